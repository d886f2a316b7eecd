//! Things: what files give a name, and what people point at. In glTF a node with a mesh, and each of its instances; in OBJ
//! what follows `o` or `g`. Diffuse ones are things as well, which [`Object`](super::Object)s are not told apart by.
//!
//! A thing's id is its place in the scene, in the order of the files; its path is unique, so that whoever names it in a file
//! or on a command line means one. Deliberately absent: what moves things.

use std::collections::HashMap;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{Mesh, TriangleIndex};

/// A place in [`Things`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ThingId(pub u32);

/// Something that a file names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Thing {
    /// Its own name; the file's where that has none.
    pub name: String,
    /// Names of what it hangs from and its own, joined by `/` (one within a name is written `\/`); the second of two that
    /// are the same ends in `#2`.
    pub path: String,
    /// The nearest thing that it hangs from.
    pub parent: Option<ThingId>,
    /// How many triangles it has, at least one.
    pub triangles: u32,
    /// Their bounds.
    pub bounds: [Vec3; 2],
}

/// All things of a scene, and whose each triangle is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Things {
    list: Vec<Thing>,
    /// Where runs of triangles of one thing begin, ascending from 0, and whose they are.
    runs: Vec<(TriangleIndex, ThingId)>,
}

/// A thing as its file has it.
#[derive(Clone, Debug)]
pub struct ThingSource {
    /// Its name.
    pub name: String,
    /// Its path, which others may have too.
    pub path: String,
    /// The thing that it hangs from, an earlier one in the same list.
    pub parent: Option<u32>,
}

impl Things {
    /// Of `sources` those that have triangles; `of_triangle` says whose each is.
    ///
    /// # Panics
    /// If a triangle belongs to none of them: a bug in a reader.
    pub fn new(sources: &[ThingSource], of_triangle: &[u32], mesh: &Mesh) -> Self {
        let mut counts = vec![0u32; sources.len()];
        let mut bounds = vec![[Vec3::INFINITY, Vec3::NEG_INFINITY]; sources.len()];
        for (t, &source) in of_triangle.iter().enumerate() {
            counts[source as usize] += 1;
            let [low, high] = &mut bounds[source as usize];
            for p in mesh.corners(t as u32) {
                (*low, *high) = (low.min(p), high.max(p));
            }
        }
        // Each source's own id, or, where it has no triangles, that of the nearest above it that has.
        let mut ids: Vec<Option<ThingId>> = Vec::with_capacity(sources.len());
        let mut list: Vec<Thing> = Vec::new();
        let mut taken: HashMap<String, u32> = HashMap::new();
        for (i, source) in sources.iter().enumerate() {
            let parent = source.parent.and_then(|p| *ids.get(p as usize)?);
            if counts[i] == 0 {
                ids.push(parent);
                continue;
            }
            ids.push(Some(ThingId(list.len() as u32)));
            list.push(Thing {
                name: source.name.clone(),
                path: unique(&source.path, &mut taken),
                parent,
                triangles: counts[i],
                bounds: bounds[i],
            });
        }
        let mut runs: Vec<(TriangleIndex, ThingId)> = Vec::new();
        for (t, &source) in of_triangle.iter().enumerate() {
            let id = ids[source as usize].expect("a thing with triangles");
            if runs.last().is_none_or(|(_, last)| *last != id) {
                runs.push((t as u32, id));
            }
        }
        Self { list, runs }
    }

    /// Whose a triangle is; `None` where the scene was not read from files.
    pub fn of(&self, triangle: TriangleIndex) -> Option<ThingId> {
        let after = self.runs.partition_point(|(first, _)| *first <= triangle);
        Some(self.runs.get(after.checked_sub(1)?)?.1)
    }

    /// The thing that a triangle is a part of.
    pub fn at(&self, triangle: TriangleIndex) -> Option<&Thing> {
        self.get(self.of(triangle)?)
    }

    /// A thing.
    pub fn get(&self, id: ThingId) -> Option<&Thing> {
        self.list.get(id.0 as usize)
    }

    /// The thing of this path, else the only one of this name.
    pub fn find(&self, called: &str) -> Option<ThingId> {
        let place = |i: usize| ThingId(i as u32);
        if let Some(i) = self.list.iter().position(|thing| thing.path == called) {
            return Some(place(i));
        }
        let mut named = self.list.iter().enumerate().filter(|(_, thing)| thing.name == called);
        match (named.next(), named.next()) {
            (Some((i, _)), None) => Some(place(i)),
            _ => None,
        }
    }

    /// All, in order of their ids.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Thing> {
        self.list.iter()
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether nothing is named.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Whether it can be of a mesh of so many triangles; what was read from a kept file is believed no sooner.
    pub(super) fn is_sound(&self, triangles: usize) -> bool {
        let ids_are_known = |id: ThingId| (id.0 as usize) < self.list.len();
        self.runs.first().is_none_or(|(first, _)| *first == 0)
            && self.runs.is_sorted_by(|a, b| a.0 < b.0)
            && self.runs.iter().all(|(first, id)| (*first as usize) < triangles && ids_are_known(*id))
            && self.list.iter().all(|thing| thing.parent.is_none_or(ids_are_known))
    }
}

/// One step of a path.
pub fn escaped(name: &str) -> String {
    name.replace('/', "\\/")
}

/// A path that nothing else has.
fn unique(path: &str, taken: &mut HashMap<String, u32>) -> String {
    let mut unique = path.to_owned();
    loop {
        match taken.get_mut(&unique) {
            None => break,
            // The number after the last one that was given out for this path.
            Some(_) => {
                let count = taken.get_mut(path).expect("a path that was taken");
                *count += 1;
                unique = format!("{path}#{count}");
            }
        }
    }
    taken.insert(unique.clone(), 1);
    unique
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(name: &str, path: &str, parent: Option<u32>) -> ThingSource {
        ThingSource { name: name.into(), path: path.into(), parent }
    }

    fn mesh(triangles: usize) -> Mesh {
        let positions = (0..3 * triangles).map(|i| Vec3::new(i as f32, (i % 3) as f32, 0.0)).collect();
        let triangles = (0..triangles as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        Mesh { positions, triangles, ..Mesh::default() }
    }

    #[test]
    fn each_triangle_has_its_thing() {
        let sources = [
            source("table", "table", None),
            source("empty", "table/empty", Some(0)),
            source("cup", "table/empty/cup", Some(1)),
            source("cup", "table/empty/cup", Some(1)),
        ];
        let things = Things::new(&sources, &[0, 0, 2, 3, 0], &mesh(5));
        let paths: Vec<&str> = things.iter().map(|t| t.path.as_str()).collect();
        assert_eq!(paths, ["table", "table/empty/cup", "table/empty/cup#2"]);
        let parents: Vec<_> = things.iter().map(|t| t.parent).collect();
        assert_eq!(parents, [None, Some(ThingId(0)), Some(ThingId(0))]);
        let of: Vec<u32> = (0..5).map(|t| things.of(t).expect("a thing").0).collect();
        assert_eq!(of, [0, 0, 1, 2, 0]);
        assert_eq!(things.at(2).map(|t| (t.triangles, t.bounds[0].x, t.bounds[1].x)), Some((1, 6.0, 8.0)));
        assert!(things.is_sound(5) && !things.is_sound(4));
    }

    #[test]
    fn a_path_or_a_name_that_is_the_only_one_finds_a_thing() {
        let sources = [source("cup", "a/cup", None), source("cup", "b/cup", None), source("b", "cup", None)];
        let things = Things::new(&sources, &[0, 1, 2], &mesh(3));
        assert_eq!(things.find("b/cup"), Some(ThingId(1)));
        assert_eq!(things.find("b"), Some(ThingId(2)));
        // Two have that name, but one that path.
        assert_eq!(things.find("cup"), Some(ThingId(2)));
        assert_eq!(things.find("c"), None);
        let two = Things::new(&sources[..2], &[0, 1], &mesh(2));
        assert_eq!(two.find("cup"), None);
    }

    #[test]
    fn paths_are_unique_whatever_files_call_things() {
        let names = ["a", "a#2", "a", "a", "a#2", "a#3"];
        let sources: Vec<_> = names.iter().map(|n| source(n, n, None)).collect();
        let of: Vec<u32> = (0..names.len() as u32).collect();
        let things = Things::new(&sources, &of, &mesh(names.len()));
        let mut paths: Vec<&str> = things.iter().map(|t| t.path.as_str()).collect();
        paths.sort_unstable();
        paths.dedup();
        assert_eq!(paths.len(), names.len(), "{paths:?}");
        assert_eq!(escaped("a/b"), "a\\/b");
        assert!(Things::default().of(0).is_none());
    }
}
