//! Recordings that say something else than what happened, with right checksums.

use std::fs;
use std::path::{Path, PathBuf};

use foveal_runtime::{Header, Trace};
use serde_json::Value;

/// A segment as the recorder frames it.
fn segment(body: &[u8]) -> Vec<u8> {
    let block = lz4_flex::block::compress(body);
    let mut bytes = (body.len() as u32).to_le_bytes().to_vec();
    bytes.extend_from_slice(&(block.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&crc32fast::hash(&[bytes.as_slice(), &block].concat()).to_le_bytes());
    [bytes, block].concat()
}

/// A recording beside another one, whose header differs: the runtime's, and what the program says in it.
pub fn altered(recording: &Path, name: &str, change: impl FnOnce(&mut Header, &mut Value)) -> PathBuf {
    let bytes = fs::read(recording).expect("a recording");
    let mut header = Trace::from_bytes(&bytes).expect("a recording").header().clone();
    let mut run: Value = serde_json::from_slice(&header.application).expect("JSON");
    change(&mut header, &mut run);
    header.application = serde_json::to_vec(&run).expect("JSON");
    let header = postcard::to_stdvec(&header).expect("a header");
    let behind = 8 + 12 + u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
    let bytes = [&bytes[..8], &segment(&[&[0], header.as_slice()].concat()), &bytes[behind..]].concat();
    let file = recording.with_file_name(name);
    fs::write(&file, bytes).expect("written");
    file
}
