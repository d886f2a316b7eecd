//! What is recorded of one actor and not yet with the writer.

use std::collections::BTreeMap;

use crate::log::format::{Payload, Symbol, put, put_bytes, put_run, put_signed, value};
use crate::message::ActorId;

/// Senders of an actor among which a sender is searched one by one.
const SYMBOLS_SEARCHED: usize = 16;

/// The log of one actor that is not yet with the writer.
#[derive(Default)]
pub(super) struct Recorder {
    pub(super) first: u64,
    pub(super) order: Vec<u8>,
    /// The run at hand: whose messages, that sender's number, how many.
    pub(super) run: Option<(Symbol, u32, u64)>,
    pub(super) symbols: Vec<Symbol>,
    /// Numbers of those that are not searched one by one.
    pub(super) numbers: BTreeMap<Symbol, u32>,
    pub(super) external: Vec<u8>,
    pub(super) last_job: u64,
    pub(super) last_timer: u64,
    pub(super) values: Vec<u8>,
    pub(super) last_value: u64,
    pub(super) last_now: u64,
    pub(super) hashes: Vec<u8>,
    pub(super) rejected: Vec<u8>,
    pub(super) said: Vec<u8>,
    pub(super) faint: Vec<u8>,
    pub(super) last_rejected: u64,
}

impl Recorder {
    #[inline]
    pub(super) fn delivery(&mut self, symbol: Symbol, payload: Payload<'_>) {
        match &mut self.run {
            Some((of, _, length)) if *of == symbol => *length += 1,
            _ => self.next_run(symbol),
        }
        match payload {
            Payload::None => {}
            Payload::External(bytes) => put_bytes(&mut self.external, bytes),
            Payload::Skipped(count) => put(&mut self.external, u64::from(count)),
            Payload::Timer { timer, time } => {
                put(&mut self.external, u64::from(timer));
                put_signed(&mut self.external, time.wrapping_sub(self.last_timer) as i64);
                self.last_timer = time;
            }
            Payload::Order(bits) => put(&mut self.external, u64::from(bits)),
            Payload::Job { id, attempt } => {
                put_signed(&mut self.external, id.wrapping_sub(self.last_job) as i64);
                if attempt > 0 {
                    put(&mut self.external, u64::from(attempt));
                }
                self.last_job = id;
            }
        }
    }

    fn next_run(&mut self, symbol: Symbol) {
        self.end_run();
        self.run = Some((symbol, self.number(symbol), 1));
    }

    fn number(&mut self, symbol: Symbol) -> u32 {
        let known = match self.symbols.iter().take(SYMBOLS_SEARCHED).position(|known| *known == symbol) {
            Some(known) => Some(known as u32),
            None => self.numbers.get(&symbol).copied(),
        };
        known.unwrap_or_else(|| {
            let number = self.symbols.len();
            self.symbols.push(symbol);
            if number >= SYMBOLS_SEARCHED {
                self.numbers.insert(symbol, number as u32);
            }
            number as u32
        })
    }

    fn end_run(&mut self) {
        if let Some((_, number, length)) = self.run.take() {
            put_run(&mut self.order, number, length);
        }
    }

    pub(super) fn value(&mut self, index: u64, tag: u8) {
        put(&mut self.values, (index - self.last_value) << value::TAG_BITS | u64::from(tag));
        self.last_value = index;
    }

    pub(super) fn len(&self) -> usize {
        let streams = [&self.order, &self.external, &self.values, &self.hashes, &self.rejected, &self.said];
        streams.iter().map(|stream| stream.len()).sum::<usize>() + self.faint.len()
    }

    /// Everything since the last chunk, as the bytes of one.
    pub(super) fn chunk(&mut self, id: ActorId, index: u64, chain: u64, declared: usize) -> Vec<u8> {
        self.end_run();
        let mut bytes = Vec::with_capacity(self.len() + 32);
        put(&mut bytes, u64::from(id.0));
        put(&mut bytes, index - self.first);
        bytes.extend_from_slice(&chain.to_le_bytes());
        let new = &self.symbols[declared..];
        put(&mut bytes, new.len() as u64);
        for symbol in new {
            put(&mut bytes, u64::from(symbol.from.0));
            bytes.push(symbol.lane);
        }
        let Self { order, external, values, hashes, rejected, said, faint, .. } = self;
        let streams = [order, external, values, hashes, rejected, said, faint];
        let there = streams.iter().enumerate().map(|(bit, stream)| u8::from(!stream.is_empty()) << bit).sum();
        bytes.push(there);
        for stream in streams.into_iter().filter(|stream| !stream.is_empty()) {
            put_bytes(&mut bytes, stream);
            stream.clear();
        }
        self.first = index;
        bytes
    }
}
