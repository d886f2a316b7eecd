//! From files to a world: load the scene, find or make its illumination.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;

use foveal::geometry::Accel;
use foveal::illumination::Irradiance;
use foveal::illumination::bake::{BakeSettings, Baked, Baker, cache_key};
use foveal::illumination::cache::{load_illumination, save};
use foveal::illumination::quick::quick_direct;
use foveal::scene::{NamedCamera, Scene, load};
use foveal::transport::light::Lights;
use foveal::transport::particle::SceneTransport;
use foveal::world::World;

use super::Progress;
use super::arguments::{duration, share};
use super::bake_progress::BakeClock;
use super::failure::Failure;
use crate::illuminator::Refinement;
use crate::textures::TextureStore;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C asks for an end instead of forcing one; a second one forces it.
pub fn end_on_interrupt() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    };
    if ctrlc::set_handler(handler).is_err() {
        tracing::debug!("Ctrl-C is handled elsewhere");
    }
}

/// Whether Ctrl-C was pressed.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Nothing, until Ctrl-C was pressed.
///
/// # Errors
/// From then on.
pub fn uninterrupted() -> Result<(), Failure> {
    match interrupted() {
        false => Ok(()),
        true => Err(Failure::Interrupted("interrupted; what was done is kept".into())),
    }
}

/// Where illumination comes from; part of a recording's header.
#[derive(Args, Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct IlluminationArguments {
    /// Illumination made by `foveal bake --out`; without it one is taken from the cache, or refined while walking
    #[arg(long, value_name = "FILE")]
    pub bake: Option<PathBuf>,
    /// Stay with the first estimate, which takes about a second
    #[arg(long, conflicts_with = "bake")]
    pub quick: bool,
    /// Bake before the walk begins instead of while it goes on
    #[arg(long, conflicts_with = "quick")]
    #[serde(default)]
    pub baked: bool,
    /// In a recording: the illumination was refined while walking
    #[arg(skip)]
    #[serde(default)]
    pub refined: bool,
    /// Folder of kept bakes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    #[serde(skip)]
    pub cache: Option<PathBuf>,
    /// When a bake is good enough
    #[command(flatten)]
    pub settings: BakeSettingsArguments,
}

/// When a bake is good enough.
#[derive(Args, Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct BakeSettingsArguments {
    /// Stop at this relative error of irradiance
    #[arg(long, value_name = "SHARE", value_parser = share, default_value = "2%")]
    pub error: f32,
    /// Stop after so many particles
    #[arg(long, value_name = "N", default_value_t = 1 << 22)]
    pub particles: u64,
    /// Texels of the lightmap, about (default: by the number of triangles, 32 Ki to 256 Ki; from 128 Ki where
    /// lights without area cast sharp shadows)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 26))]
    pub texels: Option<u32>,
    /// Fine texels also where no camera or path of the scene leads
    #[arg(long)]
    #[serde(default)]
    pub everything: bool,
    /// Seed of the bake's random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub bake_seed: u64,
    /// Stop after this time, e.g. 10s
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time: Option<Duration>,
}

impl Default for BakeSettingsArguments {
    fn default() -> Self {
        Self { error: 0.02, particles: 1 << 22, texels: None, everything: false, bake_seed: 1, time: None }
    }
}

impl BakeSettingsArguments {
    /// As the core takes them.
    pub fn settings(&self, scene: &Scene) -> BakeSettings {
        // A room of a few walls needs no fine map, and its bake should take seconds; but the shadows of lights without
        // area are as sharp as the map.
        let least = if scene.lights.is_empty() { 32 * 1024 } else { 128 * 1024 };
        let of_scene = || (least + 4 * scene.mesh.triangles.len()).min(256 * 1024) as u32;
        BakeSettings {
            texels: self.texels.unwrap_or_else(of_scene),
            seed: self.bake_seed,
            everything: self.everything,
            particles: Some(self.particles.max(1)),
            error: Some(self.error),
            ..BakeSettings::default()
        }
    }
}

/// A scene that is ready for a picture.
pub struct Session {
    /// Scene, geometry, lights and illumination.
    pub world: World,
    /// Textures, where they do not all fit into their limit; the world has them at their coarsest then.
    pub textures: Option<Arc<TextureStore>>,
    /// What the illumination is to be refined towards, where it is a first estimate.
    pub refinement: Option<Refinement>,
    /// What went wrong without stopping anything, each said once.
    pub warnings: Vec<String>,
}

impl Session {
    /// Keeps the textures within `limit` bytes, if they are more. `cache`: where their levels are kept.
    pub fn limit_textures(&mut self, limit: Option<u64>, cache: Option<&Path>) -> Result<(), Failure> {
        let scene = &self.world.scene;
        let all: u64 = scene.textures.iter().map(|t| t.mips.bytes() as u64).sum();
        let Some(limit) = limit.filter(|limit| all > *limit) else { return Ok(()) };
        let folder = cache_folder(cache)
            .ok_or_else(|| {
                Failure::Environment("nowhere to keep textures; set FOVEAL_CACHE or --cache".into())
            })?
            .join("textures");
        let (store, textures) = TextureStore::new(scene, limit, &folder).map_err(|below| {
            Failure::Limit(format!(
                "textures cannot be kept within {limit} bytes: the smallest limit that works is {} bytes",
                below.smallest
            ))
        })?;
        for warning in &store.warnings {
            tracing::warn!("{warning}");
        }
        self.warnings.extend(store.warnings.iter().cloned());
        self.world = self.world.with_resident(textures);
        self.textures = Some(Arc::new(store));
        Ok(())
    }
}

/// Loads a scene; warnings go to the log and into the list.
pub fn load_scene(path: &Path) -> Result<(Arc<Scene>, Vec<String>), Failure> {
    let loaded = load::load(path).map_err(|e| Failure::Input(e.to_string()))?;
    let warnings: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    for warning in &warnings {
        tracing::warn!("{warning}");
    }
    Ok((Arc::new(loaded.scene), warnings))
}

/// Loads a scene and its illumination.
pub fn open(path: &Path, a: &IlluminationArguments, progress: Progress) -> Result<Session, Failure> {
    let (scene, warnings) = load_scene(path)?;
    illuminated(scene, warnings, a, progress)
}

/// The illumination of a scene that is loaded, with what went wrong so far.
pub fn illuminated(
    scene: Arc<Scene>,
    mut warnings: Vec<String>,
    a: &IlluminationArguments,
    progress: Progress,
) -> Result<Session, Failure> {
    // What is kept is read while the geometry index is built.
    let (accel, kept) = rayon::join(|| Arc::new(Accel::build(&scene)), || kept(&scene, a, &mut warnings));
    let lights = Arc::new(Lights::build(&scene));
    let (illumination, unmet): (Arc<dyn Irradiance>, Unmet) = match kept? {
        Some(kept) => (kept, None),
        None => illuminate(&scene, &accel, &lights, a, progress, &mut warnings)?,
    };
    let world = World { scene, accel, lights, illumination };
    let refinement = unmet.map(|(settings, keep)| Refinement { world: world.clone(), settings, keep });
    Ok(Session { world, textures: None, refinement, warnings })
}

/// The illumination that was asked for, from a file or the cache. `None` where it has to be made.
fn kept(
    scene: &Arc<Scene>,
    a: &IlluminationArguments,
    warnings: &mut Vec<String>,
) -> Result<Option<Arc<dyn Irradiance>>, Failure> {
    if a.quick {
        return Ok(None);
    }
    let settings = a.settings.settings(scene);
    let key = cache_key(scene, &settings);
    let triangles = scene.mesh.triangles.len();
    if let Some(file) = &a.bake {
        let map = load_illumination(file, &key, triangles).map_err(|e| {
            Failure::Input(format!(
                "{}: {e}; bake this scene with the same --texels and --bake-seed again",
                file.display()
            ))
        })?;
        return Ok(Some(Arc::new(map)));
    }
    let kept = cache_file(a.cache.as_deref(), scene, &settings);
    if let Some(file) = kept.as_ref().filter(|f| !a.refined && f.exists()) {
        match load_illumination(file, &key, triangles) {
            Ok(map) => return Ok(Some(Arc::new(map))),
            Err(e) => {
                let warning = format!("{}: {e}; the illumination is baked anew", file.display());
                tracing::warn!("{warning}");
                warnings.push(warning);
            }
        }
    }
    Ok(None)
}

/// Settings that the illumination does not meet yet, and where one that does is to be kept.
type Unmet = Option<(BakeSettings, Option<PathBuf>)>;

fn illuminate(
    scene: &Arc<Scene>,
    accel: &Accel,
    lights: &Lights,
    a: &IlluminationArguments,
    progress: Progress,
    warnings: &mut Vec<String>,
) -> Result<(Arc<dyn Irradiance>, Unmet), Failure> {
    let transport = SceneTransport::new(scene, accel, lights);
    let first = || Arc::new(quick_direct(scene, &transport, a.settings.bake_seed));
    if a.quick {
        return Ok((first(), None));
    }
    let settings = a.settings.settings(scene);
    let key = cache_key(scene, &settings);
    let kept = cache_file(a.cache.as_deref(), scene, &settings);
    if !a.baked {
        return Ok((first(), Some((settings, kept))));
    }
    let baked = bake_with_progress(scene, &transport, &settings, a.settings.time, progress);
    if interrupted() {
        return Err(Failure::Interrupted("interrupted while baking".into()));
    }
    // A bake that a time limit ended is not what the settings ask for.
    if let Some(file) = kept.filter(|_| baked.complete) {
        let kept = std::fs::create_dir_all(file.parent().unwrap_or(Path::new("."))).is_ok()
            && save(&file, &key, &baked.illumination).is_ok();
        if !kept {
            let warning =
                format!("{}: the illumination cannot be kept; set FOVEAL_CACHE or --cache", file.display());
            tracing::warn!("{warning}");
            warnings.push(warning);
        }
    }
    Ok((Arc::new(baked.illumination), None))
}

/// Bakes with a bar, until the settings are met, the time is up, or Ctrl-C.
pub fn bake_with_progress(
    scene: &Scene,
    transport: &SceneTransport<'_>,
    settings: &BakeSettings,
    time: Option<Duration>,
    progress: Progress,
) -> Baked {
    let aims = (settings.error.unwrap_or(0.0), settings.particles.unwrap_or(u64::MAX));
    let clock = BakeClock::new(Instant::now(), progress, false, time, aims);
    let keep_going = |p: &foveal::illumination::bake::Progress| {
        clock.at(p);
        !interrupted() && !clock.is_over()
    };
    // What was interrupted is not looked at.
    let mut baker = Baker::new(scene, transport, settings).hurried_by(|| interrupted() || clock.is_late());
    let baked = baker.run(&keep_going, &mut |_| {});
    clock.finish();
    baked
}

/// The folder of kept bakes.
pub fn cache_folder(given: Option<&Path>) -> Option<PathBuf> {
    let from = |variable: &str| std::env::var_os(variable).filter(|v| !v.is_empty()).map(PathBuf::from);
    given
        .map(Path::to_path_buf)
        .or_else(|| from("FOVEAL_CACHE"))
        .or_else(|| from("XDG_CACHE_HOME").map(|p| p.join("foveal")))
        .or_else(|| from("HOME").map(|p| p.join(".cache/foveal")))
}

/// Where the bake of a scene with these settings is kept: its name holds all that decides its content.
pub fn cache_file(given: Option<&Path>, scene: &Scene, settings: &BakeSettings) -> Option<PathBuf> {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&cache_key(scene, settings));
    hasher.update(&settings.particles.unwrap_or(0).to_le_bytes());
    hasher.update(&settings.error.unwrap_or(0.0).to_le_bytes());
    let name = format!("{}.fvbake", &hasher.finalize().to_hex()[..32]);
    cache_folder(given).map(|folder| folder.join(name))
}

/// A camera of the scene by name, or the first.
pub fn camera<'s>(scene: &'s Scene, name: Option<&str>) -> Result<&'s NamedCamera, Failure> {
    match name {
        None => scene.cameras.first().ok_or_else(|| Failure::Input("the scene has no camera".into())),
        Some(name) => scene.cameras.iter().find(|c| c.name == name).ok_or_else(|| {
            let names: Vec<&str> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
            Failure::Usage(format!("no camera \"{name}\"; the scene has {}", names.join(", ")))
        }),
    }
}
