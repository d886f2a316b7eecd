//! The check of a document that draws nothing.
//!
//! What a scene does not draw is not read, so a mistake in it does no harm and is not looked for. Where nothing is drawn
//! at all, somebody wants to know why: then the whole document is held against its own numbers, and what cannot be is the
//! answer. Names that lead nowhere are no mistake here, since nobody follows them.

use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, MapAccess, Visitor};

use super::accessor;
use super::buffers::Buffers;
use super::document::Document;
use super::{Oddities, Problem};

/// An object of any keys, and nothing else.
struct Object;

impl<'de> Deserialize<'de> for Object {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        struct Keys;
        impl<'de> Visitor<'de> for Keys {
            type Value = Object;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Object, A::Error> {
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
                Ok(Object)
            }
        }
        d.deserialize_map(Keys)
    }
}

#[derive(Deserialize)]
struct Extensions {
    #[serde(default, rename = "extensions")]
    _extensions: BTreeMap<String, Object>,
}

/// Refuses a document that cannot be, and says what is odd in it. `json` is its text.
pub(super) fn check(
    document: &Document,
    json: &[u8],
    buffers: &mut Buffers<'_>,
    odd: &mut Oddities,
) -> Result<(), Problem> {
    if let Err(e) = serde_json::from_slice::<Extensions>(json) {
        return Err(Problem::new("/extensions", format!("{e}; export again")));
    }
    for index in 0..document.buffers.len() {
        if let Some(doubt) = buffers.doubt(index)? {
            odd.count(&format!("buffer {index}, whose `uri` {doubt}"), "not read; nothing is drawn of it");
        }
    }
    for index in 0..document.accessors.len() {
        accessor::check_lengths(document, index)?;
    }
    for (m, mesh) in document.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let at = |key: &str| format!("/meshes/{m}/primitives/{p}/{key}");
            if primitive.targets.len() != mesh.primitives[0].targets.len() {
                let message = format!(
                    "has {} targets, but the first primitive has {}; export again",
                    primitive.targets.len(),
                    mesh.primitives[0].targets.len()
                );
                return Err(Problem::new(at("targets"), message));
            }
            let indices = primitive.indices.and_then(|i| document.accessors.get(i.at()));
            if let Some(of) = indices
                && !accessor::are_indices(of)
            {
                let message = format!(
                    "names an accessor of type {} and component {}, which are no indices; export again",
                    super::buffers::shortened(&of.shape),
                    of.component_type.0
                );
                return Err(Problem::new(at("indices"), message));
            }
        }
    }
    Ok(())
}
