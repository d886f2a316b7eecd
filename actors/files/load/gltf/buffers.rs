//! Bytes of buffers, read when something that is drawn asks for them first.

use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::{GeneralPurpose, GeneralPurposeConfig};
use base64::engine::{DecodePaddingMode, general_purpose::STANDARD};

use super::super::error::FileProblem;
use super::super::folder::Folder;
use super::document::{Document, Meshopt};
use super::meshopt::{self, Layout};
use super::number::Index;
use super::{Problem, get};

/// Bytes of all data URIs of buffers.
const DATA_BYTES_MAX: usize = 512 << 20;

/// Bytes of all views that were compressed.
const DECODED_BYTES_MAX: u64 = 4 << 30;

/// The bytes behind a document: those of its own file, and the files beside it.
pub(super) struct Buffers<'a> {
    document: &'a Document,
    folder: &'a mut Folder,
    /// The folder of the document, relative to the scene's.
    base: &'a Path,
    file: &'a [u8],
    bin: Option<Range<usize>>,
    loaded: Vec<Option<Vec<u8>>>,
    data_bytes: usize,
    /// Views that were compressed, by their number.
    decoded: HashMap<u32, Vec<u8>>,
    /// Values of accessors that came from compressed meshes, by their number, tightly packed.
    values: HashMap<u32, Vec<u8>>,
    decoded_bytes: u64,
}

/// What a `uri` means.
pub(super) enum Reference {
    /// A file of the scene's folder.
    File(PathBuf),
    /// Bytes in the document.
    Data(Vec<u8>),
}

impl<'a> Buffers<'a> {
    pub fn new(
        document: &'a Document,
        folder: &'a mut Folder,
        base: &'a Path,
        file: &'a [u8],
        bin: Option<Range<usize>>,
    ) -> Self {
        let loaded = vec![None; document.buffers.len()];
        Self {
            document,
            folder,
            base,
            file,
            bin,
            loaded,
            data_bytes: 0,
            decoded: HashMap::new(),
            values: HashMap::new(),
            decoded_bytes: 0,
        }
    }

    /// What lies behind a `uri`. The error completes "`uri` …".
    pub fn resolve(&mut self, uri: &str) -> Result<Reference, String> {
        if let Some(data) = uri.strip_prefix("data:") {
            let left = DATA_BYTES_MAX - self.data_bytes;
            let bytes = decode_data(data, left)?;
            self.data_bytes += bytes.len();
            return Ok(Reference::Data(bytes));
        }
        if let Some(scheme) = scheme(uri) {
            return Err(format!("begins with \"{scheme}:\"; only files beside the scene and data: are read"));
        }
        let name = percent_decoded(uri);
        let found = self.folder.find(self.base, &name).map_err(|p| format!("\"{}\" {p}", shortened(uri)))?;
        Ok(Reference::File(found))
    }

    fn load(&mut self, index: usize) -> Result<(), Problem> {
        let buffer = &self.document.buffers[index];
        let at = || format!("/buffers/{index}");
        let declared = buffer.byte_length.0;
        let own = self.bin.as_ref().map(Range::len);
        let length = match (&buffer.uri, own) {
            (None, Some(length)) if index == 0 => length,
            (None, _) => {
                let message = "has no `uri`, and the file has no bytes of its own; export again as .glb, or with its .bin";
                return Err(Problem::new(at(), message));
            }
            (Some(uri), _) => {
                let bytes = match self.resolve(uri).map_err(|e| Problem::new(at() + "/uri", e))? {
                    Reference::Data(bytes) => bytes,
                    Reference::File(found) => {
                        let read = self.folder.read(&found);
                        read.map_err(|p| Problem::new(at() + "/uri", format!("\"{}\" {p}", shortened(uri))))?
                    }
                };
                let length = bytes.len();
                self.loaded[index] = Some(bytes);
                length
            }
        };
        if declared > length as u64 {
            return Err(too_short(index, declared, length as u64));
        }
        Ok(())
    }

    /// Whether a view lies in a buffer that is only a place for bytes, which the file does not have.
    pub fn is_placeholder(&self, view: Index) -> bool {
        let Some(view) = self.document.buffer_views.get(view.at()) else { return false };
        let buffer = view.extensions.meshopt.as_ref().map_or(view.buffer, |m| m.buffer);
        let no_name = self.document.buffers.get(buffer.at()).is_some_and(|b| b.uri.is_none());
        no_name && (buffer.0 > 0 || !self.is_container())
    }

    fn is_container(&self) -> bool {
        self.file.starts_with(b"glTF")
    }

    /// What is odd about a buffer of which nothing is drawn; it completes "`uri` …". An error where its bytes are not there.
    pub fn doubt(&mut self, index: usize) -> Result<Option<String>, Problem> {
        let declared = &self.document.buffers[index];
        let at = |key: &str| format!("/buffers/{index}{key}");
        let length = match &declared.uri {
            // Without a `uri` it is the file's own chunk, or a place for what an extension brings.
            None if index > 0 || !self.is_container() => return Ok(None),
            None => match &self.bin {
                Some(bin) => bin.len() as u64,
                None => {
                    let message = "has no `uri`, and the file has no bytes of its own; export again";
                    return Err(Problem::new(at(""), message));
                }
            },
            Some(uri) if uri.starts_with("data:") => match self.resolve(uri) {
                Ok(Reference::Data(bytes)) => bytes.len() as u64,
                Ok(Reference::File(_)) => return Ok(None),
                Err(why) => return Ok(Some(why)),
            },
            Some(uri) if uri.contains(':') => {
                return Ok(Some("names no file beside the scene".to_owned()));
            }
            Some(uri) => match self.folder.find(self.base, &percent_decoded(uri)) {
                Ok(found) => match std::fs::metadata(found) {
                    Ok(file) => file.len(),
                    Err(_) => return Ok(Some("cannot be read".to_owned())),
                },
                Err(why @ FileProblem::Missing) => {
                    return Err(Problem::new(at("/uri"), format!("\"{}\" {why}", shortened(uri))));
                }
                Err(why) => return Ok(Some(format!("\"{}\" {why}", shortened(uri)))),
            },
        };
        if declared.byte_length.0 > length {
            return Err(too_short(index, declared.byte_length.0, length));
        }
        Ok(None)
    }

    /// The bytes of a view, and its stride.
    pub fn view(&mut self, index: Index) -> Result<(&[u8], Option<u64>), Problem> {
        let document = self.document;
        let view = get(&document.buffer_views, index, "bufferViews")?;
        let at = || format!("/bufferViews/{}", index.0);
        if let Some(stride) = view.byte_stride.filter(|s| !(1..=252).contains(&s.0)) {
            let message = format!("is {}; it must be between 4 and 252", stride.0);
            return Err(Problem::new(at() + "/byteStride", message));
        }
        let stride = view.byte_stride.map(|s| s.0);
        let Some(packed) = &view.extensions.meshopt else {
            return Ok((self.range(view.buffer, view.byte_offset.0, view.byte_length.0, at)?, stride));
        };
        if !self.decoded.contains_key(&index.0) {
            let bytes = self.decompress(packed, view.byte_length.0, &at)?;
            self.decoded.insert(index.0, bytes);
        }
        Ok((self.decoded.get(&index.0).map_or(&[], Vec::as_slice), stride))
    }

    /// What comes out of a compressed view, which has to be `declared` bytes.
    fn decompress(
        &mut self,
        packed: &Meshopt,
        declared: u64,
        at: &dyn Fn() -> String,
    ) -> Result<Vec<u8>, Problem> {
        let at = || at() + "/extensions/EXT_meshopt_compression";
        let (count, stride) = (packed.count.0, packed.byte_stride.0);
        let filter = packed.filter.as_deref().unwrap_or("NONE");
        let layout = Layout::named(&packed.mode, filter, count, stride)
            .map_err(|why| Problem::new(at(), format!("is compressed {why}; export it again")))?;
        if u128::from(count) * u128::from(stride) != u128::from(declared) {
            let message =
                format!("has {count} elements of {stride} bytes, but the view has {declared} bytes");
            return Err(Problem::new(at() + "/count", message + "; export it again"));
        }
        self.expect_decoded(declared).map_err(|message| Problem::new(at() + "/count", message))?;
        let bytes = self.range(packed.buffer, packed.byte_offset.0, packed.byte_length.0, at)?;
        meshopt::decode(bytes, &layout)
            .map_err(|why| Problem::new(at(), format!("the compressed bytes {why}; export it again")))
    }

    /// Counts what is about to be decoded. The error completes "view …".
    pub fn expect_decoded(&mut self, bytes: u64) -> Result<(), String> {
        self.decoded_bytes = self.decoded_bytes.saturating_add(bytes);
        if self.decoded_bytes > DECODED_BYTES_MAX {
            return Err(format!("makes the views of the file more than {DECODED_BYTES_MAX} bytes; split it"));
        }
        Ok(())
    }

    /// The values of an accessor that came from a compressed mesh.
    pub fn values(&self, accessor: Index) -> Option<&[u8]> {
        self.values.get(&accessor.0).map(Vec::as_slice)
    }

    /// Keeps them.
    #[cfg(feature = "draco")]
    pub fn set_values(&mut self, accessor: Index, bytes: Vec<u8>) {
        self.values.insert(accessor.0, bytes);
    }

    /// Bytes of a buffer; `at` is where they are asked for.
    fn range(
        &mut self,
        buffer: Index,
        start: u64,
        length: u64,
        at: impl Fn() -> String,
    ) -> Result<&[u8], Problem> {
        let declared = get(&self.document.buffers, buffer, "buffers")?;
        let (buffer, own) = (buffer.at(), declared.uri.is_none());
        if self.loaded[buffer].is_none() {
            self.load(buffer)?;
        }
        let declared = declared.byte_length.0;
        let end = start.checked_add(length).filter(|&end| end <= declared).ok_or_else(|| {
            let message = format!("{length} bytes from {start} leave the buffer of {declared}; export again");
            Problem::new(at(), message)
        })?;
        let whole: &[u8] = match (&self.loaded[buffer], &self.bin) {
            (Some(bytes), _) => bytes,
            (None, Some(bin)) if own => &self.file[bin.clone()],
            (None, _) => &[],
        };
        // `load` has seen that there are as many bytes as declared.
        Ok(whole.get(start as usize..end as usize).unwrap_or(&[]))
    }
}

fn too_short(index: usize, declared: u64, length: u64) -> Problem {
    let message = format!("is {declared}, but there are {length} bytes; export the buffer again");
    Problem::new(format!("/buffers/{index}/byteLength"), message)
}

/// A scheme before a colon. A single letter is a drive, which [`Folder::find`] refuses.
fn scheme(uri: &str) -> Option<&str> {
    let (scheme, _) = uri.split_once(':')?;
    let good = scheme.len() > 1
        && scheme.bytes().all(|b| b.is_ascii_alphanumeric() || matches!(b, b'+' | b'-' | b'.'));
    good.then_some(scheme)
}

/// As much of a name as a message shows.
pub(super) fn shortened(uri: &str) -> String {
    let short: String = uri.chars().take(80).collect();
    if short.len() < uri.len() { short + "…" } else { short }
}

/// `%41` to `A`, once: what is left of `%252e` is `%2e`, not a dot.
fn percent_decoded(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let hex = |b: Option<&u8>| b.and_then(|b| (*b as char).to_digit(16));
        match (bytes[at], hex(bytes.get(at + 1)).zip(hex(bytes.get(at + 2)))) {
            (b'%', Some((high, low))) => {
                out.push((high * 16 + low) as u8);
                at += 3;
            }
            (byte, _) => {
                out.push(byte);
                at += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// What follows `data:`; at most `limit` bytes of it.
fn decode_data(data: &str, limit: usize) -> Result<Vec<u8>, String> {
    const LENIENT: GeneralPurpose = GeneralPurpose::new(
        &base64::alphabet::STANDARD,
        GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
    );
    let (kind, body) = data.split_once(',').ok_or("is a data URI without a comma; export again")?;
    if !kind.ends_with(";base64") {
        return Err("is a data URI that is not base64; export again".to_owned());
    }
    if body.len() / 4 * 3 > limit {
        return Err(format!("makes data URIs of more than {DATA_BYTES_MAX} bytes; export as .glb"));
    }
    let read = STANDARD.decode(body).or_else(|_| LENIENT.decode(body));
    read.map_err(|e| format!("is broken base64 ({e}); export again"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_decoded_once() {
        assert_eq!(percent_decoded("a%20b%2Fc"), "a b/c");
        assert_eq!(percent_decoded("%252e%252e/x"), "%2e%2e/x");
        assert_eq!(percent_decoded("50%,%4,%zz%"), "50%,%4,%zz%");
        assert_eq!(scheme("file:///etc/passwd"), Some("file"));
        assert_eq!((scheme("C:/x"), scheme("a b:c")), (None, None));
    }

    #[test]
    fn data_is_bounded_and_forgiving_of_padding() {
        assert_eq!(decode_data("application/octet-stream;base64,AAEC", 9), Ok(vec![0, 1, 2]));
        assert_eq!(decode_data(";base64,AAE", 9), Ok(vec![0, 1]));
        assert_eq!(decode_data(";base64,AAE=", 9), Ok(vec![0, 1]));
        assert!(decode_data(";base64,AAECAAEC", 5).unwrap_err().contains("more than"));
        for bad in ["AAEC", "text/plain,abc", ";base64,A*", ";base64,A"] {
            assert!(decode_data(bad, 99).is_err(), "{bad}");
        }
    }
}
