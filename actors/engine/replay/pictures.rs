//! Which tiles of the shown picture became others, delivery by delivery: so that a search for when a pixel changed draws only
//! those parts of a recording again in which its tile did.

use std::sync::Arc;

use foveal::image::Map2d;

use super::course::{length, read_length};

/// Pixels along an edge of a tile.
const TILE: usize = 32;

/// Notes which tiles change.
#[derive(Default)]
pub(super) struct Pictures {
    last: Option<Arc<Map2d<[u8; 3]>>>,
    /// Bytes for the tiles of a picture; 0 before any was seen.
    stride: usize,
    /// The delivery of the last entry, and one more.
    next: u64,
    entries: Vec<u8>,
}

impl Pictures {
    /// What is shown before a delivery is made.
    pub(super) fn stands(&mut self, index: u64, shown: &Arc<Map2d<[u8; 3]>>) {
        let last = self.last.replace(Arc::clone(shown));
        if last.as_ref().is_some_and(|last| Arc::ptr_eq(last, shown)) {
            return;
        }
        self.stride = tiles(shown.width(), shown.height()).div_ceil(8);
        let mut changed = vec![0_u8; self.stride];
        let columns = shown.width().div_ceil(TILE);
        for y in 0..shown.height() {
            let now = row(shown, y).chunks(TILE);
            let before = last.as_ref().filter(|last| last.height() > y).map(|last| row(last, y));
            for (column, now) in now.enumerate() {
                let is_same =
                    before.and_then(|row| row.get(column * TILE..column * TILE + now.len())) == Some(now);
                let tile = y / TILE * columns + column;
                changed[tile / 8] |= u8::from(!is_same) << (tile % 8);
            }
        }
        if changed.iter().any(|tiles| *tiles != 0) {
            // The delivery before this one made it so.
            self.entry(index.saturating_sub(1), &changed);
        }
    }

    /// Any tile may have changed in a delivery.
    pub(super) fn is_unknown(&mut self, index: u64) {
        let all = vec![u8::MAX; self.stride];
        self.entry(index, &all);
    }

    fn entry(&mut self, index: u64, changed: &[u8]) {
        // Two of one delivery: each tells what it knows.
        length(&mut self.entries, (index + 1).saturating_sub(self.next));
        self.next = index + 1;
        length(&mut self.entries, changed.len() as u64);
        self.entries.extend_from_slice(changed);
    }

    /// What was noted since the last call.
    pub(super) fn take(&mut self) -> Vec<u8> {
        self.next = 0;
        std::mem::take(&mut self.entries)
    }
}

fn row(picture: &Map2d<[u8; 3]>, y: usize) -> &[[u8; 3]] {
    &picture.data()[y * picture.width()..(y + 1) * picture.width()]
}

fn tiles(width: usize, height: usize) -> usize {
    width.div_ceil(TILE) * height.div_ceil(TILE)
}

/// The tile of a pixel in a picture of so many columns.
pub(super) fn tile_of(x: u32, y: u32, width: u32) -> usize {
    y as usize / TILE * (width as usize).div_ceil(TILE) + x as usize / TILE
}

/// The deliveries in which a tile may have changed, of what [`Pictures::take`] gave; `None` where that is damaged.
pub(super) fn changes(mut entries: &[u8], tile: usize) -> Option<Vec<u64>> {
    let (mut found, mut next) = (Vec::new(), 0_u64);
    while !entries.is_empty() {
        next = next.checked_add(read_length(&mut entries)?)?;
        let count = read_length(&mut entries)? as usize;
        let (changed, rest) = entries.split_at_checked(count)?;
        entries = rest;
        // Where nothing was shown yet nothing is known of tiles.
        if changed.is_empty() || changed.get(tile / 8)? >> (tile % 8) & 1 == 1 {
            let index = next.checked_sub(1)?;
            found.extend((found.last() != Some(&index)).then_some(index));
        }
    }
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_that_change_are_told_by_their_delivery() {
        let picture = |at: &[(usize, usize)]| {
            let mut picture = Map2d::new(70, 40, [1_u8; 3]);
            at.iter().for_each(|(x, y)| picture.data_mut()[y * 70 + x] = [2; 3]);
            Arc::new(picture)
        };
        let pictures = [picture(&[]), picture(&[(69, 39)]), picture(&[(69, 39), (0, 31)]), picture(&[])];
        let mut notes = Pictures::default();
        notes.is_unknown(0);
        for (index, picture) in [3, 4, 9, 20, 300].into_iter().zip([0, 0, 1, 2, 3]) {
            notes.stands(index, &pictures[picture]);
        }
        notes.is_unknown(400);
        let entries = notes.take();
        let at = |x, y| changes(&entries, tile_of(x, y, 70)).expect("whole");
        assert_eq!(at(69, 39), [0, 2, 8, 299, 400]);
        assert_eq!(at(5, 5), [0, 2, 19, 299, 400]);
        assert_eq!(at(40, 0), [0, 2, 400], "another tile");
        for cut in 1..entries.len() {
            // Whole entries or nothing.
            let found = changes(&entries[..cut], 0);
            assert!(found.is_none_or(|found| found.len() < 5));
        }
        // The same once more.
        notes.stands(401, &pictures[0]);
        assert!(notes.take().is_empty());
    }
}
