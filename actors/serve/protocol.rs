//! What page and server say to each other over one WebSocket: text is JSON, binary is little-endian.
//!
//! The first message of a page is [`FromPage::Hello`]; everything from outside is parsed here and nowhere else.

use foveal_engine::controls::{Kind, Value, controls};
use foveal_engine::navigation::{Motion, Pace};
use foveal_engine::source::{Controls, Place, Ranges, Wish};
use foveal_engine::walk::Act;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};

/// Raised whenever a page of before could not talk to a server of after.
pub const VERSION: u32 = 1;
/// Most bytes of a text from a page.
pub const TEXT_MAX: usize = 4 << 10;
/// Most bytes of input from a page.
pub const INPUT_MAX: usize = 8 << 10;
/// Bytes of one input event: time, kind, two numbers.
pub const INPUT_BYTES: usize = 17;
/// Bytes in front of the picture of a frame.
pub const HEAD_BYTES: usize = 32;

/// What a page says.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase")]
pub enum FromPage {
    /// Who it is; first.
    Hello {
        /// [`VERSION`] of the page.
        v: u32,
        /// What the address had behind its `#t=`.
        token: String,
        /// What its last welcome said, where the connection was lost.
        #[serde(default)]
        resume: Option<String>,
    },
    /// A control is set.
    Set {
        /// Its name.
        key: String,
        /// Its value.
        value: Value,
    },
    /// Something is to be done.
    Do(Deed),
    /// A frame was drawn, which gives its credit back.
    Shown {
        /// Its number.
        frame: u32,
    },
    /// A file has arrived.
    Kept,
    /// Somebody still looks.
    Here,
}

/// What can be asked for beside moving.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "name", rename_all = "lowercase")]
pub enum Deed {
    /// To drive.
    Take,
    /// To let drive who asked.
    Give,
    /// To go to a bookmark, or set it here; counted from 0.
    Bookmark {
        /// Which.
        number: u8,
        /// Whether it is set.
        set: bool,
    },
    /// To record a path, or end that.
    Record,
    /// To play it, or end that.
    Play,
    /// The picture on show with all bits, to keep.
    Screenshot,
    /// Of a recording: to go to a frame.
    Frame {
        /// Its number.
        number: u32,
    },
    /// Of a recording: to go by messages, back where it is negative.
    Messages {
        /// How many.
        count: i16,
    },
    /// Of a recording: to play, or pause.
    Replay,
    /// Of a recording: why a pixel looks as it does.
    Why {
        /// Its column.
        x: u32,
        /// Its row.
        y: u32,
    },
    /// To leave a recording and walk on from there.
    Branch,
}

impl Deed {
    /// What is wanted of a recording, if this is about one.
    pub fn wish(self) -> Option<Wish> {
        Some(match self {
            Self::Frame { number } => Wish::Frame(number),
            Self::Messages { count } => Wish::Messages(count.into()),
            Self::Replay => Wish::Play,
            Self::Why { x, y } => Wish::Why(x, y),
            Self::Branch => Wish::Branch,
            _ => return None,
        })
    }
}

/// An input event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Input {
    /// When, by the page's clock: milliseconds.
    pub time: f64,
    /// What.
    pub act: Act,
}

/// A message that makes no sense. Whoever sends one is not our page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

impl FromPage {
    /// # Errors
    /// If it is no message.
    pub fn parse(text: &str) -> Result<Self, Malformed> {
        serde_json::from_str(text).map_err(|_| Malformed)
    }
}

const MOTIONS: [Motion; 6] =
    [Motion::Forward, Motion::Backward, Motion::Left, Motion::Right, Motion::Up, Motion::Down];
const PACES: [Pace; 3] = [Pace::Normal, Pace::Fast, Pace::Slow];

/// The events of a binary message.
///
/// # Errors
/// If one of them is none; then none counts.
pub fn parse_input(bytes: &[u8]) -> Result<Vec<Input>, Malformed> {
    let (events, rest) = bytes.as_chunks::<INPUT_BYTES>();
    if events.is_empty() || !rest.is_empty() || bytes.len() > INPUT_MAX {
        return Err(Malformed);
    }
    events.iter().map(event).collect()
}

fn event(bytes: &[u8; INPUT_BYTES]) -> Result<Input, Malformed> {
    let [t0, t1, t2, t3, t4, t5, t6, t7, kind, a0, a1, a2, a3, b0, b1, b2, b3] = *bytes;
    let time = f64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
    let (a, b) = (f32::from_le_bytes([a0, a1, a2, a3]), f32::from_le_bytes([b0, b1, b2, b3]));
    if !(time.is_finite() && a.is_finite() && b.is_finite()) {
        return Err(Malformed);
    }
    // Negative ones become 0.
    let motion = || MOTIONS.get(a as usize).copied().ok_or(Malformed);
    let act = match kind {
        1 => Act::Press(motion()?),
        2 => Act::Release(motion()?),
        3 => Act::Look(a.clamp(-1e4, 1e4), b.clamp(-1e4, 1e4)),
        4 => Act::Wheel(a.clamp(-20.0, 20.0)),
        5 => Act::Pace(PACES.get(a as usize).copied().ok_or(Malformed)?),
        6 => Act::ReleaseAll,
        7 => Act::ToggleOrbit,
        _ => return Err(Malformed),
    };
    Ok(Input { time, act })
}

/// What a viewer may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Moves and sets.
    Drives,
    /// Looks on, and may ask to drive.
    Watches,
}

/// Why a connection ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Why {
    /// The page is of another version of the program.
    Version,
    /// The token is wrong or missing.
    Token,
    /// As many look already as may.
    Full,
    /// The same viewer came again by another connection.
    Elsewhere,
    /// Nothing was heard for long.
    Idle,
    /// More was sent than is allowed, or what makes no sense.
    Rude,
    /// The walk is over.
    Over,
    /// The server ends.
    Shutdown,
}

impl Why {
    /// The close code of the WebSocket.
    pub fn code(self) -> u16 {
        match self {
            Self::Version | Self::Token | Self::Rude => 1008,
            Self::Full => 1013,
            Self::Elsewhere | Self::Idle | Self::Over => 1000,
            Self::Shutdown => 1001,
        }
    }
}

/// The first message to a page that is let in.
pub fn welcome(id: u64, resume: &str, role: Role, may_drive: bool, walk: &Described) -> String {
    json!({
        "type": "welcome",
        "v": VERSION,
        "id": id,
        "resume": resume,
        "role": role,
        "may_drive": may_drive,
        "title": walk.title,
        "size": walk.size,
        "bookmarks": walk.bookmarks,
        "paths": walk.paths,
        "recorded": walk.recorded,
        "controls": walk.controls,
        "ends": walk.ends,
    })
    .to_string()
}

/// A walk as pages are told of it.
#[derive(Clone, Debug, Default)]
pub struct Described {
    title: String,
    size: [u32; 2],
    bookmarks: Vec<String>,
    paths: Vec<String>,
    recorded: bool,
    controls: serde_json::Value,
    ends: serde_json::Value,
}

impl Described {
    /// Of a walk through `place`; `ends` is what each overlay's scale says at its ends.
    pub fn new(place: &Place, size: [u32; 2], ranges: &Ranges, recorded: bool) -> Self {
        let row = |control: &foveal_engine::controls::Control| {
            let kind = match control.kind(ranges)? {
                Kind::Slider { least, most, logarithmic, whole } => json!({
                    "kind": "slider", "least": least, "most": most, "logarithmic": logarithmic, "whole": whole,
                }),
                Kind::Choice(names) => json!({"kind": "choice", "names": names}),
                Kind::Switch => json!({"kind": "switch"}),
            };
            let mut row = json!({
                "key": control.key, "label": control.label, "help": control.help, "group": control.group,
                "unit": control.unit, "needs": control.needs, "of_recordings": control.of_recordings,
            });
            if let (Some(row), serde_json::Value::Object(kind)) = (row.as_object_mut(), kind) {
                row.extend(kind);
            }
            Some(row)
        };
        Self {
            title: place.title.clone(),
            size,
            bookmarks: place.cameras.iter().map(|c| c.name.clone()).collect(),
            paths: place.paths.iter().map(|p| p.name.clone()).collect(),
            recorded,
            controls: controls().iter().filter_map(row).collect(),
            ends: crate::scales::scales(),
        }
    }
}

/// All values of the controls.
pub fn values(now: &Controls) -> String {
    let values: Map<String, serde_json::Value> =
        controls().iter().map(|c| (c.key.to_owned(), json!(c.value(now)))).collect();
    json!({"type": "values", "values": values}).to_string()
}

/// Who drives, for one viewer. `asked`: somebody wants to drive in this one's place.
pub fn role(role: Role, asked: bool, viewers: usize) -> String {
    json!({"type": "role", "role": role, "asked": asked, "viewers": viewers}).to_string()
}

/// A line for people.
pub fn notice(text: &str, failed: bool) -> String {
    json!({"type": "notice", "text": text, "failed": failed}).to_string()
}

/// The last message.
pub fn bye(why: Why) -> String {
    json!({"type": "bye", "why": why}).to_string()
}

/// What stands in front of a frame's picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// It is what the view converges to, each bit of it.
    pub exact: bool,
    /// No bit was lost on the way.
    pub lossless: bool,
    /// Quality of the JPEG; 0 where none was lost.
    pub quality: u8,
    /// Number of the picture, for [`FromPage::Shown`].
    pub number: u32,
    /// Number of the view.
    pub view: u32,
    /// Columns and rows of the whole picture.
    pub size: [u16; 2],
    /// What is replaced of it: left, top, columns, rows.
    pub part: [u16; 4],
    /// Page's time of the newest input that it knows of, milliseconds; 0 for others than the driver.
    pub mark: f64,
}

impl Head {
    /// Kind of a frame, beside [`FILE`].
    const FRAME: u8 = 1;

    /// The head, and behind it the picture.
    pub fn with(&self, picture: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEAD_BYTES + picture.len());
        let flags = u8::from(self.exact) | u8::from(self.lossless) << 1;
        bytes.extend([Self::FRAME, flags, self.quality, 0]);
        bytes.extend(self.number.to_le_bytes());
        bytes.extend(self.size.into_iter().chain(self.part).flat_map(u16::to_le_bytes));
        bytes.extend(self.view.to_le_bytes());
        bytes.extend(self.mark.to_le_bytes());
        bytes.extend(picture);
        bytes
    }
}

/// First byte of a file to keep.
pub const FILE: u8 = 2;

#[cfg(test)]
mod tests {
    use super::*;

    fn input(time: f64, kind: u8, a: f32, b: f32) -> Vec<u8> {
        let mut bytes = time.to_le_bytes().to_vec();
        bytes.push(kind);
        bytes.extend(a.to_le_bytes());
        bytes.extend(b.to_le_bytes());
        bytes
    }

    #[test]
    fn texts_are_parsed_and_nonsense_is_not() {
        let hello = FromPage::parse(r#"{"type":"hello","v":1,"token":"x"}"#);
        assert_eq!(hello, Ok(FromPage::Hello { v: 1, token: "x".into(), resume: None }));
        let set = FromPage::parse(r#"{"type":"set","key":"fps","value":12.5}"#);
        assert_eq!(set, Ok(FromPage::Set { key: "fps".into(), value: Value::Number(12.5) }));
        let set = FromPage::parse(r#"{"type":"set","key":"refines","value":true}"#);
        assert_eq!(set, Ok(FromPage::Set { key: "refines".into(), value: Value::Switch(true) }));
        assert_eq!(FromPage::parse(r#"{"type":"do","name":"take"}"#), Ok(FromPage::Do(Deed::Take)));
        let mark = FromPage::parse(r#"{"type":"do","name":"bookmark","number":2,"set":true}"#);
        assert_eq!(mark, Ok(FromPage::Do(Deed::Bookmark { number: 2, set: true })));
        for text in [
            "",
            "{}",
            "[]",
            r#"{"type":"hello"}"#,
            r#"{"type":"do","name":"rm"}"#,
            r#"{"type":"shown","frame":-1}"#,
            r#"{"type":"set","key":"fps","value":[1]}"#,
        ] {
            assert_eq!(FromPage::parse(text), Err(Malformed), "{text}");
        }
    }

    #[test]
    fn input_is_parsed_and_nonsense_is_not() {
        let bytes = [input(5.0, 1, 3.0, 0.0), input(6.0, 3, 4.0, -2.0), input(7.0, 6, 0.0, 0.0)].concat();
        let events = parse_input(&bytes).expect("events");
        assert_eq!(events[0], Input { time: 5.0, act: Act::Press(Motion::Right) });
        assert_eq!(events[1], Input { time: 6.0, act: Act::Look(4.0, -2.0) });
        assert_eq!(events[2].act, Act::ReleaseAll);
        assert!(parse_input(&bytes[1..]).is_err() && parse_input(&[]).is_err());
        assert!(parse_input(&input(1.0, 9, 0.0, 0.0)).is_err());
        assert!(parse_input(&input(1.0, 1, 6.0, 0.0)).is_err());
        assert!(parse_input(&input(1.0, 3, f32::NAN, 0.0)).is_err());
        assert!(parse_input(&input(f64::INFINITY, 6, 0.0, 0.0)).is_err());
        assert!(parse_input(&input(1.0, 6, 0.0, 0.0).repeat(500)).is_err());
    }

    #[test]
    fn a_head_has_its_length() {
        let head = Head {
            exact: true,
            lossless: true,
            quality: 0,
            number: 7,
            view: 3,
            size: [512, 384],
            part: [0, 16, 512, 368],
            mark: 1.5,
        };
        let bytes = head.with(&[9]);
        assert_eq!((bytes.len(), bytes[..2].to_vec(), bytes[HEAD_BYTES]), (HEAD_BYTES + 1, vec![1, 3], 9));
        assert_eq!(bytes[8..12], [0, 2, 128, 1]);
        assert_eq!(f64::from_le_bytes(bytes[24..32].try_into().expect("eight bytes")), 1.5);
    }
}
