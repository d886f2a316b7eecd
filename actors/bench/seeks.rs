//! `foveal bench seeks`: how soon a moment of a recording is there, the first time and later, and how soon it is told when
//! something came about; beside it what the recording takes.
//!
//! Looks are processes, from their start until the picture is written and they have ended, as somebody has them who asks on
//! a command line; and frames of a recording that stands open, as in the window.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::Args;
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::uninterrupted;
use foveal_engine::recording::{Elsewhere, light_beside, open_trace};
use foveal_engine::replay::{Player, Source};
use foveal_engine::source::{FrameSource, Timeline};
use foveal_runtime::TraceStat;
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

use super::made::MadeScene;
use super::timed;

/// What is asked of the recording.
const QUESTIONS: [&str; 3] =
    ["allocator.in_flight > 3", "renderer.counts.traced > 1000", "allocator hears JobDone samples > 200"];
/// Frames a second of a walk that is recorded here.
const FPS: u32 = 10;

/// Arguments of `foveal bench seeks`.
#[derive(Args, Debug)]
pub struct SeeksArguments {
    /// Recording (default: one is made of the gallery, with growing light)
    #[arg(value_name = "FVL")]
    recording: Option<PathBuf>,
    /// Frames of the recording that is made, ten per second
    #[arg(long, value_name = "N", default_value_t = 600, conflicts_with = "recording", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Picture size of the recording that is made
    #[arg(long, value_name = "WxH", default_value = "512x512", conflicts_with = "recording")]
    size: Size,
    /// Number of frames to seek to, evenly spaced
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=1000))]
    looks: u32,
    /// Another build of foveal, measured in alternation with this one
    #[arg(long, value_name = "PROGRAM")]
    before: Option<PathBuf>,
    /// Folder for what is cached of the recording, which remains there (default: a temporary one)
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArguments,
}

/// A program, with a folder for what it keeps.
struct Looks<'a> {
    program: &'a Path,
    cache: PathBuf,
    recording: &'a Path,
}

impl Looks<'_> {
    /// Asks something of the recording, and says how many seconds that took.
    fn replay(&self, question: &[&str]) -> Result<f64, Failure> {
        let wrong = |what: &str| {
            Failure::Check(format!("{}: replay {}: {what}", self.program.display(), question.join(" ")))
        };
        let mut process = Command::new(self.program);
        process.args(["-q", "replay", "--cache"]).args([&self.cache, self.recording]).args(question);
        let (ms, ended) = timed(|| process.stdin(Stdio::null()).output());
        let ended = ended.map_err(|e| wrong(&e.to_string()))?;
        let said = String::from_utf8_lossy(&ended.stderr);
        // That something never comes about is an answer, too.
        match ended.status.success() || said.contains("never comes about") {
            true => Ok(ms * 1e-3),
            false => Err(wrong(said.trim())),
        }
    }

    fn show(&self, frame: u32, out: &str) -> Result<f64, Failure> {
        self.replay(&["--show", &frame.to_string(), "--out", out])
    }
}

/// Records a walk through the gallery, which has to stay as long as the recording.
fn record(program: &Path, a: &SeeksArguments, folder: &Path) -> Result<(PathBuf, MadeScene), Failure> {
    let scene = MadeScene::bundled("gallery")?;
    let (file, size) = (folder.join("walk.fvl"), format!("{}x{}", a.size.width, a.size.height));
    let status = Command::new(program)
        .args(["-q", "walk", "--frames", &a.frames.to_string(), "--fps", &FPS.to_string(), "--size", &size])
        // Longer than anybody waits, so that it does not come to its end.
        .args(["--error", "0.1%", "--particles", "1000000000", "--cache"])
        .args([&folder.join("light"), Path::new("--record"), &file, scene.path()])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .status();
    match status {
        Ok(status) if status.success() => Ok((file, scene)),
        Ok(status) => Err(Failure::Check(format!("a walk to be recorded ended with {status}"))),
        Err(e) => Err(Failure::Environment(format!("no walk can be recorded: {e}"))),
    }
}

/// Runs the benchmark.
pub fn run(a: &SeeksArguments, progress: Progress) -> Result<(), Failure> {
    let environment = |e: std::io::Error| Failure::Environment(format!("looks cannot be measured: {e}"));
    let own = std::env::current_exe().map_err(environment)?;
    let folder = tempfile::tempdir().map_err(environment)?;
    let (recording, _scene) = match &a.recording {
        Some(file) => (file.clone(), None),
        None => record(&own, a, folder.path()).map(|(file, scene)| (file, Some(scene)))?,
    };
    let cache = a.cache.clone().unwrap_or_else(|| folder.path().join("kept"));
    let of = |program, name| Looks { program, cache: cache.join(name), recording: &recording };
    let mut programs = vec![of(own.as_path(), "here")];
    programs.extend(a.before.as_deref().map(|before| of(before, "before")));
    let source = opened(&recording, &programs[0].cache)?;
    let (frames, seconds) =
        (source.shown_in.len() as u32, source.frames_begun().map(|begun| f64::from(begun.time)).sum::<f64>());
    let [width, height] = [source.recorded.settings.width, source.recorded.settings.height];
    drop(source);
    let name = format!("{frames} frames of {width} × {height}");
    let mut rows = recorded(&recording, seconds, &name)?;

    let indexed = programs.iter().map(|of| of.replay(&["--index"])).collect::<Result<Vec<_>, Failure>>()?;
    let row = Row::new(format!("{name}: a replay that leaves snapshots"), "s", &indexed[..1]);
    rows.push(row.against_another(&indexed));
    let looked_at: Vec<u32> = (1..=a.looks)
        .map(|i| (u64::from(frames) * u64::from(2 * i - 1) / u64::from(2 * a.looks)) as u32)
        .collect();
    let picture = folder.path().join("picture.png");
    let picture = picture.to_string_lossy();
    let bar = progress.bar(u64::from(a.looks), "looks");
    let (mut first, mut later) = (vec![Vec::new(); programs.len()], vec![Vec::new(); programs.len()]);
    for frame in &looked_at {
        for (number, of) in programs.iter().enumerate() {
            first[number].push(of.show(*frame, &picture)?);
        }
        let mut looks = vec![Vec::new(); programs.len()];
        for _ in 0..a.common.runs {
            uninterrupted()?;
            for (number, of) in programs.iter().enumerate() {
                looks[number].push(of.show(*frame, &picture)?);
            }
        }
        looks.iter().zip(&mut later).for_each(|(looks, later)| later.extend(median(looks)));
        bar.inc(1);
    }
    bar.finish_and_clear();
    let of_all = |what: &str, values: &[Vec<f64>], aim: f64| {
        let medians: Vec<f64> = values.iter().filter_map(|values| median(values)).collect();
        let row = Row::new(what, "s", &values[0]).aim(Aim::AtMost(aim));
        row.against_another(&medians)
    };
    rows.push(of_all("a look at a frame, the first, median of frames", &first, 1.0));
    rows.push(of_all("a look at a frame, later, median of frames", &later, 0.2));
    for (what, values, aim) in [("first", &first, 1.0), ("later", &later, 0.2)] {
        let slowest: Vec<f64> =
            values.iter().map(|values| values.iter().copied().fold(0.0, f64::max)).collect();
        let row = Row::new(format!("the slowest of these frames, {what}"), "s", &slowest[..1]);
        rows.push(row.aim(Aim::AtMost(aim)).against_another(&slowest));
    }
    rows.extend(open(&recording, &programs[0].cache, &looked_at)?);
    for question in QUESTIONS {
        let mut asked = vec![Vec::new(); programs.len()];
        for _ in 0..a.common.runs {
            uninterrupted()?;
            for (number, of) in programs.iter().enumerate() {
                asked[number].push(of.replay(&["--when", question])?);
            }
        }
        rows.push(of_all(&format!("when `{question}`"), &asked, 2.0));
    }
    let notes = [
        format!("looks: processes; {} frames, each looked at {} times later", a.looks, a.common.runs),
        "files are in the system's memory".to_owned(),
    ];
    finish("seeks", &rows, &notes, &a.common)
}

fn opened(recording: &Path, cache: &Path) -> Result<Source, Failure> {
    let elsewhere = Elsewhere { cache: Some(cache.to_path_buf()), ..Elsewhere::default() };
    Source::open(recording, &elsewhere, false, &())
}

/// What the recording takes.
fn recorded(recording: &Path, seconds: f64, name: &str) -> Result<Vec<Row>, Failure> {
    let TraceStat { file_bytes, order_bytes, hash_bytes, pop_bytes, deliveries, .. } =
        open_trace(recording)?.stat();
    let light = std::fs::metadata(light_beside(recording)).map_or(0, |file| file.len());
    let told = (order_bytes + hash_bytes + pop_bytes) as f64;
    Ok(vec![
        Row::new(format!("{name}: the log"), "kB/s", &[file_bytes as f64 / 1e3 / seconds])
            .aim(Aim::AtMost(20.0)),
        Row::new("order and hashes", "bytes/message", &[told / deliveries as f64]).aim(Aim::AtMost(1.5)),
        Row::new("maps of the light", "MB", &[light as f64 / 1e6]),
    ])
}

/// Looks at frames of a recording that stands open.
fn open(recording: &Path, cache: &Path, frames: &[u32]) -> Result<Vec<Row>, Failure> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut player = Player::new(opened(recording, cache)?, threads)?;
    let (mut missed, mut looks) = (0_u32, Vec::new());
    for frame in frames {
        uninterrupted()?;
        let (ms, picture) = timed(|| {
            player.go_to(*frame);
            player.picture()
        });
        looks.push(ms * 1e-3);
        missed += u32::from(picture.is_none() || player.shown().frame != Some(*frame));
    }
    if missed > 0 {
        return Err(Failure::Check(format!("{missed} frames are not shown")));
    }
    let row = Row::new("a frame of a recording that stands open, later", "s", &looks);
    Ok(vec![row.aim(Aim::AtMost(0.2))])
}

/// Beside another build.
trait AgainstAnother {
    /// The second of these values is another build's, where there is one.
    fn against_another(self, values: &[f64]) -> Self;
}

impl AgainstAnother for Row {
    fn against_another(self, values: &[f64]) -> Self {
        match values.get(1) {
            Some(other) => self.against("before", Some(*other)),
            None => self,
        }
    }
}
