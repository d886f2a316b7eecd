//! Plots of lines as SVG.

use std::ops::Range;

use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;

/// Numbers over the frames of a walk.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Title.
    pub title: String,
    /// What it shows.
    pub caption: String,
    /// Unit of the numbers.
    pub unit: &'static str,
    /// Lines with their names, a number per frame.
    pub lines: Vec<(String, Vec<f32>)>,
    /// A line that should not be crossed.
    pub limit: Option<f32>,
}

/// Numbers at times.
#[derive(Clone, Debug)]
pub struct Curve {
    /// What they are of.
    pub name: String,
    /// Seconds and numbers; those that are none are left out.
    pub points: Vec<(f32, f32)>,
}

/// Colours of lines, and of what should not be crossed.
const COLORS: [RGBColor; 8] = [
    RGBColor(31, 119, 180),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(227, 119, 194),
    RGBColor(127, 127, 127),
    RGBColor(23, 190, 207),
];
const LIMIT: RGBColor = RGBColor(214, 39, 40);

/// Width and height of a plot on a desk, and on a phone.
pub const SIZES: [(u32, u32); 2] = [(860, 260), (360, 240)];

/// Lines over frames, as SVG, on a desk and on a phone; `None` where there are too few frames for a plot.
pub(crate) fn line_plot(plot: &Plot) -> Option<[String; 2]> {
    let frames = plot.lines.iter().map(|(_, values)| values.len()).max().filter(|n| *n > 1)?;
    let values = plot.lines.iter().flat_map(|(_, values)| values).chain(&plot.limit);
    let top = 1.1 * values.copied().filter(|v| v.is_finite()).fold(1e-3f32, f32::max);
    let lines = plot.lines.iter().map(|(name, values)| (name, values.iter().copied().enumerate()));
    let of_size =
        |size| draw(size, None, ["frame", plot.unit], 0..frames - 1, 0.0..top, lines.clone(), plot.limit);
    let [wide, narrow] = SIZES.map(of_size);
    Some([wide?, narrow?])
}

/// Curves over time, as SVG; `None` where there are too few numbers for a plot.
pub fn time_plot(title: &str, unit: &str, curves: &[Curve]) -> Option<String> {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.1.is_finite());
    let end = all().map(|p| p.0).fold(0.0, f32::max);
    if all().count() < 2 || end <= 0.0 {
        return None;
    }
    let (low, high) = all().fold((0f32, 1e-3f32), |(low, high), p| (low.min(p.1), high.max(p.1)));
    let lines = curves.iter().map(|c| (&c.name, c.points.iter().copied().filter(|p| p.1.is_finite())));
    draw((860, 300), Some(title), ["s", unit], 0.0..end, 1.05 * low..1.05 * high, lines, None)
}

fn draw<'l, X, P: IntoIterator<Item = (X, f32)>>(
    size: (u32, u32),
    title: Option<&str>,
    [x_desc, y_desc]: [&str; 2],
    x: Range<X>,
    y: Range<f32>,
    lines: impl Iterator<Item = (&'l String, P)>,
    limit: Option<f32>,
) -> Option<String>
where
    X: Clone + 'static,
    Range<X>: AsRangedCoord<Value = X>,
    <Range<X> as AsRangedCoord>::CoordDescType: Ranged<ValueType = X> + ValueFormatter<X>,
{
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, size);
        let root = root.into_drawing_area();
        let mut builder = ChartBuilder::on(&root);
        builder.margin(8).x_label_area_size(34).y_label_area_size(if size.0 < 500 { 44 } else { 60 });
        if let Some(title) = title {
            root.fill(&WHITE).ok()?;
            builder.caption(title, ("sans-serif", 16));
        }
        let ends = [x.start.clone(), x.end.clone()];
        let mut chart = builder.build_cartesian_2d(x, y).ok()?;
        let mut mesh = chart.configure_mesh();
        if size.0 < 500 {
            mesh.x_labels(5).y_labels(5);
        }
        mesh.x_desc(x_desc).y_desc(y_desc).light_line_style(TRANSPARENT).draw().ok()?;
        for ((name, points), color) in lines.zip(COLORS.into_iter().cycle()) {
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)))
                .ok()?
                .label(name.as_str())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], color.stroke_width(2)));
        }
        if let Some(limit) = limit {
            let line = PathElement::new(ends.map(|x| (x, limit)).to_vec(), LIMIT);
            chart.draw_series(std::iter::once(line)).ok()?;
        }
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .position(SeriesLabelPosition::UpperRight)
            .draw()
            .ok()?;
        root.present().ok()?;
    }
    Some(svg)
}
