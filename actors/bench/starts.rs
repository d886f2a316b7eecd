//! Starts as a user has them: a process with nothing kept, and the next one, until their first lit picture is written, and how
//! long they take to end then.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use foveal_engine::failure::Failure;
use foveal_terminal::arguments::Size;
use foveal_terminal::table::{Aim, Row, median};

/// A scene of more triangles has no aim.
const TRIANGLES: usize = 415_000;
/// A process that has not ended by then hangs.
const LONGEST: Duration = Duration::from_secs(300);
/// Between two looks whether the picture is there.
const LOOK: Duration = Duration::from_millis(1);
/// What is measured of a start, with its aim in seconds when nothing was kept and when something was.
const MEASURED: [(&str, [f64; 2]); 2] =
    [("process to its first lit picture", [0.6, 0.3]), ("end of the process after it", [0.2, 0.2])];
/// Which start it was.
const STARTS: [&str; 2] = ["nothing kept", "second start"];

/// One start, seconds.
struct Start {
    /// From the process's start until its picture is written.
    picture: f64,
    /// From then until it has ended.
    end: f64,
}

/// A program that is started, with a folder of its own.
struct Starts<'a> {
    program: &'a Path,
    folder: PathBuf,
    size: Size,
}

impl Starts<'_> {
    /// A walk of one frame through a scene, with what starts before it kept.
    fn start(&self, scene: &Path) -> Result<Start, Failure> {
        let wrong = |what: &str| Failure::Check(format!("{}: {what}", self.program.display()));
        let io = |e: std::io::Error| wrong(&e.to_string());
        let out = self.folder.join("out");
        let picture = out.join("frame-0000.png");
        if out.exists() {
            fs::remove_dir_all(&out).map_err(io)?;
        }
        let began = Instant::now();
        let mut process = Command::new(self.program)
            .args([
                "-q",
                "walk",
                "--frames",
                "1",
                "--size",
                &format!("{}x{}", self.size.width, self.size.height),
            ])
            .args([Path::new("--cache"), &self.folder.join("cache"), Path::new("--out"), &out, scene])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .map_err(io)?;
        let mut written = None;
        loop {
            if written.is_none() && picture.exists() {
                written = Some(began.elapsed());
            }
            if let Some(status) = process.try_wait().map_err(io)? {
                let ended = began.elapsed();
                let written = written.or_else(|| picture.exists().then_some(ended));
                return match written.filter(|_| status.success()) {
                    Some(at) => Ok(Start { picture: at.as_secs_f64(), end: (ended - at).as_secs_f64() }),
                    None => Err(wrong(&format!("a walk of one frame ended with {status}"))),
                };
            }
            if began.elapsed() > LONGEST {
                let _ = process.kill();
                return Err(wrong("a walk of one frame does not end"));
            }
            std::thread::sleep(LOOK);
        }
    }

    /// The first start and the second.
    fn both(&self, scene: &Path) -> Result<[Start; 2], Failure> {
        let _ = fs::remove_dir_all(self.folder.join("cache"));
        Ok([self.start(scene)?, self.start(scene)?])
    }
}

/// Rows of a scene's starts, `runs` of each, and of another build's in turn with these.
pub fn rows(
    (scene, name, triangles): (&Path, &str, usize),
    size: Size,
    runs: u32,
    before: Option<&Path>,
) -> Result<Vec<Row>, Failure> {
    let environment = |e: std::io::Error| Failure::Environment(format!("starts cannot be measured: {e}"));
    let own = std::env::current_exe().map_err(environment)?;
    let folder = tempfile::tempdir().map_err(environment)?;
    let programs: Vec<Starts<'_>> = [Some(own.as_path()), before]
        .into_iter()
        .flatten()
        .enumerate()
        .map(|(i, program)| Starts { program, folder: folder.path().join(i.to_string()), size })
        .collect();
    // By program, start and what is measured.
    let mut found = vec![[[(); 2]; 2].map(|row| row.map(|()| Vec::new())); programs.len()];
    for _ in 0..runs.max(1) {
        for (program, found) in programs.iter().zip(&mut found) {
            for (start, found) in program.both(scene)?.into_iter().zip(found) {
                found[0].push(start.picture);
                found[1].push(start.end);
            }
        }
    }
    let mut rows = Vec::new();
    for (start, of_start) in STARTS.iter().enumerate() {
        for (part, (what, aims)) in MEASURED.iter().enumerate() {
            let row = Row::new(format!("{name}, {of_start}: {what}"), "s", &found[0][start][part]);
            let row = match found.get(1) {
                Some(other) => row.against("before", median(&other[start][part])),
                None => row,
            };
            rows.push(if triangles <= TRIANGLES { row.aim(Aim::AtMost(aims[start])) } else { row });
        }
    }
    Ok(rows)
}
