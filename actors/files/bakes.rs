//! Files that keep a bake: a header with the key of scene and settings, then a compressed body under a
//! checksum. What is cut short, altered, of another version or another scene is an error and never
//! a panic or a large allocation.

use std::fs;
use std::io::Read;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::write_whole;
use foveal::illumination::bake::VERSION;
use foveal::illumination::stored::Illumination;

/// First bytes of a file.
const MAGIC: [u8; 8] = *b"FVBAKE\r\n";
/// Magic, version, key, compressed and plain length, checksum.
const HEADER: usize = 8 + 4 + 32 + 8 + 8 + 32;
/// LZ4 cannot expand more than this.
const EXPANSION_MAX: u64 = 255;
/// Bytes of a body at most: above 2 GiB of texels something else is wrong.
const BODY_BYTES_MAX: u64 = 4 << 30;

/// Why a file was not used.
#[derive(Debug)]
pub enum CacheError {
    /// It could not be read or written.
    Io(std::io::Error),
    /// It is no bake, or one of another version.
    Foreign,
    /// It was made from another scene or with other settings.
    OtherKey,
    /// It is cut short or altered.
    Damaged,
}

impl std::fmt::Display for CacheError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io(error) => write!(f, "{error}"),
            Self::Foreign => f.write_str("not a bake of this version"),
            Self::OtherKey => f.write_str("made from another scene or with other settings"),
            Self::Damaged => f.write_str("cut short or damaged"),
        }
    }
}

impl std::error::Error for CacheError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            _ => None,
        }
    }
}

impl From<std::io::Error> for CacheError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

/// The bytes of a file that keeps `value` under `key`.
///
/// # Errors
/// [`CacheError::Damaged`] if `value` cannot be serialised or is too large.
pub fn encode<T: Serialize>(key: &[u8; 32], value: &T) -> Result<Vec<u8>, CacheError> {
    let plain = postcard::to_stdvec(value).map_err(|_| CacheError::Damaged)?;
    if plain.len() as u64 > BODY_BYTES_MAX {
        return Err(CacheError::Damaged);
    }
    let body = lz4_flex::block::compress(&plain);
    let mut bytes = Vec::with_capacity(HEADER + body.len());
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(key);
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend((plain.len() as u64).to_le_bytes());
    bytes.extend(checksum(&bytes, &body));
    bytes.extend(body);
    Ok(bytes)
}

fn checksum(head: &[u8], body: &[u8]) -> [u8; 32] {
    *blake3::Hasher::new().update(head).update(body).finalize().as_bytes()
}

/// What [`encode`] gives under `key` for the value that is kept in the bytes of a file under another one. Nothing is unpacked
/// for it.
///
/// # Errors
/// If the bytes are not whole, or of another version.
pub fn under(key: &[u8; 32], bytes: &[u8]) -> Result<Vec<u8>, CacheError> {
    let (head, body) = bytes.split_at_checked(HEADER).ok_or(CacheError::Damaged)?;
    if head[..8] != MAGIC || head[8..12] != VERSION.to_le_bytes() {
        return Err(CacheError::Foreign);
    }
    if checksum(&head[..60], body) != head[60..] {
        return Err(CacheError::Damaged);
    }
    let mut bytes = [&head[..12], key, &head[44..60]].concat();
    bytes.extend(checksum(&bytes, body));
    bytes.extend(body);
    Ok(bytes)
}

/// The value kept in the bytes of a file, if they are whole and of this version and key.
///
/// # Errors
/// Says what is wrong with the bytes.
pub fn decode<T: DeserializeOwned>(key: &[u8; 32], bytes: &[u8]) -> Result<T, CacheError> {
    let (head, body) = bytes.split_at_checked(HEADER).ok_or(CacheError::Damaged)?;
    if head[..8] != MAGIC || head[8..12] != VERSION.to_le_bytes() {
        return Err(CacheError::Foreign);
    }
    let length = |at: usize| {
        let mut word = [0; 8];
        word.copy_from_slice(&head[at..at + 8]);
        u64::from_le_bytes(word)
    };
    let (compressed, plain) = (length(44), length(52));
    if compressed != body.len() as u64 || checksum(&head[..60], body) != head[60..] {
        return Err(CacheError::Damaged);
    }
    if head[12..44] != *key {
        return Err(CacheError::OtherKey);
    }
    if plain > BODY_BYTES_MAX || plain > compressed.saturating_mul(EXPANSION_MAX) {
        return Err(CacheError::Damaged);
    }
    let plain = lz4_flex::block::decompress(body, plain as usize).map_err(|_| CacheError::Damaged)?;
    postcard::from_bytes(&plain).map_err(|_| CacheError::Damaged)
}

/// Writes `value` to `path`: first beside it, then in one step over what was there.
///
/// # Errors
/// If the file cannot be written.
pub fn save<T: Serialize>(path: &Path, key: &[u8; 32], value: &T) -> Result<(), CacheError> {
    Ok(write_whole(path, &encode(key, value)?)?)
}

/// Reads what [`save`] wrote.
///
/// # Errors
/// If the file is not there, not whole, or of another version or key.
pub fn load<T: DeserializeOwned>(path: &Path, key: &[u8; 32]) -> Result<T, CacheError> {
    let file = fs::File::open(path)?;
    let length = file.metadata()?.len();
    if length > BODY_BYTES_MAX + HEADER as u64 {
        return Err(CacheError::Damaged);
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(length).read_to_end(&mut bytes)?;
    decode(key, &bytes)
}

/// Reads an illumination and checks that it fits a scene of `triangles` triangles.
///
/// # Errors
/// As [`load`]; [`CacheError::Damaged`] if an index or value in it is impossible.
pub fn load_illumination(path: &Path, key: &[u8; 32], triangles: usize) -> Result<Illumination, CacheError> {
    let map: Illumination = load(path, key)?;
    if map.triangle_count() != triangles || !map.is_sound() {
        return Err(CacheError::Damaged);
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use foveal::illumination::atlas::{Atlas, ConformalCharts};
    use foveal::illumination::stored::Summary;
    use foveal::scene::{MaterialId, Mesh};
    use glam::{Vec2, Vec3, Vec4};

    fn map() -> Illumination {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        let mesh = Mesh {
            normals: vec![Vec3::ZERO; 4],
            uvs: vec![Vec2::ZERO; 4],
            positions,
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            materials: vec![MaterialId(0); 2],
            objects: vec![0; 2],
            ..Mesh::default()
        };
        let atlas = Atlas::build(&mesh, 200, &|_| true, &|_| true, &ConformalCharts);
        let n = atlas.elements.len();
        let values = (0..n).map(|i| Some(Vec4::splat(i as f32))).collect();
        Illumination::new(&atlas, values, vec![None; n], Summary::default())
    }

    #[test]
    fn what_was_kept_comes_back_under_its_key_only() {
        let map = map();
        let bytes = encode(&[7; 32], &map).unwrap();
        assert_eq!(decode::<Illumination>(&[7; 32], &bytes).unwrap(), map);
        assert!(matches!(decode::<Illumination>(&[8; 32], &bytes), Err(CacheError::OtherKey)));
        let folder = std::env::temp_dir().join(format!("foveal-cache-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("a.fvbake");
        save(&path, &[7; 32], &map).unwrap();
        assert_eq!(load_illumination(&path, &[7; 32], 2).unwrap(), map);
        assert!(load_illumination(&path, &[7; 32], 3).is_err());
        fs::remove_file(&path).unwrap();
        assert!(matches!(load_illumination(&path, &[7; 32], 2), Err(CacheError::Io(_))));
        // A folder stands where the file should be: nothing is left beside it.
        fs::create_dir(&path).unwrap();
        assert!(matches!(save(&path, &[7; 32], &map), Err(CacheError::Io(_))));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn any_cut_and_any_flipped_bit_is_refused() {
        let bytes = encode(&[7; 32], &map()).unwrap();
        for cut in (0..bytes.len()).step_by(7) {
            assert!(decode::<Illumination>(&[7; 32], &bytes[..cut]).is_err());
        }
        for at in 0..bytes.len() {
            let mut altered = bytes.clone();
            altered[at] ^= 1 << (at % 8);
            assert!(decode::<Illumination>(&[7; 32], &altered).is_err(), "{at}");
        }
        let mut longer = bytes.clone();
        longer.push(0);
        assert!(decode::<Illumination>(&[7; 32], &longer).is_err());
    }

    #[test]
    fn a_huge_claimed_length_under_a_right_checksum_is_refused() {
        let mut bytes = encode(&[7; 32], &map()).unwrap();
        bytes[52..60].copy_from_slice(&(1u64 << 60).to_le_bytes());
        let sum = checksum(&bytes[..60], &bytes[HEADER..]);
        bytes[60..HEADER].copy_from_slice(&sum);
        assert!(matches!(decode::<Illumination>(&[7; 32], &bytes), Err(CacheError::Damaged)));
    }
}
