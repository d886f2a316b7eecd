//! Edits behind checksums: a file is taken apart, edited inside, and put together again as its writer would, with right
//! lengths and right checksums, so that the edits reach what stands behind them.

use foveal_runtime::Trace;

/// A part of a recording that can be edited, with what is put before it again.
pub enum Part {
    /// As it is: what tells the kind of a segment.
    Fixed(Vec<u8>),
    /// Content without a length: a header, an end, the head of a chunk.
    Plain(Vec<u8>),
    /// Content with its length before it, made of parts.
    Counted(Vec<Part>),
}

impl Part {
    /// Everything that can be edited, in order.
    fn leaves<'a>(&'a mut self, found: &mut Vec<&'a mut Vec<u8>>) {
        match self {
            Self::Fixed(_) => {}
            Self::Plain(bytes) => found.push(bytes),
            Self::Counted(parts) => parts.iter_mut().for_each(|part| part.leaves(found)),
        }
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Fixed(content) | Self::Plain(content) => bytes.extend_from_slice(content),
            Self::Counted(parts) => {
                let mut content = Vec::new();
                parts.iter().for_each(|part| part.write(&mut content));
                put(bytes, content.len());
                bytes.extend_from_slice(&content);
            }
        }
    }
}

fn put(bytes: &mut Vec<u8>, mut number: usize) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// A number of seven bits a byte, and what follows it.
fn take(bytes: &[u8]) -> (usize, &[u8]) {
    let length = bytes.iter().position(|byte| *byte < 0x80).expect("a number ends") + 1;
    let digits = bytes[..length].iter().enumerate();
    let number = digits.map(|(digit, byte)| usize::from(byte & 0x7f) << (7 * digit)).sum();
    (number, &bytes[length..])
}

fn word(bytes: &[u8]) -> usize {
    u32::from_le_bytes(bytes[..4].try_into().expect("four bytes")) as usize
}

/// The segments of a whole recording: of each its parts.
pub fn recording(file: &[u8]) -> Vec<Vec<Part>> {
    let (raw, stored) = (word(&file[8..]), word(&file[12..]));
    let header = lz4_flex::block::decompress(&file[20..20 + stored], raw).expect("a header");
    let behind = Trace::segments(file).expect("a recording");
    let parts = |body: Vec<u8>| {
        let kind = Part::Fixed(body[..1].to_vec());
        let parts = if body[0] == 1 { chunks(&body[1..]) } else { vec![Part::Plain(body[1..].to_vec())] };
        std::iter::once(kind).chain(parts).collect()
    };
    std::iter::once(header).chain(behind).map(parts).collect()
}

/// The recording again with one of its blocks edited as it is stored: what unpacks them gets nonsense.
pub fn with_block(file: &[u8], which: u16, edit: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let (mut left, mut blocks) = (&file[8..], Vec::new());
    while !left.is_empty() {
        let stored = word(&left[4..]);
        blocks.push((&left[..4], left[12..12 + stored].to_vec()));
        left = &left[12 + stored..];
    }
    let count = blocks.len();
    let block = &mut blocks[usize::from(which) % count].1;
    *block = edit(block);
    let mut bytes = file[..8].to_vec();
    blocks.iter().for_each(|(length, block)| seal(&mut bytes, length, block));
    bytes
}

/// A segment, whose unpacked length and block are given.
fn seal(bytes: &mut Vec<u8>, length: &[u8], block: &[u8]) {
    let mut segment = length.to_vec();
    segment.extend_from_slice(&(block.len() as u32).to_le_bytes());
    let checksum = crc32fast::hash(&[segment.as_slice(), block].concat());
    segment.extend_from_slice(&checksum.to_le_bytes());
    segment.extend_from_slice(block);
    bytes.extend_from_slice(&segment);
}

fn chunks(mut body: &[u8]) -> Vec<Part> {
    let mut chunks = Vec::new();
    while !body.is_empty() {
        let (length, rest) = take(body);
        chunks.push(Part::Counted(chunk(&rest[..length])));
        body = &rest[length..];
    }
    chunks
}

/// A chunk: its head, then the streams that it has.
fn chunk(bytes: &[u8]) -> Vec<Part> {
    let (_actor, rest) = take(bytes);
    let (_deliveries, rest) = take(rest);
    let (senders, mut rest) = take(&rest[8..]);
    for _ in 0..senders {
        rest = &take(rest).1[1..];
    }
    let head = bytes.len() - rest.len() + 1;
    let mut parts = vec![Part::Plain(bytes[..head].to_vec())];
    rest = &rest[1..];
    while !rest.is_empty() {
        let (length, stream) = take(rest);
        parts.push(Part::Counted(vec![Part::Plain(stream[..length].to_vec())]));
        rest = &stream[length..];
    }
    parts
}

/// The recording again, with one of its parts edited and none of its blocks coded.
pub fn sealed_recording(file: &[u8], which: u16, edit: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let mut segments = recording(file);
    let mut leaves = Vec::new();
    segments.iter_mut().flatten().for_each(|part| part.leaves(&mut leaves));
    let count = leaves.len();
    let leaf = &mut *leaves[usize::from(which) % count];
    *leaf = edit(leaf);
    let mut bytes = file[..8].to_vec();
    for parts in segments {
        let mut body = Vec::new();
        parts.iter().for_each(|part| part.write(&mut body));
        seal(&mut bytes, &(body.len() as u32).to_le_bytes(), &lz4_flex::block::compress(&body));
    }
    bytes
}

/// Magic, version and key of a kept bake, then two lengths, then the checksum.
const LENGTHS: usize = 44;
const CHECKSUM: usize = LENGTHS + 16;
const BODY: usize = CHECKSUM + 32;

/// A kept bake again, with its content edited.
pub fn sealed_bake(file: &[u8], edit: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
    let plain = lz4_flex::block::decompress(&file[BODY..], word(&file[LENGTHS + 8..])).expect("a whole file");
    let plain = edit(&plain);
    let block = lz4_flex::block::compress(&plain);
    let mut bytes = file[..LENGTHS].to_vec();
    bytes.extend_from_slice(&(block.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&(plain.len() as u64).to_le_bytes());
    let checksum = blake3::Hasher::new().update(&bytes).update(&block).finalize();
    bytes.extend_from_slice(checksum.as_bytes());
    bytes.extend_from_slice(&block);
    bytes
}
