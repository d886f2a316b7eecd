//! A recording as something to look at: frames that one scrubs through, stories of pixels, and a walk that branches off.

use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use foveal::display::tone::Encoder;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::{Adjustment, Settings};

use super::source::{Source, Telling};
use super::stepper::Stepper;
use crate::engine::{Engine, Event};
use crate::failure::Failure;
use crate::look;
use crate::opened::Opened;
use crate::options::Options;
use crate::recording::program;
use crate::source::{Branch, Controls, FrameSource, Names, Place, Ranges, Status, Timeline, TimelineShown};

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
    }
}

impl Timeline for Player {
    fn shown(&self) -> TimelineShown {
        TimelineShown {
            frames: self.source.shown_in.len() as u32,
            frame: self.stepper.frame(),
            position: self.stepper.positions(),
            lines: self.lines.iter().cloned().collect(),
            story: self.story.clone(),
        }
    }

    fn go_to(&mut self, frame: u32) {
        let done = self.source.frame_shown(frame).and_then(|place| self.stepper.go(Some(place)));
        self.after(done);
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
        self.story = self.stepper.why((x, y)).unwrap_or_else(|e| vec![e.to_string()]);
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
}

impl Way {
    /// The walk, on this thread.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub(super) fn start(self, controls: &Controls) -> Result<Branch, String> {
        let Self { camera, settings, quality, opened, facts } = self;
        let fps = Some(controls.set.fps);
        let options = Options { fps, quality, facts, ..Options::interactive(settings) };
        let source = Engine::start(opened, options).map_err(|e| e.to_string())?;
        Ok(Branch { source: Box::new(source), camera })
    }
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
        let opened = Opened { light, as_read, ..Opened::of_world(world) };
        let quality = adjusted.and_then(|adjusted| adjusted.quality);
        Ok(Way { camera, settings, quality, opened, facts: self.facts() })
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
