//! How long work takes in a simulation, and the random numbers that say so.

use crate::message::Digest;

/// Virtual time of one heavy turn, in nanoseconds.
pub(crate) const HEAVY_NS: u64 = 500_000;

/// How much virtual time work takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Work {
    /// Each turn takes a constant by its actor's class, and [`crate::Cx::measure`] finds nothing.
    #[default]
    Constant,
    /// Turns and what is measured in them take what the seed says, each another time.
    Seeded,
    /// Heavy turns and what is measured take the processor time that this thread really spends on them; light turns a
    /// constant. Such a run is never the same twice; its recording replays like any other.
    Measured,
}

impl Work {
    /// Duration number `count` under a seed, an eighth to sixteen times `nominal`.
    pub(crate) fn draw(seed: u64, count: u64, nominal: u64) -> u64 {
        let mut random = Random::new(&[seed, count, 0x71e5]);
        let least = (nominal / 8).max(1) << random.below(7);
        least + random.below(least)
    }
}

/// A stream of random numbers: hashes of a key and a counter.
pub(crate) struct Random {
    key: Digest,
    count: u64,
}

impl Random {
    pub(crate) fn new(key: &[u64]) -> Self {
        let mut digest = Digest::new();
        key.iter().for_each(|word| digest.u64(*word));
        Self { key: digest, count: 0 }
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.count += 1;
        let mut hash = self.key;
        hash.u64(self.count);
        hash.u64(self.count ^ 0x5555);
        hash.finish()
    }

    /// A number below `end` (> 0).
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(end)) >> 64) as u64
    }
}
