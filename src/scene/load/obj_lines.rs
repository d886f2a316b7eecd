//! Turns any OBJ text into one that `tobj` reads without an error: what it hands on are numbers that
//! parse, faces whose indices exist, and nothing else.
//!
//! `tobj` ends with an error at the first bad number, at an index out of range, at a `w` of 0 and at
//! bytes that are not UTF-8; it has no line numbers, no smoothing groups, and pads nothing where
//! some faces have texture coordinates and others do not. So every corner gets three absolute
//! indices here (a first, zero `vt` and `vn` stand for absent ones), and names, materials and
//! smoothing go into [`Segment`]s beside the stream.

use std::collections::HashMap;
use std::io::{BufRead, Read};

use memchr::memchr;

/// Faces with more corners than this are left out: cutting them up takes quadratic time at worst.
pub(super) const CORNERS_MAX: usize = 1 << 16;

/// Bytes handed on at a time.
const CHUNK: usize = 64 * 1024;

/// Consecutive faces of one name, material and smoothing group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

/// How often something was met, and where first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    pub count: usize,
    pub line: u32,
}

impl Tally {
    fn note(&mut self, line: u32) {
        if self.count == 0 {
            self.line = line;
        }
        self.count += 1;
    }
}

/// What was put right or left out.
#[derive(Clone, Debug, Default)]
pub(super) struct Oddities {
    /// Vertices with a coordinate that is no number, or NaN or infinite.
    pub vertices: Tally,
    /// Faces with a vertex index that is absent, out of range or no number.
    pub faces: Tally,
    /// Texture coordinate or normal indices out of range.
    pub attributes: Tally,
    /// Faces with fewer than three corners.
    pub short: Tally,
    /// Faces with more than [`CORNERS_MAX`] corners.
    pub long: Tally,
    /// Points and lines.
    pub lines: Tally,
    /// Free-form curves and surfaces.
    pub free_form: Tally,
    /// Vertex colours.
    pub colors: Tally,
    /// Normals and texture coordinates that are no numbers.
    pub numbers: Tally,
}

/// The cleaned text as a stream, and what stands beside it.
pub(super) struct ObjLines<'a> {
    text: &'a [u8],
    at: usize,
    line: u32,
    out: Vec<u8>,
    out_at: usize,
    /// Counts of v, vt, vn so far.
    counts: [usize; 3],
    /// Counts in the whole file, once something refers forward.
    totals: Option<[usize; 3]>,
    /// Faces handed on.
    faces: usize,
    corners: Vec<[usize; 3]>,
    joined: Vec<u8>,
    current: Segment,
    name_of: HashMap<&'a [u8], u32>,
    material_of: HashMap<&'a [u8], u32>,
    /// Names of `o` and `g`; the first is empty.
    pub names: Vec<String>,
    /// Names of `usemtl` and the line of their first use.
    pub materials: Vec<(String, u32)>,
    /// What follows `mtllib`, with the line.
    pub libraries: Vec<(String, u32)>,
    /// In the order of faces.
    pub segments: Vec<Segment>,
    /// What was put right.
    pub odd: Oddities,
}

fn is_space(b: u8) -> bool {
    matches!(b, b' ' | b'\t' | b'\r' | 0 | 0x0b | 0x0c)
}

/// Words of a line. NUL bytes count as blanks, `#` at the start of a word ends the line.
#[derive(Clone)]
struct Words<'a>(&'a [u8]);

impl<'a> Iterator for Words<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let start = self.0.iter().position(|&b| !is_space(b))?;
        let rest = &self.0[start..];
        if rest[0] == b'#' {
            self.0 = &[];
            return None;
        }
        let end = rest.iter().position(|&b| is_space(b)).unwrap_or(rest.len());
        self.0 = &rest[end..];
        Some(&rest[..end])
    }
}

/// Text after the keyword, without blanks at the ends.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let Some(a) = bytes.iter().position(|&b| !is_space(b)) else { return &[] };
    let b = bytes.iter().rposition(|&b| !is_space(b)).map_or(a, |b| b + 1);
    &bytes[a..b]
}

/// Digits with at most a sign and a point: these always parse, and are finite if not very long.
#[inline]
fn is_plain_number(word: &[u8]) -> bool {
    let word = word.strip_prefix(b"-").unwrap_or(word);
    let mut digits = 0;
    let mut points = 0;
    for &b in word {
        if b.is_ascii_digit() {
            digits += 1;
        } else if b == b'.' {
            points += 1;
        } else {
            return false;
        }
    }
    digits > 0 && points <= 1 && digits < 30
}

/// The number, as `tobj` will read it.
fn number(word: &[u8]) -> Option<f32> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

/// A whole number with a sign; `None` if there is none or it is too long.
#[inline]
fn whole(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word.first() {
        Some(b'-') => (true, &word[1..]),
        Some(b'+') => (false, &word[1..]),
        _ => (false, word),
    };
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut n = 0i64;
    for &b in digits {
        if !b.is_ascii_digit() {
            return None;
        }
        n = n * 10 + i64::from(b - b'0');
    }
    Some(if negative { -n } else { n })
}

fn push_whole(out: &mut Vec<u8>, mut n: usize) {
    let mut digits = [0u8; 20];
    let mut at = digits.len();
    loop {
        at -= 1;
        digits[at] = b'0' + (n % 10) as u8;
        n /= 10;
        if n == 0 {
            break;
        }
    }
    out.extend_from_slice(&digits[at..]);
}

/// Whether the next line belongs to this one.
fn ends_in_backslash(line: &[u8]) -> bool {
    line.strip_suffix(b"\r").unwrap_or(line).last() == Some(&b'\\')
}

/// Counts `v`, `vt` and `vn` lines.
fn count_all(text: &[u8]) -> [usize; 3] {
    let mut counts = [0; 3];
    let mut continued = false;
    for line in text.split(|&b| b == b'\n') {
        let within = std::mem::replace(&mut continued, ends_in_backslash(line));
        if within {
            continue;
        }
        match Words(line).next() {
            Some(b"v") => counts[0] += 1,
            Some(b"vt") => counts[1] += 1,
            Some(b"vn") => counts[2] += 1,
            _ => {}
        }
    }
    counts
}

impl<'a> ObjLines<'a> {
    /// Of a whole file, without byte-order mark.
    pub fn new(text: &'a [u8]) -> Self {
        let mut out = Vec::with_capacity(CHUNK + 4096);
        // What absent texture coordinates and normals refer to.
        out.extend_from_slice(b"vt 0 0\nvn 0 0 0\n");
        Self {
            text,
            at: 0,
            line: 0,
            out,
            out_at: 0,
            counts: [0; 3],
            totals: None,
            faces: 0,
            corners: Vec::new(),
            joined: Vec::new(),
            current: Segment { first_face: 0, name: 0, material: None, smoothing: 0 },
            name_of: HashMap::new(),
            material_of: HashMap::new(),
            names: vec![String::new()],
            materials: Vec::new(),
            libraries: Vec::new(),
            segments: Vec::new(),
            odd: Oddities::default(),
        }
    }

    fn refill(&mut self) {
        self.out.clear();
        self.out_at = 0;
        while self.at < self.text.len() && self.out.len() < CHUNK {
            let text = self.text;
            let rest = &text[self.at..];
            let end = memchr(b'\n', rest).unwrap_or(rest.len());
            let line = &rest[..end];
            self.at += end + 1;
            self.line += 1;
            if ends_in_backslash(line) {
                self.continued(line);
            } else {
                self.statement(line, Some(line));
            }
        }
    }

    /// A line that ends in `\`, joined with those that follow.
    fn continued(&mut self, first: &[u8]) {
        let without = |l: &[u8]| l.iter().rposition(|&b| b == b'\\').unwrap_or(l.len());
        let mut joined = std::mem::take(&mut self.joined);
        joined.clear();
        joined.extend_from_slice(&first[..without(first)]);
        let start = self.line;
        while self.at < self.text.len() {
            let rest = &self.text[self.at..];
            let end = memchr(b'\n', rest).unwrap_or(rest.len());
            let line = &rest[..end];
            self.at += end + 1;
            self.line += 1;
            joined.push(b' ');
            if ends_in_backslash(line) {
                joined.extend_from_slice(&line[..without(line)]);
            } else {
                joined.extend_from_slice(line);
                break;
            }
        }
        let last = std::mem::replace(&mut self.line, start);
        self.statement(&joined, None);
        self.line = last;
        self.joined = joined;
    }

    /// `lasting` is the same line, if it lives as long as the text.
    fn statement(&mut self, line: &[u8], lasting: Option<&'a [u8]>) {
        let mut words = Words(line);
        let Some(keyword) = words.next() else { return };
        match keyword {
            b"v" => self.vertex(words),
            b"vt" => self.texture_coordinate(words),
            b"vn" => self.normal(words),
            b"f" | b"fo" => self.face(words),
            b"o" | b"g" | b"usemtl" | b"mtllib" => {
                let start = line.iter().position(|&b| !is_space(b)).unwrap_or(0) + keyword.len();
                self.named(keyword, trimmed(&line[start..]), lasting.map(|l| trimmed(&l[start..])));
            }
            b"s" => {
                self.current.smoothing = match words.next() {
                    None | Some(b"off") | Some(b"OFF") | Some(b"null") => 0,
                    Some(w) => whole(w).map_or(0, |n| n.clamp(0, i64::from(u32::MAX)) as u32),
                };
            }
            b"l" | b"p" => self.odd.lines.note(self.line),
            b"curv" | b"curv2" | b"surf" => self.odd.free_form.note(self.line),
            _ => {}
        }
    }

    fn named(&mut self, keyword: &[u8], name: &[u8], lasting: Option<&'a [u8]>) {
        let text = || String::from_utf8_lossy(name).into_owned();
        match keyword {
            b"mtllib" => self.libraries.push((text(), self.line)),
            b"usemtl" if name.is_empty() => self.current.material = None,
            b"usemtl" => {
                // A name twice in the list does no harm; it only costs memory where a line is continued.
                let known = self.material_of.get(name).copied();
                let index = known.unwrap_or_else(|| {
                    self.materials.push((text(), self.line));
                    self.materials.len() as u32 - 1
                });
                if let (None, Some(l)) = (known, lasting) {
                    self.material_of.insert(l, index);
                }
                self.current.material = Some(index);
            }
            _ => {
                let known = self.name_of.get(name).copied();
                let index = known.unwrap_or_else(|| {
                    self.names.push(text());
                    self.names.len() as u32 - 1
                });
                if let (None, Some(l)) = (known, lasting) {
                    self.name_of.insert(l, index);
                }
                self.current.name = index;
            }
        }
    }

    fn vertex(&mut self, mut words: Words<'_>) {
        self.counts[0] += 1;
        self.out.extend_from_slice(b"v");
        let mut good = true;
        for _ in 0..3 {
            good &= self.coordinate(words.next(), b"nan");
        }
        if !good {
            self.odd.vertices.note(self.line);
        }
        // x y z, then w, or r g b, or w and colours: only a lone w moves the vertex.
        if let Some(w) = words.next() {
            if words.next().is_some() {
                self.odd.colors.note(self.line);
            } else if number(w).is_some_and(|w| w != 0.0 && w.is_finite()) {
                self.out.push(b' ');
                self.out.extend_from_slice(w);
            } else {
                self.odd.vertices.note(self.line);
            }
        }
        self.out.push(b'\n');
    }

    /// Hands on a number, or `instead` where there is none. Whether it was a finite one.
    #[inline]
    fn coordinate(&mut self, word: Option<&[u8]>, instead: &[u8]) -> bool {
        self.out.push(b' ');
        let Some(word) = word else {
            self.out.extend_from_slice(instead);
            return false;
        };
        if is_plain_number(word) {
            self.out.extend_from_slice(word);
            return true;
        }
        match number(word) {
            Some(v) => {
                self.out.extend_from_slice(word);
                v.is_finite()
            }
            None => {
                self.out.extend_from_slice(instead);
                false
            }
        }
    }

    fn texture_coordinate(&mut self, mut words: Words<'_>) {
        self.counts[1] += 1;
        self.out.extend_from_slice(b"vt");
        let u = self.coordinate(words.next(), b"0");
        // One number is a one-dimensional texture.
        let v = self.coordinate(Some(words.next().unwrap_or(b"0")), b"0");
        if !(u && v) {
            self.odd.numbers.note(self.line);
        }
        self.out.push(b'\n');
    }

    fn normal(&mut self, mut words: Words<'_>) {
        self.counts[2] += 1;
        self.out.extend_from_slice(b"vn");
        let mut good = true;
        for _ in 0..3 {
            good &= self.coordinate(words.next(), b"0");
        }
        if !good {
            self.odd.numbers.note(self.line);
        }
        self.out.push(b'\n');
    }

    /// The absolute index from 1 of `index` among what `kind` counts; `None` if there is no such.
    #[inline]
    fn resolve(&mut self, index: i64, kind: usize) -> Option<usize> {
        let count = self.counts[kind];
        if index < 0 {
            let back = index.unsigned_abs() as usize;
            return (back <= count).then(|| count + 1 - back);
        }
        let index = index as usize;
        if index == 0 {
            return None;
        }
        if index > count {
            let text = self.text;
            let totals = self.totals.get_or_insert_with(|| count_all(text));
            return (index <= totals[kind]).then_some(index);
        }
        Some(index)
    }

    fn corner(&mut self, word: &[u8]) -> Option<[usize; 3]> {
        // 1 is the zero that stands for absent ones, so real ones begin at 2.
        let mut corner = [0, 1, 1];
        for (kind, part) in word.split(|&b| b == b'/').enumerate() {
            if kind == 3 {
                return None;
            }
            if part.is_empty() {
                continue;
            }
            let found = whole(part).and_then(|i| self.resolve(i, kind));
            match (kind, found) {
                (0, i) => corner[0] = i?,
                (_, Some(i)) => corner[kind] = i + 1,
                (_, None) => self.odd.attributes.note(self.line),
            }
        }
        (corner[0] > 0).then_some(corner)
    }

    fn face(&mut self, words: Words<'_>) {
        self.corners.clear();
        for word in words {
            let Some(corner) = self.corner(word) else {
                self.odd.faces.note(self.line);
                return;
            };
            self.corners.push(corner);
        }
        if self.corners.len() < 3 {
            self.odd.short.note(self.line);
            return;
        }
        if self.corners.len() > CORNERS_MAX {
            self.odd.long.note(self.line);
            return;
        }
        let now = Segment { first_face: self.faces, ..self.current };
        if self.segments.last().is_none_or(|s| Segment { first_face: now.first_face, ..*s } != now) {
            self.segments.push(now);
        }
        self.out.push(b'f');
        for &[v, vt, vn] in &self.corners {
            for (index, before) in [(v, b' '), (vt, b'/'), (vn, b'/')] {
                self.out.push(before);
                push_whole(&mut self.out, index);
            }
        }
        self.out.push(b'\n');
        self.faces += 1;
    }
}

impl Read for ObjLines<'_> {
    fn read(&mut self, buf: &mut [u8]) -> std::io::Result<usize> {
        let from = self.fill_buf()?;
        let n = from.len().min(buf.len());
        buf[..n].copy_from_slice(&from[..n]);
        self.consume(n);
        Ok(n)
    }
}

impl BufRead for ObjLines<'_> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        while self.out_at >= self.out.len() && self.at < self.text.len() {
            self.refill();
        }
        Ok(&self.out[self.out_at..])
    }

    fn consume(&mut self, n: usize) {
        self.out_at = (self.out_at + n).min(self.out.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clean(text: &str) -> (String, Oddities) {
        let mut lines = ObjLines::new(text.as_bytes());
        let mut out = String::new();
        lines.read_to_string(&mut out).unwrap();
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
        assert_eq!(odd.faces, Tally { count: 2, line: 3 });
        assert_eq!(odd.short.line, 4);
        assert_eq!(odd.lines.line, 6);
        assert_eq!(odd.colors.line, 7);
    }

    #[test]
    fn continued_lines_are_one() {
        check(
            "v 0 0 \\\n0\nv 1 \\\r\n0 \\\n0\nv 0 1 0\nf 1 \\\n 2 \\\n 3",
            "v 0 0  0;v 1  0  0;v 0 1 0;f 1/1/1 2/1/1 3/1/1;".replace("  ", " ").as_str(),
        );
        check("v 0 0 0 \\", "v 0 0 0;");
    }

    #[test]
    fn segments_follow_names_materials_and_smoothing() {
        let mut lines = ObjLines::new(b"v 0 0 0\nf 1 1 1\nusemtl  a b \nf 1 1 1\ng x\ng x\nf 1 1 1\nf 1 1 1\ns 2\nf 1 1 1\nusemtl a b\nusemtl #c\ns off\nf 1 1 1\n");
        std::io::copy(&mut lines, &mut std::io::sink()).unwrap();
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
