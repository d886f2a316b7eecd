//! How far pictures are from what they should be, over time: measures, curves of several runs, plots and a page.

use std::fmt::Write as _;
use std::path::Path;

use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::flip;
use foveal::metrics::pixels::{linear_errors, mse, psnr};
use glam::Vec3;
use plotters::prelude::*;

use super::messages::load::quantile;
use super::table::{Row, median, table_of};
use crate::cli::failure::Failure;
use crate::cli::output::{make_folder, png_bytes, write_atomic};
use crate::cli::report::{Figure, Page, Section, html};

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
    pub runs: Vec<Vec<Point>>,
}

/// What pictures of a view are held against.
pub(super) struct Judge<'v> {
    /// Object ids; 0 where nothing is corrected.
    pub objects: &'v Map2d<u32>,
    pub tone: &'v ToneMap,
    pub reference: &'v Map2d<Vec3>,
    /// Whether points keep their pictures.
    pub keeps: bool,
}

impl Judge<'_> {
    pub(super) fn point(&self, seconds: f64, picture: Map2d<Vec3>) -> Point {
        let map = flip::flip(self.reference, &picture, self.tone);
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
            corrected: measures(sum / count as f64, &corrected(&picture), &corrected(self.reference)),
            all: measures(flip::mean(&map), &picture, self.reference),
            picture: self.keeps.then_some(picture),
        }
    }
}

/// Lines of a table: one for each point of each run.
pub(super) const CSV_HEAD: &str = "scene,motion,way,run,seconds,flip of non-diffuse pixels,flip,psnr of non-diffuse \
                                   pixels,psnr,relmse of non-diffuse pixels,relmse\n";

/// The lines of these ways.
pub(super) fn csv(scene: &str, motion: &str, ways: &[Way]) -> String {
    let mut out = String::new();
    let decibels = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    for way in ways {
        for (run, points) in way.runs.iter().enumerate() {
            for Point { seconds, corrected: c, all: a, picture: _ } in points {
                let _ = writeln!(
                    out,
                    "{scene},{motion},\"{}\",{run},{seconds},{},{},{},{},{},{}",
                    way.name,
                    c.flip,
                    a.flip,
                    decibels(c.psnr),
                    decibels(a.psnr),
                    c.relmse,
                    a.relmse
                );
            }
        }
    }
    out
}

/// What a plot shows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plot {
    /// A picture that becomes better; errors on a logarithmic axis.
    Still,
    /// The same, with a dashed line where it counts as right; time on a logarithmic axis, too.
    UntilRight(f64),
    /// The frames of a walk.
    Walking,
}

/// Least error that logarithmic axes show.
const LEAST: f64 = 1e-3;

/// Medians over the runs with bands of 10 to 90 %, as SVG; `None` where there is nothing to plot.
fn plot(ways: &[Way], plot: Plot) -> Option<String> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (860, 420)).into_drawing_area();
        root.fill(&WHITE).ok()?;
        let mut builder = ChartBuilder::on(&root);
        builder.margin(8).x_label_area_size(34).y_label_area_size(56);
        let all = || ways.iter().flat_map(|w| w.runs.iter().flatten());
        let range = |of: &dyn Fn(&Point) -> f64| {
            let values = all().map(of).filter(|v| v.is_finite() && *v > 0.0);
            let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
            (high > 0.0).then_some((low, high))
        };
        let (times, errors) = (range(&|p| p.seconds)?, range(&|p| p.corrected.flip.max(LEAST))?);
        match plot {
            Plot::Still => {
                let y = 0.8 * errors.0..1.25 * errors.1;
                let chart = builder.build_cartesian_2d(0.0..times.1, y.log_scale()).ok()?;
                draw(chart, ways, None, "processor seconds")?;
            }
            Plot::UntilRight(right) => {
                let (x, y) = (0.8 * times.0..1.25 * times.1, 0.8 * errors.0.min(right)..1.25 * errors.1);
                let chart = builder.build_cartesian_2d(x.log_scale(), y.log_scale()).ok()?;
                draw(chart, ways, Some((times, right)), "processor seconds")?;
            }
            Plot::Walking => {
                let chart = builder.build_cartesian_2d(0.0..times.1, 0.0..1.1 * errors.1).ok()?;
                draw(chart, ways, None, "seconds of the walk")?;
            }
        }
        root.present().ok()?;
    }
    Some(svg)
}

fn draw<'a, X, Y>(
    mut chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<X, Y>>,
    ways: &[Way],
    right: Option<((f64, f64), f64)>,
    x_desc: &str,
) -> Option<()>
where
    X: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
{
    // Ticks are sums of steps: what rounding left of them is cut off.
    let rounded = |v: &f64| ((1e6 * v).round() / 1e6).to_string();
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(x_desc).y_desc("mean FLIP of non-diffuse pixels").light_line_style(TRANSPARENT);
    mesh.x_label_formatter(&rounded).y_label_formatter(&rounded).draw().ok()?;
    if let Some(((from, to), right)) = right {
        let line = DashedLineSeries::new([(from, right), (to, right)], 4, 4, BLACK.mix(0.4).into());
        chart.draw_series(line).ok()?;
    }
    for (i, way) in ways.iter().enumerate() {
        let color = Palette99::pick(i).to_rgba();
        let steps = way.runs.iter().map(Vec::len).min().unwrap_or(0);
        let (mut line, mut low, mut high) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..steps {
            let mut flips: Vec<f64> = way.runs.iter().map(|r| r[step].corrected.flip.max(LEAST)).collect();
            let seconds: Vec<f64> = way.runs.iter().map(|r| r[step].seconds).collect();
            let (Some(t), Some(e)) = (median(&seconds), median(&flips)) else { continue };
            // On a logarithmic axis there is no beginning.
            if t <= 0.0 && right.is_some() {
                continue;
            }
            line.push((t, e));
            low.push((t, quantile(&mut flips, 0.1)));
            high.push((t, quantile(&mut flips, 0.9)));
        }
        high.reverse();
        chart.draw_series([Polygon::new([low, high].concat(), color.mix(0.2))]).ok()?;
        let legend = move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], color.stroke_width(2));
        let series = chart.draw_series(LineSeries::new(line, color.stroke_width(2))).ok()?;
        series.label(way.name.as_str()).legend(legend);
    }
    let mut labels = chart.configure_series_labels();
    labels.position(SeriesLabelPosition::LowerLeft).background_style(WHITE.mix(0.8)).draw().ok()
}

/// The parts of a page about one scene, standing still and walking, with pictures of these moments; and their plots as
/// files.
///
/// # Errors
/// If a file cannot be written.
pub(super) fn sections_of(
    out: &Path,
    name: &str,
    [still, walking]: [&[Way]; 2],
    right: Option<f64>,
    [still_at, walking_at]: [f64; 2],
    tone: &ToneMap,
) -> Result<[Section; 2], Failure> {
    make_folder(out)?;
    let part = |motion: &str, ways, what, at| -> Result<Section, Failure> {
        let section = section(format!("{name}, {motion}"), ways, what, at, tone)?;
        if let Some(svg) = &section.svg {
            write_atomic(&out.join(format!("error-{name}-{motion}.svg")), svg.as_bytes())?;
        }
        Ok(section)
    };
    Ok([
        part("still", still, right.map_or(Plot::Still, Plot::UntilRight), still_at)?,
        part("walking", walking, Plot::Walking, walking_at)?,
    ])
}

/// All curves as a table, and the page with everything.
///
/// # Errors
/// If a file cannot be written.
pub(super) fn write_page(
    out: &Path,
    csv_name: &str,
    csv: &str,
    rows: &[Row],
    notes: &[String],
    sections: Vec<Section>,
) -> Result<(), Failure> {
    make_folder(out)?;
    write_atomic(&out.join(csv_name), csv.as_bytes())?;
    let page = Page {
        title: "Error against time".into(),
        summary: notes.to_vec(),
        tables: vec![table_of("Medians", rows)],
        sections,
        ..Page::default()
    };
    write_atomic(&out.join("report.html"), html(&page).as_bytes())
}

/// A part of a page: a plot, and what each way showed of its first run at `at` seconds.
fn section(title: String, ways: &[Way], what: Plot, at: f64, tone: &ToneMap) -> Result<Section, Failure> {
    let mut figures = Vec::new();
    for way in ways {
        let Some(points) = way.runs.first() else { continue };
        // The last picture that was there by then, or the first there ever was.
        let there = points.iter().rev().find(|p| p.seconds <= at * 1.001).or(points.first());
        let Some((point, picture)) = there.and_then(|p| Some((p, p.picture.as_ref()?))) else { continue };
        let rgb8 = picture.map(|c| tone.to_rgb8(c));
        figures.push(Figure {
            title: way.name.clone(),
            caption: format!("{:.1} ms, FLIP {:.3}", point.seconds * 1e3, point.corrected.flip),
            png: png_bytes(picture.width() as u32, picture.height() as u32, rgb8.data().as_flattened())?,
        });
    }
    let caption = format!(
        "Medians of the runs with bands of 10 to 90 %. Below, what is shown after {:.1} ms.",
        at * 1e3
    );
    Ok(Section { title, svg: plot(ways, what), caption, figures })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two runs whose errors fall with the square root of time.
    fn way(name: &str) -> Way {
        let point = |scale: f64, i: i32| Point {
            seconds: f64::from(i) * 0.01,
            corrected: Measures { flip: scale / f64::from(i + 1).sqrt(), ..Measures::default() },
            all: Measures::default(),
            picture: (i == 0).then(|| Map2d::new(4, 3, Vec3::ONE)),
        };
        Way { name: name.into(), runs: [0.2, 0.3].map(|s| (0..9).map(|i| point(s, i)).collect()).to_vec() }
    }

    #[test]
    fn plots_name_their_curves_and_have_short_ticks() {
        let ways = [way("one"), way("two")];
        for what in [Plot::Still, Plot::UntilRight(0.05), Plot::Walking] {
            let svg = plot(&ways, what).expect("a plot");
            assert!(svg.contains("one") && svg.contains("two") && svg.matches("<polygon").count() >= 2);
            assert!(!svg.contains("0000000") && !svg.contains("NaN"), "{svg}");
        }
        assert!(plot(&[], Plot::Walking).is_none());
        let section =
            section("t".into(), &ways, Plot::Walking, 0.005, &ToneMap::default()).expect("a section");
        assert_eq!(section.figures.len(), 2);
    }

    /// The pixels that are corrected have errors of their own; where none is, there is no error.
    #[test]
    fn errors_are_told_of_corrected_pixels_and_of_all() {
        let reference = Map2d::new(8, 8, Vec3::splat(0.2));
        let picture = Map2d::from_fn(8, 8, |x, _| Vec3::splat(if x < 4 { 0.2 } else { 0.6 }));
        let tone = ToneMap::default();
        let of = |ids: &Map2d<u32>| {
            let judge = Judge { objects: ids, tone: &tone, reference: &reference, keeps: false };
            judge.point(1.0, picture.clone())
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
}
