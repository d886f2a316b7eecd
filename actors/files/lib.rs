//! The files of foveal, in and out. The core knows scenes and maps; what a disk holds of them is read and written here.
//!
//! [`load`] makes scenes of what people have: OBJ with MTL, glTF, sidecars, pictures. The others are our own, and each is
//! written whole or not at all, under a checksum: [`bakes`] keeps light under the key of its scene and settings, [`kept`] a
//! scene with its geometry index for the next start, [`mips`] the levels of textures that are not in memory. What is cut
//! short, altered or made up is an error, never a panic or memory that nobody has.

pub mod bakes;
pub mod kept;
pub mod load;
pub mod mips;
