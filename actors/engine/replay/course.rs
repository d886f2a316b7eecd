//! How something a recording tells goes on, delivery by delivery, in few bytes: what is there at first as a whole, then what
//! becomes another.
//!
//! A stream of entries: how many deliveries after the one before, and a change. A change is a value in the place of the
//! one that stood there, or, of named values, which of them change to what. Numbers are little-endian; lengths and steps
//! have seven bits in a byte.

use foveal_runtime::{Content, List};

/// Values within each other, at most.
const DEPTH: usize = 64;

mod tag {
    pub(super) const UNTOLD: u8 = 0;
    pub(super) const FALSE: u8 = 1;
    pub(super) const TRUE: u8 = 2;
    pub(super) const COUNT: u8 = 3;
    pub(super) const NEGATIVE: u8 = 4;
    pub(super) const SINGLE: u8 = 5;
    pub(super) const DOUBLE: u8 = 6;
    pub(super) const NAME: u8 = 7;
    pub(super) const TEXT: u8 = 8;
    pub(super) const LIST: u8 = 9;
    pub(super) const FIELDS: u8 = 10;
    pub(super) const VARIANT: u8 = 11;
    /// Of the fields that stand there.
    pub(super) const CHANGES: u8 = 12;
    /// Nothing is seen at this delivery.
    pub(super) const UNSEEN: u8 = 13;
}

/// Writes how something goes on.
#[derive(Default)]
pub(super) struct Writer {
    last: Option<Content>,
    /// The delivery of the last entry, and one more.
    next: u64,
    bytes: Vec<u8>,
}

impl Writer {
    /// What is there at a delivery; written where it is another than before.
    pub(super) fn stands(&mut self, index: u64, content: Content) {
        if self.last.as_ref() != Some(&content) {
            self.comes(index, content);
        }
    }

    /// What comes at a delivery, written also where it is as before.
    pub(super) fn comes(&mut self, index: u64, content: Content) {
        self.step(index);
        match &self.last {
            Some(last) => change(&mut self.bytes, last, &content),
            None => value(&mut self.bytes, &content),
        }
        self.last = Some(content);
    }

    /// At this delivery nothing is seen.
    pub(super) fn is_unseen(&mut self, index: u64) {
        self.step(index);
        self.bytes.push(tag::UNSEEN);
    }

    fn step(&mut self, index: u64) {
        length(&mut self.bytes, index - self.next);
        self.next = index + 1;
    }

    /// Bytes so far.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }

    /// All of it.
    pub(super) fn end(self) -> Vec<u8> {
        self.bytes
    }
}

/// Reads it again.
pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    next: u64,
    now: Content,
}

impl<'a> Reader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, next: 0, now: Content::Untold }
    }

    /// The next entry: at which delivery, and what is there then, or nothing where nothing is seen. `None` at the end, and
    /// `Some(None)` where the bytes are none that a [`Writer`] made.
    pub(super) fn entry(&mut self) -> Option<Option<(u64, Option<&Content>)>> {
        if self.bytes.is_empty() {
            return None;
        }
        Some(self.read())
    }

    fn read(&mut self) -> Option<(u64, Option<&Content>)> {
        let index = self.next.checked_add(read_length(&mut self.bytes)?)?;
        self.next = index.checked_add(1)?;
        if self.bytes.first() == Some(&tag::UNSEEN) {
            self.bytes = &self.bytes[1..];
            return Some((index, None));
        }
        apply(&mut self.bytes, &mut self.now, DEPTH)?;
        Some((index, Some(&self.now)))
    }
}

pub(super) fn length(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    length(bytes, text.len() as u64);
    bytes.extend_from_slice(text.as_bytes());
}

fn value(bytes: &mut Vec<u8>, content: &Content) {
    match content {
        Content::Untold => bytes.push(tag::UNTOLD),
        Content::Flag(flag) => bytes.push(if *flag { tag::TRUE } else { tag::FALSE }),
        Content::Count(number) => {
            bytes.push(tag::COUNT);
            length(bytes, *number);
        }
        Content::Negative(number) => {
            bytes.push(tag::NEGATIVE);
            length(bytes, *number as u64);
        }
        Content::Single(number) => {
            bytes.push(tag::SINGLE);
            bytes.extend_from_slice(&number.to_bits().to_le_bytes());
        }
        Content::Double(number) => {
            bytes.push(tag::DOUBLE);
            bytes.extend_from_slice(&number.to_bits().to_le_bytes());
        }
        Content::Name(name) => {
            bytes.push(tag::NAME);
            text(bytes, name);
        }
        Content::Text(told) => {
            bytes.push(tag::TEXT);
            text(bytes, told);
        }
        Content::List(list) => {
            bytes.push(tag::LIST);
            length(bytes, list.length as u64);
            bytes.extend_from_slice(&list.hash.to_le_bytes());
            bytes.push(u8::from(list.extremes.is_some()));
            let extremes = list.extremes.iter().flatten();
            extremes.for_each(|number| bytes.extend_from_slice(&number.to_bits().to_le_bytes()));
            length(bytes, list.items.len() as u64);
            list.items.iter().for_each(|item| value(bytes, item));
        }
        Content::Fields { variant, fields } => {
            match variant {
                Some(name) => {
                    bytes.push(tag::VARIANT);
                    text(bytes, name);
                }
                None => bytes.push(tag::FIELDS),
            }
            length(bytes, fields.len() as u64);
            for (name, content) in fields {
                text(bytes, name);
                value(bytes, content);
            }
        }
    }
}

/// What makes one value another.
fn change(bytes: &mut Vec<u8>, from: &Content, to: &Content) {
    let (Content::Fields { variant: a, fields: before }, Content::Fields { variant: b, fields: after }) =
        (from, to)
    else {
        return value(bytes, to);
    };
    let is_alike = a == b && before.len() == after.len();
    if !is_alike || before.iter().zip(after).any(|((a, _), (b, _))| a != b) {
        return value(bytes, to);
    }
    bytes.push(tag::CHANGES);
    let mut next = 0;
    for (number, ((_, from), (_, to))) in before.iter().zip(after).enumerate() {
        if from != to {
            // One more, since none ends them.
            length(bytes, (number - next + 1) as u64);
            next = number + 1;
            change(bytes, from, to);
        }
    }
    bytes.push(0);
}

fn byte(bytes: &mut &[u8]) -> Option<u8> {
    let (first, rest) = bytes.split_first()?;
    *bytes = rest;
    Some(*first)
}

fn array<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk()?;
    *bytes = rest;
    Some(*first)
}

pub(super) fn read_length(bytes: &mut &[u8]) -> Option<u64> {
    let mut number = 0;
    for shift in (0..64).step_by(7) {
        let part = byte(bytes)?;
        number |= u64::from(part & 0x7f) << shift;
        if part & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}

fn read_text(bytes: &mut &[u8]) -> Option<String> {
    let length = read_length(bytes)? as usize;
    let (text, rest) = bytes.split_at_checked(length)?;
    *bytes = rest;
    Some(std::str::from_utf8(text).ok()?.to_owned())
}

/// A number of things that take a byte each at least.
fn read_count(bytes: &mut &[u8]) -> Option<usize> {
    read_length(bytes).map(|count| count as usize).filter(|count| *count <= bytes.len())
}

fn read_value(tag: u8, bytes: &mut &[u8], depth: usize) -> Option<Content> {
    let depth = depth.checked_sub(1)?;
    Some(match tag {
        tag::UNTOLD => Content::Untold,
        tag::FALSE => Content::Flag(false),
        tag::TRUE => Content::Flag(true),
        tag::COUNT => Content::Count(read_length(bytes)?),
        tag::NEGATIVE => Content::Negative(read_length(bytes)? as i64),
        tag::SINGLE => Content::Single(f32::from_bits(u32::from_le_bytes(array(bytes)?))),
        tag::DOUBLE => Content::Double(f64::from_bits(u64::from_le_bytes(array(bytes)?))),
        tag::NAME => Content::Name(read_text(bytes)?.into()),
        tag::TEXT => Content::Text(read_text(bytes)?),
        tag::LIST => {
            let length = read_length(bytes)? as usize;
            let hash = u64::from_le_bytes(array(bytes)?);
            let extremes = match byte(bytes)? {
                0 => None,
                _ => Some([f64::from_le_bytes(array(bytes)?), f64::from_le_bytes(array(bytes)?)]),
            };
            let count = read_count(bytes)?;
            let mut items = Vec::with_capacity(count.min(256));
            for _ in 0..count {
                let tag = byte(bytes)?;
                items.push(read_value(tag, bytes, depth)?);
            }
            Content::List(List { length, items, hash, extremes })
        }
        tag::FIELDS | tag::VARIANT => {
            let variant = if tag == tag::VARIANT { Some(read_text(bytes)?.into()) } else { None };
            let count = read_count(bytes)?;
            let mut fields = Vec::with_capacity(count.min(256));
            for _ in 0..count {
                let name = read_text(bytes)?;
                let tag = byte(bytes)?;
                fields.push((name.into(), read_value(tag, bytes, depth)?));
            }
            Content::Fields { variant, fields }
        }
        _ => return None,
    })
}

/// Makes of what stands there what comes next.
fn apply(bytes: &mut &[u8], now: &mut Content, depth: usize) -> Option<()> {
    let tag = byte(bytes)?;
    if tag != tag::CHANGES {
        *now = read_value(tag, bytes, depth)?;
        return Some(());
    }
    let depth = depth.checked_sub(1)?;
    let Content::Fields { fields, .. } = now else { return None };
    let mut next = 0_usize;
    loop {
        let step = read_length(bytes)? as usize;
        if step == 0 {
            return Some(());
        }
        let number = next.checked_add(step - 1)?;
        apply(bytes, &mut fields.get_mut(number)?.1, depth)?;
        next = number + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(count: u64, single: f32, list: &[f32]) -> Content {
        Content::fields([
            ("count", Content::of(&count)),
            ("below", Content::of(&-3_i64)),
            ("inner", Content::fields([("single", Content::of(&single)), ("flag", Content::Flag(true))])),
            ("list", Content::of(list)),
            ("kind", Content::variant("Ball", [("radius", Content::Double(0.5))])),
            ("name", Content::Text("hall".into())),
            ("none", Content::Name("none".into())),
        ])
    }

    #[test]
    fn what_is_written_is_read() {
        let long: Vec<f32> = (0..300).map(|i| i as f32).collect();
        let states = [
            state(1, 0.0, &[1.0, 2.0]),
            state(1, -0.0, &[1.0, 2.0]),
            state(300, f32::NAN, &long),
            Content::Name("gone".into()),
            state(300, 1e30, &[]),
        ];
        let mut writer = Writer::default();
        for (number, state) in (0..).zip(&states) {
            writer.stands(7 + number * 200, state.clone());
            // Nothing new takes nothing.
            let before = writer.len();
            writer.stands(8 + number * 200, state.clone());
            assert_eq!(writer.len(), before);
        }
        writer.is_unseen(5000);
        writer.comes(5001, states[4].clone());
        let bytes = writer.end();
        let mut reader = Reader::new(&bytes);
        for (number, state) in (0..).zip(&states) {
            let (index, now) = reader.entry().flatten().expect("an entry");
            assert_eq!((index, now), (7 + number * 200, Some(state)));
            assert_eq!(now.map(Content::to_string), Some(state.to_string()));
        }
        assert_eq!(reader.entry(), Some(Some((5000, None))));
        assert_eq!(reader.entry(), Some(Some((5001, Some(&states[4])))));
        assert_eq!(reader.entry(), None);
    }

    #[test]
    fn few_changes_take_few_bytes() {
        let mut writer = Writer::default();
        writer.stands(0, state(1, 0.5, &[1.0]));
        let whole = writer.len();
        writer.stands(1, state(2, 0.5, &[1.0]));
        assert!(whole > 80 && writer.len() - whole <= 6, "{whole}, {}", writer.len());
    }

    #[test]
    fn damaged_bytes_end() {
        let mut writer = Writer::default();
        (0..20).for_each(|i| writer.comes(i, state(i, i as f32, &[i as f32; 3])));
        let bytes = writer.end();
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut bytes = bytes.clone();
                bytes[at] ^= 1 << bit;
                let mut reader = Reader::new(&bytes[..bytes.len() - at % 3]);
                while reader.entry().is_some_and(|entry| entry.is_some()) {}
            }
        }
    }
}
