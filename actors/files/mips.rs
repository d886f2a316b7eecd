//! Levels of mip chains on disk, one file each, named by the content of their chain.
//!
//! In: a chain whose levels are in memory. Out: files that give each level back without the picture's decoder. What is
//! cut short, altered or of another chain is an error, never a panic or a large allocation.

use std::fs;
use std::io::{Error, ErrorKind, Result};
use std::path::{Path, PathBuf};

use foveal::scene::texture::{LevelTexels, MipChain};

use crate::write_whole;

/// First bytes of a file; the digit is the version.
const MAGIC: [u8; 8] = *b"FVMIP1\r\n";
/// Magic and checksum.
const HEADER: usize = 8 + 32;

/// Where a level of the chain with this content is kept.
pub fn level_file(folder: &Path, content: &[u8; 32], level: usize) -> PathBuf {
    let name = blake3::Hash::from_bytes(*content).to_hex();
    folder.join(format!("{}-{level}.fvmip", &name[..32]))
}

/// Keeps all levels of a chain that are in memory and not kept yet.
pub fn keep(folder: &Path, content: &[u8; 32], chain: &MipChain) -> Result<()> {
    fs::create_dir_all(folder)?;
    for level in 0..chain.level_count() {
        let file = level_file(folder, content, level);
        let Some(texels) = chain.level(level).filter(|_| !file.exists()) else { continue };
        let plain = texels.as_bytes();
        let body = lz4_flex::block::compress_prepend_size(plain);
        write_whole(&file, &[MAGIC.as_slice(), blake3::hash(plain).as_bytes(), &body].concat())?;
    }
    Ok(())
}

/// Reads a level of `bytes` bytes back, of texels like those of another level of its chain.
pub fn read(file: &Path, bytes: usize, like: &LevelTexels) -> Result<LevelTexels> {
    let wrong = || Error::new(ErrorKind::InvalidData, "cut short or damaged");
    let content = fs::read(file)?;
    let (header, body) = content.split_at_checked(HEADER).ok_or_else(wrong)?;
    let (magic, sum) = header.split_at(MAGIC.len());
    let stated = body.get(..4).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes).ok_or_else(wrong)?;
    if magic != MAGIC || stated as usize != bytes {
        return Err(wrong());
    }
    let plain = lz4_flex::block::decompress_size_prepended(body).map_err(|_| wrong())?;
    if plain.len() != bytes || blake3::hash(&plain).as_bytes() != sum {
        return Err(wrong());
    }
    like.of_bytes(&plain).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_come_back_and_damage_is_refused() {
        let folder = std::env::temp_dir().join(format!("foveal-mips-{}", std::process::id()));
        let texels = (0..64 * 16u32).map(|i| [i as u8, (i / 7) as u8, (i / 64) as u8, 255]).collect();
        let chain = MipChain::from_rgba8(64, 16, texels, true);
        let content = chain.content_hash();
        keep(&folder, &content, &chain).unwrap();
        let like = chain.level(6).unwrap();
        for level in 0..chain.level_count() {
            let file = level_file(&folder, &content, level);
            let back = read(&file, chain.level_bytes(level), like).unwrap();
            assert_eq!(back.as_bytes(), chain.level(level).unwrap().as_bytes());
            assert!(read(&file, chain.level_bytes(level) + 4, like).is_err());
            let good = fs::read(&file).unwrap();
            for at in [0, 20, HEADER, HEADER + 2, good.len() - 1] {
                let mut bad = good.clone();
                bad[at] ^= 0x55;
                fs::write(&file, &bad).unwrap();
                assert!(read(&file, chain.level_bytes(level), like).is_err(), "level {level}, byte {at}");
                fs::write(&file, &good[..at]).unwrap();
                assert!(read(&file, chain.level_bytes(level), like).is_err(), "level {level}, cut at {at}");
            }
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
