//! Frames written as PNG beside the walk: a thread of its own, so that no frame waits for a file.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

use super::failure::Failure;
use super::output::{png_bytes, write_atomic};
use crate::message::FrameSnapshot;

/// Pictures that may wait; then the walk waits for the disk rather than for memory.
const WAITING_MAX: usize = 64;

/// Writes pictures into a folder.
pub struct PictureWriter {
    queue: SyncSender<(String, Arc<FrameSnapshot>)>,
    thread: JoinHandle<Result<(), Failure>>,
}

impl PictureWriter {
    /// A writer into `folder`, which exists.
    pub fn new(folder: PathBuf) -> Self {
        let (queue, waiting) = sync_channel::<(String, Arc<FrameSnapshot>)>(WAITING_MAX);
        let thread = std::thread::spawn(move || {
            for (name, snapshot) in waiting {
                let picture = &snapshot.rgb8;
                let (w, h) = (picture.width() as u32, picture.height() as u32);
                write_atomic(&folder.join(name), &png_bytes(w, h, picture.data().as_flattened())?)?;
            }
            Ok(())
        });
        Self { queue, thread }
    }

    /// Hands over one picture.
    pub fn write(&self, name: &str, snapshot: Arc<FrameSnapshot>) -> Result<(), Failure> {
        // Where the writer has ended, `finish` says why.
        let _ = self.queue.send((name.to_owned(), snapshot));
        Ok(())
    }

    /// Waits until all are written.
    pub fn finish(self) -> Result<(), Failure> {
        drop(self.queue);
        self.thread.join().unwrap_or_else(|_| Err(Failure::Check("the writer of pictures failed".into())))
    }
}
