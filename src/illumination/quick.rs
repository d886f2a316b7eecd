//! The first illumination of a scene, within a second: coarse elements, direct light at some of them, some particles.

use glam::Vec3;
use rayon::prelude::*;

use super::bake::{BLOCK, BakeSettings, Baker};
use super::clusters::ClusterTree;
use super::direct::{DirectBin, probe};
use super::stored::Illumination;
use crate::rng::hash;
use crate::scene::Scene;
use crate::transport::particle::LightTransport;

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Particles of the first map: enough for the mean brightness of every wall, with kernels as wide as walls.
const PARTICLES: u64 = 1 << 16;
/// Elements at which direct light is sampled, at most: in a dense mesh neighbours share theirs.
const PLACES: usize = 32 * 1024;
/// Samples of direct light at each of them: what is noisy is smoothed.
const SAMPLES: u32 = 4;
/// Particles of a bake that was cut short before it came to any: some hundredths of a second.
const PARTICLES_CUT_SHORT: u64 = 1 << 14;

/// The first picture: direct light sampled at coarse elements, all other light from few particles with wide
/// kernels. Nothing in it is guessed: it is a short bake.
pub fn quick_direct(scene: &Scene, transport: &dyn LightTransport, seed: u64) -> Illumination {
    let settings = BakeSettings { texels: TEXELS, seed, error: Some(0.05), ..BakeSettings::default() };
    let mut baker = Baker::new(scene, transport, &settings);
    baker.coarse = true;
    baker.gather_sparsely(0);
    baker.direct_rounds = 1;
    baker.emit(PARTICLES);
    let mut map = baker.illumination();
    map.summary.notes.push("a first estimate from few particles".into());
    map
}

impl Baker<'_> {
    /// Ends the first round of direct light where it is, in bounded time: what it did not come to is lit sparsely,
    /// indirect light is that of few particles, and estimates are coarse.
    pub(super) fn cut_short(&mut self) {
        let done = self.direct_block * BLOCK;
        self.gather_sparsely(done);
        (self.cut, self.coarse) = (Some(done), true);
        self.emit(self.settings.particles.map_or(PARTICLES_CUT_SHORT, |most| most.min(PARTICLES_CUT_SHORT)));
    }

    /// Direct light at every so manieth element from `done` on, which speaks for those beside it; so do elements before
    /// `done`, which have theirs.
    fn gather_sparsely(&mut self, done: usize) {
        let tree = ClusterTree::build(&self.atlas.elements);
        let run = tree.len().div_ceil(PLACES).max(1);
        let (atlas, transport, seed) = (&self.atlas, &self.transport, self.settings.seed);
        // The element that speaks for these, and whether it has been gathered before.
        let speaker = |members: &[u32]| {
            let index = members[members.len() / 2];
            (index, (index as usize) < done || members.iter().all(|&e| (e as usize) < done))
        };
        let light = |index: u32, side: u64| {
            let (e, back) = (&atlas.elements[index as usize], side == 1);
            let certain = transport.certain(e.triangle, e.b1, e.b2, back);
            (certain, move |u| transport.direct(e.triangle, e.b1, e.b2, back, u))
        };
        let reaches_back = |members: &[u32]| {
            let (index, is_done) = speaker(members);
            let (certain, sample) = light(index, 1);
            !is_done && (certain != Vec3::ZERO || probe(hash(seed, index.into(), 2), sample))
        };
        let gathered = |index: u32, reached: [bool; 2]| {
            [0, 1].map(|side| {
                let (certain, sample) = light(index, side);
                let mut bin = DirectBin::default();
                bin.set_certain(certain);
                if reached[side as usize] {
                    bin.gather(hash(seed, index.into(), side), SAMPLES, sample);
                }
                bin
            })
        };
        // Most backs are inside of bodies. Neighbours decide together: an element whose own two looks decided would be
        // dark wherever they happened to find nothing, and so too dark on the average.
        let at = |neighbours: &[u32]| -> Vec<[DirectBin; 2]> {
            let reached = [true, neighbours.chunks(run).any(reaches_back)];
            let bins = neighbours.chunks(run).map(|members| match speaker(members) {
                (index, true) => self.direct[index as usize],
                (index, false) => gathered(index, reached),
            });
            bins.collect()
        };
        let found: Vec<Vec<[DirectBin; 2]>> = tree.order().par_chunks(run * BLOCK).map(at).collect();
        for (members, bins) in tree.order().chunks(run).zip(found.into_iter().flatten()) {
            for &e in members.iter().filter(|&&e| e as usize >= done) {
                self.direct[e as usize] = bins;
            }
        }
        self.spare_tree = Some(tree);
        self.sources = None;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::illumination::bake::{BLOCKS, bake};
    use crate::illumination::cache;
    use crate::illumination::test_scenes::{grid, join, lambert, quad, scene};
    use crate::illumination::test_transport::Lambertian;

    /// A floor of many vertices under a lamp, of which a bake without time gathers direct light at some, and lights the
    /// others by these; the samples are counted. What was gathered is gone on with, as if nothing had happened.
    #[test]
    fn a_first_round_without_time_is_cut_short_and_gone_on_with() {
        let mut mesh = grid(200, 200, |x, y| Vec3::new(x, y, 0.0));
        join(&mut mesh, &quad(Vec3::new(0.25, 0.25, 2.0), Vec3::Y * 0.5, Vec3::X * 0.5), 1);
        let hall = scene(mesh, vec![lambert(0.5, 0.0), lambert(0.1, 5.0)], Vec::new());
        let transport = Lambertian::new(&hall);
        let settings = BakeSettings {
            texels: 64,
            particles: Some(20_000),
            everything: true,
            error: None,
            ..BakeSettings::default()
        };
        let cut = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut baker = Baker::new(&hall, &transport, &settings);
                (baker.run(&|_| false, &mut |_| {}), baker.state())
            })
        };
        let (short, state) = cut(1);
        let asked = transport.asked.load(Ordering::Relaxed);
        let elements = short.illumination.element_count();
        let done = BLOCKS * BLOCK;
        assert!(!short.complete && elements > 2 * done);
        // Two looks at the back and eight samples; of every second element of the others four.
        let others = elements.div_ceil(2);
        assert!((asked as usize) < done * 10 + others * 6 + 100, "{asked} of {elements}");
        // Nowhere is it dark: the middle of the floor receives as much as under a small square light.
        let exact = 5.0 * 0.25 / 4.0;
        for t in [0, 39_999, 40_000, 79_999] {
            let found = short.illumination.lookup(t, 0.3, 0.3, false).x;
            assert!((0.5 * exact..1.2 * exact).contains(&found), "{t}: {found} {exact}");
        }
        // The lamp receives what the floor reflects.
        let summary = &short.illumination.summary;
        assert!(summary.has_indirect && summary.particles > 0, "{summary:?}");
        let said = summary.notes.join(" ");
        assert!(
            said.contains("direct light at 40 %") && said.contains("indirect light is a first estimate"),
            "{said}"
        );
        let (again, same) = cut(3);
        assert!(again.illumination == short.illumination && same == state);
        transport.asked.store(0, Ordering::Relaxed);
        let whole = bake(&hall, &transport, &settings, &|_| true);
        let in_all = transport.asked.swap(0, Ordering::Relaxed);
        let mut going_on = Baker::new(&hall, &transport, &settings);
        assert!(
            going_on.restore(&cache::decode(&[1; 32], &cache::encode(&[1; 32], &state).unwrap()).unwrap())
        );
        let resumed = going_on.run(&|_| true, &mut |_| {});
        assert!(resumed.complete && resumed.illumination == whole.illumination);
        let still = transport.asked.load(Ordering::Relaxed);
        assert!(still + done as u64 * 8 <= in_all, "{still} {in_all}");
        let mut other = Baker::new(&hall, &transport, &BakeSettings { texels: 200_000, ..settings });
        let mut wrong = state;
        assert!(other.restore(&wrong));
        wrong.direct.pop();
        assert!(!other.restore(&wrong));
    }

    /// A thin sheet half-way between two small lamps, the upper one seven times as bright: samples at the back find their
    /// lamp in one of eight cases only, so that two looks at an element mostly miss it.
    #[test]
    fn the_back_of_a_thin_sheet_receives_what_its_lamp_sends() {
        let mut mesh = grid(60, 60, |x, y| Vec3::new(x - 0.5, y - 0.5, 0.0));
        let sheet = mesh.triangles.len() as u32;
        // Squares of 0.1, 2 above and 2 below, facing the sheet.
        join(&mut mesh, &quad(Vec3::new(-0.05, -0.05, 2.0), Vec3::Y * 0.1, Vec3::X * 0.1), 1);
        join(&mut mesh, &quad(Vec3::new(-0.05, -0.05, -2.0), Vec3::X * 0.1, Vec3::Y * 0.1), 2);
        let materials = vec![lambert(0.5, 0.0), lambert(0.1, 2800.0), lambert(0.1, 400.0)];
        let room = scene(mesh, materials, Vec::new());
        let transport = Lambertian::new(&room);
        // L A cos⁴ / d² of a point, all over the sheet.
        let exact = |x: f32, y: f32, radiance: f32| radiance * 0.01 * 4.0 / (x * x + y * y + 4.0).powi(2);
        for seed in [1, 2, 3] {
            let map = quick_direct(&room, &transport, seed);
            for back in [false, true] {
                let (mut sum, mut expected) = (0.0, 0.0);
                for t in 0..sheet {
                    let [a, b, c] = room.mesh.corners(t);
                    let p = (a + b + c) / 3.0;
                    sum += map.lookup(t, 1.0 / 3.0, 1.0 / 3.0, back).x;
                    expected += exact(p.x, p.y, if back { 400.0 } else { 2800.0 });
                }
                assert!((sum / expected - 1.0).abs() < 0.03, "{seed} {back}: {}", sum / expected);
            }
        }
    }
}
