//! How a window's walks are made: of its scene, of the same read again, of another that is dropped on it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use foveal::display::first_approximation::Probes;
use foveal_actors::settings::Settings;
use foveal_actors::station::{Heard, Outlets, StationMessage};
use foveal_runtime::{Hashing, Port, Record};

use crate::bake_clock::Watch;
use crate::change::{Change, Changer};
use crate::controls::Setting;
use crate::engine::{Engine, Stalled};
use crate::failure::Failure;
use crate::light::Light;
use crate::opened::{self, Opened};
use crate::options::{Options, Recording};
use crate::recording::program;
use crate::source::{Build, FrameSource, Loader};

/// What each walk of a window is made with.
#[derive(Clone)]
pub struct Recipe {
    /// The scene to begin with.
    pub scene: PathBuf,
    /// Where light comes from.
    pub light: Light,
    /// Settings of all actors.
    pub settings: Settings,
    /// Frames per second to aim at; `None` is the scene's, else 10.
    pub fps: Option<f32>,
    /// Least quality of a frame that is shown, if frames are to wait for it.
    pub quality: Option<f32>,
    /// Most bytes of textures; `None` is the scene's limit, if it has one.
    pub texture_bytes: Option<u64>,
    /// Where the first walk is recorded, if at all; those after it go to FILE-2, FILE-3, …
    pub record: Option<PathBuf>,
    /// Whether recordings have the maps of light that grows beside them.
    pub keeps_light: bool,
    /// The command that recordings say they were made with.
    pub command: &'static str,
    /// How densely hashes are recorded.
    pub hashing: Hashing,
    /// What is set at once, in this order.
    pub set: Vec<Setting>,
    /// Where the walk through [`Self::scene`] begins.
    pub from: From,
    /// Who stops at once, to see that the walk goes on.
    pub stalled: Stalled,
    /// How other machines come to each walk, if they may; its settings have [places](Settings::stations) for them.
    pub doors: Option<Doors>,
}

/// Opens a walk to other machines; `None` where this one cannot be, which is no error of the walk's.
pub type Doors = Arc<dyn Fn(&Opened, &Settings) -> Result<Option<Beyond>, Failure> + Send + Sync>;

/// What is on the other side of a door.
pub struct Beyond {
    /// What leads there.
    pub outlets: Outlets,
    /// Takes what leads from there to the stations.
    pub attach: Box<dyn FnOnce(Vec<ToStation>)>,
}

/// What leads from a guest to its station.
pub type ToStation = Port<Heard, StationMessage>;

/// Where a walk begins: the scene's first camera, unless something is named.
#[derive(Clone, Debug, Default)]
pub struct From {
    /// At this camera of the scene.
    pub camera: Option<String>,
    /// Along this path of it, which is played until somebody moves.
    pub path: Option<String>,
}

impl Recipe {
    /// A scene by this name, in a picture of this size, as `foveal view` shows it.
    pub fn new(scene: impl Into<PathBuf>, settings: Settings) -> Self {
        Self {
            scene: scene.into(),
            light: Light::default(),
            settings,
            fps: None,
            quality: None,
            texture_bytes: None,
            command: "view",
            record: None,
            keeps_light: true,
            hashing: Hashing::Said,
            set: Vec::new(),
            from: From::default(),
            stalled: Stalled::Nobody,
            doors: None,
        }
    }

    /// Everything of a walk but its threads, from a scene file. Takes long, so it may be done on a thread beside.
    ///
    /// # Errors
    /// If the scene or its illumination cannot be read, or a limit cannot be met.
    pub fn load(&self, path: &Path, watch: &dyn Watch) -> Result<Loaded, Failure> {
        let mut opened = opened::open(path, &self.light, watch)?;
        opened.limit_textures(self.texture_bytes.or(opened.world.scene.budget.texture_bytes))?;
        let probes = Arc::new(Probes::of_world(&opened.world));
        Ok(Loaded { opened, probes })
    }

    /// Starts walk `number`, counted from 1, on this thread.
    ///
    /// # Errors
    /// If threads cannot be started, or the walk has no use for what is to be set.
    pub fn start(&self, loaded: Loaded, number: u32) -> Result<Engine, Failure> {
        let Loaded { opened, probes } = loaded;
        let file = opened.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let recording = self.record.as_ref().map(|file| Recording {
            into: Record::File(numbered(file, number)),
            hashing: self.hashing,
            command: self.command,
        });
        let beyond = match &self.doors {
            Some(open) => open(&opened, &self.settings)?,
            None => None,
        };
        let (outlets, attach) = beyond.map(|beyond| (beyond.outlets, beyond.attach)).unzip();
        let options = Options {
            outlets,
            fps: self.fps,
            quality: self.quality,
            texture_bytes: self.texture_bytes,
            recording,
            keeps_light: self.keeps_light,
            probes: Some(probes),
            facts: vec![("Software".to_owned(), program()), ("foveal file".to_owned(), file)],
            ..Options::interactive(self.settings)
        };
        let is_named = opened.path == self.scene;
        let mut engine = Engine::start(opened, options)?;
        if let Some(attach) = attach {
            attach(engine.station_inputs());
        }
        // A scene that is dropped on the window has cameras of its own.
        if is_named {
            engine.begin_at(self.from.camera.as_deref(), self.from.path.as_deref())?;
        }
        let (mut controls, ranges) = (engine.controls(), engine.ranges());
        controls.put_all(&self.set, &ranges).map_err(|e| Failure::Usage(e.to_string()))?;
        engine.set(&controls)?;
        engine.stall(self.stalled);
        Ok(engine)
    }

    /// The scene's walk, loaded and started.
    ///
    /// # Errors
    /// As [`Recipe::load`] and [`Recipe::start`].
    pub fn walk(&self, watch: &dyn Watch) -> Result<Engine, Failure> {
        self.start(self.load(&self.scene, watch)?, 1)
    }

    /// Changes walks that began by this recipe; `walks` have begun so far.
    pub fn changer(self, walks: Arc<AtomicU32>) -> Changer {
        let recipe = Arc::new(self);
        Arc::new(move |change, opened, size| {
            let mut recipe = Recipe::clone(&recipe);
            let [width, height] = if let Change::Size(size) = change { size } else { size };
            let cache_capacity = Settings::new(width, height, 1).cache_capacity;
            recipe.settings = Settings { width, height, cache_capacity, ..recipe.settings };
            let of = |opened: Opened| {
                let probes = Arc::new(Probes::of_world(&opened.world));
                Loaded { opened, probes }
            };
            let loaded = match change {
                Change::Reload => recipe.load(&opened.path, &()).map_err(|e| e.to_string())?,
                Change::Size(_) => of(opened),
                Change::Edit(edit) => of(opened.edited(edit, &()).map_err(|e| e.to_string())?),
            };
            let number = walks.fetch_add(1, Ordering::Relaxed) + 1;
            Ok(Box::new(move || {
                let engine = recipe.start(loaded, number).map_err(|e| e.to_string())?;
                Ok(Box::new(engine) as Box<dyn FrameSource>)
            }))
        })
    }

    /// Makes walks by this recipe. Scenes are read on the thread that asks, actors are started where they are shown.
    pub fn loader(self) -> Loader {
        self.loader_of(Arc::default())
    }

    /// The same, and what changes them.
    pub fn loader_and_changer(self) -> (Loader, Changer) {
        let walks = Arc::default();
        (self.clone().loader_of(Arc::clone(&walks)), self.changer(walks))
    }

    fn loader_of(self, walks: Arc<AtomicU32>) -> Loader {
        let recipe = Arc::new(self);
        Arc::new(move |path: Option<&Path>| {
            let recipe = Arc::clone(&recipe);
            let number = walks.fetch_add(1, Ordering::Relaxed) + 1;
            let loaded = recipe.load(path.unwrap_or(&recipe.scene), &()).map_err(|e| e.to_string())?;
            let build: Build = Box::new(move || {
                let engine = recipe.start(loaded, number).map_err(|e| e.to_string())?;
                Ok(Box::new(engine) as Box<dyn FrameSource>)
            });
            Ok(build)
        })
    }
}

/// A scene that is ready for a walk.
pub struct Loaded {
    /// With its light.
    pub opened: Opened,
    /// What each of its objects sees around.
    pub probes: Arc<Probes>,
}

/// The file of a walk, counted from 1.
pub fn numbered(file: &Path, walk: u32) -> PathBuf {
    if walk == 1 {
        return file.to_owned();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let end = file.extension().map_or_else(String::new, |e| format!(".{}", e.to_string_lossy()));
    file.with_file_name(format!("{stem}-{walk}{end}"))
}
