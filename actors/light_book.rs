//! The maps that an illuminator published, on disk: beside a recording, or in the cache folder where a replay had to make
//! them again. With them a replay does not bake, and a snapshot says which light it shows instead of holding it.
//!
//! A file is a head and pages, one for each map, in the order in which they were published. What is cut short or altered
//! is not there: the light is made again, and the hash that the recording has of each map says whether it is the same.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{Read, Result, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use foveal::illumination::packed;
use foveal::illumination::stored::Illumination;
use xxhash_rust::xxh3::xxh3_64;

/// First bytes of a file; the digit is the version. The key follows.
const MAGIC: &[u8; 8] = b"FVLIGHT1";
/// Bytes that say what a page is.
const HEAD: usize = 8 + 8 + 8 + 1 + 8;
/// Bytes of a page before its map: its head, the hash of all of it, and the hash of these.
const PAGE: usize = HEAD + 32 + 8;
/// Stands for no turn.
const NONE: u64 = u64::MAX;

/// What is known of a turn of the illuminator.
#[derive(Clone, Debug)]
pub enum Known {
    /// It published this map.
    Published {
        /// The map.
        map: Arc<Illumination>,
        /// Whether it was the last.
        last: bool,
    },
    /// It published nothing.
    Silent,
    /// Nothing: whoever wants its map has to bake it.
    Unknown,
}

/// Where a map lies.
#[derive(Debug)]
struct Page {
    turn: u64,
    /// The turn that published the map before.
    before: u64,
    digest: u64,
    last: bool,
    /// BLAKE3 of all of that and of the packed map.
    content: [u8; 32],
    file: Arc<Path>,
    offset: u64,
    length: u64,
}

impl Page {
    /// All but the hash and the map.
    fn head(&self) -> [u8; HEAD] {
        let mut head = [0; HEAD];
        for (at, value) in [self.turn, self.before, self.digest].into_iter().enumerate() {
            head[at * 8..at * 8 + 8].copy_from_slice(&value.to_le_bytes());
        }
        head[24] = u8::from(self.last);
        head[25..].copy_from_slice(&self.length.to_le_bytes());
        head
    }

    fn hash(&self, packed: &[u8]) -> [u8; 32] {
        *blake3::Hasher::new().update(&self.head()).update(packed).finalize().as_bytes()
    }

    /// The packed map, if it is whole.
    fn read(&self) -> Option<Vec<u8>> {
        let mut file = File::open(&self.file).ok()?;
        file.seek(SeekFrom::Start(self.offset)).ok()?;
        // No longer than the file was.
        let mut packed = Vec::with_capacity(self.length as usize);
        file.take(self.length).read_to_end(&mut packed).ok()?;
        (self.hash(&packed) == self.content).then_some(packed)
    }
}

/// Pages that are added to and never taken away, so that who reads needs no lock.
#[derive(Debug, Default)]
struct Pages(OnceLock<Box<(Page, Pages)>>);

impl Pages {
    fn iter(&self) -> impl Iterator<Item = &Page> {
        std::iter::successors(self.0.get(), |page| page.1.0.get()).map(|page| &page.0)
    }

    fn push(&self, page: Page) {
        let mut end = self;
        let mut page = Box::new((page, Pages::default()));
        while let Err(back) = end.0.set(page) {
            page = back;
            let Some((_, next)) = end.0.get().map(|at| &**at) else { return };
            end = next;
        }
    }
}

/// The maps of one bake.
#[derive(Debug)]
pub struct LightBook {
    key: [u8; 32],
    /// Triangles of the scene.
    triangles: usize,
    pages: Pages,
    /// Maps that were delivered before the recording ends, where that is known.
    delivered: Option<u64>,
    /// Plain bytes of the map of turn 0, which the others are packed against, as it was found…
    first: OnceLock<Option<Vec<u8>>>,
    /// …or made here.
    made: OnceLock<Vec<u8>>,
    /// Where maps are kept that are not known yet.
    file: Option<Arc<Path>>,
    /// What is wrong with the files, to be said if it costs time.
    troubles: Vec<String>,
}

impl LightBook {
    /// A book of nothing that is kept in `file`: what was there goes.
    pub fn begin(key: [u8; 32], triangles: usize, file: &Path) -> Self {
        let _ = std::fs::remove_file(file);
        Self::open(key, triangles, &[], Some(file))
    }

    /// The maps in `files`; further ones are kept in `file`, which is read as well.
    pub fn open(key: [u8; 32], triangles: usize, files: &[&Path], file: Option<&Path>) -> Self {
        let mut book = Self {
            key,
            triangles,
            pages: Pages::default(),
            delivered: None,
            first: OnceLock::new(),
            made: OnceLock::new(),
            file: file.map(Arc::from),
            troubles: Vec::new(),
        };
        for path in files {
            if let Err(e) = book.read(path) {
                book.troubles.push(format!("{}: {e}", path.display()));
            }
        }
        if let Some(path) = file {
            // That there is none yet is usual.
            let _ = book.read(path);
        }
        book
    }

    /// Says how many maps were delivered before the recording ends: once they are known, no later turn published one that
    /// anybody saw.
    pub fn with_delivered(self, maps: u64) -> Self {
        Self { delivered: Some(maps), ..self }
    }

    fn read(&self, path: &Path) -> Result<()> {
        let wrong = |what: &str| std::io::Error::new(std::io::ErrorKind::InvalidData, what);
        let mut file = File::open(path)?;
        let (size, path) = (file.metadata()?.len(), Arc::from(path));
        let head = self.head();
        let mut found = vec![0; head.len()];
        file.read_exact(&mut found).map_err(|_| wrong("cut short"))?;
        if found != head {
            return Err(wrong("maps of another light, or of another version of foveal"));
        }
        let mut end = head.len() as u64;
        while end < size {
            let mut head = [0; PAGE];
            file.read_exact(&mut head).map_err(|_| wrong("cut short"))?;
            let word = |at: usize| {
                let mut word = [0; 8];
                word.copy_from_slice(&head[at..at + 8]);
                u64::from_le_bytes(word)
            };
            let (offset, length) = (end + PAGE as u64, word(25));
            if length > size - offset.min(size) {
                return Err(wrong("cut short or damaged"));
            }
            let mut content = [0; 32];
            content.copy_from_slice(&head[HEAD..HEAD + 32]);
            if word(HEAD + 32) != xxh3_64(&head[..HEAD + 32]) {
                return Err(wrong("damaged"));
            }
            let (turn, before, digest, last) = (word(0), word(8), word(16), head[24] == 1);
            self.pages.push(Page {
                turn,
                before,
                digest,
                last,
                content,
                file: Arc::clone(&path),
                offset,
                length,
            });
            end = file.seek(SeekFrom::Start(offset + length))?;
        }
        Ok(())
    }

    fn head(&self) -> Vec<u8> {
        [MAGIC.as_slice(), &self.key].concat()
    }

    /// Why the light has to be baked again, in a line.
    pub fn trouble(&self) -> String {
        match self.troubles.first() {
            Some(trouble) => format!("{trouble}; the light is baked again"),
            None => "the maps of the light were not kept, or not to the end; they are baked again".to_owned(),
        }
    }

    /// What is known of a turn, counted from 0.
    pub fn turn(&self, turn: u64) -> Known {
        let mut is_silent = false;
        for page in self.pages.iter() {
            if page.turn == turn
                && let Some(map) = self.map(page)
            {
                return Known::Published { map: Arc::new(map), last: page.last };
            }
            is_silent |= (page.before == NONE || page.before < turn) && turn < page.turn;
        }
        let is_over = || {
            let turns: BTreeSet<u64> = self.pages.iter().map(|page| page.turn).collect();
            let all_known = self.delivered.is_some_and(|maps| turns.len() as u64 >= maps);
            all_known && turns.last().is_none_or(|last| *last < turn)
        };
        if is_silent || is_over() { Known::Silent } else { Known::Unknown }
    }

    /// Whether a map of this hash is at hand, as far as is known without reading it.
    pub fn has(&self, digest: u64) -> bool {
        self.pages.iter().any(|page| page.digest == digest)
    }

    /// Whether the map of this hash can be read, as far as its bytes are those that were written.
    pub fn is_whole(&self, digest: u64) -> bool {
        self.pages.iter().any(|page| page.digest == digest && page.read().is_some())
    }

    /// The map of this hash.
    pub fn with_digest(&self, digest: u64) -> Option<Illumination> {
        self.pages.iter().filter(|page| page.digest == digest).find_map(|page| self.map(page))
    }

    fn map(&self, page: &Page) -> Option<Illumination> {
        let map = match page.turn {
            0 => packed::map(self.first()?, self.triangles),
            _ => packed::map(&packed::unpack(&page.read()?, self.first()?)?, self.triangles),
        };
        map.filter(|map| map.digest() == page.digest)
    }

    /// Plain bytes of the first map, if it is at hand.
    fn first(&self) -> Option<&[u8]> {
        let plain = |page: &Page| packed::unpack(&page.read()?, &[]);
        let found = || self.pages.iter().filter(|page| page.turn == 0).find_map(plain);
        self.first.get_or_init(found).as_deref().or_else(|| self.made.get().map(Vec::as_slice))
    }

    /// A map that need not be in the book as bytes, and whether they are told against the first one.
    pub fn pack(&self, map: &Illumination) -> Option<(bool, Vec<u8>)> {
        let first = self.first();
        Some((first.is_some(), packed::pack(&packed::plain(map)?, first.unwrap_or_default())))
    }

    /// The map of what [`Self::pack`] gave.
    pub fn unpack(&self, against_first: bool, bytes: &[u8]) -> Option<Illumination> {
        let first = if against_first { self.first()? } else { &[] };
        packed::map(&packed::unpack(bytes, first)?, self.triangles)
    }

    /// Keeps what a turn published; `before` is the turn that published last. Whoever bakes keeps maps in their order.
    ///
    /// # Errors
    /// If it cannot be written; then it is not known later.
    pub fn keep(&self, turn: u64, before: Option<u64>, map: &Illumination, last: bool) -> Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        if matches!(self.turn(turn), Known::Published { .. }) {
            return Ok(());
        }
        let Some(plain) = packed::plain(map) else { return Ok(()) };
        let packed = match (turn, self.first()) {
            (0, _) => packed::pack(&plain, &[]),
            (_, Some(first)) => packed::pack(&plain, first),
            // What the others would be told against could not be kept.
            (_, None) => return Ok(()),
        };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut end = self.pages.iter().filter(|page| page.file == *path).map(|p| p.offset + p.length).max();
        if end.is_none() {
            file.set_len(0)?;
            file.write_all(&self.head())?;
            end = Some(self.head().len() as u64);
        }
        // Behind the last whole page: what was left half written is written over.
        let end = end.unwrap_or_default();
        file.set_len(end)?;
        file.seek(SeekFrom::Start(end))?;
        let (before, digest, length) = (before.unwrap_or(NONE), map.digest(), packed.len() as u64);
        let (file_of, offset) = (Arc::clone(path), end + PAGE as u64);
        let mut page = Page { turn, before, digest, last, content: [0; 32], file: file_of, offset, length };
        page.content = page.hash(&packed);
        let mut head = [page.head().as_slice(), &page.content].concat();
        head.extend_from_slice(&xxh3_64(&head).to_le_bytes());
        file.write_all(&[head, packed].concat())?;
        self.pages.push(page);
        if turn == 0 {
            let _ = self.made.set(plain);
        }
        Ok(())
    }
}
