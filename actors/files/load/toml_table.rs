//! TOML tables that know their file, so that every complaint names a line.

use std::cell::RefCell;
use std::path::Path;

use glam::Vec3;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{Place, SceneError};

/// Brackets within brackets beyond this are refused before the parser, which recurses, sees them.
const DEPTH_MAX: usize = 64;

/// A TOML file.
pub(super) struct Document<'a> {
    path: &'a Path,
    text: &'a str,
}

/// A table of it. Asking for a key makes it known; [`Table::finish`] refuses those never asked for.
pub(super) struct Table<'a> {
    document: &'a Document<'a>,
    table: &'a DeTable<'a>,
    /// As in a header, for messages.
    name: String,
    offset: usize,
    known: RefCell<Vec<&'static str>>,
}

impl<'a> Document<'a> {
    pub fn new(path: &'a Path, text: &'a str) -> Self {
        Self { path, text }
    }

    /// Parses the file.
    pub fn parse(&self) -> Result<Spanned<DeTable<'a>>, SceneError> {
        if let Some(at) = too_deep(self.text) {
            return Err(SceneError::Syntax {
                place: self.place(at),
                message: "nested too deeply".to_owned(),
            });
        }
        DeTable::parse(self.text).map_err(|e| SceneError::Syntax {
            place: self.place(e.span().map_or(0, |s| s.start)),
            message: e.message().lines().next().unwrap_or("unreadable").to_owned(),
        })
    }

    /// The place of a byte.
    fn place(&self, offset: usize) -> Place {
        let before = &self.text.as_bytes()[..offset.min(self.text.len())];
        Place::new(self.path, 1 + before.iter().filter(|b| **b == b'\n').count() as u32)
    }

    /// The whole file as a table.
    pub fn root(&'a self, table: &'a Spanned<DeTable<'a>>) -> Table<'a> {
        self.table(table.get_ref(), "the file".to_owned(), 0)
    }

    fn table(&'a self, table: &'a DeTable<'a>, name: String, offset: usize) -> Table<'a> {
        Table { document: self, table, name, offset, known: RefCell::new(Vec::new()) }
    }
}

/// Where brackets are nested too deeply; those in strings and comments count too, which errs on the
/// safe side only in files that no one writes.
fn too_deep(text: &str) -> Option<usize> {
    let mut depth = 0usize;
    for (i, b) in text.bytes().enumerate() {
        match b {
            b'[' | b'{' => {
                depth += 1;
                if depth > DEPTH_MAX {
                    return Some(i);
                }
            }
            b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    // A key of many dots makes tables within tables as well.
    let mut dots = 0usize;
    for (i, b) in text.bytes().enumerate() {
        match b {
            b'.' => {
                dots += 1;
                if dots > 8 * DEPTH_MAX {
                    return Some(i);
                }
            }
            b'\n' => dots = 0,
            _ => {}
        }
    }
    None
}

fn describe(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(_) => "a string".to_owned(),
        DeValue::Integer(_) | DeValue::Float(_) => "a number".to_owned(),
        DeValue::Boolean(_) => "true or false".to_owned(),
        DeValue::Datetime(_) => "a date".to_owned(),
        DeValue::Array(a) => format!("a list of {}", a.len()),
        DeValue::Table(_) => "a table".to_owned(),
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|v| v as f64),
        DeValue::Float(f) => f.as_str().parse().ok(),
        _ => None,
    }
}

impl<'a> Table<'a> {
    /// The line of the table's header.
    pub fn place(&self) -> Place {
        self.document.place(self.offset)
    }

    /// Every key, with its value, in the order of the file.
    pub fn entries(&self) -> Vec<(&'a str, &'a Spanned<DeValue<'a>>)> {
        let mut all: Vec<_> =
            self.table.iter().map(|(k, v)| (k.span().start, k.get_ref().as_ref(), v)).collect();
        all.sort_by_key(|(offset, ..)| *offset);
        all.into_iter().map(|(_, k, v)| (k, v)).collect()
    }

    fn get(&self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.known.borrow_mut().push(key);
        self.table.get(key)
    }

    /// The place of a key, or of the table where the key is absent.
    pub fn place_of(&self, key: &str) -> Place {
        match self.table.get_key_value(key) {
            Some((k, _)) => self.document.place(k.span().start),
            None => self.place(),
        }
    }

    fn wrong<T>(&self, key: &str, expected: &str, found: &Spanned<DeValue<'_>>) -> Result<T, SceneError> {
        Err(SceneError::WrongType {
            place: self.document.place(found.span().start),
            key: key.to_owned(),
            expected: expected.to_owned(),
            found: describe(found.get_ref()),
        })
    }

    /// Says that the value of `key` has no meaning.
    pub fn invalid(&self, key: &str, message: impl std::fmt::Display) -> SceneError {
        SceneError::invalid(self.place_of(key), format!("`{key}` {message}"))
    }

    /// The value, or the error that it must be there.
    pub fn required<T>(&self, key: &'static str, value: Option<T>) -> Result<T, SceneError> {
        value.ok_or_else(|| SceneError::MissingKey {
            place: self.place(),
            key: key.to_owned(),
            table: self.name.clone(),
        })
    }

    pub fn string(&self, key: &'static str) -> Result<Option<&'a str>, SceneError> {
        match self.get(key) {
            None => Ok(None),
            Some(v) => match v.get_ref().as_str() {
                Some(s) => Ok(Some(s)),
                None => self.wrong(key, "a string", v),
            },
        }
    }

    pub fn boolean(&self, key: &'static str) -> Result<Option<bool>, SceneError> {
        match self.get(key) {
            None => Ok(None),
            Some(v) => match v.get_ref().as_bool() {
                Some(b) => Ok(Some(b)),
                None => self.wrong(key, "true or false", v),
            },
        }
    }

    /// A finite number.
    pub fn number(&self, key: &'static str) -> Result<Option<f32>, SceneError> {
        match self.get(key) {
            None => Ok(None),
            Some(v) => match number(v.get_ref()).map(|n| n as f32).filter(|n| n.is_finite()) {
                Some(n) => Ok(Some(n)),
                None => self.wrong(key, "a finite number", v),
            },
        }
    }

    /// A number in a range given in words.
    pub fn number_in(
        &self,
        key: &'static str,
        good: impl Fn(f32) -> bool,
        range: &str,
    ) -> Result<Option<f32>, SceneError> {
        match self.number(key)? {
            Some(n) if !good(n) => Err(self.invalid(key, format_args!("is {n}; it must be {range}"))),
            n => Ok(n),
        }
    }

    pub fn vec3(&self, key: &'static str) -> Result<Option<Vec3>, SceneError> {
        let Some(v) = self.get(key) else { return Ok(None) };
        let expected = "three finite numbers in brackets, as [0.0, 1.0, 2.0]";
        let Some([x, y, z]) = v.get_ref().as_array().map(|a| &a[..]) else {
            return self.wrong(key, expected, v);
        };
        let [x, y, z] = [x, y, z].map(|n| number(n.get_ref()).map(|n| n as f32));
        match (x, y, z) {
            (Some(x), Some(y), Some(z)) if Vec3::new(x, y, z).is_finite() => Ok(Some(Vec3::new(x, y, z))),
            _ => self.wrong(key, expected, v),
        }
    }

    /// A colour or radiance: three numbers that are not negative and at most `max`.
    pub fn color(&self, key: &'static str, max: f32) -> Result<Option<Vec3>, SceneError> {
        match self.vec3(key)? {
            Some(c) if c.min_element() < 0.0 || c.max_element() > max => {
                Err(self.invalid(key, format_args!("is {c}; each number must lie between 0 and {max}")))
            }
            c => Ok(c),
        }
    }

    /// A list of strings.
    pub fn strings(&self, key: &'static str) -> Result<Option<Vec<(&'a str, Place)>>, SceneError> {
        let Some(v) = self.get(key) else { return Ok(None) };
        let Some(list) = v.get_ref().as_array() else { return self.wrong(key, "a list of strings", v) };
        let mut out = Vec::new();
        for item in list.iter() {
            match item.get_ref().as_str() {
                Some(s) => out.push((s, self.document.place(item.span().start))),
                None => return self.wrong(key, "a list of strings", item),
            }
        }
        Ok(Some(out))
    }

    /// A table under `key`.
    pub fn table(&self, key: &'static str) -> Result<Option<Table<'a>>, SceneError> {
        let Some(v) = self.get(key) else { return Ok(None) };
        self.as_table(key, v, format!("[{key}]")).map(Some)
    }

    /// A value that must be a table.
    pub fn as_table(
        &self,
        key: &str,
        v: &'a Spanned<DeValue<'a>>,
        name: String,
    ) -> Result<Table<'a>, SceneError> {
        match v.get_ref().as_table() {
            Some(t) => Ok(self.document.table(t, name, v.span().start)),
            None => self.wrong(key, "a table", v),
        }
    }

    /// A list of tables, `[[key]]` or inline.
    pub fn tables(&self, key: &'static str) -> Result<Vec<Table<'a>>, SceneError> {
        let Some(v) = self.get(key) else { return Ok(Vec::new()) };
        let Some(list) = v.get_ref().as_array() else {
            return self.wrong(key, &format!("a list of tables, each begun with [[{key}]]"), v);
        };
        list.iter().map(|t| self.as_table(key, t, format!("[[{key}]]"))).collect()
    }

    /// Refuses the first key that was never asked for.
    pub fn finish(&self) -> Result<(), SceneError> {
        let known = self.known.borrow();
        let mut unknown: Vec<_> =
            self.table.keys().filter(|k| !known.contains(&k.get_ref().as_ref())).collect();
        unknown.sort_by_key(|k| k.span().start);
        let Some(key) = unknown.first() else { return Ok(()) };
        // Only the beginning is compared and shown: a key may be as long as the file.
        let text: String = key.get_ref().chars().take(60).collect();
        let nearest = known.iter().min_by_key(|k| (strsim::damerau_levenshtein(&text, k), **k));
        Err(SceneError::UnknownKey {
            place: self.document.place(key.span().start),
            key: text,
            table: self.name.clone(),
            nearest: nearest.map(|n| (*n).to_owned()),
        })
    }
}
