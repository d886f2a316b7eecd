//! Maps as plain bytes, which are those of postcard, but with numbers written and read by the column instead of one by one: a
//! look at a recorded moment waits for several maps.

use bytemuck::{AnyBitPattern, NoUninit};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Illumination, Part};

/// Reads a value.
fn take<T: DeserializeOwned>(bytes: &mut &[u8]) -> Option<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).ok()?;
    *bytes = rest;
    Some(value)
}

/// Reads a list of numbers, or of arrays of them: how many there are, then each as it lies in memory.
fn column<T: AnyBitPattern + NoUninit>(bytes: &mut &[u8]) -> Option<Vec<T>> {
    let count: usize = take(bytes)?;
    let (column, rest) = bytes.split_at_checked(count.checked_mul(size_of::<T>())?)?;
    *bytes = rest;
    Some(bytemuck::pod_collect_to_vec(column))
}

fn part(bytes: &mut &[u8]) -> Option<Option<Part>> {
    let is_there: bool = take(bytes)?;
    Some(if is_there { Some(Part { front: column(bytes)?, back: column(bytes)? }) } else { None })
}

/// Writes a value.
fn put(bytes: &mut Vec<u8>, value: &impl Serialize) -> Option<()> {
    *bytes = postcard::to_extend(value, std::mem::take(bytes)).ok()?;
    Some(())
}

/// Writes what [`column`] reads.
fn put_column<T: NoUninit>(bytes: &mut Vec<u8>, column: &[T]) -> Option<()> {
    put(bytes, &column.len())?;
    bytes.extend_from_slice(bytemuck::cast_slice(column));
    Some(())
}

fn put_part(bytes: &mut Vec<u8>, part: Option<&Part>) -> Option<()> {
    put(bytes, &part.is_some())?;
    if let Some(Part { front, back }) = part {
        put_column(bytes, front)?;
        put_column(bytes, back)?;
    }
    Some(())
}

impl Illumination {
    /// What postcard would write; `None` where that cannot be.
    pub(in crate::illumination) fn to_plain(&self) -> Option<Vec<u8>> {
        if cfg!(target_endian = "big") {
            return postcard::to_stdvec(self).ok();
        }
        let Self { width, height, corners, front, back_blocks, back, named, unfound, summary } = self;
        let mut bytes = Vec::with_capacity(self.bytes());
        put(&mut bytes, &(width, height, corners))?;
        put_column(&mut bytes, front)?;
        put(&mut bytes, back_blocks)?;
        put_column(&mut bytes, back)?;
        put_part(&mut bytes, named.as_ref())?;
        put_part(&mut bytes, unfound.as_ref())?;
        put(&mut bytes, summary)?;
        Some(bytes)
    }

    /// What postcard would read; `None` where that is nothing.
    pub(in crate::illumination) fn from_plain(plain: &[u8]) -> Option<Self> {
        if cfg!(target_endian = "big") {
            return postcard::from_bytes(plain).ok();
        }
        let mut bytes = plain;
        // In the order of the fields.
        let (width, height) = take(&mut bytes)?;
        let corners = take(&mut bytes)?;
        let front = column(&mut bytes)?;
        let back_blocks = take(&mut bytes)?;
        let back = column(&mut bytes)?;
        let (named, unfound) = (part(&mut bytes)?, part(&mut bytes)?);
        let summary = take(&mut bytes)?;
        Some(Self { width, height, corners, front, back_blocks, back, named, unfound, summary })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::illumination::atlas::Corners;
    use glam::Vec2;

    fn map(named: bool) -> Illumination {
        let values = |count: usize| (0..count).map(|i| [i as f32, 0.5, f32::MIN_POSITIVE, 1e30]).collect();
        let part = || Part { front: vec![[1.0, 2.0, 3.0]; 70], back: Vec::new() };
        Illumination {
            width: 300,
            height: 2,
            corners: Arc::new(vec![
                Corners::Vertices([1, 200, 70_000]),
                Corners::Texels([Vec2::new(0.5, 1.5); 3]),
            ]),
            front: values(70),
            back_blocks: vec![0, u32::MAX],
            back: values(64),
            named: named.then(part),
            unfound: (!named).then(part),
            summary: Default::default(),
        }
    }

    #[test]
    fn columns_are_what_postcard_wrote() {
        for named in [false, true] {
            let map = map(named);
            let mut plain = postcard::to_stdvec(&map).expect("bytes");
            assert_eq!(map.to_plain().as_ref(), Some(&plain));
            assert_eq!(Illumination::from_plain(&plain).as_ref(), Some(&map));
            for length in 0..plain.len() {
                assert_eq!(Illumination::from_plain(&plain[..length]), None, "cut at {length}");
            }
            // A length beyond all bytes.
            for at in 0..plain.len() {
                let before = std::mem::replace(&mut plain[at], 0xff);
                let by_column = Illumination::from_plain(&plain).map(|map| postcard::to_stdvec(&map));
                let one_by_one = postcard::from_bytes::<Illumination>(&plain).ok();
                assert_eq!(by_column, one_by_one.map(|map| postcard::to_stdvec(&map)), "byte {at}");
                plain[at] = before;
            }
        }
    }
}
