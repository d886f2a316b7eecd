//! What `#[derive(Message)]` makes: every field is in the digest and comes back from a snapshot.

use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Part {
    words: Vec<u16>,
    inner: (i8, Option<f64>),
}

#[derive(Clone, Debug, PartialEq, Message)]
enum Told {
    Many {
        flag: bool,
        number: i64,
        real: f32,
        text: String,
        list: Vec<u8>,
        fixed: [u32; 3],
        part: Part,
        shared: Arc<Vec<f32>>,
        #[message(skip = "a test of what is left out")]
        left_out: u8,
    },
    Pair(u32, Option<u32>),
    Other(u32, Option<u32>),
    #[message(lane = control, size = 7 + _0.len())]
    Urgent(String),
    #[message(lane = latest(3), kind = "Renamed")]
    Newest,
    #[message(unsaved = "a test of what is not saved")]
    Unsaved {
        #[message(with = hashed)]
        instant: Opaque,
    },
}

/// Without serde's traits.
#[derive(Clone, Debug, PartialEq)]
struct Opaque(u64);

mod hashed {
    pub fn digest(value: &super::Opaque, digest: &mut foveal_runtime::Digest) {
        digest.u64(value.0);
    }

    pub fn content(value: &super::Opaque) -> foveal_runtime::Content {
        foveal_runtime::Content::of(&value.0)
    }
}

fn hash(told: &Told) -> u64 {
    let mut digest = Digest::new();
    told.digest(&mut digest);
    digest.finish()
}

fn many(change: usize) -> Told {
    let pick = |at: usize, other: u8| if change == at { other } else { 0 };
    Told::Many {
        flag: change == 1,
        number: -i64::from(pick(2, 1)),
        // Minus zero is another number.
        real: if change == 3 { -0.0 } else { 0.0 },
        text: if change == 4 { "a".into() } else { String::new() },
        list: vec![0; usize::from(pick(5, 1))],
        fixed: [1, 2, 3 + u32::from(pick(6, 1))],
        part: Part {
            words: vec![9, u16::from(pick(7, 1))],
            inner: (if change == 8 { -1 } else { 1 }, (change == 9).then_some(0.0)),
        },
        shared: Arc::new(vec![1.0, if change == 10 { 1.5 } else { 2.0 }]),
        left_out: pick(11, 1),
    }
}

#[test]
fn every_field_is_in_the_digest() {
    let plain = hash(&many(0));
    for change in 1..=10 {
        assert_ne!(hash(&many(change)), plain, "change {change}");
        assert_eq!(hash(&many(change)), hash(&many(change)));
    }
    assert_eq!(hash(&many(11)), plain, "left out, and says why");
    let variants =
        [Told::Pair(1, None), Told::Other(1, None), Told::Pair(0, Some(1)), Told::Pair(1, Some(0))];
    for (at, one) in variants.iter().enumerate() {
        variants[..at].iter().for_each(|other| assert_ne!(hash(one), hash(other), "{one:?} {other:?}"));
    }
    assert_ne!(hash(&Told::Unsaved { instant: Opaque(1) }), hash(&Told::Unsaved { instant: Opaque(2) }));
}

#[test]
fn every_field_is_told() {
    for change in 1..=11 {
        let differences = many(0).content().differences(&many(change).content());
        assert_eq!(differences.len(), 1, "change {change}: {differences:?}");
    }
    let told = many(6).content();
    assert_eq!(told.at("fixed.2").and_then(Content::number), Some(4.0));
    assert_eq!(Told::Pair(1, None).content().to_string(), "Pair { 0: 1, 1: none }");
    assert_eq!(Told::Newest.content().to_string(), "Renamed");
    assert_eq!(Told::Unsaved { instant: Opaque(3) }.content().to_string(), "Unsaved { instant: 3 }");
}

#[test]
fn long_content_is_in_the_digest() {
    // Long texts and lists of bytes take another way through the hash than short ones.
    for length in [0, 1, 7, 8, 9, 64, 65, 1000] {
        let text = "x".repeat(length);
        let other = format!("{text}y");
        assert_ne!(hash(&Told::Urgent(text.clone())), hash(&Told::Urgent(other)), "{length}");
        for at in 0..length {
            let mut other = text.clone().into_bytes();
            other[at] = b'z';
            let other = String::from_utf8(other).expect("ascii");
            assert_ne!(hash(&Told::Urgent(text.clone())), hash(&Told::Urgent(other)), "{length} {at}");
        }
    }
}

#[test]
fn kinds_lanes_and_sizes_are_as_said() {
    let told = |told: Told| (told.kind(), told.lane(), told.size_bytes());
    assert_eq!(told(many(0)), ("Many", Lane::Data, 0));
    assert_eq!(told(Told::Urgent("abc".into())), ("Urgent", Lane::Control, 10));
    assert_eq!(told(Told::Newest), ("Renamed", Lane::Latest(3), 0));
}
