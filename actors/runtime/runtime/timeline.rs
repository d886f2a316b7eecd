//! Slices of time on tracks and arrows between them, as a Chrome trace or in Perfetto's own format.

use std::fmt::Write;

use crate::log::format::{put, put_bytes};
use crate::scheduler::profile::TurnTime;

/// Something that took some time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slice {
    /// Which track it lies on.
    pub track: u32,
    /// What it was.
    pub name: String,
    /// When it began, in nanoseconds.
    pub start_ns: u64,
    /// How long it took, in nanoseconds.
    pub duration_ns: u64,
    /// More to tell of it.
    pub notes: Vec<(&'static str, String)>,
}

/// Slices by track, and what led from one to another.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Timeline {
    /// Names of the tracks, by number.
    pub tracks: Vec<String>,
    /// Slices; those of one track in the order of time and not overlapping.
    pub slices: Vec<Slice>,
    /// Arrows between slices, by their places in `slices`.
    pub arrows: Vec<(usize, usize)>,
}

fn quoted(text: &str) -> String {
    let mut quoted = String::with_capacity(text.len() + 2);
    quoted.push('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => quoted.push(' '),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

impl Timeline {
    /// Where an arrow leaves or meets its slice: close behind the beginning, which may be the end of another slice, so
    /// that every viewer sees which is meant.
    fn inside(&self, slice: usize) -> u64 {
        let Slice { start_ns, duration_ns, .. } = self.slices[slice];
        start_ns + (duration_ns / 8).min(500)
    }

    /// JSON for chrome://tracing; Perfetto's viewer reads it too.
    pub fn chrome(&self) -> String {
        let mut json = String::from("{\"traceEvents\":[");
        let mut separator = "";
        for (track, name) in self.tracks.iter().enumerate() {
            let name = quoted(name);
            let _ = write!(
                json,
                "{separator}\n{{\"ph\":\"M\",\"pid\":1,\"tid\":{track},\"name\":\"thread_name\",\"args\":{{\"name\":{name}}}}},\
                 \n{{\"ph\":\"M\",\"pid\":1,\"tid\":{track},\"name\":\"thread_sort_index\",\"args\":{{\"sort_index\":{track}}}}}"
            );
            separator = ",";
        }
        let micro = |ns: u64| ns as f64 * 1e-3;
        for Slice { track, name, start_ns, duration_ns, notes } in &self.slices {
            let notes: Vec<String> =
                notes.iter().map(|(key, value)| format!("{}:{}", quoted(key), quoted(value))).collect();
            let _ = write!(
                json,
                "{separator}\n{{\"ph\":\"X\",\"pid\":1,\"tid\":{track},\"name\":{},\"ts\":{:.3},\"dur\":{:.3},\"args\":{{{}}}}}",
                quoted(name),
                micro(*start_ns),
                micro(*duration_ns),
                notes.join(",")
            );
            separator = ",";
        }
        for (number, (from, to)) in self.arrows.iter().enumerate() {
            let ends = [("s", *from, self.inside(*from)), ("f", *to, self.inside(*to))];
            for (phase, slice, time) in ends {
                let end = if phase == "f" { ",\"bp\":\"e\"" } else { "" };
                let _ = write!(
                    json,
                    ",\n{{\"ph\":\"{phase}\",\"pid\":1,\"tid\":{},\"cat\":\"message\",\"name\":\"message\",\"id\":{number},\"ts\":{:.3}{end}}}",
                    self.slices[slice].track,
                    micro(time),
                );
            }
        }
        json.push_str("\n]}\n");
        json
    }

    /// Perfetto's own format: a sequence of `TracePacket`s (perfetto/protos/perfetto/trace).
    pub fn perfetto(&self) -> Vec<u8> {
        let mut trace = Proto::default();
        for (track, name) in self.tracks.iter().enumerate() {
            let mut descriptor = Proto::default();
            descriptor.number(track_descriptor::UUID, track as u64 + 1);
            descriptor.bytes(track_descriptor::NAME, name.as_bytes());
            trace.packet(packet::TRACK_DESCRIPTOR, &descriptor, None);
        }
        let mut leaving: Vec<Vec<u64>> = vec![Vec::new(); self.slices.len()];
        let mut arriving = leaving.clone();
        for (number, (from, to)) in self.arrows.iter().enumerate() {
            leaving[*from].push(number as u64 + 1);
            arriving[*to].push(number as u64 + 1);
        }
        for (place, slice) in self.slices.iter().enumerate() {
            let mut begin = Proto::default();
            begin.number(track_event::TYPE, track_event::SLICE_BEGIN);
            begin.number(track_event::TRACK_UUID, u64::from(slice.track) + 1);
            begin.bytes(track_event::NAME, slice.name.as_bytes());
            for (key, value) in &slice.notes {
                let mut note = Proto::default();
                note.bytes(debug_annotation::NAME, key.as_bytes());
                note.bytes(debug_annotation::STRING_VALUE, value.as_bytes());
                begin.bytes(track_event::DEBUG_ANNOTATIONS, &note.0);
            }
            leaving[place].iter().for_each(|flow| begin.fixed64(track_event::FLOW_IDS, *flow));
            arriving[place].iter().for_each(|flow| begin.fixed64(track_event::TERMINATING_FLOW_IDS, *flow));
            trace.packet(packet::TRACK_EVENT, &begin, Some(slice.start_ns));
            let mut end = Proto::default();
            end.number(track_event::TYPE, track_event::SLICE_END);
            end.number(track_event::TRACK_UUID, u64::from(slice.track) + 1);
            trace.packet(packet::TRACK_EVENT, &end, Some(slice.start_ns + slice.duration_ns));
        }
        trace.0
    }
}

/// Fields of `TracePacket`.
mod packet {
    pub(super) const TIMESTAMP: u64 = 8;
    pub(super) const TRUSTED_PACKET_SEQUENCE_ID: u64 = 10;
    pub(super) const TRACK_EVENT: u64 = 11;
    pub(super) const TRACK_DESCRIPTOR: u64 = 60;
}

/// Fields of `TrackDescriptor`.
mod track_descriptor {
    pub(super) const UUID: u64 = 1;
    pub(super) const NAME: u64 = 2;
}

/// Fields of `TrackEvent` and values of its type.
mod track_event {
    pub(super) const DEBUG_ANNOTATIONS: u64 = 4;
    pub(super) const TYPE: u64 = 9;
    pub(super) const TRACK_UUID: u64 = 11;
    pub(super) const NAME: u64 = 23;
    pub(super) const FLOW_IDS: u64 = 47;
    pub(super) const TERMINATING_FLOW_IDS: u64 = 48;
    pub(super) const SLICE_BEGIN: u64 = 1;
    pub(super) const SLICE_END: u64 = 2;
}

/// Fields of `DebugAnnotation`.
mod debug_annotation {
    pub(super) const STRING_VALUE: u64 = 6;
    pub(super) const NAME: u64 = 10;
}

/// A protocol buffer that is being written.
#[derive(Default)]
struct Proto(Vec<u8>);

impl Proto {
    fn number(&mut self, field: u64, value: u64) {
        put(&mut self.0, field << 3);
        put(&mut self.0, value);
    }

    fn fixed64(&mut self, field: u64, value: u64) {
        put(&mut self.0, field << 3 | 1);
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn bytes(&mut self, field: u64, bytes: &[u8]) {
        put(&mut self.0, field << 3 | 2);
        put_bytes(&mut self.0, bytes);
    }

    /// One `TracePacket` of a `Trace`.
    fn packet(&mut self, field: u64, content: &Self, time: Option<u64>) {
        let mut packet = Self::default();
        if let Some(time) = time {
            packet.number(packet::TIMESTAMP, time);
        }
        packet.number(packet::TRUSTED_PACKET_SEQUENCE_ID, 1);
        packet.bytes(field, &content.0);
        self.bytes(1, &packet.0);
    }
}

/// Turn times on one track for each thread that ran turns.
pub(crate) fn of_turns(actors: &[(String, Vec<TurnTime>)]) -> Timeline {
    let mut threads: Vec<u16> =
        actors.iter().flat_map(|(_, turns)| turns.iter().map(|turn| turn.thread)).collect();
    threads.sort_unstable();
    threads.dedup();
    let name = |thread: &u16| if *thread == 0 { "main".to_owned() } else { format!("worker {thread}") };
    let tracks = threads.iter().map(name).collect();
    let mut slices: Vec<Slice> = actors
        .iter()
        .flat_map(|(name, turns)| {
            turns.iter().map(|turn| Slice {
                track: threads.binary_search(&turn.thread).unwrap_or(0) as u32,
                name: name.clone(),
                start_ns: turn.start_ns,
                duration_ns: u64::from(turn.duration_ns),
                notes: vec![("messages", turn.messages.to_string())],
            })
        })
        .collect();
    slices.sort_by_key(|slice| (slice.track, slice.start_ns));
    Timeline { tracks, slices, arrows: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::format::Cursor;

    fn timeline() -> Timeline {
        let slice = |track, name: &str, start_ns| Slice {
            track,
            name: name.to_owned(),
            start_ns,
            duration_ns: 40,
            notes: vec![("index", "7".to_owned())],
        };
        Timeline {
            tracks: vec!["main \"a\"".into(), "worker".into()],
            slices: vec![slice(0, "Order", 100), slice(1, "job", 180)],
            arrows: vec![(0, 1)],
        }
    }

    #[test]
    fn chrome_ties_arrows_to_their_slices() {
        let json = timeline().chrome();
        assert!(
            json.contains("\"ph\":\"s\",\"pid\":1,\"tid\":0") && json.contains("\"ts\":0.105}"),
            "{json}"
        );
        assert!(
            json.contains("\"ph\":\"f\",\"pid\":1,\"tid\":1") && json.contains("\"ts\":0.185,\"bp\""),
            "{json}"
        );
        assert_eq!(json.matches('{').count(), json.matches('}').count());
        assert!(json.contains("main \\\"a\\\""), "{json}");
    }

    /// Numbers and lengths of a message's fields.
    fn fields(bytes: &[u8]) -> Vec<(u64, u64, Vec<u8>)> {
        let mut cursor = Cursor::new(bytes, 0);
        let mut fields = Vec::new();
        while !cursor.is_empty() {
            let key = cursor.number().expect("a key");
            fields.push(match key & 7 {
                0 => (key >> 3, cursor.number().expect("a number"), Vec::new()),
                1 => (key >> 3, cursor.u64().expect("eight bytes"), Vec::new()),
                2 => (key >> 3, 0, cursor.bytes().expect("bytes").to_vec()),
                other => panic!("wire type {other}"),
            });
        }
        fields
    }

    #[test]
    fn perfetto_packets_decode() {
        let packets = fields(&timeline().perfetto());
        assert_eq!(packets.len(), 2 + 2 * 2);
        let events: Vec<_> = packets
            .iter()
            .filter_map(|(_, _, packet)| {
                let fields_of = fields(packet);
                let time = fields_of.iter().find(|field| field.0 == 8)?.1;
                let event = &fields_of.iter().find(|field| field.0 == 11)?.2;
                Some((time, fields(event)))
            })
            .collect();
        assert_eq!(events.iter().map(|event| event.0).collect::<Vec<_>>(), [100, 140, 180, 220]);
        let of = |event: usize, field: u64| events[event].1.iter().find(|f| f.0 == field).map(|f| f.1);
        assert_eq!((of(0, 47), of(2, 48), of(0, 9), of(1, 9)), (Some(1), Some(1), Some(1), Some(2)));
    }
}
