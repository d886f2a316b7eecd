//! What an actor is, and the only doors it has to the world.

pub(crate) mod node;
pub(crate) mod reserve;
pub(crate) mod seat;
pub(crate) mod supervise;

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use crate::actor::seat::Lease;
use crate::journal::Journal;
use crate::journal::divergence::{Held, Said};
use crate::journal::env::Env;
use crate::log::format::{lane, quantise, unquantise, value};
use crate::mailbox::{Address, Envelope, Inbound};
use crate::message::content::Content;
use crate::message::incident::guarded;
use crate::message::saved::{Loader, Saver};
use crate::message::{ActorId, LATEST_KEYS, Lane, Message, Reason, Rejected};
use crate::scheduler::ThreadCx;
use crate::scheduler::clock::{Time, nanoseconds};
use crate::scheduler::link::{Class, Control};
use crate::scheduler::signals::signal;
use crate::scheduler::timer::{Alarm, TIMERS_PER_ACTOR};

/// A state machine that owns its state and changes it only by the messages it is given, in order.
///
/// [`Actor::handle`] must be a function of the state, the message, and what `cx` returns. It must not read a clock,
/// draw from a thread's random state, iterate over a randomly seeded map or touch anything shared that changes:
/// replay reports such an actor at the first message where it shows.
pub trait Actor: Send + 'static {
    /// Everything this actor can be told.
    type Msg: Message;
    /// Name in reports.
    const NAME: &'static str;
    /// How it is scheduled.
    const CLASS: Class = Class::Light;

    /// Called once, before the first message.
    fn started(&mut self, _cx: &mut Cx<'_, Self::Msg>) {}

    /// Takes one message.
    fn handle(&mut self, message: Self::Msg, cx: &mut Cx<'_, Self::Msg>);

    /// Called once when the actor stops.
    fn stopped(&mut self) {}

    /// A hash of the state, taken after each delivery where hashes are not sparse: with it, replay names the message that
    /// changed a state wrongly rather than the first message that tells of it. `None` costs nothing.
    fn digest(&self) -> Option<u64> {
        None
    }

    /// The state, for whoever looks at a replay: what decides what it does next. Asked between messages.
    fn content(&self) -> Content {
        Content::Untold
    }

    /// Writes the state for a snapshot of a replay. Whoever does not say how has no snapshots.
    fn save(&self, saver: &mut Saver) {
        saver.refuse();
    }

    /// Puts a new actor into the state that was saved; `None` if it is not one.
    fn restore(&mut self, _loader: &mut Loader<'_>) -> Option<()> {
        None
    }
}

/// Names an actor of a running system, to look at its state.
pub struct Handle<A> {
    pub(crate) id: ActorId,
    kind: PhantomData<fn(A)>,
}

impl<A> Clone for Handle<A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A> Copy for Handle<A> {}

impl<A> Handle<A> {
    pub(crate) fn new(id: ActorId) -> Self {
        Self { id, kind: PhantomData }
    }

    /// The actor's identity.
    pub fn id(self) -> ActorId {
        self.id
    }
}

/// Names a timer of one actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TimerId(u32);

/// Names a question of one actor: it goes with the question and comes back with the answer. See [`Cx::ask`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Ticket(u32);

/// A timer that runs.
pub(crate) struct OwnTimer<M> {
    /// What it will deliver; `None` once cancelled: it still fires.
    pub(crate) message: Option<M>,
    /// Deliveries to the actor before it was started, the one at hand included.
    pub(crate) started_in: u64,
}

/// The timers an actor has running, with the messages they will deliver.
pub(crate) struct OwnTimers<M> {
    pub(crate) next: u32,
    pub(crate) running: BTreeMap<u32, OwnTimer<M>>,
}

impl<M> OwnTimers<M> {
    pub(crate) fn new() -> Self {
        Self { next: 0, running: BTreeMap::new() }
    }

    /// Takes a timer that has fired; `None` says that no such timer runs.
    pub(crate) fn take(&mut self, timer: u32) -> Option<OwnTimer<M>> {
        self.running.remove(&timer)
    }

    pub(crate) fn contains(&self, timer: u32) -> bool {
        self.running.contains_key(&timer)
    }
}

/// An actor's way to the world during a turn: everything that comes through here is recorded, or regenerated.
pub struct Cx<'a, M: Message> {
    pub(crate) address: &'a Address<M>,
    pub(crate) journal: &'a mut Journal,
    pub(crate) timers: &'a mut OwnTimers<M>,
    pub(crate) thread: &'a ThreadCx,
    pub(crate) env: &'a Arc<Env>,
    pub(crate) stop: &'a mut bool,
    pub(crate) lease: Option<&'a dyn Lease>,
}

impl<M: Message> Cx<'_, M> {
    /// Tells another actor (or this one). A message that is not accepted comes back; that it did is recorded, so
    /// replay takes the same branch.
    #[inline(always)]
    pub fn tell<N: Message>(&mut self, to: &Address<N>, message: N) -> Result<(), Rejected<N>> {
        post(self.journal, self.thread, to, message)
    }

    /// This actor's own address.
    pub fn address(&self) -> &Address<M> {
        self.address
    }

    /// The time, to a microsecond. Recorded.
    pub fn now(&mut self) -> Time {
        if let Some(replayed) = self.journal.replayed_value(value::NOW) {
            return Time(replayed);
        }
        let now = self.env.scheduler.clock.now() / 1000 * 1000;
        self.journal.record_now(now);
        Time(now)
    }

    /// Lets a duration that was measured outside the runtime's view (a stage's own time, say) into the actor's state:
    /// returns it rounded to 8 significant bits, or during replay the one that was recorded.
    pub fn measured(&mut self, duration: Duration) -> Duration {
        if let Some(code) = self.journal.replayed_value(value::MEASURED) {
            return Duration::from_nanos(unquantise(code));
        }
        let (rounded, code) = quantise(nanoseconds(duration));
        self.journal.record_measured(code);
        Duration::from_nanos(rounded)
    }

    /// Lets a count that is a fact of the moment (who still holds something, say) into the actor's state: returns it,
    /// or during replay the one that was recorded.
    pub fn observe(&mut self, count: u64) -> u64 {
        if let Some(replayed) = self.journal.replayed_value(value::COUNT) {
            return replayed;
        }
        self.journal.record_count(count);
        count
    }

    /// Runs `work` and measures it as [`Cx::measured`] does. In a simulation it takes what [`crate::simulate::Work`]
    /// says.
    pub fn measure<R>(&mut self, work: impl FnOnce() -> R) -> (R, Duration) {
        let (result, elapsed) = self.env.scheduler.clock.measure(work);
        (result, self.measured(Duration::from_nanos(elapsed)))
    }

    /// Puts a milestone into the recording, for example kind 0 with the hash of each shown frame. Replay compares it.
    pub fn mark(&mut self, kind: u32, value: u64) {
        self.journal.mark(kind, value);
    }

    /// Delivers `message` to this actor after `delay`: never before, and as much later as its next turn comes. A pinned
    /// actor waits for the main thread alone, any other for a thread that is not in a turn: on one thread, for a heavy
    /// turn that is under way there. It comes back if [`TIMERS_PER_ACTOR`] timers run already.
    pub fn after(&mut self, delay: Duration, message: M) -> Result<TimerId, Rejected<M>> {
        if self.timers.running.len() >= TIMERS_PER_ACTOR {
            return Err(Rejected { message, reason: Reason::Full });
        }
        let timer = self.timers.next;
        self.timers.next = timer.wrapping_add(1);
        let started_in = self.journal.index;
        self.timers.running.insert(timer, OwnTimer { message: Some(message), started_in });
        if !self.journal.replaying() {
            let deadline = self.env.scheduler.clock.now().saturating_add(nanoseconds(delay));
            let target: Arc<dyn Alarm> = Arc::clone(&self.address.mailbox) as Arc<dyn Alarm>;
            self.env.scheduler.timer_started();
            if self.env.scheduler.timers.start(deadline, timer, target) {
                self.env.scheduler.notify();
            }
        }
        Ok(TimerId(timer))
    }

    /// Takes a running timer back, with its message. `None` if it was delivered or cancelled before.
    pub fn cancel(&mut self, timer: TimerId) -> Option<M> {
        self.timers.running.get_mut(&timer.0)?.message.take()
    }

    /// Tells `to` a question that is to be answered within `time`. `question` puts the ticket into it (and this actor's
    /// address, if the receiver does not know it); the receiver tells the answer with the same ticket, and the asker
    /// asks [`Cx::answered`] whether it still counts. If there is none in time, this actor is delivered `late(ticket)`.
    ///
    /// The question comes back if it is not accepted, or if [`TIMERS_PER_ACTOR`] timers and questions are open already.
    /// Nobody waits meanwhile: answers are messages among others, recorded and replayed as they are.
    pub fn ask<N: Message>(
        &mut self,
        to: &Address<N>,
        time: Duration,
        question: impl FnOnce(Ticket) -> N,
        late: impl FnOnce(Ticket) -> M,
    ) -> Result<Ticket, Rejected<N>> {
        let ticket = Ticket(self.timers.next);
        let message = question(ticket);
        let Ok(timer) = self.after(time, late(ticket)) else {
            return Err(Rejected { message, reason: Reason::Full });
        };
        self.tell(to, message).map(|()| ticket).inspect_err(|_| drop(self.cancel(timer)))
    }

    /// Takes a question back, whose answer has come. False if it was answered before, or is late.
    pub fn answered(&mut self, ticket: Ticket) -> bool {
        self.cancel(TimerId(ticket.0)).is_some()
    }

    /// Orders another actor to stop, pause or resume. Needs no room, cannot fail.
    pub fn control<N: Message>(&mut self, to: &Address<N>, control: Control) {
        if !self.journal.replaying() {
            to.mailbox.link.control(control, self.thread);
        }
    }

    /// Takes the job at hand for this worker's own: what it tells from now on, nobody else will. False where the
    /// [lease](crate::Wiring::leases) was over before and another worker has the job: then this one tells nothing.
    ///
    /// Ask once the work is done. True for what is no job, and where jobs are not leased.
    pub fn claim(&mut self) -> bool {
        self.lease.is_none_or(|lease| lease.claim(self.journal))
    }

    /// Does `work` for the job at hand as long as its [epoch](Cx::retire) has not passed. `work` asks now and then whether
    /// it is wanted still, and gives up with `None` where it is not. That it gave up is recorded: in replay it is not
    /// begun then, and otherwise goes on to its end.
    ///
    /// For jobs that take longer than others can wait for a worker.
    pub fn while_wanted<R>(&mut self, work: impl FnOnce(&dyn Fn() -> bool) -> Option<R>) -> Option<R> {
        if let Some(given_up) = self.journal.replayed_value(value::COUNT) {
            return if given_up == 0 { work(&|| true) } else { None };
        }
        let lease = self.lease;
        let done = work(&|| lease.is_none_or(|lease| lease.is_wanted()));
        self.journal.record_count(u64::from(done.is_none()));
        done
    }

    /// Does `work` as long as nobody has ordered this actor to stop. `work` asks now and then, from whichever threads it
    /// uses, whether it is to go on, and gives up with `None` where it is not. That it gave up is recorded: in replay it is not
    /// begun then, and otherwise goes on to its end. Whoever gave up says nothing of what it was at.
    ///
    /// For turns that take longer than a system's end can wait.
    pub fn while_running<R>(
        &mut self,
        work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> Option<R>,
    ) -> Option<R> {
        if let Some(given_up) = self.journal.replays_giving_up() {
            return if given_up { None } else { work(&|| true) };
        }
        let link = &self.address.mailbox.link;
        let done = work(&|| !link.signals.any(signal::STOP) && !link.scheduler.is_stopping());
        if done.is_none() {
            self.journal.record_given_up();
        }
        done
    }

    /// The same with a job at hand.
    pub(crate) fn at<'b>(&'b mut self, lease: &'b dyn Lease) -> Cx<'b, M> {
        let Cx { address, journal, timers, thread, env, stop, lease: _ } = self;
        Cx { address, journal, timers, thread, env, stop, lease: Some(lease) }
    }

    /// Stops this actor after this message.
    pub fn stop(&mut self) {
        *self.stop = true;
    }

    /// The next random number of this actor: a hash of the system's seed, the actor and a counter, so that it is the
    /// same in replay whatever thread runs it.
    pub fn random(&mut self) -> u64 {
        self.journal.random()
    }

    /// True where all this has happened before: who was shown something then is not shown it again.
    pub fn replays(&self) -> bool {
        self.env.replaying()
    }

    /// False where the world must not notice, as in replay and simulation: no file is written.
    pub fn effects(&self) -> bool {
        self.env.effects()
    }

    /// Deliveries to this actor so far, this one included.
    pub fn index(&self) -> u64 {
        self.journal.index
    }
}

/// Sends `message` on behalf of the actor whose journal this is.
#[inline(always)]
pub(crate) fn post<N: Message>(
    journal: &mut Journal,
    thread: &ThreadCx,
    to: &Address<N>,
    message: N,
) -> Result<(), Rejected<N>> {
    let number = journal.next_send();
    let from = journal.id;
    let way = message.lane();
    if journal.replaying() {
        if let Some(reason) = journal.replays_rejection(number) {
            return Err(Rejected { message, reason });
        }
        let (lane, sent_in) = (lane_code(way), journal.index);
        let digest = journal.digest_of(&message);
        journal.says(to.id(), lane, digest);
        let inbound = Inbound { from, lane, sent_in, message };
        match journal.holds_back() {
            true => journal.hold_back(Box::new(HeldMessage { to: to.clone(), inbound })),
            false => to.mailbox.accept_replayed(inbound, thread),
        }
        return Ok(());
    }
    if journal.rejects_by_fault(number) {
        journal.record_rejection(number, Reason::Full);
        return Err(Rejected { message, reason: Reason::Full });
    }
    let sequence = match way {
        Lane::Latest(key) => journal.latest_sent(to.id(), key % LATEST_KEYS),
        _ => 0,
    };
    let digest = journal.digest_of(&message);
    let accepted = to.mailbox.accept(Envelope { from, sequence, digest, external: None, message }, thread);
    if accepted.is_ok() {
        journal.says(to.id(), lane_code(way), digest);
    }
    match (&accepted, way) {
        (Ok(()), Lane::Latest(key)) => journal.count_latest_sent(to.id(), key % LATEST_KEYS),
        (Ok(()), _) => {}
        (Err(rejected), _) => {
            journal.record_rejection(number, rejected.reason);
            to.mailbox.link.counters.rejected();
        }
    }
    accepted
}

/// A message of a replay, before it is known that its sender does as recorded.
struct HeldMessage<N: Message> {
    to: Address<N>,
    inbound: Inbound<N>,
}

impl<N: Message> Held for HeldMessage<N> {
    fn tell(&self) -> Said {
        let message = &self.inbound.message;
        let says = guarded(|| message.content()).unwrap_or_default();
        Said { to: self.to.id(), kind: message.kind(), says }
    }

    fn go(self: Box<Self>, thread: &ThreadCx) {
        self.to.mailbox.accept_replayed(self.inbound, thread);
    }
}

/// The code of a way in the order stream.
#[inline]
pub(crate) fn lane_code(way: Lane) -> u8 {
    match way {
        Lane::Data => lane::DATA,
        Lane::Control => lane::CONTROL,
        Lane::Latest(key) => lane::LATEST + key % LATEST_KEYS,
    }
}
