//! Light of a snapshot, read when it is first asked for: most looks at a moment end before anything is drawn in it.

use std::sync::{Arc, OnceLock};

use foveal::illumination::stored::Illumination;
use foveal::illumination::{Irradiance, Unnamed};
use foveal_runtime::{Loader, Saver};
use glam::Vec3;

use super::saved::{Saved, SnapshotContext};
use crate::light_book::LightBook;

/// Where a map is found again.
#[derive(Clone, Copy, Debug, serde::Serialize, serde::Deserialize)]
enum Place {
    /// In the book, by this hash.
    Published(u64),
    /// In the snapshot: against the book's first map, or by itself.
    Held { against_first: bool },
}

/// A map that is read when it is first asked for.
#[derive(Debug)]
pub struct LaterLight {
    place: Place,
    held: Vec<u8>,
    book: Arc<LightBook>,
    map: OnceLock<Option<Arc<Illumination>>>,
}

impl LaterLight {
    /// The map. `None` where it cannot be read after all: then all is dark, the replay comes to other pictures, and parts.
    pub fn map(&self) -> Option<&Arc<Illumination>> {
        let read = || match self.place {
            Place::Published(digest) => self.book.with_digest(digest),
            Place::Held { against_first } => self.book.unpack(against_first, &self.held),
        };
        self.map.get_or_init(|| read().map(Arc::new)).as_ref()
    }
}

impl Irradiance for LaterLight {
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        self.map().map_or(Vec3::ZERO, |map| map.irradiance(triangle, b1, b2, back))
    }

    fn unnamed(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Unnamed {
        match self.map() {
            Some(map) => map.unnamed(triangle, b1, b2, back),
            None => Unnamed { rest: Vec3::ZERO, named: None },
        }
    }

    fn unfound(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        self.map().map_or(Vec3::ZERO, |map| map.unfound(triangle, b1, b2, back))
    }

    fn stored(&self) -> Option<&Illumination> {
        self.map().map(|map| &**map)
    }
}

impl Saved for Arc<LaterLight> {
    fn save(&self, saver: &mut Saver) {
        match self.map() {
            Some(map) => map.save(saver),
            None => saver.refuse(),
        }
    }

    /// What is to be read later must be there now.
    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let book = loader.context::<SnapshotContext>()?.book.clone()?;
            let place = loader.take()?;
            let held = match place {
                Place::Published(digest) => book.is_whole(digest).then(Vec::new)?,
                Place::Held { .. } => loader.bytes()?.to_vec(),
            };
            Some(LaterLight { place, held, book, map: OnceLock::new() })
        })
    }
}

impl Saved for Arc<Illumination> {
    fn save(&self, saver: &mut Saver) {
        let book = saver.context::<SnapshotContext>().and_then(|context| context.book.clone());
        saver.shared(self, |map, saver| {
            let digest = map.digest();
            let Some(book) = book else { return saver.refuse() };
            if book.has(digest) {
                return saver.put(&Place::Published(digest));
            }
            let Some((against_first, bytes)) = book.pack(map) else { return saver.refuse() };
            saver.put(&Place::Held { against_first });
            saver.bytes(&bytes);
        });
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Arc::<LaterLight>::restore(loader)?.map().cloned()
    }
}
