//! Running the program and looking at what it leaves.

#[cfg(feature = "serve")]
pub mod browser;
pub mod recording;

use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use foveal::image::Map2d;
use foveal_engine::files::read_picture;
use glam::Vec3;
use serde_json::Value;

/// A bake that takes a moment: what the illumination is matters to no test here, only that it is the same.
pub const CHEAP_BAKE: &str = "--particles 20000 --error 20% --texels 8192";

/// No command may take longer, however busy the machine.
const PATIENCE: Duration = Duration::from_secs(300);

/// Root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Sidecar of a bundled scene.
pub fn scene(name: &str) -> PathBuf {
    root().join("scenes").join(name).join(format!("{name}.toml"))
}

/// The folder of this run. It outlives the run, since nothing runs after the last test; the next run removes it.
fn run_folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("program");
        for old in fs::read_dir(&all).into_iter().flatten().flatten() {
            if !Path::new("/proc").join(old.file_name()).exists() {
                let _ = fs::remove_dir_all(old.path());
            }
        }
        let own = all.join(std::process::id().to_string());
        fs::create_dir_all(&own).expect("a folder for the tests' files");
        own
    })
}

/// A new folder whose name begins with `what`.
pub fn folder(what: &str) -> PathBuf {
    static MADE: AtomicUsize = AtomicUsize::new(0);
    let path = run_folder().join(format!("{what}-{}", MADE.fetch_add(1, Ordering::Relaxed)));
    fs::create_dir_all(&path).expect("a folder");
    path
}

/// A command line of the program.
pub struct Foveal {
    command: Command,
    line: String,
    folder: PathBuf,
    /// What it reads.
    input: Option<PathBuf>,
}

/// How it ended.
pub struct Ended {
    /// Exit code; `None` after a signal.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
    line: String,
}

/// A program that still runs.
pub struct Running {
    child: Child,
    line: String,
    folder: PathBuf,
}

impl Foveal {
    /// `words` are split at blanks; what may hold blanks is given by [`Self::arg`].
    pub fn new(words: &str) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_foveal"));
        command
            .args(words.split_whitespace())
            .env("FOVEAL_CACHE", run_folder().join("cache"))
            .env("NO_COLOR", "1")
            .env_remove("FOVEAL_LOG");
        Self { command, line: format!("foveal {words}"), folder: folder("output"), input: None }
    }

    /// One more argument.
    pub fn arg(mut self, argument: impl AsRef<OsStr>) -> Self {
        self.line += &format!(" {}", argument.as_ref().display());
        self.command.arg(argument);
        self
    }

    /// In this folder.
    pub fn inside(mut self, folder: &Path) -> Self {
        self.command.current_dir(folder);
        self
    }

    /// In another environment.
    pub fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.command.env(name, value);
        self
    }

    /// Without a variable of the environment.
    #[cfg(feature = "window")]
    pub fn without(mut self, name: &str) -> Self {
        self.command.env_remove(name);
        self
    }

    /// With this to read.
    pub fn input(mut self, text: &str) -> Self {
        let file = self.folder.join("in");
        fs::write(&file, text).expect("a file");
        self.input = Some(file);
        self
    }

    /// Starts it. Its output goes to files, so that it never waits for a reader.
    pub fn start(mut self) -> Running {
        let file = |name| File::create(self.folder.join(name)).expect("a file");
        let input = self.input.map_or_else(Stdio::null, |file| File::open(file).expect("a file").into());
        self.command.stdin(input).stdout(file("out")).stderr(file("err"));
        let child = self.command.spawn().expect("the program starts");
        Running { child, line: self.line, folder: self.folder }
    }

    /// Runs it to its end.
    pub fn run(self) -> Ended {
        self.start().wait()
    }

    /// Runs it, which must succeed.
    pub fn ok(self) -> Ended {
        let ended = self.run();
        assert_eq!(ended.code, Some(0), "{}\n{}", ended.line, ended.err);
        ended
    }

    /// Runs it with `--json`, which must succeed and print one document and nothing else.
    pub fn json(self) -> Value {
        self.arg("--json").ok().json()
    }

    /// Runs it; it must end with this code, say why in words that hold each of `told`, and print no result.
    pub fn fails(self, code: i32, told: &[&str]) -> Ended {
        let ended = self.run();
        assert_eq!(ended.code, Some(code), "{}\n{}", ended.line, ended.err);
        for word in told {
            assert!(ended.err.contains(word), "{}\ndoes not say \"{word}\":\n{}", ended.line, ended.err);
        }
        assert!(!ended.err.contains("panicked"), "{}\n{}", ended.line, ended.err);
        assert_eq!(ended.out, "", "{}", ended.line);
        ended
    }
}

impl Running {
    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// What it has said on standard error so far.
    pub fn said(&self) -> String {
        fs::read_to_string(self.folder.join("err")).unwrap_or_default()
    }

    /// What it has printed so far.
    #[cfg(feature = "serve")]
    pub fn printed(&self) -> String {
        fs::read_to_string(self.folder.join("out")).unwrap_or_default()
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("a child").is_none()
    }

    /// Ends it at once, as no program can prevent.
    pub fn kill(mut self) -> Ended {
        let _ = self.child.kill();
        self.wait()
    }

    /// Waits for its end.
    pub fn wait(mut self) -> Ended {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                break status;
            }
            if start.elapsed() > PATIENCE {
                let _ = self.child.kill();
                panic!("{}: no end after {} s", self.line, PATIENCE.as_secs());
            }
            std::thread::sleep(Duration::from_millis(3));
        };
        let text = |name| {
            let bytes = fs::read(self.folder.join(name)).expect("its output");
            String::from_utf8_lossy(&bytes).into_owned()
        };
        Ended { code: status.code(), out: text("out"), err: text("err"), line: self.line.clone() }
    }
}

/// A test that fails leaves nothing behind that runs on.
impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Ended {
    /// Its standard output as the one JSON document it must be.
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{}: {e}\n{}", self.line, self.out))
    }
}

/// A picture file in linear RGB.
pub fn picture(path: &Path) -> Map2d<Vec3> {
    read_picture(path).unwrap_or_else(|e| panic!("{e}"))
}

/// Fails unless both pictures have the same bits everywhere; says where they part.
pub fn assert_same_bits(found: &Map2d<Vec3>, expected: &Map2d<Vec3>, what: &str) {
    assert_eq!((found.width(), found.height()), (expected.width(), expected.height()), "{what}");
    let bits = |v: &Vec3| v.to_array().map(f32::to_bits);
    let differing: Vec<usize> =
        (0..found.data().len()).filter(|&i| bits(&found.data()[i]) != bits(&expected.data()[i])).collect();
    if let Some(&first) = differing.first() {
        let (x, y) = (first % found.width(), first / found.width());
        panic!(
            "{what}: {} pixels differ, the first at ({x}, {y}): {} instead of {}",
            differing.len(),
            found.data()[first],
            expected.data()[first]
        );
    }
}
