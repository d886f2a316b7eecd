//! The report of a walk: one HTML file that stands alone, pictures and plots inside it.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

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
    /// Column names.
    pub header: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
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
    /// Plots.
    pub plots: Vec<Plot>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Parts behind all of that.
    pub sections: Vec<Section>,
}

const STYLE: &str = "\
    body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#222}\
    figure{display:inline-block;margin:.5rem 1rem 1rem 0;vertical-align:top;max-width:32rem}\
    img{max-width:100%;min-width:16rem;image-rendering:pixelated}figcaption{font-size:13px;color:#555}\
    table{border-collapse:collapse;margin:.5rem 0 1.5rem}td,th{padding:.15rem .8rem .15rem 0;text-align:right}\
    td:first-child,th:first-child{text-align:left}tr+tr{border-top:1px solid #ddd}\
    @media(prefers-color-scheme:dark){body{background:#161616;color:#ddd}figcaption{color:#aaa}}";

/// The page as HTML.
pub fn html(page: &Page) -> String {
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                style { (PreEscaped(STYLE)) }
                title { (page.title) }
            }
            body {
                h1 { (page.title) }
                @for sentence in &page.summary { p { (sentence) } }
                @for plot in &page.plots {
                    @if let Some(svg) = line_plot(plot) { (plotted(&plot.title, &svg, &plot.caption)) }
                }
                @for Table { title, header, rows } in &page.tables {
                    h2 { (title) }
                    table {
                        tr { @for cell in header { th { (cell) } } }
                        @for row in rows { tr { @for cell in row { td { (cell) } } } }
                    }
                }
                @if !page.figures.is_empty() { h2 { "Pictures" } }
                (pictures(&page.figures))
                @for Section { title, svg, caption, figures } in &page.sections {
                    (plotted(title, svg.as_deref().unwrap_or_default(), caption))
                    br;
                    (pictures(figures))
                }
            }
        }
    };
    markup.into_string()
}

fn plotted(title: &str, svg: &str, caption: &str) -> Markup {
    html! {
        h2 { (title) }
        figure style="max-width:none" { (PreEscaped(svg)) figcaption { (caption) } }
    }
}

fn pictures(figures: &[Figure]) -> Markup {
    html! {
        @for Figure { title, caption, png } in figures {
            figure {
                img alt=(title) src={ "data:image/png;base64," (STANDARD.encode(png)) };
                figcaption { b { (title) } " " (caption) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_stands_alone_and_escapes_names() {
        let page = Page {
            title: "a<b>".into(),
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
        let html = super::html(&page);
        assert!(html.contains("a&lt;b&gt;") && !html.contains("<script>") && !html.contains("<i>"));
        assert_eq!(html.matches("<svg").count(), 2);
        assert!(!html.contains("src=\"http") && !html.contains("href="), "nothing is fetched");
    }
}
