//! What a window, a browser or a test shows: a walk or a recording, seen from outside.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::edit::Lamp;
use foveal::scene::{Camera, CameraPath, NamedCamera};
use foveal_runtime::Ending;
use glam::Vec3;

use foveal_actors::insight::Insight;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::Adjustment;
use foveal_actors::station::StationStatus;

use crate::engine::Event;
use crate::look::Mirror;
use crate::opened::Opened;
use crate::pick::Picked;
use crate::replay::Segment;

/// What the user may change while walking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Controls {
    /// What reaches the actors, as messages.
    pub set: Adjustment,
    /// What is painted over the picture. Of the window alone.
    pub overlay: Overlay,
}

/// How far [`Controls`] go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ranges {
    /// Most tracers.
    pub workers: u32,
    /// Least and most bytes of textures, where they are limited.
    pub textures: Option<[u64; 2]>,
}

/// One actor as the window sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct ActorStatus {
    /// Its name.
    pub name: String,
    /// Messages delivered to it.
    pub delivered: u64,
    /// Messages that wait for it.
    pub waiting: u64,
    /// Most messages that ever waited when it began to work, or wait now.
    pub waiting_max: u64,
    /// Time it has been at work.
    pub busy: Duration,
}

/// Where a session stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Views so far.
    pub view: u32,
    /// Every non-diffuse pixel shows its own ray.
    pub converged: bool,
    /// It has been refined as far as was asked for.
    pub refined: bool,
    /// Samples that refined the view in the last frame.
    pub supersampled: u32,
    /// Fresh samples splatted in the last frame.
    pub traced: u32,
    /// Warped samples shown in the last frame.
    pub reused: u32,
    /// Samples that expired in the last frame.
    pub expired: u32,
    /// The illumination is final.
    pub lit: bool,
    /// The actors.
    pub actors: Vec<ActorStatus>,
    /// Places for other machines, by number.
    pub stations: Vec<StationStatus>,
}

impl Status {
    /// Where the view stands, in words; `refining`: whether more samples are on their way to each pixel.
    pub fn state(&self, refining: bool) -> &'static str {
        match (self.converged, self.lit) {
            (true, _) if self.refined => "refined",
            (true, _) if refining => "converged, being refined",
            (true, _) => "converged",
            (false, true) => "correcting",
            (false, false) => "correcting, light grows",
        }
    }
}

/// What a window needs to know of a scene.
#[derive(Clone, Debug)]
pub struct Place {
    /// Title for people.
    pub title: String,
    /// Up axis, unit.
    pub up: Vec3,
    /// Diagonal of the bounds, scene units.
    pub diagonal: f32,
    /// Cameras; never empty, the first is the start view.
    pub cameras: Vec<NamedCamera>,
    /// Paths that can be played.
    pub paths: Vec<CameraPath>,
    /// All that can be dimmed; of a recording nothing.
    pub lamps: Vec<NamedLamp>,
}

/// Something that emits light.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedLamp {
    /// For people.
    pub name: String,
    /// What it is.
    pub lamp: Lamp,
    /// By how much of what the files say it shines now, per band.
    pub gain: Vec3,
}

/// Names for people.
#[derive(Clone, Debug, Default)]
pub struct Names {
    /// Of objects, by id.
    pub objects: Vec<String>,
    /// Of textures.
    pub textures: Vec<String>,
}

/// A recording at a moment, as its timeline shows it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimelineShown {
    /// Frames of the recording.
    pub frames: u32,
    /// The frame that is shown; `None` before the first.
    pub frame: Option<u32>,
    /// Deliveries made to each actor.
    pub position: String,
    /// The last deliveries.
    pub lines: Vec<String>,
    /// Why the pixel that was asked for looks as it does.
    pub story: Vec<String>,
    /// The path of its sample, over the picture.
    pub path: Vec<Segment>,
    /// Names of the actors.
    pub actors: Vec<String>,
    /// Whose state is told, and what it says.
    pub state: (String, Vec<String>),
    /// Where what was searched for comes about: what is told of it, and the place.
    pub found: Vec<(String, String)>,
    /// What each actor did in the frame, where that is asked for.
    pub lanes: Option<Arc<LanesShown>>,
    /// Frames from which on another recording, shown beside, has other pictures.
    pub parted: Option<u32>,
}

/// What each actor did in a frame, on a line of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LanesShown {
    /// Names of the lanes.
    pub names: Vec<String>,
    /// Nanoseconds of all of it.
    pub whole_ns: u64,
    /// What was delivered.
    pub slices: Vec<LaneSlice>,
    /// From a slice to one whose message was sent in it.
    pub arrows: Vec<(usize, usize)>,
}

/// A delivery on its lane.
#[derive(Clone, Debug, PartialEq)]
pub struct LaneSlice {
    /// Which lane.
    pub lane: usize,
    /// When it began.
    pub start_ns: u64,
    /// How long it took.
    pub duration_ns: u64,
    /// What was delivered.
    pub kind: &'static str,
    /// Its place.
    pub at: String,
    /// The frame waited for it.
    pub is_critical: bool,
}

/// A walk that leaves a recording.
pub struct Branch {
    /// Its session.
    pub source: Box<dyn FrameSource>,
    /// Where it begins.
    pub camera: Camera,
    /// Where it is recorded, if it is.
    pub recorded: Option<PathBuf>,
}

/// What the user wants of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Go to a frame.
    Frame(u32),
    /// Go so many messages forward, or back.
    Messages(i64),
    /// Play, or pause.
    Play,
    /// Why a pixel looks as it does.
    Why(u32, u32),
    /// Leave the recording and walk on.
    Branch,
    /// Find where a condition comes about.
    Find(String),
    /// Go to a place: a frame, or an actor and a number.
    Place(String),
    /// Tell the state of this actor.
    State(String),
    /// Show what each actor did in a frame, or no longer.
    Lanes(bool),
}

/// A recording that one can go through.
pub trait Timeline {
    /// Where it stands.
    fn shown(&self) -> TimelineShown;
    /// Goes to where a frame was shown.
    fn go_to(&mut self, frame: u32);
    /// Goes to the next frame; `false` at the end.
    fn next_frame(&mut self) -> bool;
    /// Makes so many deliveries, or takes them back.
    fn step(&mut self, messages: i64);
    /// Tells the story of a pixel.
    fn why(&mut self, x: u32, y: u32);
    /// Finds where a condition comes about.
    fn find(&mut self, condition: &str);
    /// Goes to a place.
    fn go_to_place(&mut self, place: &str);
    /// Tells an actor's state from now on; that of none where the name is empty.
    fn tell_state(&mut self, actor: &str);
    /// Shows what each actor did in a frame from now on, or no longer.
    fn show_lanes(&mut self, shows: bool);
    /// A walk on from here, with settings, light and camera of this moment; its samples are traced anew.
    ///
    /// # Errors
    /// If no frame has begun, or threads cannot be started.
    fn branch(&mut self) -> Result<Branch, String>;
}

/// A session of actors on the window's thread.
pub trait FrameSource {
    /// The scene.
    fn place(&self) -> Place;
    /// Whether its first path is played from the start, until somebody moves.
    fn plays(&self) -> bool {
        false
    }
    /// Columns and rows of the picture.
    fn size(&self) -> [u32; 2];
    /// What it starts with.
    fn controls(&self) -> Controls;
    /// How far controls go.
    fn ranges(&self) -> Ranges;
    /// What the allocator thought last, and names of objects and textures with it.
    fn insight(&self) -> Option<(&Insight, &Names)>;
    /// The user changed something.
    fn set_controls(&mut self, controls: &Controls);
    /// A frame begins, seen from `camera`.
    fn begin_frame(&mut self, camera: &Camera);
    /// Works for at most `time`; does not use the processor while there is nothing to do.
    fn work(&mut self, time: Duration);
    /// Quality of the view as estimated so far: [`Insight::quality`]; 0 where it has converged, −∞ while nothing is known of
    /// it.
    fn quality(&mut self) -> f32;
    /// Whether the view has all that it gets, and all of it arrived.
    fn is_done(&self) -> bool;
    /// Why nothing more will come, where something went wrong that nobody can mend.
    fn ended(&self) -> Option<String> {
        None
    }
    /// Whether something that was asked for is still being made, on a thread beside.
    fn is_busy(&self) -> bool {
        false
    }
    /// Takes up what a thread beside has made. `false` where there is nothing new.
    fn take_news(&mut self) -> bool {
        false
    }
    /// Whether the last frame shows all that arrived.
    fn is_shown(&self) -> bool {
        true
    }
    /// The frame's time is up: shows what there is, and tells what happened since the frame before.
    fn end_frame(&mut self) -> Vec<Event>;
    /// What is at a pixel of the view that is shown; `None` where that is the environment, or nobody can say.
    fn pick(&self, _x: u32, _y: u32) -> Option<Picked> {
        None
    }
    /// The picture as it was last shown, with tone map and overlay of the controls; `None` before the first.
    fn picture(&mut self) -> Option<Map2d<[u8; 3]>>;
    /// Whether a display draws by itself, and is told of samples for that. Said before the first frame.
    fn set_mirrored(&mut self, _mirrored: bool) {}
    /// Lets a display that draws by itself show what the last frame shows. `false` where there are only finished
    /// pictures, or it has no room.
    fn draw_on(&mut self, _mirror: &mut dyn Mirror) -> bool {
        false
    }
    /// Ends it, as another one is shown instead, without waiting for what its threads have in hand.
    fn leave(self: Box<Self>) -> Ending {
        Ending::default()
    }
    /// Where it stands.
    fn status(&self) -> Status;
    /// What it is made of, for the walk that begins in its place after a [`Change`](crate::change::Change). `None` where it is
    /// a recording, which stays as it was.
    fn opened(&self) -> Option<Opened> {
        None
    }
    /// Names and values that say how a picture came to be, for a screenshot's metadata.
    fn facts(&self) -> Vec<(String, String)>;
    /// Its timeline, where it is a recording.
    fn timeline(&self) -> Option<&dyn Timeline> {
        None
    }
    /// The same, to go through.
    fn timeline_mut(&mut self) -> Option<&mut dyn Timeline> {
        None
    }
}

/// Makes a session on the window's thread, of what was loaded on another.
pub type Build = Box<dyn FnOnce() -> Result<Box<dyn FrameSource>, String> + Send>;

/// Loads the scene at a path, or the first one (again) without path. Called on a thread of its own, so
/// that the window lives on meanwhile.
pub type Loader = Arc<dyn Fn(Option<&Path>) -> Result<Build, String> + Send + Sync>;
