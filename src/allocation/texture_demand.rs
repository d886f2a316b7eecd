//! Which textures and mip levels a view wants, and what it would lose by coarser ones (Dumont 2003 §5.2.4;
//! REFERENCE §8.7).
//!
//! In: the texture-id map of a view with the illumination at each pixel, and the spatial errors of each texture. Out:
//! pixels per level and visible error per coarsest allowed level, in just noticeable differences times pixels.

use crate::display::cpu_pass::{Passes, draw};
use crate::display::tone::ToneMap;
use crate::display::{FrameBuffers, TextureLevel};
use crate::geometry::Ray;
use crate::image::{Map2d, luminance};
use crate::math;
use crate::perception::tvi::{TviTable, tvi};

use crate::scene::camera::CameraFrame;
use crate::world::World;

use super::decision::{Approximation, Resource};
use super::spatial_error::SpatialErrors;

/// Most levels a texture can have: sides up to 2^31.
pub const LEVELS_MAX: usize = 32;

/// f_D of Eqs. (7) and (11), in just noticeable differences: an error of `spatial` relative to a surface that shows
/// `luminance` cd/m² under `environment` cd/m² of reflection.
pub fn visible_error(luminance: f32, environment: f32, spatial: f32) -> f32 {
    luminance / tvi(luminance + environment) * spatial
}

/// What a view shows of one texture.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TextureUse {
    /// A: pixels that want each level; a pixel between two levels counts in both by its share.
    pub pixels: [f32; LEVELS_MAX],
    /// Σ L / TVI(L + L_e) over these pixels: the luminance part of f_D, times A.
    pub visibility: [f32; LEVELS_MAX],
}

impl Default for TextureUse {
    fn default() -> Self {
        Self { pixels: [0.0; LEVELS_MAX], visibility: [0.0; LEVELS_MAX] }
    }
}

impl TextureUse {
    /// A_i, all pixels that show the texture.
    pub fn total_pixels(&self) -> f32 {
        self.pixels.iter().sum()
    }

    /// v_i, the finest level wanted; none where the texture is not visible.
    pub fn finest(&self) -> Option<usize> {
        self.pixels.iter().position(|&pixels| pixels > 0.0)
    }

    /// −q_i(j) of Eqs. (3)–(5): the visible error if no level finer than `coarsest` is there. The areas of the paper
    /// cancel (correction D3), so a texture that is not visible has none.
    pub fn error(&self, spatial: &SpatialErrors, coarsest: usize) -> f64 {
        let wanted = self.visibility.iter().enumerate().take(coarsest.min(LEVELS_MAX));
        wanted
            .filter(|(_, visibility)| **visibility > 0.0)
            .map(|(m, visibility)| f64::from(*visibility) * f64::from(spatial.error(m, coarsest)))
            .sum()
    }
}

/// Gathers [`TextureUse`] in one pass over the buffers of a view.
#[derive(Clone, Debug, Default)]
pub struct TextureScan {
    thresholds: TviTable,
}

impl TextureScan {
    /// What a view shows of each texture.
    ///
    /// `wanted`: texture and level per pixel. `illumination`: I, the displayed illumination of the pixel in cd/m², so that
    /// T·I is what a texel T shows. `environment`: L_e, the luminance of non-diffuse reflection in cd/m², if there is any.
    /// `mean_luminances`: T̃ per texture; textures without one are passed over.
    ///
    /// Sums over pixels, not over a mean illumination: a texture on several objects or under several lights adds up
    /// (the additive form of REFERENCE §8.7).
    ///
    /// # Panics
    /// If the maps' sizes differ: a bug of the caller.
    pub fn gather(
        &self,
        wanted: &Map2d<TextureLevel>,
        illumination: &Map2d<f32>,
        environment: Option<&Map2d<f32>>,
        mean_luminances: &[f32],
    ) -> Vec<TextureUse> {
        assert_eq!(wanted.data().len(), illumination.data().len(), "maps of one view");
        assert!(environment.is_none_or(|map| map.data().len() == wanted.data().len()), "maps of one view");
        let mut uses = vec![TextureUse::default(); mean_luminances.len()];
        for (i, (word, &light)) in wanted.data().iter().zip(illumination.data()).enumerate() {
            let Some(texture) = word.texture().map(|texture| texture.0 as usize) else { continue };
            let (Some(used), Some(&mean)) = (uses.get_mut(texture), mean_luminances.get(texture)) else {
                continue;
            };
            let luminance = mean * light;
            let reflection = environment.map_or(0.0, |map| map.data()[i].max(0.0));
            let visibility = luminance / self.thresholds.threshold(luminance + reflection);
            let visibility = if visibility > 0.0 && visibility.is_finite() { visibility } else { 0.0 };
            let level = word.level();
            let fine = (level as usize).min(LEVELS_MAX - 1);
            let share = if fine + 1 < LEVELS_MAX { level - fine as f32 } else { 0.0 };
            used.pixels[fine] += 1.0 - share;
            used.visibility[fine] += (1.0 - share) * visibility;
            if share > 0.0 {
                used.pixels[fine + 1] += share;
                used.visibility[fine + 1] += share * visibility;
            }
        }
        uses
    }
}

/// What a view, and the turns and steps that may follow it, show of each texture: seen in few pixels by a camera behind the
/// viewer that looks to the sides too (Dumont 2003 §5.2.4.1).
///
/// `mean_luminances`: T̃ per texture. Pixels count as pixels of the view.
pub fn predicted_uses(world: &World, frame: &CameraFrame, mean_luminances: &[f32]) -> Vec<TextureUse> {
    /// Pixels of the view per pixel of the prediction, along an edge.
    const COARSENESS: u32 = 5;
    /// How much wider it looks.
    const WIDER: f32 = 1.3;
    let back = 0.05 * world.scene.diagonal();
    let ray = Ray { t_max: back, ..Ray::new(frame.eye, -frame.forward) };
    let free = world.accel.intersect(&world.scene, &ray).map_or(back, |hit| 0.8 * hit.t);
    let size = frame.size.map(|s| (s / COARSENESS).max(1));
    let behind = CameraFrame {
        eye: frame.eye - frame.forward * free,
        right: frame.right * WIDER,
        up: frame.up * WIDER,
        size,
        ..*frame
    };
    let (width, height) = (size[0] as usize, size[1] as usize);
    let mut buffers = FrameBuffers::new(width, height);
    draw(world, &behind, Passes { texture_ids: true }, &mut buffers);
    // Levels were chosen for these pixels, not for those of the view.
    let coarser = math::log2(behind.pixel_angle() / frame.pixel_angle());
    let display = &world.scene.display;
    let tone = ToneMap::from(display);
    let wanted = buffers.texture.map(|word| match word.texture() {
        Some(texture) => TextureLevel::new(texture, word.level() - coarser),
        None => word,
    });
    let illumination = Map2d::from_fn(width, height, |x, y| {
        let texture = wanted.at(x, y).texture().map_or(usize::MAX, |t| t.0 as usize);
        let mean = mean_luminances.get(texture).copied().unwrap_or(0.0);
        let shown = luminance(tone.to_linear(buffers.color.at(x, y))) * display.white_cd_m2;
        if mean > 0.0 { shown / mean } else { 0.0 }
    });
    let environment = reflection(world, &buffers, &illumination);
    let mut uses = TextureScan::default().gather(&wanted, &illumination, Some(&environment), mean_luminances);
    let share = (frame.size[0] * frame.size[1]) as f32 / (size[0] * size[1]) as f32;
    for used in &mut uses {
        used.pixels.iter_mut().chain(&mut used.visibility).for_each(|v| *v *= share);
    }
    uses
}

/// L_e = ρ_s F̃, what a view-dependent lobe adds at each pixel, cd/m². The mean F̃ of what surrounds the surface is taken for
/// that of the light that falls on it, which is the cosine lobe's mean of the same surroundings.
fn reflection(world: &World, buffers: &FrameBuffers, illumination: &Map2d<f32>) -> Map2d<f32> {
    let scene = &world.scene;
    let albedo: Vec<f32> = scene.materials.iter().map(|material| material.model.lobe_albedo()).collect();
    Map2d::from_fn(illumination.width(), illumination.height(), |x, y| {
        let of_triangle = |hit: crate::geometry::Hit| scene.mesh.materials.get(hit.triangle as usize);
        let material = buffers.hit.at(x, y).hit().and_then(of_triangle);
        material.map_or(0.0, |m| albedo[m.0 as usize] * illumination.at(x, y))
    })
}

/// Textures under a limit of memory: state j of texture i keeps levels j and coarser.
#[derive(Clone, Copy, Debug)]
pub struct TextureChoices<'a> {
    /// Bytes of each level of each texture, the finest first.
    pub bytes: &'a [Vec<u64>],
    /// What the view shows of each.
    pub uses: &'a [TextureUse],
    /// What coarser levels lose.
    pub spatial: &'a [SpatialErrors],
}

/// Error of each level that is not there where nobody would see it, so that free memory is still used.
const UNSEEN: f64 = 1e-9;

impl Resource for TextureChoices<'_> {
    fn action_count(&self) -> usize {
        self.bytes.len()
    }

    fn saliency(&self, _action: usize) -> f64 {
        1.0
    }

    fn approximations(&self, action: usize, out: &mut Vec<Approximation>) {
        let mut cost: u64 = self.bytes[action].iter().fold(0, |sum, &bytes| sum.saturating_add(bytes));
        for (coarsest, &bytes) in self.bytes[action].iter().enumerate() {
            let seen = match (self.uses.get(action), self.spatial.get(action)) {
                (Some(used), Some(spatial)) => used.error(spatial, coarsest),
                _ => 0.0,
            };
            out.push(Approximation { cost, error: seen + UNSEEN * coarsest as f64 });
            cost = cost.saturating_sub(bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocation::decision::{Constraint, decide};
    use crate::allocation::spatial_error::SpatialSettings;
    use crate::rng;
    use crate::scene::TextureId;
    use glam::Vec3;

    #[test]
    fn the_worked_example_of_the_reference() {
        // T̃ = .5, I = 100: L = 50.
        assert!((50.0 / tvi(50.0) - 16.191_99).abs() < 1e-4);
        assert!((visible_error(50.0, 0.0, 0.2375) - 3.845_598).abs() < 1e-4);
    }

    fn word(texture: u32, level: f32) -> TextureLevel {
        TextureLevel::new(TextureId(texture), level)
    }

    #[test]
    fn pixels_are_split_between_levels() {
        let wanted =
            Map2d::from_vec(4, 1, vec![word(0, 1.25), word(0, 1.0), TextureLevel::NONE, word(7, 0.0)]);
        let light = Map2d::new(4, 1, 100.0);
        let uses = TextureScan::default().gather(&wanted, &light, None, &[0.5, 0.5]);
        assert_eq!(uses.len(), 2);
        assert_eq!(&uses[0].pixels[..4], &[0.0, 1.75, 0.25, 0.0]);
        assert_eq!((uses[0].total_pixels(), uses[0].finest()), (2.0, Some(1)));
        assert_eq!((uses[1].total_pixels(), uses[1].finest()), (0.0, None));
        let factor = uses[0].visibility[1] / uses[0].pixels[1];
        assert!((factor / 16.191_99 - 1.0).abs() < 5e-3, "{factor}");
        // A bright reflection hides errors of the texture under it.
        let bright = TextureScan::default().gather(&wanted, &light, Some(&Map2d::new(4, 1, 500.0)), &[0.5]);
        assert!(bright[0].visibility[1] < 0.2 * uses[0].visibility[1]);
        let dark = TextureScan::default().gather(&wanted, &Map2d::new(4, 1, f32::NAN), None, &[0.5]);
        assert_eq!(dark[0].visibility[1], 0.0);
    }

    /// Where a texture is used under several lights and scales, what the most demanding use would lose counts at least:
    /// pixels are summed one by one, so no mean over uses hides it.
    #[test]
    fn the_largest_estimate_counts() {
        let spatial = SpatialErrors::of_levels(&mips(32, 0.9), &SpatialSettings::new(10.8, 100.0));
        let lights = [0.5, 5.0, 20.0, 60.0, 100.0];
        let levels = [0.0, 1.0, 2.5, 0.0, 3.0];
        let used = |shown: &dyn Fn(usize) -> bool| {
            let wanted =
                Map2d::from_fn(5, 20, |x, _| if shown(x) { word(0, levels[x]) } else { TextureLevel::NONE });
            let light = Map2d::from_fn(5, 20, |x, _| lights[x]);
            TextureScan::default().gather(&wanted, &light, None, &[0.5]).remove(0)
        };
        let together = used(&|_| true);
        assert_eq!(together.finest(), Some(0));
        for coarsest in 1..6 {
            let alone = |use_: usize| used(&|x| x == use_).error(&spatial, coarsest);
            let largest = (0..5).map(alone).fold(0.0, f64::max);
            assert!(together.error(&spatial, coarsest) >= largest * (1.0 - 1e-6) && largest > 0.0);
            let sum: f64 = (0..5).map(alone).sum();
            assert!((together.error(&spatial, coarsest) / sum - 1.0).abs() < 1e-5, "all uses add up");
        }
    }

    /// What is behind something else asks for nothing; what comes out from behind it asks at once.
    #[test]
    fn occluded_textures_ask_for_nothing() {
        use crate::illumination::Uniform;
        use crate::scene::texture::MipChain;
        use crate::scene::{Camera, Mesh, Model, Reflectance, Texture};
        use std::sync::Arc;
        let textured = |id: u32| {
            let mut material = crate::scene::test_scenes::grey();
            let map = Some(TextureId(id));
            material.model = Model::Lambert { albedo: Reflectance { color: Vec3::ONE, map } };
            material
        };
        let world = |lid: f32| {
            let mut mesh = Mesh::default();
            // A large box behind a small one, which hides all of it or some.
            crate::scene::test_scenes::add_box(
                &mut mesh,
                Vec3::new(-1.0, -1.0, -6.0),
                Vec3::new(1.0, 1.0, -5.0),
                0,
                false,
            );
            crate::scene::test_scenes::add_box(
                &mut mesh,
                Vec3::new(-lid, -lid, -2.0),
                Vec3::new(lid, lid, -1.5),
                1,
                false,
            );
            for (uv, p) in mesh.uvs.iter_mut().zip(&mesh.positions) {
                *uv = glam::Vec2::new(p.x, p.y);
            }
            let mut scene = crate::scene::test_scenes::scene(mesh, vec![textured(0), textured(1)]);
            for name in ["far", "near"] {
                let texels = (0..64 * 64u32).map(|i| [(i * 37 % 251) as u8; 4]).collect();
                scene.textures.push(Texture::new(name, MipChain::from_rgba8(64, 64, texels, true)));
            }
            World::new(Arc::new(scene), Arc::new(Uniform(Vec3::ONE)))
        };
        let seen = |lid: f32| {
            let camera = Camera { eye: Vec3::ZERO, target: Vec3::NEG_Z, up: Vec3::Y, fov_y: 0.9 };
            let uses = predicted_uses(&world(lid), &camera.frame(320, 240), &[0.5; 2]);
            [uses[0].total_pixels(), uses[1].total_pixels()]
        };
        let [hidden, near] = seen(1.0);
        assert!(hidden == 0.0 && near > 1000.0, "{hidden} {near}");
        let [far, near] = seen(0.2);
        assert!(far > 500.0 && near > 500.0, "{far} {near}");
    }

    /// Eq. (11): what reflects besides raises the threshold under its texture by L_e.
    #[test]
    fn reflections_hide_texture() {
        use crate::illumination::Uniform;
        use crate::scene::texture::MipChain;
        use crate::scene::{Camera, Distribution, Mesh, Model, Reflectance, Roughness, Texture};
        use std::sync::Arc;
        let seen = |specular: Option<f32>| {
            let albedo = Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) };
            let mut material = crate::scene::test_scenes::grey();
            material.model = match specular {
                None => Model::Lambert { albedo },
                Some(share) => Model::Ward {
                    diffuse: albedo,
                    specular: Reflectance::constant(Vec3::splat(share)),
                    roughness: Roughness { alpha_x: 0.2, alpha_y: 0.2, distribution: Distribution::Ggx },
                },
            };
            let mut mesh = Mesh::default();
            let (low, high) = (Vec3::new(-9.0, -9.0, -6.0), Vec3::new(9.0, 9.0, -5.0));
            crate::scene::test_scenes::add_box(&mut mesh, low, high, 0, false);
            for (uv, p) in mesh.uvs.iter_mut().zip(&mesh.positions) {
                *uv = glam::Vec2::new(p.x, p.y);
            }
            let mut scene = crate::scene::test_scenes::scene(mesh, vec![material]);
            scene.textures.push(Texture::new("even", MipChain::from_rgba8(8, 8, vec![[188; 4]; 64], true)));
            let world = World::new(Arc::new(scene), Arc::new(Uniform(Vec3::splat(0.5))));
            let camera = Camera { eye: Vec3::ZERO, target: Vec3::NEG_Z, up: Vec3::Y, fov_y: 0.9 };
            let used = predicted_uses(&world, &camera.frame(320, 240), &[0.5])[0];
            used.visibility.iter().sum::<f32>() / used.total_pixels()
        };
        let diffuse = seen(None);
        // L of the diffuse surface, from L / TVI(L).
        let light = (1..2000).map(|i| i as f32 * 0.1).min_by(|a, b| {
            let off = |l: f32| (l / tvi(l) - diffuse).abs();
            off(*a).total_cmp(&off(*b))
        });
        let light = light.unwrap();
        for share in [0.0, 0.2, 0.8] {
            let expected = light / tvi(light + share * light / 0.5);
            let got = seen(Some(share));
            assert!((got / expected - 1.0).abs() < 0.02, "ρ_s {share}: {got}, not {expected}");
        }
    }

    fn mips(side: usize, contrast: f32) -> Vec<Map2d<Vec3>> {
        let levels = side.ilog2() + 1;
        let noise = |x: usize, y: usize| rng::unit_f32(rng::hash(x as u64, y as u64, 3)) - 0.5;
        (0..levels)
            .map(|l| {
                let n = 1usize << l;
                Map2d::from_fn(side / n, side / n, |x, y| {
                    let sum: f32 = (0..n * n).map(|i| noise(x * n + i % n, y * n + i / n)).sum();
                    Vec3::splat(0.5 + contrast * sum / (n * n) as f32)
                })
            })
            .collect()
    }

    #[test]
    fn memory_goes_where_it_shows() {
        let settings = SpatialSettings::new(10.8, 100.0);
        let spatial: Vec<SpatialErrors> =
            [0.9, 0.9, 0.01, 0.9].map(|c| SpatialErrors::of_levels(&mips(32, c), &settings)).to_vec();
        let bytes: Vec<Vec<u64>> = vec![(0..6).map(|l| 4u64 << (2 * (5 - l))).collect(); 4];
        // Texture 0 fills the view, 1 is far away, 2 is nearly flat, 3 is not visible.
        let wanted = Map2d::from_fn(100, 10, |x, y| match (x, y) {
            (0..60, _) => word(0, 0.0),
            (60..65, _) => word(1, 3.0),
            _ => word(2, 0.0),
        });
        let light = Map2d::new(100, 10, 80.0);
        let uses = TextureScan::default().gather(&wanted, &light, None, &[0.5; 4]);
        assert_eq!(uses[1].error(&spatial[1], 3), 0.0);
        assert!(uses[1].error(&spatial[1], 5) > 0.0);
        let choices = TextureChoices { bytes: &bytes, uses: &uses, spatial: &spatial };
        let decided = |limit| decide(&choices, Constraint::Bytes(limit), None);
        let all: u64 = bytes.iter().flatten().sum();
        assert_eq!(decided(all).unwrap().states, [0; 4], "without pressure everything is loaded");
        let smallest = decided(15).unwrap_err();
        assert_eq!(smallest.smallest, 16);
        // Room for one full texture and little more.
        let tight = decided(bytes[0].iter().sum::<u64>() + 400).unwrap();
        assert_eq!(tight.states[0], 0);
        assert!(tight.states[1] <= 3 && tight.states[3] > 0, "{:?}", tight.states);
        assert!(tight.quality > -uses[2].error(&spatial[2], 5) - 1e-3);
    }
}
