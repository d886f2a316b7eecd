//! Long lists as bytes: written one after the other as they lie in memory, and read back straight to where they stay, by several
//! threads at once.
//!
//! Each list has a checksum for each piece of it, so that whoever reads a piece looks at it while it is in its cache; the sum of all
//! is one over these.

use std::borrow::Cow;

use bytemuck::Pod;
use rayon::prelude::*;
use xxhash_rust::xxh3::{Xxh3, xxh3_128};

/// Bytes that lists begin at multiples of.
const ALIGNED: usize = 16;
/// Bytes that are read and summed at once.
const PIECE: usize = 1 << 20;

/// Lists one after the other, each from a whole 16 bytes on: where they lie already, since they may be most of what is in memory.
#[derive(Debug, Default)]
pub struct Bulk<'a> {
    lists: Vec<Cow<'a, [u8]>>,
    sums: Sums,
}

/// Checksums of pieces, as they were read or written.
#[derive(Debug, Default)]
struct Sums(Vec<u128>);

impl Sums {
    fn of_all(&self) -> [u8; 16] {
        let mut hasher = Xxh3::new();
        self.0.iter().for_each(|sum| hasher.update(&sum.to_le_bytes()));
        hasher.digest128().to_le_bytes()
    }
}

impl<'a> Bulk<'a> {
    /// Adds a list.
    pub fn put<T: Pod>(&mut self, list: &'a [T]) {
        self.add(Cow::Borrowed(bytemuck::cast_slice(list)));
    }

    /// Adds a list that nobody else has.
    pub fn put_made<T: Pod>(&mut self, list: &[T]) {
        self.add(Cow::Owned(bytemuck::cast_slice(list).to_vec()));
    }

    fn add(&mut self, list: Cow<'a, [u8]>) {
        self.sums.0.extend(list.chunks(PIECE).map(xxh3_128));
        self.lists.push(list);
    }

    /// The bytes of all lists, in turn.
    pub fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        self.lists.iter().flat_map(|list| {
            let padding = list.len().next_multiple_of(ALIGNED) - list.len();
            [&list[..], &[0; ALIGNED][..padding]]
        })
    }

    /// How many they are.
    pub fn len_bytes(&self) -> usize {
        self.pieces().map(<[u8]>::len).sum()
    }

    /// The checksum of all lists.
    pub fn sum(&self) -> [u8; 16] {
        self.sums.of_all()
    }
}

/// Where bytes are read from, by several threads at once: memory, or what stays as it is while it is read.
pub trait ReadAt: Sync {
    /// Reads all that `into` takes, from byte `at` on. False where there is not as much.
    fn read_at(&self, at: u64, into: &mut [u8]) -> bool;
}

impl ReadAt for &[u8] {
    fn read_at(&self, at: u64, into: &mut [u8]) -> bool {
        let from = usize::try_from(at).ok().and_then(|at| self.get(at..at.checked_add(into.len())?));
        from.inspect(|from| into.copy_from_slice(from)).is_some()
    }
}

/// Takes lists out again.
pub struct BulkReader<'a> {
    source: &'a dyn ReadAt,
    /// Where the next list begins, and where the last one ends.
    at: u64,
    end: u64,
    sums: Sums,
}

impl<'a> BulkReader<'a> {
    /// From the first on; they lie in these bytes of a source.
    pub fn new(source: &'a dyn ReadAt, within: std::ops::Range<u64>) -> Self {
        Self { source, at: within.start, end: within.end, sums: Sums::default() }
    }

    /// The next list, which has `count` elements; `None` where that is more than there is.
    pub fn take<T: Pod + Send>(&mut self, count: usize) -> Option<Vec<T>> {
        let length = count.checked_mul(size_of::<T>())?;
        let padded = length.checked_next_multiple_of(ALIGNED)?;
        let next = self.at.checked_add(padded as u64).filter(|next| *next <= self.end)?;
        let mut list: Vec<T> = bytemuck::zeroed_vec(count);
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut list);
        let (source, at) = (self.source, self.at);
        let read = |(i, piece): (usize, &mut [u8])| {
            source.read_at(at + (i * PIECE) as u64, piece).then(|| xxh3_128(piece))
        };
        let sums: Option<Vec<u128>> = bytes.par_chunks_mut(PIECE).enumerate().map(read).collect();
        self.sums.0.extend(sums?);
        let mut rest = [0; ALIGNED];
        let rest = &mut rest[..padded - length];
        if !source.read_at(at + length as u64, rest) || rest.iter().any(|byte| *byte != 0) {
            return None;
        }
        self.at = next;
        Some(list)
    }

    /// The checksum of all lists; `None` where some were not taken.
    pub fn sum(self) -> Option<[u8; 16]> {
        (self.at == self.end).then(|| self.sums.of_all())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_come_back() {
        let long: Vec<u32> = (0..700_000).collect();
        let mut bulk = Bulk::default();
        bulk.put(&[1u8, 2, 3]);
        bulk.put(&long);
        bulk.put::<[f32; 3]>(&[]);
        bulk.put_made(&[[0.5f32; 3]]);
        let mut behind = vec![9; 5];
        behind.extend(bulk.pieces().flatten());
        let within = 5..5 + bulk.len_bytes() as u64;
        assert_eq!(within.end, behind.len() as u64);
        let source = behind.as_slice();
        let mut reader = BulkReader::new(&source, within.clone());
        assert_eq!(reader.take::<u8>(3), Some(vec![1, 2, 3]));
        assert_eq!(reader.take::<u32>(long.len()).as_ref(), Some(&long));
        assert_eq!(reader.take::<[f32; 3]>(0), Some(Vec::new()));
        assert_eq!(reader.take::<u32>(usize::MAX), None);
        assert_eq!(reader.take::<u32>(1 << 40), None, "more than there is takes no memory");
        assert_eq!(reader.take::<[f32; 3]>(1), Some(vec![[0.5; 3]]));
        assert_eq!(reader.sum(), Some(bulk.sum()));
        assert_eq!(BulkReader::new(&source, within.clone()).sum(), None, "not all was taken");
        let source = &behind[..100];
        let mut cut = BulkReader::new(&source, within);
        assert_eq!(cut.take::<u8>(3), Some(vec![1, 2, 3]));
        assert_eq!(cut.take::<u32>(long.len()), None);
    }
}
