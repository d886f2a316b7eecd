//! Curves of errors as plots, and a page with pictures at equal time.

use std::path::Path;

use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::heat::heat_map;
use foveal::metrics::{compare, quantile};
use glam::Vec3;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::error_curves::{Measures, Point, Way};
use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, png_bytes, write_atomic};
use foveal_terminal::report::{Compared, Comparison, Figure, Page, Section, html};
use foveal_terminal::table::{Row, figure, median, table_of};

/// What a plot's axes show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Axes {
    /// A picture that becomes better; errors on a logarithmic axis.
    Still,
    /// The same, with a dashed line at an error that is waited for; time on a logarithmic axis, too.
    Until(f64),
    /// The frames of a walk.
    Walking,
}

/// A part of the page: ways that share a plot.
pub(super) struct Panel<'a> {
    /// Heading.
    pub title: String,
    /// Name of the plot's file, without its ending.
    pub file: String,
    /// What the errors are held against, in words.
    pub against: String,
    pub ways: Vec<&'a Way>,
    pub axes: Axes,
    /// Pictures are those of this moment, in seconds.
    pub at: f64,
    /// What they should look like, with names.
    pub references: Vec<(String, &'a Map2d<Vec3>)>,
}

/// Least error that logarithmic axes show.
const LEAST: f64 = 1e-3;
/// Width and height of a plot, and what of the width is left to the names.
const SIZE: (u32, u32) = (900, 420);
const NAMES_WIDTH: u32 = 220;
/// The same on a phone, where names stand below: the width, the height without them, and that of a name.
const NARROW: (u32, u32) = (360, 280);
const NAME_HEIGHT: u32 = 20;

/// Medians over the runs with bands of 10 to 90 %, as SVG; `None` where there is nothing to plot.
fn plot(ways: &[&Way], axes: Axes, against: &str, is_narrow: bool) -> Option<String> {
    let size = match is_narrow {
        true => (NARROW.0, NARROW.1 + NAME_HEIGHT * (ways.len() as u32 + 1)),
        false => SIZE,
    };
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE).ok()?;
        let (left, right) = match is_narrow {
            true => root.split_vertically(NARROW.1),
            false => root.split_horizontally(SIZE.0 - NAMES_WIDTH),
        };
        let mut builder = ChartBuilder::on(&left);
        builder.margin(10).x_label_area_size(36).y_label_area_size(if is_narrow { 52 } else { 60 });
        let all = || ways.iter().flat_map(|w| w.runs.iter().flatten());
        let range = |of: &dyn Fn(&Point) -> f64| {
            let values = all().map(of).filter(|v| v.is_finite() && *v > 0.0);
            let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
            (high > 0.0).then_some((low, high))
        };
        let (times, errors) = (range(&|p| p.seconds)?, range(&|p| p.corrected.flip.max(LEAST))?);
        let y_desc = match is_narrow {
            true => "mean FLIP".to_owned(),
            false => format!("mean FLIP of non-diffuse pixels against {against}"),
        };
        match axes {
            Axes::Still => {
                let y = 0.8 * errors.0..1.25 * errors.1;
                let chart = builder.build_cartesian_2d(0.0..times.1, y.log_scale()).ok()?;
                draw(chart, ways, None, ["processor time, s", &y_desc])?;
            }
            Axes::Until(error) => {
                let (x, y) = (0.8 * times.0..1.25 * times.1, 0.8 * errors.0.min(error)..1.25 * errors.1);
                let chart = builder.build_cartesian_2d(x.log_scale(), y.log_scale()).ok()?;
                draw(chart, ways, Some((times, error)), ["processor time, s", &y_desc])?;
            }
            Axes::Walking => {
                let chart = builder.build_cartesian_2d(0.0..times.1, 0.0..1.1 * errors.1).ok()?;
                draw(chart, ways, None, ["time of the walk, s", &y_desc])?;
            }
        }
        names(&right, ways)?;
        root.present().ok()?;
    }
    Some(svg)
}

/// The colour of a way: a floor is grey.
fn color(i: usize, way: &Way) -> RGBAColor {
    if way.is_floor { BLACK.mix(0.6) } else { Palette99::pick(i).to_rgba() }
}

/// Beside the plot, so that no name lies over a curve.
fn names<D: DrawingBackend>(area: &DrawingArea<D, plotters::coord::Shift>, ways: &[&Way]) -> Option<()> {
    let font = ("sans-serif", 13).into_font().color(&BLACK);
    let style = font.pos(Pos::new(HPos::Left, VPos::Center));
    for (i, way) in ways.iter().enumerate() {
        let y = 24 + 20 * i as i32;
        let (from, to) = (4, 28);
        let color = color(i, way);
        if way.is_floor {
            for x in (from..to).step_by(8) {
                area.draw(&PathElement::new(vec![(x, y), (x + 4, y)], color.stroke_width(2))).ok()?;
            }
        } else {
            area.draw(&PathElement::new(vec![(from, y), (to, y)], color.stroke_width(2))).ok()?;
        }
        area.draw(&Text::new(way.name.as_str(), (to + 6, y), style.clone())).ok()?;
    }
    Some(())
}

fn draw<'a, X, Y>(
    mut chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<X, Y>>,
    ways: &[&Way],
    waited_for: Option<((f64, f64), f64)>,
    [x_desc, y_desc]: [&str; 2],
) -> Option<()>
where
    X: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
{
    // Ticks are sums of steps: what rounding left of them is cut off.
    let rounded = |v: &f64| ((1e6 * v).round() / 1e6).to_string();
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(x_desc).y_desc(y_desc).light_line_style(TRANSPARENT);
    mesh.x_label_formatter(&rounded).y_label_formatter(&rounded).draw().ok()?;
    if let Some(((from, to), error)) = waited_for {
        let line = DashedLineSeries::new([(from, error), (to, error)], 2, 4, BLACK.mix(0.4).into());
        chart.draw_series(line).ok()?;
    }
    for (i, way) in ways.iter().enumerate() {
        let color = color(i, way);
        let steps = way.runs.iter().map(Vec::len).min().unwrap_or(0);
        let (mut line, mut low, mut high) = (Vec::new(), Vec::new(), Vec::new());
        for step in 0..steps {
            let flips: Vec<f64> = way.runs.iter().map(|r| r[step].corrected.flip.max(LEAST)).collect();
            let seconds: Vec<f64> = way.runs.iter().map(|r| r[step].seconds).collect();
            let (Some(t), Some(e)) = (median(&seconds), median(&flips)) else { continue };
            // On a logarithmic axis there is no beginning.
            if t <= 0.0 && waited_for.is_some() {
                continue;
            }
            line.push((t, e));
            low.push((t, quantile(flips.iter().copied(), 0.1)));
            high.push((t, quantile(flips.iter().copied(), 0.9)));
        }
        if way.is_floor {
            chart.draw_series(DashedLineSeries::new(line, 6, 4, color.stroke_width(2))).ok()?;
            continue;
        }
        high.reverse();
        chart.draw_series([Polygon::new([low, high].concat(), color.mix(0.2))]).ok()?;
        chart.draw_series(LineSeries::new(line, color.stroke_width(2))).ok()?;
    }
    Some(())
}

/// The parts of a page, and their plots as files.
///
/// # Errors
/// If a file cannot be written.
pub(super) fn sections_of(out: &Path, panels: &[Panel<'_>], tone: &ToneMap) -> Result<Vec<Section>, Failure> {
    make_folder(out)?;
    let part = |panel: &Panel<'_>| -> Result<Section, Failure> {
        let section = section(panel, tone)?;
        if let Some(svg) = &section.svg {
            write_atomic(&out.join(format!("{}.svg", panel.file)), svg.as_bytes())?;
        }
        Ok(section)
    };
    panels.iter().map(part).collect()
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
        tables: vec![table_of("All rows", rows)],
        sections,
        ..Page::default()
    };
    write_atomic(&out.join("report.html"), html(&page).as_bytes())
}

/// Milliseconds, or what is easier to read.
fn duration(seconds: f64) -> String {
    if seconds < 1.0 { format!("{} ms", figure(seconds * 1e3)) } else { format!("{} s", figure(seconds)) }
}

/// FLIP, PSNR and relMSE in words.
fn errors(m: &Measures) -> String {
    let decibels = m.psnr.map_or("∞".into(), figure);
    format!("FLIP {:.3}, PSNR {decibels} dB, relMSE {}", m.flip, figure(m.relmse))
}

/// A part of a page: a plot, what pictures should look like, and what each way showed of its first run at a moment.
fn section(panel: &Panel<'_>, tone: &ToneMap) -> Result<Section, Failure> {
    let png = |picture: &Map2d<Vec3>| {
        let rgb8 = picture.map(|c| tone.to_rgb8(c));
        png_bytes(picture.width() as u32, picture.height() as u32, rgb8.data().as_flattened())
    };
    let mut figures = Vec::new();
    for (title, picture) in &panel.references {
        let caption =
            format!("What the other pictures should look like; errors are told against {}.", panel.against);
        figures.push(Figure { title: title.clone(), caption, png: png(picture)? });
    }
    let mut shown = Vec::new();
    for way in &panel.ways {
        let Some(points) = way.runs.first() else { continue };
        // The last picture that was there by then, or the first there ever was.
        let there = points.iter().rev().find(|p| p.seconds <= panel.at * 1.001).or(points.first());
        let Some((point, picture)) = there.and_then(|p| Some((p, p.picture.as_ref()?))) else { continue };
        let when = if way.is_floor { String::new() } else { format!("{}: ", duration(point.seconds)) };
        let (corrected, all) = (errors(&point.corrected), errors(&point.all));
        let figure = Figure {
            title: way.name.clone(),
            caption: format!("{when}non-diffuse pixels {corrected}; all {all}; against {}", way.against),
            png: png(picture)?,
        };
        // Beside the first of the references, where that is of the same view and size.
        let compared = panel.references.first().map(|(_, reference)| compare(picture, reference, tone));
        if let Some(Ok(compared)) = compared {
            let heat = heat_map(&compared.flip_map);
            let flip = png_bytes(heat.width() as u32, heat.height() as u32, heat.data().as_flattened())?;
            shown.push(Compared { figure: figure.clone(), flip });
        }
        figures.push(figure);
    }
    let comparison = panel.references.first().filter(|_| !shown.is_empty()).map(|(title, picture)| Comparison {
        title: format!("{}: side by side", panel.title),
        caption: format!(
            "Left of the line is what is shown after {}, right of it {title}. Look at mirrors, glass and gloss. The difference \
             (FLIP) is bright where a viewer who flips between the two would notice it.",
            duration(panel.at)
        ),
        size: [picture.width() as u32, picture.height() as u32],
        reference: figures[0].clone(),
        shown,
    });
    let caption = format!(
        "Lower is better, and so is to fall earlier. Lines are medians of the runs, bands their 10th to 90th percentile. \
         The pictures below are those shown after {}, or the first there are.",
        duration(panel.at)
    );
    let [svg, narrow] =
        [false, true].map(|is_narrow| plot(&panel.ways, panel.axes, &panel.against, is_narrow));
    Ok(Section { title: panel.title.clone(), svg, narrow, caption, figures, comparison })
}

#[cfg(test)]
mod tests {
    use super::super::error_curves::{Against, ReferenceKind};
    use super::*;

    /// Two runs whose errors fall with the square root of time.
    fn way(name: &str) -> Way {
        let point = |scale: f64, i: i32| Point {
            seconds: f64::from(i) * 0.01,
            corrected: Measures { flip: scale / f64::from(i + 1).sqrt(), ..Measures::default() },
            all: Measures::default(),
            picture: (i == 0).then(|| Map2d::new(4, 3, Vec3::ONE)),
        };
        let runs = [0.2, 0.3].map(|s| (0..9).map(|i| point(s, i)).collect()).to_vec();
        Way { runs, ..Way::new(name, Against { kind: ReferenceKind::Path, spp: 8 }) }
    }

    #[test]
    fn plots_name_their_curves_and_have_short_ticks() {
        let floor = Way { is_floor: true, ..way("floor") };
        let ways = [&way("one"), &way("two"), &floor];
        for axes in [Axes::Still, Axes::Until(0.05), Axes::Walking] {
            let narrow = plot(&ways, axes, "path", true).expect("a plot");
            assert!(narrow.contains("two") && narrow.contains("width=\"360\""));
            let svg = plot(&ways, axes, "path", false).expect("a plot");
            assert!(svg.contains("one") && svg.contains("two") && svg.contains("floor"));
            assert!(svg.contains("against path"), "{svg}");
            // The floor has no band.
            assert_eq!(svg.matches("<polygon").count(), 2);
            assert!(!svg.contains("0000000") && !svg.contains("NaN"), "{svg}");
        }
        assert!(plot(&[], Axes::Walking, "path", false).is_none());
    }

    /// What should be seen stands before what was seen, and both say what they are.
    #[test]
    fn pictures_stand_beside_their_reference() {
        let (one, reference) = (way("one"), Map2d::new(4, 3, Vec3::ONE));
        let panel = Panel {
            title: "t".into(),
            file: "f".into(),
            against: "path".into(),
            ways: vec![&one],
            axes: Axes::Walking,
            at: 0.005,
            references: vec![("the reference".into(), &reference)],
        };
        let section = section(&panel, &ToneMap::default()).expect("a section");
        let titles: Vec<&str> = section.figures.iter().map(|f| f.title.as_str()).collect();
        assert_eq!(titles, ["the reference", "one"]);
        assert!(section.figures[1].caption.contains("against path, 8 samples per pixel"));
        let comparison = section.comparison.expect("both are there");
        assert_eq!((comparison.size, comparison.shown.len()), ([4, 3], 1));
    }
}
