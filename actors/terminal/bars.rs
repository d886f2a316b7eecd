//! Numbers with their spreads, a line each on one scale: a part of a page, or a picture that stands alone as SVG.

use foveal::math::ln;
use maud::{Markup, PreEscaped, html};

/// Numbers of one unit with their spreads, a line each.
#[derive(Clone, Debug, Default)]
pub struct Bars {
    /// Title.
    pub title: String,
    /// What to see in it.
    pub caption: String,
    /// Unit of all.
    pub unit: String,
    /// Whether the scale is logarithmic; from 0 where it is not.
    pub is_log: bool,
    /// A line for each.
    pub bars: Vec<Bar>,
}

/// A number with its spread.
#[derive(Clone, Debug)]
pub struct Bar {
    /// What it is of.
    pub name: String,
    /// The number and its spread in words.
    pub text: String,
    /// The number itself.
    pub median: f64,
    /// Between which bounds it lies.
    pub bounds: [f64; 2],
    /// Between which bounds most of the values lie that it is the median of.
    pub reach: [f64; 2],
    /// What it should be.
    pub target: Option<f64>,
    /// What it is compared with.
    pub peer: Option<f64>,
    /// Whether it is not what it should be.
    pub is_missed: bool,
}

impl Bar {
    fn points(&self) -> impl Iterator<Item = f64> {
        [Some(self.median), self.target, self.peer].into_iter().flatten().filter(|v| v.is_finite())
    }
}

/// Numbers further apart than this many times cannot be told from each other on a scale that begins at 0.
const FAR_APART: f64 = 50.0;

impl Bars {
    /// On a logarithmic scale, where the least number could not be told from 0 on another.
    pub fn on_a_scale_that_shows_all(self) -> Self {
        let all = self.bars.iter().flat_map(Bar::points).filter(|v| *v > 0.0);
        let (low, high) = all.fold((f64::INFINITY, 0.0), |(low, high), v| (v.min(low), v.max(high)));
        Self { is_log: high > FAR_APART * low, ..self }
    }

    fn scale(&self) -> Option<Scale> {
        let reaches = self.bars.iter().flat_map(|b| b.points().chain(b.reach));
        let reaches = reaches.filter(|v| v.is_finite() && *v > 0.0);
        let (low, high) = reaches.fold((f64::INFINITY, 0.0), |(low, high), v| (v.min(low), v.max(high)));
        let ends = match self.is_log {
            true => [power_of_ten(low), 10.0 * power_of_ten(0.999 * high)],
            false => [0.0, high],
        };
        (high > 0.0).then_some(Scale { ends, is_log: self.is_log })
    }
}

/// The power of ten that is not above a number: of its text, so that it is the same on all machines.
fn power_of_ten(v: f64) -> f64 {
    let text = format!("{v:e}");
    let exponent = text.split('e').nth(1).and_then(|e| e.parse().ok()).unwrap_or(0);
    10f64.powi(exponent)
}

/// Where numbers stand.
struct Scale {
    ends: [f64; 2],
    is_log: bool,
}

impl Scale {
    /// The place of a number as a share of the width.
    fn at(&self, v: f64) -> f64 {
        let [from, to] = self.ends;
        let share = match self.is_log {
            true => ln(v.max(from) / from) / ln(to / from),
            false => v / to,
        };
        share.clamp(0.0, 1.0)
    }

    /// Numbers that are written beside the scale.
    fn ticks(&self) -> Vec<f64> {
        /// Most steps between ticks.
        const STEPS: f64 = 5.0;
        let [from, to] = self.ends;
        if self.is_log {
            return std::iter::successors(Some(from), |v| Some(10.0 * v))
                .take_while(|v| *v < 1.01 * to)
                .collect();
        }
        let power = power_of_ten(to / STEPS);
        let step =
            power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|m| m * power >= to / STEPS).unwrap_or(10.0);
        (0..).map(|i| f64::from(i) * step).take_while(|v| *v <= to).collect()
    }
}

/// The lines of a page: name and number in words, and between them where they stand.
pub(crate) fn lines(bars: &Bars) -> Markup {
    let Some(scale) = bars.scale() else { return html! {} };
    let at = |v: f64| format!("{:.2}%", 100.0 * scale.at(v));
    let line = |class: &str, [from, to]: [f64; 2]| {
        html! { line class=(class) x1=(at(from)) x2=(at(to)) y1="50%" y2="50%" {} }
    };
    html! {
        h2 { (bars.title) }
        div.bars {
            @for Bar { name, text, median, bounds, reach, target, peer, is_missed } in &bars.bars {
                span.name { (name) }
                span.value.missed[*is_missed] { (text) }
                svg aria-hidden="true" {
                    (line("reach", *reach))
                    (line("sure", *bounds))
                    @if let Some(target) = target { line.aim x1=(at(*target)) x2=(at(*target)) y1="10%" y2="90%" {} }
                    @if let Some(peer) = peer { circle.peer cx=(at(*peer)) cy="50%" r="4" {} }
                    circle.middle cx=(at(*median)) cy="50%" r="4" {}
                }
            }
        }
        p.caption { (bars.caption) @if bars.is_log { " The scale is logarithmic." } }
    }
}

/// Width of a picture, of the margin around it, and where the scale ends and numbers in words begin.
const WIDTH: f64 = 760.0;
const MARGIN: f64 = 16.0;
const SCALE_END: f64 = 460.0;
/// Heights of what stands above the lines of a unit, of a line, and of what lies between units.
const HEAD: f64 = 44.0;
const LINE: f64 = 38.0;
const GAP: f64 = 20.0;

/// Light and dark as the page around it, on paper of its own where that page does not follow.
const STYLE: &str = "text{font:12px system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;fill:#1c1d1f}\
.paper{fill:#fff}.unit{font-weight:600}.tick{font-size:11px;fill:#5c6066}.grid{stroke:#d9dbde}\
.reach{stroke:#1766b5;stroke-width:6;opacity:.35}.sure{stroke:#1766b5;stroke-width:2}.middle{fill:#1766b5}\
.aim{stroke:#b3261e;stroke-width:2}.missed,.red{fill:#b3261e}.peer{fill:none;stroke:#5c6066;stroke-width:2}.blue{fill:#1766b5}\
@media(prefers-color-scheme:dark){text{fill:#e6e6e3}.paper{fill:#16181b}.tick{fill:#a2a5aa}.grid{stroke:#3a3d42}\
.reach,.sure{stroke:#7ab8f5}.middle,.blue{fill:#7ab8f5}.aim{stroke:#ff8a80}.missed,.red{fill:#ff8a80}.peer{stroke:#a2a5aa}}";

/// A picture that stands alone, a scale for each unit; `None` where there is nothing to draw.
pub fn svg(title: &str, all: &[Bars]) -> Option<String> {
    let mut height = MARGIN;
    let mut parts = Vec::new();
    for bars in all {
        let Some(scale) = bars.scale() else { continue };
        parts.push(part(bars, &scale, height));
        height += HEAD + LINE * bars.bars.len() as f64 + GAP;
    }
    if parts.is_empty() {
        return None;
    }
    height += MARGIN;
    let markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {WIDTH} {height}")) width=(WIDTH) height=(height) role="img" aria-label=(title) {
            title { (title) }
            style { (PreEscaped(STYLE)) }
            rect.paper width="100%" height="100%" {}
            @for part in &parts { (part) }
            text x=(MARGIN) y=(height - MARGIN) {
                tspan.blue { "●" } " median of the runs · " tspan.blue { "━" } " their 10th to 90th percentile · "
                tspan.red { "┃" } " target · ○ what it is compared with"
            }
        }
    };
    Some(markup.into_string())
}

/// The numbers of one unit, from `top` downwards.
fn part(bars: &Bars, scale: &Scale, top: f64) -> Markup {
    let at = |v: f64| format!("{:.1}", MARGIN + (SCALE_END - MARGIN) * scale.at(v));
    let (first, last) = (top + HEAD, top + HEAD + LINE * bars.bars.len() as f64);
    // Of a number that was added up, no more than was meant.
    let tick = |v: f64| ((1e9 * v).round() / 1e9).to_string();
    html! {
        text.unit x=(MARGIN) y=(top + 12.0) {
            @if bars.unit.is_empty() { "ratios" } @else { (bars.unit) }
            @if bars.is_log { ", logarithmic scale" }
        }
        @for v in scale.ticks() {
            line.grid x1=(at(v)) x2=(at(v)) y1=(first - 8.0) y2=(last) {}
            text.tick x=(at(v)) y=(first - 13.0) text-anchor="middle" { (tick(v)) }
        }
        @for (bar, y) in bars.bars.iter().zip((0..).map(|i| first + LINE * f64::from(i))) {
            @let middle = y + 26.0;
            text x=(MARGIN) y=(y + 12.0) { (bar.name) }
            @for (class, [from, to]) in [("reach", bar.reach), ("sure", bar.bounds)] {
                line class=(class) x1=(at(from)) x2=(at(to)) y1=(middle) y2=(middle) {}
            }
            @if let Some(target) = bar.target {
                line.aim x1=(at(target)) x2=(at(target)) y1=(middle - 8.0) y2=(middle + 8.0) {}
            }
            @if let Some(peer) = bar.peer { circle.peer cx=(at(peer)) cy=(middle) r="4" {} }
            circle.middle cx=(at(bar.median)) cy=(middle) r="4" {}
            text.missed[bar.is_missed] x=(SCALE_END + MARGIN) y=(middle + 4.0) {
                (bar.text) @if bar.is_missed { " – target missed" }
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn bar(name: &str, median: f64) -> Bar {
        Bar {
            name: name.into(),
            text: median.to_string(),
            median,
            bounds: [0.9 * median, 1.1 * median],
            reach: [0.5 * median, 2.0 * median],
            target: None,
            peer: None,
            is_missed: false,
        }
    }

    fn of(medians: &[f64]) -> Bars {
        Bars { bars: medians.iter().map(|m| bar("a", *m)).collect(), ..Bars::default() }
    }

    #[test]
    fn scales_show_all_numbers() {
        let near = of(&[2.0, 10.0]).on_a_scale_that_shows_all();
        let scale = near.scale().expect("a scale");
        assert_eq!(
            (near.is_log, scale.ends, scale.ticks()),
            (false, [0.0, 20.0], vec![0.0, 5.0, 10.0, 15.0, 20.0])
        );
        assert_eq!((scale.at(5.0), scale.at(-1.0), scale.at(99.0)), (0.25, 0.0, 1.0));
        let far = of(&[0.03, 0.0, 40.0]).on_a_scale_that_shows_all();
        let scale = far.scale().expect("a scale");
        assert!(far.is_log && scale.ends == [0.01, 100.0], "{:?}", scale.ends);
        assert_eq!(scale.ticks().len(), 5);
        assert!((scale.at(1.0) - 0.5).abs() < 1e-9 && scale.at(0.0) == 0.0);
        assert!(of(&[0.0]).scale().is_none() && of(&[]).on_a_scale_that_shows_all().scale().is_none());
    }

    /// What is opened is closed in its order, and nothing else looks like markup.
    pub(crate) fn is_well_formed(svg: &str) -> bool {
        let mut open = Vec::new();
        for tag in svg.split('<').skip(1) {
            let Some((tag, text)) = tag.split_once('>') else { return false };
            if text.contains('>') || tag.matches('"').count() % 2 != 0 {
                return false;
            }
            let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap_or_default();
            match (tag.starts_with('/'), tag.ends_with('/')) {
                (true, _) if open.pop() != Some(name) => return false,
                (false, false) => open.push(name),
                _ => {}
            }
        }
        open.is_empty()
    }

    #[test]
    fn a_picture_stands_alone() {
        let missed = Bar { target: Some(1.0), peer: Some(3.0), is_missed: true, ..bar("<a> & \"b\"", 2.0) };
        let all = [
            Bars { unit: "ms".into(), bars: vec![missed, bar("c", 4.0)], ..Bars::default() },
            Bars { bars: vec![bar("d", 0.0)], ..Bars::default() },
            of(&[0.01, 10.0]).on_a_scale_that_shows_all(),
        ];
        let svg = svg("a < b", &all).expect("a picture");
        assert!(is_well_formed(&svg), "{svg}");
        assert!(
            svg.starts_with("<svg xmlns=")
                && svg.contains("prefers-color-scheme:dark")
                && svg.contains("paper")
        );
        assert!(svg.contains("&lt;a&gt;") && svg.contains("target missed") && svg.contains("logarithmic"));
        assert_eq!(svg.matches("class=\"middle\"").count(), 4, "what has no scale is not drawn");
        assert_eq!((svg.matches("class=\"peer\"").count(), svg.matches("class=\"aim\"").count()), (1, 1));
        assert!(!svg.contains("NaN") && super::svg("", &all[1..2]).is_none());
        assert!(!is_well_formed("<svg><a></svg></a>") && !is_well_formed("<svg>"));
    }
}
