//! The binary container (glTF 2.0 §4): a JSON chunk, and at most one of bytes.

use std::ops::Range;

/// Bytes of a document. A larger one is refused before it is read as JSON.
const JSON_BYTES_MAX: usize = 256 << 20;

/// Where a file keeps its document and its own bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Container {
    /// The document.
    pub json: Range<usize>,
    /// The chunk that a buffer without `uri` means.
    pub bin: Option<Range<usize>>,
    /// What is odd about it.
    pub doubts: Vec<String>,
}

fn word(bytes: &[u8], at: usize) -> Option<usize> {
    let word = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(word.try_into().ok()?) as usize)
}

/// Finds the chunks of a GLB, or takes the whole for a document. The error says what is wrong and what to do.
pub(super) fn open(bytes: &[u8]) -> Result<Container, String> {
    let mut doubts = Vec::new();
    let (json, bin) =
        if bytes.starts_with(b"glTF") { chunks(bytes, &mut doubts)? } else { (0..bytes.len(), None) };
    let mut json = json;
    if bytes[json.clone()].starts_with(b"\xef\xbb\xbf") {
        json.start += 3;
        doubts.push("the document begins with a byte order mark; skipped".to_owned());
    }
    if json.len() > JSON_BYTES_MAX {
        return Err(format!(
            "its document has {} bytes, more than {JSON_BYTES_MAX}; keep buffers and pictures outside of it",
            json.len()
        ));
    }
    Ok(Container { json, bin, doubts })
}

type Chunks = (Range<usize>, Option<Range<usize>>);

fn chunks(bytes: &[u8], doubts: &mut Vec<String>) -> Result<Chunks, String> {
    const AGAIN: &str = "export it again";
    let header = word(bytes, 4).zip(word(bytes, 8));
    let (version, length) = header.ok_or_else(|| format!("the file ends within its header; {AGAIN}"))?;
    if version != 2 {
        return Err(format!("it is a container of version {version}; this build reads version 2"));
    }
    if length > bytes.len() {
        return Err(format!("it declares {length} bytes but has {}; {AGAIN}", bytes.len()));
    }
    if length < bytes.len() {
        doubts.push(format!(
            "{} bytes lie behind the end that the header gives; not read",
            bytes.len() - length
        ));
    }
    let mut at = 12;
    let (mut json, mut bin) = (None, None);
    while at < length {
        let header = word(&bytes[..length], at).zip(word(&bytes[..length], at + 4));
        let (size, kind) =
            header.ok_or_else(|| format!("a chunk's header at byte {at} is cut off; {AGAIN}"))?;
        let start = at + 8;
        if size % 4 != 0 {
            return Err(format!("the chunk at byte {at} has {size} bytes, no multiple of 4; {AGAIN}"));
        }
        let end = start.checked_add(size).filter(|&end| end <= length);
        let end =
            end.ok_or_else(|| format!("the chunk at byte {at} of {size} bytes leaves the file; {AGAIN}"))?;
        match (&kind.to_le_bytes()[..4], json.is_some()) {
            (b"JSON", false) => json = Some(start..end),
            (_, false) => return Err(format!("its first chunk is no document; {AGAIN}")),
            (b"JSON", true) => return Err(format!("it has a second document; {AGAIN}")),
            (b"BIN\0", true) if bin.is_some() => {
                return Err(format!("it has a second chunk of bytes, at byte {at}; {AGAIN}"));
            }
            (b"BIN\0", true) => bin = Some(start..end),
            // The text wants chunks of other kinds to be passed over.
            (_, true) => {}
        }
        at = end;
    }
    let json = json.ok_or_else(|| format!("it has no document; {AGAIN}"))?;
    Ok((json, bin))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A container of chunks.
    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut body = Vec::new();
        for (kind, bytes) in chunks {
            body.extend((bytes.len() as u32).to_le_bytes());
            body.extend(*kind);
            body.extend(*bytes);
        }
        let mut file = b"glTF".to_vec();
        file.extend(2u32.to_le_bytes());
        file.extend((12 + body.len() as u32).to_le_bytes());
        file.extend(body);
        file
    }

    #[test]
    fn chunks_are_found() {
        let file = glb(&[(b"JSON", b"{}  "), (b"XYZW", b"1234"), (b"BIN\0", b"abcdefgh")]);
        let found = open(&file).unwrap();
        assert_eq!((&file[found.json], &file[found.bin.unwrap()]), (&b"{}  "[..], &b"abcdefgh"[..]));
        assert!(found.doubts.is_empty());
        let longer = [&file[..], b"more"].concat();
        assert_eq!(open(&longer).unwrap().doubts.len(), 1);
        let text = open(b"\xef\xbb\xbf{}").unwrap();
        assert_eq!((text.json, text.bin, text.doubts.len()), (3..5, None, 1));
    }

    #[test]
    fn what_leaves_the_file_is_refused() {
        let good = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"abcd")]);
        for length in 4..good.len() {
            assert!(open(&good[..length]).is_err(), "{length}");
        }
        let with = |at: usize, value: u32| {
            let mut file = good.clone();
            file[at..at + 4].copy_from_slice(&value.to_le_bytes());
            open(&file).unwrap_err()
        };
        assert!(with(4, 1).contains("version 1"));
        assert!(with(8, 1000).contains("1000 bytes"));
        assert!(with(12, 3).contains("multiple of 4"));
        assert!(with(12, u32::MAX - 3).contains("leaves the file"));
        assert!(with(16, 7).contains("no document"));
        for twice in [&b"JSON"[..], b"BIN\0"] {
            let kind: &[u8; 4] = twice.try_into().unwrap();
            assert!(open(&glb(&[(b"JSON", b"{}  "), (b"BIN\0", b""), (kind, b"{}  ")])).is_err());
        }
        assert!(open(&glb(&[])).is_err());
    }
}
