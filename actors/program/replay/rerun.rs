//! Files for the viewer of rerun are written by a program of its own, `foveal-rerun`: their format brings along more crates
//! than this one has.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Command;

use foveal_engine::Failure;
use foveal_terminal::light::ElsewhereArguments;

/// The program's name.
const PROGRAM: &str = "foveal-rerun";

/// The program beside this one, or else by its name wherever programs lie.
fn program() -> PathBuf {
    let name = format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX);
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(&name));
    beside.filter(|file| file.is_file()).unwrap_or_else(|| name.into())
}

/// Has a recording written into a file.
///
/// # Errors
/// If there is no such program, or what it says.
pub(super) fn write(trace: &Path, out: &Path, elsewhere: &ElsewhereArguments) -> Result<(), Failure> {
    let run = Command::new(program()).arg(trace).arg(out).args(elsewhere.words()).output();
    let ended = run.map_err(|e| {
        Failure::Environment(match e.kind() {
            ErrorKind::NotFound => format!(
                "--export rerun: {PROGRAM} is neither beside this program nor on the PATH; `cargo install --path rerun` builds it"
            ),
            _ => format!("{PROGRAM}: {e}"),
        })
    })?;
    if ended.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&ended.stderr);
    let said = said.trim().trim_start_matches(&format!("{PROGRAM}: ")).to_owned();
    Err(match ended.status.code() {
        Some(1) => Failure::Check(said),
        Some(2) => Failure::Usage(said),
        Some(3) => Failure::Input(said),
        Some(130) | None => Failure::Interrupted(said),
        _ => Failure::Environment(said),
    })
}
