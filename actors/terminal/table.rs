//! A benchmark's result: rows of medians, each with its aim and, where there is one, a peer of the same run.

use std::path::{Path, PathBuf};

use clap::Args;
use foveal::metrics::quantile;
use serde::Serialize;
use serde_json::{Value, json};

use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};

use crate::known::Known;
use crate::machine::machine;
use crate::print::{print_json, print_line};
use crate::report::{Bar, Bars, Page, Table, html};

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
    /// 10 and 90 % of the runs, where those are told.
    pub band: Option<[f64; 2]>,
    /// Of an error: what pictures are held against.
    pub reference: Option<String>,
}

impl Row {
    /// The median of `values`.
    pub fn new(what: impl Into<String>, unit: &'static str, values: &[f64]) -> Self {
        Self {
            what: what.into(),
            value: median(values),
            unit,
            runs: values.len() as u32,
            peer: None,
            peer_value: None,
            aim: None,
            band: None,
            reference: None,
        }
    }

    /// With the 10 and 90 % quantiles of the values that the median is of.
    pub fn with_band(mut self, values: &[f64]) -> Self {
        self.band = (values.len() > 1 && self.value.is_some())
            .then(|| [0.1, 0.9].map(|share| quantile(values.iter().copied(), share)));
        self
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

    fn cells(&self) -> [String; 6] {
        let with_unit = |v: Option<f64>| v.map_or("–".into(), |v| format!("{} {}", figure(v), self.unit));
        [
            self.what.clone(),
            match self.band {
                Some([low, high]) => {
                    format!("{} ({} – {})", with_unit(self.value), figure(low), figure(high))
                }
                None => with_unit(self.value),
            },
            match (&self.peer, self.peer_value) {
                (Some(peer), Some(_)) => format!("{} ({peer})", with_unit(self.peer_value)),
                (Some(peer), None) => peer.clone(),
                (None, _) => String::new(),
            },
            self.ratio().map(figure).unwrap_or_default(),
            self.aim_text().unwrap_or_default(),
            match self.met() {
                None => "",
                Some(true) => "met",
                Some(false) => "MISSED",
            }
            .into(),
        ]
    }
}

/// Columns of a table.
const HEAD: [&str; 6] = ["what", "value", "beside", "ratio", "aim", ""];

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

/// Prints the rows as the arguments ask for, and leaves NAME.csv in the folder.
pub fn finish(name: &str, rows: &[Row], notes: &[String], a: &CommonArguments) -> Result<(), Failure> {
    let document = json!({
        "schema": format!("foveal.bench.{name}/1"),
        "machine": machine(),
        "rows": rows.iter().map(Row::json).collect::<Vec<_>>(),
        "notes": notes,
    });
    if let Some(out) = &a.out {
        make_folder(out)?;
        let columns = "what,value,unit,runs,peer,peer_value,ratio,aim,met,low,high,reference";
        write_csv(&out.join(format!("{name}.csv")), columns, rows.iter().map(Row::columns))?;
        write_atomic(&out.join(format!("{name}.json")), format!("{document:#}\n").as_bytes())?;
        let page = page_of(name, rows, notes, &document["machine"]);
        write_atomic(&out.join(format!("{name}.html")), html(&page).as_bytes())?;
    }
    if a.json {
        print_json(&document);
        return Ok(());
    }
    let lines: Vec<[String; 6]> =
        std::iter::once(HEAD.map(String::from)).chain(rows.iter().map(Row::cells)).collect();
    let widths: [usize; 6] =
        std::array::from_fn(|c| lines.iter().map(|l| l[c].chars().count()).max().unwrap_or(0));
    for line in &lines {
        let cells: Vec<String> =
            line.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}")).collect();
        print_line(cells.join("  ").trim_end());
    }
    let m = &document["machine"];
    print_line(&format!("on {}, {} cores", m["processor"].as_str().unwrap_or("?"), m["cores"]));
    for note in notes {
        print_line(note);
    }
    Ok(())
}

/// The rows as a report shows them.
pub fn table_of(title: &str, rows: &[Row]) -> Table {
    Table {
        title: title.to_owned(),
        header: HEAD.map(String::from).to_vec(),
        rows: rows.iter().map(|r| r.cells().to_vec()).collect(),
    }
}

/// A number of a row, as it is drawn.
struct Drawn {
    name: String,
    unit: String,
    value: f64,
    band: Option<[f64; 2]>,
    aim: Option<f64>,
}

/// Spreads by unit, of rows that have a spread or an aim.
fn spreads(rows: impl Iterator<Item = Drawn>) -> Vec<Bars> {
    let mut all: Vec<Bars> = Vec::new();
    let is_drawn = |d: &Drawn| d.value.is_finite() && d.value >= 0.0 && (d.band.is_some() || d.aim.is_some());
    for Drawn { name, unit, value, band, aim } in rows.filter(is_drawn) {
        let bounds = band.unwrap_or([value; 2]);
        let bar = Bar { name, known: Known { median: value, bounds }, reach: bounds, aim };
        match all.iter_mut().find(|bars| bars.unit == unit) {
            Some(of_unit) => of_unit.bars.push(bar),
            None => all.push(Bars {
                title: if unit.is_empty() { "Ratios".into() } else { format!("In {unit}") },
                caption: "Point: the median of the runs; line: 10 to 90 % of them, where there are several. Red: the aim."
                    .into(),
                unit,
                bars: vec![bar],
            }),
        }
    }
    all
}

/// The rows as a page: spreads by unit, and the table.
fn page_of(name: &str, rows: &[Row], notes: &[String], machine: &Value) -> Page {
    let on = format!("{}, {} cores", machine["processor"].as_str().unwrap_or("?"), machine["cores"]);
    let missed = rows.iter().filter(|row| row.met() == Some(false)).count();
    let aims = rows.iter().filter(|row| row.met().is_some()).count();
    let drawn = |row: &Row| Drawn {
        name: row.what.clone(),
        unit: row.unit.to_owned(),
        value: row.value.unwrap_or(f64::NAN),
        band: row.band,
        aim: match row.aim {
            Some(Aim::AtMost(aim) | Aim::AtLeast(aim)) => Some(aim),
            _ => None,
        },
    };
    let measured = match (aims, missed) {
        (0, _) => String::new(),
        (_, 0) => format!(" All {aims} aims are met."),
        _ => format!(" {missed} of {aims} aims missed."),
    };
    Page {
        title: format!("foveal bench {name}"),
        summary: std::iter::once(format!("Measured on {on}.{measured}"))
            .chain(notes.iter().cloned())
            .collect(),
        bars: spreads(rows.iter().map(drawn)),
        tables: vec![table_of("All rows", rows)],
        ..Page::default()
    }
}

/// The same of a document that [`finish`] left: spreads by unit, and the table.
pub fn page_of_document(document: &Value) -> (Vec<Bars>, Table) {
    let rows = || document["rows"].as_array().into_iter().flatten();
    let text = |row: &Value, key: &str| row[key].as_str().unwrap_or_default().to_owned();
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let with_unit = |row: &Value, key: &str| match row[key].as_f64() {
        Some(v) => format!("{} {}", figure(v), text(row, "unit")),
        None => "–".to_owned(),
    };
    let drawn = |row: &Value| Drawn {
        name: text(row, "what"),
        unit: text(row, "unit"),
        value: number(row, "value"),
        band: Some([row["band"][0].as_f64(), row["band"][1].as_f64()])
            .and_then(|[low, high]| Some([low?, high?])),
        // `≤ 10 ms`; of a ratio to a peer there is no place on this scale.
        aim: text(row, "aim")
            .split_whitespace()
            .nth(1)
            .and_then(|v| v.parse().ok())
            .filter(|_| !text(row, "aim").ends_with("peer")),
    };
    let line = |row: &Value| {
        let beside = match (row["peer"].as_str(), row["peer_value"].as_f64()) {
            (Some(peer), Some(_)) => format!("{} ({peer})", with_unit(row, "peer_value")),
            (peer, _) => peer.unwrap_or_default().to_owned(),
        };
        let met = match row["met"].as_bool() {
            None => "",
            Some(true) => "met",
            Some(false) => "MISSED",
        };
        let ratio = row["ratio"].as_f64().map(figure).unwrap_or_default();
        vec![text(row, "what"), with_unit(row, "value"), beside, ratio, text(row, "aim"), met.into()]
    };
    let table = Table {
        title: String::new(),
        header: HEAD.map(String::from).to_vec(),
        rows: rows().map(line).collect(),
    };
    (spreads(rows().map(drawn)), table)
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
        let rows = [Row::new("a, \"b\"", "ms", &[1.5]).with_band(&[1.0, 2.0]), Row::default()];
        let lines = csv_lines(rows.iter().map(Row::columns));
        assert_eq!(lines, "\"a, \"\"b\"\"\",1.5,ms,1,,,,,,1.1,1.9,\n,,,0,,,,,,,,\n");
        assert_eq!(csv_lines([("a", &(1.5, None::<u8>))]), "a,1.5,\n");
    }

    #[test]
    fn pages_say_what_is_missed() {
        let rows = [
            Row::new("a", "ms", &[3.0, 1.0, 2.0]).with_band(&[3.0, 1.0, 2.0]).aim(Aim::AtMost(1.5)),
            Row::new("b", "ms", &[1.0]).aim(Aim::AtMost(1.5)),
            Row::new("c", "rays/s", &[7.0]),
        ];
        let page = page_of("x", &rows, &["a note".into()], &json!({"processor": "p", "cores": 2}));
        assert_eq!(page.summary, ["Measured on p, 2 cores. 1 of 2 aims missed.", "a note"]);
        assert_eq!(page.bars.len(), 1, "what has neither a spread nor an aim is in the table");
        assert_eq!(page.bars[0].bars.len(), 2);
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
