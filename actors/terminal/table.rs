//! A benchmark's result: rows of medians, each with its spread, its target and, where there is one, a peer of the same run.

use std::path::{Path, PathBuf};

use clap::Args;
use foveal::metrics::quantile;
use serde::Serialize;
use serde_json::{Value, json};

use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};

use crate::bars::{Bar, Bars};
use crate::machine::{machine, made_on, today};
use crate::print::{print_json, print_line};
use crate::report::{Page, Table, html};

/// Arguments that all benchmarks share.
#[derive(Args, Clone, Debug)]
pub struct CommonArguments {
    /// Runs per measurement; the median is reported
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Folder for CSV tables and plots
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

/// What a value should be. Missed aims are printed, never hidden, and fail nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Aim {
    /// The value is at most this.
    AtMost(f64),
    /// The value is at least this.
    AtLeast(f64),
    /// value / peer is at most this.
    RatioAtMost(f64),
    /// value / peer is at least this.
    RatioAtLeast(f64),
}

/// One measured figure.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// What was measured.
    pub what: String,
    /// Median over the runs; `None` where it could not be measured.
    pub value: Option<f64>,
    /// Unit of value and peer.
    pub unit: &'static str,
    /// Number of runs behind the median.
    pub runs: u32,
    /// What it is compared with.
    pub peer: Option<String>,
    /// The peer's median.
    pub peer_value: Option<f64>,
    /// What it should be.
    pub aim: Option<Aim>,
    /// 10 and 90 % of the values that the median is of, where there are at least three.
    pub band: Option<[f64; 2]>,
    /// Of an error: what pictures are held against.
    pub reference: Option<String>,
}

/// Values that a spread is told of.
const BAND: usize = 3;

impl Row {
    /// The median of `values`, and their spread where there are a few.
    pub fn new(what: impl Into<String>, unit: &'static str, values: &[f64]) -> Self {
        let is_spread = values.iter().filter(|v| v.is_finite()).count() >= BAND;
        Self {
            what: what.into(),
            value: median(values),
            unit,
            runs: values.len() as u32,
            band: is_spread.then(|| [0.1, 0.9].map(|share| quantile(values.iter().copied(), share))),
            ..Self::default()
        }
    }

    /// With a peer's median.
    pub fn against(mut self, peer: impl Into<String>, value: Option<f64>) -> Self {
        self.peer = Some(peer.into());
        self.peer_value = value;
        self
    }

    /// With an aim.
    pub fn aim(mut self, aim: Aim) -> Self {
        self.aim = Some(aim);
        self
    }

    /// An error's reference.
    pub fn held_against(mut self, reference: impl ToString) -> Self {
        self.reference = Some(reference.to_string());
        self
    }

    /// value / peer.
    pub fn ratio(&self) -> Option<f64> {
        let ratio = self.value? / self.peer_value?;
        ratio.is_finite().then_some(ratio)
    }

    /// Whether the aim is met; `None` without an aim or a value to hold against it.
    pub fn met(&self) -> Option<bool> {
        Some(match self.aim? {
            Aim::AtMost(a) => self.value? <= a,
            Aim::AtLeast(a) => self.value? >= a,
            Aim::RatioAtMost(a) => self.ratio()? <= a,
            Aim::RatioAtLeast(a) => self.ratio()? >= a,
        })
    }

    fn aim_text(&self) -> Option<String> {
        Some(match self.aim? {
            Aim::AtMost(a) => format!("≤ {} {}", figure(a), self.unit),
            Aim::AtLeast(a) => format!("≥ {} {}", figure(a), self.unit),
            Aim::RatioAtMost(a) => format!("≤ {} × peer", figure(a)),
            Aim::RatioAtLeast(a) => format!("≥ {} × peer", figure(a)),
        })
    }

    fn json(&self) -> Value {
        json!({
            "what": self.what,
            "value": self.value,
            "unit": self.unit,
            "runs": self.runs,
            "band": self.band,
            "peer": self.peer,
            "peer_value": self.peer_value,
            "ratio": self.ratio(),
            "aim": self.aim_text(),
            "met": self.met(),
            "reference": self.reference,
        })
    }

    fn columns(&self) -> impl Serialize {
        let Self { what, value, unit, runs, peer, peer_value, reference, .. } = self;
        let [low, high] = self.band.map_or([None; 2], |band| band.map(Some));
        let (ratio, aim, met) = (self.ratio(), self.aim_text(), self.met());
        (what, value, unit, runs, peer, peer_value, ratio, aim, met, low, high, reference)
    }
}

/// Columns of a table.
pub const HEAD: [&str; 6] = ["what", "value", "compared with", "ratio", "target", ""];

/// What stands in these columns for a row of a document.
pub fn cells(row: &Value) -> [String; 6] {
    let text = |key: &str| row[key].as_str().unwrap_or_default().to_owned();
    let beside = match (row["peer"].as_str(), row["peer_value"].as_f64()) {
        (Some(peer), Some(value)) => format!("{} ({peer})", with_unit(value, row)),
        (peer, _) => peer.unwrap_or_default().to_owned(),
    };
    let met = match row["met"].as_bool() {
        None => "",
        Some(true) => "met",
        Some(false) => "MISSED",
    };
    let ratio = row["ratio"].as_f64().map(figure).unwrap_or_default();
    [text("what"), value_of(row), beside, ratio, text("aim"), met.into()]
}

fn with_unit(value: f64, row: &Value) -> String {
    format!("{} {}", figure(value), row["unit"].as_str().unwrap_or_default()).trim_end().to_owned()
}

fn band_of(row: &Value) -> Option<[f64; 2]> {
    let [low, high] = [0, 1].map(|i| row["band"][i].as_f64());
    Some([low?, high?])
}

/// A row's value with its unit and spread.
pub fn value_of(row: &Value) -> String {
    let Some(value) = row["value"].as_f64() else { return "–".into() };
    match band_of(row) {
        Some([low, high]) => format!("{} ({} – {})", with_unit(value, row), figure(low), figure(high)),
        None => with_unit(value, row),
    }
}

/// The rows of a document, each with what it is of: what stands indented below another is part of that.
pub fn named_rows(document: &Value) -> Vec<(String, &Value)> {
    let mut whole = "";
    let rows = document["rows"].as_array().into_iter().flatten();
    let named = rows.map(|row| {
        let what = row["what"].as_str().unwrap_or_default();
        match what.strip_prefix("  ") {
            Some(part) => (format!("{whole}: {}", part.trim_start()), row),
            None => {
                whole = what;
                (what.to_owned(), row)
            }
        }
    });
    named.collect()
}

/// Median of the finite values; `None` of none.
pub fn median(values: &[f64]) -> Option<f64> {
    Some(quantile(values.iter().copied(), 0.5)).filter(|v| v.is_finite())
}

/// Three significant digits.
pub fn figure(v: f64) -> String {
    if v.is_infinite() {
        return "∞".into();
    }
    let digits = match v.abs() {
        a if a >= 99.95 || a == 0.0 => 0,
        a if a >= 9.995 => 1,
        a if a >= 0.9995 => 2,
        a if a >= 0.0995 => 3,
        a if a >= 0.00995 => 4,
        _ => return format!("{v:.2e}"),
    };
    format!("{v:.digits$}")
}

/// Prints the rows as the arguments ask for, and leaves NAME.csv, NAME.json and NAME.html in the folder.
pub fn finish(name: &str, rows: &[Row], notes: &[String], a: &CommonArguments) -> Result<(), Failure> {
    let document = json!({
        "schema": format!("foveal.bench.{name}/1"),
        "machine": machine(),
        "date": today(),
        "rows": rows.iter().map(Row::json).collect::<Vec<_>>(),
        "notes": notes,
    });
    if let Some(out) = &a.out {
        make_folder(out)?;
        let columns = "what,value,unit,runs,peer,peer_value,ratio,aim,met,low,high,reference";
        write_csv(&out.join(format!("{name}.csv")), columns, rows.iter().map(Row::columns))?;
        write_atomic(&out.join(format!("{name}.json")), format!("{document:#}\n").as_bytes())?;
        write_atomic(&out.join(format!("{name}.html")), html(&page_of(name, &document)).as_bytes())?;
    }
    if a.json {
        print_json(&document);
        return Ok(());
    }
    let rows = document["rows"].as_array().into_iter().flatten().map(cells);
    let lines: Vec<[String; 6]> = std::iter::once(HEAD.map(String::from)).chain(rows).collect();
    let widths: [usize; 6] =
        std::array::from_fn(|c| lines.iter().map(|l| l[c].chars().count()).max().unwrap_or(0));
    for line in &lines {
        let cells: Vec<String> =
            line.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        print_line(cells.join("  ").trim_end());
    }
    print_line(&made_on(&document));
    for note in notes {
        print_line(note);
    }
    Ok(())
}

/// How spreads and targets are told in a table.
pub const HOW_TO_READ: &str = "Each value is the median of its runs; in brackets are their 10th and 90th percentiles, where there \
    were at least three runs, interpolated between neighbouring ones. Ratios are those of the value to what it is compared with.";

/// The rows as a report shows them.
pub fn table_of(title: &str, rows: &[Row]) -> Table {
    table(title, HOW_TO_READ, &json!({"rows": rows.iter().map(Row::json).collect::<Vec<_>>()}))
}

/// The rows of a document that [`finish`] left, as a report shows them.
pub fn table(title: &str, caption: &str, document: &Value) -> Table {
    let rows = document["rows"].as_array().into_iter().flatten();
    Table {
        title: title.to_owned(),
        caption: caption.to_owned(),
        header: HEAD.map(String::from).to_vec(),
        rows: rows.map(|row| indented(cells(row)).to_vec()).collect(),
    }
}

/// Cells whose first keeps its distance from the left where space is folded.
pub fn indented([what, rest @ ..]: [String; 6]) -> [String; 6] {
    let what = match what.strip_prefix("  ") {
        Some(part) => format!("\u{2003}{}", part.trim_start()),
        None => what,
    };
    let [value, beside, ratio, target, met] = rest;
    [what, value, beside, ratio, target, met]
}

/// Where a row's target stands among its values, if there is one: `≤ 10 ms`, or `≤ 1.20 × peer`.
fn target_of(row: &Value) -> Option<f64> {
    let aim = row["aim"].as_str()?;
    let number: f64 = aim.split_whitespace().nth(1)?.parse().ok()?;
    match aim.ends_with("× peer") {
        true => Some(number * row["peer_value"].as_f64()?),
        false => Some(number),
    }
}

/// The rows of a document that have a spread, a target or a peer, by unit.
pub fn bars_of(document: &Value) -> Vec<Bars> {
    let mut all: Vec<Bars> = Vec::new();
    for (name, row) in named_rows(document) {
        let Some(median) = row["value"].as_f64().filter(|v| *v >= 0.0) else { continue };
        let (band, target, peer) = (band_of(row), target_of(row), row["peer_value"].as_f64());
        if band.is_none() && target.is_none() && peer.is_none() {
            continue;
        }
        let name = match (row["peer"].as_str(), peer) {
            (Some(with), Some(_)) => format!("{name}  ○ {with}"),
            _ => name,
        };
        let unit = row["unit"].as_str().unwrap_or_default();
        let bounds = band.unwrap_or([median; 2]);
        let is_missed = row["met"] == false;
        let bar = Bar { name, text: value_of(row), median, bounds, reach: bounds, target, peer, is_missed };
        match all.iter_mut().find(|bars| bars.unit == unit) {
            // Beside what it was not compared with, a number says nothing new.
            Some(of_unit) if of_unit.bars.iter().any(|b| b.name == bar.name) => {}
            Some(of_unit) => of_unit.bars.push(bar),
            None => all.push(Bars {
                title: if unit.is_empty() { "Ratios".into() } else { format!("In {unit}") },
                caption: "Dot: the median of the runs. Line: their 10th to 90th percentile, where there were at least \
                          three. Red: the target. Ring: what the number is compared with."
                    .into(),
                unit: unit.to_owned(),
                bars: vec![bar],
                ..Bars::default()
            }),
        }
    }
    all.into_iter().map(Bars::on_a_scale_that_shows_all).collect()
}

/// A document as a page: what has a spread, a target or a peer, by unit, and the table.
fn page_of(name: &str, document: &Value) -> Page {
    let met = |is_met: bool| {
        let rows = document["rows"].as_array().into_iter().flatten();
        rows.filter(|row| row["met"] == is_met).count()
    };
    let targets = match (met(true), met(false)) {
        (0, 0) => None,
        (1, 0) => Some("The target is met.".to_owned()),
        (all, 0) => Some(format!("All {all} targets are met.")),
        (met, missed) => Some(format!("{missed} of {} targets missed.", met + missed)),
    };
    let notes = document["notes"].as_array().into_iter().flatten().filter_map(Value::as_str);
    Page {
        title: format!("foveal bench {name}"),
        made: Some(made_on(document)),
        summary: targets.into_iter().chain(notes.map(str::to_owned)).collect(),
        bars: bars_of(document),
        tables: vec![table("All rows", HOW_TO_READ, document)],
        ..Page::default()
    }
}

/// Rows as CSV, without a head: tuples of what is in their columns.
pub fn csv_lines<R: Serialize>(rows: impl IntoIterator<Item = R>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).expect("rows are tuples of one length");
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

/// Writes a table as CSV.
///
/// # Errors
/// If the file cannot be written.
pub fn write_csv<R: Serialize>(
    path: &Path,
    head: &str,
    rows: impl IntoIterator<Item = R>,
) -> Result<(), Failure> {
    write_atomic(path, format!("{head}\n{}", csv_lines(rows)).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_says_whether_its_aim_is_met() {
        let row = Row::new("a", "ms", &[3.0, 1.0, 2.0]);
        assert_eq!((row.value, row.runs, row.met()), (Some(2.0), 3, None));
        assert_eq!(row.clone().aim(Aim::AtMost(2.0)).met(), Some(true));
        assert_eq!(row.clone().aim(Aim::AtLeast(2.1)).met(), Some(false));
        let against = row.against("b", Some(4.0));
        assert_eq!(against.ratio(), Some(0.5));
        assert_eq!(against.clone().aim(Aim::RatioAtMost(0.4)).met(), Some(false));
        assert_eq!(against.aim(Aim::RatioAtLeast(0.5)).met(), Some(true));
        let nothing = Row::new("a", "ms", &[]).against("b", Some(0.0)).aim(Aim::RatioAtMost(1.0));
        assert_eq!((nothing.value, nothing.met()), (None, None));
    }

    #[test]
    fn tables_have_a_cell_in_every_column() {
        let rows = [Row::new("a, \"b\"", "ms", &[1.0, 1.5, 2.0]), Row::default()];
        let lines = csv_lines(rows.iter().map(Row::columns));
        assert_eq!(lines, "\"a, \"\"b\"\"\",1.5,ms,3,,,,,,1.1,1.9,\n,,,0,,,,,,,,\n");
        assert_eq!(csv_lines([("a", &(1.5, None::<u8>))]), "a,1.5,\n");
    }

    #[test]
    fn what_was_run_a_few_times_says_its_spread() {
        let cell = |values: &[f64]| value_of(&Row::new("a", "ms", values).json());
        assert_eq!(cell(&[3.0, 1.0, 2.0]), "2.00 ms (1.20 – 2.80)");
        assert_eq!(cell(&[1.0, 2.0]), "1.50 ms");
        assert_eq!(cell(&[1.0, 2.0, f64::INFINITY]), "1.50 ms");
        assert_eq!(cell(&[]), "–");
        let cells =
            cells(&Row::new("a", "", &[2.0]).against("b", Some(4.0)).aim(Aim::RatioAtMost(0.4)).json());
        assert_eq!(cells, ["a", "2.00", "4.00 (b)", "0.500", "≤ 0.400 × peer", "MISSED"]);
    }

    #[test]
    fn pages_say_what_is_missed() {
        let rows = [
            Row::new("a", "ms", &[3.0, 1.0, 2.0]).aim(Aim::AtMost(1.5)),
            Row::new("  of it b", "ms", &[1.0]).aim(Aim::AtMost(1.5)),
            Row::new("c", "rays/s", &[7.0]),
            Row::new("d", "", &[7.0]).against("e", Some(5.0)).aim(Aim::RatioAtMost(2.0)),
            Row::new("f", "", &[7.0]).against("e", None),
        ];
        let rows: Vec<Value> = rows.iter().map(Row::json).collect();
        let document = json!({"rows": rows, "notes": ["a note"], "machine": {"processor": "p", "cores": 2, "version": "1"}});
        let page = page_of("x", &document);
        assert_eq!(page.summary, ["1 of 3 targets missed.", "a note"]);
        assert_eq!(page.made.as_deref(), Some("foveal 1 on p, 2 cores"));
        assert_eq!(page.bars.len(), 2, "what has neither a spread nor a target nor a peer is in the table");
        let names = |bars: &Bars| bars.bars.iter().map(|b| b.name.clone()).collect::<Vec<_>>();
        assert_eq!(
            (names(&page.bars[0]), names(&page.bars[1])),
            (vec!["a".into(), "a: of it b".into()], vec!["d  ○ e".into()])
        );
        assert_eq!((page.bars[1].bars[0].target, page.bars[0].bars[0].is_missed), (Some(10.0), true));
        assert!(html(&page).contains("class=\"words missed\">MISSED"));
    }

    #[test]
    fn three_digits() {
        for (v, s) in [(0.0, "0"), (1234.6, "1235"), (12.34, "12.3"), (1.234, "1.23"), (0.1234, "0.123")] {
            assert_eq!(figure(v), s);
        }
        assert_eq!((figure(0.01234), figure(0.001234)), ("0.0123".into(), "1.23e-3".into()));
    }
}
