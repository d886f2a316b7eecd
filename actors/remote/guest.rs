//! The guest's side: says who it is, gets the scene, does what it is given, until the walk ends or it is told to leave.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal::illumination::stored::Illumination;
use foveal::sampling::Lattice;
use foveal::world::World;
use foveal_actors::station::VIEWS;
use foveal_actors::station::wire::{
    Body, DoneJob, FromGuest, Hash, JOBS_MAX, JobSpec, MESSAGE_BYTES_MAX, PIECE_BYTES_MAX, PROTOCOL, Refusal,
    ToGuest, ViewSpec,
};
use foveal_engine::batch::{Piece, Task};
use foveal_engine::failure::Failure;
use foveal_engine::process::memory_bytes;
use foveal_files::bakes::decode;

use crate::ground::{OwnGround, Pass};
use crate::hands::MAP_KEY;
use crate::link::{Gone, GuestLink};
use crate::package::{Arriving, MANIFEST_BYTES_MAX, Manifest, Stock, open};
use crate::program;
use crate::work::{Crew, Finished, VIEW_PIXELS_MAX};

/// How a guest traces.
#[derive(Clone, Debug)]
pub struct Options {
    /// Threads.
    pub cores: u16,
    /// Where scenes are kept.
    pub stock: PathBuf,
    /// Most bytes of one scene.
    pub stock_bytes_max: u64,
    /// Its name, for people.
    pub name: String,
    /// Most memory of this process, bytes: with more it leaves.
    pub memory_max: Option<u64>,
    /// What this machine's numbers are known by ([`probe`](foveal_actors::station::bits::probe)).
    pub bits: u64,
}

/// Why a stay ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// The walk is over.
    Farewell,
    /// The walk does not want it.
    Refused(Refusal),
    /// The link is gone.
    Gone,
    /// Somebody here wants to leave.
    Left,
}

/// What is told while it goes on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Bytes that came, of all that are wanted.
    Stocking {
        /// Bytes.
        got: u64,
        /// Of so many.
        of: u64,
    },
    /// The scene is made ready.
    Building,
    /// It traces.
    Ready,
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Done {
    /// Jobs.
    pub jobs: u64,
    /// Samples and guides.
    pub samples: u64,
    /// Time that all cores took for them.
    pub busy: Duration,
    /// From the first word until jobs could be taken.
    pub joined: Option<Duration>,
}

/// Somebody to ask, and to tell.
pub trait Host {
    /// Whether it is to leave.
    fn leaves(&self) -> bool;
    /// How far it is.
    fn progress(&mut self, progress: Progress);
}

/// Pieces that are asked for ahead.
const PIECES_AHEAD: u64 = 4;
/// For so long a walk may say nothing that was asked for.
const SILENCE: Duration = Duration::from_secs(30);
/// How often somebody looks whether it is to leave.
const LOOK: Duration = Duration::from_millis(20);
/// How often somebody looks how much memory is taken.
const MEMORY_LOOK: Duration = Duration::from_millis(500);
/// Answers that go together, if they come within so long.
const BUNDLE: usize = 8;
const BUNDLE_TIME: Duration = Duration::from_millis(5);
/// Bytes of colours in one message, about.
const BUNDLE_BYTES: usize = 512 << 10;

/// Most bytes of the light of a task.
const MAP_BYTES_MAX: u64 = 1 << 30;
/// Most bytes of what a piece comes to, so that a message has room for it.
const FOUND_BYTES_MAX: usize = MESSAGE_BYTES_MAX - 64;
/// Passes whose photons are kept.
const PASSES: usize = 4;

/// What pieces of work are done with.
#[derive(Default)]
struct Bench {
    ground: Option<Arc<OwnGround>>,
    /// Photons of passes, by ground and pass.
    passes: VecDeque<((u32, u64), Pass)>,
}

impl Bench {
    /// Has a piece done; false where it makes no sense.
    fn take(&mut self, crew: &mut Crew, lease: u64, number: u32, piece: &[u8]) -> bool {
        let Some(ground) = self.ground.as_ref().filter(|ground| ground.number == number) else {
            return false;
        };
        let piece = postcard::from_bytes::<Piece>(piece).ok().filter(|piece| ground.has(piece));
        let Some(piece) = piece else { return false };
        let Piece::Bidirectional { pass, .. } = &piece else {
            crew.take_piece(lease, ground, Pass::default(), piece);
            return true;
        };
        let name = (number, *pass);
        if self.passes.iter().all(|(known, _)| *known != name) {
            self.passes.push_back((name, Pass::default()));
            if self.passes.len() > PASSES {
                self.passes.pop_front();
            }
        }
        let pass = self.passes.iter().find(|(known, _)| *known == name).map(|(_, pass)| Arc::clone(pass));
        crew.take_piece(lease, ground, pass.unwrap_or_default(), piece);
        true
    }
}

enum Broken {
    Ended(End),
    Failed(Failure),
}

impl From<Gone> for Broken {
    fn from(_: Gone) -> Self {
        Self::Ended(End::Gone)
    }
}

/// Traces for the walk at the other end of `link`.
///
/// # Errors
/// If what the walk sends makes no sense, or cannot be kept here.
pub fn stay(
    link: &mut dyn GuestLink,
    options: &Options,
    host: &mut dyn Host,
    done: &mut Done,
) -> Result<End, Failure> {
    match (Stay { link, options, host, done, held: None }).run() {
        Ok(end) | Err(Broken::Ended(end)) => Ok(end),
        Err(Broken::Failed(failure)) => Err(failure),
    }
}

/// What is too long for a message, beside what is bundled with it and how all of it is told, is somebody else's.
fn fitting(job: DoneJob) -> DoneJob {
    let found = job.found.filter(|found| found.size_bytes() <= MESSAGE_BYTES_MAX - 2 * BUNDLE_BYTES);
    DoneJob { found, ..job }
}

struct Stay<'a> {
    link: &'a mut dyn GuestLink,
    options: &'a Options,
    host: &'a mut dyn Host,
    done: &'a mut Done,
    /// Since when there are answers that have not been sent.
    held: Option<Instant>,
}

fn senseless(what: &str) -> Broken {
    Broken::Failed(Failure::Input(format!("the walk sent what makes no sense: {what}")))
}

fn failed(what: String) -> Broken {
    Broken::Failed(Failure::Environment(what))
}

impl Stay<'_> {
    fn say(&mut self, message: &FromGuest) -> Result<(), Broken> {
        Ok(self.link.send(&message.to_bytes())?)
    }

    /// The next message, if one comes within `wait`.
    fn hear(&mut self, wait: Duration) -> Result<Option<ToGuest>, Broken> {
        if self.host.leaves() {
            let _ = self.link.send(&FromGuest::Leaving.to_bytes());
            return Err(Broken::Ended(End::Left));
        }
        let Some(bytes) = self.link.next(wait)? else { return Ok(None) };
        match ToGuest::of_bytes(&bytes) {
            Some(ToGuest::Refused(refusal)) => Err(Broken::Ended(End::Refused(refusal))),
            Some(ToGuest::Farewell) => Err(Broken::Ended(End::Farewell)),
            Some(message) => Ok(Some(message)),
            None => Err(senseless("no message")),
        }
    }

    /// The next message, which was asked for.
    fn answer(&mut self) -> Result<ToGuest, Broken> {
        let began = Instant::now();
        while began.elapsed() < SILENCE {
            if let Some(message) = self.hear(LOOK)? {
                return Ok(message);
            }
        }
        Err(Broken::Ended(End::Gone))
    }

    fn run(&mut self) -> Result<End, Broken> {
        let began = Instant::now();
        let Options { cores, stock, name, memory_max: memory, bits, .. } = self.options.clone();
        let stock = Stock::new(stock).map_err(Broken::Failed)?;
        let program = program();
        self.say(&FromGuest::Hello { protocol: PROTOCOL, program, bits, cores, name, memory })?;
        let ToGuest::Welcome { incarnation, package, bytes, k_max } = self.answer()? else {
            return Err(senseless("no welcome"));
        };
        let manifest = self.stocked(&stock, package, bytes)?;
        self.host.progress(Progress::Building);
        let (scene, light) = stock.lay_out(&manifest, &package).map_err(failed)?;
        let world = open(&manifest, &scene, light.as_deref(), stock.folder()).map_err(Broken::Failed)?;
        let mut crew = Crew::new(world.clone(), k_max, cores, self.link.waker()).map_err(failed)?;
        self.say(&FromGuest::Ready { incarnation })?;
        self.done.joined.get_or_insert(began.elapsed());
        self.host.progress(Progress::Ready);
        let mut views: VecDeque<Arc<ViewSpec>> = VecDeque::new();
        let (mut bench, mut looked) = (Bench::default(), Instant::now());
        self.fits()?;
        loop {
            if looked.elapsed() > MEMORY_LOOK {
                self.fits()?;
                looked = Instant::now();
            }
            match self.hear(self.held.map_or(LOOK, |since| BUNDLE_TIME.saturating_sub(since.elapsed())))? {
                Some(ToGuest::View(view)) => {
                    let [width, height] = view.frame.size.map(u64::from);
                    if width * height > VIEW_PIXELS_MAX {
                        return Err(failed(format!(
                            "the walk's picture of {width} × {height} is too large for here"
                        )));
                    }
                    views.push_back(Arc::new(view));
                    if views.len() > VIEWS {
                        views.pop_front();
                    }
                }
                Some(ToGuest::Jobs(jobs)) => self.take(&mut crew, (&views, k_max), incarnation, jobs)?,
                Some(ToGuest::Retire { below }) => crew.retire(below),
                Some(ToGuest::Ground { number, task, map }) => {
                    bench.ground =
                        Some(Arc::new(self.ground(number, &task, map, &world, bench.ground.as_deref())?));
                    self.say(&FromGuest::Grounded { incarnation, number })?;
                }
                Some(ToGuest::Work { lease, ground, piece }) => {
                    if crew.waiting() > JOBS_MAX || !bench.take(&mut crew, lease, ground, &piece) {
                        return Err(senseless("a piece of work that is none, or too many"));
                    }
                }
                // More of a blob than was needed.
                Some(ToGuest::Piece { .. }) | None => {}
                Some(_) => return Err(senseless("a second welcome")),
            }
            self.tell(&crew, incarnation)?;
        }
    }

    fn take(
        &mut self,
        crew: &mut Crew,
        (views, k_max): (&VecDeque<Arc<ViewSpec>>, u32),
        incarnation: u64,
        jobs: Vec<JobSpec>,
    ) -> Result<(), Broken> {
        let mut unknown = Vec::new();
        for job in jobs {
            let Some(view) = views.iter().rev().find(|view| view.view == job.view) else {
                // Of a view that is not remembered.
                unknown.push(DoneJob { lease: job.lease, micros: 0, found: None });
                continue;
            };
            let size = view.frame.size;
            let lattice = Lattice::new(k_max, size.map(|side| side as i32 / 2));
            if !job.fits(&lattice, size) || crew.waiting() > JOBS_MAX {
                return Err(senseless("a job outside of its picture, or too many"));
            }
            crew.take(view, job);
        }
        if unknown.is_empty() { Ok(()) } else { self.say(&FromGuest::Done { incarnation, jobs: unknown }) }
    }

    /// Leaves, if this process has more memory than it may have.
    fn fits(&mut self) -> Result<(), Broken> {
        match (self.options.memory_max, memory_bytes()) {
            (Some(most), Some(bytes)) if bytes > most => {
                let _ = self.link.send(&FromGuest::Leaving.to_bytes());
                let why =
                    format!("{bytes} bytes of memory are taken, more than the {most} allowed (--memory)");
                Err(Broken::Failed(Failure::Limit(why)))
            }
            _ => Ok(()),
        }
    }

    /// What pieces of work are done with from now on.
    fn ground(
        &mut self,
        number: u32,
        task: &[u8],
        map: Option<(Hash, u64)>,
        world: &World,
        before: Option<&OwnGround>,
    ) -> Result<OwnGround, Broken> {
        let task: Task = postcard::from_bytes(task).map_err(|_| senseless("a task that is none"))?;
        let map = match map {
            None => None,
            Some((hash, bytes)) => {
                let blob = self.fetch_whole(hash, bytes)?;
                let map: Illumination = decode(&MAP_KEY, &blob).map_err(|e| senseless(&e.to_string()))?;
                Some(map)
            }
        };
        OwnGround::new(number, world, task, map, before).map_err(|e| senseless(&e))
    }

    /// Says what is done, in as few messages as may be: each costs the walk as much as dozens of samples. While there is more
    /// to do, answers wait for each other a little.
    fn tell(&mut self, crew: &Crew, incarnation: u64) -> Result<(), Broken> {
        let finished = crew.finished();
        if finished == 0 {
            return Ok(());
        }
        let since = *self.held.get_or_insert_with(Instant::now);
        if crew.waiting() > 0 && finished < BUNDLE && since.elapsed() < BUNDLE_TIME {
            return Ok(());
        }
        self.held = None;
        loop {
            let (mut jobs, mut bytes) = (Vec::new(), 0);
            while jobs.len() < JOBS_MAX && bytes < BUNDLE_BYTES {
                let job = match crew.done() {
                    None => break,
                    Some(Finished::Samples(job)) => fitting(job),
                    Some(Finished::Piece { lease, micros, found }) => {
                        self.done.jobs += u64::from(found.is_some());
                        self.done.busy += Duration::from_micros(u64::from(micros));
                        let found =
                            found.and_then(|found| postcard::to_stdvec(&found).ok()).unwrap_or_default();
                        // What is too long for a message is somebody else's.
                        let found = if found.len() <= FOUND_BYTES_MAX { found } else { Vec::new() };
                        let waiting = crew.waiting() as u32;
                        self.say(&FromGuest::Worked { incarnation, lease, micros, waiting, found })?;
                        continue;
                    }
                };
                bytes += job.found.as_ref().map_or(0, Body::size_bytes);
                self.done.jobs += u64::from(job.found.is_some());
                self.done.samples += job.found.as_ref().map_or(0, |found| u64::from(found.samples()));
                self.done.busy += Duration::from_micros(u64::from(job.micros));
                jobs.push(job);
            }
            if jobs.is_empty() {
                return Ok(());
            }
            self.say(&FromGuest::Done { incarnation, jobs })?;
        }
    }

    /// Gets what is not here yet of a package.
    fn stocked(&mut self, stock: &Stock, package: Hash, bytes: u64) -> Result<Manifest, Broken> {
        if bytes > MANIFEST_BYTES_MAX {
            return Err(senseless("a list of files that is too long"));
        }
        let mut got = 0;
        if !stock.has(&package, bytes) {
            self.fetch(stock, package, bytes, &mut got, bytes)?;
        }
        let list = stock.read(&package, MANIFEST_BYTES_MAX);
        let manifest = list.as_deref().and_then(Manifest::of_bytes);
        let manifest = manifest.ok_or_else(|| senseless("a list of files that is none"))?;
        let wanted: Vec<_> = manifest.blobs().filter(|(hash, bytes)| !stock.has(hash, *bytes)).collect();
        let of = wanted.iter().map(|(_, bytes)| *bytes).fold(0_u64, u64::saturating_add);
        if of > self.options.stock_bytes_max {
            let most = self.options.stock_bytes_max;
            return Err(failed(format!(
                "the scene has {of} bytes, more than the {most} that are kept here (--cache-size)"
            )));
        }
        let mut got = 0;
        for (hash, bytes) in wanted {
            if !stock.has(&hash, bytes) {
                self.fetch(stock, hash, bytes, &mut got, of)?;
            }
        }
        Ok(manifest)
    }

    /// Gets a blob that is not kept.
    fn fetch_whole(&mut self, hash: Hash, bytes: u64) -> Result<Vec<u8>, Broken> {
        if bytes > MAP_BYTES_MAX {
            return Err(failed(format!("the light has {bytes} bytes, too many for here")));
        }
        let (mut blob, mut asked) = (Vec::new(), 0);
        while (blob.len() as u64) < bytes {
            while asked < bytes && asked < blob.len() as u64 + PIECES_AHEAD * PIECE_BYTES_MAX as u64 {
                self.say(&FromGuest::Want { hash, at: asked })?;
                asked += PIECE_BYTES_MAX as u64;
            }
            match self.answer()? {
                ToGuest::Piece { hash: of, at, bytes: piece }
                    if of == hash && at == blob.len() as u64 && !piece.is_empty() =>
                {
                    blob.extend_from_slice(&piece);
                }
                _ => return Err(senseless("something else than a piece that was asked for")),
            }
        }
        let is_whole = blob.len() as u64 == bytes && blake3::hash(&blob) == blake3::Hash::from(hash);
        if is_whole { Ok(blob) } else { Err(senseless("a blob that is not what its hash says")) }
    }

    fn fetch(&mut self, stock: &Stock, hash: Hash, bytes: u64, got: &mut u64, of: u64) -> Result<(), Broken> {
        let mut arriving: Arriving = stock.begin(hash, bytes).map_err(failed)?;
        let mut asked = 0;
        while let Some((hash, at)) = arriving.wants() {
            while asked < bytes && asked < at + PIECES_AHEAD * PIECE_BYTES_MAX as u64 {
                self.say(&FromGuest::Want { hash, at: asked })?;
                asked += PIECE_BYTES_MAX as u64;
            }
            let ToGuest::Piece { hash, at, bytes: piece } = self.answer()? else {
                return Err(senseless("something else than a piece that was asked for"));
            };
            arriving.take(&hash, at, &piece).map_err(|e| senseless(&e))?;
            *got += piece.len() as u64;
            self.host.progress(Progress::Stocking { got: *got, of });
        }
        arriving.keep().map_err(|e| senseless(&e))
    }
}
