//! Which parts of the machine a scene needs (DESIGN, "Skip what a scene does not need").

use std::collections::BTreeSet;

use super::{Budget, Model, Scene};

/// A part of the machine that may be skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Subsystem {
    /// The actors that trace samples.
    Tracers,
    /// The model of attention.
    Analyzer,
    /// The cache of samples, with ageing and warp.
    SampleCache,
    /// Object ids in the frame buffer.
    IdPass,
    /// Distributed rays for rough lobes.
    DistributedRays,
    /// Shadow rays that go on through what lets light pass.
    TransparentShadows,
    /// Shadow rays at all.
    ShadowRays,
    /// The bake of diffuse illumination.
    Illumination,
    /// Look-ups in textures.
    Textures,
    /// Texture ids and mip levels in the frame buffer.
    TextureIdPass,
    /// Visibility thresholds of texture levels.
    ElevationMaps,
    /// Prefiltered environment maps of objects.
    EnvironmentMaps,
}

impl Subsystem {
    /// Every part.
    pub const ALL: [Subsystem; 12] = [
        Subsystem::Tracers,
        Subsystem::Analyzer,
        Subsystem::SampleCache,
        Subsystem::IdPass,
        Subsystem::DistributedRays,
        Subsystem::TransparentShadows,
        Subsystem::ShadowRays,
        Subsystem::Illumination,
        Subsystem::Textures,
        Subsystem::TextureIdPass,
        Subsystem::ElevationMaps,
        Subsystem::EnvironmentMaps,
    ];

    /// Its name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Subsystem::Tracers => "tracers",
            Subsystem::Analyzer => "analyzer",
            Subsystem::SampleCache => "sample cache",
            Subsystem::IdPass => "object-id pass",
            Subsystem::DistributedRays => "distributed rays",
            Subsystem::TransparentShadows => "transparent shadows",
            Subsystem::ShadowRays => "shadow rays",
            Subsystem::Illumination => "illumination bake",
            Subsystem::Textures => "textures",
            Subsystem::TextureIdPass => "texture-id pass",
            Subsystem::ElevationMaps => "elevation maps",
            Subsystem::EnvironmentMaps => "environment maps",
        }
    }
}

/// Whether a part is needed, and why.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct PlanPart {
    /// Name of the part.
    pub part: &'static str,
    /// Whether it is needed.
    pub needed: bool,
    /// The reason, with the numbers behind it.
    pub why: String,
}

/// What a scene needs within a budget.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScenePlan {
    /// One entry per [`Subsystem`], in the order of [`Subsystem::ALL`].
    pub parts: Vec<PlanPart>,
}

impl ScenePlan {
    /// The plan for a scene within a budget (usually [`SceneParts::budget`](super::SceneParts::budget), changed by the command line).
    pub fn new(scene: &Scene, budget: &Budget) -> Self {
        let facts = Facts::of(scene, budget);
        let parts = Subsystem::ALL.map(|part| {
            let (needed, why) = facts.decide(part);
            PlanPart { part: part.name(), needed, why }
        });
        Self { parts: parts.to_vec() }
    }

    /// Whether a part is needed.
    pub fn needs(&self, part: Subsystem) -> bool {
        self.parts.iter().any(|p| p.part == part.name() && p.needed)
    }

    /// How many parts are skipped.
    pub fn skipped(&self) -> usize {
        self.parts.iter().filter(|p| !p.needed).count()
    }
}

/// What decides.
struct Facts {
    objects: usize,
    glossy: usize,
    transparent: usize,
    cut_outs: usize,
    textured: usize,
    diffuse_triangles: usize,
    lights: usize,
    texture_bytes: u64,
    texture_limit: Option<u64>,
}

fn count(n: usize, what: &str) -> String {
    let s = if n == 1 { "" } else { "s" };
    if n == 0 { format!("no {what}") } else { format!("{n} {what}{s}") }
}

impl Facts {
    fn of(scene: &Scene, budget: &Budget) -> Self {
        // Only materials that a triangle has.
        let used: BTreeSet<u32> = scene.mesh.materials.iter().map(|m| m.0).collect();
        let materials: Vec<_> = used.iter().filter_map(|&m| scene.materials.get(m as usize)).collect();
        let emissive = materials.iter().filter(|m| m.is_emissive()).count();
        Self {
            objects: scene.objects.len().saturating_sub(1),
            glossy: materials.iter().filter(|m| m.is_glossy()).count(),
            transparent: materials.iter().filter(|m| matches!(m.model, Model::Dielectric { .. })).count(),
            cut_outs: materials.iter().filter(|m| m.may_vanish()).count(),
            textured: scene.textures.len(),
            diffuse_triangles: scene.objects.first().map_or(0, |o| o.triangles.len()),
            lights: emissive + scene.lights.len() + usize::from(scene.environment.is_some()),
            texture_bytes: scene.textures.iter().map(|t| t.mips.bytes() as u64).sum(),
            texture_limit: budget.texture_bytes,
        }
    }

    fn decide(&self, part: Subsystem) -> (bool, String) {
        let samples = (self.objects > 0, count(self.objects, "non-diffuse object"));
        match part {
            Subsystem::Tracers
            | Subsystem::Analyzer
            | Subsystem::SampleCache
            | Subsystem::IdPass
            | Subsystem::EnvironmentMaps => samples,
            Subsystem::DistributedRays => (self.glossy > 0, count(self.glossy, "rough glossy material")),
            Subsystem::TransparentShadows => {
                let why = format!(
                    "{}, {}",
                    count(self.transparent, "transparent material"),
                    count(self.cut_outs, "cut-out material")
                );
                (self.transparent + self.cut_outs > 0, why)
            }
            Subsystem::ShadowRays => (self.lights > 0, count(self.lights, "light")),
            Subsystem::Illumination => {
                let why = format!(
                    "{}, {}",
                    count(self.diffuse_triangles, "diffuse triangle"),
                    count(self.lights, "light")
                );
                (self.diffuse_triangles > 0 && self.lights > 0, why)
            }
            Subsystem::Textures => (self.textured > 0, count(self.textured, "texture")),
            Subsystem::TextureIdPass | Subsystem::ElevationMaps => match self.texture_limit {
                _ if self.textured == 0 => (false, "no texture".to_owned()),
                None => (false, "no limit on texture memory".to_owned()),
                Some(limit) => {
                    let over = self.texture_bytes > limit;
                    let fits = if over { "do not fit" } else { "fit" };
                    (over, format!("textures of {} bytes {fits} into {limit}", self.texture_bytes))
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::test_scenes::{add_box, box_scene, grey, material, mirror, scene};
    use super::super::texture::MipChain;
    use super::super::{Mesh, Reflectance, Roughness, Texture};
    use super::*;

    fn check(scene: &Scene, needed: &[Subsystem]) {
        let plan = ScenePlan::new(scene, &scene.budget);
        let found: Vec<Subsystem> = Subsystem::ALL.into_iter().filter(|p| plan.needs(*p)).collect();
        assert_eq!(found, needed, "{plan:#?}");
        assert_eq!(plan.skipped(), Subsystem::ALL.len() - needed.len());
    }

    fn two_boxes(second: super::super::Material) -> Scene {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::ZERO, Vec3::ONE, 0, true);
        add_box(&mut mesh, Vec3::splat(0.4), Vec3::splat(0.6), 1, false);
        let mut lamp = grey();
        lamp.emission = Reflectance::constant(Vec3::ONE);
        scene(mesh, vec![lamp, second])
    }

    #[test]
    fn a_dark_diffuse_box_needs_nothing() {
        check(&box_scene(true), &[]);
    }

    #[test]
    fn mirrors_need_samples_but_no_distributed_rays() {
        use Subsystem::*;
        let samples = [Tracers, Analyzer, SampleCache, IdPass, ShadowRays, Illumination, EnvironmentMaps];
        check(&two_boxes(mirror()), &samples);
        check(&two_boxes(grey()), &[ShadowRays, Illumination]);
    }

    #[test]
    fn glossy_and_glass() {
        let rough = Roughness { alpha_x: 0.2, alpha_y: 0.2, distribution: Default::default() };
        let metal = Model::Metal { specular: Reflectance::constant(Vec3::ONE), roughness: rough };
        let plan = |m| ScenePlan::new(&two_boxes(material("m", m)), &Budget::default());
        let p = plan(metal);
        assert!(p.needs(Subsystem::DistributedRays) && !p.needs(Subsystem::TransparentShadows));
        let smooth = Roughness { alpha_x: 0.0, alpha_y: 0.0, ..rough };
        let p =
            plan(Model::Dielectric { ior: 1.5, transmittance: Vec3::ONE, thin: false, roughness: smooth });
        assert!(!p.needs(Subsystem::DistributedRays) && p.needs(Subsystem::TransparentShadows));
    }

    #[test]
    fn texture_passes_depend_on_the_limit() {
        let mut s = box_scene(true);
        s.textures.push(Texture::new("t", MipChain::from_rgba8(16, 16, vec![[0; 4]; 256], true)));
        let needs = |limit: Option<u64>| {
            let p = ScenePlan::new(&s, &Budget { texture_bytes: limit, fps: None });
            (p.needs(Subsystem::Textures), p.needs(Subsystem::ElevationMaps))
        };
        assert_eq!(needs(None), (true, false));
        assert_eq!(needs(Some(1 << 20)), (true, false));
        assert_eq!(needs(Some(1000)), (true, true));
    }
}
