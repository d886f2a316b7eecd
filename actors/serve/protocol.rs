//! What page and server say to each other over one WebSocket: text is JSON, binary is little-endian.
//!
//! The first message of a page is [`FromPage::Hello`]; everything from outside is parsed here and nowhere else.

use foveal_engine::Lamp;
use foveal_engine::controls::{Kind, Value, controls};
use foveal_engine::foveal::scene::Camera;
use foveal_engine::glam::Vec3;
use foveal_engine::navigation::{Motion, Pace};
use foveal_engine::source::{Controls, NamedLamp, Wish};
use foveal_engine::thread::Opening;
use foveal_engine::walk::Act;
use serde::{Deserialize, Serialize};
use serde_json::{Map, json};

use crate::coding::{Coded, TILE};

/// Raised whenever a page of before could not talk to a server of after.
pub const VERSION: u32 = 1;
/// Most bytes of a text from a page.
pub const TEXT_MAX: usize = 4 << 10;
/// Most bytes of input from a page.
pub const INPUT_MAX: usize = 8 << 10;
/// Bytes of one input event: time, kind, two numbers.
pub const INPUT_BYTES: usize = 17;
/// Bytes in front of the tiles and the picture of a frame.
pub const HEAD_BYTES: usize = 32;
/// Lamps that pages are told of.
const LAMPS: usize = 64;

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
        /// Where the camera stood then ([`camera_from`]), should the server not know it any more.
        #[serde(default)]
        camera: Option<[f32; 10]>,
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
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
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
    /// Pictures of another size.
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The scene's files are read again.
    Reload,
    /// A lamp shines so much of what the files say.
    Dim {
        /// Which of the welcome's lamps.
        lamp: u16,
        /// How much.
        gain: f32,
    },
    /// A light without area comes to where the camera stands.
    Bring {
        /// Which of the welcome's lamps.
        lamp: u16,
    },
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
    /// Whether pictures may be other ones after it although nobody moves; a page counts these.
    pub fn sets(self) -> bool {
        matches!(self, Self::Size { .. } | Self::Reload | Self::Dim { .. } | Self::Bring { .. })
    }

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
        "changes": walk.changes,
        "controls": walk.controls,
        "ends": walk.ends,
        "lamps": walk.lamps.iter().map(|lamp| {
            json!({"name": lamp.name, "gain": lamp.gain.max_element(), "moves": matches!(lamp.lamp, Lamp::Light(_))})
        }).collect::<Vec<_>>(),
    })
    .to_string()
}

/// A walk as pages are told of it.
#[derive(Clone, Debug, Default)]
pub struct Described {
    title: String,
    size: [u32; 2],
    changes: bool,
    bookmarks: Vec<String>,
    paths: Vec<String>,
    recorded: bool,
    controls: serde_json::Value,
    ends: serde_json::Value,
    /// What can be dimmed.
    pub lamps: Vec<NamedLamp>,
}

impl Described {
    /// Of a walk that begins so, and is `recorded` or not.
    pub fn new(opening: &Opening, recorded: bool) -> Self {
        let Opening { place, size, ranges, controls: _, changes } = opening;
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
            size: *size,
            changes: *changes,
            bookmarks: place.cameras.iter().map(|c| c.name.clone()).collect(),
            paths: place.paths.iter().map(|p| p.name.clone()).collect(),
            recorded,
            controls: controls().iter().filter_map(row).collect(),
            ends: crate::scales::scales(),
            lamps: place.lamps.iter().take(LAMPS).cloned().collect(),
        }
    }
}

/// Whether a picture is what its view converges to, as everything is set that this viewer has set: it has said so many times
/// that something is.
pub fn still(picture: u64, exact: bool, set: u64) -> String {
    json!({"type": "still", "picture": picture as u32, "exact": exact, "set": set}).to_string()
}

/// A camera as the ten numbers that pages keep: eye, target, up, field of view.
pub fn camera_numbers(camera: &Camera) -> [f32; 10] {
    let [e, t, u] = [camera.eye, camera.target, camera.up].map(|v| v.to_array());
    [e[0], e[1], e[2], t[0], t[1], t[2], u[0], u[1], u[2], camera.fov_y]
}

/// The camera of ten numbers, if one can look through it.
pub fn camera_from(numbers: [f32; 10]) -> Option<Camera> {
    let [e0, e1, e2, t0, t1, t2, u0, u1, u2, fov_y] = numbers;
    let (eye, target, up) = (Vec3::new(e0, e1, e2), Vec3::new(t0, t1, t2), Vec3::new(u0, u1, u2));
    let is_near = numbers.iter().all(|v| v.is_finite() && v.abs() < 1e9);
    let looks = (target - eye).cross(up).length() > 1e-6 && (0.01..3.0).contains(&fov_y);
    (is_near && looks).then_some(Camera { eye, target, up, fov_y })
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
    /// Page's time of the newest input that it knows of, milliseconds; 0 for others than the driver.
    pub mark: f64,
    /// How much of the time since then the walk took, seconds; tenths of milliseconds are told, at most 6.5 s.
    pub took: f64,
}

impl Head {
    /// Kind of a frame, beside [`FILE`].
    const FRAME: u8 = 1;

    /// The head, and behind it where the tiles lie and the picture of them, or of all.
    pub fn with(&self, coded: &Coded) -> Vec<u8> {
        let Coded { tiles, columns, bytes: picture } = coded;
        let mut bytes = Vec::with_capacity(HEAD_BYTES + 4 * tiles.len() + picture.len());
        let flags = u8::from(self.exact) | u8::from(self.lossless) << 1;
        bytes.extend([Self::FRAME, flags, self.quality, 0]);
        bytes.extend(self.number.to_le_bytes());
        let sheet = [tiles.len() as u16, *columns, TILE as u16, (self.took * 1e4) as u16];
        bytes.extend(self.size.into_iter().chain(sheet).flat_map(u16::to_le_bytes));
        bytes.extend(self.view.to_le_bytes());
        bytes.extend(self.mark.to_le_bytes());
        bytes.extend(tiles.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(picture);
        bytes
    }
}

/// First byte of a file to keep.
pub const FILE: u8 = 2;

#[cfg(test)]
#[path = "protocol_tests.rs"]
mod tests;
