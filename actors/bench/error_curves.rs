//! How far pictures are from what they should be, over time: references, measures, and curves of several runs.

use std::fmt;

use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::flip;
use foveal::metrics::pixels::{linear_errors, mse, psnr};
use foveal_terminal::table::csv_lines;
use glam::Vec3;

/// Which gold standard pictures are held against, named as `foveal reference --kind` does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ReferenceKind {
    /// What still views converge to: the base light, and everything that is not diffuse traced.
    Traced,
    /// Unbiased paths, which know of no base light.
    Path,
}

/// A reference of so many samples per pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Against {
    pub kind: ReferenceKind,
    pub spp: u32,
}

impl ReferenceKind {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Traced => "traced",
            Self::Path => "path",
        }
    }
}

impl fmt::Display for Against {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}, {} sample{} per pixel",
            self.kind.name(),
            self.spp,
            if self.spp == 1 { "" } else { "s" }
        )
    }
}

/// Errors of some pixels of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Measures {
    /// Mean FLIP.
    pub flip: f64,
    /// Decibels; `None` without any error.
    pub psnr: Option<f64>,
    /// Mean relative squared error of linear radiance.
    pub relmse: f64,
}

/// One picture of a curve.
#[derive(Clone, Debug)]
pub(super) struct Point {
    /// When it was there.
    pub seconds: f64,
    /// Errors of the pixels that are corrected, which are not diffuse.
    pub corrected: Measures,
    /// Errors of all pixels.
    pub all: Measures,
    /// The picture, of runs that are shown.
    pub picture: Option<Map2d<Vec3>>,
}

/// One way to come to a picture, and its curves, one of each run.
#[derive(Clone, Debug)]
pub(super) struct Way {
    pub name: String,
    pub against: Against,
    /// Whether this is where others end, however long they take.
    pub is_floor: bool,
    pub runs: Vec<Vec<Point>>,
}

impl Way {
    /// A way that nobody went yet.
    pub(super) fn new(name: impl Into<String>, against: Against) -> Self {
        Self { name: name.into(), against, is_floor: false, runs: Vec::new() }
    }
}

/// Measures pictures of a view.
#[derive(Clone, Copy)]
pub(super) struct Judge<'v> {
    /// Object ids; 0 where nothing is corrected.
    pub objects: &'v Map2d<u32>,
    pub tone: &'v ToneMap,
    /// Whether points keep their pictures.
    pub keeps: bool,
}

impl Judge<'_> {
    /// How far `picture`, there after `seconds`, is from `reference`.
    pub(super) fn point(&self, reference: &Map2d<Vec3>, seconds: f64, picture: &Map2d<Vec3>) -> Point {
        let map = flip::flip(reference, picture, self.tone);
        let is_corrected: Vec<bool> = self.objects.data().iter().map(|id| *id != 0).collect();
        let corrected = |m: &Map2d<Vec3>| {
            let values = m.data().iter().zip(&is_corrected).filter(|(_, c)| **c).map(|(v, _)| *v);
            let values: Vec<Vec3> = values.collect();
            Map2d::from_vec(values.len(), 1, values)
        };
        let flips = map.data().iter().zip(&is_corrected).filter(|(_, c)| **c);
        let sum: f64 = flips.map(|(e, _)| f64::from(*e)).sum();
        let count = is_corrected.iter().filter(|c| **c).count().max(1);
        let measures = |flip: f64, test: &Map2d<Vec3>, reference: &Map2d<Vec3>| {
            let shown = |m: &Map2d<Vec3>| m.map(|c| self.tone.to_linear(c));
            let relmse = linear_errors(test, reference).relmse;
            Measures { flip, psnr: psnr(mse(&shown(test), &shown(reference))), relmse }
        };
        Point {
            seconds,
            corrected: measures(sum / count as f64, &corrected(picture), &corrected(reference)),
            all: measures(flip::mean(&map), picture, reference),
            picture: self.keeps.then(|| picture.clone()),
        }
    }
}

/// When a curve first is at an error or below it, between its points; infinite where it never is.
pub(super) fn time_to(points: &[Point], error: f64) -> f64 {
    let mut before: Option<&Point> = None;
    for p in points {
        if p.corrected.flip <= error {
            return match before {
                // Errors fall like powers of time, so on straight lines of logarithms.
                Some(b) if b.corrected.flip > p.corrected.flip && b.seconds > 0.0 && error > 0.0 => {
                    let gain = (b.corrected.flip / p.corrected.flip.max(1e-9)).ln();
                    let share = (b.corrected.flip / error).ln() / gain;
                    b.seconds * (p.seconds / b.seconds).powf(share)
                }
                _ => p.seconds,
            };
        }
        before = Some(p);
    }
    f64::INFINITY
}

/// Head of a table with a line for each point of each run. Times are in seconds, PSNR in dB.
pub(super) const CSV_HEAD: &str = "scene,motion,way,run,seconds,flip of non-diffuse pixels,flip,psnr of non-diffuse \
                                   pixels,psnr,relmse of non-diffuse pixels,relmse,reference,samples per pixel of \
                                   the reference\n";

/// The lines of these ways.
pub(super) fn csv(scene: &str, motion: &str, ways: &[Way]) -> String {
    let points = ways.iter().flat_map(|way| {
        let numbered = way.runs.iter().enumerate();
        numbered.flat_map(move |(run, points)| points.iter().map(move |point| (way, run, point)))
    });
    csv_lines(points.map(|(way, run, Point { seconds, corrected: c, all: a, picture: _ })| {
        let errors = (c.flip, a.flip, c.psnr, a.psnr, c.relmse, a.relmse);
        (scene, motion, &way.name, run, seconds, errors, way.against.kind.name(), way.against.spp)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pixels that are corrected have errors of their own; where none is, there is no error.
    #[test]
    fn errors_are_told_of_corrected_pixels_and_of_all() {
        let reference = Map2d::new(8, 8, Vec3::splat(0.2));
        let picture = Map2d::from_fn(8, 8, |x, _| Vec3::splat(if x < 4 { 0.2 } else { 0.6 }));
        let tone = ToneMap::default();
        let of = |ids: &Map2d<u32>| {
            Judge { objects: ids, tone: &tone, keeps: false }.point(&reference, 1.0, &picture)
        };
        let right = of(&Map2d::from_fn(8, 8, |x, _| u32::from(x >= 4)));
        let none = of(&Map2d::new(8, 8, 0));
        let relative = |share: f64| share * 0.16 / (0.04 + 0.01);
        assert!((right.corrected.relmse - relative(1.0)).abs() < 1e-6, "{right:?}");
        assert!((right.all.relmse - relative(0.5)).abs() < 1e-6, "{right:?}");
        assert!(right.corrected.flip > right.all.flip && right.corrected.psnr < right.all.psnr);
        assert_eq!(none.corrected, Measures::default());
        assert_eq!(none.all, right.all);
        assert!(right.picture.is_none());
    }

    /// Errors that fall like powers of time are met where they are, however few the points.
    #[test]
    fn times_are_found_between_points() {
        let point = |seconds: f64, flip: f64| Point {
            seconds,
            corrected: Measures { flip, ..Measures::default() },
            all: Measures::default(),
            picture: None,
        };
        let points = [point(1.0, 0.4), point(4.0, 0.2), point(16.0, 0.1), point(17.0, 0.0)];
        for (error, time) in [(0.5, 1.0), (0.4, 1.0), (0.2, 4.0), (0.1 * 2f64.sqrt(), 8.0), (0.0, 17.0)] {
            assert!((time_to(&points, error) - time).abs() < 1e-9, "{error}");
        }
        assert_eq!(time_to(&points[..2], 0.1), f64::INFINITY);
        assert_eq!(time_to(&[], 0.1), f64::INFINITY);
    }

    /// Each line says what it is held against, and every line has every column.
    #[test]
    fn lines_of_the_table_name_their_reference() {
        let tone = ToneMap::default();
        let (ids, picture) = (Map2d::new(4, 3, 1), Map2d::new(4, 3, Vec3::ONE));
        let point = Judge { objects: &ids, tone: &tone, keeps: false }.point(&picture, 0.5, &picture);
        let of =
            |kind, spp| Way { runs: vec![vec![point.clone()]], ..Way::new("a, b", Against { kind, spp }) };
        let lines = csv("s", "still", &[of(ReferenceKind::Traced, 1), of(ReferenceKind::Path, 256)]);
        let lines: Vec<&str> = lines.lines().collect();
        assert!(lines[0].ends_with(",traced,1") && lines[1].ends_with(",path,256"), "{lines:?}");
        // The way's name has a comma of its own.
        let columns = CSV_HEAD.matches(',').count() + 1;
        assert!(lines.iter().all(|l| l.matches(',').count() == columns), "{lines:?}");
    }
}
