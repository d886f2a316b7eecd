//! Chunks in few bytes: what comes next in a log is mostly what came next before, so each bit is coded by how likely it
//! was where the same few bytes stood in front of it.
//!
//! Three such guesses, from none, two and four bytes before in the same stream of the same actor, are weighed by how good they were lately;
//! an arithmetic coder spends −log₂ of what the bit was given. All of it is whole numbers, so that every machine reads
//! what another one wrote. What follows from segment to segment is kept, so segments are read in order, as they are
//! anyway. Hashes have no pattern and take what they are long.

use super::format::{FAINT_BITS, STREAMS, stream};

/// Bodies that are longer are compressed otherwise: coding takes a microsecond for a byte.
pub(crate) const CODED_BYTES_MAX: usize = 1 << 20;

/// Slots of a table of guesses: such that all tables fit into a core's own cache.
const SLOTS: usize = 1 << 16;
/// Slots that lie together: those of four bits of a byte in one place.
const NIBBLE: usize = 16;
/// A guess forgets what it saw more bits ago than this.
const ASKED_MAX: u8 = 60;
/// Guesses for each bit.
const ORDERS: usize = 3;
/// Bits of a probability.
const SHIFT: u32 = 16;
/// Actors whose streams have histories of their own; further ones share them.
const ACTORS: usize = 256;

/// What a byte of a body is: streams by their numbers, then the rest.
type Field = usize;
const KIND: Field = STREAMS;
const LENGTH: Field = STREAMS + 1;
const ACTOR: Field = STREAMS + 2;
const COUNT: Field = STREAMS + 3;
const CHAIN: Field = STREAMS + 4;
const SYMBOLS: Field = STREAMS + 5;
const FROM: Field = STREAMS + 6;
const LANE: Field = STREAMS + 7;
const THERE: Field = STREAMS + 8;
/// And the lengths of the streams, from here on.
const STREAM_LENGTH: Field = STREAMS + 9;
const FIELDS: usize = STREAM_LENGTH + STREAMS;

/// Bits spent on each stream of an actor, in 65536ths, and on what is around all streams.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spent {
    pub(crate) streams: Vec<[u64; STREAMS]>,
    /// Bytes that were coded so.
    pub(crate) coded: [u64; STREAMS],
    pub(crate) around: u64,
}

/// A guess at one bit: its probability of being set, and how often it was asked.
#[derive(Clone, Copy)]
struct Slot {
    set: u16,
    asked: u8,
}

/// Where one is in a body.
#[derive(Clone, Copy)]
struct Grammar {
    field: Field,
    actor: usize,
    /// The number that is being read, and its bits so far.
    number: u64,
    shift: u32,
    /// Bytes of the chain, or symbols of the chunk, that are still to come.
    left: u64,
    there: u8,
    /// Bytes that the stream at hand still has.
    bytes: u64,
}

impl Grammar {
    fn new() -> Self {
        Self { field: KIND, actor: 0, number: 0, shift: 0, left: 0, there: 0, bytes: 0 }
    }

    /// Whether a number ends with this byte.
    fn number_ends(&mut self, byte: u8) -> Option<u64> {
        self.number |= u64::from(byte & 0x7f).checked_shl(self.shift).unwrap_or(0);
        self.shift += 7;
        if byte >= 0x80 && self.shift < 70 {
            return None;
        }
        self.shift = 0;
        Some(std::mem::take(&mut self.number))
    }

    /// The stream that comes next, or the next chunk.
    fn next_stream(&mut self) {
        self.field = match self.there.trailing_zeros() as usize {
            next @ ..STREAMS => {
                self.there &= self.there - 1;
                STREAM_LENGTH + next
            }
            _ => LENGTH,
        };
    }

    /// Passes a byte. Nonsense leads somewhere, too: it is for the reader to refuse it.
    fn pass(&mut self, byte: u8) {
        match self.field {
            KIND => self.field = LENGTH,
            CHAIN => {
                self.left = self.left.saturating_sub(1);
                if self.left == 0 {
                    self.field = SYMBOLS;
                }
            }
            LANE => {
                self.left = self.left.saturating_sub(1);
                self.field = if self.left == 0 { THERE } else { FROM };
            }
            THERE => {
                self.there = byte;
                self.next_stream();
            }
            ..STREAMS => {
                self.bytes = self.bytes.saturating_sub(1);
                if self.bytes == 0 {
                    self.next_stream();
                }
            }
            _ => {
                let Some(number) = self.number_ends(byte) else { return };
                match self.field {
                    LENGTH => self.field = ACTOR,
                    ACTOR => (self.actor, self.field) = ((number % ACTORS as u64) as usize, COUNT),
                    COUNT => (self.left, self.field) = (8, CHAIN),
                    SYMBOLS => {
                        (self.left, self.field) = (number, if number == 0 { THERE } else { FROM });
                    }
                    FROM => self.field = LANE,
                    field => {
                        self.bytes = number;
                        match number {
                            0 => self.next_stream(),
                            _ => self.field = field - STREAM_LENGTH,
                        }
                    }
                }
            }
        }
    }
}

/// What has been learnt of a recording's bytes so far. Writer and reader keep the same.
pub(crate) struct Model {
    slots: Vec<Slot>,
    /// For each field and each number of bits before: what each guess counts.
    weights: Vec<[i32; ORDERS]>,
    history: Vec<u32>,
    squash: Vec<u16>,
    stretch: Vec<i16>,
    /// What a guess moves by, of so many times asked: 65536ths of the way.
    steps: Vec<i64>,
    cost: Vec<u32>,
    pub(crate) spent: Spent,
}

/// Puts bits out, or takes them in: then `bit` is made of what is there.
trait Bits {
    fn code(&mut self, bit: bool, set: u32) -> bool;
}

impl Model {
    pub(crate) fn new() -> Self {
        // ln(p / (1 − p)) in 256ths for p in 4096ths, and its inverse, made of whole numbers alone.
        let squash: Vec<u16> = (-2047..=2047).map(squashed).collect();
        let mut stretch = vec![2047_i16; 4096];
        let mut at = 0;
        for (number, p) in squash.iter().enumerate() {
            while at <= usize::from(*p) {
                stretch[at] = number as i16 - 2047;
                at += 1;
            }
        }
        Self {
            slots: vec![Slot { set: 1 << 15, asked: 0 }; SLOTS * ORDERS],
            weights: vec![[(1 << 16) / 3; ORDERS]; FIELDS * 8],
            history: vec![0; ACTORS * FIELDS],
            squash,
            stretch,
            steps: (0..=i64::from(ASKED_MAX)).map(|asked| 2 * (1 << 16) / (2 * asked + 3)).collect(),
            cost: (0..4096).map(cost).collect(),
            spent: Spent::default(),
        }
    }

    /// The bytes of a body, coded.
    pub(crate) fn encode(&mut self, body: &[u8]) -> Vec<u8> {
        let (mut bits, mut grammar) = (Encoder::new(), Grammar::new());
        for byte in body {
            self.byte(&mut bits, &mut grammar, *byte);
        }
        bits.finish()
    }

    /// The body of so many bytes that was coded so.
    pub(crate) fn decode(&mut self, coded: &[u8], length: usize) -> Vec<u8> {
        let (mut bits, mut grammar) = (Decoder::new(coded), Grammar::new());
        (0..length).map(|_| self.byte(&mut bits, &mut grammar, 0)).collect()
    }

    fn byte(&mut self, bits: &mut impl Bits, grammar: &mut Grammar, byte: u8) -> u8 {
        let (field, actor) = (grammar.field, grammar.actor);
        let (width, patterned) = match field {
            stream::HASHES => (8, false),
            stream::FAINT => (FAINT_BITS, false),
            stream::SAID => (1, true),
            _ => (8, true),
        };
        let place = actor * FIELDS + field;
        let before = self.history[place];
        let of = |count: u32, seen: u32| {
            let mut hash = (place as u64) << 3 | u64::from(count);
            hash = hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ u64::from(seen);
            (hash.wrapping_mul(0xff51_afd7_ed55_8ccd) >> 16) as usize
        };
        let contexts = match field {
            // Its bytes follow each other without meaning one by one.
            CHAIN => [of(0, grammar.left as u32), of(1, 0), of(2, 0)],
            stream::SAID => [of(0, before & 0x3), of(1, before & 0xff), of(2, before & 0xffff)],
            _ => [of(0, 0), of(1, before & 0xffff), of(2, before)],
        };
        let (mut node, mut spent) = (1_usize, 0_u64);
        let mut begins = [0; ORDERS];
        for number in (0..width).rev() {
            let first = if number % 4 == 3 || number + 1 == width { node } else { 0 };
            if patterned && first > 0 {
                // Where the slots of the next four bits lie.
                begins = std::array::from_fn(|order| {
                    let place = contexts[order] ^ first.wrapping_mul(0x9e3_779b1);
                    order * SLOTS + (place & (SLOTS / NIBBLE - 1)) * NIBBLE
                });
            }
            let bit = byte >> number & 1 == 1;
            let bit = if patterned {
                // Within a nibble the bits so far begin with a one.
                let within = if node < NIBBLE {
                    node
                } else {
                    1 << (3 - number % 4) | node & ((1 << (3 - number % 4)) - 1)
                };
                let slots = begins.map(|begin| begin + within);
                let weights = field * 8 + number as usize;
                self.bit(bits, bit, slots, weights, &mut spent)
            } else {
                spent += 1 << SHIFT;
                bits.code(bit, 1 << (SHIFT - 1))
            };
            node = node << 1 | usize::from(bit);
        }
        let byte = (node & ((1 << width) - 1)) as u8;
        self.history[place] = if width == 1 { before << 1 } else { before << 8 } | u32::from(byte);
        if field < STREAMS {
            if self.spent.streams.len() <= actor {
                self.spent.streams.resize(actor + 1, [0; STREAMS]);
            }
            self.spent.streams[actor][field] += spent;
            self.spent.coded[field] += 1;
        } else {
            self.spent.around += spent;
        }
        grammar.pass(byte);
        byte
    }

    fn bit(
        &mut self,
        bits: &mut impl Bits,
        bit: bool,
        slots: [usize; ORDERS],
        weights: usize,
        spent: &mut u64,
    ) -> bool {
        let stretched = slots.map(|slot| i32::from(self.stretch[usize::from(self.slots[slot].set >> 4)]));
        let weighed: i64 =
            stretched.iter().zip(self.weights[weights]).map(|(s, w)| i64::from(*s) * i64::from(w)).sum();
        let sum = (weighed >> 16).clamp(-2047, 2047) as i32;
        let p = u32::from(self.squash[(sum + 2047) as usize]).clamp(1, 4095);
        let bit = bits.code(bit, p << 4);
        *spent += u64::from(self.cost[if bit { p } else { 4096 - p } as usize]);
        let error = (if bit { 4096 } else { 0 } - p as i32) * 14;
        for (weight, stretched) in self.weights[weights].iter_mut().zip(stretched) {
            *weight = (*weight + ((stretched * error + (1 << 15)) >> 16)).clamp(-(1 << 19), 1 << 19);
        }
        for slot in slots {
            let Slot { set, asked } = &mut self.slots[slot];
            let aim = if bit { 65535 } else { 0 };
            // As the mean of what was seen, until it has seen enough to forget.
            let step = ((aim - i64::from(*set)) * self.steps[usize::from(*asked)]) >> 16;
            *set = (i64::from(*set) + step).clamp(0, 65535) as u16;
            *asked = (*asked + 1).min(ASKED_MAX);
        }
        bit
    }
}

/// 4096 / (1 + e^(−x / 256)), from a table of its values at each 128th.
fn squashed(x: i32) -> u16 {
    const KNOWN: [i32; 33] = [
        1, 2, 3, 6, 10, 16, 27, 45, 73, 120, 194, 310, 488, 747, 1101, 1546, 2047, 2549, 2994, 3348, 3607,
        3785, 3901, 3975, 4022, 4050, 4068, 4079, 4085, 4089, 4092, 4093, 4094,
    ];
    let place = (x >> 7) + 16;
    let within = x & 127;
    let [low, high] = [KNOWN[place as usize], KNOWN[(place as usize + 1).min(32)]];
    ((low * (128 - within) + high * within + 64) >> 7) as u16
}

/// −log₂(p / 4096) in 65536ths.
fn cost(p: u32) -> u32 {
    // By squaring: each time it passes 2, a bit of the logarithm is set.
    let mut whole = 0;
    let mut number = u64::from(p.max(1)) << 32;
    while number < 1 << 44 {
        number <<= 1;
        whole += 1;
    }
    let mut fraction = 0_u32;
    let mut x = number >> 12;
    for _ in 0..16 {
        x = ((u128::from(x) * u128::from(x)) >> 32) as u64;
        fraction <<= 1;
        if x >= 2 << 32 {
            x >>= 1;
            fraction |= 1;
        }
    }
    (whole << 16) - fraction.min(whole << 16)
}

/// The interval that is left, of which every number says all bits so far.
struct Encoder {
    low: u32,
    high: u32,
    bytes: Vec<u8>,
}

fn split(low: u32, high: u32, set: u32) -> u32 {
    low + ((u64::from(high - low) * u64::from(set)) >> SHIFT) as u32
}

impl Encoder {
    fn new() -> Self {
        Self { low: 0, high: u32::MAX, bytes: Vec::new() }
    }

    /// As few bytes as say a number in the interval, whatever zeros are read behind them.
    fn finish(mut self) -> Vec<u8> {
        for length in 0..=4_u32 {
            let unit = 1_u64 << (32 - 8 * length);
            let number = u64::from(self.low).div_ceil(unit) * unit;
            if number <= u64::from(self.high) {
                self.bytes.extend_from_slice(&(number as u32).to_be_bytes()[..length as usize]);
                break;
            }
        }
        self.bytes
    }
}

impl Bits for Encoder {
    fn code(&mut self, bit: bool, set: u32) -> bool {
        let middle = split(self.low, self.high, set);
        (self.low, self.high) = if bit { (self.low, middle) } else { (middle + 1, self.high) };
        while (self.low ^ self.high) >> 24 == 0 {
            self.bytes.push((self.high >> 24) as u8);
            (self.low, self.high) = (self.low << 8, self.high << 8 | 0xff);
        }
        bit
    }
}

struct Decoder<'a> {
    low: u32,
    high: u32,
    number: u32,
    left: &'a [u8],
}

impl<'a> Decoder<'a> {
    fn new(coded: &'a [u8]) -> Self {
        let mut decoder = Self { low: 0, high: u32::MAX, number: 0, left: coded };
        (0..4).for_each(|_| decoder.take());
        decoder
    }

    fn take(&mut self) {
        let byte = self.left.split_off_first().copied().unwrap_or(0);
        self.number = self.number << 8 | u32::from(byte);
    }
}

impl Bits for Decoder<'_> {
    fn code(&mut self, _: bool, set: u32) -> bool {
        let middle = split(self.low, self.high, set);
        let bit = self.number <= middle;
        (self.low, self.high) = if bit { (self.low, middle) } else { (middle + 1, self.high) };
        while (self.low ^ self.high) >> 24 == 0 {
            (self.low, self.high) = (self.low << 8, self.high << 8 | 0xff);
            self.take();
        }
        bit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_coded_comes_back(bodies: Vec<Vec<u8>>) {
            let (mut writer, mut reader) = (Model::new(), Model::new());
            for body in bodies {
                // Streams of narrow symbols take no others.
                let mut grammar = Grammar::new();
                let body: Vec<u8> = body.into_iter().map(|byte| {
                    let byte = match grammar.field {
                        stream::SAID => byte & 1,
                        stream::FAINT => byte & 15,
                        _ => byte,
                    };
                    grammar.pass(byte);
                    byte
                }).collect();
                let coded = writer.encode(&body);
                prop_assert_eq!(reader.decode(&coded, body.len()), body);
            }
        }

        #[test]
        fn nonsense_is_read_to_its_end(coded: Vec<u8>, length in 0_usize..5000) {
            prop_assert_eq!(Model::new().decode(&coded, length).len(), length);
        }
    }

    #[test]
    fn costs_are_logarithms() {
        for (p, bits) in [(4096, 0.0), (2048, 1.0), (1024, 2.0), (3000, 0.449_2), (1, 12.0)] {
            let found = f64::from(cost(p)) / 65536.0;
            assert!((found - bits).abs() < 1e-3, "{p}: {found} for {bits}");
        }
    }
}
