//! A recording with the world it was made in: systems that replay it are built from here.

use std::cell::{Ref, RefCell, RefMut};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal::scene::Camera;
use foveal::world::World;
use foveal_actors::light_book::LightBook;
use foveal_actors::message::RendererInput;
use foveal_actors::renderer::{MARK_FRAME, Unseen};
use foveal_actors::stages::StageTimes;
use foveal_actors::wiring::{Actors, wire};
use foveal_runtime::{
    ActorId, Config, Content, Delivery, Event, Exit, Hashing, Limit, Mode, Observer, Runtime, Snapshot,
    Trace, Until,
};

use serde_json::{Value, json};

use super::counters::counted;
use super::history::History;
use super::index::{Index, Kept};
use super::indexing::Indexing;
use super::plain;
use crate::bake_clock::Watch;
use crate::failure::Failure;
use crate::interrupt::interrupted;
use crate::opened::Opened;
use crate::recording::{Elsewhere, Parent, RecordedRun, light_beside, light_key, program};

/// A delivery that was looked at.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Who received.
    pub actor: ActorId,
    /// Its number.
    pub index: u64,
    /// Who sent.
    pub from: ActorId,
    /// The message's variant.
    pub kind: &'static str,
    /// The delivery it was sent in.
    pub cause: Option<(ActorId, u64)>,
    /// The receiver's chained hash.
    pub chain: u64,
    /// What it said, where that was asked for.
    pub told: Option<String>,
}

/// How what messages say is to be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Telling {
    /// Not at all.
    Nothing,
    /// As a line to read.
    Text,
    /// As JSON.
    Json,
}

impl Telling {
    /// A value in that form.
    pub fn of(self, content: &Content) -> Option<String> {
        match self {
            Self::Nothing => None,
            Self::Text => Some(content.to_string()),
            Self::Json => serde_json::to_string(content).ok(),
        }
    }
}

impl Seen {
    /// What an observer is shown.
    pub fn of(d: &Delivery<'_>, telling: Telling) -> Self {
        let told = if telling == Telling::Nothing { None } else { telling.of(&(d.told)()) };
        let Delivery { actor, index, from, kind, cause, chain, .. } = *d;
        Self { actor, index, from, kind, cause, chain, told }
    }
}

/// How one replay is to run.
#[derive(Clone, Default)]
pub struct How {
    /// Threads beside the main one.
    pub threads: usize,
    /// Where to stop.
    pub until: Option<Until>,
    /// Where to begin, if not at the start.
    pub from: Option<Arc<Snapshot>>,
    /// Begin at the last snapshot before `until`.
    pub jump: bool,
    /// With `jump`: so many frames earlier.
    pub frames_before: usize,
    /// Sees every delivery.
    pub observer: Option<Observer>,
    /// What is said in this delivery is wanted.
    pub listen_to: Option<(ActorId, u64)>,
    /// Deliveries of a turn; `None` for the runtime's own choice.
    pub turn: Option<u64>,
    /// Turns kept of each actor.
    pub ring_turns: Option<usize>,
}

/// A frame as it began.
#[derive(Clone, Copy, Debug)]
pub struct Begun {
    /// The renderer's delivery.
    pub index: u64,
    /// Its number.
    pub frame: u32,
    /// Where the camera was.
    pub camera: Camera,
    /// How long it was meant to take, seconds.
    pub time: f32,
}

/// A recording and its world: what replays on several threads are made of.
pub struct Ground {
    /// The recording.
    pub trace: Arc<Trace>,
    /// Its file.
    pub path: PathBuf,
    /// What it says of the run.
    pub recorded: RecordedRun,
    /// The delivery of the renderer in which each frame was shown.
    pub shown_in: Vec<u64>,
    opened: Opened,
}

/// A recording, its world, and the snapshots that are kept of it.
pub struct Source {
    ground: Ground,
    index: RefCell<Index>,
    history: RefCell<History>,
    ahead: RefCell<Option<Ahead>>,
}

/// A snapshot that was read before anybody asked for it.
struct Ahead {
    /// For a replay to this delivery.
    place: (ActorId, u64),
    /// Whether that is its last one.
    is_there: bool,
    snapshot: Snapshot,
}

impl Ahead {
    fn read(index: &Index, place: Until) -> Option<Self> {
        let Until::Delivery { actor, index: at } = place else { return None };
        let there = index.right_after(actor, at);
        let is_there = there.is_some();
        let snapshot = there.or_else(|| index.before(actor, at))?;
        Some(Self { place: (actor, at), is_there, snapshot })
    }
}

impl Deref for Source {
    type Target = Ground;

    fn deref(&self) -> &Ground {
        &self.ground
    }
}

impl Ground {
    /// The scene it was recorded in, as it began.
    pub fn opened(&self) -> &Opened {
        &self.opened
    }

    /// Its world.
    pub fn world(&self) -> &World {
        &self.opened.world
    }

    /// All deliveries of the recording, by actor.
    pub fn deliveries(&self) -> Vec<u64> {
        let nodes = 0..self.trace.header().nodes.len() as u32;
        nodes.map(|number| self.trace.deliveries(ActorId(number))).collect()
    }

    /// Where each frame began, as the recording says.
    pub fn frames_begun(&self) -> impl Iterator<Item = Begun> {
        self.trace.events(renderer(&self.trace)).filter_map(|event| {
            let Event::Delivered { index, external: Some(bytes), .. } = event else { return None };
            match postcard::from_bytes(&bytes).ok()? {
                RendererInput::FrameBegan { frame, camera, time } => {
                    Some(Begun { index, frame: frame.0, camera, time })
                }
                _ => None,
            }
        })
    }

    /// A system that replays it.
    pub fn system(&self, how: How) -> Result<(Runtime, Actors), Failure> {
        let live = Config::live(how.threads);
        let mut config = Config {
            mode: Mode::Replay { trace: Arc::clone(&self.trace), until: how.until },
            observer: how.observer,
            listen_to: how.listen_to,
            from: how.from,
            program: program(),
            ring_turns: how.ring_turns.unwrap_or(live.ring_turns),
            ..live
        };
        if let Some(messages) = how.turn {
            config.budget.messages = messages;
        }
        let (machine, stages) = (self.recorded.machine(), StageTimes::default());
        let parts = machine.parts(&self.opened, None, None, stages, Box::new(Unseen));
        Runtime::build(config, |w| wire(w, parts))
            .map_err(|e| Failure::Input(format!("{}: {e}", self.path.display())))
    }
}

impl Source {
    /// Reads a recording and makes its world again.
    pub fn open(
        path: &Path,
        elsewhere: &Elsewhere,
        verify: bool,
        watch: &dyn Watch,
    ) -> Result<Self, Failure> {
        Self::open_at(path, elsewhere, verify, None, watch)
    }

    /// The same for whoever looks at a place first, as [`Source::place`] reads it: what is kept of it is read while the world
    /// is made.
    pub fn open_at(
        path: &Path,
        elsewhere: &Elsewhere,
        verify: bool,
        place: Option<&str>,
        watch: &dyn Watch,
    ) -> Result<Self, Failure> {
        // What a recording says of itself is enough to make its world, while the rest of it is read.
        let header = Trace::header_of(path).ok();
        let early = header.as_ref().and_then(|header| RecordedRun::in_header(header, path).ok());
        let early = early.filter(|recorded| recorded.parent.is_none());
        let read = || {
            let trace = plain::open(path, elsewhere.cache.as_deref()).map(Arc::new)?;
            let (shown_in, index) = (shown_in(&trace), Index::open(path, elsewhere.cache.as_deref()));
            // What is no place is said when it is gone to.
            let place = place.and_then(|text| place_in(&trace, &shown_in, text).ok());
            let ahead = place.and_then(|place| Ahead::read(&index, place));
            Ok::<_, Failure>((trace, shown_in, index, ahead))
        };
        let (read, world) = rayon::join(read, || early.map(|recorded| recorded.open(path, elsewhere, watch)));
        let (trace, shown_in, index, ahead) = read?;
        let recorded = RecordedRun::of(&trace, path)?;
        if verify && trace.header().hashing == Hashing::Off {
            return Err(Failure::Input(format!(
                "{}: recorded without hashes; it cannot be verified",
                path.display()
            )));
        }
        let mut opened = match &recorded.parent {
            None => world.unwrap_or_else(|| recorded.open(path, elsewhere, watch))?,
            Some(parent) => Self::left(parent, path, &recorded, elsewhere, watch)?,
        };
        if let Some(refinement) = &mut opened.refinement {
            let (beside, triangles) = (light_beside(path), refinement.world.scene.mesh.triangles.len());
            let beside: &[&Path] = if beside.exists() { &[&beside] } else { &[] };
            let book = LightBook::open(
                light_key(&refinement.world.scene, &refinement.settings, &recorded.illumination_hash),
                triangles,
                beside,
                index.light(),
            );
            let delivered =
                trace.find("illuminator").map_or(0, |from| trace.deliveries_from(renderer(&trace), from));
            refinement.book = Some(Arc::new(book.with_delivered(delivered)));
        }
        let history = RefCell::new(History::beside(index.file.as_ref()));
        let index = RefCell::new(index);
        let ground = Ground { trace, path: path.to_owned(), recorded, shown_in, opened };
        Ok(Self { ground, index, history, ahead: RefCell::new(ahead) })
    }

    /// The world in which a walk left another recording: its light may have been on its way from one map to the next, which
    /// nobody else can make.
    fn left(
        parent: &Parent,
        path: &Path,
        recorded: &RecordedRun,
        elsewhere: &Elsewhere,
        watch: &dyn Watch,
    ) -> Result<Opened, Failure> {
        let file = match parent.find(path) {
            Ok(file) => file,
            // Where the light was final the scene says all.
            Err(e) => return recorded.open(path, elsewhere, watch).map_err(|_| e),
        };
        let before = Self::open(&file, elsewhere, false, watch)?;
        let until = Some(before.frame_shown(parent.frame)?);
        let (runtime, actors) = before.run(How { until, jump: true, ..How::default() }, |_| ())?;
        let world = runtime.inspect(actors.renderer, |r| r.world().clone());
        let world = world.filter(|world| recorded.began_in(&*world.illumination)).ok_or_else(|| {
            let (child, parent) = (path.display(), parent.recording.display());
            Failure::Check(format!("{child}: {parent} does not come to the light in which it began"))
        })?;
        let (light, as_read) = (before.opened.light.clone(), before.opened.as_read.clone());
        Ok(Opened { path: before.opened.path.clone(), light, as_read, ..Opened::of_world(world) })
    }

    /// Replays to where it is to stop, and leaves snapshots for others on the way. `look` is called now and then.
    pub fn run(&self, mut how: How, mut look: impl FnMut(&Runtime)) -> Result<(Runtime, Actors), Failure> {
        let mut index = self.index.borrow_mut();
        if let (true, Some(Until::Delivery { actor, index: at })) = (how.jump, how.until) {
            let (actor, at) = match how.frames_before {
                0 => (actor, at),
                // Frames are counted by the renderer.
                frames => {
                    let shown = self.shown_in.partition_point(|shown| *shown < at);
                    (self.renderer(), shown.checked_sub(frames).map_or(0, |frame| self.shown_in[frame]))
                }
            };
            let ahead = self.ahead.take().filter(|ahead| ahead.place == (actor, at));
            let (there, before) = match ahead {
                Some(Ahead { is_there: true, snapshot, .. }) => (Some(snapshot), None),
                Some(Ahead { snapshot, .. }) => (None, Some(snapshot)),
                None => (None, None),
            };
            // Where one looked before.
            let only_there = how.frames_before == 0 && how.observer.is_none() && how.listen_to.is_none();
            let right_after = || there.or_else(|| index.right_after(actor, at).filter(|_| before.is_none()));
            if let Some(from) = only_there.then(right_after).flatten() {
                let there = How { from: Some(Arc::new(from)), ..how.clone() };
                if let Ok((runtime, actors)) = self.system(there) {
                    look(&runtime);
                    return Ok((runtime, actors));
                }
            }
            how.from = before.or_else(|| index.before(actor, at)).map(Arc::new);
        }
        let (jumped, stops) = (how.from.is_some(), how.until.is_some());
        let again = How { from: None, jump: false, ..how.clone() };
        let (mut runtime, actors) = match self.system(how) {
            // What was kept cannot be used after all.
            Err(_) if jumped => self.system(again.clone())?,
            built => built?,
        };
        index.begin();
        loop {
            let exit = runtime.pump_until(Limit::IDLE, |runtime| {
                look(runtime);
                interrupted() || index.is_due()
            });
            if interrupted() {
                return Err(Failure::Interrupted("interrupted while replaying".into()));
            }
            match exit {
                Exit::Until => index.keep(|| counted(&self.trace, &runtime)),
                _ => break,
            }
        }
        if stops && index.is_worth() && !runtime.diverged() {
            index.keep(|| counted(&self.trace, &runtime));
        }
        look(&runtime);
        if jumped && runtime.diverged() {
            // A snapshot may be at fault: only a replay from the start can tell.
            drop((index, runtime, actors));
            return self.run(again, look);
        }
        Ok((runtime, actors))
    }

    /// A replay that leaves snapshots, and what actors are told and know, as far as there are none yet.
    pub fn indexing(&self) -> Indexing {
        Indexing::new(!self.index.borrow().is_kept())
    }

    /// The last snapshot that is kept before a delivery and has nothing behind it that `cut` does not.
    pub fn kept(&self, actor: ActorId, index: u64, cut: &[u64]) -> Option<Arc<Snapshot>> {
        self.index.borrow().before(actor, index).filter(|s| s.is_before(cut)).map(Arc::new)
    }

    /// Keeps a snapshot.
    #[cfg(test)]
    pub(super) fn keep(&self, runtime: &Runtime) {
        self.index.borrow_mut().keep(|| counted(&self.trace, runtime));
    }

    /// The snapshots that are kept, where there is a folder for them.
    pub fn snapshots(&self) -> Option<Kept> {
        self.index.borrow().kept()
    }

    /// What had been delivered at each snapshot that is kept, from the first on.
    pub fn places(&self) -> Vec<Vec<u64>> {
        self.index.borrow().places()
    }

    /// The snapshots that are kept, to read.
    pub(super) fn index(&self) -> Ref<'_, Index> {
        self.index.borrow()
    }

    /// The same, to keep more.
    pub(super) fn index_to_keep(&self) -> RefMut<'_, Index> {
        self.index.borrow_mut()
    }

    /// What is kept of what actors were told and knew.
    pub(super) fn history(&self) -> RefMut<'_, History> {
        self.history.borrow_mut()
    }

    /// Whether it is known of all of the recording what actors were told and knew.
    pub(super) fn is_told(&self) -> bool {
        let mut history = self.history();
        (0..).zip(self.deliveries()).all(|(actor, made)| made == 0 || history.known_to(ActorId(actor)) > made)
    }

    /// The renderer's number.
    pub fn renderer(&self) -> ActorId {
        renderer(&self.trace)
    }

    /// Where `frame` was shown.
    pub fn frame_shown(&self, frame: u32) -> Result<Until, Failure> {
        frame_in(&self.trace, &self.shown_in, frame)
    }

    /// `FRAME` or `ACTOR:INDEX`, the actor by name or number.
    pub fn place(&self, text: &str) -> Result<Until, Failure> {
        place_in(&self.trace, &self.shown_in, text)
    }

    /// An actor by name or number.
    pub fn actor(&self, name: &str) -> Result<ActorId, Failure> {
        actor_in(&self.trace, name)
    }

    /// An actor's or port's name.
    pub fn name(&self, id: ActorId) -> &str {
        name(&self.trace, id)
    }

    /// A delivery's place, as it can be given to `--until`.
    pub fn at(&self, (actor, index): (ActorId, u64)) -> String {
        format!("{}:{index}", self.name(actor))
    }

    /// A delivery as JSON, with what it said as JSON, too.
    pub fn document(&self, s: &Seen) -> Value {
        let told = s.told.as_deref().and_then(|told| serde_json::from_str::<Value>(told).ok());
        json!({
            "at": self.at((s.actor, s.index)),
            "message": s.kind,
            "from": self.name(s.from),
            "sent_in": s.cause.map(|cause| self.at(cause)),
            "hash": format!("{:016x}", s.chain),
            "says": told,
        })
    }

    /// A delivery in one line.
    pub fn line(&self, s: &Seen) -> String {
        let from = match s.cause {
            Some(cause) => self.at(cause),
            None if s.from == s.actor => "itself".to_owned(),
            None => self.name(s.from).to_owned(),
        };
        format!("{:<16} {:<16} from {from:<16} {:016x}", self.at((s.actor, s.index)), s.kind, s.chain)
    }
}

/// Where a frame was shown.
fn frame_in(trace: &Trace, shown_in: &[u64], frame: u32) -> Result<Until, Failure> {
    let index = shown_in.get(frame as usize).copied().ok_or_else(|| {
        let frames = shown_in.len();
        Failure::Usage(format!("no frame {frame}; the recording shows {frames}, counted from 0"))
    })?;
    Ok(Until::Delivery { actor: renderer(trace), index })
}

/// `FRAME` or `ACTOR:INDEX`, the actor by name or number.
fn place_in(trace: &Trace, shown_in: &[u64], text: &str) -> Result<Until, Failure> {
    if let Ok(frame) = text.parse::<u32>() {
        return frame_in(trace, shown_in, frame);
    }
    let wrong = || Failure::Usage(format!("{text}: a frame number, or an actor and an index as renderer:12"));
    let (name, index) = text.rsplit_once(':').ok_or_else(wrong)?;
    let actor = actor_in(trace, name)?;
    let index: u64 = index.parse().map_err(|_| wrong())?;
    match trace.deliveries(actor) {
        deliveries if index < deliveries => Ok(Until::Delivery { actor, index }),
        deliveries => {
            Err(Failure::Usage(format!("no {text}; {deliveries} deliveries to it are recorded, from 0")))
        }
    }
}

/// An actor by name or number.
fn actor_in(trace: &Trace, name: &str) -> Result<ActorId, Failure> {
    let nodes = &trace.header().nodes;
    let by_number = || {
        let number = name.strip_prefix('#').unwrap_or(name).parse::<u32>().ok()?;
        ((number as usize) < nodes.len()).then_some(ActorId(number))
    };
    trace.find(name).or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = nodes.iter().filter(|n| n.class.is_some()).map(|n| n.name.as_str()).collect();
        Failure::Usage(format!("no actor \"{name}\"; the recording has {}", names.join(", ")))
    })
}

/// An actor's or port's name.
pub fn name(trace: &Trace, id: ActorId) -> &str {
    trace.header().nodes.get(id.0 as usize).map_or("?", |node| node.name.as_str())
}

fn renderer(trace: &Trace) -> ActorId {
    trace.find("renderer").unwrap_or(ActorId(0))
}

/// The delivery of the renderer in which each frame was shown.
fn shown_in(trace: &Trace) -> Vec<u64> {
    let frames = trace.marks(renderer(trace)).filter(|(_, kind, _)| *kind == MARK_FRAME);
    frames.map(|(index, ..)| index.saturating_sub(1)).collect()
}

/// An observer that puts every delivery for which `wanted` holds into a queue, with what it says.
pub fn observe(
    seen: &Arc<SegQueue<Seen>>,
    telling: Telling,
    wanted: impl Fn(&Delivery<'_>) -> bool + Send + Sync + 'static,
) -> Observer {
    let seen = Arc::clone(seen);
    Arc::new(move |d: &Delivery<'_>| {
        if wanted(d) {
            seen.push(Seen::of(d, telling));
        }
    })
}
