//! Views of a scene with all samples traced, and walks through them under each order of rays.
//!
//! What walks is the engine with one tracer, on a virtual clock that moves by the processor time that tracing takes: so
//! every order has the same time whatever else the machine does, and what is measured is what runs. What a view takes
//! in all, and what it comes to, is traced once beside it.

use std::sync::Arc;
use std::time::Duration;

use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::first_approximation::Probes;
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::video;
use foveal::perception::viewing::Viewing;
use foveal::scene::Camera;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::Footprint;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::world::World;
use foveal_runtime::simulate::{Simulation, Strategy, Work};
use glam::Vec3;

use foveal_actors::renderer::Renderer;
use foveal_actors::stages::Stage;
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::{interrupted, uninterrupted};
use foveal_engine::process::cpu_ns;
use foveal_engine::{Clock, Engine, Opened, Options, Settings};
use foveal_terminal::arguments::Size;

/// Frames per second of the walk.
pub(super) const FRAMES_PER_SECOND: f32 = 10.0;

/// One of the orders that are compared.
#[derive(Clone)]
pub(super) struct Entrant {
    pub(super) name: String,
    pub(super) policy: RayPolicy,
    /// Without any first approximation, as both papers draw what is not diffuse.
    black: bool,
}

/// The orders by their names.
pub(super) fn policies(names: &[String]) -> Result<Vec<Entrant>, Failure> {
    let of = |name: &str, policy: RayPolicy| Entrant { name: name.to_owned(), policy, black: false };
    let paper = RayPolicy { reduction: RayPolicy::HABER_REDUCTION, ..RayPolicy::new(Policy::Attention, 0) };
    let published = Entrant { black: true, ..of("as published in 2001", paper) };
    let mut all = vec![published, of("attention of 2001", paper)];
    for policy in [Policy::Attention, Policy::Uniform, Policy::Utility] {
        all.push(of(policy.name(), RayPolicy::new(policy, 0)));
    }
    if names.iter().any(|n| n == "all") {
        return Ok(all);
    }
    let one = |name: &String| {
        let policy: Policy = name.parse().map_err(Failure::Usage)?;
        Ok(of(policy.name(), RayPolicy::new(policy, 0)))
    };
    names.iter().map(one).collect()
}

impl Entrant {
    /// All pixels level by level over nothing, as a plain ray tracer would on this lattice.
    pub(super) fn plain_lattice() -> Self {
        Self { name: "√5 order".into(), policy: RayPolicy::new(Policy::Uniform, 0), black: true }
    }
}

/// A view with all of its samples.
pub(super) struct Traced {
    camera: Camera,
    pub(super) frame: CameraFrame,
    pub(super) buffers: FrameBuffers,
    /// Seconds per sample, by object id.
    pub(super) cost: Vec<f64>,
    /// Seconds that all samples take.
    seconds: f64,
    /// Seconds of drawing the base layer.
    pub(super) drawing: f64,
    pub(super) reference: Map2d<Vec3>,
}

impl Traced {
    /// Seconds that all samples take.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }
}

/// A scene with all views traced.
pub(super) struct Study {
    opened: Opened,
    pub(super) tone: ToneMap,
    pub(super) views: Vec<Traced>,
    probes: Arc<Probes>,
    settings: Settings,
}

impl Study {
    /// `frames` views along the scene's first path, or from its first camera where it has none.
    ///
    /// # Errors
    /// If the scene has no camera, or Ctrl-C was pressed before all were traced.
    pub(super) fn new(opened: Opened, size: Size, frames: u32, coarse_maps: bool) -> Result<Self, Failure> {
        let world = &opened.world;
        let still = foveal_engine::opened::camera(&world.scene, None)?.camera;
        let camera = |i: u32| match world.scene.paths.first() {
            Some(path) => path.at(i as f32 / FRAMES_PER_SECOND, still.up, still.fov_y),
            None => still,
        };
        let mut settings = Settings::new(size.width, size.height, 1);
        if coarse_maps {
            settings.environment_bytes = 0;
        }
        let mut views = Vec::new();
        for i in 0..frames {
            uninterrupted()?;
            views.push(traced(world, camera(i), &settings));
        }
        let probes = Arc::new(Probes::of_world(world));
        Ok(Self { tone: ToneMap::from(&world.scene.display), views, probes, settings, opened })
    }

    pub(super) fn world(&self) -> &World {
        &self.opened.world
    }

    /// The same, with all samples traced once more: for another run's times.
    pub(super) fn retrace(&mut self) {
        for view in &mut self.views {
            *view = traced(&self.opened.world, view.camera, &self.settings);
        }
    }

    /// What each view converges to.
    pub(super) fn converged(&self) -> Vec<Map2d<Vec3>> {
        self.views.iter().map(|v| v.reference.clone()).collect()
    }

    /// What each view converges to with other random numbers: as far as that is from [`Self::converged`], no picture of a
    /// walk can be expected to know better.
    pub(super) fn converged_otherwise(&self) -> Result<Vec<Map2d<Vec3>>, Failure> {
        let settings = Settings { seed: !self.settings.seed, ..self.settings };
        let mut pictures = Vec::new();
        for view in &self.views {
            uninterrupted()?;
            pictures.push(traced(&self.opened.world, view.camera, &settings).reference);
        }
        Ok(pictures)
    }

    /// Where the walk begins and stands still.
    pub(super) fn still(&self) -> &Traced {
        &self.views[0]
    }

    /// Stands still: what is shown at the beginning and after these shares of the time of all samples. Each frame is
    /// attended to.
    pub(super) fn stand(
        &self,
        entrant: &Entrant,
        shares: impl Iterator<Item = f64>,
        mut shown: impl FnMut(f64, Map2d<Vec3>),
    ) -> Result<Times, Failure> {
        let (mut walk, view) =
            (Walk::new(self, entrant, self.settings.footprint, Counts::Tracing)?, self.still());
        for share in std::iter::once(0.0).chain(shares) {
            let picture = walk.frame(&view.camera, share * view.seconds())?;
            shown(share * view.seconds(), picture);
        }
        Ok(walk.times())
    }

    /// Walks all views, each with time for `share` of its samples, and gives what is shown.
    pub(super) fn walk(&self, entrant: &Entrant, share: f64) -> Result<(Times, Vec<Map2d<Vec3>>), Failure> {
        let mut walk = Walk::new(self, entrant, self.settings.footprint, Counts::Tracing)?;
        let shown = self.shown(&mut walk, |view| share * view.seconds())?;
        Ok((walk.times(), shown))
    }

    /// Walks all views with these footprints, so many seconds each for everything, and gives what is shown.
    pub(super) fn walk_in_time(
        &self,
        entrant: &Entrant,
        footprint: Footprint,
        seconds: f64,
    ) -> Result<Vec<Map2d<Vec3>>, Failure> {
        self.shown(&mut Walk::new(self, entrant, footprint, Counts::Everything)?, |_| seconds)
    }

    fn shown(&self, walk: &mut Walk, time: impl Fn(&Traced) -> f64) -> Result<Vec<Map2d<Vec3>>, Failure> {
        let mut until = 0.0;
        let frame = |view: &Traced| {
            until += time(view);
            walk.frame(&view.camera, until)
        };
        self.views.iter().map(frame).collect()
    }

    /// How near the pictures of a walk come to references, in just objectionable differences: 10 is the same.
    pub(super) fn jod(&self, shown: &[Map2d<Vec3>], references: &[Map2d<Vec3>]) -> Result<f64, Failure> {
        let (display, camera) = (&self.world().scene.display, &self.still().camera);
        let [width, height] = [self.settings.width, self.settings.height];
        let fov_x = 2.0 * ((0.5 * camera.fov_y).tan() * width as f32 / height as f32).atan();
        let viewing = Viewing::from_centre_of_projection(display.white_cd_m2, width as usize, fov_x);
        let jod = video::jod(shown, references, FRAMES_PER_SECOND, &self.tone, &viewing);
        jod.map(f64::from).map_err(Failure::Check)
    }
}

/// Draws a view and traces all of its samples, object by object. Processor time: what else the machine does is none of
/// the policies' business.
fn traced(world: &World, camera: Camera, s: &Settings) -> Traced {
    let frame = camera.frame(s.width, s.height);
    let mut buffers = FrameBuffers::new(s.width as usize, s.height as usize);
    let start = cpu_ns();
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let drawing = 1e-9 * (cpu_ns() - start);
    let mut pixels = vec![Vec::new(); world.scene.objects.len().max(1)];
    for (i, id) in buffers.object.data().iter().enumerate().filter(|(_, id)| **id != 0) {
        pixels[*id as usize].push((i as i32 % s.width as i32, i as i32 / s.width as i32));
    }
    let mut reference = buffers.color.clone();
    let (mut cost, mut seconds) = (vec![0.0; pixels.len()], 0.0);
    for (object, pixels) in pixels.into_iter().enumerate().filter(|(_, pixels)| !pixels.is_empty()) {
        let (count, start) = (pixels.len(), cpu_ns());
        let owner = Owner { view: 0, object: object as u32, k: 0 };
        let batch = trace_samples(world, &frame, &buffers, owner, pixels.into_iter(), s.seed);
        let taken = 1e-9 * (cpu_ns() - start);
        cost[object] = taken / count as f64;
        seconds += taken;
        for (pixel, color) in batch.pixels.iter().zip(&batch.colors) {
            *reference.at_mut(usize::from(pixel[0]), usize::from(pixel[1])) += *color;
        }
    }
    Traced { camera, frame, buffers, cost, seconds, drawing, reference }
}

/// Seconds of a walk.
pub(super) struct Times {
    pub(super) deciding: f64,
    pub(super) tracing: f64,
}

/// What the clock of a walk counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counts {
    /// The tracer's time, on samples and maps: what orders differ in.
    Tracing,
    /// That of drawing as well.
    Everything,
}

/// One order on its way.
struct Walk {
    engine: Engine,
    counts: Counts,
    /// What the clock counted so far.
    counted: f64,
    deciding: Duration,
}

impl Walk {
    fn new(study: &Study, entrant: &Entrant, footprint: Footprint, counts: Counts) -> Result<Self, Failure> {
        let Settings { environment_bytes, .. } = study.settings;
        let settings = Settings {
            footprint,
            policy: entrant.policy,
            approximates: !entrant.black,
            environment_bytes: if entrant.black { 0 } else { environment_bytes },
            ..study.settings
        };
        let simulation = Simulation {
            strategy: Strategy::RoundRobin,
            work: Work::Measured,
            steps_max: u64::MAX,
            ..Simulation::new(0)
        };
        let (clock, probes) = (Clock::Virtual(simulation), Some(study.probes.clone()));
        let options = Options { clock, probes, ..Options::new(settings) };
        let engine = Engine::start(study.opened.clone(), options)?;
        Ok(Self { engine, counts, counted: 0.0, deciding: Duration::ZERO })
    }

    /// A frame that is shown so many counted seconds after the walk began; where the one before took longer than it should,
    /// that is taken from this one.
    fn frame(&mut self, camera: &Camera, until: f64) -> Result<Map2d<Vec3>, Failure> {
        self.beside(|engine| engine.begin(camera))?;
        // A run that was interrupted is thrown away.
        let left = if interrupted() { 0.0 } else { until - self.counted };
        let began = self.engine.runtime().now().seconds();
        self.engine.work_until(Duration::from_secs_f64(left.max(0.0)), |_| false)?;
        self.counted += self.engine.runtime().now().seconds() - began;
        let frame = self.beside(Engine::end)?;
        self.deciding +=
            frame.stages.iter().filter(|s| s.0 == Stage::Allocate).map(|s| s.1).sum::<Duration>();
        let nothing = || Failure::Check("a frame was shown, and there is no picture".into());
        self.engine.look(Renderer::picture).flatten().ok_or_else(nothing)
    }

    /// Does what is not an order's own work. Tracers go on meanwhile: an order whose jobs are long would have that for nothing
    /// if it did not count.
    fn beside<R>(&mut self, work: impl FnOnce(&mut Engine) -> Result<R, Failure>) -> Result<R, Failure> {
        let counts = self.counts;
        let counted = |engine: &Engine| match counts {
            Counts::Tracing => tracing(engine),
            Counts::Everything => engine.runtime().now().seconds(),
        };
        let before = counted(&self.engine);
        let result = work(&mut self.engine);
        self.counted += counted(&self.engine) - before;
        result
    }

    fn times(&self) -> Times {
        Times { deciding: self.deciding.as_secs_f64(), tracing: tracing(&self.engine) }
    }
}

/// Seconds that tracers were busy for.
fn tracing(engine: &Engine) -> f64 {
    let counters = engine.runtime().counters();
    let busy = counters.iter().filter(|c| c.name.starts_with("tracer")).map(|c| c.busy_ns as f64);
    1e-9 * busy.sum::<f64>()
}

impl Drop for Walk {
    /// Nobody waits for what is still to be traced.
    fn drop(&mut self) {
        self.engine.stall(foveal_engine::Stalled::Tracers);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made::MadeScene;
    use crate::stages::quick_world;

    /// Every order ends where the samples that were traced beside it are, and begins with what it draws without any.
    #[test]
    fn orders_begin_as_they_are_meant_to_and_end_at_the_reference() {
        let scene = MadeScene::bundled("box").expect("a scene");
        let opened = Opened::of_world(quick_world(scene.path()).expect("a world"));
        let study = Study::new(opened, Size { width: 64, height: 48 }, 2, false).expect("a study");
        let view = study.still();
        let corrected = || (0..).zip(view.buffers.object.data()).filter(|(_, id)| **id != 0).map(|(i, _)| i);
        for entrant in policies(&["all".into()]).expect("orders") {
            let mut shown = Vec::new();
            // What maps and noise take comes on top of the samples' time.
            let times = study.stand(&entrant, [0.5, 50.0].into_iter(), |s, picture| shown.push((s, picture)));
            let times = times.expect("a walk");
            assert!(times.tracing > 0.0 && times.deciding > 0.0, "{}", entrant.name);
            let [(_, first), _, (seconds, last)] = &shown[..] else { panic!("three pictures") };
            assert_eq!(*seconds, 50.0 * view.seconds());
            assert_eq!(last, &view.reference, "{}", entrant.name);
            let (base, first) = (view.buffers.color.data(), first.data());
            let bare = corrected().filter(|&i: &usize| first[i] == base[i]).count();
            let all = corrected().count();
            assert!(
                if entrant.black { bare > all / 4 } else { bare < all / 4 },
                "{}: {bare} of {all}",
                entrant.name
            );
        }
        let (_, shown) =
            study.walk(&policies(&["utility".into()]).expect("an order")[0], 0.2).expect("a walk");
        assert!(shown.len() == 2 && shown[0] != shown[1] && shown[1] != study.views[1].reference);
    }
}
