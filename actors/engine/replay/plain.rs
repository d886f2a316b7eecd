//! The log of a recording in the cache folder, as it is read fastest: what it is coded with takes a microsecond for a byte,
//! which every look at ten minutes would wait for.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use atomic_write_file::AtomicWriteFile;
use foveal_runtime::Trace;

use super::index::make_room_beside;
use crate::failure::Failure;
use crate::opened::cache_folder;
use crate::recording::{checked_trace, open_trace};

/// What such a file is called.
pub(super) const PLAIN: &str = "fvplain";
/// A log that takes so long to read is kept.
const WORTH: Duration = Duration::from_millis(20);

/// Where what is made of a recording is kept: its name is what is in it.
pub(super) fn kept_as(trace: &Path, cache: Option<&Path>) -> Option<PathBuf> {
    let bytes = std::fs::read(trace).ok()?;
    Some(cache_folder(cache)?.join(&blake3::hash(&bytes).to_hex()[..32]))
}

/// Reads a recording, or what was kept of it.
///
/// # Errors
/// As [`open_trace`].
pub(super) fn open(path: &Path, cache: Option<&Path>) -> Result<Trace, Failure> {
    let kept = kept_as(path, cache).map(|kept| kept.with_extension(PLAIN));
    let Some(kept) = kept else { return open_trace(path) };
    if let Some(trace) = Trace::open(&kept).ok().filter(Trace::complete) {
        // Used: it goes later.
        let _ =
            File::options().append(true).open(&kept).and_then(|file| file.set_modified(SystemTime::now()));
        return Ok(trace);
    }
    let begun = Instant::now();
    let mut plain = Vec::new();
    let trace = checked_trace(path, Trace::open_plain(path, &mut plain))?;
    // What ends early may go on, and is told of each time.
    if trace.complete() && begun.elapsed() >= WORTH {
        // Without it the next one takes as long.
        let _ = keep(&kept, &plain);
    }
    Ok(trace)
}

fn keep(file: &Path, plain: &[u8]) -> std::io::Result<()> {
    use std::io::Write;
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let mut into = AtomicWriteFile::open(file)?;
    into.write_all(plain)?;
    into.commit()?;
    make_room_beside(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is kept is the same recording, and counts only where it is whole.
    #[test]
    fn a_kept_log_is_the_recording() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/gallery.fvl");
        let mut plain = Vec::new();
        let trace = Trace::open_plain(&path, &mut plain).expect("a recording");
        let kept = kept_as(&path, Some(folder.path())).expect("a name").with_extension(PLAIN);
        keep(&kept, &plain).expect("kept");
        let again = open(&path, Some(folder.path())).expect("what was kept");
        assert!(again.complete() && again.whole_bytes() == plain.len() as u64, "it was read from there");
        assert_eq!(again.header().nodes.len(), trace.header().nodes.len());
        for actor in (0..trace.header().nodes.len() as u32).map(foveal_runtime::ActorId) {
            assert_eq!(again.deliveries(actor), trace.deliveries(actor));
            assert!(again.events(actor).eq(trace.events(actor)));
        }
        std::fs::write(&kept, &plain[..plain.len() - 9]).expect("written");
        let read = open(&path, Some(folder.path())).expect("the recording");
        assert_eq!(read.whole_bytes(), trace.whole_bytes(), "what is cut is not believed");
    }
}
