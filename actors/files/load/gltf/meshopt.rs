//! Views compressed by meshoptimizer (`EXT_meshopt_compression` and `KHR_meshopt_compression`, appendices A and B).
//!
//! Streams do not say how long they are: a view declares what comes out, and the caller bounds that. Here nothing is kept
//! beyond what the bytes have given so far, so a stream that ends early costs no more than it holds.

mod filters;
#[cfg(test)]
mod tests;

use filters::filtered;

/// What a stream holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Elements of a vertex attribute, with what is done to them afterwards.
    Attributes(Filter),
    /// Triangle lists.
    Triangles,
    /// Any other indices.
    Indices,
}

/// What is done to attributes after they are decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    None,
    /// Unit vectors on an octahedron.
    Octahedral,
    /// Rotations without their largest component.
    Quaternion,
    /// Floats as whole numbers times powers of two.
    Exponential,
    /// Colours as luma and two differences.
    Color,
}

/// What comes out of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub mode: Mode,
    pub count: usize,
    /// Bytes of an element.
    pub stride: usize,
}

impl Layout {
    /// The layout that a document names; the error completes "is compressed …".
    pub fn named(mode: &str, filter: &str, count: u64, stride: u64) -> Result<Self, String> {
        let mode = match (mode, filter) {
            ("ATTRIBUTES", "NONE") => Mode::Attributes(Filter::None),
            ("ATTRIBUTES", "OCTAHEDRAL") => Mode::Attributes(Filter::Octahedral),
            ("ATTRIBUTES", "QUATERNION") => Mode::Attributes(Filter::Quaternion),
            ("ATTRIBUTES", "EXPONENTIAL") => Mode::Attributes(Filter::Exponential),
            ("ATTRIBUTES", "COLOR") => Mode::Attributes(Filter::Color),
            ("TRIANGLES", "NONE") => Mode::Triangles,
            ("INDICES", "NONE") => Mode::Indices,
            _ => {
                let [mode, filter] = [mode, filter].map(super::buffers::shortened);
                return Err(format!(
                    "in mode {mode:?} with filter {filter:?}, which this build does not know"
                ));
            }
        };
        let fits = match mode {
            Mode::Attributes(filter) => {
                let of_filter = match filter {
                    Filter::None | Filter::Exponential => true,
                    Filter::Octahedral | Filter::Color => matches!(stride, 4 | 8),
                    Filter::Quaternion => stride == 8,
                };
                stride.is_multiple_of(4) && (4..=256).contains(&stride) && of_filter
            }
            Mode::Triangles => matches!(stride, 2 | 4) && count.is_multiple_of(3),
            Mode::Indices => matches!(stride, 2 | 4),
        };
        match usize::try_from(count) {
            Ok(count) if fits => Ok(Self { mode, count, stride: stride as usize }),
            _ => {
                Err(format!("as {count} elements of {stride} bytes, which its mode and filter do not allow"))
            }
        }
    }
}

/// The elements of a stream: `layout.count` times `layout.stride` bytes. The error completes "the compressed bytes …".
pub(super) fn decode(bytes: &[u8], layout: &Layout) -> Result<Vec<u8>, &'static str> {
    match layout.mode {
        Mode::Attributes(filter) => {
            let mut out = attributes(bytes, layout.count, layout.stride)?;
            filtered(&mut out, layout.stride, filter);
            Ok(out)
        }
        Mode::Triangles => triangles(bytes, layout.count, layout.stride),
        Mode::Indices => indices(bytes, layout.count, layout.stride),
    }
}

const SHORT: &str = "end early";
const LONG: &str = "go on after their end";
const HEADER: &str = "begin with a byte that says another format";

/// Bytes that are read one after the other.
struct Stream<'a>(&'a [u8]);

impl<'a> Stream<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(SHORT)?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, &'static str> {
        self.take(1).map(|b| b[0])
    }

    /// Seven bits a byte, the lowest first.
    fn varint(&mut self) -> Result<u32, &'static str> {
        let mut value = 0u32;
        for shift in (0..32).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("hold a number of more than 32 bits")
    }

    fn end(&self) -> Result<(), &'static str> {
        if self.0.is_empty() { Ok(()) } else { Err(LONG) }
    }
}

/// Elements that are decoded together have columns of this many deltas.
const GROUP: usize = 16;

fn attributes(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let (version, tail_min) = match bytes.first() {
        Some(0xa0) => (0, 32),
        Some(0xa1) => (1, 24),
        _ => return Err(HEADER),
    };
    let tail = stride + if version == 1 { stride / 4 } else { 0 };
    let end = bytes.len().checked_sub(tail.max(tail_min)).filter(|&end| end >= 1).ok_or(SHORT)?;
    let mut stream = Stream(&bytes[1..end]);
    let (baseline, channels) = bytes[bytes.len() - tail..].split_at(stride);
    if channels.iter().any(|c| c & 15 > 2 || c & 15 < 2 && c >> 4 != 0) {
        return Err("name a kind of differences that there is not");
    }
    let mut last = baseline.to_vec();
    let block_max = ((8192 / stride) & !(GROUP - 1)).min(256);
    let mut out = Vec::new();
    let mut columns = vec![0u8; stride * block_max];
    while out.len() < count * stride {
        let elements = (count - out.len() / stride).min(block_max);
        let control = if version == 1 { stream.take(stride / 4)? } else { &[] };
        for (k, column) in columns.chunks_exact_mut(block_max).enumerate() {
            let control = control.get(k / 4).map(|c| c >> (2 * (k % 4)) & 3);
            match control {
                None => deltas(&mut stream, &mut column[..elements], [0, 2, 4, 8])?,
                Some(0) => deltas(&mut stream, &mut column[..elements], [0, 1, 2, 4])?,
                Some(1) => deltas(&mut stream, &mut column[..elements], [1, 2, 4, 8])?,
                Some(2) => column[..elements].fill(0),
                Some(_) => column[..elements].copy_from_slice(stream.take(elements)?),
            }
        }
        for i in 0..elements {
            for (k, last) in last.chunks_exact_mut(4).enumerate() {
                let delta = std::array::from_fn(|b| columns[(4 * k + b) * block_max + i]);
                let now = undone(delta, [last[0], last[1], last[2], last[3]], channels.get(k).copied());
                last.copy_from_slice(&now);
            }
            out.extend_from_slice(&last);
        }
    }
    stream.end()?;
    Ok(out)
}

/// Reads the deltas of one byte of elements, in groups that say how many bits each has.
fn deltas(stream: &mut Stream<'_>, column: &mut [u8], bits_of: [usize; 4]) -> Result<(), &'static str> {
    let groups = column.len().div_ceil(GROUP);
    let header = stream.take(groups.div_ceil(4))?;
    for (g, group) in column.chunks_mut(GROUP).enumerate() {
        let bits = bits_of[usize::from(header[g / 4] >> (2 * (g % 4)) & 3)];
        let packed = stream.take(bits * GROUP / 8)?;
        let mut values = [0u8; GROUP];
        for (i, value) in values.iter_mut().enumerate() {
            *value = match bits {
                0 => 0,
                8 => packed[i],
                // Single bits begin at the lowest, others at the highest.
                1 => packed[i / 8] >> (i % 8) & 1,
                _ => {
                    let (byte, place) = (i * bits / 8, i * bits % 8);
                    packed[byte] >> (8 - bits - place) & ((1 << bits) - 1)
                }
            };
            // All ones: the value follows.
            if matches!(bits, 1 | 2 | 4) && usize::from(*value) == (1 << bits) - 1 {
                *value = stream.byte()?;
            }
        }
        group.copy_from_slice(&values[..group.len()]);
    }
    Ok(())
}

/// Four bytes of an element from their differences to the one before.
fn undone(delta: [u8; 4], last: [u8; 4], channel: Option<u8>) -> [u8; 4] {
    match channel {
        Some(channel) if channel & 15 == 2 => {
            let delta = u32::from_le_bytes(delta).rotate_right(u32::from(channel >> 4));
            (u32::from_le_bytes(last) ^ delta).to_le_bytes()
        }
        Some(1) => {
            let word = |v: [u8; 4], at: usize| u16::from_le_bytes([v[at], v[at + 1]]);
            let next = |at| {
                let d = word(delta, at);
                let d = if d & 1 != 0 { !(d >> 1) } else { d >> 1 };
                word(last, at).wrapping_add(d).to_le_bytes()
            };
            let ([a, b], [c, d]) = (next(0), next(2));
            [a, b, c, d]
        }
        _ => std::array::from_fn(|b| {
            let d = delta[b];
            last[b].wrapping_add(if d & 1 != 0 { !(d >> 1) } else { d >> 1 })
        }),
    }
}

/// The last sixteen of something; 0 is the newest.
struct Recent<T>([T; 16], usize);

impl<T: Copy> Recent<T> {
    fn push(&mut self, value: T) {
        self.0[self.1 & 15] = value;
        self.1 = self.1.wrapping_add(1);
    }

    fn get(&self, back: u8) -> T {
        self.0[self.1.wrapping_sub(1 + usize::from(back)) & 15]
    }
}

/// What a decoder of triangles remembers.
struct Corners<'a> {
    data: Stream<'a>,
    next: u32,
    last: u32,
    vertices: Recent<u32>,
    edges: Recent<[u32; 2]>,
}

impl Corners<'_> {
    fn new_vertex(&mut self) -> u32 {
        self.next = self.next.wrapping_add(1);
        self.next.wrapping_sub(1)
    }

    fn explicit(&mut self) -> Result<u32, &'static str> {
        let v = self.data.varint()?;
        let delta = if v & 1 != 0 { !(v >> 1) } else { v >> 1 };
        self.last = self.last.wrapping_add(delta);
        Ok(self.last)
    }

    /// The vertex that four bits name; with it whether it is to be remembered.
    fn named(&mut self, bits: u8, explicit: bool) -> Result<(u32, bool), &'static str> {
        match bits {
            0 => Ok((self.new_vertex(), true)),
            15 if explicit => Ok((self.explicit()?, true)),
            _ => Ok((self.vertices.get(bits - 1), false)),
        }
    }

    /// A triangle beside the edge that the upper bits of `code` name.
    fn beside(&mut self, code: u8) -> Result<[u32; 3], &'static str> {
        let [a, b] = self.edges.get(code >> 4);
        let (c, remember) = match code & 15 {
            0 => (self.new_vertex(), true),
            13 => {
                self.last = self.last.wrapping_sub(1);
                (self.last, true)
            }
            14 => {
                self.last = self.last.wrapping_add(1);
                (self.last, true)
            }
            15 => (self.explicit()?, true),
            bits => (self.vertices.get(bits), false),
        };
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        if remember {
            self.vertices.push(c);
        }
        Ok([a, b, c])
    }

    /// A triangle away from all before: its last two corners as the bits of `pair` say.
    fn apart(&mut self, a: u32, pair: u8, explicit: bool) -> Result<[u32; 3], &'static str> {
        let (b, remember_b) = self.named(pair >> 4, explicit)?;
        let (c, remember_c) = self.named(pair & 15, explicit)?;
        self.edges.push([b, a]);
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        self.vertices.push(a);
        if remember_b {
            self.vertices.push(b);
        }
        if remember_c {
            self.vertices.push(c);
        }
        Ok([a, b, c])
    }
}

/// Adds an index of 2 or 4 bytes.
fn put(out: &mut Vec<u8>, stride: usize, index: u32) {
    out.extend_from_slice(&index.to_le_bytes()[..stride]);
}

fn triangles(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let mut stream = Stream(bytes);
    if stream.byte()? != 0xe1 {
        return Err(HEADER);
    }
    let codes = stream.take(count / 3)?;
    let end = stream.0.len().checked_sub(16).ok_or(SHORT)?;
    let (data, table) = stream.0.split_at(end);
    let edges = Recent([[0; 2]; 16], 0);
    let mut corners = Corners { data: Stream(data), next: 0, last: 0, vertices: Recent([0; 16], 0), edges };
    let mut out = Vec::with_capacity(count * stride);
    for &code in codes {
        let triangle = match code {
            0..0xf0 => corners.beside(code)?,
            0xf0..0xfe => {
                let a = corners.new_vertex();
                corners.apart(a, table[usize::from(code & 15)], false)?
            }
            _ => {
                let pair = corners.data.byte()?;
                if pair == 0 {
                    corners.next = 0;
                }
                let a = if code == 0xfe { corners.new_vertex() } else { corners.explicit()? };
                corners.apart(a, pair, true)?
            }
        };
        triangle.iter().for_each(|&v| put(&mut out, stride, v));
    }
    corners.data.end()?;
    Ok(out)
}

fn indices(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    if bytes.first() != Some(&0xd1) {
        return Err(HEADER);
    }
    let end = bytes.len().checked_sub(4).filter(|&end| end >= 1).ok_or(SHORT)?;
    let mut stream = Stream(&bytes[1..end]);
    let mut last = [0u32; 2];
    let mut out = Vec::new();
    for _ in 0..count {
        let v = stream.varint()?;
        let delta = if v & 2 != 0 { !(v >> 2) } else { v >> 2 };
        let last = &mut last[(v & 1) as usize];
        *last = last.wrapping_add(delta);
        put(&mut out, stride, *last);
    }
    stream.end()?;
    Ok(out)
}
