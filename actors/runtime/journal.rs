//! The one place through which every delivery and every job pop of an actor passes.
//!
//! Here deliveries are counted, hashed, recorded, compared with a recording, shown to an observer, and faulted.

pub(crate) mod divergence;
pub(crate) mod env;
pub(crate) mod faults;
pub(crate) mod observe;
pub(crate) mod port;
mod recorder;
pub(crate) mod script;
mod sends;
mod values;

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::log::format::{CHUNK_DELIVERIES_MAX, FAINT_BITS, Hashing, Payload, Symbol, lane, value};
use crate::log::walk::Walk;
use crate::log::writer::BACKLOG_BYTES_MAX;
use crate::message::incident::guarded;
use crate::message::{ActorId, Digest, Message};
use crate::scheduler::ThreadCx;
use crate::scheduler::link::Link;

use divergence::{Divergence, Held, Turn};
use env::Env;
use observe::{Delivery, Sight};
use recorder::Recorder;
use script::Script;

/// Deliveries kept for a report of a divergence.
const HISTORY: usize = 20;
/// Bytes after which an actor hands its log over at the end of a turn.
const CHUNK_BYTES: usize = 4096;

/// Why a turn cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Halted;

/// What of an actor's journal goes into a snapshot.
#[derive(Serialize, Deserialize)]
pub(crate) struct JournalState {
    pub(crate) index: u64,
    pub(crate) chain: u64,
    pub(crate) sends: u64,
    pub(crate) jobs_made: u64,
    pub(crate) randoms: u64,
    pub(crate) speaks: bool,
    pub(crate) sent: Vec<(ActorId, u8, u32)>,
    pub(crate) seen: Vec<(ActorId, u8, u32)>,
    pub(crate) walk: Walk,
}

/// One actor's side of counting, hashing, recording and replay.
pub(crate) struct Journal {
    pub(crate) id: ActorId,
    /// Deliveries so far.
    pub(crate) index: u64,
    pub(crate) chain: u64,
    /// What the next delivery comes of, where it is known: for observers.
    pub(crate) cause: Option<(ActorId, u64)>,
    sends: u64,
    jobs_made: u64,
    randoms: u64,
    hashing: Hashing,
    /// Deliveries up to the next sparse hash, that one included.
    to_hash: u32,
    recorder: Option<Box<Recorder>>,
    declared: usize,
    held_back: Option<Vec<u8>>,
    period: u32,
    script: Option<Box<Script>>,
    history: VecDeque<Turn>,
    /// The actor said something since the last delivery was handled.
    speaks: bool,
    /// Deliveries that were handled: of a turn that breaks off, the last one may not be.
    handled: u64,
    /// Replay: what it said in the delivery at hand.
    held: Vec<Box<dyn Held>>,
    sent: Vec<(ActorId, u8, u32)>,
    seen: Vec<(ActorId, u8, u32)>,
    panics: VecDeque<u64>,
    fulls: VecDeque<u64>,
    hangs: VecDeque<u64>,
    link: Arc<Link>,
    env: Arc<Env>,
}

impl Journal {
    pub(crate) fn new(link: &Arc<Link>, env: &Arc<Env>) -> Self {
        let [panics, fulls, hangs] = env.faults_of(link.id);
        Self {
            id: link.id,
            index: 0,
            chain: Digest::new().finish(),
            cause: None,
            sends: 0,
            jobs_made: 0,
            randoms: 0,
            hashing: env.hashing,
            to_hash: if let Hashing::Every(period) = env.hashing { period.max(1) } else { u32::MAX },
            recorder: env.log.is_some().then(Box::default),
            declared: 0,
            held_back: None,
            period: 0,
            script: env.trace.as_ref().and_then(|trace| Script::new(trace, link.id)).map(Box::new),
            history: VecDeque::new(),
            speaks: false,
            handled: 0,
            held: Vec::new(),
            sent: Vec::new(),
            seen: Vec::new(),
            panics,
            fulls,
            hangs,
            link: Arc::clone(link),
            env: Arc::clone(env),
        }
    }

    /// Says what the next delivery comes of: `sent_in` deliveries had been made to `from` by then.
    #[inline]
    pub(crate) fn comes_of(&mut self, from: ActorId, sent_in: u64) {
        self.cause = sent_in.checked_sub(1).map(|index| (from, index));
    }

    /// Passes one delivery. `Err` if replay diverged here or was told to stop. Where `digest` panics, nothing was passed; it
    /// is not asked where the message's hash is `known` from its sender.
    #[inline]
    pub(crate) fn deliver(
        &mut self,
        symbol: Symbol,
        payload: Payload<'_>,
        kind: &'static str,
        sight: Sight<'_>,
        known: u64,
        digest: impl FnOnce(&mut Digest),
    ) -> Result<(), Halted> {
        if self.hashing == Hashing::Said {
            let hash = match known {
                0 => {
                    let mut hash = Digest::new();
                    digest(&mut hash);
                    hash.finish().max(1)
                }
                known => known,
            };
            let mut chain = Digest::from_chain(self.chain);
            chain.u64(u64::from(symbol.from.0) << 8 | u64::from(symbol.lane));
            chain.u64(hash);
            self.chain = chain.finish();
        } else if self.hashing != Hashing::Off {
            let mut chain = Digest::from_chain(self.chain);
            chain.u64(u64::from(symbol.from.0) << 8 | u64::from(symbol.lane));
            digest(&mut chain);
            self.chain = chain.finish();
        }
        self.link.counters.delivered();
        if let Some(recorder) = &mut self.recorder {
            recorder.delivery(symbol, payload);
            match self.hashing {
                Hashing::Exact => recorder.hashes.extend_from_slice(&short(self.chain).to_le_bytes()),
                Hashing::Every(_) if self.to_hash == 1 => {
                    recorder.hashes.extend_from_slice(&self.chain.to_le_bytes());
                }
                _ => {}
            }
        }
        if self.env.observer.is_some() {
            let (actor, index, from, chain, cause) =
                (self.id, self.index, symbol.from, self.chain, self.cause.take());
            let Sight { content, receiver, told, state } = sight;
            self.env.observe(&Delivery {
                actor,
                index,
                from,
                kind,
                cause,
                content,
                receiver,
                told,
                state,
                chain,
            });
        }
        let passed = if self.script.is_some() { self.compare(symbol, kind) } else { Ok(()) };
        self.index += 1;
        self.to_hash -= 1;
        if self.to_hash == 0 {
            self.to_hash = self.period_of_hashes();
        }
        passed
    }

    /// After the actor handled a delivery: what it said in it, and its state's own hash, is recorded, or is what was
    /// recorded, and only then goes to whom it is said.
    #[inline]
    pub(crate) fn handled(
        &mut self,
        thread: &ThreadCx,
        state: impl FnOnce() -> Option<u64>,
    ) -> Result<(), Halted> {
        match self.hashing {
            Hashing::Said => self.said_all(state())?,
            Hashing::Exact => self.became(state())?,
            Hashing::Every(_) | Hashing::Off => {}
        }
        self.tell_all(thread);
        Ok(())
    }

    /// The same where the state's own hash cannot be told.
    pub(crate) fn handled_at_last(&mut self, thread: &ThreadCx) -> Result<(), Halted> {
        if self.hashing == Hashing::Said && self.handled < self.index {
            self.said_all(None)?;
        }
        self.tell_all(thread);
        Ok(())
    }

    /// Where hashes are of what is delivered: the state that came of it.
    fn became(&mut self, state: Option<u64>) -> Result<(), Halted> {
        let Some(state) = state else { return Ok(()) };
        let mut chain = Digest::from_chain(self.chain);
        chain.u64(state);
        self.chain = chain.finish();
        if let Some(recorder) = &mut self.recorder {
            recorder.hashes.extend_from_slice(&short(self.chain).to_le_bytes());
        }
        if let Some(script) = &mut self.script
            && let Some(expected) = script.hash16()
            && expected != short(self.chain)
        {
            let found = format!("state hash {:04x}", short(self.chain));
            self.env
                .diverged(self.divergence(self.index - 1, format!("state hash {expected:04x}"), found), true);
            return Err(Halted);
        }
        Ok(())
    }

    /// Where hashes are of what is said: all that was said in a delivery, and the state that came of it.
    fn said_all(&mut self, state: Option<u64>) -> Result<(), Halted> {
        if let Some(state) = state {
            let mut chain = Digest::from_chain(self.chain);
            chain.u64(state);
            self.chain = chain.finish();
            self.speaks = true;
        }
        let speaks = std::mem::take(&mut self.speaks);
        let hash = if speaks { short(self.chain) } else { faint(self.chain) };
        self.handled = self.index;
        if let Some(recorder) = &mut self.recorder {
            recorder.said.push(u8::from(speaks));
            match speaks {
                true => recorder.hashes.extend_from_slice(&hash.to_le_bytes()),
                false => recorder.faint.push(hash as u8),
            }
        }
        if let Some(script) = &mut self.script
            && let Some((spoke, expected)) = script.said()
            && (spoke, expected) != (speaks, hash)
        {
            let told = |speaks: bool, hash: u16| match speaks {
                true => format!("hash {hash:04x} of what it says"),
                false => format!("nothing said, hash {hash:x}"),
            };
            let mut divergence = self.divergence(self.index - 1, told(spoke, expected), told(speaks, hash));
            divergence.said = Some(self.held.drain(..).map(|held| held.tell()).collect());
            self.env.diverged(divergence, true);
            return Err(Halted);
        }
        Ok(())
    }

    /// What was said in the delivery at hand is kept where somebody listens, and goes to whom it was said.
    #[inline]
    fn tell_all(&mut self, thread: &ThreadCx) {
        if self.listens() {
            self.env.hear(self.held.iter().map(|held| held.tell()).collect());
        }
        self.let_go(thread);
    }

    /// Replay: whether what is said in the delivery at hand is wanted: see [`crate::Config::listen_to`].
    #[inline]
    fn listens(&self) -> bool {
        self.env.listen_to.is_some_and(|(actor, index)| (actor, index + 1) == (self.id, self.index))
            && self.script.is_some()
    }

    /// What was said goes to whom it was said.
    pub(crate) fn let_go(&mut self, thread: &ThreadCx) {
        self.held.drain(..).for_each(|held| held.go(thread));
    }

    /// Replay: whether what is said waits until it is known that the recording has it, too, so that nobody is ever told
    /// what is wrong, and nothing that follows from it can come before it; or until it was listened to.
    #[inline]
    pub(crate) fn holds_back(&self) -> bool {
        self.script.is_some() && (self.hashing == Hashing::Said || self.listens())
    }

    pub(crate) fn hold_back(&mut self, held: Box<dyn Held>) {
        self.held.push(held);
    }

    /// A message's hash, where hashes are of what is said; 0 where they are not, or it cannot be told.
    #[inline]
    pub(crate) fn digest_of(&self, message: &impl Message) -> u64 {
        if self.hashing != Hashing::Said {
            return 0;
        }
        let hash = guarded(|| {
            let mut hash = Digest::new();
            message.digest(&mut hash);
            hash.finish().max(1)
        });
        hash.unwrap_or(0)
    }

    /// The actor says something to another.
    #[inline]
    pub(crate) fn says(&mut self, to: ActorId, lane: u8, hash: u64) {
        if self.hashing == Hashing::Said {
            let mut chain = Digest::from_chain(self.chain);
            chain.u64(u64::from(to.0) << 8 | u64::from(lane));
            chain.u64(hash);
            self.chain = chain.finish();
            self.speaks = true;
        }
    }

    fn compare(&mut self, symbol: Symbol, kind: &'static str) -> Result<(), Halted> {
        self.history.truncate(HISTORY - 1);
        let lane = lane::name(symbol.lane);
        self.history.push_front(Turn { index: self.index, from: symbol.from, lane, kind });
        let Some(script) = &mut self.script else { return Ok(()) };
        if let Some((index, tag)) = script.peek_value()
            && index < self.index + 1
        {
            let found = "none".to_owned();
            return self.diverge(index.saturating_sub(1), value::name(tag).to_owned(), found);
        }
        let (expected, found) = match script.hashing {
            Hashing::Exact => match script.hash16() {
                Some(expected) => (u64::from(expected), u64::from(short(self.chain))),
                None => return self.stop_here(),
            },
            Hashing::Every(_) if self.to_hash == 1 => match script.hash64() {
                Some(expected) => (expected, self.chain),
                None => return self.stop_here(),
            },
            _ => return self.stop_here(),
        };
        if expected != found {
            let since = match self.hashing {
                Hashing::Every(_) => {
                    format!(" of deliveries {} to {}", self.index + 1 - self.since_hash(), self.index)
                }
                _ => String::new(),
            };
            let (expected, found) = (format!("hash {expected:x}{since}"), format!("hash {found:x}"));
            return self.diverge(self.index, expected, found);
        }
        self.stop_here()
    }

    /// Whether replay was asked to stop at this delivery: it is still handled, and is the last one.
    fn stop_here(&self) -> Result<(), Halted> {
        self.env.stop_at_delivery(self.id, self.index);
        Ok(())
    }

    fn diverge(&self, index: u64, expected: String, found: String) -> Result<(), Halted> {
        self.env.diverged(self.divergence(index, expected, found), false);
        Err(Halted)
    }

    fn divergence(&self, index: u64, expected: String, found: String) -> Divergence {
        Divergence {
            actor: self.id,
            name: self.link.name.clone(),
            index,
            mark: self.env.last_mark(),
            kind: self.history.front().map_or("start", |turn| turn.kind),
            from: self.history.front().map(|turn| turn.from),
            expected,
            found,
            said: None,
            turns: self.history.iter().cloned().collect(),
        }
    }

    /// Replay and recording agree that something else comes next.
    pub(crate) fn diverge_here(&self, expected: String, found: String) {
        let _ = self.diverge(self.index, expected, found);
    }

    /// Deliveries from one sparse hash to the next.
    fn period_of_hashes(&self) -> u32 {
        if let Hashing::Every(period) = self.hashing { period.max(1) } else { u32::MAX }
    }

    /// Deliveries that the sparse hash at hand covers and the one before does not.
    fn since_hash(&self) -> u64 {
        u64::from(self.period_of_hashes()).min(self.index + 1)
    }

    /// What a snapshot keeps of it.
    pub(crate) fn state(&self) -> Option<JournalState> {
        let script = self.script.as_ref()?;
        Some(JournalState {
            index: self.index,
            chain: self.chain,
            sends: self.sends,
            jobs_made: self.jobs_made,
            randoms: self.randoms,
            speaks: self.speaks,
            sent: self.sent.clone(),
            seen: self.seen.clone(),
            walk: script.walk().clone(),
        })
    }

    pub(crate) fn restore(&mut self, state: JournalState) -> Option<()> {
        let JournalState { index, chain, sends, jobs_made, randoms, speaks, sent, seen, walk } = state;
        self.speaks = speaks;
        (self.index, self.chain, self.handled) = (index, chain, index);
        let period = self.period_of_hashes();
        self.to_hash = period - (index % u64::from(period)) as u32;
        (self.sends, self.jobs_made, self.randoms) = (sends, jobs_made, randoms);
        (self.sent, self.seen) = (sent, seen);
        self.script.as_mut()?.go_on_from(walk);
        Some(())
    }

    #[inline]
    pub(crate) fn replaying(&self) -> bool {
        self.script.is_some()
    }

    pub(crate) fn script(&mut self) -> Option<&mut Script> {
        self.script.as_deref_mut()
    }

    // --- the end of a turn ------------------------------------------------------------------------------------------

    /// Hands the log to the writer if there is enough of it, a period has passed, or `now` asks for it.
    #[inline]
    pub(crate) fn end_turn(&mut self, now: bool) {
        if self.recorder.is_some() {
            self.flush(now);
        }
    }

    fn flush(&mut self, now: bool) {
        if self.hashing == Hashing::Said
            && self.handled < self.index
            && let Some(recorder) = &mut self.recorder
        {
            // The turn broke off in it.
            recorder.said.push(0);
            recorder.faint.push(faint(self.chain) as u8);
            self.handled = self.index;
        }
        let (Some(recorder), Some(log)) = (&mut self.recorder, &self.env.log) else { return };
        if log.is_stopped() {
            self.recorder = None;
            self.held_back = None;
            self.link.unflushed.store(false, Ordering::Relaxed);
            return;
        }
        if let Some(chunk) = self.held_back.take() {
            self.held_back = log.push(chunk).err();
        }
        let period = log.period.load(Ordering::Relaxed);
        let due = now
            || recorder.len() >= CHUNK_BYTES
            || self.index - recorder.first >= CHUNK_DELIVERIES_MAX / 2
            || (period != self.period && recorder.first != self.index);
        if due && self.held_back.is_none() && (recorder.first != self.index || recorder.len() > 0) {
            // Where hashes are dense the end of the recording says it: it is eight bytes.
            let chain = if self.hashing == Hashing::Said { 0 } else { self.chain };
            let chunk = recorder.chunk(self.id, self.index, chain, self.declared);
            self.declared = recorder.symbols.len();
            self.period = period;
            self.held_back = log.push(chunk).err();
        }
        if recorder.len() > BACKLOG_BYTES_MAX {
            log.stop(format!("the disk is too slow for what {} does", self.link.name));
        }
        let unflushed = self.held_back.is_some() || recorder.first != self.index || recorder.len() > 0;
        self.link.unflushed.store(unflushed, Ordering::Relaxed);
    }
}

/// The 16 bits of a chained hash that are recorded. Every bit of the hash reaches them.
fn short(chain: u64) -> u16 {
    (chain.wrapping_mul(0xff51_afd7_ed55_8ccd) >> 48) as u16
}

/// The bits of it that are recorded where an actor says nothing.
fn faint(chain: u64) -> u16 {
    short(chain) >> (16 - FAINT_BITS)
}
