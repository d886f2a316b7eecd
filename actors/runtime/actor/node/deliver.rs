//! How one delivery is made: the same code live and in replay, for messages, jobs, timers and orders.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use super::{Core, Newcomer, Node};
use crate::actor::seat::{KILLS_MAX, Popped, job_symbol};
use crate::actor::supervise::{OnPanic, verdict};
use crate::actor::{Actor, Cx, OwnTimer};
use crate::journal::Halted;
use crate::journal::observe::Sight;
use crate::log::format::{Payload, Symbol, lane};
use crate::mailbox::Envelope;
use crate::message::incident::{Incident, Injected, guarded, message_of};
use crate::message::{ActorId, Message};
use crate::scheduler::ThreadCx;
use crate::scheduler::signals::signal;

/// How far a delivery came.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// Asking the message or job what it is; nothing is recorded yet.
    Read,
    /// The actor is at it.
    Handle,
    /// Hashing the actor's state.
    Hash,
}

/// What stands for a message or job that panicked when it was asked.
const UNREADABLE: &str = "unreadable";

type Panic = Box<dyn Any + Send>;

impl<A: Actor> Node<A> {
    /// The one way a message gets to the actor. Code of the message and of the actor may panic anywhere in it.
    #[inline]
    pub(super) fn deliver(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        symbol: Symbol,
        (payload, known): (Payload<'_>, u64),
        message: A::Msg,
    ) -> Result<(), Halted> {
        let (mut stage, mut kind) = (Stage::Read, UNREADABLE);
        let Core { actor: Some(actor), journal, timers, stopping, .. } = core else { return Ok(()) };
        // Lent to what may panic, not moved into it: that would be three copies more.
        let mut message = Some(message);
        let done = catch_unwind(AssertUnwindSafe(|| {
            let Some(read) = &message else { return Ok(()) };
            kind = read.kind();
            let (told, state) = (|| read.content(), || actor.content());
            let sight = Sight { content: read, receiver: actor, told: &told, state: &state };
            journal.deliver(symbol, payload, kind, sight, known, |digest| read.digest(digest))?;
            stage = Stage::Handle;
            if journal.panics_by_fault() {
                resume_unwind(Box::new(Injected));
            }
            let env = &self.env;
            let mut cx =
                Cx { address: &self.address, journal, timers, thread, env, stop: stopping, lease: None };
            if let Some(message) = message.take() {
                actor.handle(message, &mut cx);
            }
            stage = Stage::Hash;
            journal.handled(thread, || actor.digest())
        }));
        done.unwrap_or_else(|panic| {
            let _ = guarded(|| drop(message));
            self.broke_off(core, thread, (symbol, payload), (stage, kind), panic)
        })
    }

    /// The one way a job gets to the worker; its seat holds it.
    pub(super) fn deliver_job(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        popped: Popped,
    ) -> Result<(), Halted> {
        let symbol = job_symbol(&core.journal, &popped);
        let payload = Payload::Job { id: popped.id, attempt: popped.attempt };
        // A job's identity begins with who made it.
        core.journal.comes_of(ActorId((popped.id >> 40) as u32), popped.pushed_in);
        let _span = tracing::trace_span!("job", actor = A::NAME, job = popped.id).entered();
        let (mut stage, mut kind) = (Stage::Read, UNREADABLE);
        let Core { actor: Some(actor), journal, timers, stopping, seat: Some(seat), .. } = core else {
            return Ok(());
        };
        let done = catch_unwind(AssertUnwindSafe(|| {
            kind = seat.kind();
            let (told, state) = (|| seat.told(), || actor.content());
            let sight = Sight { content: seat.content(), receiver: actor, told: &told, state: &state };
            journal.deliver(symbol, payload, kind, sight, 0, |digest| seat.digest(digest))?;
            stage = Stage::Handle;
            if journal.panics_by_fault() {
                resume_unwind(Box::new(Injected));
            }
            let env = &self.env;
            if popped.attempt >= KILLS_MAX {
                seat.give_up(journal, thread);
            } else {
                if journal.hangs_by_fault() {
                    seat.hang(thread);
                }
                let mut cx =
                    Cx { address: &self.address, journal, timers, thread, env, stop: stopping, lease: None };
                if popped.stale {
                    seat.stale(actor, &mut cx)
                } else {
                    seat.run(actor, &mut cx)
                }
                seat.completed(journal);
            }
            stage = Stage::Hash;
            journal.handled(thread, || actor.digest())
        }));
        done.unwrap_or_else(|panic| self.broke_off(core, thread, (symbol, payload), (stage, kind), panic))
    }

    /// A delivery panicked. It counts and is recorded all the same, so that replay comes to the same panic.
    #[cold]
    fn broke_off(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        (symbol, payload): (Symbol, Payload<'_>),
        (stage, kind): (Stage, &'static str),
        panic: Panic,
    ) -> Result<(), Halted> {
        if stage == Stage::Read {
            core.journal.deliver(symbol, payload, kind, Sight::NOTHING, 0, |digest| {
                digest.bytes(UNREADABLE.as_bytes())
            })?;
        }
        if stage != Stage::Hash && !matches!(payload, Payload::Job { .. }) {
            self.link.counters.dead_letters(1);
        }
        self.panicked(core, thread, kind, panic);
        if stage == Stage::Hash { core.journal.handled_at_last(thread) } else { self.handled(core, thread) }
    }

    /// After a delivery that ran no code of the actor.
    fn handled(&self, core: &mut Core<A>, thread: &ThreadCx) -> Result<(), Halted> {
        let Core { actor, journal, .. } = core;
        match catch_unwind(AssertUnwindSafe(|| journal.handled(thread, || actor.as_ref()?.digest()))) {
            Ok(handled) => handled,
            Err(panic) => {
                self.panicked(core, thread, "the hash of its state", panic);
                core.journal.handled_at_last(thread)
            }
        }
    }

    fn panicked(&self, core: &mut Core<A>, thread: &ThreadCx, kind: &'static str, panic: Panic) {
        let env = &self.env;
        let (actor, name) = (self.link.id, self.link.name.clone());
        self.link.counters.panicked();
        let message = message_of(panic.as_ref());
        // Whatever it is dropped with must not take the thread along.
        let _ = guarded(|| drop(panic));
        let tripped = core.circuit.panicked(core.journal.index);
        let mut made = match &mut core.on_panic {
            OnPanic::Restart(make) => Some(guarded(make)),
            _ => None,
        };
        let Core { seat, on_panic, journal, .. } = core;
        let verdict = journal.verdict(|| match (on_panic, seat.as_deref(), &made) {
            (OnPanic::End, ..) | (_, _, Some(Err(_))) => verdict::END,
            (OnPanic::Stop, ..) => verdict::STOP,
            (_, Some(seat), _) if tripped && seat.leave(thread) => verdict::OPEN,
            (_, None, _) if tripped => verdict::END,
            _ => verdict::GO_ON,
        });
        let open = (verdict == verdict::OPEN).then(|| Incident::CircuitOpen { actor, name: name.clone() });
        let message_of_job = message.clone();
        let first = Incident::Panicked { actor, name: name.clone(), kind: kind.to_owned(), message };
        if verdict == verdict::END {
            env.end(first.clone());
        }
        env.report(journal, thread, first);
        if let Some(seat) = seat {
            seat.killed(journal, thread, &message_of_job);
        }
        if let Some(open) = open {
            env.report(journal, thread, open);
        }
        match made.take() {
            Some(Ok(actor)) if verdict == verdict::GO_ON => {
                let before = core.actor.replace(actor);
                let _ = guarded(|| drop(before));
            }
            Some(Err(message)) => {
                env.scheduler.note(Incident::Beside { what: format!("starting {name} anew"), message });
            }
            _ => {}
        }
        core.stopping |= verdict != verdict::GO_ON;
    }

    pub(super) fn start(&self, core: &mut Core<A>, thread: &ThreadCx) {
        while let Some(decoder) = self.mailbox().decoders.pop() {
            core.decoders.push(decoder);
        }
        if core.actor.is_none()
            && let Some(newcomer) = self.newcomer.take()
        {
            let Newcomer { actor, on_panic } = *newcomer;
            (core.actor, core.on_panic, core.came) = (Some(actor), on_panic, true);
        }
        if core.actor.is_none() {
            return;
        }
        // One that was put where a snapshot was taken has started before.
        if std::mem::replace(&mut core.started, true) {
            return;
        }
        let Core { actor: Some(actor), journal, timers, stopping, .. } = core else { return };
        let begun = catch_unwind(AssertUnwindSafe(|| {
            if journal.panics_by_fault() {
                resume_unwind(Box::new(Injected));
            }
            let env = &self.env;
            actor.started(&mut Cx {
                address: &self.address,
                journal,
                timers,
                thread,
                env,
                stop: stopping,
                lease: None,
            });
        }));

        if let Err(panic) = begun {
            self.panicked(core, thread, "start", panic);
        }
        // Whether it is what was said then shows at the first delivery.
        core.journal.let_go(thread);
    }

    pub(super) fn order(&self, core: &mut Core<A>, thread: &ThreadCx, bits: u32) -> Result<(), Halted> {
        let symbol = Symbol { from: self.link.id, lane: lane::ORDER };
        core.journal
            .deliver(symbol, Payload::Order(bits), "order", Sight::NOTHING, 0, |digest| digest.u32(bits))?;
        if bits & signal::STOP != 0 {
            core.stopping = true;
        }
        // Recordings of before may hold both at once: that was a pause taken back.
        if bits & signal::PACE == signal::PAUSE {
            core.paused = !core.journal.replaying();
            if let Some(seat) = &core.seat {
                seat.decline(thread);
            }
        } else if bits & signal::RESUME != 0 {
            core.paused = false;
        }
        self.handled(core, thread)
    }

    pub(super) fn envelope(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        envelope: Envelope<A::Msg>,
        way: u8,
    ) -> Result<(), Halted> {
        let Envelope { from, sequence, digest, external, message } = envelope;
        let symbol = Symbol { from, lane: way };
        let payload = match (way.checked_sub(lane::LATEST), &external) {
            (_, Some(encoded)) => Payload::External(&encoded.0),
            (Some(key), None) => Payload::Skipped(core.journal.skipped(from, key, sequence)),
            (None, None) => Payload::None,
        };
        self.deliver(core, thread, symbol, (payload, digest), message)
    }

    pub(super) fn timer(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        timer: u32,
        time: u64,
    ) -> Result<(), Halted> {
        let symbol = Symbol { from: self.link.id, lane: lane::TIMER };
        let payload = Payload::Timer { timer, time };
        match core.timers.take(timer) {
            Some(OwnTimer { message: Some(message), started_in }) => {
                core.journal.comes_of(self.link.id, started_in);
                self.deliver(core, thread, symbol, (payload, 0), message)
            }
            // It was cancelled after it fired: a delivery all the same, since it made room for another timer.
            _ => {
                core.journal.deliver(symbol, payload, "cancelled timer", Sight::NOTHING, 0, |digest| {
                    digest.u32(timer)
                })?;
                self.handled(core, thread)
            }
        }
    }
}
