//! Walks with limited textures, for `foveal bench textures`: frame rate, memory, the bill, and the second paper's figures
//! 13 and 17.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use super::made::MadeScene;
use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};
use foveal_terminal::arguments::Size;
use foveal_terminal::plots::{Curve, time_plot};
use foveal_terminal::table::{Aim, CommonArguments, Row, median, write_csv};

/// How many times larger than the limit the textures are (Dumont 2003 §5.5).
const OVER: u64 = 4;
/// How much finer textures are along an edge where the memory of the process is looked at.
const FINER: u32 = 8;
/// Textures and maps that get a line of the bill.
const LINES: usize = 12;

fn number(d: &Value, path: &str) -> f64 {
    d.pointer(path).and_then(Value::as_f64).unwrap_or(f64::NAN)
}

/// This program, walking.
struct Walker<'a> {
    scene: &'a Path,
    size: Size,
    cache: &'a Path,
    /// Whether the C library gives large blocks back as soon as they are free. It would keep some for itself, and nobody
    /// could see from outside what the program holds.
    gives_back: bool,
}

impl Walker<'_> {
    fn walk(&self, words: &str) -> Result<Value, Failure> {
        let program = std::env::current_exe()
            .map_err(|e| Failure::Environment(format!("this program cannot be found: {e}")))?;
        let size = format!("{}x{}", self.size.width, self.size.height);
        let mut command = Command::new(program);
        command.args(["-q", "walk", "--quick", "--json", "--size", &size, "--cache"]).arg(self.cache);
        if self.gives_back {
            command.env("MALLOC_MMAP_THRESHOLD_", "65536");
        }
        let made = command.args(words.split_whitespace()).arg(self.scene).output();
        let out = made.map_err(|e| Failure::Environment(format!("a walk cannot be started: {e}")))?;
        serde_json::from_slice(&out.stdout)
            .map_err(|_| Failure::Check(format!("a walk failed: {}", String::from_utf8_lossy(&out.stderr))))
    }
}

fn texture_bytes(scene: &Path) -> Result<u64, Failure> {
    let (scene, _) = foveal_engine::opened::load_scene(scene)?;
    Ok(scene.textures.iter().map(|t| t.mips.bytes() as u64).sum())
}

/// The program walking with and without a limit: frame times, what it held, and what for.
pub fn walks(scene: &MadeScene, size: Size, a: &CommonArguments) -> Result<Vec<Row>, Failure> {
    let cache = std::env::temp_dir().join(format!("foveal-{}-textures", std::process::id()));
    make_folder(&cache)?;
    let rows = walk_all(scene, size, a, &cache);
    let _ = std::fs::remove_dir_all(&cache);
    rows
}

fn walk_all(scene: &MadeScene, size: Size, a: &CommonArguments, cache: &Path) -> Result<Vec<Row>, Failure> {
    let walker = Walker { scene: scene.path(), size, cache, gives_back: false };
    let limit = texture_bytes(scene.path())? / OVER;
    let budget = format!("--texture-budget {limit}");
    let mut figures: [Vec<f64>; 7] = Default::default();
    let mut bill = Value::Null;
    for _ in 0..a.runs.min(3) {
        // A frame a millisecond: as fast as it goes.
        let fast = "--frames 60 --fps 1000";
        let full = walker.walk(fast)?;
        let limited = walker.walk(&format!("{fast} {budget}"))?;
        let steady = walker.walk(&format!("--frames 40 --fps 10 {budget}"))?;
        let of_limit = |path| number(&steady, path) / limit as f64;
        let values = [
            number(&full, "/frame_ms/median"),
            number(&limited, "/frame_ms/median"),
            number(&steady, "/frame_ms/median"),
            of_limit("/textures/peak_used_bytes")
                .max(number(&limited, "/textures/peak_used_bytes") / limit as f64),
            of_limit("/textures/peak_held_bytes")
                .max(number(&limited, "/textures/peak_held_bytes") / limit as f64),
            number(&steady, "/stage_ms/allocate") / number(&steady, "/frame_ms/median"),
            number(&steady, "/frame_ms/p99"),
        ];
        figures.iter_mut().zip(values).for_each(|(of, value)| of.push(value));
        bill = steady;
    }
    let [full, limited, steady, counted, held, deciding, late] = figures;
    let mut rows = vec![
        Row::new("unconstrained frame of a walk with a quarter of its textures", "ms", &limited)
            .against("all textures", median(&full))
            .aim(Aim::RatioAtMost(1.05)),
        Row::new("frame of the same at 10 per second", "ms", &steady),
        Row::new("  99th percentile", "ms", &late),
        Row::new("limit: most that the allocator counted / limit", "", &counted).aim(Aim::AtMost(1.0)),
        Row::new("limit: most texels that the process held / limit", "", &held).aim(Aim::AtMost(1.0)),
        Row::new("share of a frame spent deciding (rays, maps and textures)", "", &deciding)
            .aim(Aim::AtMost(0.02)),
    ];
    rows.extend(bill_rows(&bill));
    if let Some(out) = &a.out {
        make_folder(out)?;
        // Less than for the figures above, so that there is more to decide.
        paper_figures(&walker, &format!("--texture-budget {}", limit / 2), out)?;
    }
    rows.extend(memory(size, cache)?);
    Ok(rows)
}

/// The memory of the process, with textures so large that they stand out.
fn memory(size: Size, cache: &Path) -> Result<Vec<Row>, Failure> {
    let scene = MadeScene::bundled("gallery")?;
    scene.refine_pictures(FINER)?;
    let walker = Walker { scene: scene.path(), size, cache, gives_back: true };
    let all = texture_bytes(scene.path())?;
    let limit = all / OVER;
    let words = "--frames 40 --fps 10";
    let full = number(&walker.walk(words)?, "/walk_memory_bytes");
    let limited = walker.walk(&format!("{words} --texture-budget {limit}"))?;
    let without = full - all as f64;
    let share = (number(&limited, "/walk_memory_bytes") - without) / limit as f64;
    let mib = f64::from(1 << 20);
    Ok(vec![
        Row::new(
            "large textures: memory of the process",
            "MiB",
            &[number(&limited, "/walk_memory_bytes") / mib],
        )
        .against("all textures", Some(full / mib)),
        Row::new(
            format!("limit of {:.0} MiB: memory above that without textures / limit", limit as f64 / mib),
            "",
            &[share],
        )
        .aim(Aim::AtMost(1.0)),
        Row::new(
            "  most texels that the process held / limit",
            "",
            &[number(&limited, "/textures/peak_held_bytes") / limit as f64],
        )
        .aim(Aim::AtMost(1.0)),
    ])
}

/// The bill: what each texture and map asked for, was given, and loses by that.
fn bill_rows(d: &Value) -> Vec<Row> {
    let kib = |v: &Value| v.as_f64().unwrap_or(0.0) / 1024.0;
    let mut rows = Vec::new();
    for (what, name, lines) in [
        ("texture", "texture", &d["textures"]["bill"]),
        ("environment map", "name", &d["environment_maps"]["bill"]),
    ] {
        let mut lines: Vec<&Value> = lines.as_array().into_iter().flatten().collect();
        // The sum of nothing is −0.
        let loss = |line: &Value| line["visible_loss"].as_f64().unwrap_or(0.0).max(0.0) + 0.0;
        lines.sort_by(|a, b| {
            loss(b).total_cmp(&loss(a)).then(kib(&b["asked_bytes"]).total_cmp(&kib(&a["asked_bytes"])))
        });
        for line in lines.into_iter().take(LINES) {
            let text = format!(
                "bill: {what} {}: {:.1} KiB asked, {:.1} KiB given; predicted visible loss",
                line[name].as_str().unwrap_or_default(),
                kib(&line["asked_bytes"]),
                kib(&line["given_bytes"]),
            );
            rows.push(Row::new(text, "JND · pixels", &[loss(line)]));
        }
    }
    for (what, key) in [("textures", "textures"), ("environment maps", "environment_maps")] {
        let price = number(d, &format!("/{key}/one_more_mib_buys"));
        rows.push(Row::new(format!("bill: one more MiB of {what} would buy"), "JND · pixels", &[price]));
    }
    rows
}

/// A number of each frame against the time at which it was shown, seconds.
fn over_time(d: &Value, of: impl Fn(usize) -> f64) -> Vec<(f32, f32)> {
    let mut now = 0.0;
    let frames = d["over_time"]["frame_ms"].as_array().into_iter().flatten();
    let at = |(i, ms): (usize, &Value)| {
        now += ms.as_f64().unwrap_or(0.0) * 1e-3;
        (now as f32, of(i) as f32)
    };
    frames.enumerate().map(at).collect()
}

fn rate(d: &Value) -> Vec<(f32, f32)> {
    over_time(d, |i| 1e3 / d["over_time"]["frame_ms"][i].as_f64().unwrap_or(f64::NAN))
}

fn loss(d: &Value) -> Vec<(f32, f32)> {
    over_time(d, |i| -d["over_time"]["quality"][i].as_f64().unwrap_or(f64::NAN))
}

/// Figures 13 (q, levels and frame rate over time) and 17 (both modes), as SVG with their numbers as CSV.
fn paper_figures(walker: &Walker<'_>, budget: &str, out: &Path) -> Result<(), Failure> {
    let kept_rate = walker.walk(&format!("--fps 10 {budget}"))?;
    let kept_quality = walker.walk(&format!("--fps 10 --mode fixed-quality {budget}"))?;
    let plot = |name: &str, title: &str, unit: &str, lines: &[Curve]| -> Result<(), Failure> {
        if let Some(svg) = time_plot(title, unit, lines) {
            write_atomic(&out.join(format!("{name}.svg")), svg.as_bytes())?;
        }
        let points = lines.iter().flat_map(|c| c.points.iter().map(|p| (&c.name, p)));
        write_csv(&out.join(format!("{name}.csv")), "curve,seconds,value", points)
    };
    let of_textures = |key: &'static str| -> Vec<Curve> {
        let textures = &kept_rate["textures"];
        let points = textures["over_time"].as_array().map_or(&[][..], Vec::as_slice);
        let count = textures["bill"].as_array().map_or(0, Vec::len);
        let of = |t: usize| Curve {
            name: textures["bill"][t]["texture"].as_str().unwrap_or_default().to_owned(),
            // Frames before the first decision have no entry.
            points: over_time(&kept_rate, |i| {
                let first = kept_rate["over_time"]["frame_ms"].as_array().map_or(0, Vec::len) - points.len();
                let entry = i.checked_sub(first).and_then(|i| points.get(i));
                entry.and_then(|p| p[key][t].as_f64()).unwrap_or(f64::NAN)
            }),
        };
        (0..count).map(of).collect()
    };
    let curve = |name: &str, points| Curve { name: name.to_owned(), points };
    let mut losses = of_textures("losses");
    let mut levels = of_textures("finest");
    // In the beginning everything is missing, beside which nothing else would be seen.
    losses.iter_mut().chain(&mut levels).for_each(|c| c.points.retain(|p| p.0 > 1.0));
    losses.iter_mut().flat_map(|c| &mut c.points).for_each(|p| p.1 = -p.1);
    plot("figure-13-a-quality", "Quality q of each texture", "JND · pixels", &losses)?;
    plot("figure-13-b-levels", "Finest level of each texture in memory", "level", &levels)?;
    plot("figure-13-c-rate", "Frames per second", "1/s", &[curve("fixed-rate", rate(&kept_rate))])?;
    let both = |of: fn(&Value) -> Vec<(f32, f32)>| {
        [curve("fixed-rate", of(&kept_rate)), curve("fixed-quality", of(&kept_quality))]
    };
    plot("figure-17-rate", "Frame rate of both modes", "1/s", &both(rate))?;
    plot("figure-17-loss", "Visible error of frames shown, −Q", "JND", &both(loss))
}
