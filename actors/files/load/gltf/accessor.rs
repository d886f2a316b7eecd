//! Typed arrays in buffers (glTF 2.0 §3.6), every number checked before anything is allocated by it.

use super::buffers::Buffers;
use super::document::{Accessor, Document};
use super::number::Index;
use super::{Problem, get};

/// Elements of one accessor.
const COUNT_MAX: u64 = 1 << 31;

/// Elements that may come from no bytes at all.
const ZEROS_MAX: u64 = 1 << 20;

/// Decoded bytes of all accessors.
const DECODED_MAX: u64 = 4 << 30;

/// Reads accessors, and counts what they decode to.
pub(super) struct Accessors<'b, 'a> {
    pub document: &'a Document,
    pub buffers: &'b mut Buffers<'a>,
    decoded: u64,
}

/// Bytes of a component.
pub(super) fn component_size(kind: u32) -> Option<u64> {
    Some(match kind {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        5125 | 5126 => 4,
        _ => return None,
    })
}

pub(super) fn components(shape: &str) -> Option<usize> {
    Some(match shape {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" | "MAT2" => 4,
        "MAT3" => 9,
        "MAT4" => 16,
        _ => return None,
    })
}

/// A component as a number; normalised integers by the text's formula.
fn component(bytes: &[u8], kind: u32, normalized: bool) -> f32 {
    let scaled = |v: f32, most: f32| if normalized { (v / most).max(-1.0) } else { v };
    match (kind, bytes) {
        (5120, &[a, ..]) => scaled(f32::from(a as i8), 127.0),
        (5121, &[a, ..]) => scaled(f32::from(a), 255.0),
        (5122, &[a, b, ..]) => scaled(f32::from(i16::from_le_bytes([a, b])), 32_767.0),
        (5123, &[a, b, ..]) => scaled(f32::from(u16::from_le_bytes([a, b])), 65_535.0),
        (5125, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]) as f32,
        (5126, &[a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]),
        _ => 0.0,
    }
}

fn whole(bytes: &[u8], kind: u32) -> u32 {
    match (kind, bytes) {
        (5121, &[a, ..]) => u32::from(a),
        (5123, &[a, b, ..]) => u32::from(u16::from_le_bytes([a, b])),
        (5125, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]),
        _ => u32::MAX,
    }
}

/// Bytes of an element, columns of matrices at multiples of four.
fn element_size(component: u64, shape: &str) -> Option<u64> {
    let n = components(shape)? as u64;
    Some(match shape {
        "MAT2" => 2 * (2 * component).next_multiple_of(4),
        "MAT3" => 3 * (3 * component).next_multiple_of(4),
        "MAT4" => 4 * (4 * component).next_multiple_of(4),
        _ => n * component,
    })
}

/// Whether an accessor can hold indices of vertices.
pub(super) fn are_indices(of: &Accessor) -> bool {
    of.shape == "SCALAR" && matches!(of.component_type.0, 5121 | 5123 | 5125)
}

/// Whether accessor `index` lies within the view that it names, as both are declared; nothing is read. What is of no known
/// type, or names a view that is not there, passes.
pub(super) fn check_lengths(document: &Document, index: usize) -> Result<(), Problem> {
    let of = &document.accessors[index];
    let view = of.buffer_view.and_then(|v| document.buffer_views.get(v.at()).map(|view| (v, view)));
    let size = component_size(of.component_type.0).and_then(|c| element_size(c, &of.shape));
    let (Some((number, view)), Some(size)) = (view, size) else { return Ok(()) };
    let stride = view.byte_stride.map_or(size, |s| s.0);
    if stride < size {
        return Err(short_stride(index as u32, number, stride, size));
    }
    fits(of.byte_offset.0, stride, size, of.count.0, view.byte_length.0)
        .map_err(|message| Problem::new(format!("/accessors/{index}"), message))
}

fn short_stride(index: u32, view: Index, stride: u64, size: u64) -> Problem {
    let message = format!("view {} has a byteStride of {stride}, less than the {size} of an element", view.0);
    Problem::new(format!("/accessors/{index}/bufferView"), message)
}

/// Whether `count` elements of `size` bytes every `stride` bytes from `offset` lie within `length` bytes.
fn fits(offset: u64, stride: u64, size: u64, count: u64, length: u64) -> Result<(), String> {
    if count == 0 {
        return Ok(());
    }
    let end = u128::from(offset) + u128::from(stride) * u128::from(count - 1) + u128::from(size);
    if end > u128::from(length) {
        return Err(format!(
            "{count} elements of {size} bytes from byte {offset} leave the view of {length} bytes; export again"
        ));
    }
    Ok(())
}

impl<'b, 'a> Accessors<'b, 'a> {
    pub fn new(document: &'a Document, buffers: &'b mut Buffers<'a>) -> Self {
        Self { document, buffers, decoded: 0 }
    }

    fn accessor(&mut self, index: Index, decoded_size: u64) -> Result<(&'a Accessor, u64, u64), Problem> {
        let accessor = get(&self.document.accessors, index, "accessors")?;
        let problem =
            |key: &str, message: String| Problem::new(format!("/accessors/{}{key}", index.0), message);
        let count = accessor.count.0;
        let kind = accessor.component_type.0;
        let size = component_size(kind).ok_or_else(|| {
            problem("/componentType", format!("is {kind}; it must be 5120 to 5123, 5125 or 5126"))
        })?;
        let n = components(&accessor.shape).ok_or_else(|| {
            problem("/type", format!("is {:?}, which is no type", super::buffers::shortened(&accessor.shape)))
        })?;
        if count > COUNT_MAX {
            return Err(problem("/count", format!("is {count}, more than {COUNT_MAX}; split the mesh")));
        }
        let sparse = accessor.sparse.as_ref().map_or(0, |s| s.count.0);
        if sparse > count {
            return Err(problem("/sparse/count", format!("is {sparse}, more than the count {count}")));
        }
        if accessor.buffer_view.is_none() && count > ZEROS_MAX && !self.is_decoded(index) {
            // Zeros cost a file nothing, so what replaces them has to be there.
            let there = match &accessor.sparse {
                Some(s) => self.buffers.view(s.values.buffer_view)?.0.len() as u64 / (size * n as u64),
                None => 0,
            };
            if there.min(sparse) < count / 64 {
                let message = format!("is {count}, but there are no bytes for it; name a bufferView");
                return Err(problem("/count", message));
            }
        }
        self.decoded = self.decoded.saturating_add(count.saturating_mul(decoded_size));
        if self.decoded > DECODED_MAX {
            let message = format!("makes meshes of more than {DECODED_MAX} bytes; split the file");
            return Err(problem("/count", message));
        }
        Ok((accessor, size * n as u64, size))
    }

    /// Calls `each` with the bytes of every element, and where values are sparse again with those that replace it.
    fn elements(
        &mut self,
        index: Index,
        accessor: &'a Accessor,
        size: u64,
        mut each: impl FnMut(usize, &[u8]),
    ) -> Result<(), Problem> {
        let at = |key: &str| format!("/accessors/{}{key}", index.0);
        let count = accessor.count.0;
        if let Some(bytes) = self.buffers.values(index) {
            return walk(bytes, 0, size, size, count, &mut each)
                .map_err(|message| Problem::new(at(""), message));
        }
        if let Some(view) = accessor.buffer_view {
            let (bytes, stride) = self.buffers.view(view)?;
            let stride = stride.unwrap_or(size);
            if stride < size {
                return Err(short_stride(index.0, view, stride, size));
            }
            walk(bytes, accessor.byte_offset.0, stride, size, count, &mut each)
                .map_err(|message| Problem::new(at(""), message))?;
        }
        let Some(sparse) = &accessor.sparse else { return Ok(()) };
        let kind = sparse.indices.component_type.0;
        let width = component_size(kind).filter(|_| matches!(kind, 5121 | 5123 | 5125)).ok_or_else(|| {
            Problem::new(
                at("/sparse/indices/componentType"),
                format!("is {kind}; it must be 5121, 5123 or 5125"),
            )
        })?;
        let mut places = Vec::new();
        let (bytes, _) = self.buffers.view(sparse.indices.buffer_view)?;
        walk(bytes, sparse.indices.byte_offset.0, width, width, sparse.count.0, &mut |_, b| {
            places.push(whole(b, kind))
        })
        .map_err(|message| Problem::new(at("/sparse/indices"), message))?;
        let rising = places.windows(2).all(|w| w[0] < w[1]);
        if !rising || places.last().is_some_and(|&last| u64::from(last) >= count) {
            let message = format!("do not rise, or reach the count {count}; export again");
            return Err(Problem::new(at("/sparse/indices"), message));
        }
        let (bytes, _) = self.buffers.view(sparse.values.buffer_view)?;
        walk(bytes, sparse.values.byte_offset.0, size, size, sparse.count.0, &mut |i, b| {
            each(places[i] as usize, b)
        })
        .map_err(|message| Problem::new(at("/sparse/values"), message))
    }

    /// Whether an accessor names bytes that the file does not have.
    pub fn is_placeholder(&self, index: Index) -> bool {
        let view = self.document.accessors.get(index.at()).and_then(|a| a.buffer_view);
        view.is_some_and(|view| self.buffers.is_placeholder(view))
    }

    /// Whether its values came from a compressed mesh.
    pub fn is_decoded(&self, index: Index) -> bool {
        self.buffers.values(index).is_some()
    }

    /// How many elements an accessor has, as it says.
    pub fn count(&self, index: Index) -> Result<u64, Problem> {
        Ok(get(&self.document.accessors, index, "accessors")?.count.0)
    }

    /// Vectors of `N` numbers; what has more is cut off, what has fewer is refused.
    pub fn floats<const N: usize>(&mut self, index: Index, of: &str) -> Result<Vec<[f32; N]>, Problem> {
        let (accessor, size, width) = self.accessor(index, 4 * N as u64)?;
        let n = components(&accessor.shape).unwrap_or(0);
        if n < N || accessor.shape.starts_with("MAT") {
            let message = format!("is {}, but {of} are vectors of {N}", accessor.shape);
            return Err(Problem::new(format!("/accessors/{}/type", index.0), message));
        }
        let (kind, normalized) = (accessor.component_type.0, accessor.normalized);
        // Bytes are looked for before room is made.
        let mut values: Vec<[f32; N]> = Vec::new();
        let count = accessor.count.0 as usize;
        if accessor.buffer_view.is_none() {
            values.resize(count, [0.0; N]);
        }
        self.elements(index, accessor, size, |i, bytes| {
            let value = std::array::from_fn(|c| component(&bytes[c * width as usize..], kind, normalized));
            match values.get_mut(i) {
                Some(place) => *place = value,
                None => values.push(value),
            }
        })?;
        Ok(values)
    }

    /// Colours of three or four numbers, in [0, 1].
    pub fn colors(&mut self, index: Index) -> Result<Vec<[f32; 4]>, Problem> {
        let shape = &get(&self.document.accessors, index, "accessors")?.shape;
        let unit = |v: f32| if v.is_nan() { 1.0 } else { v.clamp(0.0, 1.0) };
        if shape == "VEC4" {
            return Ok(self.floats::<4>(index, "colours")?.into_iter().map(|c| c.map(unit)).collect());
        }
        let three = self.floats::<3>(index, "colours")?;
        Ok(three.into_iter().map(|[r, g, b]| [r, g, b, 1.0].map(unit)).collect())
    }

    /// Matrices of floats.
    pub fn matrices(&mut self, index: Index) -> Result<Vec<[f32; 16]>, Problem> {
        let (accessor, size, _) = self.accessor(index, 64)?;
        if accessor.shape != "MAT4" || accessor.component_type.0 != 5126 {
            let message = format!("is {}, but matrices are MAT4 of floats", accessor.shape);
            return Err(Problem::new(format!("/accessors/{}/type", index.0), message));
        }
        let mut values: Vec<[f32; 16]> = Vec::new();
        if accessor.buffer_view.is_none() {
            values.resize(accessor.count.0 as usize, [0.0; 16]);
        }
        self.elements(index, accessor, size, |i, bytes| {
            let value = std::array::from_fn(|c| component(&bytes[4 * c..], 5126, false));
            match values.get_mut(i) {
                Some(place) => *place = value,
                None => values.push(value),
            }
        })?;
        Ok(values)
    }

    /// Indices of vertices.
    pub fn indices(&mut self, index: Index) -> Result<Vec<u32>, Problem> {
        let (accessor, size, _) = self.accessor(index, 4)?;
        let kind = accessor.component_type.0;
        if !are_indices(accessor) {
            let message =
                format!("of type {} and component {kind} are no indices of vertices", accessor.shape);
            return Err(Problem::new(format!("/accessors/{}", index.0), message));
        }
        let mut values: Vec<u32> = Vec::new();
        if accessor.buffer_view.is_none() {
            values.resize(accessor.count.0 as usize, 0);
        }
        self.elements(index, accessor, size, |i, bytes| match values.get_mut(i) {
            Some(place) => *place = whole(bytes, kind),
            None => values.push(whole(bytes, kind)),
        })?;
        Ok(values)
    }
}

/// Elements of `size` bytes every `stride` bytes from `offset`, if all of them lie within `bytes`.
fn walk(
    bytes: &[u8],
    offset: u64,
    stride: u64,
    size: u64,
    count: u64,
    each: &mut impl FnMut(usize, &[u8]),
) -> Result<(), String> {
    fits(offset, stride, size, count, bytes.len() as u64)?;
    let mut at = offset as usize;
    for i in 0..count as usize {
        each(i, &bytes[at..at + size as usize]);
        at += stride as usize;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn components_are_scaled_as_the_text_says() {
        assert_eq!(component(&[0x80], 5120, true), -1.0);
        assert_eq!(component(&[0x81], 5120, true), -1.0);
        assert_eq!(component(&[255], 5121, true), 1.0);
        assert_eq!(component(&[255, 127], 5122, true), 1.0);
        assert_eq!(component(&[255, 255], 5123, false), 65_535.0);
        assert_eq!(component(&1.5f32.to_le_bytes(), 5126, true), 1.5);
    }

    #[test]
    fn no_product_wraps() {
        let none = &mut |_: usize, _: &[u8]| panic!("nothing is there");
        for (offset, stride, size, count) in [
            (u64::MAX, 4, 4, 2),
            (0, u64::MAX, 4, u64::MAX),
            (0, 12, 12, u64::MAX / 12 + 2),
            (8, 4, 4, 1),
            (1, 4, 4, 2),
        ] {
            assert!(walk(&[0; 8], offset, stride, size, count, none).is_err());
        }
        let mut seen = Vec::new();
        walk(&[1, 2, 3, 4, 5, 6], 1, 4, 1, 2, &mut |i, b| seen.push((i, b[0]))).unwrap();
        assert_eq!(seen, [(0, 2), (1, 6)]);
    }
}
