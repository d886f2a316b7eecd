//! Reading a recording: everything is checked before it is used, and a damaged file is read up to the damage.

use std::fmt;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use super::format::{
    Cursor, End, Header, KIND_CHUNKS, KIND_END, KIND_HEADER, MAGIC, SEGMENT_BYTES_MAX, SEGMENT_HEAD, Symbol,
    VERSION, lane,
};
use super::walk::{ActorLog, Walk};
use crate::journal::Payload;
use crate::message::ActorId;

/// Decompressed bytes a recording may hold.
pub const TRACE_BYTES_MAX: u64 = 2 << 30;
/// Actors and ports a recording may name.
const NODES_MAX: usize = 1 << 20;

/// Why a file is no recording that can be used.
#[derive(Debug)]
pub enum TraceError {
    /// The file cannot be read.
    Io(std::io::Error),
    /// It does not begin as a recording does.
    NotARecording,
    /// It was written by another version of the format.
    Version {
        /// Version of the file.
        found: u16,
        /// The version this program reads.
        expected: u16,
    },
    /// Its header is damaged.
    Header {
        /// What is wrong.
        reason: String,
    },
}

impl fmt::Display for TraceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io(error) => write!(f, "cannot read the recording: {error}"),
            Self::NotARecording => f.write_str("this is no recording: it does not begin with FVLOG"),
            Self::Version { found, expected } => {
                write!(f, "the recording has format version {found}, this program reads version {expected}")
            }
            Self::Header { reason } => write!(f, "the recording's header is damaged: {reason}"),
        }
    }
}

impl std::error::Error for TraceError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            _ => None,
        }
    }
}

/// Where a recording stops being readable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Bytes from the start that are whole.
    pub offset: u64,
    /// What is wrong behind them.
    pub reason: String,
}

/// A recording in memory.
#[derive(Debug)]
pub struct Trace {
    header: Header,
    pub(crate) logs: Vec<Arc<ActorLog>>,
    end: Option<End>,
    cut: Option<Cut>,
    whole_bytes: u64,
    segments: u64,
}

/// Sizes of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceStat {
    /// Deliveries to all actors.
    pub deliveries: u64,
    /// Bytes of the file that are whole.
    pub file_bytes: u64,
    /// Segments.
    pub segments: u64,
    /// Bytes of the order of deliveries, before compression.
    pub order_bytes: u64,
    /// Bytes of payloads from outside, job pops and timers.
    pub external_bytes: u64,
    /// Of these, bytes of job pops.
    pub pop_bytes: u64,
    /// Bytes of clock readings, durations and marks.
    pub value_bytes: u64,
    /// Bytes of hashes.
    pub hash_bytes: u64,
    /// Bytes of rejections.
    pub rejected_bytes: u64,
}

impl Trace {
    /// Reads a file up to its first damage.
    pub fn open(path: &Path) -> Result<Self, TraceError> {
        let file = std::fs::File::open(path).map_err(TraceError::Io)?;
        Self::read(&mut std::io::BufReader::new(file))
    }

    /// Reads a recording from memory.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TraceError> {
        Self::read(&mut &*bytes)
    }

    fn read(source: &mut impl Read) -> Result<Self, TraceError> {
        let mut head = [0; 8];
        let length = fill(source, &mut head).map_err(TraceError::Io)?;
        if length < 6 || head[..6] != MAGIC {
            return Err(TraceError::NotARecording);
        }
        let found = u16::from_le_bytes([head[6], head[7]]);
        if length < 8 || found != VERSION {
            return Err(TraceError::Version { found, expected: VERSION });
        }
        let damaged = |reason: String| TraceError::Header { reason };
        let (bytes, body) = match read_segment(source) {
            Segment::Body(bytes, body) => (bytes, body),
            Segment::Nothing => return Err(damaged("it is missing".into())),
            Segment::Damaged(reason) => return Err(damaged(reason)),
        };
        if body.first() != Some(&KIND_HEADER) {
            return Err(damaged("the first segment is no header".into()));
        }
        let header: Header = postcard::from_bytes(&body[1..]).map_err(|error| damaged(error.to_string()))?;
        if header.nodes.len() > NODES_MAX {
            return Err(damaged(format!("it names {} actors", header.nodes.len())));
        }
        let mut trace =
            Self { logs: Vec::new(), end: None, cut: None, whole_bytes: 8 + bytes, segments: 1, header };
        let mut logs: Vec<(ActorLog, Walk)> = trace.header.nodes.iter().map(|_| Default::default()).collect();
        let mut total = 0_u64;
        loop {
            let (bytes, body) = match read_segment(source) {
                Segment::Body(bytes, body) => (bytes, body),
                Segment::Nothing => {
                    if trace.end.is_none() {
                        trace.cut(String::from("the recording ends without its end mark"));
                    }
                    break;
                }
                Segment::Damaged(reason) => {
                    trace.cut(reason);
                    break;
                }
            };
            total += body.len() as u64;
            let outcome = if trace.end.is_some() {
                Err("something follows the end".to_owned())
            } else if total > TRACE_BYTES_MAX {
                Err(format!("more than {TRACE_BYTES_MAX} bytes when unpacked"))
            } else {
                trace.segment(&body, &mut logs)
            };
            if let Err(reason) = outcome {
                trace.cut(reason);
                break;
            }
            trace.whole_bytes += bytes;
            trace.segments += 1;
        }
        trace.logs = logs.into_iter().map(|(log, _)| Arc::new(log)).collect();
        Ok(trace)
    }

    fn cut(&mut self, reason: String) {
        self.cut = Some(Cut { offset: self.whole_bytes, reason });
    }

    fn segment(&mut self, body: &[u8], logs: &mut [(ActorLog, Walk)]) -> Result<(), String> {
        match body.first() {
            Some(&KIND_CHUNKS) => {
                let mut cursor = Cursor::new(body, 1);
                let mut before = Vec::new();
                while !cursor.is_empty() {
                    let result = match cursor.bytes() {
                        Some(chunk) => append(chunk, &self.header, logs, &mut before),
                        None => Err("a chunk is longer than its segment".to_owned()),
                    };
                    if let Err(reason) = result {
                        // A segment counts as a whole or not at all.
                        for (actor, lengths) in before.into_iter().rev() {
                            undo(&mut logs[actor as usize], lengths);
                        }
                        return Err(reason);
                    }
                }
                Ok(())
            }
            Some(&KIND_END) => {
                let end: End = postcard::from_bytes(&body[1..]).map_err(|error| error.to_string())?;
                let found = logs.iter().map(|(log, _)| log.deliveries);
                if !end.totals.iter().map(|(deliveries, _)| *deliveries).eq(found) {
                    return Err("the end counts other deliveries than are recorded".into());
                }
                self.end = Some(end);
                Ok(())
            }
            Some(other) => Err(format!("a segment of unknown kind {other}")),
            None => Err("an empty segment".into()),
        }
    }

    /// What the recording says about itself.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Where the file stops being readable; `None` if it is whole.
    pub fn damage(&self) -> Option<&Cut> {
        self.cut.as_ref()
    }

    /// The run ended in order and all of it is here.
    pub fn complete(&self) -> bool {
        self.end.is_some() && self.cut.is_none()
    }

    /// Bytes of the file, from its start, that are whole: what is left when it is cut to its good part.
    pub fn whole_bytes(&self) -> u64 {
        self.whole_bytes
    }

    /// Deliveries recorded for one actor.
    pub fn deliveries(&self, actor: ActorId) -> u64 {
        self.logs.get(actor.0 as usize).map_or(0, |log| log.deliveries)
    }

    /// The chained hash of everything delivered to one actor, as far as it is recorded.
    pub fn chain(&self, actor: ActorId) -> u64 {
        self.logs.get(actor.0 as usize).map_or(0, |log| log.chain)
    }

    /// Identity of the actor or port with this name.
    pub fn find(&self, name: &str) -> Option<ActorId> {
        self.header.nodes.iter().position(|node| node.name == name).map(|index| ActorId(index as u32))
    }

    /// Sizes.
    pub fn stat(&self) -> TraceStat {
        let mut stat =
            TraceStat { file_bytes: self.whole_bytes, segments: self.segments, ..TraceStat::default() };
        for log in &self.logs {
            stat.deliveries += log.deliveries;
            stat.order_bytes += log.order.len() as u64;
            stat.external_bytes += log.external.len() as u64;
            stat.pop_bytes += self.pop_bytes(log);
            stat.value_bytes += log.values.len() as u64;
            stat.hash_bytes += log.hashes.len() as u64;
            stat.rejected_bytes += log.rejected.len() as u64;
        }
        stat
    }

    fn pop_bytes(&self, log: &ActorLog) -> u64 {
        let (mut walk, mut bytes, mut before) = (Walk::default(), 0, 0);
        while let Some(symbol) = walk.peek(log) {
            let Some((payload, external)) = walk.payload(log, symbol, self.is_port(symbol.from)) else {
                break;
            };
            walk.pass(payload, external);
            if let Payload::Job { .. } = payload {
                bytes += external - before;
            }
            before = external;
        }
        bytes as u64
    }

    pub(crate) fn is_port(&self, id: ActorId) -> bool {
        self.header.nodes.get(id.0 as usize).is_some_and(|node| node.class.is_none())
    }
}

/// Lengths of a log before a chunk: symbols, the five streams, deliveries, chain, and the validating walk.
type Lengths = ([usize; 6], u64, u64, Walk);

fn undo((log, walk): &mut (ActorLog, Walk), (lengths, deliveries, chain, before): Lengths) {
    log.symbols.truncate(lengths[0]);
    let streams = [&mut log.order, &mut log.external, &mut log.values, &mut log.hashes, &mut log.rejected];
    streams.into_iter().zip(&lengths[1..]).for_each(|(stream, length)| stream.truncate(*length));
    (log.deliveries, log.chain, *walk) = (deliveries, chain, before);
}

/// Adds a chunk to its actor's log after checking that all of it can be decoded.
fn append(
    chunk: &[u8],
    header: &Header,
    logs: &mut [(ActorLog, Walk)],
    undo_list: &mut Vec<(u32, Lengths)>,
) -> Result<(), String> {
    let short = || "a chunk ends early".to_owned();
    let mut cursor = Cursor::new(chunk, 0);
    let actor = cursor.number().ok_or_else(short)?;
    let index = usize::try_from(actor).ok().filter(|index| *index < logs.len());
    let Some((log, walk)) = index.and_then(|index| logs.get_mut(index)) else {
        return Err(format!("a chunk of actor {actor}, which the header does not name"));
    };
    let count = cursor.number().ok_or_else(short)?;
    let lengths = [
        log.symbols.len(),
        log.order.len(),
        log.external.len(),
        log.values.len(),
        log.hashes.len(),
        log.rejected.len(),
    ];
    undo_list.push((actor as u32, (lengths, log.deliveries, log.chain, walk.clone())));
    log.chain = cursor.u64().ok_or_else(short)?;
    for _ in 0..cursor.number().ok_or_else(short)? {
        let from = cursor.number().ok_or_else(short)?;
        let lane = cursor.byte().ok_or_else(short)?;
        if from >= header.nodes.len() as u64 || lane >= lane::END {
            return Err(format!("a delivery from {from} on lane {lane}, which do not exist"));
        }
        log.symbols.push(Symbol { from: ActorId(from as u32), lane });
    }
    let there = cursor.byte().ok_or_else(short)?;
    let streams = [&mut log.order, &mut log.external, &mut log.values, &mut log.hashes, &mut log.rejected];
    for (_, stream) in streams.into_iter().enumerate().filter(|(bit, _)| there >> bit & 1 == 1) {
        stream.extend_from_slice(cursor.bytes().ok_or_else(short)?);
    }
    if !cursor.is_empty() {
        return Err("a chunk is longer than its content".into());
    }
    log.deliveries = log.deliveries.checked_add(count).ok_or_else(|| "too many deliveries".to_owned())?;
    let valid = walk.validate(log, header, count);
    valid.ok_or_else(|| format!("the log of actor {actor} cannot be decoded"))
}

enum Segment {
    /// Bytes in the file, and the unpacked content.
    Body(u64, Vec<u8>),
    Nothing,
    Damaged(String),
}

fn read_segment(source: &mut impl Read) -> Segment {
    let mut head = [0; SEGMENT_HEAD];
    match fill(source, &mut head) {
        Ok(0) => return Segment::Nothing,
        Ok(SEGMENT_HEAD) => {}
        Ok(_) => return Segment::Damaged("the file ends inside a segment's head".into()),
        Err(error) => return Segment::Damaged(error.to_string()),
    }
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (raw, stored, checksum) = (word(0) as usize, word(4) as usize, word(8));
    // An lz4 block is at most a little longer than its content, and at most 255 times shorter.
    let stored_max = lz4_flex::block::get_maximum_output_size(raw.min(SEGMENT_BYTES_MAX));
    if raw > SEGMENT_BYTES_MAX || stored > stored_max || raw > stored.saturating_mul(255) + 64 {
        return Segment::Damaged(format!("a segment claims {stored} bytes for {raw}"));
    }
    let mut block = Vec::new();
    match source.take(stored as u64).read_to_end(&mut block) {
        Ok(read) if read == stored => {}
        Ok(_) => return Segment::Damaged("the file ends inside a segment".into()),
        Err(error) => return Segment::Damaged(error.to_string()),
    }
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&head[..8]);
    hasher.update(&block);
    if hasher.finalize() != checksum {
        return Segment::Damaged("a segment's checksum does not fit its content".into());
    }
    match lz4_flex::block::decompress(&block, raw) {
        Ok(body) if body.len() == raw => Segment::Body((SEGMENT_HEAD + stored) as u64, body),
        Ok(_) => Segment::Damaged("a segment unpacks to another length than it says".into()),
        Err(error) => Segment::Damaged(format!("a segment cannot be unpacked: {error}")),
    }
}

/// Reads until the buffer is full or the source ends; returns how much was read.
fn fill(source: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut length = 0;
    while length < buffer.len() {
        match source.read(&mut buffer[length..]) {
            Ok(0) => break,
            Ok(read) => length += read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(length)
}
