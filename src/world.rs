//! A scene made ready to be walked: geometry index, lights and illumination beside it.

use std::sync::{Arc, OnceLock};

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Accel, Ray};
use crate::illumination::Irradiance;
use crate::image::luminance;
use crate::math;
use crate::rng::Stream;
use crate::scene::camera::CameraFrame;
use crate::scene::{Scene, Texture};
use crate::transport::Indexed;
use crate::transport::bidirectional::Bidirectional;
use crate::transport::caustic::{Caustics, Class, Sources};
use crate::transport::gather::{Gather, Trust};
use crate::transport::light::Lights;
use crate::transport::light::bright::BrightSurfaces;
use crate::transport::tracer::{Settings, Tracer};

/// Everything rays need, shared by all who trace and never changed. A refined illumination makes a
/// new `World` around the same scene.
#[derive(Clone)]
pub struct World {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its geometry index.
    pub accel: Arc<Accel>,
    /// Its lights.
    pub lights: Arc<Lights>,
    /// Diffuse illumination.
    pub illumination: Arc<dyn Irradiance>,
    /// Where light begins that no path finds, once it was looked for.
    unfound: Arc<OnceLock<Sources>>,
    /// The surfaces that most light comes from under this illumination, once they were looked for.
    bright: Arc<OnceLock<BrightSurfaces>>,
}

impl World {
    /// Builds geometry index and lights, and finds the exposure where files say none.
    pub fn new(scene: Arc<Scene>, illumination: Arc<dyn Irradiance>) -> Self {
        let accel = Arc::new(Accel::build(&scene));
        let lights = Arc::new(Lights::build(&scene));
        let scene = metered(scene, &accel, &lights);
        Self::of(scene, accel, lights, illumination)
    }

    /// Of what was built before.
    pub fn of(
        scene: Arc<Scene>,
        accel: Arc<Accel>,
        lights: Arc<Lights>,
        illumination: Arc<dyn Irradiance>,
    ) -> Self {
        Self { scene, accel, lights, illumination, unfound: Arc::default(), bright: Arc::default() }
    }

    /// The tracer of corrections in this world.
    pub fn tracer(&self) -> Tracer<'_> {
        Tracer::new(&self.scene, &self.accel, &self.lights, &*self.illumination, Settings::default())
    }

    /// Unbiased radiance along a ray, without the illumination.
    pub fn path_radiance(&self, ray: &Ray, stream: Stream) -> Vec3 {
        self.gather(Trust::Nobody).radiance(ray, stream)
    }

    /// Its scene with what rays need of it.
    pub fn indexed(&self) -> Indexed<'_> {
        Indexed { scene: &self.scene, accel: &self.accel, lights: &self.lights }
    }

    /// The integrator of this world's light, with as much trust in a map.
    pub fn gather<'a>(&'a self, trust: Trust<'a>) -> Gather<'a> {
        Gather::new(&self.scene, &self.accel, &self.lights, trust)
    }

    /// The same with this world's illumination as the value of what paths do not follow, and as the guide to where light
    /// comes from.
    pub fn gather_beyond_map(&self) -> Gather<'_> {
        let look = || BrightSurfaces::new(&self.scene, &*self.illumination);
        let gather = self.gather(Trust::EndValue(&*self.illumination)).looking_out();
        gather.looking_for(self.bright.get_or_init(look))
    }

    /// Particles of the light that [`Self::gather`] does not find.
    pub fn caustics(&self) -> Caustics<'_> {
        let look = || Sources::new(&self.scene, &self.accel, &self.lights, Class::Unfound);
        Caustics::new(&self.scene, &self.accel, &self.lights, self.unfound.get_or_init(look))
    }

    /// Bidirectional paths of a view, without the illumination.
    pub fn bidirectional<'a>(&'a self, frame: &'a CameraFrame) -> Bidirectional<'a> {
        Bidirectional::new(&self.scene, &self.accel, &self.lights, frame)
    }

    /// The same world with other levels of its textures in memory.
    pub fn with_resident(&self, textures: Vec<Texture>) -> Self {
        Self { scene: Arc::new(self.scene.with_resident(textures)), ..self.clone() }
    }

    /// Another scene of the same triangles and lights.
    pub fn with_scene(&self, scene: Arc<Scene>) -> Self {
        let Self { accel, lights, illumination, .. } = self.clone();
        Self::of(scene, accel, lights, illumination)
    }

    /// The same scene under another illumination.
    pub fn with_illumination(&self, illumination: Arc<dyn Irradiance>) -> Self {
        Self { illumination, bright: Arc::default(), ..self.clone() }
    }
}

/// Columns and rows of rays by which a scene is metered: 4,096 of them.
const METER: u32 = 64;

/// Paths for each of these rays, so that noise does not pass for darkness.
const METER_PATHS: u32 = 4;

/// What the mean of a picture becomes on a display: grey cards reflect as much.
const MIDDLE_GREY: f32 = 0.18;

/// The scene with its exposure found, where its files say none (`Display::metered`): what the start view shows becomes
/// middle grey by its geometric mean, with a floor of 10⁻⁴ of the brightest so that black does not decide.
///
/// Paths find it, not the illumination, so that it is a number of the scene, whatever is baked.
pub fn metered(mut scene: Arc<Scene>, accel: &Accel, lights: &Lights) -> Arc<Scene> {
    let view = scene.cameras.first().filter(|_| scene.display.metered).map(|c| c.camera);
    let Some(view) = view else { return scene };
    let frame = view.frame(METER, METER);
    let pixels: Vec<Option<f32>> = (0..METER * METER)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % METER, i / METER);
            let ray = Ray::new(frame.eye, frame.direction(x as f32 + 0.5, y as f32 + 0.5));
            let paths = Gather::new(&scene, accel, lights, Trust::Nobody);
            let of = |s: u32| paths.radiance(&ray, Stream::new(0x3e7e, i.into(), s.into()));
            // Where nothing is, nothing is too dark.
            if scene.environment.is_none() && accel.intersect_seen(&scene, &ray).is_none() {
                return None;
            }
            let mean = (0..METER_PATHS).map(|s| luminance(of(s))).sum::<f32>() / METER_PATHS as f32;
            Some(if mean.is_finite() { mean.max(0.0) } else { 0.0 })
        })
        .collect();
    let pixels: Vec<f32> = pixels.into_iter().flatten().collect();
    let most = pixels.iter().copied().fold(0.0, f32::max);
    if most <= 0.0 {
        return scene;
    }
    // In a fixed order.
    let sum: f64 = pixels.iter().map(|&l| f64::from(math::ln(l + 1e-4 * most))).sum();
    let mean = math::exp((sum / pixels.len() as f64) as f32);
    let exposure = MIDDLE_GREY / mean;
    if exposure.is_finite() && exposure > 0.0 {
        let scene = Arc::make_mut(&mut scene);
        scene.display.exposure = exposure;
        scene.display.metered = false;
    }
    scene
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World").field("scene", &self.scene.name).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::{Environment, Mesh};

    #[test]
    fn an_even_radiance_is_metered_to_middle_grey() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(50.0), Vec3::splat(51.0), 0, false);
        let mut made = crate::scene::test_scenes::with_camera(scene(mesh, vec![grey()]));
        made.environment =
            Some(Environment { radiance: Vec3::splat(250.0), map: None, rotate_up: 0.0, up: Vec3::Y });
        made.display.metered = true;
        let (accel, lights) = (Accel::build(&made), Lights::build(&made));
        let found = metered(Arc::new(made), &accel, &lights);
        let expected = MIDDLE_GREY / (250.0 * (1.0 + 1e-4));
        assert!((found.display.exposure / expected - 1.0).abs() < 1e-3, "{}", found.display.exposure);
        assert!(!found.display.metered);
        // Whoever says a number keeps it.
        assert_eq!(metered(found.clone(), &accel, &lights).display, found.display);
    }
}
