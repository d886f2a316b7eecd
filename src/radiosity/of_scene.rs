//! Hierarchical radiosity of a scene, simplified to any number of elements, turned into a lightmap
//! (the mesh-to-texture step of Haber et al. 2001; Dumont et al. 2003 §5.4).

use glam::Vec3;

use super::mesh::RadiosityMesh;
use super::simplify::{Criterion, Rung, Simplified, cut_below, simplify};
use super::{Patch, Radiosity, Refinement};
use crate::geometry::{Accel, Ray};
use crate::illumination::Irradiance;
use crate::illumination::atlas::Atlas;
use crate::illumination::stored::{Illumination, Summary};
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::{Light, Material, Model, Reflectance, Scene};
use crate::transport::bsdf::cosine_hemisphere;

/// Reflectances are clamped to this: at 1 light would never end.
const REFLECTANCE_MAX: f32 = 0.99;
/// Rays that decide whether anything faces the back of a polygon.
const BACK_RAYS: u64 = 32;
/// Power through a link, as a share of all power, in the first solution; each further one allows a quarter.
const FIRST_POWER: f32 = 4e-3;
/// A radiosity solution of a scene, refined step by step.
#[derive(Clone, Debug)]
pub struct SceneRadiosity {
    solution: Radiosity<3>,
    /// Per patch the triangle and whether it is its back.
    owners: Vec<(u32, bool)>,
    power: f32,
    error: f32,
}

fn mean(scene: &Scene, r: &Reflectance) -> Vec3 {
    let of_map = r.map.map_or(Vec3::ONE, |map| {
        let [r, g, b, _] = scene.textures[map.0 as usize].mean();
        Vec3::new(r, g, b)
    });
    r.color * of_map
}

/// Diffuse reflectance of a material, mean over its texture.
fn diffuse(scene: &Scene, triangle: u32) -> Vec3 {
    match &scene.materials[scene.mesh.materials[triangle as usize].0 as usize].model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => mean(scene, albedo),
        Model::CookTorrance { diffuse, .. } | Model::Ward { diffuse, .. } => mean(scene, diffuse),
        Model::MetalRough(m) => mean(scene, &m.diffuse),
        _ => Vec3::ZERO,
    }
    .clamp(Vec3::ZERO, Vec3::splat(REFLECTANCE_MAX))
}

/// Whether two points see each other.
fn visible(scene: &Scene, accel: &Accel, p: Vec3, q: Vec3) -> bool {
    !accel.occluded(scene, &Ray { t_min: 1e-4, t_max: 1.0 - 1e-4, ..Ray::new(p, q - p) })
}

/// Whether light may reach the back of a triangle: whether anything is there to come from.
fn back_is_open(scene: &Scene, accel: &Accel, triangle: u32, corners: [Vec3; 3], normal: Vec3) -> bool {
    let (x, y) = normal.any_orthonormal_pair();
    let lift = 1e-4 * scene.diagonal();
    (0..BACK_RAYS).any(|ray| {
        let mut stream = Stream::new(0xbac4, triangle.into(), ray);
        let [u, v] = stream.next_2d();
        let s = u.sqrt();
        let p = corners[0] * (1.0 - s) + corners[1] * (s * (1.0 - v)) + corners[2] * (s * v) - normal * lift;
        let local = cosine_hemisphere(stream.next_2d());
        accel.intersect(scene, &Ray::new(p, x * local.x + y * local.y - normal * local.z)).is_some()
    })
}

impl SceneRadiosity {
    /// The roots of a scene's diffuse surfaces with a first, coarse solution.
    ///
    /// # Errors
    /// Says in words why radiosity cannot light this scene: lights without area, too many polygons.
    pub fn new(scene: &Scene, accel: &Accel) -> Result<Self, String> {
        let no_area = scene.environment.is_some()
            || scene
                .lights
                .iter()
                .any(|l| matches!(l, Light::Point { .. } | Light::Spot { .. } | Light::Directional { .. }));
        if no_area {
            return Err(
                "radiosity takes its light from surfaces only; this scene has other lights, use particles"
                    .into(),
            );
        }
        let (mut patches, mut owners) = (Vec::new(), Vec::new());
        for t in 0..scene.mesh.triangles.len() as u32 {
            let corners = scene.mesh.corners(t);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            let material = &scene.materials[scene.mesh.materials[t as usize].0 as usize];
            let reflectance = diffuse(scene, t);
            let emission = mean(scene, &material.emission) * std::f32::consts::PI;
            if normal == Vec3::ZERO || reflectance.max_element().max(emission.max_element()) <= 0.0 {
                continue;
            }
            let reflectance = reflectance.to_array();
            patches.push(Patch { corners, reflectance, emission: emission.to_array() });
            owners.push((t, false));
            if material.two_sided && back_is_open(scene, accel, t, corners, normal) {
                let [a, b, c] = corners;
                patches.push(Patch { corners: [a, c, b], reflectance, emission: [0.0; 3] });
                owners.push((t, true));
            }
        }
        let mut solution = Radiosity::new(patches, &|p, q| visible(scene, accel, p, q))?;
        solution.solve();
        Ok(Self { solution, owners, power: FIRST_POWER * 4.0, error: 1.0 })
    }

    /// Refines links to a quarter of the power and solves again (multigridding). Returns the estimated error.
    pub fn refine(&mut self, scene: &Scene, accel: &Accel) -> f32 {
        self.refine_by(0.25, scene, accel)
    }

    /// The same in smaller steps where not much is missing to so many leaves.
    pub fn refine_towards(&mut self, scene: &Scene, accel: &Accel, leaves: usize) -> f32 {
        let factor = if 4 * self.leaf_count() < leaves { 0.25 } else { 0.9 };
        self.refine_by(factor, scene, accel)
    }

    fn refine_by(&mut self, factor: f32, scene: &Scene, accel: &Accel) -> f32 {
        self.power *= factor;
        let before: Vec<[f32; 3]> = self.solution.nodes.iter().map(|n| n.irradiance).collect();
        let refinement = Refinement { power: self.power, area: 2e-6, ..Refinement::default() };
        self.solution.refine(&refinement, &|p, q| visible(scene, accel, p, q));
        self.solution.solve();
        // What this step changed is a bound of what the next will: each has a quarter of the power per link.
        let (mut change, mut energy) = (0.0f64, 0.0f64);
        for (i, node) in self.solution.nodes.iter().enumerate().filter(|(_, n)| n.children.is_none()) {
            let mut known = i;
            while known >= before.len() {
                known = node_parent(&self.solution, known);
            }
            let (new, old) = (Vec3::from(node.irradiance), Vec3::from(before[known]));
            change += f64::from(node.area) * f64::from(luminance(new - old)).powi(2);
            energy += f64::from(node.area) * f64::from(luminance(new)).powi(2);
        }
        self.error = if energy > 0.0 { (change / energy).sqrt() as f32 } else { 0.0 };
        self.error
    }

    /// Estimated relative error: what the last refinement changed.
    pub fn error(&self) -> f32 {
        self.error
    }

    /// Leaves of all quadtrees: the triangles of the radiosity mesh.
    pub fn leaf_count(&self) -> usize {
        self.solution.leaf_count()
    }

    /// Links.
    pub fn link_count(&self) -> usize {
        self.solution.link_count()
    }

    /// Whether the number of links is at its limit, so that refinement changes nothing more.
    pub fn is_exhausted(&self) -> bool {
        self.link_count() >= Refinement::default().links_max || self.power < 1e-8
    }

    /// Cuts the mesh back to `k` elements. `elevation` is the mean elevation of the visibility threshold by the
    /// texture on a piece of a triangle, 1 without texture.
    pub fn simplify(
        &mut self,
        k: usize,
        criterion: &Criterion<'_>,
        elevation: &dyn Fn(u32, [Vec3; 3]) -> f32,
    ) -> Simplified {
        let mut forest = self.solution.forest([0.212_672_9, 0.715_152_2, 0.072_175]);
        for (node, out) in self.solution.nodes.iter().zip(&mut forest.nodes) {
            let (triangle, _) = self.owners[node.root as usize];
            out.elevation = f64::from(elevation(triangle, node.corners));
        }
        let cut = simplify(&forest, k, criterion);
        self.cut(&cut);
        cut
    }

    /// Cuts each tree of the mesh back to the rung of its ladder that `choose` names, and on to `k` elements where those
    /// are more.
    pub fn cut_to(&mut self, k: usize, choose: impl FnOnce(&[Vec<Rung>]) -> Vec<usize>) -> Simplified {
        let forest = self.solution.forest([0.212_672_9, 0.715_152_2, 0.072_175]);
        let ladders = forest.ladders();
        let chosen = choose(&ladders);
        let cut = |(ladder, rung): (&Vec<Rung>, usize)| {
            ladder.iter().take(rung + 1).filter_map(|r| r.node).collect::<Vec<_>>()
        };
        let cut = cut_below(&forest, ladders.iter().zip(chosen).flat_map(cut), k);
        self.cut(&cut);
        cut
    }

    fn cut(&mut self, to: &Simplified) {
        for joined in &to.joined {
            self.solution.join(joined);
        }
        self.solution = self.solution.cut(&to.is_leaf);
    }

    /// The solution as a continuous irradiance.
    pub fn mesh(&self, scene: &Scene) -> RadiosityMesh {
        RadiosityMesh::new(&mut self.solution.clone(), &self.owners, scene.mesh.triangles.len())
    }

    /// The solution as a lightmap over the scene's own triangles.
    pub fn lightmap(&self, scene: &Scene, atlas: &Atlas) -> Illumination {
        let mesh: &dyn Irradiance = &self.mesh(scene);
        let mut map = Illumination::resampled(atlas, mesh);
        let (mut sum, mut area) = (glam::DVec3::ZERO, 0.0f64);
        for e in atlas.elements.iter().filter(|e| e.area > 0.0) {
            let both = [false, true].map(|back| mesh.irradiance(e.triangle, e.b1, e.b2, back));
            sum += f64::from(e.area) * (both[0] + both[1]).as_dvec3();
            area += f64::from(e.area);
        }
        map.summary = Summary {
            relative_error: self.error,
            bias_error: self.error,
            mean: (sum / area.max(1e-300)).as_vec3().to_array(),
            has_indirect: self.solution.patches().iter().any(|p| p.reflectance.iter().any(|&r| r > 0.0)),
            notes: atlas.notes.iter().cloned().chain(left_out(scene)).collect(),
            ..Summary::default()
        };
        map
    }
}

/// Says which materials send light on that radiosity does not know of, and so neither does the error that it states.
fn left_out(scene: &Scene) -> Option<String> {
    let mut seen = vec![false; scene.materials.len()];
    for material in &scene.mesh.materials {
        seen[material.0 as usize] = true;
    }
    let of_glints = |m: &Material| !matches!(m.model, Model::Lambert { .. });
    let all = scene.materials.iter().zip(seen);
    let names: Vec<&str> = all.filter(|(m, seen)| *seen && of_glints(m)).map(|(m, _)| &*m.name).collect();
    (!names.is_empty()).then(|| {
        format!(
            "radiosity knows of light between diffuse surfaces only: what comes by way of {} is left out, and the \
             error stated does not know of it; --method particles does",
            names.join(", ")
        )
    })
}

fn node_parent(solution: &Radiosity<3>, i: usize) -> usize {
    solution.nodes[i].parent.map_or(0, |p| p as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::bake::{BakeSettings, Baker};
    use crate::illumination::test_scenes::{cube, join, lambert, quad, scene};
    use crate::transport::Indexed;
    use crate::transport::light::Lights;

    #[test]
    fn what_radiosity_leaves_out_is_named() {
        let mut mesh = cube(Vec3::ZERO, 2.0, false);
        join(&mut mesh, &quad(Vec3::new(0.5, 1.9, 0.5), Vec3::X, Vec3::Z), 1);
        let plain = vec![lambert(0.5, 0.0), lambert(0.2, 3.0)];
        let notes = |materials: Vec<Material>, mesh: &crate::scene::Mesh| {
            let room = scene(mesh.clone(), materials, Vec::new());
            let (accel, lights) = (Accel::build(&room), Lights::build(&room));
            let solution = SceneRadiosity::new(&room, &accel).expect("lamps have areas");
            let settings = BakeSettings { texels: 100, everything: true, ..BakeSettings::default() };
            let baker = Baker::new(Indexed { scene: &room, accel: &accel, lights: &lights }, &settings);
            let notes = solution.lightmap(&room, baker.atlas()).summary.notes;
            notes.into_iter().filter(|note| note.starts_with("radiosity")).collect::<Vec<_>>()
        };
        assert!(notes(plain.clone(), &mesh).is_empty());
        join(&mut mesh, &cube(Vec3::splat(0.5), 0.5, true), 2);
        let specular = Reflectance::constant(Vec3::ONE);
        let mirror = Material::new("chrome".to_owned(), Model::Mirror { specular });
        let unused = Material { name: "unused".into(), ..mirror.clone() };
        let notes = notes([plain, vec![mirror, unused]].concat(), &mesh);
        assert!(notes.len() == 1 && notes[0].contains("chrome") && !notes[0].contains("unused"), "{notes:?}");
    }
}
