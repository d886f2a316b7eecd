//! A walk: input becomes cameras, cameras become frames, each in its time.
//!
//! Knows no window: times are seconds since the start, given by the caller.

mod acts;
mod notices;
mod recorded;
mod times;
mod ways;

use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::foresight::Foresight;
use foveal_actors::insight::{Insight, LONGEST_FRAME};
use foveal_actors::renderer::overlay::Overlay;
use foveal_runtime::Ending;

pub use self::acts::Act;
pub use self::notices::{Notice, Notices};
pub use self::times::FrameTimes;
pub use self::ways::BOOKMARKS;
use self::ways::Ways;
use crate::engine::Event;
use crate::look::Mirror;
use crate::navigation::Navigator;
use crate::opened::Opened;
use crate::source::{Controls, FrameSource, Names, Place, Ranges, Status};

/// Longest stretch of work between two looks at the input.
const SLICE: Duration = Duration::from_millis(8);

/// What the caller does until the next call of [`Walk::tick`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// Call again at once.
    Now,
    /// Call again at this time, or after input.
    At(f64),
    /// Call again after input.
    Input,
}

/// A walk through one scene.
pub struct Walk {
    source: Box<dyn FrameSource>,
    place: Place,
    /// Who walks.
    pub navigator: Navigator,
    controls: Controls,
    ways: Ways,
    /// Begin and camera of the frame that is worked on.
    frame: Option<f64>,
    camera: Option<Camera>,
    /// Camera of the picture on show.
    shown: Option<Camera>,
    last_begin: f64,
    /// Work or display changed, so that a frame must be drawn although nothing moves.
    stale: bool,
    picture: Option<Map2d<[u8; 3]>>,
    /// A display draws by itself, so that frames need no picture.
    mirrored: bool,
    mirror_wanted: bool,
    /// How long the last frames took, until they were on show.
    pub times: FrameTimes,
    /// Begin and end of the last frame, while it is being shown.
    ended: Option<(f64, f64)>,
    /// How long frames are shown after their end, before the next can begin.
    showing: Foresight,
    /// Estimated quality of the picture on show.
    quality: Option<f32>,
    /// When the next frame of a recording is due, while it plays.
    replaying: Option<f64>,
    /// What the user was told last.
    pub notices: Notices,
    /// Sessions that were left and have not quite ended.
    leaving: Vec<Ending>,
}

impl Walk {
    /// Stands at the scene's first camera.
    pub fn new(source: Box<dyn FrameSource>, now: f64) -> Self {
        let place = source.place();
        let start = place.cameras.first().map_or(
            Camera { eye: glam::Vec3::ZERO, target: glam::Vec3::NEG_Z, up: place.up, fov_y: 0.8 },
            |c| c.camera,
        );
        let plays = source.plays();
        let mut walk = Self {
            navigator: Navigator::new(&start, place.up, place.diagonal, now),
            controls: source.controls(),
            ways: Ways::new(&place),
            source,
            place,
            frame: None,
            camera: None,
            shown: None,
            last_begin: f64::NEG_INFINITY,
            stale: true,
            picture: None,
            mirrored: false,
            mirror_wanted: false,
            times: FrameTimes::default(),
            ended: None,
            showing: Foresight::default(),
            quality: None,
            replaying: None,
            notices: Notices::default(),
            leaving: Vec::new(),
        };
        if plays {
            walk.toggle_playing(now);
        }
        walk
    }

    /// The same walk through another version of the scene: camera, bookmarks and controls stay.
    pub fn replace_source(&mut self, mut source: Box<dyn FrameSource>) {
        source.set_controls(&self.controls);
        source.set_mirrored(self.mirrored);
        self.place = source.place();
        self.leave_for(source);
        self.frame = None;
        self.camera = None;
        self.stale = true;
    }

    /// Another scene: a walk through it begins, and this one ends.
    pub fn move_to(&mut self, source: Box<dyn FrameSource>, now: f64) {
        let wanted = self.mirror_wanted;
        let mut next = Self::new(source, now);
        // What is walked through now ends beside the next.
        std::mem::swap(self, &mut next);
        std::mem::swap(&mut self.leaving, &mut next.leaving);
        self.leaving.push(next.source.leave());
        self.set_mirrored(wanted);
    }

    fn leave_for(&mut self, source: Box<dyn FrameSource>) {
        self.leaving.retain(|ending| !ending.is_over());
        let before = std::mem::replace(&mut self.source, source);
        self.leaving.push(before.leave());
    }

    /// What it is made of; nothing where it is a recording.
    pub fn opened(&self) -> Option<Opened> {
        self.source.opened()
    }

    /// The scene.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// What the user set.
    pub fn controls(&self) -> &Controls {
        &self.controls
    }

    /// The user set something.
    pub fn set_controls(&mut self, controls: Controls) {
        if controls == self.controls {
            return;
        }
        self.controls = controls;
        self.source.set_controls(&controls);
        self.stale = true;
        if self.picture.is_some() && !self.mirrored {
            self.picture = self.source.picture();
        }
    }

    /// How far controls go.
    pub fn ranges(&self) -> Ranges {
        self.source.ranges()
    }

    /// What the allocator thought last.
    pub fn insight(&self) -> Option<(&Insight, &Names)> {
        self.source.insight()
    }

    /// The overlay after this one.
    pub fn next_overlay(&mut self) {
        let at = Overlay::ALL.iter().position(|o| *o == self.controls.overlay).unwrap_or(0);
        let overlay = Overlay::ALL[(at + 1) % Overlay::ALL.len()];
        self.set_controls(Controls { overlay, ..self.controls });
    }

    /// Why the walk cannot go on, if it cannot.
    pub fn ended(&self) -> Option<String> {
        self.source.ended()
    }

    /// Where the session stands.
    pub fn status(&self) -> Status {
        self.source.status()
    }

    /// Whether a display draws by itself, with [`Self::draw_on`]; else frames come as pictures.
    pub fn set_mirrored(&mut self, wanted: bool) {
        self.mirror_wanted = wanted;
        // A recording may go back to a frame whose samples nobody traces again.
        let mirrored = wanted && self.source.timeline().is_none();
        if mirrored != self.mirrored {
            self.mirrored = mirrored;
            self.source.set_mirrored(mirrored);
            self.fetch_picture();
        }
    }

    /// Whether frames come without pictures.
    pub fn is_mirrored(&self) -> bool {
        self.mirrored
    }

    /// Lets a display draw what the last frame shows. `false` where it cannot.
    pub fn draw_on(&mut self, mirror: &mut dyn Mirror) -> bool {
        self.source.draw_on(mirror)
    }

    /// Columns and rows of the picture.
    pub fn size(&self) -> [u32; 2] {
        self.source.size()
    }

    /// Makes the picture that is on show, where frames come without.
    pub fn fetch_picture(&mut self) {
        self.picture = self.source.picture();
    }

    /// The picture on show; of a mirrored walk the last that was fetched.
    pub fn picture(&self) -> Option<&Map2d<[u8; 3]>> {
        self.picture.as_ref()
    }

    /// Quality of the picture on show as estimated when it was shown ([`Insight::quality`]), once anything is known of it.
    pub fn quality(&self) -> Option<f32> {
        self.quality
    }

    /// The camera of the picture on show.
    pub fn camera(&self) -> Option<&Camera> {
        self.shown.as_ref()
    }

    /// The camera of the frame that began last.
    pub fn begun(&self) -> Option<&Camera> {
        self.camera.as_ref()
    }

    /// Names and values that say how the picture came to be.
    pub fn facts(&mut self, now: f64) -> Vec<(String, String)> {
        let camera = self.camera_at(now);
        let stands = self.shown == Some(camera);
        let mut facts = self.source.facts();
        facts.extend(self.shown.as_ref().map(crate::screenshot::camera_fact));
        if self.source.timeline().is_none() {
            facts.push(("foveal speed".into(), self.navigator.speed().to_string()));
            facts.push(("foveal at rest".into(), stands.to_string()));
            facts.extend(self.quality.map(|quality| ("foveal quality".into(), quality.to_string())));
        }
        facts
    }

    /// Tells the user something.
    pub fn tell(&mut self, text: String) {
        self.notices.push(Notice { text, failed: false });
    }

    /// Tells the user what went wrong.
    pub fn complain(&mut self, text: String) {
        self.notices.push(Notice { text, failed: true });
    }

    /// Works a little. Returns whether there is a new picture, and when to call again.
    pub fn tick(&mut self, now: f64) -> (bool, Next) {
        if self.source.timeline().is_some() {
            return self.tick_recording(now);
        }
        let period = 1.0 / f64::from(self.controls.set.fps.clamp(0.1, 1000.0));
        let Some(begin) = self.frame else {
            return (false, self.begin(now, period));
        };
        // Of a scene that was just loaded something is to be seen soon: the time of the first coarse samples.
        let is_first = self.shown.is_none();
        let showing = self.showing.expected().as_secs_f64().min(0.5 * period);
        let mut deadline = begin + if is_first { 0.3 * period } else { period - showing };
        if let Some(least) = self.controls.set.quality.filter(|_| !is_first && now >= deadline)
            && self.source.quality() < least
        {
            deadline = begin + LONGEST_FRAME.as_secs_f64();
        }
        if now < deadline && !self.source.is_done() {
            self.source.work(SLICE.min(Duration::from_secs_f64(deadline - now)));
            return (false, Next::Now);
        }
        // (Without its sign, 0 is told as 0.)
        self.quality = Some(self.source.quality() + 0.0).filter(|quality| quality.is_finite());
        for event in self.source.end_frame() {
            self.hear(event);
        }
        self.frame = None;
        self.ended = Some((begin, now));
        // A session that hears of its end of frame on this thread shows it while it works.
        self.source.work(Duration::ZERO);
        if !self.mirrored {
            self.picture = self.source.picture();
        }
        self.shown = self.camera;
        (true, Next::Now)
    }

    /// Says what whoever looks on should know of; the rest is seen in the status.
    fn hear(&mut self, event: Event) {
        match event {
            Event::Incident { what } => self.complain(what),
            Event::RecordingStopped { reason } => self.complain(format!("the recording ends here: {reason}")),
            Event::LightGrew | Event::LightFinal | Event::Converged | Event::Refined => {}
        }
    }

    fn begin(&mut self, now: f64, period: f64) -> Next {
        if let Some((began, ended)) = self.ended.take() {
            self.times.push(Duration::from_secs_f64((now - began).max(0.0)));
            // The picture was composed and painted meanwhile, which is part of the frame's time.
            self.showing.learn(Duration::from_secs_f64((now - ended).clamp(0.0, 0.5 * period)));
        }
        let camera = self.camera_at(now);
        let moved = self.camera != Some(camera);
        let all_shown = self.source.is_done() && self.source.is_shown();
        if !moved && !self.stale && all_shown {
            return if self.navigator.is_moving() || self.ways.is_playing() {
                Next::Now
            } else {
                Next::Input
            };
        }
        // Not earlier than a period after the frame before, unless that took longer.
        let next = self.last_begin + period;
        if now < next && self.camera.is_some() {
            return Next::At(next);
        }
        self.record_key(&camera, now, period);
        self.last_begin = now;
        self.camera = Some(camera);
        self.stale = false;
        self.frame = Some(now);
        self.source.begin_frame(&camera);
        Next::Now
    }
}

#[cfg(test)]
mod tests;
