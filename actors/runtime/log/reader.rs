//! Reading a recording: everything is checked before it is used, and a damaged file is read up to the damage.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;

use super::coder::{CODED_BYTES_MAX, Model, Spent};
use super::format::{
    CHUNK_DELIVERIES_MAX, CODED, Cursor, End, FAINT_BITS, Header, KIND_CHUNKS, KIND_END, KIND_HEADER, MAGIC,
    Payload, SEGMENT_BYTES_MAX, SEGMENT_HEAD, STREAMS, Symbol, VERSION, VERSION_OLDEST, lane, stream,
};
use super::walk::{ActorLog, Walk};
use super::writer::segment;
use crate::message::ActorId;

/// Decompressed bytes a recording may hold.
pub const TRACE_BYTES_MAX: u64 = 2 << 30;

/// Why a file is no recording that can be used.
#[derive(Debug)]
pub enum TraceError {
    /// The file cannot be read.
    Io(io::Error),
    /// It does not begin as a recording does.
    NotARecording,
    /// It was written by another version of the format.
    Version {
        /// Version of the file.
        found: u16,
        /// The version this program reads.
        expected: u16,
        /// What the file says of its writer, if it does.
        writer: Option<String>,
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
            Self::Version { found, expected, writer } => {
                let by = writer.as_ref().map_or_else(String::new, |writer| format!(", written by {writer}"));
                write!(
                    f,
                    "the recording has format version {found}{by}; this program reads version {expected} and {VERSION_OLDEST}: "
                )?;
                f.write_str("replay it with the program that wrote it, or record anew")
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
    /// What coded segments spent on what is in them.
    spent: Option<Spent>,
}

/// Sizes of a recording: of each stream what it takes in the file, and before compression where that is lz4's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceStat {
    /// Deliveries to all actors.
    pub deliveries: u64,
    /// Bytes of the file that are whole.
    pub file_bytes: u64,
    /// Segments.
    pub segments: u64,
    /// Bytes of the order of deliveries.
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
        Self::read(&mut io::BufReader::new(file), None)
    }

    /// Reads a recording, and makes the same one that takes more room and is read in less time: nothing of it is coded,
    /// only compressed.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_plain(path: &Path, plain: &mut Vec<u8>) -> Result<Self, TraceError> {
        let file = std::fs::File::open(path).map_err(TraceError::Io)?;
        Self::read(&mut io::BufReader::new(file), Some(plain))
    }

    /// Reads a recording from memory.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, TraceError> {
        Self::read(&mut &*bytes, None)
    }

    /// What a file says about itself; the rest of it is not read.
    pub fn header_of(path: &Path) -> Result<Header, TraceError> {
        let file = std::fs::File::open(path).map_err(TraceError::Io)?;
        let (_, header) = begin(&mut io::BufReader::new(file))?;
        Ok(header)
    }

    /// The segments of a recording behind its header, unpacked, up to the first damage: for whoever takes one apart.
    ///
    /// # Errors
    /// If it is no recording, another version's, or its header is damaged.
    pub fn segments(bytes: &[u8]) -> Result<Vec<Vec<u8>>, TraceError> {
        let mut source = bytes;
        begin(&mut source)?;
        let (mut model, mut segments) = (None, Vec::new());
        while let Segment::Body(_, body) = read_segment(&mut source, &mut model) {
            segments.push(body);
        }
        Ok(segments)
    }

    fn read(source: &mut impl Read, mut plain: Option<&mut Vec<u8>>) -> Result<Self, TraceError> {
        let (bytes, header) = match plain.as_deref_mut() {
            Some(plain) => begin(&mut Passed { source, passed: plain })?,
            None => begin(source)?,
        };
        let mut model = None;
        let mut trace = Self {
            logs: Vec::new(),
            end: None,
            cut: None,
            whole_bytes: 8 + bytes,
            segments: 1,
            spent: None,
            header,
        };
        let mut logs: Vec<Option<Box<Reading>>> = trace.header.nodes.iter().map(|_| None).collect();
        let mut total = 0_u64;
        loop {
            let (bytes, body) = match read_segment(source, &mut model) {
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
            if let Some(plain) = plain.as_deref_mut() {
                plain.extend_from_slice(&segment(&body));
            }
            trace.whole_bytes += bytes;
            trace.segments += 1;
        }
        let empty = Arc::new(ActorLog::default());
        let kept =
            |read: Option<Box<Reading>>| read.map_or_else(|| Arc::clone(&empty), |read| Arc::new(read.log));
        trace.logs = logs.into_iter().map(kept).collect();
        trace.spent = model.map(|model| model.spent);
        Ok(trace)
    }

    fn cut(&mut self, reason: String) {
        self.cut = Some(Cut { offset: self.whole_bytes, reason });
    }

    fn segment(&mut self, body: &[u8], logs: &mut [Option<Box<Reading>>]) -> Result<(), String> {
        match body.first() {
            Some(&KIND_CHUNKS) => {
                let mut cursor = Cursor::new(body, 1);
                let mut before = BTreeMap::new();
                while !cursor.is_empty() {
                    let result = match cursor.bytes() {
                        Some(chunk) => append(chunk, &self.header, logs, &mut before),
                        None => Err("a chunk is longer than its segment".to_owned()),
                    };
                    if let Err(reason) = result {
                        // A segment counts as a whole or not at all.
                        for (actor, lengths) in before {
                            logs[actor].as_mut().into_iter().for_each(|read| read.undo(&lengths));
                        }
                        return Err(reason);
                    }
                }
                Ok(())
            }
            Some(&KIND_END) => {
                let end: End = postcard::from_bytes(&body[1..]).map_err(|error| error.to_string())?;
                let found = logs.iter().map(|read| read.as_ref().map_or(0, |read| read.log.deliveries));
                if !end.totals.iter().map(|(deliveries, _)| *deliveries).eq(found) {
                    return Err("the end counts other deliveries than are recorded".into());
                }
                for (read, (_, chain)) in logs.iter_mut().zip(&end.totals) {
                    read.as_mut().into_iter().for_each(|read| read.log.chain = *chain);
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
        let mut plain = [0_u64; STREAMS];
        for log in &self.logs {
            stat.deliveries += log.deliveries;
            for (sum, stream) in plain.iter_mut().zip(log.plain()) {
                *sum += stream as u64;
            }
        }
        let mut takes = plain.map(|bytes| bytes as f64);
        // As it was recorded where nothing was coded: a bit, and four of them, in a byte each.
        takes[stream::SAID] /= 8.0;
        takes[stream::FAINT] *= f64::from(FAINT_BITS) / 8.0;
        if let Some(spent) = &self.spent {
            let (coded, all) = (spent.coded, plain);
            for (which, takes) in takes.iter_mut().enumerate() {
                let bits: u64 = spent.streams.iter().map(|streams| streams[which]).sum();
                let left = all[which].saturating_sub(coded[which]) as f64 / all[which].max(1) as f64;
                *takes = *takes * left + bits as f64 / f64::from(8 << 16);
            }
        }
        // Job pops share their stream with what else comes from outside.
        let pops = plain[stream::EXTERNAL].max(1) as f64;
        let pops = self.logs.iter().map(|log| self.pop_bytes(log)).sum::<u64>() as f64 / pops;
        let whole = |which: usize| takes[which].round() as u64;
        stat.order_bytes = whole(stream::ORDER);
        stat.external_bytes = whole(stream::EXTERNAL);
        stat.pop_bytes = (takes[stream::EXTERNAL] * pops).round() as u64;
        stat.value_bytes = whole(stream::VALUES);
        stat.hash_bytes = (takes[stream::HASHES] + takes[stream::SAID] + takes[stream::FAINT]).round() as u64;
        stat.rejected_bytes = whole(stream::REJECTED);
        stat
    }

    fn pop_bytes(&self, log: &ActorLog) -> u64 {
        let mut walk = Walk::default();
        let strides = std::iter::from_fn(|| walk.stride(log, &self.header, u64::MAX));
        strides
            .filter(|stride| matches!(stride.payload, Payload::Job { .. }))
            .map(|stride| stride.bytes as u64)
            .sum()
    }
}

/// An actor's log while it is read.
#[derive(Default)]
struct Reading {
    log: ActorLog,
    /// The walk that checks it.
    walk: Walk,
}

/// A log before a segment.
struct Lengths {
    symbols: usize,
    streams: [usize; STREAMS],
    deliveries: u64,
    chain: u64,
    spoken: u64,
    walk: Walk,
}

impl Reading {
    fn lengths(&mut self) -> Lengths {
        let Self { log, walk } = self;
        let streams = log.streams().map(|stream| stream.len());
        let (symbols, deliveries, chain) = (log.symbols.len(), log.deliveries, log.chain);
        Lengths { symbols, streams, deliveries, chain, spoken: log.spoken, walk: walk.clone() }
    }

    fn undo(&mut self, before: &Lengths) {
        self.log
            .streams()
            .into_iter()
            .zip(before.streams)
            .for_each(|(stream, length)| stream.truncate(length));
        self.log.symbols.truncate(before.symbols);
        (self.log.deliveries, self.log.chain) = (before.deliveries, before.chain);
        self.log.spoken = before.spoken;
        self.walk = before.walk.clone();
    }
}

/// Adds a chunk to its actor's log after checking that all of it can be decoded.
fn append(
    chunk: &[u8],
    header: &Header,
    logs: &mut [Option<Box<Reading>>],
    before: &mut BTreeMap<usize, Lengths>,
) -> Result<(), String> {
    let short = || "a chunk ends early".to_owned();
    let mut cursor = Cursor::new(chunk, 0);
    let actor = cursor.number().ok_or_else(short)?;
    let Some(index) = usize::try_from(actor).ok().filter(|index| *index < logs.len()) else {
        return Err(format!("a chunk of actor {actor}, which the header does not name"));
    };
    let read = logs[index].get_or_insert_default();
    before.entry(index).or_insert_with(|| read.lengths());
    let count = cursor.number().ok_or_else(short)?;
    if count > CHUNK_DELIVERIES_MAX {
        return Err(format!("a chunk claims {count} deliveries"));
    }
    read.log.chain = cursor.u64().ok_or_else(short)?;
    for _ in 0..cursor.number().ok_or_else(short)? {
        let from = cursor.number().ok_or_else(short)?;
        let lane = cursor.byte().ok_or_else(short)?;
        if from >= header.nodes.len() as u64 || lane >= lane::END {
            return Err(format!("a delivery from {from} on lane {lane}, which do not exist"));
        }
        if read.log.symbols.len() >= header.nodes.len() * usize::from(lane::END) {
            return Err(format!("actor {actor} has more senders than there are"));
        }
        read.log.symbols.push(Symbol { from: ActorId(from as u32), lane });
    }
    let there = cursor.byte().ok_or_else(short)?;
    let mut new = [&[][..]; STREAMS];
    for (bit, stream) in read.log.streams().into_iter().enumerate().filter(|(bit, _)| there >> bit & 1 == 1) {
        new[bit] = cursor.bytes().ok_or_else(short)?;
        stream.extend_from_slice(new[bit]);
    }
    if new[stream::SAID].iter().any(|said| *said > 1)
        || new[stream::FAINT].iter().any(|faint| faint >> FAINT_BITS != 0)
    {
        return Err(format!("hashes of actor {actor} that are none"));
    }
    read.log.spoken += new[stream::SAID].iter().map(|said| u64::from(*said)).sum::<u64>();
    if !cursor.is_empty() {
        return Err("a chunk is longer than its content".into());
    }
    let Reading { log, walk } = &mut **read;
    log.deliveries = log.deliveries.checked_add(count).ok_or_else(|| "too many deliveries".to_owned())?;
    let valid = walk.validate(log, header, count);
    valid.ok_or_else(|| format!("the log of actor {actor} cannot be decoded"))
}

/// Keeps what is read.
struct Passed<'a, R> {
    source: &'a mut R,
    passed: &'a mut Vec<u8>,
}

impl<R: Read> Read for Passed<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.source.read(buffer)?;
        self.passed.extend_from_slice(&buffer[..read]);
        Ok(read)
    }
}

/// What a recording begins with: its header, and the bytes of that.
fn begin(source: &mut impl Read) -> Result<(u64, Header), TraceError> {
    let mut head = [0; 8];
    let length = fill(source, &mut head).map_err(TraceError::Io)?;
    if length < 6 || head[..6] != MAGIC {
        return Err(TraceError::NotARecording);
    }
    let found = u16::from_le_bytes([head[6], head[7]]);
    if length < 8 {
        return Err(TraceError::NotARecording);
    }
    let first = read_segment(source, &mut None);
    if !(VERSION_OLDEST..=VERSION).contains(&found) {
        return Err(TraceError::Version { found, expected: VERSION, writer: first.writer() });
    }
    let damaged = |reason: String| TraceError::Header { reason };
    let (bytes, body) = match first {
        Segment::Body(bytes, body) => (bytes, body),
        Segment::Nothing => return Err(damaged("it is missing".into())),
        Segment::Damaged(reason) => return Err(damaged(reason)),
    };
    if body.first() != Some(&KIND_HEADER) {
        return Err(damaged("the first segment is no header".into()));
    }
    let header: Header = postcard::from_bytes(&body[1..]).map_err(|error| damaged(error.to_string()))?;
    Ok((bytes, header))
}

enum Segment {
    /// Bytes in the file, and the unpacked content.
    Body(u64, Vec<u8>),
    Nothing,
    Damaged(String),
}

impl Segment {
    /// Who wrote it, if this is a header. All versions begin it alike: the application's part, then a text of the
    /// writer.
    fn writer(&self) -> Option<String> {
        let Self::Body(_, body) = self else { return None };
        let mut cursor = Cursor::new(body.strip_prefix(&[KIND_HEADER])?, 0);
        cursor.bytes()?;
        let text = std::str::from_utf8(cursor.bytes()?).ok()?;
        let plain = !text.is_empty() && text.len() < 200 && !text.chars().any(char::is_control);
        plain.then(|| text.to_owned())
    }
}

/// `model` is made with the first segment that is coded.
fn read_segment(source: &mut impl Read, model: &mut Option<Model>) -> Segment {
    let mut head = [0; SEGMENT_HEAD];
    match fill(source, &mut head) {
        Ok(0) => return Segment::Nothing,
        Ok(SEGMENT_HEAD) => {}
        Ok(_) => return Segment::Damaged("the file ends inside a segment's head".into()),
        Err(error) => return Segment::Damaged(error.to_string()),
    }
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (raw, stored, checksum) = ((word(0) & !CODED) as usize, word(4) as usize, word(8));
    let coded = word(0) & CODED != 0;
    // An lz4 block is at most a little longer than its content, and at most 255 times shorter.
    let stored_max = lz4_flex::block::get_maximum_output_size(raw.min(SEGMENT_BYTES_MAX));
    let too_short = if coded { raw > CODED_BYTES_MAX } else { raw > stored.saturating_mul(255) + 64 };
    if raw > SEGMENT_BYTES_MAX || stored > stored_max || too_short {
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
    if coded {
        let body = model.get_or_insert_with(Model::new).decode(&block, raw);
        return Segment::Body((SEGMENT_HEAD + stored) as u64, body);
    }
    match lz4_flex::block::decompress(&block, raw) {
        Ok(body) if body.len() == raw => Segment::Body((SEGMENT_HEAD + stored) as u64, body),
        Ok(_) => Segment::Damaged("a segment unpacks to another length than it says".into()),
        Err(error) => Segment::Damaged(format!("a segment cannot be unpacked: {error}")),
    }
}

/// Reads until the buffer is full or the source ends; returns how much was read.
fn fill(source: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut length = 0;
    while length < buffer.len() {
        match source.read(&mut buffer[length..]) {
            Ok(0) => break,
            Ok(read) => length += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(length)
}
