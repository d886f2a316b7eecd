//! From files to a world: load the scene, find or make its illumination.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use etcetera::base_strategy::{BaseStrategy, choose_native_strategy};
use foveal::geometry::Accel;
use foveal::illumination::bake::{BakeSettings, Baked, Baker, cache_key};
use foveal::illumination::first::first_picture;
use foveal::illumination::{Irradiance, Uniform};
use foveal::scene::edit::{AsRead, Lamp, SceneEdit};
use foveal::scene::{NamedCamera, Scene, edit};
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::{World, metered};
use foveal_files::bakes::{load_illumination, save};
use foveal_files::load;

use glam::Vec3;

use foveal_actors::illuminator::Refinement;
use foveal_actors::textures::TextureStore;

use crate::bake_clock::{BakeClock, Watch};
use crate::edit::EditError;
use crate::failure::Failure;
use crate::interrupt::interrupted;
use crate::kept_light;
use crate::kept_scene::{self, Read};
use crate::light::{Light, Reading};
use crate::process::told;
use crate::source::NamedLamp;

/// A scene that is ready for a picture.
#[derive(Clone)]
pub struct Opened {
    /// The file it was read from; empty for a world that was made.
    pub path: PathBuf,
    /// Where its illumination came from.
    pub light: Light,
    /// Scene, geometry, lights and illumination.
    pub world: World,
    /// Textures, where they do not all fit into their limit; the world has them at their coarsest then.
    pub textures: Option<Arc<TextureStore>>,
    /// What the illumination is to be refined towards, where it is a first estimate.
    pub refinement: Option<Refinement>,
    /// What of the scene its edits ([`Light::edits`]) changed.
    pub as_read: AsRead,
    /// What went wrong without stopping anything, each said once.
    pub warnings: Vec<String>,
}

impl Opened {
    /// A world that was made, under the light it has.
    pub fn of_world(world: World) -> Self {
        Self {
            path: PathBuf::new(),
            light: Light::default(),
            as_read: AsRead::of(&world.scene),
            world,
            textures: None,
            refinement: None,
            warnings: Vec::new(),
        }
    }

    /// The same scene after one more edit: with the light that is kept of it, or else with a first estimate, which is
    /// refined while one walks unless [`Light::baked`].
    ///
    /// # Errors
    /// If the edit cannot be made, or its light not.
    pub fn edited(&self, edit: SceneEdit, watch: &dyn Watch) -> Result<Self, EditError> {
        if self.textures.is_some() {
            return Err(EditError::LimitedTextures);
        }
        // A file that was baked holds other light.
        let mut light = Light { bake: None, begun: 0, ..self.light.clone() };
        edit::add(&mut light.edits, edit);
        let scene = self.as_read.edited(&self.world.scene, &light.edits)?;
        let (mut warnings, accel) = (self.warnings.clone(), self.world.accel.clone());
        let kept = kept(&scene, &light, &mut warnings)?;
        let lights = Arc::new(Lights::build(&scene));
        let (path, scene, as_read) = (self.path.clone(), Arc::new(scene), self.as_read.clone());
        Ok(Unlit { path, scene, accel, lights, as_read, warnings }.lit(kept, &light, watch)?)
    }

    /// All that emits light and can be dimmed, and how far that is.
    pub fn lamps(&self) -> Vec<NamedLamp> {
        let scene = &self.world.scene;
        let named = |lamp: Lamp| {
            let name = lamp_name(scene, lamp);
            let gain = |edit: &SceneEdit| match edit {
                SceneEdit::LampDimmed { lamp: of, gain } if *of == lamp => Some(*gain),
                _ => None,
            };
            NamedLamp { name, lamp, gain: self.light.edits.iter().find_map(gain).unwrap_or(Vec3::ONE) }
        };
        self.as_read.lamps().map(named).collect()
    }

    /// Keeps the textures within `limit` bytes, if they are more; their levels lie in the cache folder.
    pub fn limit_textures(&mut self, limit: Option<u64>) -> Result<(), Failure> {
        let scene = &self.world.scene;
        let all: u64 = scene.textures.iter().map(|t| t.mips.bytes() as u64).sum();
        let Some(limit) = limit.filter(|limit| all > *limit) else { return Ok(()) };
        let folder = cache_folder(self.light.cache.as_deref())
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

/// What a lamp of a scene is called.
pub(crate) fn lamp_name(scene: &Scene, lamp: Lamp) -> String {
    match lamp {
        Lamp::Material(i) => scene.materials[i as usize].name.clone(),
        Lamp::Light(i) => format!("{} {}", scene.lights[i as usize].kind(), i + 1),
        Lamp::Environment => "environment".to_owned(),
    }
}

/// Loads a scene; warnings go to the log and into the list.
pub fn load_scene(path: &Path) -> Result<(Arc<Scene>, Vec<String>), Failure> {
    load_scene_as(path, &Reading::default())
}

/// As [`load_scene`], with what was chosen where its files leave a choice.
pub fn load_scene_as(path: &Path, reading: &Reading) -> Result<(Arc<Scene>, Vec<String>), Failure> {
    let loaded = load::load_with(path, &reading.options()).map_err(|e| Failure::Input(e.to_string()))?;
    let warnings: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    for warning in &warnings {
        tracing::warn!("{warning}");
    }
    Ok((Arc::new(loaded.scene), warnings))
}

/// The files that a scene is read from, relative to its folder, each with its BLAKE3. Reads them.
///
/// # Errors
/// If the scene cannot be read.
pub fn files(path: &Path, reading: &Reading) -> Result<Vec<(String, [u8; 32])>, Failure> {
    let loaded = load::load_with(path, &reading.options()).map_err(|e| Failure::Input(e.to_string()))?;
    Ok(loaded.files)
}

/// Loads a scene and its illumination.
pub fn open(path: &Path, light: &Light, watch: &dyn Watch) -> Result<Opened, Failure> {
    with_light(path, told("scene", || kept_scene::read(path, light))?, light, watch)
}

/// Loads a scene for work that has light of its own, or takes the one that is kept ([`Light::cache`]); one that takes long to
/// read is kept for the next time.
///
/// # Errors
/// If it cannot be read.
pub fn unlit(path: &Path, light: &Light) -> Result<World, Failure> {
    let mut read = kept_scene::read(path, light)?;
    let accel = read.accel.take().unwrap_or_else(|| Arc::new(Accel::build(&read.scene)));
    let lights = Arc::new(Lights::build(&read.scene));
    let scene = metered(read.scene.clone(), &accel, &lights);
    read.keep(&scene, &accel);
    Ok(World::of(scene, accel, lights, Arc::new(Uniform(Vec3::ZERO))))
}

/// The illumination of a scene that is loaded, with what went wrong so far.
pub fn illuminated(
    path: &Path,
    scene: Arc<Scene>,
    warnings: Vec<String>,
    light: &Light,
    watch: &dyn Watch,
) -> Result<Opened, Failure> {
    with_light(path, Read::of(scene, warnings), light, watch)
}

pub(crate) fn with_light(
    path: &Path,
    mut read: Read,
    light: &Light,
    watch: &dyn Watch,
) -> Result<Opened, Failure> {
    let (scene, mut warnings) = (read.scene.clone(), std::mem::take(&mut read.warnings));
    let as_read = AsRead::of(&scene);
    let edits = &light.edits;
    let edited = |scene: &Arc<Scene>| match edits.is_empty() {
        true => Ok(scene.clone()),
        false => as_read.edited(scene, edits).map(Arc::new),
    };
    let changed = edited(&scene).map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?;
    // What is kept is read, and the lights are made ready, while the geometry index is built.
    let index = read.accel.take();
    let (accel, (kept, mut lights)) = rayon::join(
        || index.unwrap_or_else(|| told("geometry index", || Arc::new(Accel::build(&scene)))),
        || (kept(&changed, light, &mut warnings), told("lights", || Arc::new(Lights::build(&scene)))),
    );
    // As it was read: an exposure that followed the lamps would undo what is done to them.
    let mut scene = told("exposure", || metered(scene, &accel, &lights));
    read.keep(&scene, &accel);
    if !edits.is_empty() {
        let display = scene.display;
        scene = changed;
        Arc::make_mut(&mut scene).display = display;
        lights = Arc::new(Lights::build(&scene));
    }
    Unlit { path: path.to_owned(), scene, accel, lights, as_read, warnings }.lit(kept?, light, watch)
}

/// A scene that is ready but for its illumination.
struct Unlit {
    path: PathBuf,
    scene: Arc<Scene>,
    accel: Arc<Accel>,
    lights: Arc<Lights>,
    as_read: AsRead,
    warnings: Vec<String>,
}

impl Unlit {
    /// With the illumination that is kept, or one that is made.
    fn lit(
        self,
        kept: Option<Arc<dyn Irradiance>>,
        light: &Light,
        watch: &dyn Watch,
    ) -> Result<Opened, Failure> {
        let Self { path, scene, accel, lights, as_read, mut warnings } = self;
        let (illumination, unmet): (Arc<dyn Irradiance>, Option<Unmet>) = match kept {
            Some(kept) => (kept, None),
            None => illuminate(&scene, &accel, &lights, light, watch, &mut warnings)?,
        };
        let world = World::of(scene, accel, lights, illumination);
        let refinement = unmet.map(|Unmet { settings, keep, early, begun }| Refinement {
            world: world.clone(),
            settings,
            begun,
            keep,
            early,
            book: None,
        });
        Ok(Opened { path, light: light.clone(), world, textures: None, refinement, warnings, as_read })
    }
}

/// The illumination that was asked for, from a file or the cache. `None` where it has to be made.
fn kept(
    scene: &Scene,
    a: &Light,
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

/// What the illumination does not meet yet.
struct Unmet {
    settings: BakeSettings,
    /// Where one that meets it is to be kept.
    keep: Option<PathBuf>,
    /// Where those before it are kept.
    early: Option<PathBuf>,
    /// Rounds of the bake that it has.
    begun: u32,
}

fn illuminate(
    scene: &Arc<Scene>,
    accel: &Accel,
    lights: &Lights,
    a: &Light,
    watch: &dyn Watch,
    warnings: &mut Vec<String>,
) -> Result<(Arc<dyn Irradiance>, Option<Unmet>), Failure> {
    let indexed = Indexed { scene, accel, lights };
    let settings = a.settings.settings(scene);
    let key = cache_key(scene, &settings);
    let first = || {
        let of_recording = || load_illumination(a.first.as_ref()?, &key, scene.mesh.triangles.len()).ok();
        of_recording().unwrap_or_else(|| match a.begun {
            0 => told("first light", || first_picture(indexed, a.settings.bake_seed)),
            rounds => {
                tracing::warn!(
                    "the light that the walk began with was not kept; {rounds} rounds of it are made anew"
                );
                kept_light::baked(indexed, &settings, rounds)
            }
        })
    };
    if a.quick {
        return Ok((Arc::new(first()), None));
    }
    let kept = cache_file(a.cache.as_deref(), scene, &settings);
    if !a.baked {
        // A replay begins with what was recorded.
        let is_kept = a.keeps_early && !a.refined;
        let early = kept_light::file(a.cache.as_deref(), scene, &settings).filter(|_| is_kept);
        let map = match early
            .as_ref()
            .and_then(|file| told("kept light", || kept_light::load(file, scene, &settings)))
        {
            Some(map) => Arc::new(map),
            None => {
                let map = Arc::new(first());
                if let Some(early) = &early {
                    kept_light::keep(early, scene, &settings, map.clone());
                }
                map
            }
        };
        let begun = map.summary.rounds;
        return Ok((map, Some(Unmet { settings, keep: kept, early, begun })));
    }
    let baked = bake_within(indexed, &settings, a.settings.time, watch);
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

/// Bakes until the settings are met, the time is up, or [`crate::interrupt`].
pub fn bake_within(
    indexed: Indexed<'_>,
    settings: &BakeSettings,
    time: Option<Duration>,
    watch: &dyn Watch,
) -> Baked {
    let aims = (settings.error.unwrap_or(0.0), settings.particles.unwrap_or(u64::MAX));
    let clock = BakeClock::new(Instant::now(), watch, time, aims);
    let keep_going = |p: &foveal::illumination::bake::Progress| {
        clock.at(p);
        !interrupted() && !clock.is_over()
    };
    let baked = Baker::new(indexed, settings).run(indexed, &keep_going, &mut |_| {});
    clock.finish();
    baked
}

/// The folder of kept bakes: the one given, FOVEAL_CACHE, or `foveal` in the folder that the system has for caches.
pub fn cache_folder(given: Option<&Path>) -> Option<PathBuf> {
    let named = || std::env::var_os("FOVEAL_CACHE").filter(|v| !v.is_empty()).map(PathBuf::from);
    let of_user = || Some(choose_native_strategy().ok()?.cache_dir().join("foveal"));
    given.map(Path::to_path_buf).or_else(named).or_else(of_user)
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
