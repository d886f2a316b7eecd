//! Writing a recording while the system runs: actors hand over chunks, one thread compresses and writes them.
//!
//! A turn never waits for the disk. If the writer cannot keep up or the disk is full, recording stops with a notice
//! and the run goes on.

use crossbeam_queue::ArrayQueue;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use super::coder::{CODED_BYTES_MAX, Model};
use super::format::{
    CODED, End, Header, KIND_CHUNKS, KIND_END, KIND_HEADER, MAGIC, SEGMENT_BYTES_MAX, SEGMENT_HEAD, VERSION,
    put_bytes,
};
use crate::scheduler::ThreadCx;
use crate::scheduler::link::Link;
use crate::scheduler::signals::signal;

/// Chunks that may wait for the writer.
const CHUNKS_MAX: usize = 4096;
/// Where more wait, segments are compressed by what is fastest.
const CHUNKS_CODED: usize = 64;
/// A segment is closed at this size…
const SEGMENT_BYTES: usize = 256 << 10;
/// …or after so long, which bounds what a killed process loses.
const PERIOD: Duration = Duration::from_millis(100);
/// Bytes one actor may hold back while the writer is behind.
pub(crate) const BACKLOG_BYTES_MAX: usize = 16 << 20;

/// How a recording is doing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RecordingStatus {
    /// This run is not recorded.
    Off,
    /// It is, and so many bytes are written.
    On {
        /// Bytes in the file so far.
        bytes: u64,
    },
    /// It was until something went wrong; what is written replays.
    Stopped {
        /// What went wrong.
        reason: String,
    },
}

/// Shared between the actors and the writer.
pub(crate) struct LogQueue {
    chunks: ArrayQueue<Vec<u8>>,
    stopped: AtomicBool,
    closing: AtomicBool,
    /// Grows once a period; an actor that sees a new value hands over what it has.
    pub(crate) period: AtomicU32,
    bytes: AtomicU64,
    notice: ArrayQueue<String>,
}

impl LogQueue {
    pub(crate) fn new() -> Self {
        Self {
            chunks: ArrayQueue::new(CHUNKS_MAX),
            stopped: AtomicBool::new(false),
            closing: AtomicBool::new(false),
            period: AtomicU32::new(0),
            bytes: AtomicU64::new(0),
            notice: ArrayQueue::new(1),
        }
    }

    /// Hands a chunk to the writer; it comes back if the writer is behind.
    pub(crate) fn push(&self, chunk: Vec<u8>) -> Result<(), Vec<u8>> {
        self.chunks.push(chunk)
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Ends the recording early, with a reason for the user.
    pub(crate) fn stop(&self, reason: String) {
        if !self.stopped.swap(true, Ordering::SeqCst) {
            tracing::warn!("recording stopped: {reason}");
            let _ = self.notice.push(reason);
        }
    }

    pub(crate) fn status(&self) -> RecordingStatus {
        if self.is_stopped() {
            let reason = self.notice.pop().unwrap_or_default();
            let _ = self.notice.push(reason.clone());
            RecordingStatus::Stopped { reason }
        } else {
            RecordingStatus::On { bytes: self.bytes.load(Ordering::Relaxed) }
        }
    }
}

/// The writer thread of one recording.
pub(crate) struct Writer {
    queue: Arc<LogQueue>,
    thread: std::thread::JoinHandle<Box<dyn Write + Send>>,
}

impl Writer {
    /// Writes the header at once, then starts the thread. Where it `asks`, it wakes actors that have something for it; a
    /// simulation's schedule must not depend on that thread, so there they hand over at the end of their turns alone.
    pub(crate) fn start(
        mut sink: Box<dyn Write + Send>,
        header: &Header,
        queue: &Arc<LogQueue>,
        links: Vec<Arc<Link>>,
        asks: bool,
    ) -> std::io::Result<Self> {
        let mut head = MAGIC.to_vec();
        head.extend_from_slice(&VERSION.to_le_bytes());
        head.extend_from_slice(&segment(&encoded(KIND_HEADER, header)?));
        sink.write_all(&head)?;
        queue.bytes.store(head.len() as u64, Ordering::Relaxed);
        let shared = Arc::clone(queue);
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || write(sink, &shared, if asks { &links } else { &[] }))?;
        Ok(Self { queue: Arc::clone(queue), thread })
    }

    /// It ended before it was told to.
    pub(crate) fn is_over(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what is left and, if every actor's log is complete, the end.
    pub(crate) fn finish(self, totals: Option<Vec<(u64, u64)>>) {
        self.queue.closing.store(true, Ordering::SeqCst);
        self.thread.thread().unpark();
        let Ok(mut sink) = self.thread.join() else {
            return self.queue.stop("whatever the recording is written to panicked".to_owned());
        };
        if let Some(totals) = totals
            && !self.queue.is_stopped()
        {
            let written = encoded(KIND_END, &End { totals }).and_then(|body| sink.write_all(&segment(&body)));
            if let Err(error) = written.and_then(|()| sink.flush()) {
                self.queue.stop(error.to_string());
            }
        }
    }
}

fn encoded(kind: u8, content: &impl serde::Serialize) -> std::io::Result<Vec<u8>> {
    postcard::to_extend(content, vec![kind]).map_err(std::io::Error::other)
}

/// Compresses and frames one segment.
pub(crate) fn segment(body: &[u8]) -> Vec<u8> {
    framed(body.len() as u32, &lz4_flex::block::compress(body))
}

fn framed(raw: u32, block: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(SEGMENT_HEAD + block.len());
    bytes.extend_from_slice(&raw.to_le_bytes());
    bytes.extend_from_slice(&(block.len() as u32).to_le_bytes());
    let mut checksum = crc32fast::Hasher::new();
    checksum.update(&bytes);
    checksum.update(block);
    bytes.extend_from_slice(&checksum.finalize().to_le_bytes());
    bytes.extend_from_slice(block);
    bytes
}

fn write(mut sink: Box<dyn Write + Send>, queue: &LogQueue, links: &[Arc<Link>]) -> Box<dyn Write + Send> {
    let thread = ThreadCx::outside();
    let mut model: Option<Model> = None;
    loop {
        let closing = queue.closing.load(Ordering::SeqCst);
        queue.period.fetch_add(1, Ordering::Relaxed);
        let waiting = |link: &&Arc<Link>| link.unflushed.load(Ordering::Relaxed);
        if !closing {
            links.iter().filter(waiting).for_each(|link| link.raise(signal::FLUSH, &thread));
        }
        loop {
            let mut body = vec![KIND_CHUNKS];
            while body.len() < SEGMENT_BYTES
                && let Some(chunk) = queue.chunks.pop()
            {
                put_bytes(&mut body, &chunk);
            }
            if body.len() == 1 {
                break;
            }
            // A chunk is at most one actor's backlog, and a segment at most one chunk more than its aim.
            if body.len() > SEGMENT_BYTES_MAX {
                queue.stop("one turn produced more than a segment can hold".into());
            }
            if queue.is_stopped() {
                continue;
            }
            // Coding takes longer than compression: who is behind has no time for it.
            let bytes = if queue.chunks.len() <= CHUNKS_CODED && body.len() <= CODED_BYTES_MAX {
                framed(body.len() as u32 | CODED, &model.get_or_insert_with(Model::new).encode(&body))
            } else {
                segment(&body)
            };
            match sink.write_all(&bytes).and_then(|()| sink.flush()) {
                Ok(()) => {
                    queue.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
                }
                Err(error) => queue.stop(error.to_string()),
            }
        }
        if closing {
            return sink;
        }
        std::thread::park_timeout(PERIOD);
    }
}
