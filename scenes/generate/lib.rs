//! The bundled scenes as functions. Deterministic: the same bytes on every machine.

#![expect(
    clippy::disallowed_methods,
    reason = "the files that are kept were made with these; a test compares them"
)]

mod atelier;
mod chess;
mod cornell;
mod duck;
mod finishes;
mod gallery;
mod gltf;
mod implicit;
mod kinds;
mod large;
mod obj;
mod salon;
mod shapes;
mod table;
mod test_rooms;
mod textures;

pub use kinds::KINDS;
pub use obj::SceneFiles;

/// Makes a scene.
pub type Make = fn() -> image::ImageResult<SceneFiles>;

/// The bundled scenes by name.
pub const BUNDLED: [(&str, Make); 9] = [
    ("box", cornell::scene),
    ("duck", duck::scene),
    ("table", table::scene),
    ("gallery", gallery::scene),
    ("chess", chess::scene),
    ("atelier", atelier::scene),
    ("finishes", finishes::scene),
    ("furnace", test_rooms::furnace),
    ("diffuse", test_rooms::diffuse),
];

/// A hall of vases of about `triangle_count` triangles, for measurements.
pub fn hall(triangle_count: usize) -> image::ImageResult<SceneFiles> {
    large::hall(triangle_count)
}

/// A papered salon, for the measurement of simplified meshes.
pub fn salon() -> image::ImageResult<SceneFiles> {
    salon::scene()
}
