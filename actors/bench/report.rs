//! `foveal bench report`: the measurements that the book quotes, one after the other, and a page of what came of them.
//!
//! Each is a process of its own: none finds the caches of another warm, and one that fails leaves the others.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Instant, SystemTime};

use clap::Args;
use serde_json::Value;

use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};
use foveal_engine::interrupt::uninterrupted;
use foveal_terminal::machine::machine;
use foveal_terminal::print::print_line;
use foveal_terminal::progress::Progress;
use foveal_terminal::report::{Page, html};
use foveal_terminal::table::page_of_document;

/// What is measured, with its arguments, in how many runs, and what it says.
const MEASUREMENTS: [(&str, &str, u32, &str); 7] = [
    ("stages", "", 7, "Stages of a frame, with what the first paper measured on eight processors of 2001."),
    ("rays", "", 5, "Rays per second and thread; a diffuse bounce is what a walk traces most."),
    ("messages", "--quick", 5, "What a message between actors costs, with and without recording."),
    (
        "first-light",
        "",
        3,
        "From a scene that is loaded, and from the start of a process, to the first lit picture.",
    ),
    ("error", "", 3, "How fast the error of corrected pixels falls under each order of samples."),
    ("textures", "", 3, "What a limit on the memory of textures costs, beside plain rules."),
    ("skips", "", 3, "What is saved by leaving out what a scene does not need."),
];

/// Arguments of `foveal bench report`.
#[derive(Args, Debug)]
pub struct ReportArguments {
    /// Folder for the tables, plots and pages
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Run only these benchmarks, and keep the folder's results of the others
    #[arg(long, value_name = "WHAT,…", value_delimiter = ',', value_parser = MEASUREMENTS.map(|m| m.0))]
    only: Vec<String>,
    /// Runs per measurement (default: set by each benchmark)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: Option<u32>,
}

/// Runs the command.
pub fn run(a: &ReportArguments, progress: Progress) -> Result<(), Failure> {
    make_folder(&a.out)?;
    let program = std::env::current_exe()
        .map_err(|e| Failure::Environment(format!("the program does not find itself: {e}")))?;
    let mut failed = Vec::new();
    let chosen = |name: &str| a.only.is_empty() || a.only.iter().any(|only| only == name);
    let bar = progress.bar(MEASUREMENTS.len() as u64, "measurements");
    for (name, arguments, runs, _) in MEASUREMENTS.iter().filter(|m| chosen(m.0)) {
        uninterrupted()?;
        let start = Instant::now();
        let mut command = Command::new(&program);
        command.arg("bench").arg(name).args(arguments.split_whitespace()).arg("--out").arg(&a.out);
        command.args(["--runs", &a.runs.unwrap_or(*runs).to_string()]);
        let status = command.stdin(Stdio::null()).stdout(Stdio::null()).status();
        match status {
            Ok(status) if status.success() => {
                print_line(&format!("{name}: {:.0} s", start.elapsed().as_secs_f64()));
            }
            Ok(status) => failed.push(format!("{name}: {status}")),
            Err(e) => failed.push(format!("{name}: {e}")),
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let documents: Vec<(usize, Value)> = (0..MEASUREMENTS.len())
        .filter_map(|i| {
            let bytes = std::fs::read(a.out.join(format!("{}.json", MEASUREMENTS[i].0))).ok()?;
            Some((i, serde_json::from_slice(&bytes).ok()?))
        })
        .collect();
    let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let date = now.split('T').next().unwrap_or_default();
    write_atomic(&a.out.join("README.md"), markdown(&documents, date).as_bytes())?;
    write_atomic(&a.out.join("index.html"), html(&page(&documents, date)).as_bytes())?;
    print_line(&format!("open {}", a.out.join("index.html").display()));
    match failed.is_empty() {
        true => Ok(()),
        false => Err(Failure::Check(format!("not measured: {}", failed.join("; ")))),
    }
}

/// Where it was measured, in a sentence.
fn measured_on(date: &str) -> String {
    let m = machine();
    let simd =
        m["simd"].as_array().into_iter().flatten().filter_map(Value::as_str).collect::<Vec<_>>().join(", ");
    format!(
        "foveal {} on {}, {} cores ({simd}), {}, {date}.",
        m["version"].as_str().unwrap_or_default(),
        m["processor"].as_str().unwrap_or("an unknown processor"),
        m["cores"],
        m["os"].as_str().unwrap_or_default(),
    )
}

/// Rows that miss their aim, each in a sentence.
fn missed(documents: &[(usize, Value)]) -> Vec<String> {
    let rows = documents.iter().flat_map(|(i, d)| {
        d["rows"].as_array().into_iter().flatten().map(move |row| (MEASUREMENTS[*i].0, row))
    });
    let of = |(name, row): (&str, &Value)| {
        let [value, _] = cells(row);
        let aim = row["aim"].as_str().unwrap_or_default();
        format!("{name}, {}: {value} (aim {aim})", row["what"].as_str().unwrap_or_default())
    };
    rows.filter(|(_, row)| row["met"] == false).map(of).collect()
}

/// A row's value with its spread, and what is beside it.
fn cells(row: &Value) -> [String; 2] {
    let figure = |v: &Value| v.as_f64().map_or("–".to_owned(), foveal_terminal::table::figure);
    let unit = row["unit"].as_str().unwrap_or_default();
    let value = match row["band"].as_array() {
        Some(band) if band.len() == 2 => {
            format!("{} {unit} ({} – {})", figure(&row["value"]), figure(&band[0]), figure(&band[1]))
        }
        _ => format!("{} {unit}", figure(&row["value"])),
    };
    let beside = match (row["peer"].as_str(), row["peer_value"].as_f64()) {
        (Some(peer), Some(_)) => format!("{} {unit} ({peer})", figure(&row["peer_value"])),
        (Some(peer), None) => peer.to_owned(),
        (None, _) => String::new(),
    };
    [value.trim().to_owned(), beside]
}

/// In how many runs it was measured.
fn runs_of(document: &Value) -> String {
    let rows = document["rows"].as_array().into_iter().flatten();
    match rows.filter_map(|row| row["runs"].as_u64()).max() {
        None | Some(0 | 1) => "once".to_owned(),
        Some(runs) => format!("at most {runs} runs of each"),
    }
}

fn markdown(documents: &[(usize, Value)], date: &str) -> String {
    let mut text = format!("# Measured\n\n{}\n", measured_on(date));
    text += "Made by `foveal bench report --out DIR`; medians, with 10 and 90 % of the runs in brackets.\n\n";
    let missed = missed(documents);
    if !missed.is_empty() {
        text += "## Missed\n\n";
        missed.iter().for_each(|line| text += &format!("- {line}\n"));
        text += "\n";
    }
    let cell = |text: &str| text.replace('|', "\\|");
    for (i, document) in documents {
        let (name, arguments, _, says) = MEASUREMENTS[*i];
        let command = format!("foveal bench {name} {arguments}");
        text += &format!("## {name}\n\n{says} `{}`, {}.\n\n", command.trim_end(), runs_of(document));
        text += "| what | value | beside | aim | |\n| --- | --- | --- | --- | --- |\n";
        for row in document["rows"].as_array().into_iter().flatten() {
            let [value, beside] = cells(row);
            let met = match row["met"].as_bool() {
                None => "",
                Some(true) => "met",
                Some(false) => "missed",
            };
            let (what, aim) =
                (row["what"].as_str().unwrap_or_default(), row["aim"].as_str().unwrap_or_default());
            let words = [what, &value, &beside, aim, met].map(cell);
            text += &format!("| {} |\n", words.join(" | "));
        }
        text += "\n";
        for note in document["notes"].as_array().into_iter().flatten().filter_map(Value::as_str) {
            text += &format!("{note}\n\n");
        }
    }
    text
}

fn page(documents: &[(usize, Value)], date: &str) -> Page {
    let missed = missed(documents);
    let mut page = Page { title: "Measured".into(), summary: vec![measured_on(date)], ..Page::default() };
    if !missed.is_empty() {
        page.summary.push(format!("Missed: {}.", missed.join("; ")));
    }
    for (i, document) in documents {
        let (name, _, _, says) = MEASUREMENTS[*i];
        let of = page_of_document(document);
        page.bars.extend(of.0.into_iter().map(|mut bars| {
            bars.title = format!("{name}: {}", bars.title.to_lowercase());
            bars.caption = format!("{says} {}", bars.caption);
            bars
        }));
        page.tables.push(foveal_terminal::report::Table { title: name.to_owned(), ..of.1 });
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_is_missed_stands_first() {
        let rows = json!([
            {"what": "a|b", "value": 12.34, "unit": "ms", "band": [11.0, 13.0], "runs": 3, "aim": "≤ 10 ms", "met": false},
            {"what": "c", "value": null, "unit": "", "peer": "d", "peer_value": 1.0, "met": null},
        ]);
        let documents = [(0, json!({"rows": rows, "notes": ["a note"]}))];
        let text = markdown(&documents, "2000-01-01");
        assert!(text.find("## Missed").expect("there") < text.find("## stages").expect("there"));
        assert!(text.contains("- stages, a|b: 12.3 ms (11.0 – 13.0) (aim ≤ 10 ms)"));
        assert!(text.contains("`foveal bench stages`, at most 3 runs of each."));
        assert!(text.contains("| a\\|b | 12.3 ms (11.0 – 13.0) |  | ≤ 10 ms | missed |"));
        assert!(
            text.contains("| c | – | 1.00  (d) |") && text.contains("2000-01-01") && text.contains("a note")
        );
        let page = page(&documents, "2000-01-01");
        assert_eq!((page.tables.len(), page.summary.len()), (1, 2));
        assert_eq!(page.bars.len(), 1);
    }
}
