//! Which elements of a radiosity mesh a picture can do without: the criteria of Dumont et al. 2003 §5.4 with the
//! scene's textures and display, and the allocation of elements to polygons by the same code that allocates everything else.

use glam::Vec3;

use crate::image::{Map2d, luminance};
use crate::math;
use crate::perception::csf::barten;
use crate::perception::elevation::{ElevationSettings, elevation};
use crate::perception::tvi::tvi;
use crate::radiosity::of_scene::SceneRadiosity;
use crate::radiosity::simplify::{Criterion, Eye, Rung, Simplified};
use crate::rng::Stream;
use crate::scene::{Scene, Texture};

use super::decision::{Approximation, Constraint, Resource, decide};

/// Texels of the finest level per degree that elevation maps assume: 512 pixels over 45° (REFERENCE §8.6).
const TEXELS_PER_DEGREE: f32 = 10.787;
/// Width of an element in texels of the mip level whose contrast may hide its error: that level's shortest wavelength.
const TEXELS_ACROSS: f32 = 2.0;
/// Cycles per degree that the eye sees best.
const SHARPEST: f32 = 3.25;
/// Side of the square over which the eye sums, radians: 4°.
const SUMMED_ANGLE: f64 = 0.07;
/// How far a surface is from the eye, as a share of the scene's size.
const VIEWING_DISTANCE: f64 = 0.4;
/// Points of an element at which its texture's elevation is read.
const ELEVATION_POINTS: u64 = 16;

/// Which elements go first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ElementCriterion {
    /// Least relative change of radiosity.
    Photometric,
    /// Least visible change (Dumont et al. 2003 eq 12).
    #[default]
    Perceptual,
    /// Least squared error: each polygon's tree offers its ways of being cut back, and [`decide`] allocates the elements.
    Optimal,
}

/// The trees of a mesh under a limit of elements: approximation i of a tree is rung i of its ladder.
#[derive(Clone, Copy, Debug)]
pub struct MeshChoices<'a>(pub &'a [Vec<Rung>]);

impl Resource for MeshChoices<'_> {
    fn action_count(&self) -> usize {
        self.0.len()
    }

    fn saliency(&self, _tree: usize) -> f64 {
        1.0
    }

    fn approximations(&self, tree: usize, out: &mut Vec<Approximation>) {
        let of = |rung: &Rung| Approximation { cost: rung.elements as u64, error: rung.squared_error };
        out.extend(self.0[tree].iter().map(of));
    }
}

/// The rung of each tree that gives the least squared error with `k` elements; where not even one each is allowed, one
/// each. Rungs of whole subtrees may leave elements unused: then trees that miss theirs most go back by a rung, until
/// there are `k` at least, for smaller cuts to end at `k`.
pub fn choose_rungs(ladders: &[Vec<Rung>], k: usize) -> Vec<usize> {
    let last = |ladder: &Vec<Rung>| ladder.len().saturating_sub(1);
    let Ok(chosen) = decide(&MeshChoices(ladders), Constraint::Count(k as u64), None) else {
        return ladders.iter().map(last).collect();
    };
    let mut chosen = chosen.states;
    let elements: usize = ladders.iter().zip(&chosen).map(|(ladder, &c)| ladder[c].elements).sum();
    let mut unused = k.saturating_sub(elements);
    while unused > 0 {
        let gain = |tree: &usize| {
            let [finer, now] = [chosen[*tree] - 1, chosen[*tree]].map(|rung| ladders[*tree][rung]);
            (now.squared_error - finer.squared_error) / (finer.elements - now.elements).max(1) as f64
        };
        let open = (0..ladders.len()).filter(|&tree| chosen[tree] > 0);
        let Some(tree) = open.max_by(|a, b| gain(a).total_cmp(&gain(b)).then(b.cmp(a))) else { break };
        let before = ladders[tree][chosen[tree]].elements;
        chosen[tree] -= 1;
        unused = unused.saturating_sub(ladders[tree][chosen[tree]].elements - before);
    }
    chosen
}

/// Cuts the mesh of a solution for `scene` back to `k` elements.
pub fn simplify_mesh(
    solution: &mut SceneRadiosity,
    scene: &Scene,
    k: usize,
    criterion: ElementCriterion,
) -> Simplified {
    match criterion {
        ElementCriterion::Photometric => solution.simplify(k, &Criterion::Photometric, &|_, _| 1.0),
        ElementCriterion::Optimal => solution.cut_to(k, |ladders| choose_rungs(ladders, k)),
        ElementCriterion::Perceptual => {
            let maps = elevation_maps(scene);
            let display = &scene.display;
            let criterion = Criterion::Perceptual(Eye {
                tvi: &|l| f64::from(tvi(l as f32)),
                sensitivity: &|l| f64::from(barten(SHARPEST, (l as f32).max(1e-3))),
                cd_m2_per_unit: f64::from(display.exposure * display.white_cd_m2),
                white_cd_m2: f64::from(display.white_cd_m2),
                summed_area: (SUMMED_ANGLE * VIEWING_DISTANCE * f64::from(scene.diagonal())).powi(2),
            });
            solution.simplify(k, &criterion, &|triangle, piece| mean_elevation(scene, &maps, triangle, piece))
        }
    }
}

/// Elevation of the mip levels of each texture that some diffuse surface shows.
fn elevation_maps(scene: &Scene) -> Vec<Vec<Map2d<f32>>> {
    let mut used = vec![false; scene.textures.len()];
    for material in &scene.materials {
        if let Some(t) = material.picture() {
            used[t.0 as usize] = true;
        }
    }
    let settings = |level: usize| ElevationSettings {
        masking_only: true,
        ..ElevationSettings::new(TEXELS_PER_DEGREE / (1 << level) as f32)
    };
    let of_level = |texture: &Texture, level: usize| {
        let [w, h] = texture.size(level);
        let y = Map2d::from_fn(w, h, |x, y| {
            let [r, g, b, _] = texture.texel(level, x, y);
            scene.display.white_cd_m2 * luminance(Vec3::new(r, g, b))
        });
        elevation(&y, &settings(level))
    };
    let of_texture = |(texture, used): (&Texture, bool)| match used {
        true => (0..texture.level_count()).map(|level| of_level(texture, level)).collect(),
        false => Vec::new(),
    };
    scene.textures.iter().zip(used).map(of_texture).collect()
}

/// Mean elevation over the texture's part on a piece of a triangle; 1 without texture.
///
/// Deviation from the paper, which takes level 0: contrast hides errors of about its own wavelength, and a fine
/// pattern hides no wide shadow. What a piece cannot show is as wide as itself, so the
/// level counts in which it is [`TEXELS_ACROSS`] texels wide.
fn mean_elevation(scene: &Scene, maps: &[Vec<Map2d<f32>>], triangle: u32, piece: [Vec3; 3]) -> f32 {
    let material = &scene.materials[scene.mesh.materials[triangle as usize].0 as usize];
    let levels = material.picture().map_or(&[][..], |t| &maps[t.0 as usize]);
    let Some(finest) = levels.first() else { return 1.0 };
    let [a, b, c] = scene.mesh.corners(triangle);
    let placement = material.picture().map_or(Default::default(), |t| scene.textures[t.0 as usize].placement);
    let uv = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
        .map(|(b1, b2)| scene.mesh.coordinates(triangle, b1, b2, placement.second));
    let n = (b - a).cross(c - a);
    let square = n.length_squared().max(f32::MIN_POSITIVE);
    let share = ((piece[1] - piece[0]).cross(piece[2] - piece[0]).length_squared() / square).sqrt();
    let texels = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]).abs() * (finest.width() * finest.height()) as f32;
    let level = math::log2(((share * texels).sqrt() / TEXELS_ACROSS).max(1.0)) as usize;
    let Some(map) = levels.get(level) else { return 1.0 };
    let mut sum = 0.0;
    for i in 0..ELEVATION_POINTS {
        let [u, v] = Stream::new(0xe1e, triangle.into(), i).next_2d();
        let s = u.sqrt();
        let p = piece[0] * (1.0 - s) + piece[1] * (s * (1.0 - v)) + piece[2] * (s * v);
        let (b1, b2) = ((p - a).cross(c - a).dot(n) / square, (b - a).cross(p - a).dot(n) / square);
        let at = uv[0] * (1.0 - b1 - b2) + uv[1] * b1 + uv[2] * b2;
        let texel = |x: f32, n: usize| ((x.rem_euclid(1.0) * n as f32) as usize).min(n - 1);
        // Rows count from the top, v from below.
        sum += map.at(texel(at.x, map.width()), texel(1.0 - at.y, map.height()));
    }
    sum / ELEVATION_POINTS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::radiosity::simplify::{Forest, QuadNode, cut_below, simplify};
    use crate::rng;

    /// Full quadtrees of three levels, each rougher than the one before.
    fn forest(trees: u64) -> Forest {
        let mut forest = Forest::default();
        for tree in 0..trees {
            let mut level = vec![forest.nodes.len()];
            forest.nodes.push(QuadNode {
                parent: None,
                children: None,
                area: 64.0,
                value: 0.0,
                elevation: 1.0,
            });
            for _ in 0..3 {
                let parents = std::mem::take(&mut level);
                for parent in parents {
                    forest.nodes[parent].children = Some(forest.nodes.len() as u32);
                    for child in 0..4 {
                        let noise = rng::unit_f32(rng::hash(tree, forest.nodes.len() as u64, child));
                        let area = forest.nodes[parent].area / 4.0;
                        let value = 1.0 + f64::from(noise) * (1 << tree) as f64;
                        level.push(forest.nodes.len());
                        let parent = Some(parent as u32);
                        forest.nodes.push(QuadNode { parent, children: None, area, value, elevation: 1.0 });
                    }
                }
            }
        }
        for i in (0..forest.nodes.len()).rev() {
            if let Some(first) = forest.nodes[i].children {
                let children = &forest.nodes[first as usize..first as usize + 4];
                forest.nodes[i].value = children.iter().map(|c| c.value).sum::<f64>() / 4.0;
            }
        }
        forest
    }

    #[test]
    fn elements_go_where_they_are_missed_most() {
        let forest = forest(4);
        let ladders = forest.ladders();
        assert_eq!(ladders.iter().map(|l| l[0].elements).sum::<usize>(), forest.leaf_count());
        assert!(ladders.iter().all(|l| l.last().is_some_and(|r| r.elements == 1)));
        for k in [4, 5, 17, 40, 100, 200, 256] {
            let chosen = choose_rungs(&ladders, k);
            let nodes =
                ladders.iter().zip(&chosen).flat_map(|(l, &c)| l[1..=c].iter().filter_map(|r| r.node));
            let cut = cut_below(&forest, nodes, k);
            assert_eq!(cut.elements, k);
            // As good as the one walk over all trees at once.
            let before = simplify(&forest, k, &Criterion::Optimal);
            let step = forest.ladders().iter().flatten().map(|r| r.squared_error).fold(0.0, f64::max);
            assert!(cut.squared_error <= before.squared_error + 0.05 * step, "{k}: {cut:?} {before:?}");
        }
        assert_eq!(choose_rungs(&ladders, 256), [0; 4]);
        assert!(choose_rungs(&ladders, 1).iter().zip(&ladders).all(|(&c, l)| c + 1 == l.len()));
    }
}
