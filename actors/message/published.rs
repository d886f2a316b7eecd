//! Light that the illuminator has published, on its way to where it is shown.

use std::sync::{Arc, OnceLock};

use foveal::illumination::stored::Illumination;
use foveal_runtime::{Content, Loader, Saver};

use super::saved::{Saved, SnapshotContext, Told};
use crate::light_book::LightBook;

/// A map of the light: at hand, or, in a replay that began at a snapshot, read when it is first asked for. Most looks at a
/// moment end before the light moves on.
#[derive(Debug)]
pub struct PublishedLight {
    digest: u64,
    bytes: usize,
    map: OnceLock<Arc<Illumination>>,
    book: Option<Arc<LightBook>>,
}

impl PublishedLight {
    /// A map that is at hand.
    pub fn new(map: Arc<Illumination>) -> Self {
        Self { digest: map.digest(), bytes: map.bytes(), map: OnceLock::from(map), book: None }
    }

    /// The hash of its values.
    pub fn digest(&self) -> u64 {
        self.digest
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// The map. `None` where it was to be read and its file is another one by now: then the replay comes to other pictures,
    /// and parts.
    pub fn map(&self) -> Option<&Arc<Illumination>> {
        if self.map.get().is_none() {
            let _ = self.map.set(Arc::new(self.book.as_ref()?.with_digest(self.digest)?));
        }
        self.map.get()
    }
}

impl Told for Arc<PublishedLight> {
    fn content(&self) -> Content {
        self.map().map_or(Content::Untold, Told::content)
    }
}

impl Saved for Arc<PublishedLight> {
    fn save(&self, saver: &mut Saver) {
        let book = saver.context::<SnapshotContext>().and_then(|context| context.book.clone());
        saver.shared(self, |light, saver| {
            let is_in_book = book.is_some_and(|book| book.has(light.digest));
            saver.put(&(light.digest, light.bytes as u64, is_in_book));
            match light.map() {
                _ if is_in_book => {}
                Some(map) => map.save(saver),
                None => saver.refuse(),
            }
        });
    }

    /// What is to be read later must be there now.
    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let (digest, bytes, is_in_book): (u64, u64, bool) = loader.take()?;
            let bytes = usize::try_from(bytes).ok()?;
            if !is_in_book {
                let map = OnceLock::from(Arc::<Illumination>::restore(loader)?);
                return Some(PublishedLight { digest, bytes, map, book: None });
            }
            let book = loader.context::<SnapshotContext>()?.book.clone();
            let is_whole = book.as_ref().is_some_and(|book| book.is_whole(digest));
            is_whole.then_some(PublishedLight { digest, bytes, map: OnceLock::new(), book })
        })
    }
}
