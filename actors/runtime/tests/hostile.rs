//! Files whose checksums are right and whose numbers are not: read in no time and with little memory. And files that
//! are right, from elsewhere.

use foveal_runtime::*;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::common::*;

/// What reading such a file, and everything that can be asked of it, may take.
const TIME: Duration = Duration::from_secs(1);

fn number(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// A segment as the recorder frames it.
fn segment(body: &[u8]) -> Vec<u8> {
    let block = lz4_flex::block::compress(body);
    let mut bytes = (body.len() as u32).to_le_bytes().to_vec();
    bytes.extend_from_slice(&(block.len() as u32).to_le_bytes());
    let checksum = crc32fast::hash(&[bytes.as_slice(), &block].concat());
    bytes.extend_from_slice(&checksum.to_le_bytes());
    bytes.extend_from_slice(&block);
    bytes
}

/// A recording of a ring of 8 players and their starter, with these chunks in one segment.
fn recording(hashing: Hashing, chunks: &[Vec<u8>]) -> Vec<u8> {
    let whole = record_ring(0, 7, 1, Hashing::Off);
    let header = Header { hashing, ..read(&whole).header().clone() };
    let mut bytes = whole[..8].to_vec();
    bytes.extend_from_slice(&segment(
        &[&[0], postcard::to_stdvec(&header).expect("a header").as_slice()].concat(),
    ));
    let mut body = vec![1];
    for chunk in chunks {
        number(&mut body, chunk.len() as u64);
        body.extend_from_slice(chunk);
    }
    bytes.extend_from_slice(&segment(&body));
    bytes
}

/// A recording with another header.
fn with_header(bytes: &[u8], header: &[u8]) -> Vec<u8> {
    let behind = 8 + 12 + u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
    [&bytes[..8], &segment(&[&[0], header].concat()), &bytes[behind..]].concat()
}

#[test]
fn a_recording_from_elsewhere_replays_and_is_named_where_it_does_not() {
    let here = record_ring(0, 7, 50, Hashing::Exact);
    assert_eq!(replay_ring(&read(&here), 0, 50).foreign, None);
    let mut header = read(&here).header().clone();
    header.fingerprint.processor = "sse2".into();
    header.fingerprint.compiler = "rustc 1.0.0".into();
    let trace = read(&with_header(&here, &postcard::to_stdvec(&header).expect("a header")));
    let report = replay_ring(&trace, 0, 50);
    assert_complete(&report);
    let foreign = report.foreign.expect("two differences");
    assert!(foreign.contains("\"rustc 1.0.0\" there") && foreign.contains("\"sse2\" there"), "{foreign}");
    let report = replay_ring(&trace, 0, 49);
    assert!(report.divergence.is_some() && report.foreign == Some(foreign));
}

#[test]
fn a_recording_of_an_old_format_says_who_wrote_it() {
    // The header of version 2 went on behind these two.
    let header =
        postcard::to_stdvec(&(b"{}".as_slice(), "rustc 1.94.0 x86_64-unknown-linux-gnu 0.1.0", 7_u64))
            .expect("a header");
    let mut bytes = with_header(&record_ring(0, 7, 1, Hashing::Off), &header);
    bytes[6] = 2;
    let error = Trace::from_bytes(&bytes).expect_err("another version").to_string();
    assert!(error.contains("version 2, written by rustc 1.94.0 x86_64"), "{error}");
    assert!(error.contains("this program reads version 4 and 3") && !error.contains('\n'), "{error}");
    bytes.truncate(30);
    let error = Trace::from_bytes(&bytes).expect_err("another version").to_string();
    assert!(error.contains("version 2;"), "{error}");
}

/// A chunk that says that `count` messages of actor 1 were delivered to actor 0, with these hashes.
fn run(count: u64, hashes: &[u8]) -> Vec<u8> {
    let mut chunk = vec![0];
    number(&mut chunk, count);
    chunk.extend_from_slice(&[0; 8]);
    // One sender: actor 1 on the data lane. Then the streams of order and hashes, the first with one run.
    chunk.extend_from_slice(&[1, 1, 0, 1 | u8::from(!hashes.is_empty()) << 3]);
    let mut order = vec![1, 0];
    number(&mut order, count - 3);
    for stream in [order.as_slice(), hashes].into_iter().filter(|stream| !stream.is_empty()) {
        number(&mut chunk, stream.len() as u64);
        chunk.extend_from_slice(stream);
    }
    chunk
}

/// Everything that `log stat`, `log check` and `replay` ask of a recording.
fn ask_all(bytes: &[u8]) -> Arc<Trace> {
    let begun = Instant::now();
    let trace = read(bytes);
    trace.stat();
    for actor in (0..trace.header().nodes.len() as u32).map(ActorId) {
        trace.marks(actor).for_each(drop);
        trace.delivery(actor, trace.deliveries(actor) / 2);
        assert_eq!(trace.first_difference(&trace, actor), None);
    }
    replay_ring(&trace, 0, 1);
    assert!(begun.elapsed() < TIME, "{:?}", begun.elapsed());
    trace
}

#[test]
fn a_run_of_any_length_costs_nothing() {
    let count = 1 << 31;
    let bytes = recording(Hashing::Off, &[run(count, &[])]);
    let trace = ask_all(&bytes);
    assert_eq!(trace.deliveries(ActorId(0)), count);
    let Some(Event::Delivered { index, from, .. }) = trace.delivery(ActorId(0), count - 1) else {
        panic!("the last of them")
    };
    assert_eq!((index, from), (count - 1, ActorId(1)));
    assert_eq!(trace.delivery(ActorId(0), count), None);
    let shorter = read(&recording(Hashing::Off, &[run(count / 2, &[])]));
    assert_eq!(trace.first_difference(&shorter, ActorId(0)), None, "they agree as far as both go");
}

#[test]
fn a_chunk_holds_no_more_than_can_be_delivered_before_it_is_written() {
    let bytes = recording(Hashing::Off, &[run(1 << 60, &[])]);
    assert!(bytes.len() < 400);
    let trace = ask_all(&bytes);
    let damage = trace.damage().expect("damage");
    assert!(damage.reason.contains("1152921504606846976 deliveries"), "{damage:?}");
    assert_eq!(trace.stat().deliveries, 0);
}

#[test]
fn deliveries_are_as_many_as_their_hashes() {
    for (hashing, count, hashes, whole) in [
        (Hashing::Exact, 4, 8, true),
        (Hashing::Exact, 4, 16, true),
        (Hashing::Exact, 4, 6, false),
        (Hashing::Exact, 1 << 20, 8, false),
        (Hashing::Exact, 4, 18, false),
        (Hashing::Every(64), 127, 8, true),
        (Hashing::Every(64), 128, 8, false),
        (Hashing::Every(u32::MAX), 1 << 31, 0, true),
        (Hashing::Off, 4, 8, false),
    ] {
        let trace = ask_all(&recording(hashing, &[run(count, &vec![0; hashes])]));
        let damage = trace.damage().expect("it has no end").reason.clone();
        assert_eq!(damage.contains("without its end"), whole, "{hashing:?} {count} {hashes}: {damage}");
    }
}

#[test]
fn a_segment_with_a_bad_chunk_leaves_nothing() {
    let good = run(5, &[]);
    let trace = ask_all(&recording(Hashing::Off, &[good.clone(), good, vec![0, 1]]));
    assert_eq!((trace.stat().deliveries, trace.stat().order_bytes), (0, 0));
}

/// The most memory this process has had since this was last asked, in bytes; none where that cannot be asked.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    std::fs::write("/proc/self/clear_refs", "5").ok()?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

#[test]
fn few_bytes_take_little_memory() {
    // A process of its own, since memory is counted by process.
    const CHILD: &str = "FOVEAL_TEST_HOSTILE";
    if std::env::var_os(CHILD).is_none() {
        let program = std::env::current_exe().expect("a program");
        let mut child = std::process::Command::new(program);
        child.args(["hostile::few_bytes_take_little_memory", "--exact", "--nocapture"]);
        let output = child.env(CHILD, "1").output().expect("starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        return;
    }
    let head = |body: &[u8]| [&recording(Hashing::Off, &[])[..8], &segment(body)].concat();
    let header = |nodes: u64, each: &[u8]| {
        let mut body = vec![0, 0, 0, 0, 0];
        number(&mut body, nodes);
        (0..nodes).for_each(|_| body.extend_from_slice(each));
        body
    };
    // Names nobody, as many as a segment can hold; then as many as are allowed, and an empty chunk of each.
    let (many, allowed) = (head(&header(15 << 20, &[0, 0])), head(&header(1 << 16, &[0, 0])));
    let mut chunks = vec![1];
    for actor in 0..1 << 16 {
        let mut chunk = Vec::new();
        number(&mut chunk, actor);
        chunk.extend_from_slice(&[0; 11]);
        number(&mut chunks, chunk.len() as u64);
        chunks.extend_from_slice(&chunk);
    }
    let chunks = [allowed.clone(), segment(&chunks)].concat();
    // One actor that says two million times that it has the same sender, an end with two million totals, and a segment
    // that ends badly after as many empty chunks.
    let few = recording(Hashing::Off, &[]);
    let mut senders = vec![0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    number(&mut senders, 15 << 20);
    senders.resize(30 << 20, 0);
    let senders = recording(Hashing::Off, &[senders]);
    let mut end = vec![2];
    number(&mut end, 15 << 20);
    end.resize(30 << 20, 0);
    let end = [few.clone(), segment(&end)].concat();
    let empty = [12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    let bad = [&[1][..], &empty.repeat(2 << 20), &[9]].concat();
    let bad = [few, segment(&bad)].concat();
    for (name, bytes, spare) in [
        ("many names", many, 96),
        ("names", allowed, 32),
        ("chunks", chunks, 64),
        ("senders", senders, 96),
        ("end", end, 96),
        ("chunks and damage", bad, 96),
    ] {
        assert!(bytes.len() < 512 << 10, "{name}: {}", bytes.len());
        let before = peak_bytes().and(peak_bytes());
        let begun = Instant::now();
        drop(Trace::from_bytes(&bytes));
        assert!(begun.elapsed() < TIME, "{name}: {:?}", begun.elapsed());
        if let (Some(before), Some(after)) = (before, peak_bytes()) {
            assert!(after - before < spare << 20, "{name}: {} MiB more", (after - before) >> 20);
        }
    }
}
