//! Which parts of the machine a walk runs, and what its actors are made of: one place for walks, replays and simulations.

use std::sync::Arc;

use foveal::display::cpu_pass::Passes;
use foveal::display::first_approximation::Probes;
use foveal::scene::plan::{ScenePlan, Subsystem};
use foveal_actors::insight::InsightSlot;
use foveal_actors::renderer::FrameSink;
use foveal_actors::settings::Settings;
use foveal_actors::stages::StageTimes;
use foveal_actors::wiring::Parts;

use crate::opened::Opened;

/// Which parts of the machine run.
#[derive(Clone, Copy, Debug)]
pub struct Machine {
    /// Settings of all actors.
    pub settings: Settings,
    /// What the display pass fills.
    pub passes: Passes,
    /// Whether anything is corrected; if not, only the renderer is started.
    pub corrects: bool,
}

impl Machine {
    /// What a plan needs, or all of it.
    pub fn new(opened: &Opened, settings: &Settings, plan: &ScenePlan, whole: bool) -> Self {
        // The overlay of mip levels shows the texture ids.
        let texture_ids = if whole {
            !opened.world.scene.textures.is_empty()
        } else {
            plan.needs(Subsystem::TextureIdPass)
        };
        // Textures under pressure need somebody to decide and to load, edges somebody to smooth them.
        let corrects = whole
            || plan.needs(Subsystem::Tracers)
            || opened.textures.is_some()
            || settings.supersampling.is_some();
        Self { settings: *settings, passes: Passes { texture_ids }, corrects }
    }

    /// Threads beside the renderer's. One more than tracers: of k threads, k − 1 may trace at once, so the light actors keep
    /// one. The illuminator has one of its own, so that no tracer waits behind its turns.
    pub fn threads(&self, opened: &Opened) -> usize {
        let illuminators = usize::from(opened.refinement.is_some());
        illuminators + if self.corrects { self.settings.tracers as usize + 1 } else { illuminators }
    }

    /// What the actors are made of.
    pub fn parts(
        &self,
        opened: &Opened,
        probes: Option<Arc<Probes>>,
        insight: Option<InsightSlot>,
        stages: StageTimes,
        sink: Box<dyn FrameSink>,
    ) -> Parts {
        Parts {
            settings: self.settings,
            world: opened.world.clone(),
            probes,
            passes: self.passes,
            corrects: self.corrects,
            textures: opened.textures.clone(),
            refinement: opened.refinement.clone(),
            insight,
            stages,
            sink,
            outlets: Vec::new(),
        }
    }
}
