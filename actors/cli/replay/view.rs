//! `foveal replay --view`: a recording in the window, with a timeline to scrub, step and play, stories of pixels, and a
//! walk that branches off.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use foveal::display::tone::{Encoder, ToneMap};
use foveal::image::Map2d;
use foveal::scene::Camera;

use super::source::Source;
use super::step::{Session, Teller};
use super::{ReplayArguments, why};
use crate::cli::Progress;
use crate::cli::failure::Failure;
use crate::insight::Insight;
use crate::renderer::overlay::Overlay;
use crate::settings::Adjustment;
use crate::window::source::{Branch, Names, Timeline, TimelineShown};
use crate::window::{
    self, Backend, Build, Controls, DrawnBy, FrameSource, Loader, Made, Place, Ranges, Status, WindowError,
};

/// Lines of deliveries that are kept on show.
const LINES: usize = 12;

/// Opens the window.
pub fn run(a: &ReplayArguments, file: PathBuf, workers: usize) -> Result<(), Failure> {
    let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let size = super::open_trace(&file)
        .and_then(|trace| super::RecordedRun::of(&trace, &file))
        .map(|run| [run.settings.width, run.settings.height + window::timeline::HEIGHT as u32])?;
    let (scene, elsewhere) = (a.scene.clone(), a.elsewhere.clone());
    let loader: Loader = Arc::new(move |dropped| {
        let file = dropped.unwrap_or(&file).to_path_buf();
        let quiet = Progress { shown: false };
        let source =
            Source::open(&file, scene.as_deref(), &elsewhere, false, quiet).map_err(|e| e.to_string())?;
        let build: Build = Box::new(move || {
            let player = Player::new(source, workers).map_err(|e| e.to_string())?;
            Ok(Box::new(player) as Box<dyn FrameSource>)
        });
        Ok(build)
    });
    let options = window::Options {
        name,
        size,
        backend: Backend::Auto,
        drawn_by: DrawnBy::Auto,
        lose_adapter: None,
        lose_surface: None,
        screenshots: a.screenshots.clone(),
        loader,
        probe: None,
    };
    window::run(options).map(drop).map_err(|e| match e {
        WindowError::Environment(m) => Failure::Environment(m),
        WindowError::Scene(m) => Failure::Input(m),
    })
}

/// A recording that is looked at.
struct Player {
    source: Rc<Source>,
    session: Session,
    workers: usize,
    controls: Controls,
    encoder: Encoder,
    lines: VecDeque<String>,
    story: Vec<String>,
    names: Names,
    insight: Option<Insight>,
}

impl Player {
    fn new(source: Source, workers: usize) -> Result<Self, Failure> {
        let source = Rc::new(source);
        let session = Session::new(Rc::clone(&source), workers, Teller::Kept(Vec::new()))?;
        let (scene, settings) = (&source.world().scene, &source.recorded.settings);
        let set = Adjustment {
            fps: 10.0,
            quality: None,
            workers: settings.tracers,
            policy: settings.policy.policy,
            saliency_weight: settings.saliency_weight,
            samples_per_job: settings.samples_per_job,
            ageing: settings.ageing,
            environment_bytes: settings.environment_bytes,
            texture_bytes: None,
            refine: settings.supersampling,
            tone: ToneMap::from(&scene.display),
        };
        let names = Names {
            objects: scene.objects.iter().map(|o| o.name.clone()).collect(),
            textures: scene.textures.iter().map(|t| t.name.clone()).collect(),
        };
        let mut player = Self {
            session,
            workers,
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
        self.lines.extend(self.session.told());
        if let Err(e) = done {
            self.lines.push_back(e.to_string());
        }
        while self.lines.len() > LINES {
            self.lines.pop_front();
        }
        self.insight = self.session.insight();
        self.story.clear();
    }
}

impl Timeline for Player {
    fn shown(&self) -> TimelineShown {
        TimelineShown {
            frames: self.source.shown_in.len() as u32,
            frame: self.session.frame(),
            position: self.session.positions(),
            lines: self.lines.iter().cloned().collect(),
            story: self.story.clone(),
        }
    }

    fn go_to(&mut self, frame: u32) {
        let done = self.source.frame_shown(frame).and_then(|place| self.session.go(Some(place)));
        self.after(done);
    }

    fn next_frame(&mut self) -> bool {
        let before = self.session.frame();
        let done = self.session.next_frame();
        self.after(done);
        self.session.frame() != before
    }

    fn step(&mut self, messages: i64) {
        let count = messages.unsigned_abs();
        let done = if messages < 0 { self.session.back(count) } else { self.session.forward(count) };
        self.after(done);
    }

    fn why(&mut self, x: u32, y: u32) {
        self.story = match self.session.frame() {
            None => vec!["no frame is shown yet".into()],
            frame => {
                why::story(&self.source, (x, y), frame, self.workers).unwrap_or_else(|e| vec![e.to_string()])
            }
        };
    }

    fn branch(&mut self) -> Result<Branch, String> {
        let camera = self.session.look(|r| r.camera()).flatten().ok_or("no frame has begun yet")?;
        let adjusted = self.session.look(|r| r.adjustment().copied()).flatten();
        let mut settings = self.source.recorded.settings;
        if let Some(adjusted) = &adjusted {
            settings.adjust(adjusted);
        }
        let source = window::Session::start(Made {
            world: self.session.look(|r| r.world().clone()).ok_or("nothing is shown yet")?,
            probes: None,
            textures: None,
            refinement: None,
            settings,
            fps: self.controls.set.fps,
            quality: adjusted.and_then(|adjusted| adjusted.quality),
            facts: self.facts(),
            recording: None,
        })?;
        Ok(Branch { source: Box::new(source), camera })
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

    /// What was recorded stays: only exposure, tone map, overlay and speed of playing change.
    fn set_controls(&mut self, controls: &Controls) {
        let set = Adjustment { fps: controls.set.fps, tone: controls.set.tone, ..self.controls.set };
        self.controls = Controls { set, overlay: controls.overlay };
    }

    fn begin_frame(&mut self, _camera: &Camera) {}

    fn work(&mut self, _time: Duration) {}

    fn end_frame(&mut self) {}

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        let (world, controls) = (self.source.world(), &self.controls);
        let (insight, encoder) = (self.insight.as_ref(), &self.encoder);
        self.session.look(|r| window::look::picture(r, world, controls, insight, encoder, true)).flatten()
    }

    fn quality(&mut self) -> f32 {
        self.insight.as_ref().map_or(f32::NEG_INFINITY, |insight| insight.quality)
    }

    fn is_done(&self) -> bool {
        true
    }

    fn status(&self) -> Status {
        let (view, converged, refined) = self
            .session
            .look(|r| {
                (r.drawn().map_or(0, |d| d.view.0), r.is_converged(), r.is_refined() && r.is_supersampled())
            })
            .unwrap_or_default();
        Status {
            view,
            converged,
            refined,
            lit: true,
            actors: window::look::actors(self.session.runtime()),
            ..Status::default()
        }
    }

    fn facts(&self) -> Vec<(String, String)> {
        vec![
            ("Software".to_owned(), super::program()),
            ("foveal recording".to_owned(), self.source.path.display().to_string()),
            ("foveal frame".to_owned(), self.session.frame().map_or_else(String::new, |f| f.to_string())),
        ]
    }

    fn timeline(&self) -> Option<&dyn Timeline> {
        Some(self)
    }

    fn timeline_mut(&mut self) -> Option<&mut dyn Timeline> {
        Some(self)
    }
}
