//! Frames written as PNG beside the walk: a thread of its own, so that no frame waits for a file.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::Duration;

use crossbeam_queue::ArrayQueue;

use foveal_actors::message::FrameSnapshot;
use foveal_engine::failure::Failure;
use foveal_engine::files::{png_bytes, write_atomic};

/// Pictures that may wait; then the walk waits for the disk rather than for memory.
const WAITING_MAX: usize = 64;

/// What the walk and the writer share.
struct Shared {
    waiting: ArrayQueue<(String, Arc<FrameSnapshot>)>,
    /// No more pictures come.
    closed: AtomicBool,
    /// The writer has ended: with everything written, or at the first file that could not be.
    ended: AtomicBool,
    /// Who waits for room.
    walk: Thread,
}

/// Writes pictures into a folder.
pub struct PictureWriter {
    shared: Arc<Shared>,
    thread: JoinHandle<Result<(), Failure>>,
}

impl PictureWriter {
    /// A writer into `folder`, which exists; the thread that makes it is the one that writes.
    pub fn new(folder: PathBuf) -> Self {
        let shared = Arc::new(Shared {
            waiting: ArrayQueue::new(WAITING_MAX),
            closed: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            walk: std::thread::current(),
        });
        let writer = Arc::clone(&shared);
        let thread = std::thread::spawn(move || {
            let written = write_all(&writer, &folder);
            writer.ended.store(true, Ordering::Release);
            writer.walk.unpark();
            written
        });
        Self { shared, thread }
    }

    /// Hands over one picture.
    pub fn write(&self, name: &str, snapshot: Arc<FrameSnapshot>) -> Result<(), Failure> {
        let mut picture = (name.to_owned(), snapshot);
        while let Err(back) = self.shared.waiting.push(picture) {
            // Where the writer has ended, `finish` says why.
            if self.shared.ended.load(Ordering::Acquire) {
                return Ok(());
            }
            picture = back;
            std::thread::park_timeout(Duration::from_millis(10));
        }
        self.thread.thread().unpark();
        Ok(())
    }

    /// Waits until all are written.
    pub fn finish(self) -> Result<(), Failure> {
        self.shared.closed.store(true, Ordering::Release);
        self.thread.thread().unpark();
        self.thread.join().unwrap_or_else(|_| Err(Failure::Check("the writer of pictures failed".into())))
    }
}

fn write_all(shared: &Shared, folder: &std::path::Path) -> Result<(), Failure> {
    loop {
        // Read before the queue is found empty: what is handed over before the end is written.
        let closed = shared.closed.load(Ordering::Acquire);
        while let Some((name, snapshot)) = shared.waiting.pop() {
            shared.walk.unpark();
            let picture = &snapshot.rgb8;
            let (w, h) = (picture.width() as u32, picture.height() as u32);
            write_atomic(&folder.join(name), &png_bytes(w, h, picture.data().as_flattened())?)?;
        }
        if closed {
            return Ok(());
        }
        std::thread::park();
    }
}
