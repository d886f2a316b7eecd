//! Reports: HTML files that stand alone, with pictures and plots inside. One look for all of them, light and dark, on a
//! desk and on a phone (`report.css`); pictures beside their references, under a line that can be drawn aside
//! (`report.js`).

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::json;

use crate::bars::{Bars, lines};
use crate::machine::{machine, made_on, today};
use crate::plots::{Plot, line_plot};

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
    /// What to see in it.
    pub caption: String,
    /// Column names.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// Pictures of one view beside what they should look like, under a line that can be drawn aside.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Title.
    pub title: String,
    /// What to look for.
    pub caption: String,
    /// Columns and rows.
    pub size: [u32; 2],
    /// What they should look like.
    pub reference: Figure,
    /// What was shown, and where that differs.
    pub shown: Vec<Compared>,
}

/// A picture beside its reference.
#[derive(Clone, Debug)]
pub struct Compared {
    /// The picture.
    pub figure: Figure,
    /// FLIP, pixel by pixel, as PNG.
    pub flip: Vec<u8>,
}

/// A part of a page: a plot and pictures that belong together.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// Title.
    pub title: String,
    /// A plot.
    pub svg: Option<String>,
    /// The same for a phone.
    pub narrow: Option<String>,
    /// What it shows.
    pub caption: String,
    /// Pictures.
    pub figures: Vec<Figure>,
    /// Pictures beside what they should look like.
    pub comparison: Option<Comparison>,
}

/// Everything on the page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Heading.
    pub title: String,
    /// By which version, where and when its numbers were measured, if not by this one, here and today.
    pub made: Option<String>,
    /// Sentences under the heading.
    pub summary: Vec<String>,
    /// What went wrong.
    pub warnings: Vec<String>,
    /// Pictures beside what they should look like.
    pub comparison: Option<Comparison>,
    /// Plots.
    pub plots: Vec<Plot>,
    /// Spreads.
    pub bars: Vec<Bars>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Parts behind all of that.
    pub sections: Vec<Section>,
}

const STYLE: &str = include_str!("report.css");
const SCRIPT: &str = include_str!("report.js");

/// The page as HTML.
pub fn html(page: &Page) -> String {
    let made = page.made.clone();
    let made = made.unwrap_or_else(|| made_on(&json!({"machine": machine(), "date": today()})));
    let compares = page.comparison.is_some() || page.sections.iter().any(|s| s.comparison.is_some());
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                style { (PreEscaped(STYLE)) }
                title { (page.title) }
            }
            body {
                main {
                    h1 { (page.title) }
                    p.caption { (made) "." }
                    @for sentence in &page.summary { p { (sentence) } }
                    @for warning in &page.warnings { p.warning { "Warning: " (warning) } }
                    @if let Some(comparison) = &page.comparison { (compared(comparison)) }
                    @for plot in &page.plots {
                        @if let Some([wide, narrow]) = line_plot(plot) {
                            (plotted(&plot.title, &wide, Some(&narrow), &plot.caption))
                        }
                    }
                    @for bars in &page.bars { (lines(bars)) }
                    @if !page.figures.is_empty() { h2 { "Pictures" } }
                    (pictures(&page.figures))
                    @for table in &page.tables { (tabled(table)) }
                    @for Section { title, svg, narrow, caption, figures, comparison } in &page.sections {
                        @match svg {
                            Some(svg) => (plotted(title, svg, narrow.as_deref(), caption)),
                            None => { h2 { (title) } p.caption { (caption) } }
                        }
                        @if let Some(comparison) = comparison { (compared(comparison)) }
                        (pictures(figures))
                    }
                }
                @if compares { script { (PreEscaped(SCRIPT)) } }
            }
        }
    };
    markup.into_string()
}

fn plotted(title: &str, wide: &str, narrow: Option<&str>, caption: &str) -> Markup {
    html! {
        h2 { (title) }
        figure.plot role="group" aria-label=(title) {
            @match narrow {
                Some(narrow) => { div.wide { (PreEscaped(wide)) } div.narrow { (PreEscaped(narrow)) } }
                None => div.scroll { (PreEscaped(wide)) },
            }
            figcaption { (caption) }
        }
    }
}

fn data(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

fn pictures(figures: &[Figure]) -> Markup {
    html! {
        @if !figures.is_empty() {
            div.pictures {
                @for Figure { title, caption, png } in figures {
                    figure {
                        img alt=(title) src=(data(png));
                        figcaption { b { (title) ". " } (caption) }
                    }
                }
            }
        }
    }
}

fn tabled(table: &Table) -> Markup {
    // Columns of words stand to the left: of cells that hold no digit at their start.
    let is_words = |c: usize| {
        let starts = |row: &Vec<String>| row.get(c).and_then(|cell| cell.chars().next());
        table.rows.iter().filter_map(starts).any(|c| c.is_alphabetic())
    };
    let class = |c: usize, cell: &str| match (cell, is_words(c)) {
        ("MISSED", _) => "words missed",
        (_, true) => "words",
        (_, false) => "",
    };
    html! {
        h2 { (table.title) }
        @if !table.caption.is_empty() { p.caption { (table.caption) } }
        div.scroll {
            table {
                thead { tr { @for (c, cell) in table.header.iter().enumerate() { th scope="col" class=(class(c, "")) { (cell) } } } }
                tbody {
                    @for row in &table.rows {
                        tr { @for (c, cell) in row.iter().enumerate() { td class=(class(c, cell)) { (cell) } } }
                    }
                }
            }
        }
    }
}

fn compared(comparison: &Comparison) -> Markup {
    let Comparison { title, caption, size: [width, height], reference, shown } = comparison;
    let Some(first) = shown.first() else { return html! {} };
    let each = |c: &Compared| {
        json!({
            "title": c.figure.title,
            "caption": c.figure.caption,
            "shown": data(&c.figure.png),
            "flip": data(&c.flip),
        })
    };
    // Within a script, `</` would end it.
    let all = serde_json::Value::from_iter(shown.iter().map(each)).to_string().replace('<', "\\u003c");
    let modes =
        [("split", "slider"), ("shown", "shown"), ("reference", "reference"), ("flip", "difference (FLIP)")];
    let name = format!("mode of {title}");
    html! {
        h2 { (title) }
        p.caption { (caption) }
        div.ab data-reference=(data(&reference.png)) style=(format!("--full:{width}px")) {
            div.row role="group" aria-label="What is shown" {
                label hidden[shown.len() < 2] {
                    "picture "
                    select.which { @for (i, c) in shown.iter().enumerate() { option value=(i) { (c.figure.title) } } }
                }
                @for (value, text) in modes {
                    label { input type="radio" name=(name) value=(value) checked[value == "split"]; (text) }
                }
                label {
                    "zoom "
                    select.zoom { @for zoom in [1, 2, 4, 8] { option value=(zoom) { (zoom) " ×" } } }
                }
            }
            div.stage tabindex="0" role="group" aria-label=(title) {
                div.layers {
                    img alt="reference" width=(width) height=(height) src=(data(&reference.png));
                    img.over alt=(first.figure.title) width=(width) height=(height) src=(data(&first.figure.png));
                    div.line {}
                }
            }
            input.cut type="range" min="0" max="1000" value="500" aria-label="How much of what was shown is seen, on the left";
            p.caption.said { (first.figure.caption) }
            script type="application/json" { (PreEscaped(all)) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bars::{Bar, tests::bar};

    #[test]
    fn the_page_stands_alone_and_escapes_names() {
        let figure = |title: &str| Figure { title: title.into(), caption: "y".into(), png: vec![1, 2, 3] };
        let comparison = Comparison {
            title: "c".into(),
            caption: "d".into(),
            size: [4, 3],
            reference: figure("r"),
            shown: vec![Compared { figure: figure("</script><b>"), flip: vec![4] }],
        };
        let page = Page {
            title: "a<b>".into(),
            warnings: vec!["w".into()],
            comparison: Some(comparison.clone()),
            figures: vec![figure("x")],
            tables: vec![Table {
                title: "t".into(),
                caption: "to see".into(),
                header: vec!["h".into()],
                rows: vec![vec!["<script>".into()]],
            }],
            summary: vec!["s".into()],
            sections: vec![Section {
                title: "<i>".into(),
                svg: Some("<svg></svg>".into()),
                comparison: Some(comparison),
                ..Section::default()
            }],
            plots: vec![Plot {
                title: "p".into(),
                caption: "c".into(),
                unit: "MiB",
                lines: vec![("<b>".into(), vec![1.0, 2.0, f32::NAN])],
                limit: Some(2.5),
            }],
            bars: vec![Bars {
                title: "b".into(),
                bars: vec![Bar { target: Some(5.0), is_missed: true, ..bar("<u>", 2.0) }],
                ..Bars::default()
            }],
            made: None,
        };
        let html = super::html(&page);
        assert!(html.contains("a&lt;b&gt;") && !html.contains("<i>") && !html.contains("<u>"));
        assert_eq!(html.matches("<script").count(), 3, "two with pictures, one with what moves them");
        assert_eq!(html.matches("</script").count(), 3);
        // The plot twice, the section's, the bar.
        assert_eq!(html.matches("<svg").count(), 4);
        assert!(html.contains("40.00%") && html.contains("100.00%"), "the scale ends with the aim");
        assert!(
            !html.contains("src=\"http") && !html.contains("href=") && !html.contains("url("),
            "nothing is fetched"
        );
        assert!(html.contains("value missed") && html.contains("to see"));
        let here = made_on(&json!({"machine": machine(), "date": today()}));
        assert!(html.contains(&html! { (here) }.into_string()), "{here}");
        let elsewhere = super::html(&Page { made: Some("elsewhere".into()), ..page });
        assert!(elsewhere.contains("elsewhere.") && !elsewhere.contains(&today()));
    }

    #[test]
    fn a_page_that_compares_nothing_has_no_script() {
        assert!(!super::html(&Page { title: "t".into(), ..Page::default() }).contains("<script"));
    }
}
