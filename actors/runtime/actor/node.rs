//! One actor with everything that belongs to it, and its turn: take what waits, deliver it in order, write all state
//! back, and only then let others see that it is done.

mod deliver;
mod replayed;
mod saved;

use crossbeam_utils::atomic::AtomicCell;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::actor::seat::Seat;
use crate::actor::supervise::{Circuit, OnPanic};
use crate::actor::{Actor, OwnTimers};
use crate::journal::env::Env;
use crate::journal::script::Stash;
use crate::journal::{Halted, Journal};
use crate::log::format::{Hashing, Payload, lane};
use crate::mailbox::{Address, Decoder, Inbound, Mailbox};
use crate::message::content::Content;
use crate::message::incident::guarded;
use crate::message::saved::{Loader, Saver};
use crate::message::{ActorId, LATEST_KEYS, Message};
use crate::scheduler::link::Link;
use crate::scheduler::signals::signal;
use crate::scheduler::{Runnable, ThreadCx};

use saved::{load_messages, load_timers, save_messages, save_timers};

/// An actor as its system sees it, whatever its messages are. What is not said otherwise is that of a port, whose number
/// stands among the actors': nothing is there.
pub(crate) trait AnyNode: Runnable {
    /// Shows the actor's state, unless it is in a turn.
    fn look(&self, _show: &mut dyn FnMut(&dyn Any)) {}
    /// What the actor tells of its state, unless it is in a turn.
    fn content(&self) -> Option<Content> {
        None
    }
    /// Deliveries and chained hash, unless it is in a turn.
    fn position(&self) -> Option<(u64, u64)> {
        None
    }
    /// Replay: what the script still wants, unless the actor is in a turn.
    fn script_state(&self) -> Option<ScriptState> {
        None
    }
    /// Writes everything that a snapshot of a replay needs, unless the actor is in a turn.
    fn save(&self, _saver: &mut Saver) {}
    fn restore(&self, _loader: &mut Loader<'_>) -> Option<()> {
        Some(())
    }
    /// Hands over what is left of the log, and ends the journal.
    fn end_log(&self) {}
    /// Throws away what waits, when nothing runs any more.
    fn clear(&self) {}
    /// Messages of all ways that wait in the mailbox.
    fn waiting(&self) -> u64 {
        0
    }
    /// Control messages that wait.
    fn urgent(&self) -> usize {
        0
    }
    /// Data messages that wait.
    fn depth(&self) -> usize {
        0
    }
}

/// Where an actor stands in its recording.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScriptState {
    /// Deliveries made and recorded.
    pub(crate) made: u64,
    pub(crate) recorded: u64,
    /// The script is over and the chained hash is not the recorded one.
    pub(crate) wrong_end: Option<(u64, u64)>,
    /// The lane of what the script delivers next, and who must send it; none if that is not recorded.
    pub(crate) waits_for: Option<(Option<ActorId>, u8)>,
}

/// An actor's state and what travels with it; owned by whoever runs the turn.
struct Core<A: Actor> {
    /// None in a place that is reserved and still empty.
    actor: Option<A>,
    /// It came while the system ran.
    came: bool,
    journal: Journal,
    timers: OwnTimers<A::Msg>,
    seat: Option<Box<dyn Seat<A>>>,
    on_panic: OnPanic<A>,
    circuit: Circuit,
    stash: Stash<A::Msg>,
    decoders: Vec<(ActorId, Decoder<A::Msg>)>,
    started: bool,
    paused: bool,
    stopping: bool,
    stopped: bool,
    /// A turn of it did not come to its end.
    broken: bool,
}

pub(crate) struct Node<A: Actor> {
    link: Arc<Link>,
    env: Arc<Env>,
    address: Address<A::Msg>,
    /// Empty only while a turn runs, or while the main thread looks.
    core: AtomicCell<Option<Box<Core<A>>>>,
    /// Who comes into a reserved place, until its first turn.
    newcomer: AtomicCell<Option<Box<Newcomer<A>>>>,
}

/// An actor on its way into a reserved place.
struct Newcomer<A> {
    actor: A,
    on_panic: OnPanic<A>,
}

/// How a turn ended.
struct Turn {
    consumed: usize,
    messages: u64,
    /// Work is left that the counter does not tell of.
    again: bool,
    flush: bool,
}

/// An actor in a turn. Whatever the turn panics with, the actor is put back, with what it consumed.
struct InTurn<'a, A: Actor> {
    node: &'a Node<A>,
    core: Option<Box<Core<A>>>,
    turn: Turn,
}

impl<A: Actor> Drop for InTurn<'_, A> {
    fn drop(&mut self) {
        if let Some(mut core) = self.core.take() {
            core.broken = true;
            self.node.link.activation.keep(self.turn.consumed);
            self.node.core.store(Some(core));
        }
    }
}

impl<A: Actor> Node<A> {
    pub(crate) fn new(
        address: &Address<A::Msg>,
        actor: Option<A>,
        on_panic: OnPanic<A>,
        seat: Option<Box<dyn Seat<A>>>,
        env: &Arc<Env>,
    ) -> Self {
        let link = Arc::clone(&address.mailbox.link);
        let core = Core {
            actor,
            came: false,
            journal: Journal::new(&link, env),
            timers: OwnTimers::new(),
            seat,
            on_panic,
            circuit: Circuit::default(),
            stash: Stash::new(),
            decoders: Vec::new(),
            started: false,
            paused: false,
            stopping: false,
            stopped: false,
            broken: false,
        };
        Self {
            link,
            env: Arc::clone(env),
            address: address.clone(),
            core: AtomicCell::new(Some(Box::new(core))),
            newcomer: AtomicCell::new(None),
        }
    }

    pub(crate) fn id(&self) -> ActorId {
        self.link.id
    }

    /// An actor comes into this reserved place, and begins in its next turn.
    pub(crate) fn arrive(&self, actor: A, on_panic: OnPanic<A>, thread: &ThreadCx) -> Address<A::Msg> {
        self.newcomer.store(Some(Box::new(Newcomer { actor, on_panic })));
        self.link.raise(signal::START, thread);
        self.address.clone()
    }

    fn mailbox(&self) -> &Mailbox<A::Msg> {
        &self.address.mailbox
    }

    fn signals(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        bits: u32,
        turn: &mut Turn,
    ) -> Result<(), Halted> {
        let mailbox = self.mailbox();
        if bits & signal::START != 0 {
            self.start(core, thread);
        }
        if bits & signal::CONTROL != 0 {
            turn.messages += 1;
            self.order(core, thread, bits & signal::CONTROL)?;
        }
        turn.flush |= bits & signal::FLUSH != 0;
        if bits & signal::URGENT != 0 {
            while !core.stopping
                && let Some(envelope) = mailbox.urgent.pop()
            {
                turn.messages += 1;
                self.envelope(core, thread, envelope, lane::CONTROL)?;
            }
        }
        if bits & signal::TIMER != 0 {
            while !core.stopping
                && let Some(timer) = mailbox.fired.pop()
            {
                turn.messages += 1;
                self.timer(core, thread, timer, self.link.scheduler.clock.now())?;
            }
        }
        for key in 0..LATEST_KEYS {
            if bits & signal::LATEST << key != 0
                && !core.stopping
                && let Some(envelope) = mailbox.latest[usize::from(key)].pop()
            {
                turn.messages += 1;
                self.envelope(core, thread, envelope, lane::LATEST + key)?;
            }
        }
        Ok(())
    }

    fn live_turn(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        start: u64,
        turn: &mut Turn,
    ) -> Result<(), Halted> {
        let scheduler = &*self.link.scheduler;
        let mailbox = self.mailbox();
        // The clock is read after 1, 2, 4, … messages as long as they are short.
        let (mut next_look, mut look_step) = (1, 1);
        loop {
            if scheduler.halted() {
                return Err(Halted);
            }
            let mask = if core.paused { signal::WHILE_PAUSED } else { u32::MAX };
            if self.link.signals.any(mask) {
                let bits = self.link.signals.take(mask);
                turn.consumed += bits.count_ones() as usize;
                self.signals(core, thread, bits, turn)?;
            }
            if core.stopping || core.paused {
                return Ok(());
            }
            if turn.messages >= scheduler.budget.messages {
                turn.again = true;
                return Ok(());
            }
            if turn.messages >= next_look {
                let elapsed = scheduler.clock.turn_time().saturating_sub(start);
                if elapsed >= scheduler.budget.nanoseconds {
                    turn.again = true;
                    return Ok(());
                }
                look_step = if elapsed < 2000 * turn.messages { (look_step * 2).min(32) } else { 1 };
                next_look = turn.messages + look_step;
            }
            let Some(envelope) = mailbox.data.pop() else { break };
            turn.consumed += 1;
            turn.messages += 1;
            mailbox.release(envelope.message.size_bytes());
            self.envelope(core, thread, envelope, lane::DATA)?;
        }
        // Jobs come after messages, one a turn.
        if let Core { seat: Some(seat), actor: Some(actor), .. } = core {
            if let Some(popped) = seat.pop(actor, thread) {
                turn.messages += 1;
                turn.again = true;
                self.deliver_job(core, thread, popped)?;
            } else {
                turn.again = !seat.rest(actor);
            }
        }
        Ok(())
    }

    /// Ends the actor once, and throws away what still arrives.
    fn close(&self, core: &mut Core<A>, thread: &ThreadCx, turn: &mut Turn) {
        if !core.stopped {
            core.stopped = true;
            self.link.closed.store(true, Ordering::SeqCst);
            if let Some(seat) = &mut core.seat {
                if core.broken {
                    // Whatever it held goes to another.
                    seat.killed(&mut core.journal, thread, "its turn broke off");
                }
                seat.leave_regardless(thread);
            }
            let _ = guarded(|| core.actor.as_mut().map(Actor::stopped));
        }
        let mailbox = self.mailbox();
        let mut dead = 0;
        while let Some(envelope) = mailbox.data.pop() {
            mailbox.release(envelope.message.size_bytes());
            turn.consumed += 1;
            dead += 1;
        }
        while mailbox.urgent.pop().is_some() {
            dead += 1;
        }
        dead += mailbox.latest.iter().filter_map(|slot| slot.pop()).count() as u64;
        while mailbox.fired.pop().is_some() {}
        while mailbox.inbound.pop().is_some() {
            turn.consumed += 1;
        }
        turn.consumed += self.link.signals.take(u32::MAX).count_ones() as usize;
        self.link.counters.dead_letters(dead);
    }

    /// Takes the state out for a moment; only when no turn can run.
    fn with_core<R>(&self, body: impl FnOnce(&mut Core<A>) -> R) -> Option<R> {
        let mut core = self.core.take()?;
        // The caller's own panics are the caller's, but not at the actor's cost.
        let result = catch_unwind(AssertUnwindSafe(|| body(&mut core)));
        self.core.store(Some(core));
        Some(result.unwrap_or_else(|panic| resume_unwind(panic)))
    }
}

impl<A: Actor> Runnable for Node<A> {
    fn turn(&self, thread: &ThreadCx) -> bool {
        let link = &self.link;
        let scheduler = &*link.scheduler;
        if scheduler.halted() {
            return true;
        }
        let Some(core) = self.core.take() else { unreachable!("two turns of {} at once", link.id) };
        let _span = tracing::trace_span!("turn", actor = A::NAME, id = link.id.0).entered();
        let start = match thread.last_end.get() {
            0 => scheduler.clock.turn_time(),
            end => end,
        };
        let depth = link.activation.pending() as u64;
        let consumed = link.activation.owed();
        let turn = Turn { consumed, messages: 0, again: false, flush: false };
        let mut in_turn = InTurn { node: self, core: Some(core), turn };
        let InTurn { core: Some(core), turn, .. } = &mut in_turn else { unreachable!("just put there") };
        core.stopping |= core.broken;
        let ended = if core.stopped || core.broken {
            Ok(())
        } else if core.journal.replaying() {
            self.replay_turn(core, thread, turn)
        } else {
            self.live_turn(core, thread, start, turn)
        };
        if ended.is_err() {
            turn.again = true;
        } else if core.stopping {
            turn.again = false;
            self.close(core, thread, turn);
        }
        if ended.is_ok() {
            // What is said on an actor's behalf is said outside of its deliveries, too.
            core.journal.let_go(thread);
        }
        core.journal.end_turn(turn.flush);
        let end = scheduler.clock.turn_time();
        thread.last_end.set(end);
        link.counters.turn(start, end, turn.messages, depth, thread.lane);
        let paused = core.paused && !core.stopped;
        let (again, consumed) = (turn.again, turn.consumed);
        let core = in_turn.core.take();
        if again {
            link.activation.keep(consumed);
            self.core.store(core);
            return true;
        }
        self.core.store(core);
        let active = link.activation.finish(consumed);
        if active && paused {
            // Work waits, but not for a paused actor: an order wakes it. One that came just now is seen here.
            return link.signals.park();
        }
        active
    }

    fn link(&self) -> &Arc<Link> {
        &self.link
    }
}

impl<A: Actor> AnyNode for Node<A> {
    fn look(&self, show: &mut dyn FnMut(&dyn Any)) {
        self.with_core(|core| {
            if let Some(actor) = &core.actor {
                show(actor);
            }
        });
    }

    fn content(&self) -> Option<Content> {
        self.with_core(|core| core.actor.as_ref().map(Actor::content)).flatten()
    }

    fn position(&self) -> Option<(u64, u64)> {
        self.with_core(|core| (core.journal.index, core.journal.chain))
    }

    fn script_state(&self) -> Option<ScriptState> {
        self.with_core(|core| {
            let (made, chain, hashing) = (core.journal.index, core.journal.chain, self.env.hashing);
            let script = core.journal.script()?;
            let (recorded, expected) = script.recorded();
            let hashed = script.hashing == hashing && hashing != Hashing::Off;
            let wrong_end = expected
                .filter(|expected| made > 0 && made == recorded && hashed && chain != *expected)
                .map(|expected| (expected, chain));
            let waits_for = script.next().map(|next| {
                let from = match next.payload {
                    // A job comes from who made it.
                    Payload::Job { id, .. } => Some(ActorId((id >> 40) as u32)),
                    _ => Some(next.symbol.from),
                };
                (from, next.symbol.lane)
            });
            Some(ScriptState { made, recorded, wrong_end, waits_for })
        })?
    }

    fn save(&self, saver: &mut Saver) {
        let saved = self.with_core(|core| {
            let Some(journal) = core.journal.state() else { return saver.refuse() };
            let link = &self.link;
            let mut taken = 0;
            while let Some(inbound) = self.mailbox().inbound.pop() {
                taken += 1;
                core.stash.put(inbound);
            }
            // These units of work are settled in the next turn.
            link.activation.keep(link.activation.owed() + taken);
            let waiting: Vec<_> = core.stash.messages().collect();
            saver.put(&journal);
            saver.put(&(core.started, core.paused, core.stopping, core.stopped));
            saver.put(&core.circuit);
            saver.put(&core.timers.next);
            save_timers::<A>(saver, &core.timers.running);
            save_messages(saver, &waiting);
            if let Some(seat) = &mut core.seat {
                seat.save(saver);
            }
            match &core.actor {
                Some(actor) if !core.came => actor.save(saver),
                // Nobody would know whom to restore.
                Some(_) => saver.refuse(),
                None => {}
            }
        });
        if saved.is_none() {
            saver.refuse();
        }
    }

    fn restore(&self, loader: &mut Loader<'_>) -> Option<()> {
        self.with_core(|core| {
            core.journal.restore(loader.take()?)?;
            (core.started, core.paused, core.stopping, core.stopped) = loader.take()?;
            core.circuit = loader.take()?;
            core.timers.next = loader.take()?;
            core.timers.running = load_timers::<A>(loader)?;
            for (from, lane, sent_in, message) in load_messages(loader)? {
                core.stash.put(Inbound { from, lane, sent_in, message });
            }
            if let Some(seat) = &mut core.seat {
                seat.restore(loader)?;
            }
            self.link.closed.store(core.stopped, Ordering::SeqCst);
            core.actor.as_mut().map_or(Some(()), |actor| actor.restore(loader))
        })?
    }

    fn end_log(&self) {
        self.with_core(|core| core.journal.end_turn(true));
    }

    fn clear(&self) {
        let mailbox = self.mailbox();
        while mailbox.data.pop().is_some() {}
        while mailbox.urgent.pop().is_some() {}
        while mailbox.inbound.pop().is_some() {}
        mailbox.latest.iter().for_each(|slot| drop(slot.pop()));
        drop(self.newcomer.take());
        drop(self.core.take());
    }

    fn depth(&self) -> usize {
        self.mailbox().depth()
    }

    fn urgent(&self) -> usize {
        self.mailbox().urgent.len()
    }

    fn waiting(&self) -> u64 {
        let mailbox = self.mailbox();
        let newest: usize = mailbox.latest.iter().map(|slot| slot.len()).sum();
        (mailbox.data.len() + mailbox.urgent.len() + newest) as u64
    }
}
