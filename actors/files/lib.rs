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

use std::io::Write;
use std::path::Path;

use atomic_write_file::AtomicWriteFile;

/// Writes a file whole: first beside it, then in one step over what was there, whoever else writes the same.
fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    write_pieces(path, [bytes])
}

/// [`write_whole`] of bytes one after the other.
fn write_pieces<'a>(path: &Path, pieces: impl IntoIterator<Item = &'a [u8]>) -> std::io::Result<()> {
    // What cannot take the place of a folder would stay beside it.
    if path.is_dir() {
        return Err(std::io::ErrorKind::IsADirectory.into());
    }
    let mut file = AtomicWriteFile::open(path)?;
    pieces.into_iter().try_for_each(|piece| file.write_all(piece))?;
    file.commit()
}
