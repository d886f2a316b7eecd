//! What messages and states say, as a tree that is printed, searched and compared.
//!
//! Made from what serde knows of a value, or field by field. Large buffers are told by length, hash and extremes.

mod teller;

use std::borrow::Cow;
use std::fmt;

use serde::ser::{SerializeMap, SerializeSeq};
use serde::{Serialize, Serializer};

use crate::message::Digest;

/// Items of a list that are kept one by one, at most.
const KEPT: usize = 256;
/// Items of a list that a line shows, at most.
const SHOWN: usize = 8;

/// A value as a tree.
#[derive(Clone, Debug, Default)]
pub enum Content {
    /// Nobody says.
    #[default]
    Untold,
    /// True or false.
    Flag(bool),
    /// A number that is not below 0.
    Count(u64),
    /// A number below 0.
    Negative(i64),
    /// A number of 32 bits.
    Single(f32),
    /// A number of 64 bits.
    Double(f64),
    /// A name: of a variant without fields, or `none`.
    Name(Cow<'static, str>),
    /// A text.
    Text(String),
    /// A list, a tuple or bytes.
    List(List),
    /// Named values: those of a struct, of a variant (which has a name), or of a map.
    Fields {
        /// The variant's name.
        variant: Option<Cow<'static, str>>,
        /// Names and values, in their order.
        fields: Vec<(Cow<'static, str>, Content)>,
    },
}

/// Values in a row.
#[derive(Clone, Debug)]
pub struct List {
    /// How many there are.
    pub length: usize,
    /// All of them, or none where there are many.
    pub items: Vec<Content>,
    /// Hash of all.
    pub hash: u64,
    /// Least and greatest of all numbers in it; `None` where there are none but NaN.
    pub extremes: Option<[f64; 2]>,
}

/// Where two trees differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Names and numbers on the way there, with points between them; empty for the whole.
    pub path: String,
    /// What stands there in the first one; [`Content::Untold`] where there is nothing.
    pub left: Content,
    /// The same of the second one.
    pub right: Content,
}

impl Content {
    /// What serde knows of a value.
    pub fn of(value: &(impl Serialize + ?Sized)) -> Self {
        value.serialize(teller::Teller).unwrap_or_default()
    }

    /// Named values.
    pub fn fields<N: Into<Cow<'static, str>>>(fields: impl IntoIterator<Item = (N, Self)>) -> Self {
        let fields = fields.into_iter().map(|(name, value)| (name.into(), value)).collect();
        Self::Fields { variant: None, fields }
    }

    /// A variant with its named values.
    pub fn variant<N: Into<Cow<'static, str>>>(
        name: impl Into<Cow<'static, str>>,
        fields: impl IntoIterator<Item = (N, Self)>,
    ) -> Self {
        let (name, mut fields): (Cow<'static, str>, Vec<_>) =
            (name.into(), fields.into_iter().map(|(name, value)| (name.into(), value)).collect());
        match &fields[..] {
            [] => Self::Name(name),
            // A variant that goes by the name of the only one it holds.
            [(_, Self::Fields { variant: Some(held), .. } | Self::Name(held))] if *held == name => {
                fields.swap_remove(0).1
            }
            _ => Self::Fields { variant: Some(name), fields },
        }
    }

    /// Values in a row.
    pub fn list(items: impl IntoIterator<Item = Self>) -> Self {
        let mut list = teller::Row::default();
        items.into_iter().for_each(|item| list.add(item));
        list.end()
    }

    /// What stands at the end of a path: names of fields and numbers of items, with points between them.
    pub fn at(&self, path: &str) -> Option<&Self> {
        path.split('.').filter(|step| !step.is_empty()).try_fold(self, |here, step| match here {
            Self::Fields { fields, .. } => {
                fields.iter().find(|(name, _)| name == step).map(|(_, value)| value)
            }
            Self::List(list) => list.items.get(step.parse::<usize>().ok()?),
            _ => None,
        })
    }

    /// As a number, where it is one: a list's is its length.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Count(number) => Some(*number as f64),
            Self::Negative(number) => Some(*number as f64),
            Self::Single(number) => Some(f64::from(*number)),
            Self::Double(number) => Some(*number),
            Self::List(list) => Some(list.length as f64),
            _ => None,
        }
    }

    /// All places where two trees differ. Numbers differ by their bits.
    pub fn differences(&self, other: &Self) -> Vec<Difference> {
        let mut found = Vec::new();
        self.compare(other, String::new(), &mut found);
        found
    }

    fn compare(&self, other: &Self, path: String, found: &mut Vec<Difference>) {
        let below = |step: &str| if path.is_empty() { step.to_owned() } else { format!("{path}.{step}") };
        match (self, other) {
            (Self::Fields { variant: a, fields: left }, Self::Fields { variant: b, fields: right })
                if a == b =>
            {
                for (name, value) in left {
                    let there = right.iter().find(|(other, _)| other == name).map(|(_, value)| value);
                    value.compare(there.unwrap_or(&Self::Untold), below(name), found);
                }
                for (name, value) in right.iter().filter(|(name, _)| left.iter().all(|(n, _)| n != name)) {
                    Self::Untold.compare(value, below(name), found);
                }
            }
            (Self::List(left), Self::List(right))
                if left.length == right.length
                    && [left, right].iter().all(|list| list.items.len() == list.length) =>
            {
                for (number, (a, b)) in left.items.iter().zip(&right.items).enumerate() {
                    a.compare(b, below(&number.to_string()), found);
                }
            }
            _ if self == other => {}
            _ => found.push(Difference { path, left: self.clone(), right: other.clone() }),
        }
    }

    /// One line for each value that is no tree itself: its path, and what stands there.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        self.each(String::new(), &mut |path, value| {
            lines.push(if path.is_empty() { value.to_string() } else { format!("{path} = {value}") });
        });
        lines
    }

    fn each(&self, path: String, told: &mut impl FnMut(&str, &Self)) {
        let below = |step: &str| if path.is_empty() { step.to_owned() } else { format!("{path}.{step}") };
        match self {
            Self::Fields { fields, .. } => {
                fields.iter().for_each(|(name, value)| value.each(below(name), told));
            }
            Self::List(list) if list.items.iter().any(|item| matches!(item, Self::Fields { .. })) => {
                let items = list.items.iter().enumerate();
                items.for_each(|(number, item)| item.each(below(&number.to_string()), told));
            }
            value => told(&path, value),
        }
    }

    /// Adds everything to a hash.
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Untold => digest.u32(0),
            Self::Flag(flag) => digest.u32(1 + u32::from(*flag)),
            Self::Count(number) => digest.u64(*number),
            Self::Negative(number) => digest.u64(*number as u64),
            Self::Single(number) => digest.f32(*number),
            Self::Double(number) => digest.f64(*number),
            Self::Name(text) => digest.bytes(text.as_bytes()),
            Self::Text(text) => digest.bytes(text.as_bytes()),
            Self::List(list) => digest.u64(list.hash),
            Self::Fields { variant, fields } => {
                digest.bytes(variant.as_deref().unwrap_or_default().as_bytes());
                fields.iter().for_each(|(name, value)| {
                    digest.bytes(name.as_bytes());
                    value.digest(digest);
                });
            }
        }
    }

    /// Least and greatest of the numbers in it.
    fn extremes(&self) -> Option<[f64; 2]> {
        match self {
            Self::List(list) => list.extremes,
            Self::Fields { fields, .. } => {
                fields.iter().filter_map(|(_, value)| value.extremes()).reduce(wider)
            }
            _ => self.number().filter(|number| !number.is_nan()).map(|number| [number; 2]),
        }
    }
}

fn wider(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

impl PartialEq for Content {
    /// Numbers are equal where their bits are.
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Untold, Self::Untold) => true,
            (Self::Flag(a), Self::Flag(b)) => a == b,
            (Self::Count(a), Self::Count(b)) => a == b,
            (Self::Negative(a), Self::Negative(b)) => a == b,
            (Self::Single(a), Self::Single(b)) => a.to_bits() == b.to_bits(),
            (Self::Double(a), Self::Double(b)) => a.to_bits() == b.to_bits(),
            (Self::Name(a), Self::Name(b)) => a == b,
            (Self::Text(a), Self::Text(b)) => a == b,
            (Self::List(a), Self::List(b)) => a.length == b.length && a.hash == b.hash,
            (Self::Fields { variant: a, fields: left }, Self::Fields { variant: b, fields: right }) => {
                a == b && left == right
            }
            _ => false,
        }
    }
}

impl Eq for Content {}

impl fmt::Display for Content {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Untold => f.write_str("untold"),
            Self::Flag(flag) => write!(f, "{flag}"),
            Self::Count(number) => write!(f, "{number}"),
            Self::Negative(number) => write!(f, "{number}"),
            // Not a hundred zeros where a number is huge or tiny.
            Self::Single(number) => write!(f, "{number:?}"),
            Self::Double(number) => write!(f, "{number:?}"),
            Self::Name(name) => f.write_str(name),
            Self::Text(text) => write!(f, "{text:?}"),
            Self::List(list) => list.fmt(f),
            Self::Fields { variant, fields } => {
                if let Some(variant) = variant {
                    write!(f, "{variant} ")?;
                }
                f.write_str("{")?;
                for (number, (name, value)) in fields.iter().enumerate() {
                    write!(f, "{} {name}: {value}", if number == 0 { "" } else { "," })?;
                }
                f.write_str(if fields.is_empty() { "}" } else { " }" })
            }
        }
    }
}

impl fmt::Display for List {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.items.len() == self.length && self.length <= SHOWN {
            f.write_str("[")?;
            for (number, item) in self.items.iter().enumerate() {
                write!(f, "{}{item}", if number == 0 { "" } else { ", " })?;
            }
            return f.write_str("]");
        }
        write!(f, "[{} of hash {:016x}", self.length, self.hash)?;
        match self.extremes {
            Some([least, greatest]) => write!(f, ", {least:?} to {greatest:?}]"),
            None => f.write_str("]"),
        }
    }
}

/// A number as JSON has it, or its name.
fn finite<S: Serializer>(number: f64, serializer: S) -> Result<S::Ok, S::Error> {
    if number.is_finite() {
        serializer.serialize_f64(number)
    } else {
        serializer.serialize_str(&number.to_string())
    }
}

impl Serialize for Content {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Untold => serializer.serialize_none(),
            Self::Flag(flag) => serializer.serialize_bool(*flag),
            Self::Count(number) => serializer.serialize_u64(*number),
            Self::Negative(number) => serializer.serialize_i64(*number),
            Self::Single(number) if number.is_finite() => serializer.serialize_f32(*number),
            Self::Single(number) => finite(f64::from(*number), serializer),
            Self::Double(number) => finite(*number, serializer),
            Self::Name(text) => serializer.serialize_str(text),
            Self::Text(text) => serializer.serialize_str(text),
            Self::List(list) => list.serialize(serializer),
            Self::Fields { variant: Some(variant), fields } => {
                let mut map = serializer.serialize_map(Some(1))?;
                map.serialize_entry(variant, &Self::Fields { variant: None, fields: fields.clone() })?;
                map.end()
            }
            Self::Fields { variant: None, fields } => {
                serializer.collect_map(fields.iter().map(|(name, value)| (name, value)))
            }
        }
    }
}

impl Serialize for List {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.items.len() == self.length {
            let mut seq = serializer.serialize_seq(Some(self.length))?;
            for item in &self.items {
                seq.serialize_element(item)?;
            }
            return seq.end();
        }
        let mut map = serializer.serialize_map(Some(3))?;
        map.serialize_entry("length", &self.length)?;
        map.serialize_entry("hash", &format!("{:016x}", self.hash))?;
        map.serialize_entry("extremes", &self.extremes.map(|e| e.map(Content::Double)))?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;
    use std::collections::BTreeMap;

    #[derive(Serialize, Deserialize)]
    enum Shape {
        Empty,
        Ball { center: [f32; 3], radius: f32 },
        Many(Vec<u32>),
    }

    #[derive(Serialize, Deserialize)]
    struct Place {
        name: Option<String>,
        shapes: Vec<Shape>,
        by_name: BTreeMap<u32, i8>,
    }

    fn place(radius: f32) -> Content {
        Content::of(&Place {
            name: Some("hall".into()),
            shapes: vec![Shape::Empty, Shape::Ball { center: [0.0, 1e-9, 2.5], radius }],
            by_name: [(7, -3)].into(),
        })
    }

    #[test]
    fn values_are_told_as_they_are_written() {
        assert_eq!(
            place(f32::NAN).to_string(),
            "{ name: \"hall\", shapes: [Empty, Ball { center: [0.0, 1e-9, 2.5], radius: NaN }], \
             by_name: { 7: -3 } }"
        );
        let lines = place(2.0).lines();
        assert_eq!(
            lines[1..4],
            ["shapes.0 = Empty", "shapes.1.center = [0.0, 1e-9, 2.5]", "shapes.1.radius = 2.0"]
        );
        assert_eq!(Content::of(&None::<u8>).to_string(), "none");
    }

    #[test]
    fn paths_lead_to_fields_and_items() {
        let told = place(2.0);
        assert_eq!(told.at("shapes.1.center.2").and_then(Content::number), Some(2.5));
        assert_eq!(told.at("by_name.7").and_then(Content::number), Some(-3.0));
        assert_eq!(told.at("shapes").and_then(Content::number), Some(2.0));
        for path in ["shapes.2", "nothing", "name.x", "shapes.-1"] {
            assert!(told.at(path).is_none(), "{path}");
        }
    }

    #[test]
    fn differences_are_named_with_both_values() {
        assert!(place(f32::NAN).differences(&place(f32::NAN)).is_empty());
        let [one] = &place(0.0).differences(&place(-0.0))[..] else { panic!("one") };
        assert_eq!((one.path.as_str(), one.left.to_string().as_str()), ("shapes.1.radius", "0.0"));
        assert_eq!(one.right.to_string(), "-0.0");
        let (a, b) = (Content::of(&Shape::Empty), Content::of(&Shape::Many(vec![1])));
        assert_eq!(a.differences(&b)[0].path, "");
    }

    #[test]
    fn what_is_long_is_told_by_hash_and_extremes() {
        let long = |last: u32| Content::of(&Shape::Many((0..5000).chain([last]).collect()));
        let told = long(9).to_string();
        assert!(
            told.starts_with("Many { 0: [5001 of hash ") && told.ends_with(", 0.0 to 4999.0] }"),
            "{told}"
        );
        let differences = long(9).differences(&long(8));
        assert_eq!(differences.len(), 1);
        assert_eq!(differences[0].path, "0");
        assert_eq!(Content::of(&[f32::NAN; 9]).to_string().matches("to").count(), 0);
    }
}
