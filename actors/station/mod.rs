//! A station: stands for another machine among the tracers. It keeps the jobs that the machine, its guest, is at, and tells
//! of what comes back what a tracer would tell.
//!
//! Hears: that a guest came or left, and what it found, as external messages. Says: what a tracer says, and how many jobs it
//! can have. What goes to the guest is an effect, which no replay has.
//!
//! A recording holds order, job and duration of what was found, not the colours: a station in replay traces them itself.
//! Nothing of a guest is believed: of each answer some samples, which it cannot know before, are traced here, and of the
//! first answers all.

mod answer;
pub mod bits;
pub mod board;
mod estimate;
mod heard;
mod saved;
mod status;
pub mod wire;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use foveal::allocation::jobs::SampleJob;
use foveal::sampling::Lattice;
use foveal_runtime::{Actor, Address, Content, Cx, JobPool, Kept, Loader, Saver, TimerId, Worker};
use serde::{Deserialize, Serialize};

use crate::message::{
    AllocatorMessage, CacheAgerMessage, RendererMessage, RunWork, SampleOrder, TileWork, TraceJob,
};
use crate::outbox::Outbox;
use answer::{Answer, Likeness, compared_of, differing, kind_of, order_of, traced_here};
use board::Board;
use estimate::Estimate;
pub use heard::{Found, Heard, StationMessage};
pub use status::{Stands, StationCounts, StationStatus};
use wire::{Body, JobSpec, SAMPLES_MAX, ToGuest, ViewSpec};

/// Stations of a walk, at most: with the tracers they share the places of the pool.
pub const STATIONS_MAX: u32 = 16;
/// Jobs that a station keeps, at most.
pub const CREDITS_MAX: u32 = 128;
/// Views that a guest remembers.
pub const VIEWS: usize = 4;
/// Answers of a guest that are checked in full before it is trusted with more jobs than cores.
const PROVING: u32 = 4;
/// One job of so many may be given to others as well.
const SHARED: u64 = 20;
/// One sample of so many is checked, or one answer, unless something else is said.
pub const CHECKED: u32 = 64;
/// Of a guest whose numbers have other bits, one comparison in so many may come to something else, and some beside that: where
/// rounding tips a choice over, a path goes elsewhere.
const DIFFERING: u32 = 20;
const DIFFERING_ANYHOW: u32 = 4;

/// Takes what is for a guest. An effect: nothing comes back but messages.
pub trait Outlet: Send + 'static {
    /// Sends it to the guest of this incarnation, if that still has the place, or loses it: then the jobs in it are overdue
    /// some time. Who came after it must not get it, least of all its ban.
    fn send(&mut self, incarnation: u64, message: ToGuest);
}

/// Makes the outlets of all stations of a walk, by number.
pub type Outlets = Arc<dyn Fn() -> Vec<Box<dyn Outlet>> + Send + Sync>;

/// Where nobody listens: in replay, and at stations of a walk without a door.
pub struct Silent;

impl Outlet for Silent {
    fn send(&mut self, _: u64, _: ToGuest) {}
}

/// A guest, while it is there.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Guest {
    incarnation: u64,
    cores: u16,
    name: String,
    /// Answers that were checked in full and right.
    proved: u32,
    /// A job was overdue, and nothing came since.
    suspect: bool,
    estimate: Estimate,
    /// When it came, and when it answered last, nanoseconds; and samples between.
    came: u64,
    answered: u64,
    samples: u64,
    /// Where its numbers have other bits, what of it was compared, and what of that came to something else: of samples, of
    /// pixels of blocks, of runs.
    other: Option<[[u32; 2]; 3]>,
}

/// A job that the guest has.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Out {
    job: Kept,
    samples: u32,
    /// When it was sent, when others may do it as well, and when it is overdue; nanoseconds.
    sent: u64,
    slow: u64,
    due: u64,
    /// Whether that time has come: others may do it by now, if not too many are shared already.
    shared: bool,
}

impl Out {
    /// When somebody has to look at it.
    fn next(&self) -> u64 {
        if self.shared { self.due } else { self.slow.min(self.due) }
    }
}

/// Whom a station tells.
#[derive(Clone)]
pub(crate) struct Listeners {
    pub renderer: Address<RendererMessage>,
    pub cache_ager: Address<CacheAgerMessage>,
    pub allocator: Address<AllocatorMessage>,
}

/// A station's state.
pub struct Station {
    /// Its number among tracers and stations.
    index: u32,
    lattice: Lattice,
    pool: JobPool<TraceJob>,
    to: Listeners,
    outbox: Outbox<StationMessage>,
    outlet: Box<dyn Outlet>,
    guest: Option<Guest>,
    /// Jobs out, by lease.
    out: BTreeMap<u64, Out>,
    /// Views that the guest knows, the newest last.
    views: VecDeque<u32>,
    /// The timer of the earliest job that is due, and when.
    timer: Option<(u64, TimerId)>,
    /// Jobs that the allocator was told of last.
    credits: u32,
    counts: StationCounts,
    /// One sample of so many is checked.
    checked: u32,
    /// Where it is said how it stands, and under which number.
    board: (Board, usize),
}

impl Station {
    pub(crate) fn new(
        index: u32,
        lattice: Lattice,
        pool: JobPool<TraceJob>,
        to: Listeners,
        outlet: Box<dyn Outlet>,
        (checked, board): (u32, (Board, usize)),
    ) -> Self {
        Self {
            index,
            lattice,
            pool,
            to,
            outbox: Outbox::new(|| StationMessage::SendAgain),
            outlet,
            guest: None,
            out: BTreeMap::new(),
            views: VecDeque::new(),
            timer: None,
            credits: 0,
            counts: StationCounts::default(),
            checked: checked.max(1),
            board,
        }
    }

    /// As people see it.
    pub fn status(&self) -> StationStatus {
        StationStatus {
            guest: self.guest.as_ref().map(|guest| guest.name.clone()),
            other_bits: self.guest.as_ref().is_some_and(|guest| guest.other.is_some()),
            cores: self.guest.as_ref().map_or(0, |guest| guest.cores),
            stands: match &self.guest {
                None => Stands::Vacant,
                Some(guest) if guest.suspect => Stands::Suspect,
                Some(guest) if guest.proved < PROVING => Stands::Proving,
                Some(_) => Stands::Serving,
            },
            rate: self.guest.as_ref().map_or(0.0, |guest| {
                let seconds = guest.answered.saturating_sub(guest.came) as f32 * 1e-9;
                if seconds > 0.0 { guest.samples as f32 / seconds } else { 0.0 }
            }),
            jobs: [self.out.len() as u32, self.window()],
            round_trip: self.guest.as_ref().map_or(0.0, |guest| guest.estimate.round_trip().as_secs_f32()),
            counts: self.counts,
        }
    }

    /// Jobs that it may keep now.
    fn window(&self) -> u32 {
        match &self.guest {
            Some(guest) if guest.suspect => 0,
            Some(guest) if guest.proved < PROVING => u32::from(guest.cores).min(PROVING),
            Some(guest) => guest.estimate.window(guest.cores),
            None => 0,
        }
    }

    /// Does what is for the guest, where there is one.
    fn post(&mut self, message: ToGuest, cx: &Cx<'_, StationMessage>) {
        if let Some(guest) = self.guest.as_ref().filter(|_| !cx.replays()) {
            self.outlet.send(guest.incarnation, message);
        }
    }

    fn on_joined(
        &mut self,
        incarnation: u64,
        (cores, name): (u16, String),
        has_other_bits: bool,
        cx: &mut Cx<'_, StationMessage>,
    ) {
        self.hand_all_back(cx);
        self.views.clear();
        let estimate = Estimate::default();
        let cores = cores.clamp(1, CREDITS_MAX as u16 - 1);
        let came = cx.now().0;
        self.guest = Some(Guest {
            incarnation,
            cores,
            name,
            proved: 0,
            suspect: false,
            estimate,
            came,
            answered: came,
            samples: 0,
            other: has_other_bits.then_some([[0; 2]; 3]),
        });
        self.tell_credits(cx);
    }

    fn on_left(&mut self, incarnation: u64, banned: bool, cx: &mut Cx<'_, StationMessage>) {
        if self.guest.as_ref().is_some_and(|guest| guest.incarnation == incarnation) {
            if banned {
                self.ban(cx);
            }
            self.guest = None;
            self.hand_all_back(cx);
            self.tell_credits(cx);
        }
    }

    fn on_done(&mut self, incarnation: u64, salt: u64, jobs: Vec<Found>, cx: &mut Cx<'_, StationMessage>) {
        if self.guest.as_ref().is_none_or(|guest| guest.incarnation != incarnation) {
            self.counts.late += jobs.len() as u64;
            return;
        }
        let now = cx.now().0;
        for found in jobs {
            // Somebody who was banned over the job before is not heard any more.
            let Some(guest) = &mut self.guest else { return };
            guest.suspect = false;
            let Some(out) = self.out.remove(&found.lease) else {
                self.counts.late += 1;
                continue;
            };
            self.on_found(out, &found, salt, now, cx);
        }
        self.tell_credits(cx);
        self.watch(now, cx);
    }

    fn on_found(&mut self, out: Out, found: &Found, salt: u64, now: u64, cx: &mut Cx<'_, StationMessage>) {
        let Some(job) = cx.kept(&self.pool, out.job) else { return };
        let Some(count) = found.count else {
            // It had not begun, since the view is over.
            if cx.is_stale(&self.pool, out.job) {
                if cx.finish(&self.pool, out.job) {
                    self.came_back(&job, cx);
                }
            } else {
                self.counts.returned += 1;
                cx.hand_back(&self.pool, out.job);
            }
            return;
        };
        let Some(guest) = &mut self.guest else { return };
        let proving = guest.proved < PROVING;
        guest.proved = guest.proved.saturating_add(1);
        guest.estimate.learn(out.samples, found.micros, now.saturating_sub(out.sent));
        (guest.answered, guest.samples) = (now, guest.samples + u64::from(out.samples));
        let other = guest.other;
        let traced = match &found.body {
            Some(body) => Arc::clone(body),
            // Nobody kept it: it is what anybody traces.
            None => match traced_here(&job, &self.lattice) {
                Some(body) => Arc::new(body),
                None => return cx.hand_back(&self.pool, out.job),
            },
        };
        let checked = if proving { count } else { count.div_ceil(self.checked) };
        self.counts.checked += u64::from(count.min(checked));
        let answer = Answer::of(&job, &self.lattice, &traced);
        // What was found then counts, whoever looks at it now.
        let (replays, lattice) = (cx.replays(), &self.lattice);
        let differ = |likeness| match &answer {
            _ if replays => 0,
            Some(_) => differing(&job, lattice, &traced, (checked, salt), likeness),
            None => u32::MAX,
        };
        let right = match other {
            None => cx.observe(u64::from(differ(Likeness::Bits) == 0)) == 1,
            Some(mut others) => {
                let differ = cx.observe(u64::from(differ(Likeness::Near))).min(u64::from(u32::MAX)) as u32;
                let [compared, differed] = &mut others[kind_of(&traced)];
                *compared = compared.saturating_add(compared_of(&job, &traced, (checked, salt)));
                *differed = differed.saturating_add(differ);
                let few = *differed <= *compared / DIFFERING + DIFFERING_ANYHOW;
                if let Some(guest) = &mut self.guest {
                    guest.other = Some(others);
                }
                few
            }
        };
        if !right {
            cx.hand_back(&self.pool, out.job);
            return self.ban(cx);
        }
        let Some(answer) = answer else { return };
        if !cx.finish(&self.pool, out.job) {
            self.counts.late += 1;
            return;
        }
        self.counts.jobs += 1;
        self.counts.samples += u64::from(out.samples);
        match answer {
            Answer::Samples(batch) => {
                let (hash, tracer, batch) = (batch.digest(), self.index, Arc::new(batch));
                // As a tracer: samples before the word that the job is done.
                let traced = RendererMessage::SamplesTraced { batch: batch.clone(), tracer, hash };
                self.outbox.tell(cx, &self.to.renderer, traced);
                let traced = CacheAgerMessage::SamplesTraced { batch, hash };
                self.outbox.tell(cx, &self.to.cache_ager, traced);
            }
            Answer::Guides(guides) => {
                let (hash, guides) = (guides.digest(), Arc::new(guides));
                let traced = RendererMessage::GuidesTraced { guides, hash };
                self.outbox.tell(cx, &self.to.renderer, traced);
            }
            Answer::Block(block) => {
                let TraceJob::Tile(TileWork { drawn, .. }) = &*job else { return };
                let sampled = AllocatorMessage::block_sampled(drawn.view, Some(block));
                return self.outbox.tell(cx, &self.to.allocator, sampled);
            }
            Answer::Run(splats) => {
                let TraceJob::Run(RunWork { drawn, .. }) = &*job else { return };
                let traced = AllocatorMessage::run_traced(drawn.view, Some(splats));
                return self.outbox.tell(cx, &self.to.allocator, traced);
            }
        }
        if let TraceJob::Samples(order) = &*job {
            self.job_done(order, count, found.micros as f32 * 1e-6, cx);
        }
    }

    /// A job was not done, and need not be.
    fn came_back(&mut self, job: &TraceJob, cx: &mut Cx<'_, StationMessage>) {
        match job {
            TraceJob::Samples(order) => self.job_done(order, 0, 0.0, cx),
            TraceJob::Tile(TileWork { drawn, .. }) => {
                self.outbox.tell(cx, &self.to.allocator, AllocatorMessage::block_sampled(drawn.view, None));
            }
            TraceJob::Run(RunWork { drawn, .. }) => {
                self.outbox.tell(cx, &self.to.allocator, AllocatorMessage::run_traced(drawn.view, None));
            }
            // Such a job never travels.
            _ => {}
        }
    }

    fn job_done(&mut self, job: &SampleOrder, samples: u32, seconds: f32, cx: &mut Cx<'_, StationMessage>) {
        let SampleJob { object, level, .. } = job.order;
        let done = AllocatorMessage::JobDone { view: job.drawn.view, object, level, samples, seconds };
        self.outbox.tell(cx, &self.to.allocator, done);
    }

    /// The guest sent what is not in the scene: nothing that came from it stays.
    fn ban(&mut self, cx: &mut Cx<'_, StationMessage>) {
        let Some(guest) = &self.guest else { return };
        tracing::warn!("{}: what it sends is not what is there; it is banned", guest.name);
        self.counts.banned += 1;
        self.post(ToGuest::Refused(wire::Refusal::Banned), cx);
        self.guest = None;
        self.hand_all_back(cx);
        self.outbox.tell(cx, &self.to.cache_ager, CacheAgerMessage::Doubted);
        self.tell_credits(cx);
    }

    fn on_overdue(&mut self, cx: &mut Cx<'_, StationMessage>) {
        self.timer = None;
        let now = cx.now().0;
        let over: Vec<u64> =
            self.out.iter().filter(|(_, out)| out.due <= now).map(|(lease, _)| *lease).collect();
        for out in self.out.values_mut().filter(|out| out.due > now && !out.shared && out.slow <= now) {
            out.shared = true;
            // Few, or on a machine that is busy with other things half of all jobs would be done twice.
            if self.counts.shared * SHARED <= self.counts.jobs + SHARED {
                self.counts.shared += 1;
                cx.share(&self.pool, out.job);
            }
        }
        for lease in &over {
            if let Some(out) = self.out.remove(lease) {
                self.counts.returned += 1;
                cx.hand_back(&self.pool, out.job);
            }
        }
        if let Some(guest) = &mut self.guest
            && !over.is_empty()
        {
            guest.suspect = true;
            guest.estimate.was_late();
            self.tell_credits(cx);
        }
        self.watch(now, cx);
    }

    fn hand_all_back(&mut self, cx: &mut Cx<'_, StationMessage>) {
        for (_, out) in std::mem::take(&mut self.out) {
            self.counts.returned += 1;
            cx.hand_back(&self.pool, out.job);
        }
    }

    /// One timer, for the job that is due first.
    fn watch(&mut self, now: u64, cx: &mut Cx<'_, StationMessage>) {
        let Some(due) = self.out.values().map(Out::next).min() else { return };
        match self.timer {
            Some((at, _)) if at <= due => return,
            Some((_, timer)) => drop(cx.cancel(timer)),
            None => {}
        }
        let wait = Duration::from_nanos(due.saturating_sub(now));
        self.timer = cx.after(wait, StationMessage::Overdue).ok().map(|timer| (due, timer));
    }

    /// The allocator keeps as many jobs more in flight.
    fn tell_credits(&mut self, cx: &mut Cx<'_, StationMessage>) {
        let credits = self.window();
        // Not each step: what changes by less than a quarter changes nothing.
        if credits.abs_diff(self.credits) * 4 <= self.credits && credits > 0 {
            return;
        }
        let station = self.index;
        if credits != self.credits {
            self.credits = credits;
            self.outbox.tell(cx, &self.to.allocator, AllocatorMessage::StationChanged { station, credits });
        }
    }
}

impl Actor for Station {
    type Msg = StationMessage;
    const NAME: &'static str = "station";

    fn handle(&mut self, message: StationMessage, cx: &mut Cx<'_, StationMessage>) {
        match message {
            StationMessage::Heard(Heard::Joined { incarnation, cores, name }) => {
                self.on_joined(incarnation, (cores, name), false, cx);
            }
            StationMessage::Heard(Heard::OtherJoined { incarnation, cores, name }) => {
                self.on_joined(incarnation, (cores, name), true, cx);
            }
            StationMessage::Heard(Heard::Told { incarnation, salt, jobs }) => {
                let whole =
                    |(found, body): (Found, Option<Body>)| Found { body: body.map(Arc::new), ..found };
                self.on_done(incarnation, salt, jobs.into_iter().map(whole).collect(), cx);
            }
            StationMessage::Heard(Heard::Done { incarnation, salt, jobs }) => {
                self.on_done(incarnation, salt, jobs, cx);
            }
            StationMessage::Heard(Heard::Left { incarnation, banned }) => {
                self.on_left(incarnation, banned, cx)
            }
            StationMessage::Overdue => self.on_overdue(cx),
            StationMessage::SendAgain => self.outbox.send(cx),
        }
        if cx.effects() {
            self.board.0.put(self.board.1, self.status());
        }
    }

    fn content(&self) -> Content {
        let status = self.status();
        Content::fields([("status", Content::of(&status)), ("out", Content::of(&self.out.len()))])
    }

    fn save(&self, saver: &mut Saver) {
        self.save_state(saver);
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.restore_state(loader)
    }
}

impl Worker for Station {
    type Job = TraceJob;
    const KEEPS: bool = true;

    fn room(&self) -> bool {
        (self.out.len() as u32) < self.window()
    }

    fn run(&mut self, job: &TraceJob, cx: &mut Cx<'_, StationMessage>) {
        let Some((order, drawn, seed)) = order_of(job) else { return };
        let kept = cx.keep();
        let (view, lease, samples) = (drawn.view.0, kept.number(), order.samples());
        if !self.views.contains(&view) {
            if self.views.back().is_some_and(|last| *last < view) {
                self.post(ToGuest::Retire { below: view }, cx);
            }
            self.views.push_back(view);
            if self.views.len() > VIEWS {
                self.views.pop_front();
            }
            let spec = ViewSpec { view, frame: drawn.frame, cell: drawn.drawn.cell() };
            self.post(ToGuest::View(spec), cx);
        }
        self.post(ToGuest::Jobs(vec![JobSpec { lease, view, order, seed }]), cx);
        let sent = cx.now().0;
        let ahead: u64 = self.out.values().map(|out| u64::from(out.samples)).sum();
        let within = match &self.guest {
            Some(guest) => guest.estimate.within(ahead, samples, guest.cores),
            None => Duration::ZERO,
        };
        let [slow, due] = [within / 2, within].map(|time| sent.saturating_add(time.as_nanos() as u64));
        self.out.insert(lease, Out { job: kept, samples, sent, slow, due, shared: false });
        self.watch(sent, cx);
    }

    fn stale(&mut self, job: &TraceJob, cx: &mut Cx<'_, StationMessage>) {
        self.came_back(job, cx);
    }
}

/// Whether a job can be done elsewhere: samples of a view under the light that the walk began with.
pub(crate) fn travels(job: &TraceJob) -> bool {
    match job {
        TraceJob::Samples(SampleOrder { order, .. }) => order.count <= SAMPLES_MAX,
        TraceJob::Tile(_) | TraceJob::Run(_) => true,
        _ => false,
    }
}
