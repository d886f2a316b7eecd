//! Numbers and arrays of a document, bounded while they are read.
//!
//! JSON has one kind of number, so a writer may say `1.0` where an index is meant; `1.5` is none.

use std::fmt;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};

/// Elements of an array of the document, unless it has a bound of its own.
pub(super) const ARRAY_MAX: usize = 1 << 20;

/// A whole number from 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Whole(pub u64);

struct WholeVisitor;

impl Visitor<'_> for WholeVisitor {
    type Value = u64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a whole number from 0")
    }

    fn visit_u64<E: Error>(self, v: u64) -> Result<u64, E> {
        Ok(v)
    }

    fn visit_f64<E: Error>(self, v: f64) -> Result<u64, E> {
        // Beyond 2⁵³ doubles skip whole numbers.
        if v >= 0.0 && v.fract() == 0.0 && v <= 9_007_199_254_740_992.0 {
            Ok(v as u64)
        } else {
            Err(E::custom(format_args!("{v} is no whole number from 0")))
        }
    }
}

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_any(WholeVisitor).map(Self)
    }
}

/// A place in one of the document's arrays, or a number that names a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Index(pub u32);

impl Index {
    /// As a place.
    pub fn at(self) -> usize {
        self.0 as usize
    }
}

impl<'de> Deserialize<'de> for Index {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        let v = d.deserialize_any(WholeVisitor)?;
        u32::try_from(v)
            .map(Self)
            .map_err(|_| D::Error::custom(format_args!("{v} is too large for an index")))
    }
}

/// An array of at most `MAX` elements.
#[derive(Clone, Debug)]
pub(super) struct List<T, const MAX: usize = ARRAY_MAX>(Vec<T>);

impl<T, const MAX: usize> Default for List<T, MAX> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T, const MAX: usize> Deref for List<T, MAX> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T, const MAX: usize> DerefMut for List<T, MAX> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

struct ListVisitor<T, const MAX: usize>(PhantomData<T>);

impl<'de, T: Deserialize<'de>, const MAX: usize> Visitor<'de> for ListVisitor<T, MAX> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "an array of at most {MAX} elements")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Vec<T>, A::Error> {
        let mut list = Vec::new();
        while let Some(element) = seq.next_element()? {
            if list.len() == MAX {
                return Err(A::Error::custom(format_args!("an array has more than {MAX} elements")));
            }
            list.push(element);
        }
        Ok(list)
    }
}

impl<'de, T: Deserialize<'de>, const MAX: usize> Deserialize<'de> for List<T, MAX> {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        d.deserialize_seq(ListVisitor::<T, MAX>(PhantomData)).map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_may_have_a_point_and_arrays_have_an_end() {
        let whole = |text: &str| serde_json::from_str::<Index>(text).map(|i| i.0).ok();
        assert_eq!([whole("7"), whole("1.0"), whole("2e3")], [Some(7), Some(1), Some(2000)]);
        for bad in ["1.5", "-1", "4294967296", "\"1\"", "null", "1e300"] {
            assert_eq!(whole(bad), None, "{bad}");
        }
        let list = |text: &str| serde_json::from_str::<List<Index, 3>>(text).map(|l| l.len());
        assert_eq!(list("[1, 2, 3]").unwrap(), 3);
        assert!(list("[1, 2, 3, 4]").unwrap_err().to_string().contains("more than 3"));
        assert!(list("{}").is_err());
    }
}
