//! `foveal bake`: the view-independent illumination, made once and kept.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use serde_json::{Value, json};

use foveal::allocation::mesh_elements::{ElementCriterion, simplify_mesh};
use foveal::geometry::Accel;
use foveal::illumination::bake::{BakeSettings, BakeState, Baker, cache_key};
use foveal::illumination::statement::{Statement, statement};
use foveal::illumination::stored::Illumination;
use foveal::radiosity::of_scene::SceneRadiosity;
use foveal::scene::Scene;
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal_files::bakes::{CacheError, load, load_illumination, save};

use foveal_engine::bake_clock::{BakeClock, Watch};
use foveal_engine::batch::Handed;
use foveal_engine::failure::Failure;
use foveal_engine::files::make_folder;
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{cache_file, load_scene_as};
use foveal_engine::process::peak_memory_bytes;
use foveal_remote::hands::Helped;
use foveal_terminal::arguments::bytes;
use foveal_terminal::light::{BakeSettingsArguments, ReadingArguments};
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{BakeLines, Progress};

use super::tracers::{self, HelpersArguments};

/// Bytes that an element needs at most while it is baked: its geometry, two bins, two sums of direct light, its
/// place in a tree and in the map.
const BYTES_PER_ELEMENT: u64 = 640;

/// Arguments of `foveal bake`.
#[derive(Args, Debug)]
pub struct BakeArguments {
    /// OBJ or glTF file, or a .toml sidecar
    scene: PathBuf,
    #[command(flatten)]
    settings: BakeSettingsArguments,
    #[command(flatten)]
    reading: ReadingArguments,
    /// How to compute the light
    #[arg(long, value_enum, default_value_t = Method::Particles)]
    method: Method,
    /// Simplify the radiosity mesh to this many elements (implies --method radiosity)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    elements: Option<u32>,
    /// Which elements to remove first
    #[arg(long, value_enum, default_value_t = CriterionName::Perceptual, requires = "elements")]
    criterion: CriterionName,
    /// Continue an interrupted bake of this scene with these settings
    #[arg(long)]
    resume: bool,
    /// Limit on memory for elements; texels are made coarser to fit
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    max_memory: Option<u64>,
    /// Output file (default: in the cache, where `walk` finds it)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Folder for cached bakes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Bake even if a cached bake meets the settings
    #[arg(long)]
    again: bool,
    #[command(flatten)]
    helpers: HelpersArguments,
    /// Print progress as JSON lines on standard error
    #[arg(long)]
    jsonl: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// How light is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Method {
    /// Particles with density estimation: all materials and lights
    Particles,
    /// Hierarchical radiosity: diffuse scenes of few polygons, with area lights
    Radiosity,
}

/// Names of criteria.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CriterionName {
    /// Smallest relative change of radiosity
    Photometric,
    /// Smallest visible change, with masking by textures
    Perceptual,
    /// Smallest squared error
    Optimal,
}

/// What was made, however it was made.
struct Made {
    map: Illumination,
    complete: bool,
    /// The error at points that it was not made of.
    measured: Option<Statement>,
    /// More keys for the document.
    more: Value,
    stages: Vec<(&'static str, f64)>,
}

/// Runs the command.
pub fn run(a: &BakeArguments, progress: Progress) -> Result<(), Failure> {
    foveal_terminal::progress::end_on_interrupt();
    let start = Instant::now();
    let (scene, mut warnings) = load_scene_as(&a.scene, &a.reading.reading())?;
    let mut settings = a.settings.options().settings(&scene);
    if let Some(note) = fit_memory(&scene, &mut settings, a.max_memory)? {
        tracing::warn!("{note}");
        warnings.push(note);
    }
    let method = if a.elements.is_some() { Method::Radiosity } else { a.method };
    if a.helpers.are_asked_for() && method == Method::Radiosity {
        return Err(Failure::Usage("--tracers: other machines help with --method particles alone".into()));
    }
    let key = cache_key(&scene, &settings);
    let kept = cache_file(a.cache.as_deref(), &scene, &settings)
        .map(|file| if method == Method::Radiosity { file.with_extension("radiosity.fvbake") } else { file });
    let Some(file) = a.out.clone().or_else(|| kept.clone()) else {
        return Err(Failure::Usage("no place to keep the bake: give --out or set FOVEAL_CACHE".into()));
    };
    if let Some(folder) = file.parent().filter(|p| *p != Path::new("")) {
        make_folder(folder)?;
    }
    if file.is_dir() {
        return Err(Failure::Usage(format!("{} is a folder; --out takes a file", file.display())));
    }
    let found = match &kept {
        Some(kept) if !a.again && method == Method::Particles && kept.exists() => {
            let found = load_illumination(kept, &key, scene.mesh.triangles.len());
            // Never trusted, never fatal: it is made anew.
            found.inspect_err(|e| tracing::warn!("{}: {e}; the bake is made anew", kept.display())).ok()
        }
        _ => None,
    };
    let cached = found.is_some();
    let (bar, lines) = (progress.baking(), BakeLines::default());
    let watch: &dyn Watch = if a.jsonl { &lines } else { &bar };
    let made = match (found, method) {
        (Some(map), _) => {
            let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
            let measured =
                measured_by(Indexed { scene: &scene, accel: &accel, lights: &lights }, &map, &settings);
            Made { map, complete: true, measured, more: json!({}), stages: Vec::new() }
        }
        (None, Method::Particles) => particles(a, &scene, &settings, &key, &file, start, watch)?,
        (None, Method::Radiosity) => radiosity(a, &scene, &settings, start, watch)?,
    };
    drop(bar);
    // A bake that was cut short is kept beside the place of a whole one, where no walk takes it for that.
    let partial = file.with_extension("partial.fvbake");
    let file = match (made.complete, &a.out) {
        (false, None) => partial.clone(),
        _ => file,
    };
    save(&file, &key, &made.map).map_err(|e| Failure::file(&file, e))?;
    if made.complete && a.out.is_none() {
        // The whole one takes its place. That there was none is no failure.
        let _ = std::fs::remove_file(&partial);
    }
    report(a, &scene, method, &made, cached, start.elapsed().as_secs_f64(), &file, &warnings);
    if interrupted() {
        return Err(Failure::Interrupted(format!(
            "interrupted; what was done is kept in {}; --resume goes on",
            file.display()
        )));
    }
    Ok(())
}

/// Makes texels coarser until elements fit; says so.
fn fit_memory(
    scene: &Scene,
    settings: &mut BakeSettings,
    max: Option<u64>,
) -> Result<Option<String>, Failure> {
    let Some(max) = max else { return Ok(None) };
    // Vertex storage: at most three elements per triangle, half of that where triangles share corners.
    let vertices = scene.mesh.triangles.len() as u64 * 3 / 2;
    let allowed = (max / BYTES_PER_ELEMENT).saturating_sub(vertices) * 2 / 3;
    if u64::from(settings.texels) <= allowed {
        return Ok(None);
    }
    if allowed < 1024 {
        let needed = (vertices + 2048) * BYTES_PER_ELEMENT;
        return Err(Failure::Limit(format!(
            "{} triangles need about {} MiB to be baked; --max-memory allows {} MiB",
            scene.mesh.triangles.len(),
            needed >> 20,
            max >> 20
        )));
    }
    let before = std::mem::replace(&mut settings.texels, allowed as u32);
    Ok(Some(format!(
        "{before} texels do not fit in {} MiB; {allowed} coarser ones are used (walk finds this bake with --texels \
         {allowed})",
        max >> 20
    )))
}

/// Where an interrupted bake keeps what it has gathered.
fn state_file(file: &Path) -> PathBuf {
    file.with_extension("fvstate")
}

/// What an interrupted bake has kept; nothing where there is none.
fn kept_state(file: &Path, key: &[u8; 32]) -> Option<BakeState> {
    match load(file, key) {
        Ok(kept) => Some(kept),
        Err(CacheError::Io(e)) if e.kind() == std::io::ErrorKind::NotFound => None,
        // Never trusted, never fatal: the bake begins anew.
        Err(e) => {
            tracing::warn!("{}: {e}; the bake begins anew", file.display());
            None
        }
    }
}

fn particles(
    a: &BakeArguments,
    scene: &Scene,
    settings: &BakeSettings,
    key: &[u8; 32],
    file: &Path,
    start: Instant,
    watch: &dyn Watch,
) -> Result<Made, Failure> {
    let aims = (settings.error.unwrap_or(0.0), settings.particles.unwrap_or(0));
    let clock = BakeClock::new(start, watch, a.settings.time, aims);
    let accel = Accel::build(scene);
    let lights = Lights::build(scene);
    let indexed = Indexed { scene, accel: &accel, lights: &lights };
    let helped = a.helpers.open(&a.scene, &a.reading.reading(), scene.content_hash)?;
    let handed = Handed { hands: tracers::hands(helped.as_ref()), settings };
    let state = state_file(file);
    let kept = if a.resume { kept_state(&state, key) } else { None };
    let keep_going = |p: &foveal::illumination::bake::Progress| {
        clock.at(p);
        !interrupted() && !clock.is_over()
    };
    let (mut baker, mut resumed, mut baked);
    loop {
        baker = Baker::new(indexed, settings);
        resumed = kept.as_ref().is_some_and(|kept| baker.restore(kept));
        clock.resumed_at(baker.paths());
        baked = baker.run_by(indexed, &handed, &keep_going, &mut |_| {});
        if !handed.hands.doubts() {
            break;
        }
        tracing::warn!("a machine sent light that is not in the scene and is banned; the bake begins anew");
    }
    let helpers = helped.map(Helped::close);
    let stages = clock.finish();
    let measured = match baker.statement().filter(|_| baked.complete) {
        None => measured_by(indexed, &baked.illumination, settings),
        tested => tested,
    };
    if baked.complete {
        // Nothing to go on with. That there was none is no failure.
        let _ = std::fs::remove_file(&state);
    } else {
        save(&state, key, &baker.state()).map_err(|e| Failure::file(&state, e))?;
    }
    let s = &baked.illumination.summary;
    let gathering = stages.iter().find(|(name, _)| *name == "gather").map_or(0.0, |s| s.1);
    let rate = if gathering > 0.0 && !resumed { Some(s.particles as f64 / gathering) } else { None };
    let mut more = json!({
        "resumed": resumed,
        "particles_per_second": rate,
    });
    if let Some(helpers) = &helpers {
        more["stations"] = tracers::helpers_document(helpers);
    }
    Ok(Made { map: baked.illumination, complete: baked.complete, measured, more, stages })
}

fn radiosity(
    a: &BakeArguments,
    scene: &Scene,
    settings: &BakeSettings,
    start: Instant,
    watch: &dyn Watch,
) -> Result<Made, Failure> {
    let clock = BakeClock::new(start, watch, a.settings.time, (a.settings.error, 0));
    let accel = Accel::build(scene);
    let lights = Lights::build(scene);
    clock.enter(5);
    let mut solution = SceneRadiosity::new(scene, &accel).map_err(Failure::Input)?;
    let mut complete = false;
    let enough = |s: &SceneRadiosity| a.elements.is_none_or(|k| s.leaf_count() >= k as usize);
    while !interrupted() && !clock.is_over() {
        let error = solution.refine(scene, &accel);
        clock.say(solution.leaf_count() as u64, Some(error));
        if (error <= a.settings.error && enough(&solution)) || solution.is_exhausted() {
            complete = true;
            break;
        }
    }
    let (triangles, links) = (solution.leaf_count(), solution.link_count());
    let cut = a.elements.map(|k| {
        let criterion = match a.criterion {
            CriterionName::Photometric => ElementCriterion::Photometric,
            CriterionName::Perceptual => ElementCriterion::Perceptual,
            CriterionName::Optimal => ElementCriterion::Optimal,
        };
        simplify_mesh(&mut solution, scene, k as usize, criterion)
    });
    clock.enter(0);
    let baker = Baker::new(Indexed { scene, accel: &accel, lights: &lights }, settings);
    clock.enter(4);
    let map = solution.lightmap(scene, baker.atlas());
    let lit = scene.mesh.triangles.len();
    let mut more = json!({
        "links": links,
        "triangles_before": triangles,
        "triangles_after": lit,
        "triangles_saved": 1.0 - lit as f64 / triangles.max(1) as f64,
    });
    if let (Some(cut), Some(keys)) = (&cut, more.as_object_mut()) {
        keys.insert("elements_before".into(), json!(cut.elements_before));
        keys.insert("elements".into(), json!(cut.elements));
        keys.insert("squared_error".into(), json!(cut.squared_error));
    }
    // Its error is the solution's bound; elements may be fewer than that by wish.
    Ok(Made { map, complete, measured: None, more, stages: clock.finish() })
}

/// The error of a map at points that it was not made of; not of one that was interrupted.
fn measured_by(with: Indexed<'_>, map: &Illumination, settings: &BakeSettings) -> Option<Statement> {
    (!interrupted()).then(|| statement(with, map, settings.seed)).flatten()
}

#[expect(clippy::too_many_arguments, reason = "the one caller has them all")]
fn report(
    a: &BakeArguments,
    scene: &Scene,
    method: Method,
    made: &Made,
    cached: bool,
    seconds: f64,
    file: &Path,
    warnings: &[String],
) {
    let s = &made.map.summary;
    // What the bake says of itself, and never less than was found where it is seen.
    let error = s.relative_error.max(made.measured.map_or(0.0, |m| m.at_least()));
    if a.json {
        let mut document = json!({
            "schema": "foveal.bake/1",
            "scene": scene.name,
            "method": if method == Method::Particles { "particles" } else { "radiosity" },
            "seconds": seconds,
            "stage_seconds": made.stages.iter().map(|(n, t)| ((*n).to_owned(), json!(t))).collect::<serde_json::Map<_, _>>(),
            "error": error,
            "error_reached": error <= a.settings.error,
            "error_measured": made.measured.map(|m| [m.at_least(), m.at_most()]),
            "complete": made.complete && s.relative_error <= a.settings.error,
            "texels": made.map.element_count(),
            "has_indirect": s.has_indirect,
            "mean_irradiance": s.mean,
            "cached": cached,
            "file": file.display().to_string(),
            "peak_memory_bytes": peak_memory_bytes(),
            "warnings": warnings.iter().chain(&s.notes).collect::<Vec<_>>(),
        });
        let gathered = json!({
            "particles": s.particles,
            "rounds": s.rounds,
            "error_direct": s.direct_error,
            "error_particles": s.particle_error,
            "error_bias": s.bias_error,
        });
        let gathered = (method == Method::Particles).then_some(&gathered);
        for more in gathered.into_iter().chain([&made.more]) {
            if let (Some(all), Some(more)) = (document.as_object_mut(), more.as_object()) {
                all.extend(more.clone());
            }
        }
        return print_json(&document);
    }
    print_line(&format!("{}: {}", scene.title, file.display()));
    let how = match method {
        Method::Particles => format!("{} particles", s.particles),
        Method::Radiosity => format!(
            "{} radiosity triangles turned into texels of {}",
            made.more["triangles_before"], made.more["triangles_after"]
        ),
    };
    print_line(&format!(
        "{} texels, {how}, error {:.2} % in {seconds:.1} s{}",
        made.map.element_count(),
        100.0 * error,
        if cached { " (cached)" } else { "" },
    ));
    if let Some(elements) = made.more.get("elements") {
        print_line(&format!("{} elements simplified to {elements}", made.more["elements_before"]));
    }
    if let Some(measured) = made.measured {
        let [least, most] = [measured.at_least(), measured.at_most()].map(|e| 100.0 * e);
        print_line(&format!("error at held-out points, compared with paths: {least:.1} to {most:.1} %"));
    }
    if !made.stages.is_empty() {
        let stages: Vec<String> = made.stages.iter().map(|(name, t)| format!("{name} {t:.1} s")).collect();
        print_line(&stages.join(", "));
    }
    for note in &s.notes {
        print_line(note);
    }
    if !s.has_indirect && made.complete {
        print_line("no indirect light: no surface reflects any");
    }
    if !made.complete && !interrupted() {
        print_line("time ran out before the requested error was reached; --resume continues");
    } else if method == Method::Particles && s.relative_error > a.settings.error && !interrupted() {
        print_line(&format!(
            "the requested error, {} %, was not reached with {} particles; --particles allows more",
            100.0 * a.settings.error,
            s.particles
        ));
    }
}
