//! `foveal bench report`: the measurements that the book quotes, one after the other, and a page of what came of them.
//!
//! Each is a process of its own: none finds the caches of another warm, and one that fails leaves the others.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use clap::Args;
use serde_json::Value;

use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};
use foveal_engine::interrupt::uninterrupted;
use foveal_terminal::bars::{Bars, svg};
use foveal_terminal::machine::made_on;
use foveal_terminal::print::print_line;
use foveal_terminal::progress::Progress;
use foveal_terminal::report::{Page, html};
use foveal_terminal::table::{HEAD, HOW_TO_READ, bars_of, cells, indented, named_rows, table, value_of};

/// A measurement that the book quotes.
struct Measurement {
    /// `foveal bench NAME`.
    name: &'static str,
    /// With these arguments.
    arguments: &'static str,
    /// In so many runs.
    runs: u32,
    /// What it measures, in a sentence.
    says: &'static str,
    /// What to see in its plot.
    see: &'static str,
    /// Plots that it leaves besides: what their files begin with, and what to see in them.
    curves: &'static [(&'static str, &'static str)],
}

const MEASUREMENTS: [Measurement; 7] = [
    Measurement {
        name: "stages",
        arguments: "",
        runs: 7,
        says: "Stages of a frame, compared with what Haber et al. measured in 2001 on eight processors.",
        see: "Times and memory: a dot should lie to the left of its red target. Samples traced in 50 ms: to the right of it.",
        curves: &[],
    },
    Measurement {
        name: "rays",
        arguments: "",
        runs: 5,
        says: "Rays per second of processor time. Most of the rays of a walk are diffuse bounces.",
        see: "Further right is faster. A dot should lie to the right of its ring, which is the same rays traced by what is \
              named there.",
        curves: &[],
    },
    Measurement {
        name: "messages",
        arguments: "--quick",
        runs: 5,
        says: "What a message between actors costs, recorded and not recorded.",
        see: "Jobs and messages per second: further right is better. Times and bytes: further left is better, and a dot should \
              lie to the left of its red target.",
        curves: &[],
    },
    Measurement {
        name: "first-light",
        arguments: "",
        runs: 3,
        says: "The time to the first lit picture, from a loaded scene and from the start of a process.",
        see: "A dot should lie to the left of its red target. Larger scenes take longer; a second start finds the light kept.",
        curves: &[],
    },
    Measurement {
        name: "error",
        arguments: "",
        runs: 3,
        says: "How fast the error of corrected pixels falls under each order of samples.",
        see: "Less error is further left. A dot to the left of its ring: the order by expected utility leaves less error than \
              the other order in the same time.",
        curves: &[(
            "error-",
            "Error against processor time in a still view, and against the time of the walk while walking. Lower is better, \
             and so is to fall earlier. Lines are medians, bands the 10th to the 90th percentile of the runs.",
        )],
    },
    Measurement {
        name: "textures",
        arguments: "",
        runs: 3,
        says: "What a limit on the memory of textures costs, compared with plain rules for what to keep.",
        see: "Less error is further left. A ring is the best plain rule under the same limit, or the same without a limit.",
        curves: &[
            (
                "figure-13-a",
                "A walk with room for an eighth of its textures, after Dumont et al. 2003, figure 13: what each texture \
                 loses by the level it is given. Dips are textures that come near and whose finer levels are being loaded.",
            ),
            ("figure-13-b", "The finest level of each texture in memory in the same walk; 0 is full size."),
            ("figure-13-c", "The frame rate of the same walk: it should stay at 10 frames per second."),
            (
                "figure-17-rate",
                "Both modes, after figure 17 of the same paper: `fixed-rate` holds the frame rate and lets the quality vary, \
                 `fixed-quality` the other way round.",
            ),
            ("figure-17-loss", "The visible error of the frames shown in both modes; lower is better."),
        ],
    },
    Measurement {
        name: "skips",
        arguments: "",
        runs: 3,
        says: "What is saved by leaving out the parts that a scene does not need.",
        see: "A dot is the cost as it is, its ring the cost with the part that was left out: what lies between is saved.",
        curves: &[],
    },
];

/// Arguments of `foveal bench report`.
#[derive(Args, Debug)]
pub struct ReportArguments {
    /// Folder for the tables, plots and pages
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Run only these benchmarks, and keep the folder's results of the others
    #[arg(long, value_name = "WHAT,…", value_delimiter = ',', value_parser = MEASUREMENTS.map(|m| m.name))]
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
    for Measurement { name, arguments, runs, .. } in MEASUREMENTS.iter().filter(|m| chosen(m.name)) {
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
    let documents = MEASUREMENTS.iter().filter_map(|of| {
        let bytes = std::fs::read(a.out.join(format!("{}.json", of.name))).ok()?;
        Some(Measured { of, document: serde_json::from_slice(&bytes).ok()? })
    });
    write(&a.out, &documents.collect::<Vec<_>>())?;
    print_line(&format!("open {}", a.out.join("index.html").display()));
    match failed.is_empty() {
        true => Ok(()),
        false => Err(Failure::Check(format!("not measured: {}", failed.join("; ")))),
    }
}

/// A measurement and what came of it.
struct Measured {
    of: &'static Measurement,
    document: Value,
}

impl Measured {
    fn rows(&self) -> impl Iterator<Item = &Value> {
        self.document["rows"].as_array().into_iter().flatten()
    }

    fn notes(&self) -> impl Iterator<Item = &str> {
        self.document["notes"].as_array().into_iter().flatten().filter_map(Value::as_str)
    }

    /// The command that made it, and how often it measured.
    fn command(&self) -> String {
        let Measurement { name, arguments, .. } = self.of;
        let runs = match self.rows().filter_map(|row| row["runs"].as_u64()).max() {
            None | Some(0 | 1) => "one run".to_owned(),
            Some(runs) => format!("up to {runs} runs"),
        };
        format!("`{}`, {runs}", format!("foveal bench {name} {arguments}").trim_end())
    }

    /// Rows that miss their target, each in words.
    fn missed(&self) -> impl Iterator<Item = String> {
        let missed = named_rows(&self.document).into_iter().filter(|(_, row)| row["met"] == false);
        missed.map(|(what, row)| {
            let target = row["aim"].as_str().unwrap_or_default();
            let peer = row["peer"].as_str().filter(|_| target.ends_with("peer"));
            let target = peer.map_or(target.to_owned(), |peer| {
                format!("{} {peer}", target.trim_end_matches("peer").trim_end())
            });
            format!("{}, {what}: {}, target {target}", self.of.name, value_of(row))
        })
    }

    /// The plot of its numbers: of those that have a target or a peer, if any has.
    fn plot(&self) -> Option<String> {
        let all = bars_of(&self.document);
        let mut some = all.clone();
        some.iter_mut().for_each(|b| b.bars.retain(|b| b.target.is_some() || b.peer.is_some()));
        some.retain(|b| !b.bars.is_empty());
        let drawn = if some.is_empty() { all } else { some };
        let drawn: Vec<Bars> = drawn.into_iter().map(Bars::on_a_scale_that_shows_all).collect();
        svg(&format!("foveal bench {}", self.of.name), &drawn)
    }
}

/// Writes the plots, and the two pages around them.
fn write(out: &Path, all: &[Measured]) -> Result<(), Failure> {
    let (mut text, made) = (beginning(all), made_together(all));
    for measured in all {
        let name = measured.of.name;
        let mut plots = Vec::new();
        if let Some(svg) = measured.plot() {
            let file = format!("{name}.svg");
            write_atomic(&out.join(&file), svg.as_bytes())?;
            plots.push((measured.of.see, vec![file]));
        }
        for (begins, see) in measured.of.curves {
            plots.push((see, files(out, begins)));
        }
        text += &markdown(measured, made.is_some(), &plots);
    }
    write_atomic(&out.join("README.md"), format!("{}\n", text.trim_end()).as_bytes())?;
    write_atomic(&out.join("index.html"), html(&page(all)).as_bytes())
}

/// Plots in a folder whose names begin so, in order.
fn files(folder: &Path, begins: &str) -> Vec<String> {
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = names.filter_map(|entry| entry.file_name().into_string().ok());
    let names: BTreeSet<String> =
        names.filter(|name| name.starts_with(begins) && name.ends_with(".svg")).collect();
    names.into_iter().collect()
}

/// Where and when all of it was measured, if that is the same.
fn made_together(all: &[Measured]) -> Option<String> {
    let made = made_on(&all.first()?.document);
    all.iter().all(|m| made_on(&m.document) == made).then_some(made)
}

/// What stands in front of the measurements.
fn beginning(all: &[Measured]) -> String {
    let mut text = String::from("# Measurements\n\n");
    if let Some(made) = made_together(all) {
        text += &format!("Measured by {made}.\n\n");
    }
    text += &format!(
        "`foveal bench report --out DIR` wrote this page, its plots and its tables; `index.html` is the same for a browser. \
         {HOW_TO_READ}\n\n"
    );
    let missed: Vec<String> = all.iter().flat_map(Measured::missed).collect();
    if !missed.is_empty() {
        text += "## Targets missed\n\n";
        missed.iter().for_each(|line| text += &format!("- {line}\n"));
        text += "\n";
    }
    text
}

/// A measurement as a part of that page, which may have said already by what, where and when it was made.
fn markdown(measured: &Measured, is_said: bool, plots: &[(&str, Vec<String>)]) -> String {
    let Measurement { name, says, .. } = measured.of;
    let on = if is_said { String::new() } else { format!(", by {}", made_on(&measured.document)) };
    let mut text = format!("## {name}\n\n{says} {}{on}.\n\n", measured.command());
    for (see, files) in plots.iter().filter(|(_, files)| !files.is_empty()) {
        for file in files {
            text += &format!("![Plot: {}]({file})\n\n", file.trim_end_matches(".svg").replace('-', " "));
        }
        text += &format!("*{see}*\n\n");
    }
    text += &format!("| {} |\n|{}\n", HEAD.join(" | "), " --- |".repeat(HEAD.len()));
    for row in measured.rows() {
        let cells = indented(cells(row)).map(|text| text.replace('|', "\\|").replace("MISSED", "missed"));
        text += &format!("| {} |\n", cells.join(" | "));
    }
    text += &format!("\nThe same rows: [{name}.csv]({name}.csv).\n\n");
    measured.notes().for_each(|note| text += &format!("{note}\n\n"));
    text
}

fn page(all: &[Measured]) -> Page {
    let missed: Vec<String> = all.iter().flat_map(Measured::missed).collect();
    let made = made_together(all);
    let mut page = Page { title: "Measurements".into(), ..Page::default() };
    if !missed.is_empty() {
        page.summary.push(format!("Targets missed: {}.", missed.join("; ")));
    }
    for measured in all {
        let Measurement { name, says, see, .. } = measured.of;
        let on = if made.is_some() {
            String::new()
        } else {
            format!(" Measured by {}.", made_on(&measured.document))
        };
        // What is measured is said once, how to read it below each plot.
        let said = std::iter::once(format!("{says} ")).chain(std::iter::repeat(String::new()));
        page.bars.extend(bars_of(&measured.document).into_iter().zip(said).map(|(bars, says)| Bars {
            title: format!("{name}: {}", bars.title.replacen("In ", "in ", 1)),
            caption: format!("{says}{see} {}", bars.caption),
            ..bars
        }));
        let notes: Vec<&str> = measured.notes().collect();
        let caption = format!("{says} {HOW_TO_READ}{on} {}", notes.join("; "));
        page.tables.push(table(name, caption.trim_end(), &measured.document));
    }
    page.made = made;
    page
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn measured(i: usize, rows: Value) -> Measured {
        let machine = json!({"processor": "p", "cores": 2, "version": "1"});
        let document =
            json!({"rows": rows, "notes": ["a note"], "machine": machine, "date": format!("2000-01-0{i}")});
        Measured { of: &MEASUREMENTS[i], document }
    }

    fn rows() -> Value {
        json!([
            {"what": "a|b", "value": 12.34, "unit": "ms", "band": [11.0, 13.0], "runs": 3, "aim": "≤ 10 ms", "met": false},
            {"what": "  of it c", "value": 2.0, "unit": "ms", "peer": "d", "peer_value": 1.0, "aim": "≤ 1.50 × peer", "met": false},
            {"what": "e", "value": null, "unit": "", "peer": "d", "peer_value": 1.0, "met": null},
        ])
    }

    #[test]
    fn what_is_missed_stands_first() {
        let one = [measured(1, rows())];
        let text = beginning(&one);
        assert!(text.contains("Measured by foveal 1 on p, 2 cores, 2000-01-01."), "{text}");
        assert!(text.contains("\n- rays, a|b: 12.3 ms (11.0 – 13.0), target ≤ 10 ms\n"), "{text}");
        assert!(text.contains("\n- rays, a|b: of it c: 2.00 ms, target ≤ 1.50 × d\n"), "{text}");
        let text = markdown(&one[0], true, &[("see", vec!["rays.svg".into()]), ("nothing", Vec::new())]);
        assert!(text.contains("`foveal bench rays`, up to 3 runs."), "{text}");
        assert!(text.contains("| a\\|b | 12.3 ms (11.0 – 13.0) |  |  | ≤ 10 ms | missed |"), "{text}");
        assert!(text.contains("| e | – | 1.00 (d) |") && text.contains("a note"), "{text}");
        assert!(text.contains("![Plot: rays](rays.svg)\n\n*see*\n") && !text.contains("nothing"), "{text}");
        let page = page(&one);
        assert_eq!((page.tables.len(), page.summary.len(), page.bars.len()), (1, 1, 1));
        assert!(page.tables[0].caption.ends_with("a note") && page.made.is_some());
    }

    /// What was measured on different days says so itself.
    #[test]
    fn each_is_of_its_day() {
        let two = [measured(1, rows()), measured(2, rows())];
        assert!(!beginning(&two).contains("Measured by") && page(&two).made.is_none());
        assert!(page(&two).tables[1].caption.contains("2000-01-02"));
        assert!(markdown(&two[1], false, &[]).contains(", by foveal 1 on p, 2 cores, 2000-01-02.\n"));
    }

    #[test]
    fn plots_that_are_linked_are_there() {
        let folder = tempfile::tempdir().expect("a folder");
        let curve = "<svg xmlns=\"http://www.w3.org/2000/svg\"></svg>";
        for name in ["error-box-still.svg", "error-box-still.csv", "other.svg"] {
            std::fs::write(folder.path().join(name), curve).expect("a file");
        }
        write(folder.path(), &[measured(0, rows()), measured(4, rows())]).expect("written");
        let text = std::fs::read_to_string(folder.path().join("README.md")).expect("a page");
        let mut linked: Vec<&str> =
            text.split("](").skip(1).filter_map(|rest| rest.split(')').next()).collect();
        linked.retain(|file| file.ends_with(".svg"));
        assert_eq!(linked, ["stages.svg", "error.svg", "error-box-still.svg"]);
        for file in linked {
            let svg = std::fs::read_to_string(folder.path().join(file)).expect("a plot");
            assert!(svg.starts_with("<svg") && svg.ends_with("</svg>") && !svg.contains("NaN"), "{svg}");
        }
        assert!(folder.path().join("index.html").exists());
    }
}
