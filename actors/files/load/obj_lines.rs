//! Turns any OBJ text into one that `tobj` reads without an error: what it hands on are numbers that
//! parse, faces whose indices exist, and nothing else.
//!
//! `tobj` ends with an error at the first bad number, at an index out of range and at a `w` of 0; it has no line
//! numbers, no smoothing groups, and pads nothing where some faces have texture coordinates and others do not. So
//! every corner gets three absolute indices here (a first, zero `vt` and `vn` stand for absent ones), and names,
//! materials and smoothing go into [`Segment`]s beside the stream.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, Read};
use std::sync::mpsc::sync_channel;

/// Faces with more corners than this are left out: cutting them up takes quadratic time at worst.
pub(super) const CORNERS_MAX: usize = 1 << 16;

/// Bytes made at a time.
const CHUNK: usize = 64 * 1024;
/// Chunks made before the first of them is read.
const CHUNKS_AHEAD: usize = 16;
/// Text that is worth a thread of its own.
const WORTH: usize = 1 << 20;

/// Consecutive faces of one name, material and smoothing group.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Segment {
    /// Number of the first face.
    pub first_face: usize,
    /// Index into [`ObjLines::names`]; 0 is the file itself.
    pub name: u32,
    /// Index into [`ObjLines::materials`], if `usemtl` came before.
    pub material: Option<u32>,
    /// Smoothing group; 0 is none.
    pub smoothing: u32,
}

/// What was put right or left out, in the order in which it is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Oddity {
    /// A vertex with a coordinate that is no number, or NaN or infinite.
    Vertex,
    /// A face with a vertex index that is absent, out of range or no number.
    Face,
    /// A texture coordinate or normal index out of range.
    Attribute,
    /// A face with fewer than three corners.
    Short,
    /// A face with more than [`CORNERS_MAX`] corners.
    Long,
    /// Points and lines.
    Lines,
    /// Free-form curves and surfaces.
    FreeForm,
    /// Vertex colours.
    Colors,
    /// A normal or texture coordinate that is no number.
    Number,
}

/// How often something was met, and on which line first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tally {
    pub count: usize,
    pub line: u32,
}

/// Lines with their numbers from 1; one that ends in `\` is joined with those that follow.
struct Lines<'a> {
    rest: Option<&'a str>,
    line: u32,
}

impl<'a> Lines<'a> {
    fn physical(&mut self) -> Option<&'a str> {
        let text = self.rest?;
        let (line, rest) = match memchr::memchr(b'\n', text.as_bytes()) {
            Some(at) => (&text[..at], Some(&text[at + 1..])),
            None => (text, None),
        };
        (self.rest, self.line) = (rest, self.line + 1);
        Some(line)
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = (u32, Cow<'a, str>);

    fn next(&mut self) -> Option<Self::Item> {
        let continued =
            |line: &str| line.strip_suffix('\r').unwrap_or(line).strip_suffix('\\').map(str::to_owned);
        let first = self.physical()?;
        let number = self.line;
        let Some(mut joined) = continued(first) else { return Some((number, first.into())) };
        while let Some(line) = self.physical() {
            joined.push(' ');
            match continued(line) {
                Some(part) => joined += &part,
                None => return Some((number, (joined + line).into())),
            }
        }
        Some((number, joined.into()))
    }
}

fn is_space(c: char) -> bool {
    matches!(c, ' ' | '\t' | '\r' | '\0' | '\x0b' | '\x0c')
}

/// Words of a line. NUL bytes count as blanks, `#` at the start of a word ends the line.
fn words(line: &str) -> Words<'_> {
    Words(line)
}

/// What is left of a line. By bytes, since blanks are ASCII and most of reading a file is this.
struct Words<'a>(&'a str);

impl<'a> Iterator for Words<'a> {
    type Item = &'a str;

    #[inline]
    fn next(&mut self) -> Option<&'a str> {
        let bytes = self.0.as_bytes();
        let begin = bytes.iter().position(|b| !is_space(*b as char))?;
        if bytes[begin] == b'#' {
            self.0 = "";
            return None;
        }
        let length = bytes[begin..].iter().position(|b| is_space(*b as char));
        let end = length.map_or(bytes.len(), |length| begin + length);
        let word = &self.0[begin..end];
        self.0 = &self.0[end..];
        Some(word)
    }
}

/// Whether a word is a finite number at sight: digits and at most one point between or before them.
fn is_plain(word: &str) -> bool {
    let word = word.strip_prefix('-').unwrap_or(word).as_bytes();
    let digits = word.iter().filter(|b| b.is_ascii_digit()).count();
    let points = word.iter().filter(|b| **b == b'.').count();
    (1..=32).contains(&digits) && points <= 1 && digits + points == word.len()
}

/// Counts of v, vt and vn.
fn counted(keyword: &str) -> Option<usize> {
    ["v", "vt", "vn"].iter().position(|k| *k == keyword)
}

/// The cleaned text as a stream, and what stands beside it.
pub(super) struct ObjLines<'a> {
    lines: Lines<'a>,
    /// The line that is read.
    line: u32,
    /// Clean text that is to be handed on.
    out: Vec<u8>,
    /// Counts of v, vt, vn so far, and in the whole file: faces may refer forward.
    counts: [usize; 3],
    totals: [usize; 3],
    /// Faces handed on.
    faces: usize,
    corners: Vec<[usize; 3]>,
    current: Segment,
    name_of: HashMap<String, u32>,
    material_of: HashMap<String, u32>,
    /// Names of `o` and `g`; the first is empty.
    pub names: Vec<String>,
    /// Names of `usemtl` and the line of their first use.
    pub materials: Vec<(String, u32)>,
    /// What follows `mtllib`, with the line.
    pub libraries: Vec<(String, u32)>,
    /// In the order of faces.
    pub segments: Vec<Segment>,
    /// What was put right.
    pub odd: BTreeMap<Oddity, Tally>,
}

/// The number that stands for a name; a new one is handed to `add`, which counts them.
fn numbered(known: &mut HashMap<String, u32>, name: &str, add: impl FnOnce(String) -> usize) -> u32 {
    if let Some(&number) = known.get(name) {
        return number;
    }
    let number = add(name.to_owned()) as u32 - 1;
    known.insert(name.to_owned(), number);
    number
}

impl<'a> ObjLines<'a> {
    /// Of a whole file, without byte-order mark.
    pub fn new(text: &'a str) -> Self {
        let lines = || Lines { rest: Some(text), line: 0 };
        let mut totals = [0; 3];
        for kind in lines().filter_map(|(_, line)| counted(words(&line).next()?)) {
            totals[kind] += 1;
        }
        Self {
            lines: lines(),
            line: 0,
            // What absent texture coordinates and normals refer to.
            out: b"vt 0 0\nvn 0 0 0\n".to_vec(),
            counts: [0; 3],
            totals,
            faces: 0,
            corners: Vec::new(),
            current: Segment::default(),
            name_of: HashMap::new(),
            material_of: HashMap::new(),
            names: vec![String::new()],
            materials: Vec::new(),
            libraries: Vec::new(),
            segments: Vec::new(),
            odd: BTreeMap::new(),
        }
    }

    fn put(&mut self, text: &str) {
        self.out.extend_from_slice(text.as_bytes());
    }

    fn note(&mut self, oddity: Oddity) {
        self.odd.entry(oddity).or_insert(Tally { count: 0, line: self.line }).count += 1;
    }

    fn statement(&mut self, line: &str) {
        let mut words = words(line);
        let Some(keyword) = words.next() else { return };
        if let Some(kind) = counted(keyword) {
            self.counts[kind] += 1;
        }
        let name = || line.trim_start_matches(is_space)[keyword.len()..].trim_matches(is_space);
        match keyword {
            "v" => self.vertex(words),
            // One number is a one-dimensional texture.
            "vt" => self.attribute("vt", [words.next(), words.next().or(Some("0"))]),
            "vn" => self.attribute("vn", [words.next(), words.next(), words.next()]),
            "f" | "fo" => self.face(words),
            "o" | "g" => {
                let names = &mut self.names;
                self.current.name = numbered(&mut self.name_of, name(), |name| {
                    names.push(name);
                    names.len()
                });
            }
            "usemtl" if name().is_empty() => self.current.material = None,
            "usemtl" => {
                let (materials, line) = (&mut self.materials, self.line);
                self.current.material = Some(numbered(&mut self.material_of, name(), |name| {
                    materials.push((name, line));
                    materials.len()
                }));
            }
            "mtllib" => self.libraries.push((name().to_owned(), self.line)),
            // `off`, `null` and what is no number is none.
            "s" => {
                let group = words.next().and_then(|w| w.parse::<i64>().ok()).unwrap_or(0);
                self.current.smoothing = group.clamp(0, i64::from(u32::MAX)) as u32;
            }
            "l" | "p" => self.note(Oddity::Lines),
            "curv" | "curv2" | "surf" => self.note(Oddity::FreeForm),
            _ => {}
        }
    }

    fn vertex<'w>(&mut self, mut words: impl Iterator<Item = &'w str>) {
        self.put("v");
        let mut good = true;
        for _ in 0..3 {
            good &= self.coordinate(words.next(), "nan");
        }
        // x y z, then w, or r g b, or w and colours: only a lone w moves the vertex.
        if let Some(w) = words.next() {
            if words.next().is_some() {
                self.note(Oddity::Colors);
            } else if w.parse::<f32>().is_ok_and(|w| w != 0.0 && w.is_finite()) {
                self.put(" ");
                self.put(w);
            } else {
                good = false;
            }
        }
        if !good {
            self.note(Oddity::Vertex);
        }
        self.put("\n");
    }

    /// Hands on a number, or `instead` where there is none. Whether it was a finite one.
    fn coordinate(&mut self, word: Option<&str>, instead: &str) -> bool {
        let number = |w: &str| if is_plain(w) { Some(0.0) } else { w.parse::<f32>().ok() };
        let number = word.and_then(number);
        self.put(" ");
        self.put(word.filter(|_| number.is_some()).unwrap_or(instead));
        number.is_some_and(f32::is_finite)
    }

    fn attribute<const N: usize>(&mut self, keyword: &str, words: [Option<&str>; N]) {
        self.put(keyword);
        let mut good = true;
        for word in words {
            good &= self.coordinate(word, "0");
        }
        if !good {
            self.note(Oddity::Number);
        }
        self.put("\n");
    }

    /// The absolute index from 1 of an index among what `kind` counts; `None` if there is no such.
    fn resolve(&self, word: &str, kind: usize) -> Option<usize> {
        let index: i64 = word.parse().ok()?;
        let absolute = if index < 0 { (self.counts[kind] as i64 + 1).checked_add(index)? } else { index };
        usize::try_from(absolute).ok().filter(|i| (1..=self.totals[kind]).contains(i))
    }

    fn corner(&mut self, word: &str) -> Option<[usize; 3]> {
        // 1 is the zero that stands for absent ones, so real ones begin at 2.
        let mut corner = [0, 1, 1];
        for (kind, part) in word.split('/').enumerate().filter(|(_, part)| !part.is_empty()) {
            match (kind, self.resolve(part, kind.min(2))) {
                (0, index) => corner[0] = index?,
                (1 | 2, Some(index)) => corner[kind] = index + 1,
                (1 | 2, None) => self.note(Oddity::Attribute),
                _ => return None,
            }
        }
        (corner[0] > 0).then_some(corner)
    }

    fn face<'w>(&mut self, words: impl Iterator<Item = &'w str>) {
        self.corners.clear();
        for word in words {
            let Some(corner) = self.corner(word) else { return self.note(Oddity::Face) };
            self.corners.push(corner);
        }
        match self.corners.len() {
            0..3 => return self.note(Oddity::Short),
            3..=CORNERS_MAX => {}
            _ => return self.note(Oddity::Long),
        }
        let now = Segment { first_face: self.faces, ..self.current };
        if self.segments.last().is_none_or(|s| Segment { first_face: now.first_face, ..*s } != now) {
            self.segments.push(now);
        }
        self.faces += 1;
        self.put("f");
        let mut digits = itoa::Buffer::new();
        for corner in &self.corners {
            for (index, before) in corner.iter().zip([" ", "/", "/"]) {
                self.out.extend_from_slice(before.as_bytes());
                self.out.extend_from_slice(digits.format(*index).as_bytes());
            }
        }
        self.put("\n");
    }
}

impl ObjLines<'_> {
    /// The next clean text; empty after the last.
    fn chunk(&mut self) -> Vec<u8> {
        while self.out.len() < CHUNK
            && let Some((number, line)) = self.lines.next()
        {
            self.line = number;
            self.statement(&line);
        }
        std::mem::take(&mut self.out)
    }

    /// What `read` makes of the clean text. A long one is cleaned on a thread beside the one that reads it.
    pub fn read<R>(&mut self, mut read: impl FnMut(&mut dyn BufRead) -> R) -> R {
        if self.lines.rest.is_some_and(|text| text.len() >= WORTH) {
            let (to, from) = sync_channel(CHUNKS_AHEAD);
            let lines = &mut *self;
            let beside = std::thread::scope(|scope| {
                let clean = move || loop {
                    let chunk = lines.chunk();
                    let is_last = chunk.is_empty();
                    if to.send(chunk).is_err() || is_last {
                        break;
                    }
                };
                std::thread::Builder::new().spawn_scoped(scope, clean).ok()?;
                Some(read(&mut Chunks::of(|| from.recv().unwrap_or_default())))
            });
            if let Some(made) = beside {
                return made;
            }
        }
        read(&mut Chunks::of(|| self.chunk()))
    }
}

/// A stream of chunks, the last of which is empty.
struct Chunks<F> {
    next: F,
    chunk: Vec<u8>,
    /// Bytes of it that are read.
    at: usize,
}

impl<F: FnMut() -> Vec<u8>> Chunks<F> {
    fn of(next: F) -> Self {
        Self { next, chunk: Vec::new(), at: 0 }
    }
}

impl<F: FnMut() -> Vec<u8>> BufRead for Chunks<F> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        if self.at == self.chunk.len() {
            (self.chunk, self.at) = ((self.next)(), 0);
        }
        Ok(&self.chunk[self.at..])
    }

    fn consume(&mut self, count: usize) {
        self.at = self.chunk.len().min(self.at + count);
    }
}

impl<F: FnMut() -> Vec<u8>> Read for Chunks<F> {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        let count = self.fill_buf()?.read(buf)?;
        self.consume(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clean(text: &str) -> (String, BTreeMap<Oddity, Tally>) {
        let mut lines = ObjLines::new(text);
        let mut out = String::new();
        lines.read(|text| text.read_to_string(&mut out)).unwrap();
        let body = out.strip_prefix("vt 0 0\nvn 0 0 0\n").unwrap();
        (body.replace('\n', ";"), lines.odd)
    }

    fn check(input: &str, expected: &str) {
        assert_eq!(clean(input).0, expected, "{input:?}");
    }

    #[test]
    fn numbers_pass_or_become_nan() {
        check("v 1 2 3", "v 1 2 3;");
        check("v -1.5 .5 2.", "v -1.5 .5 2.;");
        check("v 1e3 1e30 1E-3 # x", "v 1e3 1e30 1E-3;");
        check("v 1 2", "v 1 2 nan;");
        check("v a - 1,5", "v nan nan nan;");
        check("v 1 2 3 0.5", "v 1 2 3 0.5;");
        check("v 1 2 3 0", "v 1 2 3;");
        check("v 1 2 3 .1 .2 .3", "v 1 2 3;");
        check("vt .5", "vt .5 0;");
        check("vn nan x 1", "vn nan 0 1;");
        check("\tv\t1\t2\t3\r\n", "v 1 2 3;");
        check("\0\0v 1 0 0", "v 1 0 0;");
    }

    #[test]
    fn corners_become_absolute_and_complete() {
        let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        let body = |face: &str| clean(&format!("{v}vt 0 0\nvn 0 0 1\n{face}")).0;
        let start = "v 0 0 0;v 1 0 0;v 0 1 0;vt 0 0;vn 0 0 1;";
        assert_eq!(body("f 1 2 3"), format!("{start}f 1/1/1 2/1/1 3/1/1;"));
        assert_eq!(body("f -3/-1/-1 -2//1 -1/1"), format!("{start}f 1/2/2 2/1/2 3/2/1;"));
        assert_eq!(body("f 1/9/9 2 3"), format!("{start}f 1/1/1 2/1/1 3/1/1;"));
        for bad in
            ["f 1 2 4", "f 0 1 2", "f -4 1 2", "f 1 2 x", "f 1 2 4294967295", "f 1/1/1/1 2 3", "f /1 2 3"]
        {
            assert_eq!(body(bad), start, "{bad}");
        }
        for short in ["f", "f 1", "f 1 2"] {
            assert_eq!(body(short), start, "{short}");
        }
        check("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0", "f 1/1/1 2/1/1 3/1/1;v 0 0 0;v 1 0 0;v 0 1 0;");
    }

    #[test]
    fn oddities_keep_their_first_line() {
        let (_, odd) = clean("v 0 0 0\n\nf 1 2 3\nf 1 1\nf 9 9 9\nl 1 2\nv 1 1 1 1 0 0\n");
        assert_eq!(odd[&Oddity::Face], Tally { count: 2, line: 3 });
        assert_eq!(odd[&Oddity::Short].line, 4);
        assert_eq!(odd[&Oddity::Lines].line, 6);
        assert_eq!(odd[&Oddity::Colors].line, 7);
    }

    #[test]
    fn continued_lines_are_one() {
        check(
            "v 0 0 \\\n0\nv 1 \\\r\n0 \\\n0\nv 0 1 0\nf 1 \\\n 2 \\\n 3",
            "v 0 0  0;v 1  0  0;v 0 1 0;f 1/1/1 2/1/1 3/1/1;".replace("  ", " ").as_str(),
        );
        check("v 0 0 0 \\", "v 0 0 0;");
    }

    /// Each thing that is put right here is one that `tobj` alone refuses, or reads as something else.
    #[test]
    fn what_is_put_right_is_what_tobj_cannot() {
        let corners = |text: &str| {
            let options = tobj::LoadOptions {
                single_index: true,
                triangulate: false,
                ignore_points: true,
                ignore_lines: true,
            };
            let none = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
            let read = tobj::load_obj_buf(&mut text.as_bytes(), &options, none);
            read.map(|(models, _)| models.iter().map(|m| m.mesh.indices.len()).sum::<usize>()).ok()
        };
        let v = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
        for (what, rest, expected) in [
            ("a coordinate that is no number", "v 1,5 0 0\nf 1 2 3", 3),
            ("two coordinates", "v 1 5\nf 1 2 3", 3),
            ("a w of zero", "v 1 1 1 0\nf 1 2 3", 3),
            ("a remark behind numbers", "v 1 1 1 # x\nf 1 2 3", 3),
            ("a texture of one dimension", "vt .5\nf 1/1 2/1 3/1", 3),
            ("a normal that is no number", "vn x 0 1\nf 1//1 2//1 3//1", 3),
            ("an index beyond the end", "f 1 2 3\nf 1 2 4", 3),
            ("an index before the beginning", "f 1 2 3\nf -4 1 2", 3),
            ("an index of nothing", "vt 0 0\nvn 0 0 1\nf 1 2 3\nf 1/9/9 2/9/9 3/9/9", 6),
            ("a vertex that comes later", "o a\nf 1 2 4\no b\nv 1 1 1\nf 1 2 3", 6),
            ("a continued line", "f 1 2 \\\n3", 3),
            ("an old word for a face", "fo 1 2 3", 3),
            ("more than three indices of a corner", "f 1/1/1/1 2 3\nf 1 2 3", 3),
            ("blanks that are none elsewhere", "\0f 1 2 3", 3),
        ] {
            let text = format!("{v}{rest}\n");
            let mut clean = String::new();
            ObjLines::new(&text).read(|text| text.read_to_string(&mut clean)).expect("clean");
            assert_eq!(corners(&clean), Some(expected), "{what}, cleaned");
            assert_ne!(corners(&text), Some(expected), "{what}, as it is");
        }
        // What it reads by itself comes out with the same corners.
        let sound = format!("{v}vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf -1/-1 -2/-1 -3/-1\nl 1 2\n");
        let mut clean = String::new();
        ObjLines::new(&sound).read(|text| text.read_to_string(&mut clean)).expect("clean");
        assert_eq!((corners(&sound), corners(&clean)), (Some(6), Some(6)));
    }

    #[test]
    fn a_long_text_is_cleaned_beside_as_a_short_one() {
        let short: String =
            (0..20_000).map(|i| format!("v {i} .5 -1e{}\nf -1 -1 {}\n", i % 60, i % 9)).collect();
        let long = short.clone() + &"\n".repeat(WORTH);
        assert!(short.len() < WORTH && clean(&short) == clean(&long));
        // Who reads does not have to read to the end.
        let first = ObjLines::new(&long).read(|text| text.lines().next().transpose());
        assert_eq!(first.expect("text"), Some("vt 0 0".to_owned()));
    }

    proptest::proptest! {
        #[test]
        fn what_is_plain_is_a_finite_number(word in "-{0,2}[0-9.]{0,40}[0-9.e+]{0,1}") {
            if is_plain(&word) {
                proptest::prop_assert!(word.parse::<f32>().is_ok_and(f32::is_finite), "{word}");
            }
        }
    }

    #[test]
    fn numbers_plain_at_sight() {
        for plain in ["0", "-1", "1.5", ".5", "-.5", "2.", "00012.250"] {
            assert!(is_plain(plain), "{plain}");
        }
        for not in ["", "-", ".", "-.", "1e3", "+1", "--1", "1-", "1.2.3", "nan", "inf", "0x1", "1_0"] {
            assert!(!is_plain(not), "{not}");
        }
    }

    #[test]
    fn segments_follow_names_materials_and_smoothing() {
        let mut lines = ObjLines::new(
            "v 0 0 0\nf 1 1 1\nusemtl  a b \nf 1 1 1\ng x\ng x\nf 1 1 1\nf 1 1 1\ns 2\nf 1 1 1\nusemtl a b\nusemtl #c\ns off\nf 1 1 1\n",
        );
        lines.read(|mut text| std::io::copy(&mut text, &mut std::io::sink())).unwrap();
        assert_eq!(lines.materials, [("a b".to_owned(), 3), ("#c".to_owned(), 12)]);
        assert_eq!(lines.names, ["", "x"]);
        let s = |first_face, name, material, smoothing| Segment { first_face, name, material, smoothing };
        let expected = [
            s(0, 0, None, 0),
            s(1, 0, Some(0), 0),
            s(2, 1, Some(0), 0),
            s(4, 1, Some(0), 2),
            s(5, 1, Some(1), 0),
        ];
        assert_eq!(lines.segments, expected);
        assert_eq!(lines.faces, 6);
    }
}
