//! A walk at work as a window shows it.

use std::sync::atomic::Ordering;
use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::{FrameCounts, Renderer};
use foveal_runtime::Ending;

use super::frames::quality_of;
use super::{Engine, Event, Frame, LEAVING, Standing};
use crate::failure::Failure;
use crate::look::{self, Mirror};
use crate::opened::Opened;
use crate::pick::Picked;
use crate::source::{Controls, FrameSource, Names, Place, Ranges, Status};

/// What cannot be done is told to people, who see the picture stand still.
fn told(done: Result<(), Failure>) {
    if let Err(e) = done {
        tracing::warn!("{e}");
    }
}

impl FrameSource for Engine {
    fn place(&self) -> Place {
        let scene = &self.opened.world.scene;
        let (mut cameras, mut paths) = (scene.cameras.clone(), scene.paths.clone());
        // The first of both is what one begins with.
        if let Some(first) = cameras.get_mut(..=self.begins.camera) {
            first.rotate_right(1);
        }
        if let Some(first) = self.begins.path.and_then(|path| paths.get_mut(..=path)) {
            first.rotate_right(1);
        }
        Place {
            title: scene.title.clone(),
            up: scene.up,
            diagonal: scene.diagonal(),
            cameras,
            paths,
            lamps: self.opened.lamps(),
        }
    }

    fn plays(&self) -> bool {
        self.begins.path.is_some()
    }

    fn size(&self) -> [u32; 2] {
        [self.settings.width, self.settings.height]
    }

    fn controls(&self) -> Controls {
        self.controls
    }

    fn ranges(&self) -> Ranges {
        self.ranges
    }

    fn insight(&self) -> Option<(&Insight, &Names)> {
        self.insight.as_ref().map(|insight| (insight, &self.names))
    }

    fn set_controls(&mut self, controls: &Controls) {
        told(self.set(controls));
    }

    fn begin_frame(&mut self, camera: &Camera) {
        told(self.begin(camera));
    }

    fn work(&mut self, time: Duration) {
        told(self.work_until(time, Renderer::is_refined));
    }

    fn end_frame(&mut self) -> Vec<Event> {
        self.end().map(|frame| frame.events).unwrap_or_else(|e| {
            tracing::warn!("{e}");
            Vec::new()
        })
    }

    fn pick(&self, x: u32, y: u32) -> Option<Picked> {
        self.look(|renderer| {
            let drawn = renderer.drawn()?;
            let hits = &drawn.buffers().hit;
            if x as usize >= hits.width() || y as usize >= hits.height() {
                return None;
            }
            let hit = hits.at(x as usize, y as usize).hit()?;
            Some(Picked::at(&drawn.world.scene, &drawn.frame, (x, y), &hit))
        })?
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        self.listen();
        let (controls, insight) = (self.controls, self.insight.as_ref());
        // A mirror draws what has come since the frame was shown, too.
        let newest = self.newest.mirrored.load(Ordering::Relaxed);
        self.look(|renderer| {
            look::picture(renderer, &self.opened.world, &controls, insight, &self.encoder, newest)
        })?
    }

    fn set_mirrored(&mut self, mirrored: bool) {
        self.newest.mirrored.store(mirrored, Ordering::Relaxed);
    }

    fn draw_on(&mut self, mirror: &mut dyn Mirror) -> bool {
        self.listen();
        while let Some((view, splats)) = self.newest.splats.pop() {
            if view != self.splats.0 {
                self.splats = (view, Vec::new());
            }
            self.splats.1.push(splats);
        }
        let (controls, insight, footprint) = (self.controls, self.insight.as_ref(), self.settings.footprint);
        let splats = (self.splats.0, &*self.splats.1);
        self.look(|r| look::draw_on(r, &controls, insight, splats, footprint, mirror)).unwrap_or(false)
    }

    fn quality(&mut self) -> f32 {
        self.listen();
        self.look(|renderer| quality_of(renderer, self.insight.as_ref())).unwrap_or(0.0)
    }

    fn is_done(&self) -> bool {
        self.look(Renderer::is_refined).unwrap_or(true)
    }

    fn is_shown(&self) -> bool {
        self.look(Renderer::is_shown).unwrap_or(true)
    }

    fn leave(mut self: Box<Self>) -> Ending {
        self.end_work();
        // A recording is to have its end, if that comes soon; of other sessions nobody would see it.
        let time = if self.recorded { LEAVING } else { Duration::ZERO };
        self.runtime.take().map(|runtime| runtime.leave(time)).unwrap_or_default()
    }

    fn ended(&self) -> Option<String> {
        self.runtime.as_ref()?.ended().map(ToString::to_string)
    }

    fn status(&self) -> Status {
        let (view, converged, lit) = self
            .look(|r| (r.drawn().map_or(0, |d| d.view.0), r.is_converged(), r.is_lit()))
            .unwrap_or((0, true, true));
        let refined = self.look(|r| r.is_refined() && r.is_supersampled()).unwrap_or(false);
        let counts = self.shown.as_ref().map_or_else(FrameCounts::default, |frame| frame.counts);
        Status {
            view,
            converged,
            refined,
            lit,
            traced: counts.traced,
            reused: counts.reused,
            expired: counts.expired,
            supersampled: counts.refined,
            actors: self.runtime.as_ref().map(look::actors).unwrap_or_default(),
            stations: self.actors.board.read(),
        }
    }

    fn opened(&self) -> Option<Opened> {
        // A recording begins with light that its replay finds by itself, too.
        Some(if self.recorded { self.opened.clone() } else { self.as_lit() })
    }

    fn facts(&self) -> Vec<(String, String)> {
        let mut facts = self.facts.clone();
        let scene = &self.opened.world.scene;
        let hash: String = scene.content_hash.iter().map(|b| format!("{b:02x}")).collect();
        facts.push(("foveal scene".into(), format!("{} {hash}", scene.name)));
        if let Ok(settings) = serde_json::to_string(&self.settings) {
            facts.push(("foveal settings".into(), settings));
        }
        if let Ok(set) = serde_json::to_string(&self.controls.set) {
            facts.push(("foveal controls".into(), set));
        }
        let of = |frame: &Frame| (frame.snapshot.drawn.view.0, frame.standing);
        let (view, standing) = self.shown.as_ref().map_or((0, Standing::Growing), of);
        facts.push(("foveal view".into(), format!("{view}, {}", standing.name())));
        facts.push((
            "foveal display".into(),
            format!("{:?}, {}", self.controls.set.tone, self.controls.overlay.name()),
        ));
        facts
    }
}
