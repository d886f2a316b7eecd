//! How one delivery is made: the same code live and in replay, for messages, jobs, timers and orders.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use super::{Core, Node};
use crate::actor::{Actor, Cx, OwnTimer, lane_code};
use crate::journal::{Halted, Payload};
use crate::log::format::{Symbol, lane};
use crate::mailbox::Envelope;
use crate::message::{ActorId, LATEST_KEYS, Lane, Message};
use crate::pool::{Killed, Popped, Seat, job_symbol};
use crate::scheduler::ThreadCx;
use crate::signals::signal;
use crate::supervise::{Incident, Injected, OnPanic, message_of, verdict};

impl<A: Actor> Node<A> {
    /// Runs code of the actor; what it panics with comes back.
    #[inline]
    fn guarded(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        body: impl FnOnce(&mut A, &mut Option<Box<dyn Seat<A>>>, &mut Cx<'_, A::Msg>),
    ) -> Result<(), Box<dyn Any + Send>> {
        let injected = core.journal.panics_by_fault();
        let Core { actor, journal, timers, seat, stopping, .. } = core;
        let mut cx =
            Cx { address: &self.address, journal, timers, thread, env: &self.link.env, stop: stopping };
        catch_unwind(AssertUnwindSafe(|| {
            if injected {
                resume_unwind(Box::new(Injected));
            }
            body(actor, seat, &mut cx);
        }))
    }

    /// The one way a message gets to the actor.
    #[inline]
    pub(super) fn deliver(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        symbol: Symbol,
        payload: Payload<'_>,
        message: A::Msg,
    ) -> Result<(), Halted> {
        let kind = message.kind();
        core.journal.deliver(symbol, payload, kind, &message, |digest| message.digest(digest))?;
        if let Err(panic) = self.guarded(core, thread, |actor, _, cx| actor.handle(message, cx)) {
            self.link.counters.dead_letters(1);
            self.panicked(core, thread, kind, panic);
        }
        core.journal.handled(|| core.actor.digest())
    }

    /// The one way a job gets to the worker; its seat holds it.
    pub(super) fn deliver_job(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        popped: Popped,
    ) -> Result<(), Halted> {
        let Some(seat) = &core.seat else { return Ok(()) };
        let kind = seat.kind();
        let symbol = job_symbol(&core.journal, &popped);
        let payload = Payload::Job { id: popped.id, attempt: popped.attempt };
        // A job's identity begins with who made it.
        core.journal.comes_of(ActorId((popped.id >> 40) as u32), popped.pushed_in);
        core.journal.deliver(symbol, payload, kind, seat.content(), |digest| seat.digest(digest))?;
        let _span = tracing::trace_span!("job", actor = A::NAME, job = popped.id).entered();
        let done = self.guarded(core, thread, |actor, seat, cx| {
            if let Some(seat) = seat {
                if popped.stale { seat.stale(actor, cx) } else { seat.run(actor, cx) }
            }
        });
        match done {
            Ok(()) => {
                if let Some(seat) = &mut core.seat {
                    seat.completed();
                }
            }
            Err(panic) => self.panicked(core, thread, kind, panic),
        }
        core.journal.handled(|| core.actor.digest())
    }

    fn panicked(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        kind: &'static str,
        panic: Box<dyn Any + Send>,
    ) {
        let env = &self.link.env;
        let (actor, name) = (self.link.id, env.name(self.link.id));
        self.link.counters.panicked();
        let message = message_of(panic.as_ref());
        tracing::warn!("{name} panicked over {kind}: {message}");
        let tripped = core.circuit.panicked(core.journal.index);
        let Core { seat, on_panic, journal, .. } = core;
        let verdict = journal.verdict(|| match (on_panic, seat.as_deref()) {
            (OnPanic::Stop, _) => verdict::STOP,
            (_, Some(seat)) if tripped && seat.leave(thread) => verdict::OPEN,
            (_, None) if tripped => verdict::OPEN,
            _ => verdict::GO_ON,
        });
        let dead = match core.seat.as_mut().map(|seat| seat.killed(thread)) {
            Some(Killed::Dead { id, description }) => Some(Incident::JobDead { actor, job: id, description }),
            _ => None,
        };
        let open = (verdict == verdict::OPEN).then(|| Incident::CircuitOpen { actor, name: name.clone() });
        let first = Incident::Panicked { actor, name, kind: kind.to_owned(), message };
        for incident in [Some(first), dead, open].into_iter().flatten() {
            env.report(&mut core.journal, thread, incident);
        }
        if verdict != verdict::GO_ON {
            core.stopping = true;
        } else if let OnPanic::Restart(make) = &mut core.on_panic {
            core.actor = make();
        }
    }

    pub(super) fn start(&self, core: &mut Core<A>, thread: &ThreadCx) {
        while let Some(decoder) = self.mailbox().decoders.pop() {
            core.decoders.push(decoder);
        }
        // One that was put where a snapshot was taken has started before.
        if std::mem::replace(&mut core.started, true) {
            return;
        }
        if let Err(panic) = self.guarded(core, thread, |actor, _, cx| actor.started(cx)) {
            self.panicked(core, thread, "start", panic);
        }
    }

    pub(super) fn order(&self, core: &mut Core<A>, thread: &ThreadCx, bits: u32) -> Result<(), Halted> {
        let symbol = Symbol { from: self.link.id, lane: lane::ORDER };
        core.journal.deliver(symbol, Payload::Order(bits), "order", &(), |digest| digest.u32(bits))?;
        if bits & signal::STOP != 0 {
            core.stopping = true;
        }
        if bits & signal::PAUSE != 0 && bits & signal::RESUME == 0 {
            core.paused = !core.journal.replaying();
            if let Some(seat) = &core.seat {
                seat.decline(thread);
            }
        } else if bits & signal::RESUME != 0 {
            core.paused = false;
        }
        core.journal.handled(|| core.actor.digest())
    }

    pub(super) fn envelope(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        envelope: Envelope<A::Msg>,
    ) -> Result<(), Halted> {
        let Envelope { from, sequence, external, message } = envelope;
        let way = message.lane();
        let symbol = Symbol { from, lane: lane_code(way) };
        let payload = match (way, &external) {
            (_, Some(encoded)) => Payload::External(&encoded.0),
            (Lane::Latest(key), None) => {
                Payload::Skipped(core.journal.skipped(from, key % LATEST_KEYS, sequence))
            }
            _ => Payload::None,
        };
        self.deliver(core, thread, symbol, payload, message)
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
                self.deliver(core, thread, symbol, payload, message)
            }
            // It was cancelled after it fired: a delivery all the same, since it made room for another timer.
            _ => {
                core.journal.deliver(symbol, payload, "cancelled timer", &(), |digest| digest.u32(timer))?;
                core.journal.handled(|| core.actor.digest())
            }
        }
    }
}
