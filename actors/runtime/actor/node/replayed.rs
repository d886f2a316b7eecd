//! A turn in replay: what the script says, from messages that were made anew.

use std::sync::atomic::Ordering;

use super::{Core, Node, Turn};
use crate::actor::Actor;
use crate::actor::seat::Popped;
use crate::journal::Halted;
use crate::journal::script::{Next, Script};
use crate::log::format::{Payload, lane};
use crate::mailbox::Decoder;
use crate::message::incident::guarded;
use crate::scheduler::ThreadCx;
use crate::scheduler::signals::signal;

impl<A: Actor> Node<A> {
    pub(super) fn replay_turn(
        &self,
        core: &mut Core<A>,
        thread: &ThreadCx,
        turn: &mut Turn,
    ) -> Result<(), Halted> {
        let scheduler = &*self.link.scheduler;
        let bits = self.link.signals.take(u32::MAX);
        turn.consumed += bits.count_ones() as usize;
        turn.flush = bits & signal::FLUSH != 0;
        while let Some(inbound) = self.mailbox().inbound.pop() {
            turn.consumed += 1;
            core.stash.put(inbound);
        }
        if bits & signal::START != 0 {
            self.start(core, thread);
        }
        loop {
            if scheduler.halted() {
                return Err(Halted);
            }
            if core.stopping {
                return Ok(());
            }
            if turn.messages >= scheduler.budget.messages {
                turn.again = true;
                return Ok(());
            }
            if core.journal.index >= self.link.limit.load(Ordering::Relaxed) {
                return Ok(());
            }
            let Some(next) = core.journal.script().and_then(Script::next) else { return Ok(()) };
            if !self.replay_next(core, thread, &next)? {
                return Ok(());
            }
            turn.messages += 1;
        }
    }

    /// Makes the next delivery of the script; false if what it delivers is not there yet.
    fn replay_next(&self, core: &mut Core<A>, thread: &ThreadCx, next: &Next) -> Result<bool, Halted> {
        let symbol = next.symbol;
        let pass = |core: &mut Core<A>| {
            if let Some(script) = core.journal.script() {
                script.pass(next);
            }
        };
        match (next.payload, &next.external) {
            (_, Some(bytes)) => {
                let decoder =
                    core.decoders.iter().find(|(port, _)| *port == symbol.from).map(|(_, decode)| decode);
                let decode = |decode: &Decoder<A::Msg>| guarded(|| decode(bytes)).ok().flatten();
                let Some(message) = decoder.and_then(decode) else {
                    let expected = format!("an input of {}", self.env.name(symbol.from));
                    core.journal.diverge_here(expected, "a payload that cannot be decoded".into());
                    return Err(Halted);
                };
                pass(core);
                self.deliver(core, thread, symbol, (Payload::External(bytes), 0), message)?;
            }
            (Payload::Timer { timer, time }, None) => {
                if !core.timers.contains(timer) {
                    core.journal.diverge_here(format!("timer {timer}"), "no such timer runs".into());
                    return Err(Halted);
                }
                pass(core);
                self.timer(core, thread, timer, time)?;
            }
            (Payload::Order(bits), None) => {
                pass(core);
                self.order(core, thread, bits)?;
            }
            (Payload::Job { id, attempt }, None) => {
                let Some(pushed_in) = core.seat.as_mut().and_then(|seat| seat.hold(id, attempt)) else {
                    return Ok(false);
                };
                pass(core);
                let stale = matches!(symbol.lane, lane::STALE | lane::STALE_AGAIN);
                self.deliver_job(core, thread, Popped { id, attempt, pushed_in, stale })?;
            }
            (payload, None) => {
                let skipped = if let Payload::Skipped(count) = payload { count } else { 0 };
                let Some((sent_in, message)) = core.stash.take(symbol, skipped) else { return Ok(false) };
                pass(core);
                core.journal.comes_of(symbol.from, sent_in);
                self.deliver(core, thread, symbol, (payload, 0), message)?;
            }
        }
        Ok(true)
    }
}
