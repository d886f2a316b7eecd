//! How a walk is started.

use std::path::PathBuf;
use std::sync::Arc;

use foveal::display::first_approximation::Probes;
use foveal_actors::illuminator::Refinement;
use foveal_actors::light_book::LightBook;
use foveal_actors::settings::Settings;
use foveal_actors::station::Outlets;
use foveal_runtime::simulate::Simulation;
use foveal_runtime::{Config, Hashing, Record};

use crate::failure::Failure;
use crate::light::Light;
use crate::machine::Machine;
use crate::opened::Opened;
use crate::recording::{Parent, RecordedRun, illumination_hash, light_beside, light_key};

/// How a walk is started.
pub struct Options {
    /// Settings of all actors: size of the picture, number of tracers, order of rays.
    pub settings: Settings,
    /// Where the light comes from.
    pub light: Light,
    /// Frames per second to aim at; `None` is the scene's, else 10.
    pub fps: Option<f32>,
    /// Least quality of a frame that is shown, if frames are to wait for it ([`foveal_actors::insight::Insight::quality`]).
    pub quality: Option<f32>,
    /// Most bytes of textures; `None` is the scene's limit, if it has one.
    pub texture_bytes: Option<u64>,
    /// Start every actor, also those that this scene does not need: for walks whose user may ask for anything.
    pub whole: bool,
    /// Whether threads give way to the one that begins the walk, as where that one serves a window.
    pub gives_way: bool,
    /// Whose time it is.
    pub clock: Clock,
    /// Where the walk is recorded, if anywhere.
    pub recording: Option<Recording>,
    /// The recording that it goes on from, if any: said in its own.
    pub parent: Option<Parent>,
    /// Whether a recording has the maps of light that grows beside it ([`crate::recording::light_beside`]); without them
    /// who replays it bakes them again.
    pub keeps_light: bool,
    /// Turns that a profile keeps of each actor.
    pub ring_turns: Option<usize>,
    /// What each object sees around, where somebody has looked already: of many objects that takes seconds.
    pub probes: Option<Arc<Probes>>,
    /// What leads to the machines that trace for [`Settings::stations`], made anew for each attempt to start.
    pub outlets: Option<Outlets>,
    /// Names and values for a screenshot's metadata.
    pub facts: Vec<(String, String)>,
}

impl Options {
    /// What the scene needs, in real time, not recorded.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            light: Light::default(),
            fps: None,
            quality: None,
            texture_bytes: None,
            whole: false,
            gives_way: false,
            clock: Clock::Real,
            recording: None,
            parent: None,
            keeps_light: true,
            ring_turns: None,
            probes: None,
            outlets: None,
            facts: Vec::new(),
        }
    }

    /// The same for a window: every actor, and threads that give way to it.
    pub fn interactive(settings: Settings) -> Self {
        Self { whole: true, gives_way: true, ..Self::new(settings) }
    }
}

/// Whose time it is.
pub enum Clock {
    /// Threads and clock are real.
    Real,
    /// All actors on one thread, in virtual time, under a seeded schedule.
    Virtual(Simulation),
}

impl Clock {
    pub(crate) fn config(
        self,
        settings: &Settings,
        threads: usize,
        gives_way: bool,
        ring_turns: Option<usize>,
    ) -> Config {
        let config = match self {
            Self::Real => Config { gives_way, seed: settings.seed, ..Config::live(threads) },
            Self::Virtual(simulation) => Config::simulate(simulation),
        };
        Config { ring_turns: ring_turns.unwrap_or(config.ring_turns), ..config }
    }
}

/// Where a walk is recorded.
pub struct Recording {
    /// The file, or whatever takes its bytes.
    pub into: Record,
    /// How densely hashes are recorded.
    pub hashing: Hashing,
    /// Who records: walk, view, simulate.
    pub command: &'static str,
}

impl Recording {
    /// Into a file, with a hash for each message.
    pub fn file(path: impl Into<PathBuf>, command: &'static str) -> Self {
        Self { into: Record::File(path.into()), hashing: Hashing::Said, command }
    }

    /// The maps that will lie beside it; none where it is no file.
    pub(crate) fn book(&self, refinement: &Refinement) -> Result<Option<Arc<LightBook>>, Failure> {
        let Record::File(path) = &self.into else { return Ok(None) };
        // Beside a device there is nothing to keep.
        if path.metadata().is_ok_and(|facts| !facts.is_file()) {
            return Ok(None);
        }
        let triangles = refinement.world.scene.mesh.triangles.len();
        let Refinement { world, settings, .. } = refinement;
        let key = light_key(&world.scene, settings, &illumination_hash(&*world.illumination)?);
        let book = LightBook::begin(key, triangles, &light_beside(path));
        Ok(Some(Arc::new(book)))
    }

    pub(crate) fn header(
        &self,
        opened: &Opened,
        machine: &Machine,
        parent: Option<&Parent>,
    ) -> Result<Vec<u8>, Failure> {
        let parent = parent.cloned();
        RecordedRun { parent, ..RecordedRun::new(self.command, opened, machine)? }.to_bytes()
    }
}
