//! A recording as something to look at: frames that one scrubs through, stories of pixels, and a walk that branches off.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use foveal::display::tone::Encoder;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::{Adjustment, Settings};

use super::lanes::{Lanes, Timed};
use super::late::critical_path;
use super::source::{Source, Telling};
use super::stepper::Stepper;
use super::when::{Condition, when};
use super::why_path::Segment;
use crate::engine::{Engine, Event};
use crate::failure::Failure;
use crate::look;
use crate::opened::Opened;
use crate::options::{Options, Recording};
use crate::recording::{Parent, program};
use crate::source::{
    Branch, Controls, FrameSource, LaneSlice, LanesShown, Names, Place, Ranges, Status, Timeline,
    TimelineShown,
};

/// Places that a search shows at most.
const FOUND_SHOWN: usize = 200;
/// Lines of deliveries that are kept on show.
const LINES: usize = 12;

/// A recording that is looked at.
pub struct Player {
    source: Rc<Source>,
    stepper: Stepper,
    controls: Controls,
    encoder: Encoder,
    lines: VecDeque<String>,
    story: Vec<String>,
    path: Vec<Segment>,
    /// Whose state is told; nobody's where it is empty.
    told_of: String,
    state: Vec<String>,
    found: Vec<(String, String)>,
    shows_lanes: bool,
    lanes: Option<Arc<LanesShown>>,
    workers: usize,
    /// Where walks that leave it are recorded, if anywhere.
    records_into: Option<PathBuf>,
    names: Names,
    insight: Option<Insight>,
}

impl Player {
    /// At its first frame.
    ///
    /// # Errors
    /// If it cannot be replayed.
    pub fn new(source: Source, workers: usize) -> Result<Self, Failure> {
        let source = Rc::new(source);
        let stepper = Stepper::new(Rc::clone(&source), workers, Telling::Nothing)?;
        let (scene, settings) = (&source.world().scene, &source.recorded.settings);
        let set = Adjustment::of(settings, &scene.display);
        let names = Names {
            objects: scene.objects.iter().map(|o| o.name.clone()).collect(),
            textures: scene.textures.iter().map(|t| t.name.clone()).collect(),
        };
        let mut player = Self {
            stepper,
            controls: Controls { set, overlay: Overlay::None },
            encoder: Encoder::default(),
            lines: VecDeque::new(),
            story: Vec::new(),
            path: Vec::new(),
            told_of: String::new(),
            state: Vec::new(),
            found: Vec::new(),
            shows_lanes: false,
            lanes: None,
            workers,
            records_into: None,
            names,
            insight: None,
            source,
        };
        player.go_to(0);
        Ok(player)
    }

    /// Takes over what an operation said, and what the actors are like after it.
    fn after(&mut self, done: Result<(), Failure>) {
        self.lines.extend(self.stepper.told());
        if let Err(e) = done {
            self.lines.push_back(e.to_string());
        }
        while self.lines.len() > LINES {
            self.lines.pop_front();
        }
        self.insight = self.stepper.insight();
        self.story.clear();
        self.path.clear();
        self.look_at_state();
        self.lanes = None;
    }

    /// Walks that leave it are recorded into this file from now on.
    pub fn record_into(&mut self, file: Option<PathBuf>) {
        self.records_into = file;
    }

    fn look_at_state(&mut self) {
        self.state = match &*self.told_of {
            "" => Vec::new(),
            actor => match self.stepper.state(actor) {
                Ok(state) => state.lines(),
                Err(e) => vec![e.to_string()],
            },
        };
    }

    /// What each actor did in the frame on show.
    fn look_at_lanes(&mut self) {
        let (true, Some(frame)) = (self.shows_lanes, self.stepper.frame()) else { return };
        match lanes(&self.source, frame, self.workers) {
            Ok(lanes) => self.lanes = Some(Arc::new(lanes)),
            Err(e) => self.lines.push_back(e.to_string()),
        }
    }
}

/// A frame's lanes: of the actors that were told something in it.
fn lanes(source: &Source, frame: u32, workers: usize) -> Result<LanesShown, Failure> {
    let lanes = Lanes::of_frames(source, frame, frame, workers)?;
    let (first, last) = (lanes.began(source, frame), lanes.shown(source, frame));
    let critical =
        first.zip(last).map(|(first, last)| critical_path(&lanes, first, last)).unwrap_or_default();
    let begin = first.map_or(0, |first| lanes.all[first].start_ns);
    let end = last.map_or_else(
        || lanes.all.iter().map(Timed::end_ns).max().unwrap_or(begin),
        |last| lanes.all[last].end_ns(),
    );
    let mut numbers = Vec::new();
    let (mut places, mut slices) = (vec![None; lanes.all.len()], Vec::new());
    for (place, timed) in lanes.all.iter().enumerate().filter(|(_, t)| t.start_ns < end) {
        let actor = timed.seen.actor;
        let lane = numbers.iter().position(|number| *number == actor).unwrap_or_else(|| {
            numbers.push(actor);
            numbers.len() - 1
        });
        places[place] = Some(slices.len());
        slices.push(LaneSlice {
            lane,
            start_ns: timed.start_ns.saturating_sub(begin),
            duration_ns: timed.end_ns() - timed.start_ns.max(begin),
            kind: timed.seen.kind,
            at: source.at((actor, timed.seen.index)),
            is_critical: critical.contains(&place),
        });
    }
    let arrow = |(from, to): &(usize, usize)| Some((places[*from]?, places[*to]?));
    Ok(LanesShown {
        names: numbers.iter().map(|number| source.name(*number).to_owned()).collect(),
        whole_ns: end.saturating_sub(begin),
        slices,
        arrows: lanes.causes.iter().filter_map(arrow).collect(),
    })
}

impl Timeline for Player {
    fn shown(&self) -> TimelineShown {
        TimelineShown {
            frames: self.source.shown_in.len() as u32,
            frame: self.stepper.frame(),
            position: self.stepper.positions(),
            lines: self.lines.iter().cloned().collect(),
            story: self.story.clone(),
            path: self.path.clone(),
            actors: {
                let nodes = &self.source.trace.header().nodes;
                nodes.iter().filter(|node| node.class.is_some()).map(|node| node.name.clone()).collect()
            },
            state: (self.told_of.clone(), self.state.clone()),
            found: self.found.clone(),
            lanes: self.lanes.clone(),
            parted: None,
        }
    }

    fn go_to(&mut self, frame: u32) {
        let done = self.source.frame_shown(frame).and_then(|place| self.stepper.go(Some(place)));
        self.after(done);
        self.look_at_lanes();
    }

    fn next_frame(&mut self) -> bool {
        let before = self.stepper.frame();
        let done = self.stepper.next_frame();
        self.after(done);
        self.stepper.frame() != before
    }

    fn step(&mut self, messages: i64) {
        let count = messages.unsigned_abs();
        let done = if messages < 0 { self.stepper.back(count) } else { self.stepper.forward(count) };
        self.after(done);
    }

    fn why(&mut self, x: u32, y: u32) {
        let told = self.stepper.why((x, y));
        (self.story, self.path) = told.unwrap_or_else(|e| (vec![e.to_string()], Vec::new()));
    }

    fn find(&mut self, condition: &str) {
        let found = Condition::parse(condition)
            .map_err(Failure::Usage)
            .and_then(|condition| when(&self.source, &condition, self.workers));
        self.found = match found {
            Ok(found) if found.is_empty() => vec![("it never comes about".into(), String::new())],
            Ok(found) => found
                .iter()
                .take(FOUND_SHOWN)
                .map(|met| {
                    let at = self.source.at(met.at);
                    (format!("{at}: {met}"), at)
                })
                .collect(),
            Err(e) => vec![(e.to_string(), String::new())],
        };
    }

    fn go_to_place(&mut self, place: &str) {
        let done = self.source.place(place).and_then(|place| self.stepper.go(Some(place)));
        self.after(done);
        self.look_at_lanes();
    }

    fn tell_state(&mut self, actor: &str) {
        actor.clone_into(&mut self.told_of);
        self.look_at_state();
    }

    fn show_lanes(&mut self, shows: bool) {
        (self.shows_lanes, self.lanes) = (shows, None);
        self.look_at_lanes();
    }

    fn branch(&mut self) -> Result<Branch, String> {
        self.way()?.start(&self.controls)
    }
}

/// What a walk on from a moment of a recording is made of.
#[derive(Clone)]
pub(super) struct Way {
    camera: Camera,
    settings: Settings,
    quality: Option<f32>,
    opened: Opened,
    facts: Vec<(String, String)>,
    /// The recording that is left, and the frame on show.
    parent: (PathBuf, u32),
    records_into: Option<PathBuf>,
}

impl Way {
    /// The walk, on this thread.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub(super) fn start(self, controls: &Controls) -> Result<Branch, String> {
        let Self { camera, settings, quality, opened, facts, parent, records_into } = self;
        let fps = Some(controls.set.fps);
        let mut file = records_into;
        // One walk, one file: what was recorded stays.
        while let Some(taken) = file.as_mut().filter(|file| file.exists()) {
            *taken = next_name(taken);
        }
        let recording = file.as_ref().map(|file| Recording::file(file, "replay"));
        // Only where it is said: the file may be large.
        let parent = file.is_some().then(|| {
            let (recording, frame) = parent;
            Parent { hash: Parent::hash_of(&recording), recording, frame }
        });
        let options = Options { fps, quality, facts, recording, parent, ..Options::interactive(settings) };
        let source = Engine::start(opened, options).map_err(|e| e.to_string())?;
        Ok(Branch { source: Box::new(source), camera, recorded: file })
    }
}

/// `walk.fvl`, `walk-2.fvl`, `walk-3.fvl`, …
fn next_name(file: &Path) -> PathBuf {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (name, number) = match stem.rsplit_once('-') {
        Some((name, number)) if number.parse::<u32>().is_ok() => (name, number.parse().unwrap_or(1)),
        _ => (&*stem, 1_u32),
    };
    let mut next = std::ffi::OsString::from(format!("{name}-{}", number.saturating_add(1)));
    if let Some(extension) = file.extension() {
        next.push(".");
        next.push(extension);
    }
    file.with_file_name(next)
}

/// Controls as a recording takes them: what was recorded stays, only exposure, tone map, overlay and speed of playing
/// change.
pub(super) fn adopted(before: &Controls, wanted: &Controls) -> Controls {
    let set = Adjustment { fps: wanted.set.fps, tone: wanted.set.tone, ..before.set };
    Controls { set, overlay: wanted.overlay }
}

impl Player {
    /// The recording.
    pub(super) fn source(&self) -> &Source {
        &self.source
    }

    /// Names of its objects and textures.
    pub(super) fn names(&self) -> Names {
        self.names.clone()
    }

    /// The walk that leaves it here.
    ///
    /// # Errors
    /// If no frame has begun yet.
    pub(super) fn way(&self) -> Result<Way, String> {
        let camera = self.stepper.look(|r| r.camera()).flatten().ok_or("no frame has begun yet")?;
        let adjusted = self.stepper.look(|r| r.adjustment().copied()).flatten();
        let mut settings = self.source.recorded.settings;
        if let Some(adjusted) = &adjusted {
            settings.adjust(adjusted);
        }
        let world = self.stepper.look(|r| r.world().clone()).ok_or("nothing is shown yet")?;
        // Edits are against what the files say, here as before.
        let recorded = self.source.opened();
        let (light, as_read) = (recorded.light.clone(), recorded.as_read.clone());
        let opened = Opened { path: recorded.path.clone(), light, as_read, ..Opened::of_world(world) };
        let quality = adjusted.and_then(|adjusted| adjusted.quality);
        let parent = (self.source.path.clone(), self.stepper.frame().unwrap_or(0));
        let records_into = self.records_into.clone();
        Ok(Way { camera, settings, quality, opened, facts: self.facts(), parent, records_into })
    }
}

impl FrameSource for Player {
    fn place(&self) -> Place {
        let scene = &self.source.world().scene;
        Place {
            title: format!("{}, recorded", scene.title),
            up: scene.up,
            diagonal: scene.diagonal(),
            cameras: scene.cameras.clone(),
            paths: scene.paths.clone(),
            lamps: Vec::new(),
        }
    }

    fn size(&self) -> [u32; 2] {
        [self.source.recorded.settings.width, self.source.recorded.settings.height]
    }

    fn controls(&self) -> Controls {
        self.controls
    }

    fn ranges(&self) -> Ranges {
        Ranges { workers: self.source.recorded.settings.tracers, textures: None }
    }

    fn insight(&self) -> Option<(&Insight, &Names)> {
        self.insight.as_ref().map(|insight| (insight, &self.names))
    }

    fn set_controls(&mut self, controls: &Controls) {
        self.controls = adopted(&self.controls, controls);
    }

    fn begin_frame(&mut self, _camera: &Camera) {}

    fn work(&mut self, _time: Duration) {}

    fn end_frame(&mut self) -> Vec<Event> {
        Vec::new()
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        let (world, controls) = (self.source.world(), &self.controls);
        let (insight, encoder) = (self.insight.as_ref(), &self.encoder);
        self.stepper.look(|r| look::picture(r, world, controls, insight, encoder, true)).flatten()
    }

    fn quality(&mut self) -> f32 {
        self.insight.as_ref().map_or(f32::NEG_INFINITY, |insight| insight.quality)
    }

    fn is_done(&self) -> bool {
        true
    }

    fn status(&self) -> Status {
        let (view, converged, refined) = self
            .stepper
            .look(|r| {
                (r.drawn().map_or(0, |d| d.view.0), r.is_converged(), r.is_refined() && r.is_supersampled())
            })
            .unwrap_or_default();
        Status {
            view,
            converged,
            refined,
            lit: true,
            actors: look::actors(self.stepper.runtime()),
            ..Status::default()
        }
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![
            ("Software".to_owned(), program()),
            ("foveal recording".to_owned(), self.source.path.display().to_string()),
            ("foveal frame".to_owned(), self.stepper.frame().map_or_else(String::new, |f| f.to_string())),
        ]
    }

    fn timeline(&self) -> Option<&dyn Timeline> {
        Some(self)
    }

    fn timeline_mut(&mut self) -> Option<&mut dyn Timeline> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Elsewhere;

    /// A walk that leaves a recording is recorded with where it left, and replays from there.
    #[test]
    fn a_walk_on_from_a_recording_names_it_and_replays() {
        let folder = tempfile::tempdir().expect("a folder");
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let elsewhere = Elsewhere {
            scene: Some(root.join("scenes/gallery/gallery.toml")),
            cache: Some(folder.path().join("cache")),
            ..Elsewhere::default()
        };
        let (parent, child) = (folder.path().join("gallery.fvl"), folder.path().join("on.fvl"));
        std::fs::copy(root.join("traces/gallery.fvl"), &parent).expect("copied");
        std::fs::write(&child, "another recording").expect("written");
        let source = Source::open(&parent, &elsewhere, true, &()).expect("a recording");
        let mut player = Player::new(source, 1).expect("a player");
        player.record_into(Some(child.clone()));
        player.go_to(3);
        let Branch { mut source, camera, recorded } = player.branch().unwrap_or_else(|e| panic!("{e}"));
        let child = recorded.expect("it is recorded");
        assert_eq!(child, folder.path().join("on-2.fvl"), "what was there stays");
        let mut shown = Vec::new();
        for _ in 0..3 {
            source.begin_frame(&camera);
            source.work(Duration::from_millis(30));
            source.end_frame();
            shown.push(source.picture().expect("a picture"));
        }
        drop(source);
        let again = Source::open(&child, &elsewhere, true, &()).expect("the walk on");
        let named = again.recorded.parent.clone().expect("a parent");
        assert_eq!((named.frame, named.recording.as_path()), (3, parent.as_path()));
        assert_eq!(named.find(&child).expect("there"), parent);
        assert!(again.shown_in.len() >= 2, "{:?}", again.shown_in);
        let (runtime, _) = again.run(super::super::How::default(), |_| ()).expect("a replay");
        assert!(!runtime.diverged(), "{:?}", runtime.ended());
        // Another file in its place is named.
        std::fs::write(&parent, "other").expect("written");
        let failure = named.find(&child).expect_err("another one").to_string();
        assert!(failure.contains("frame 3") && failure.contains("another recording"), "{failure}");
        std::fs::remove_file(&parent).expect("removed");
        let failure = named.find(&child).expect_err("gone").to_string();
        assert!(failure.contains("neither here nor beside"), "{failure}");
    }

    #[test]
    fn files_that_are_taken_are_counted_on_from() {
        for (file, next) in
            [("a/on.fvl", "a/on-2.fvl"), ("on-2.fvl", "on-3.fvl"), ("x-y.fvl", "x-y-2.fvl"), ("on", "on-2")]
        {
            assert_eq!(next_name(Path::new(file)), Path::new(next), "{file}");
        }
    }
}
