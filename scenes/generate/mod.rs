//! The bundled scenes as functions. Deterministic: the same bytes on every machine.

mod chess;
mod cornell;
mod duck;
mod gallery;
mod implicit;
mod large;
mod obj;
mod shapes;
mod table;
mod test_rooms;
mod textures;

pub use obj::SceneFiles;

/// The bundled scenes, one at a time; with `large`, the rooms for measurements too.
pub fn scenes(large: bool) -> impl Iterator<Item = image::ImageResult<SceneFiles>> {
    type Make = fn() -> image::ImageResult<SceneFiles>;
    let bundled: [Make; 7] = [
        cornell::scene,
        duck::scene,
        table::scene,
        gallery::scene,
        chess::scene,
        test_rooms::furnace,
        test_rooms::diffuse,
    ];
    let rooms: [Make; 3] = [|| large::hall(100_000), || large::hall(300_000), || large::hall(1_000_000)];
    bundled.into_iter().chain(rooms.into_iter().filter(move |_| large)).map(|make| make())
}
