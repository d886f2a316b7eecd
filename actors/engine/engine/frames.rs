//! A frame from its beginning to its end: how long is worked for it, and what is told of it.

use std::sync::Arc;
use std::time::Duration;

use foveal::scene::Camera;
use foveal_actors::insight::{Insight, LONGEST_FRAME};
use foveal_actors::message::{FrameIndex, RendererInput, View};
use foveal_actors::renderer::Renderer;
use foveal_runtime::{Exit, Limit, RecordingStatus, Runtime};

use super::{Engine, Event, Frame, Standing};
use crate::failure::Failure;

/// Longest time for the picture of a frame, once its deadline is over.
const SHOWING: Duration = Duration::from_secs(60);

impl Engine {
    /// A frame seen from `camera`, shown after `time` with what has come until then: its work ends as much earlier as
    /// showing it is foreseen to take.
    ///
    /// # Errors
    /// If the walk has ended: an actor that nothing can go on without failed, or an invariant of a simulation broke.
    pub fn frame(&mut self, camera: &Camera, time: Duration) -> Result<Frame, Failure> {
        self.frame_until(camera, time, None, |_| false)
    }

    /// The same, shown as soon as `enough` holds of the renderer; where a quality is named, not before the view is estimated
    /// to be as good as `least` ([`Insight::quality`]), at most after [`LONGEST_FRAME`].
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn frame_until(
        &mut self,
        camera: &Camera,
        time: Duration,
        least: Option<f32>,
        mut enough: impl FnMut(&Renderer) -> bool,
    ) -> Result<Frame, Failure> {
        let began = self.runtime().now();
        self.begin(camera)?;
        // Whoever gives it much more time than a frame has wants what is best by then.
        if time.as_secs_f32() > 2.0 / self.controls.set.fps {
            self.hurries = false;
            self.runtime().leave_cores(0);
        }
        let taken = self.runtime().now().since(began);
        // Drawing the base layer and composing what is over it take times of one order.
        let showing = if self.showing.is_known() { self.showing() } else { taken };
        self.work_until(time.saturating_sub(taken + showing), &mut enough)?;
        if let Some(least) = least {
            let taken = self.runtime().now().since(began);
            self.work_until_good(least, LONGEST_FRAME.saturating_sub(taken), enough)?;
        }
        self.end()
    }

    /// How long [`Self::end`] will take, by those before it.
    pub fn showing(&self) -> Duration {
        self.showing.expected()
    }

    /// A frame begins, seen from `camera`. Returns once the renderer has drawn its base layer.
    ///
    /// # Errors
    /// If the walk has ended.
    pub fn begin(&mut self, camera: &Camera) -> Result<(), Failure> {
        // A frame that waits for its quality has the time to be drawn whole.
        let time = match self.controls.set.quality {
            Some(_) => LONGEST_FRAME.as_secs_f32(),
            None => 1.0 / self.controls.set.fps,
        };
        let moves = self.before.camera.replace(*camera).is_some_and(|before| before != *camera);
        self.hurries = moves && self.controls.set.quality.is_none();
        self.runtime().leave_cores(if self.hurries { self.drawing_cores } else { 0 });
        self.send(RendererInput::FrameBegan { frame: FrameIndex(self.frame), camera: *camera, time })?;
        // Until the renderer has heard of it, "converged" is said of the view before.
        self.work_until(SHOWING, |renderer| renderer.camera() == Some(*camera))
    }

    /// Works for at most `time`, or until `enough` holds of the renderer.
    ///
    /// A base layer that was drawn sparsely, since the next frame was expected, is drawn whole once nothing else is
    /// left to do and a frame's time is: whoever asks for one frame and waits sees it converge.
    ///
    /// # Errors
    /// If the walk has ended.
    pub fn work_until(
        &mut self,
        time: Duration,
        mut enough: impl FnMut(&Renderer) -> bool,
    ) -> Result<(), Failure> {
        let (renderer, began) = (self.actors.renderer, self.runtime().now());
        let mut until = |runtime: &Runtime| runtime.inspect(renderer, &mut enough) == Some(true);
        if self.pump(Limit::idle_within(time), &mut until)? != Exit::Idle {
            return Ok(());
        }
        let left = |engine: &Self| time.saturating_sub(engine.runtime().now().since(began));
        let period = 1.0 / self.controls.set.fps;
        let sparse = self.look(|r| r.camera().filter(|_| r.is_sparse())).flatten();
        if let Some(camera) = sparse.filter(|_| left(self).as_secs_f32() >= period) {
            self.send(RendererInput::FrameBegan { frame: FrameIndex(self.frame), camera, time: period })?;
        }
        self.pump(Limit::time(left(self)), until).map(drop)
    }

    /// Works for at most `time`, or until the view is estimated to be as good as `least`, or `enough` holds.
    fn work_until_good(
        &mut self,
        least: f32,
        time: Duration,
        mut enough: impl FnMut(&Renderer) -> bool,
    ) -> Result<(), Failure> {
        let (slot, mut insight) = (self.slot.clone(), self.insight.take());
        let worked = self.work_until(time, |renderer| {
            insight = slot.take().or(insight.take());
            enough(renderer) || quality_of(renderer, insight.as_ref()) >= least
        });
        self.insight = insight;
        worked
    }

    /// Works until nobody has anything left to do, at most for `time`. Returns whether that is so.
    ///
    /// # Errors
    /// If the walk has ended.
    pub fn rest(&mut self, time: Duration) -> Result<bool, Failure> {
        self.pump(Limit::idle_within(time), |_| false).map(|exit| exit == Exit::Idle)
    }

    /// The frame's time is up: shows what there is.
    ///
    /// # Errors
    /// If the walk has ended.
    pub fn end(&mut self) -> Result<Frame, Failure> {
        let ended = self.runtime().now();
        let _ = self.newest.frame.pop();
        let index = FrameIndex(self.frame);
        if self.hurries {
            self.runtime().leave_cores(self.drawing_cores.max(1));
        }
        self.send(RendererInput::DeadlineReached { frame: index })?;
        self.frame = self.frame.wrapping_add(1);
        let newest = Arc::clone(&self.newest.frame);
        self.pump(Limit::time(SHOWING), |_| !newest.is_empty())?;
        let Some((snapshot, counts)) = newest.pop() else {
            return Err(Failure::Check(format!(
                "frame {} was not shown within {} s",
                index.0,
                SHOWING.as_secs()
            )));
        };
        self.showing.learn(self.runtime().now().since(ended));
        if self.hurries {
            self.runtime().leave_cores(self.drawing_cores);
        }
        self.listen();
        let frame = Frame {
            index,
            snapshot,
            counts,
            stages: self.stages.take(),
            standing: self.standing(),
            textures: self.opened.textures.as_ref().and_then(|store| store.report.pop()),
            events: self.events(),
        };
        self.shown = Some(frame.clone());
        Ok(frame)
    }

    /// How far the view has come, as far as the last frame shows it.
    pub fn standing(&self) -> Standing {
        self.look(|r| match (r.is_shown(), r.is_converged(), r.is_refined()) {
            (true, true, true) if r.is_supersampled() => Standing::Refined,
            (true, true, _) => Standing::Converged,
            _ => Standing::Growing,
        })
        .unwrap_or(Standing::Growing)
    }

    /// What is new since this was asked last.
    fn events(&mut self) -> Vec<Event> {
        let mut events = Vec::new();
        let standing = self.standing();
        let look = |r: &Renderer| {
            let light = Arc::as_ptr(&r.world().illumination).cast::<()>() as usize;
            (r.drawn().map_or(View(0), |d| d.view), light, r.is_lit())
        };
        let Some((view, light, lit)) = self.look(look) else { return events };
        if self.before.light.replace(light).is_some_and(|before| before != light) {
            events.push(Event::LightGrew);
        }
        if !std::mem::replace(&mut self.before.lit, lit) && lit && self.opened.refinement.is_some() {
            events.push(Event::LightFinal);
        }
        if self.before.standing.replace((view, standing)) != Some((view, standing)) {
            match standing {
                Standing::Growing => {}
                Standing::Converged => events.push(Event::Converged),
                Standing::Refined => events.push(Event::Refined),
            }
        }
        if let (false, RecordingStatus::Stopped { reason }) = (self.before.stopped, self.recording()) {
            self.before.stopped = true;
            events.push(Event::RecordingStopped { reason: reason.to_string() });
        }
        let incidents = self.runtime.as_ref().map(Runtime::incidents).unwrap_or_default();
        events.extend(incidents.into_iter().map(|incident| Event::Incident { what: incident.to_string() }));
        events
    }
}

/// Quality of the renderer's view as the allocator estimated it: 0 where it has converged, −∞ while nothing is known of it.
pub(super) fn quality_of(renderer: &Renderer, insight: Option<&Insight>) -> f32 {
    match insight {
        // Nothing more can be done.
        _ if renderer.is_converged() => 0.0,
        Some(insight) if renderer.drawn().is_some_and(|d| d.view == insight.view) => insight.quality,
        _ => f32::NEG_INFINITY,
    }
}
