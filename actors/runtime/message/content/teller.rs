//! A serializer that writes trees.

use std::borrow::Cow;
use std::fmt;

use serde::ser::{self, Serialize};

use super::{Content, KEPT, List, wider};
use crate::message::Digest;

/// Makes a tree of one value.
pub(super) struct Teller;

/// A value said of itself that it cannot be told.
#[derive(Debug)]
pub(super) struct CannotTell(String);

impl fmt::Display for CannotTell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for CannotTell {}

impl ser::Error for CannotTell {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self(message.to_string())
    }
}

/// Values in a row, as they come.
#[derive(Default)]
pub(super) struct Row {
    variant: Option<&'static str>,
    length: usize,
    items: Vec<Content>,
    hash: Digest,
    extremes: Option<[f64; 2]>,
}

impl Row {
    fn of(variant: &'static str) -> Self {
        Self { variant: Some(variant), ..Self::default() }
    }

    pub(super) fn add(&mut self, item: Content) {
        self.length += 1;
        item.digest(&mut self.hash);
        self.extremes = [self.extremes, item.extremes()].into_iter().flatten().reduce(wider);
        match self.length {
            // So that short of memory nobody is by looking at a picture.
            length if length > KEPT => self.items = Vec::new(),
            _ => self.items.push(item),
        }
    }

    pub(super) fn end(self) -> Content {
        let Self { variant, length, items, hash, extremes } = self;
        let list = Content::List(List { length, items, hash: hash.finish(), extremes });
        match variant {
            Some(variant) => Content::variant(variant, [("0", list)]),
            None => list,
        }
    }

    fn tell(&mut self, value: &(impl Serialize + ?Sized)) -> Result<(), CannotTell> {
        self.add(value.serialize(Teller)?);
        Ok(())
    }
}

/// Named values, as they come.
#[derive(Default)]
pub(super) struct Named {
    variant: Option<&'static str>,
    fields: Vec<(Cow<'static, str>, Content)>,
    /// Of the next value of a map.
    key: String,
}

impl Named {
    fn end(self) -> Content {
        Content::Fields { variant: self.variant.map(Cow::from), fields: self.fields }
    }

    fn tell(
        &mut self,
        name: impl Into<Cow<'static, str>>,
        value: &(impl Serialize + ?Sized),
    ) -> Result<(), CannotTell> {
        self.fields.push((name.into(), value.serialize(Teller)?));
        Ok(())
    }
}

impl ser::Serializer for Teller {
    type Ok = Content;
    type Error = CannotTell;
    type SerializeSeq = Row;
    type SerializeTuple = Row;
    type SerializeTupleStruct = Row;
    type SerializeTupleVariant = Row;
    type SerializeMap = Named;
    type SerializeStruct = Named;
    type SerializeStructVariant = Named;

    fn serialize_bool(self, v: bool) -> Result<Content, CannotTell> {
        Ok(Content::Flag(v))
    }

    fn serialize_i8(self, v: i8) -> Result<Content, CannotTell> {
        self.serialize_i64(v.into())
    }

    fn serialize_i16(self, v: i16) -> Result<Content, CannotTell> {
        self.serialize_i64(v.into())
    }

    fn serialize_i32(self, v: i32) -> Result<Content, CannotTell> {
        self.serialize_i64(v.into())
    }

    fn serialize_i64(self, v: i64) -> Result<Content, CannotTell> {
        Ok(u64::try_from(v).map_or(Content::Negative(v), Content::Count))
    }

    fn serialize_u8(self, v: u8) -> Result<Content, CannotTell> {
        self.serialize_u64(v.into())
    }

    fn serialize_u16(self, v: u16) -> Result<Content, CannotTell> {
        self.serialize_u64(v.into())
    }

    fn serialize_u32(self, v: u32) -> Result<Content, CannotTell> {
        self.serialize_u64(v.into())
    }

    fn serialize_u64(self, v: u64) -> Result<Content, CannotTell> {
        Ok(Content::Count(v))
    }

    fn serialize_f32(self, v: f32) -> Result<Content, CannotTell> {
        Ok(Content::Single(v))
    }

    fn serialize_f64(self, v: f64) -> Result<Content, CannotTell> {
        Ok(Content::Double(v))
    }

    fn serialize_char(self, v: char) -> Result<Content, CannotTell> {
        Ok(Content::Text(v.to_string()))
    }

    fn serialize_str(self, v: &str) -> Result<Content, CannotTell> {
        Ok(Content::Text(v.to_owned()))
    }

    fn serialize_bytes(self, v: &[u8]) -> Result<Content, CannotTell> {
        Ok(Content::list(v.iter().map(|byte| Content::Count(u64::from(*byte)))))
    }

    fn serialize_none(self) -> Result<Content, CannotTell> {
        Ok(Content::Name("none".into()))
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<Content, CannotTell> {
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result<Content, CannotTell> {
        self.serialize_none()
    }

    fn serialize_unit_struct(self, name: &'static str) -> Result<Content, CannotTell> {
        Ok(Content::Name(name.into()))
    }

    fn serialize_unit_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
    ) -> Result<Content, CannotTell> {
        Ok(Content::Name(variant.into()))
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        value: &T,
    ) -> Result<Content, CannotTell> {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        value: &T,
    ) -> Result<Content, CannotTell> {
        Ok(Content::variant(variant, [("0", value.serialize(self)?)]))
    }

    fn serialize_seq(self, _: Option<usize>) -> Result<Row, CannotTell> {
        Ok(Row::default())
    }

    fn serialize_tuple(self, _: usize) -> Result<Row, CannotTell> {
        Ok(Row::default())
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Row, CannotTell> {
        Ok(Row::default())
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Row, CannotTell> {
        Ok(Row::of(variant))
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Named, CannotTell> {
        Ok(Named::default())
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Named, CannotTell> {
        Ok(Named::default())
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        variant: &'static str,
        _: usize,
    ) -> Result<Named, CannotTell> {
        Ok(Named { variant: Some(variant), ..Named::default() })
    }
}

/// The four kinds of rows differ in the names of their methods alone.
macro_rules! row {
    ($kind:ident, $add:ident) => {
        impl ser::$kind for Row {
            type Ok = Content;
            type Error = CannotTell;

            fn $add<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CannotTell> {
                self.tell(value)
            }

            fn end(self) -> Result<Content, CannotTell> {
                Ok(Row::end(self))
            }
        }
    };
}

row!(SerializeSeq, serialize_element);
row!(SerializeTuple, serialize_element);
row!(SerializeTupleStruct, serialize_field);
row!(SerializeTupleVariant, serialize_field);

/// The two kinds of structs do not differ.
macro_rules! named {
    ($kind:ident) => {
        impl ser::$kind for Named {
            type Ok = Content;
            type Error = CannotTell;

            fn serialize_field<T: Serialize + ?Sized>(
                &mut self,
                name: &'static str,
                value: &T,
            ) -> Result<(), CannotTell> {
                self.tell(name, value)
            }

            fn end(self) -> Result<Content, CannotTell> {
                Ok(Named::end(self))
            }
        }
    };
}

named!(SerializeStruct);
named!(SerializeStructVariant);

impl ser::SerializeMap for Named {
    type Ok = Content;
    type Error = CannotTell;

    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), CannotTell> {
        self.key = match key.serialize(Teller)? {
            Content::Text(text) => text,
            other => other.to_string(),
        };
        Ok(())
    }

    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), CannotTell> {
        let key = std::mem::take(&mut self.key);
        self.tell(key, value)
    }

    fn end(self) -> Result<Content, CannotTell> {
        Ok(Named::end(self))
    }
}
