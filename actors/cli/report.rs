//! The report of a walk: one HTML file that stands alone, pictures and plots inside it.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use plotters::prelude::*;

/// A picture with its caption.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Short title.
    pub title: String,
    /// What it shows, in a sentence or two.
    pub caption: String,
    /// PNG bytes.
    pub png: Vec<u8>,
}

/// A table: a header and rows of cells.
#[derive(Clone, Debug)]
pub struct Table {
    /// Title.
    pub title: String,
    /// Column names.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// One frame's time for the plot.
#[derive(Clone, Copy, Debug)]
pub struct FramePoint {
    /// Milliseconds from its beginning until it was shown.
    pub total_ms: f32,
    /// Milliseconds of drawing.
    pub display_ms: f32,
    /// Samples that were traced for it.
    pub samples: u32,
    /// Its quality as estimated, −1 × mean visible error of its pixels, just noticeable differences.
    pub quality: f32,
}

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

/// A part of a page: a plot and pictures that belong together.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// Title.
    pub title: String,
    /// A plot.
    pub svg: Option<String>,
    /// What it shows.
    pub caption: String,
    /// Pictures.
    pub figures: Vec<Figure>,
}

/// Everything on the page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Heading.
    pub title: String,
    /// Sentences under the heading.
    pub summary: Vec<String>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Plots behind that of the frames' times.
    pub plots: Vec<Plot>,
    /// Parts behind all of that.
    pub sections: Vec<Section>,
    /// Frames.
    pub frames: Vec<FramePoint>,
    /// The deadline of a frame.
    pub deadline_ms: f32,
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Frame times against the deadline, as SVG; `None` where there are too few frames for a plot.
fn frame_plot(frames: &[FramePoint], deadline_ms: f32) -> Option<String> {
    if frames.len() < 2 {
        return None;
    }
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (860, 260)).into_drawing_area();
        let top = frames.iter().map(|f| f.total_ms).fold(deadline_ms, f32::max) * 1.1;
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d(0..frames.len() - 1, 0f32..top)
            .ok()?;
        chart.configure_mesh().x_desc("frame").y_desc("ms").light_line_style(TRANSPARENT).draw().ok()?;
        let line = |f: fn(&FramePoint) -> f32, color: RGBColor| {
            LineSeries::new(frames.iter().enumerate().map(move |(i, p)| (i, f(p))), color.stroke_width(2))
        };
        chart.draw_series(line(|f| f.total_ms, RGBColor(31, 119, 180))).ok()?.label("shown after");
        chart.draw_series(line(|f| f.display_ms, RGBColor(255, 127, 14))).ok()?.label("drawing");
        chart
            .draw_series(std::iter::once(PathElement::new(
                vec![(0, deadline_ms), (frames.len() - 1, deadline_ms)],
                RGBColor(214, 39, 40),
            )))
            .ok()?;
        root.present().ok()?;
    }
    Some(svg)
}

/// Colours of lines.
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

/// Numbers at times.
#[derive(Clone, Debug)]
pub struct Curve {
    /// What they are of.
    pub name: String,
    /// Seconds and numbers; those that are none are left out.
    pub points: Vec<(f32, f32)>,
}

/// Curves over time, as SVG; `None` where there are too few numbers for a plot.
pub fn time_plot(title: &str, unit: &str, curves: &[Curve]) -> Option<String> {
    let all = || curves.iter().flat_map(|c| &c.points).filter(|p| p.1.is_finite());
    let end = all().map(|p| p.0).fold(0.0, f32::max);
    if all().count() < 2 || end <= 0.0 {
        return None;
    }
    let (low, high) = all().fold((0f32, 1e-3f32), |(low, high), p| (low.min(p.1), high.max(p.1)));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (860, 300)).into_drawing_area();
        root.fill(&WHITE).ok()?;
        let mut chart = ChartBuilder::on(&root)
            .caption(title, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(60)
            .build_cartesian_2d(0f32..end, 1.05 * low..1.05 * high)
            .ok()?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("s").y_desc(unit).light_line_style(TRANSPARENT).draw().ok()?;
        for (curve, color) in curves.iter().zip(COLORS.into_iter().cycle()) {
            let points = curve.points.iter().copied().filter(|p| p.1.is_finite());
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)))
                .ok()?
                .label(curve.name.as_str())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], color.stroke_width(2)));
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

/// Lines over frames, as SVG; `None` where there are too few frames for a plot.
fn line_plot(plot: &Plot) -> Option<String> {
    let frames = plot.lines.iter().map(|(_, values)| values.len()).max().filter(|n| *n > 1)?;
    let values = plot.lines.iter().flat_map(|(_, values)| values).chain(&plot.limit);
    let top = 1.1 * values.copied().filter(|v| v.is_finite()).fold(1e-3f32, f32::max);
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (860, 260)).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(60)
            .build_cartesian_2d(0..frames - 1, 0f32..top)
            .ok()?;
        let mut mesh = chart.configure_mesh();
        mesh.x_desc("frame").y_desc(plot.unit).light_line_style(TRANSPARENT).draw().ok()?;
        for ((name, values), color) in plot.lines.iter().zip(COLORS.into_iter().cycle()) {
            let points = values.iter().copied().enumerate();
            chart
                .draw_series(LineSeries::new(points, color.stroke_width(2)))
                .ok()?
                .label(name.as_str())
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], color.stroke_width(2)));
        }
        if let Some(limit) = plot.limit {
            let line = PathElement::new(vec![(0, limit), (frames - 1, limit)], RGBColor(214, 39, 40));
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

/// The page as HTML.
pub fn html(page: &Page) -> String {
    let mut out = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><style>\
         body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}\
         figure{display:inline-block;margin:.5rem 1rem 1rem 0;vertical-align:top;max-width:32rem}\
         img{max-width:100%;min-width:16rem;image-rendering:pixelated}figcaption{font-size:13px;color:#555}\
         table{border-collapse:collapse;margin:.5rem 0 1.5rem}td,th{padding:.15rem .8rem .15rem 0;text-align:right}\
         td:first-child,th:first-child{text-align:left}tr+tr{border-top:1px solid #ddd}\
         @media(prefers-color-scheme:dark){body{background:#161616;color:#ddd}figcaption{color:#aaa}}\
         </style>",
    );
    let _ = write!(out, "<title>{0}</title><h1>{0}</h1>", escape(&page.title));
    for sentence in &page.summary {
        let _ = write!(out, "<p>{}</p>", escape(sentence));
    }
    if let Some(svg) = frame_plot(&page.frames, page.deadline_ms) {
        let _ = write!(
            out,
            "<h2>Frames</h2><figure style=\"max-width:none\">{svg}<figcaption>Blue: from a frame's beginning until \
             it was shown. Orange: drawing of the base layer. Red: the deadline.</figcaption></figure>"
        );
    }
    for plot in &page.plots {
        if let Some(svg) = line_plot(plot) {
            let _ = write!(
                out,
                "<h2>{}</h2><figure style=\"max-width:none\">{svg}<figcaption>{}</figcaption></figure>",
                escape(&plot.title),
                escape(&plot.caption)
            );
        }
    }
    for table in &page.tables {
        let _ = write!(out, "<h2>{}</h2><table><tr>", escape(&table.title));
        for cell in &table.header {
            let _ = write!(out, "<th>{}</th>", escape(cell));
        }
        out.push_str("</tr>");
        for row in &table.rows {
            out.push_str("<tr>");
            for cell in row {
                let _ = write!(out, "<td>{}</td>", escape(cell));
            }
            out.push_str("</tr>");
        }
        out.push_str("</table>");
    }
    if !page.figures.is_empty() {
        out.push_str("<h2>Pictures</h2>");
    }
    write_figures(&mut out, &page.figures);
    for section in &page.sections {
        let svg = section.svg.as_deref().unwrap_or_default();
        let _ = write!(
            out,
            "<h2>{}</h2><figure style=\"max-width:none\">{svg}<figcaption>{}</figcaption></figure><br>",
            escape(&section.title),
            escape(&section.caption)
        );
        write_figures(&mut out, &section.figures);
    }
    out.push_str("</html>\n");
    out
}

fn write_figures(out: &mut String, figures: &[Figure]) {
    for figure in figures {
        let _ = write!(
            out,
            "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption><b>{0}</b> {2}</figcaption></figure>",
            escape(&figure.title).replace('"', "&quot;"),
            STANDARD.encode(&figure.png),
            escape(&figure.caption),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_stands_alone_and_escapes_names() {
        let page = Page {
            title: "a<b>".into(),
            frames: vec![FramePoint { total_ms: 10.0, display_ms: 4.0, samples: 3, quality: -0.1 }; 5],
            deadline_ms: 12.5,
            figures: vec![Figure { title: "x".into(), caption: "y".into(), png: vec![1, 2, 3] }],
            tables: vec![Table {
                title: "t".into(),
                header: vec!["h".into()],
                rows: vec![vec!["<script>".into()]],
            }],
            summary: vec!["s".into()],
            sections: vec![Section {
                title: "<i>".into(),
                svg: Some("<svg></svg>".into()),
                ..Section::default()
            }],
            plots: vec![Plot {
                title: "p".into(),
                caption: "c".into(),
                unit: "MiB",
                lines: vec![("<b>".into(), vec![1.0, 2.0, f32::NAN])],
                limit: Some(2.5),
            }],
        };
        let html = html(&page);
        assert!(html.contains("a&lt;b&gt;") && !html.contains("<script>") && !html.contains("<i>"));
        assert_eq!(html.matches("<svg").count(), 3);
        assert!(!html.contains("src=\"http") && !html.contains("href="), "nothing is fetched");
    }
}
