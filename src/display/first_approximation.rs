//! What is shown of mirrors, glass and gloss until rays correct it: their lobes' peaks, looked up in environment maps.
//!
//! In: a drawn view and the objects' maps. Out: the view-dependent radiance per pixel that the splat layer begins with
//! (Dumont 2003 §5.3 joined to Haber 2001: the paper's base layer shows mirrors black).

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::FrameBuffers;
use super::cpu_pass::{primary_interaction, primary_ray};
use super::environment_map::{EnvironmentMap, Probe, probe};
use crate::image::Map2d;
use crate::math;
use crate::scene::Model;
use crate::scene::camera::CameraFrame;
use crate::transport::bsdf::peaks::SplitSum;
use crate::transport::bsdf::{Bsdf, BsdfSample};
use crate::transport::interaction::Interaction;
use crate::world::World;

/// The coarsest map of every object of a world; made once, shared by all who decide or draw.
#[derive(Debug)]
pub struct Probes {
    /// The table of lobe albedos.
    pub split_sum: SplitSum,
    /// By object id; 0 has one that nobody reads.
    pub probes: Vec<Probe>,
}

impl Probes {
    /// Looks around from every object.
    pub fn of_world(world: &World) -> Self {
        let split_sum = SplitSum::default();
        let of_object = |(id, object)| probe(world, &split_sum, id as u32, object);
        let probes = world.scene.objects.par_iter().enumerate().map(of_object).collect();
        Self { split_sum, probes }
    }
}

/// Approximations shared by neighbouring pixels ([`FirstApproximation::cells`]).
#[derive(Clone, Debug)]
pub struct Cells {
    /// Pixels along the side of a square.
    side: usize,
    columns: usize,
    /// The pixel that each square was looked up for, and what it shows.
    cells: Vec<Option<([u32; 2], Vec3)>>,
}

impl Cells {
    /// Depths of one surface differ by less than this share between neighbours.
    const SAME: f32 = 0.02;

    /// What a pixel shows; `None` where its square's is of another object or another surface.
    pub fn pixel(&self, buffers: &FrameBuffers, x: usize, y: usize) -> Option<Vec3> {
        let ([ox, oy], shown) = (*self.cells.get(y / self.side * self.columns + x / self.side)?)?;
        let (ox, oy) = (ox as usize, oy as usize);
        let (depth, other) = (buffers.depth.at(x, y), buffers.depth.at(ox, oy));
        let is_same = buffers.object.at(x, y) == buffers.object.at(ox, oy)
            && (depth - other).abs() <= Self::SAME * other;
        is_same.then_some(shown)
    }
}

/// Approximates the view-dependent part of pictures.
#[derive(Clone, Debug)]
pub struct FirstApproximation {
    probes: Arc<Probes>,
    /// By object id; `None` draws the probe.
    maps: Vec<Option<Arc<EnvironmentMap>>>,
}

impl FirstApproximation {
    /// Without maps finer than the probes.
    pub fn new(probes: Arc<Probes>) -> Self {
        Self { maps: vec![None; probes.probes.len()], probes }
    }

    /// Maps by object id; `None` where the probe is drawn.
    pub fn maps(&self) -> &[Option<Arc<EnvironmentMap>>] {
        &self.maps
    }

    /// Gives an object a map, or takes it away.
    pub fn set(&mut self, object: u32, map: Option<Arc<EnvironmentMap>>) {
        if let Some(slot) = self.maps.get_mut(object as usize) {
            *slot = map;
        }
    }

    /// The map of an object, if it has one.
    pub fn map(&self, object: u32) -> Option<&Arc<EnvironmentMap>> {
        self.maps.get(object as usize)?.as_ref()
    }

    /// View-dependent radiance towards `at.wo` of a surface that the display shows as `base`, about. Finite; may be
    /// negative where a coat takes light.
    fn at(&self, world: &World, at: &Interaction, base: Vec3) -> Vec3 {
        let map = match self.map(at.object) {
            Some(map) => &**map,
            None => match self.probes.probes.get(at.object as usize) {
                Some(probe) => &probe.map,
                None => return Vec3::ZERO,
            },
        };
        let bsdf = Bsdf::at(&world.scene, at);
        let mut sum = world.tracer().taken_by_coat(at, &bsdf, base);
        for peak in bsdf.peaks(at.wo, &self.probes.split_sum).into_iter().flatten() {
            // Into glass, radiance grows by n² and out of it shrinks again: what is looked up is outside.
            sum += peak.weight
                * match self.behind(world, at, &peak) {
                    Some((position, direction, weight)) => weight * map.look_up(position, direction),
                    None => map.look_up(at.position, peak.wi),
                };
        }
        if sum.is_finite() { sum } else { Vec3::ZERO }
    }

    /// Where light that enters solid glass leaves it again, whereto and what is left of it; one ray, no reflection inside
    /// but where all is reflected.
    fn behind(&self, world: &World, at: &Interaction, peak: &BsdfSample) -> Option<(Vec3, Vec3, Vec3)> {
        let Model::Dielectric { transmittance, thin: false, .. } = &at.material(&world.scene).model else {
            return None;
        };
        if !peak.transmitted || at.back {
            return None;
        }
        let ray = at.spawn(peak.wi);
        let hit = world.accel.intersect(&world.scene, &ray)?;
        let exit = Interaction::at(&world.scene, &ray, &hit);
        if exit.object != at.object {
            return None;
        }
        let peaks = Bsdf::at(&world.scene, &exit).peaks(exit.wo, &self.probes.split_sum);
        let leaving = peaks.iter().flatten().find(|p| p.transmitted).or(peaks[0].as_ref())?;
        let absorbed = transmittance.clamp(Vec3::ZERO, Vec3::ONE).map(|t| math::powf(t, hit.t));
        Some((exit.position, leaving.wi, absorbed))
    }

    /// Approximations for one pixel of each square of `side` × `side` that has any with a lobe for which `is_wanted` is true:
    /// one in its middle if that is such a pixel.
    pub fn cells(
        &self,
        world: &World,
        frame: &CameraFrame,
        buffers: &FrameBuffers,
        side: usize,
        is_wanted: impl Fn(usize, usize) -> bool + Sync,
    ) -> Cells {
        let [width, height] = [buffers.width(), buffers.height()];
        let columns = width.div_ceil(side);
        let all = side * side;
        let middle = (side - 1) / 2 * (side + 1);
        let cell = |i: usize, j: usize| {
            let mut pixels = (middle..middle + all).map(|k| [side * i + k % side, side * j + k % all / side]);
            let is_there = |&[x, y]: &[usize; 2]| {
                x < width && y < height && buffers.object.at(x, y) != 0 && is_wanted(x, y)
            };
            let [x, y] = pixels.find(is_there)?;
            Some(([x as u32, y as u32], self.pixel(world, frame, buffers, x, y)))
        };
        let rows = (0..height.div_ceil(side)).into_par_iter();
        let cells = rows.flat_map_iter(|j| (0..columns).map(move |i| (i, j))).map(|(i, j)| cell(i, j));
        Cells { side, columns, cells: cells.collect() }
    }

    /// Fills `out`, of the view's size, with what the view shows until rays correct it: zero at diffuse pixels.
    pub fn draw(&self, world: &World, frame: &CameraFrame, buffers: &FrameBuffers, out: &mut Map2d<Vec3>) {
        let width = buffers.width();
        out.data_mut().par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                *out = self.pixel(world, frame, buffers, x, y);
            }
        });
    }

    /// One pixel of [`Self::draw`].
    pub fn pixel(
        &self,
        world: &World,
        frame: &CameraFrame,
        buffers: &FrameBuffers,
        x: usize,
        y: usize,
    ) -> Vec3 {
        let (true, Some(hit)) = (buffers.object.at(x, y) != 0, buffers.hit.at(x, y).hit()) else {
            return Vec3::ZERO;
        };
        let ray = primary_ray(frame, x as u32, y as u32);
        self.at(world, &primary_interaction(world, frame, &ray, &hit), buffers.color.at(x, y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::PrimaryHit;
    use crate::scene::test_scenes::{add_box, mirror, scene, with_camera};
    use crate::scene::{Environment, Mesh};

    /// Neighbours share what the first of them shows, and nobody what another surface does.
    #[test]
    fn cells_are_shared_by_one_surface() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(0.2), Vec3::splat(0.6), 0, false);
        let mut made = with_camera(scene(mesh, vec![mirror()]));
        made.environment = Some(Environment::constant(Vec3::ONE));
        let frame = made.cameras[0].camera.frame(31, 23);
        let world = World::new(Arc::new(made), Arc::new(crate::illumination::Uniform(Vec3::ONE)));
        let mut buffers = FrameBuffers::new(31, 23);
        let passes = crate::display::cpu_pass::Passes { texture_ids: false };
        crate::display::cpu_pass::draw(&world, &frame, passes, &mut buffers);
        let first = FirstApproximation::new(Arc::new(Probes::of_world(&world)));
        let wanted = |x: usize, y: usize| !(x + y).is_multiple_of(3);
        for side in [1, 2, 4] {
            let cells = first.cells(&world, &frame, &buffers, side, wanted);
            let mut shared = 0;
            for (x, y) in (0..23).flat_map(|y| (0..31).map(move |x| (x, y))) {
                let middle = |v: usize| v / side * side + (side - 1) / 2;
                let is_there =
                    |x: usize, y: usize| x < 31 && y < 23 && wanted(x, y) && buffers.object.at(x, y) != 0;
                let (i, j) = (x / side, y / side);
                let Some(&([ox, oy], looked_up)) = cells.cells[j * cells.columns + i].as_ref() else {
                    let square = (0..side * side).map(|k| (i * side + k % side, j * side + k / side));
                    assert!(square.into_iter().all(|(x, y)| !is_there(x, y)));
                    assert_eq!(cells.pixel(&buffers, x, y), None);
                    continue;
                };
                let (ox, oy) = (ox as usize, oy as usize);
                assert!([ox / side, oy / side] == [i, j] && is_there(ox, oy));
                assert!((ox, oy) == (middle(x), middle(y)) || !is_there(middle(x), middle(y)));
                match cells.pixel(&buffers, x, y) {
                    Some(shown) => {
                        assert_eq!(shown, looked_up);
                        assert_eq!(shown, first.pixel(&world, &frame, &buffers, ox, oy));
                        assert_eq!(buffers.object.at(x, y), buffers.object.at(ox, oy));
                        shared += usize::from((x, y) != (ox, oy));
                    }
                    None => assert!(
                        buffers.hit.at(x, y) == PrimaryHit::MISS
                            || (buffers.depth.at(x, y) / buffers.depth.at(ox, oy) - 1.0).abs() > 0.02
                    ),
                }
            }
            assert_eq!(shared > 50, side > 1, "{shared}");
        }
    }
}
