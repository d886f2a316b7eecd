//! The allocator's part about environment maps, its first approximations: which are captured next, and which are kept.
//!
//! Each view ranks the visible objects by Dumont 2003 Eq. (10) under two limits, time until all of them could be there
//! and memory. Captures go to the tracers in small jobs, one at a time, so that they spread over frames.

use std::sync::Arc;

use foveal::allocation::decision::{Constraint, Decision};
use foveal::allocation::environment::{COVERAGE_MIN, MapCandidate, MapChoices, MapContrast};
use foveal::display::environment_map::{
    PROBE_SIDE, Seen, phong_exponent, side_of_lobe, solid_angle, texel_count,
};
use foveal::display::first_approximation::Probes;
use foveal::image::luminance;
use foveal::perception::importance::ObjectStatistics;
use foveal::world::World;
use foveal_runtime::{Cx, Loader, Saver};

use super::Allocator;
use crate::insight::{MapRank, map_bytes};
use crate::message::tracer::{EnvironmentOrder, EnvironmentWork};
use crate::message::{AllocatorMessage, DrawnView, TraceJob};
use crate::stages::Stage;

/// Rays of one capture job: about a millisecond.
const RAYS_PER_JOB: usize = 512;
/// Nanoseconds of a capture ray before any was measured.
const RAY_NS_PRIOR: f32 = 2500.0;
/// Time that captures may look ahead, nanoseconds of one core: what a second's share of the tracers gives.
const TIME_LIMIT_NS: u64 = 500_000_000;
/// Seconds that samples are traced for each second that goes to environment maps, while there are samples to trace. What
/// is mixed from samples leaves little for maps to show: with 3 orders left 5 % more error, with 40 4 % less, of walks
/// with time for a tenth of their samples; with 60 walks at ten frames a second were as with 15 (experiments).
const SAMPLES_TO_MAPS: f32 = 15.0;

/// Seconds that samples are to be traced for before the next job of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct OwedToSamples(f32);

impl OwedToSamples {
    /// A job of a map took so long: of samples' time only where there are some to trace.
    fn maps_took(&mut self, seconds: f32, are_samples_left: bool) {
        if are_samples_left {
            self.0 += SAMPLES_TO_MAPS * seconds.max(0.0);
        }
    }

    /// Samples were traced for so long.
    pub(super) fn samples_took(&mut self, seconds: f32) {
        self.0 = (self.0 - seconds.max(0.0)).max(0.0);
    }

    /// Whether a job of a map may be handed out.
    fn is_maps_turn(self, are_samples_left: bool) -> bool {
        !are_samples_left || self.0 <= 0.0
    }
}

/// What is known of an object's map.
#[derive(Clone, Copy, Debug, serde::Serialize, serde::Deserialize)]
struct MapState {
    /// Texels along an edge of the map that is there; 0 for none.
    side: usize,
    /// Lobe, or none for a mirror.
    exponent: Option<f32>,
    /// ρ_s.
    albedo: f32,
    /// Of the map, or of the probe before there is one.
    contrast: MapContrast,
}

/// A capture on its way.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
struct Capture {
    object: u32,
    side: usize,
    seen: Vec<Seen>,
}

/// The objects of a view that may have a map, and how far the decision about them is.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
struct Ranking {
    /// Objects and the sides of the maps they would have.
    objects: Vec<(u32, usize)>,
    /// At the cost of bytes, and of the time that captures take.
    by_memory: Vec<MapCandidate>,
    by_time: Vec<MapCandidate>,
    decision: Decision,
    /// Which are kept, once that is decided.
    kept: Option<Vec<usize>>,
}

/// Maps of all objects.
#[derive(Debug)]
pub struct Environments {
    world: World,
    probes: Arc<Probes>,
    /// Most bytes of all maps.
    budget: u64,
    states: Vec<MapState>,
    /// What is being decided, and what the newest view shows, where that is another.
    deciding: Option<Ranking>,
    newer: Option<Ranking>,
    /// Objects to capture, the most useful first, with the side wanted.
    wanted: Vec<(u32, usize)>,
    current: Option<Capture>,
    /// Whether a job is out.
    in_flight: bool,
    /// Moving average of a capture ray's time, nanoseconds.
    ray_ns: f32,
    /// Luminance sums of the base layer by object, kept for their room.
    shown: Vec<f64>,
    /// Maps that were captured.
    captured: u32,
    /// What one more byte of maps would buy.
    price: f64,
    /// The last ranking, for whoever looks on.
    ranking: Vec<MapRank>,
}

impl Environments {
    /// No maps yet; `budget` in bytes.
    pub fn new(world: World, probes: Arc<Probes>, budget: u64) -> Self {
        let scene = world.scene.clone();
        let state = |(id, object): (usize, &foveal::scene::Object)| {
            let model = &scene.materials[object.material.0 as usize].model;
            MapState {
                side: 0,
                exponent: phong_exponent(model.lobe_alpha()),
                albedo: model.lobe_albedo(),
                contrast: contrast_of_probe(&probes, id),
            }
        };
        let states = scene.objects.iter().enumerate().map(state).collect();
        Self {
            states,
            world,
            probes,
            budget,
            deciding: None,
            newer: None,
            wanted: Vec::new(),
            current: None,
            in_flight: false,
            ray_ns: RAY_NS_PRIOR,
            shown: Vec::new(),
            captured: 0,
            price: 0.0,
            ranking: Vec::new(),
        }
    }

    /// Writes everything but what the wiring makes alike.
    pub fn save(&self, saver: &mut Saver) {
        let Self {
            world: _,
            probes: _,
            budget: _,
            states,
            deciding,
            newer,
            wanted,
            current,
            in_flight,
            ray_ns,
            shown: _,
            ranking: _,
            captured,
            price: _,
        } = self;
        saver.put(&(states, deciding, newer, wanted, current, in_flight, ray_ns, captured));
    }

    /// Reads what was saved.
    pub fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        let states: Vec<MapState>;
        (
            states,
            self.deciding,
            self.newer,
            self.wanted,
            self.current,
            self.in_flight,
            self.ray_ns,
            self.captured,
        ) = loader.take()?;
        let same = states.len() == self.states.len();
        self.states = states;
        same.then_some(())
    }

    /// Another limit, bytes; what is over it goes with the next ranking.
    pub fn set_budget(&mut self, bytes: u64) {
        self.budget = bytes;
    }

    /// The last ranking with the maps as they are now, the most worth first.
    pub fn ranking(&self) -> Vec<MapRank> {
        let now = |rank: &MapRank| MapRank {
            side: self.states.get(rank.object as usize).map_or(0, |state| state.side as u32),
            ..*rank
        };
        self.ranking.iter().map(now).collect()
    }

    /// Whether a job is out.
    pub fn in_flight(&self) -> bool {
        self.in_flight
    }

    /// Maps captured so far.
    pub fn captured(&self) -> u32 {
        self.captured
    }

    /// Visible error that one more MiB would take away, saliency × pixels × just noticeable differences.
    pub fn price_per_mib(&self) -> f64 {
        self.price * f64::from(1 << 20)
    }

    /// Bytes of the maps that are there.
    pub fn bytes(&self) -> u64 {
        self.states.iter().map(|s| map_bytes(s.side)).sum()
    }

    /// A view to rank by, as soon as [`Environments::go_on`] has the time; of several the newest counts.
    pub fn on_view(&mut self, drawn: &DrawnView, statistics: &[ObjectStatistics], attention: &[f32]) {
        let display = self.world.scene.display;
        let to_cd = display.exposure * display.white_cd_m2;
        let pixels = drawn.buffers().object.data().len().max(1) as f32;
        self.shown.clear();
        self.shown.resize(self.states.len(), 0.0);
        for (&id, &color) in drawn.buffers().object.data().iter().zip(drawn.buffers().color.data()) {
            if let Some(sum) = self.shown.get_mut(id as usize).filter(|_| id != 0) {
                *sum += f64::from(luminance(color));
            }
        }
        let mut objects = Vec::new();
        let (mut by_time, mut by_memory) = (Vec::new(), Vec::new());
        for (id, state) in self.states.iter().enumerate().skip(1) {
            let shown = statistics.get(id).map_or(0, |s| s.pixels);
            let coverage = shown as f32 / pixels;
            let side = if coverage >= COVERAGE_MIN { side_wanted(shown, state.exponent) } else { 0 };
            let side = side.max(state.side);
            if side == 0 {
                continue;
            }
            let candidate = MapCandidate {
                // What is not seen is kept where there is room.
                pixels: (shown as f32).max(1e-3),
                coverage: coverage.max(if state.side > 0 { COVERAGE_MIN } else { 0.0 }),
                diffuse_cd_m2: (self.shown[id] / f64::from(shown.max(1))) as f32 * to_cd,
                reflection_cd_m2: (state.albedo * state.contrast.mean * to_cd).min(display.white_cd_m2),
                relative_difference: state.contrast.relative_difference.max(1e-3),
                mean_elevation: 1.0,
                saliency: 0.1 + attention.get(id).copied().unwrap_or(0.0),
                cost: map_bytes(side),
            };
            by_memory.push(candidate);
            let rays = if side >= 2 * state.side { texel_count(side) } else { 0 };
            by_time.push(MapCandidate { cost: (rays as f32 * self.ray_ns) as u64, ..candidate });
            objects.push((id as u32, side));
        }
        let decision = Decision::new(Constraint::Bytes(self.budget));
        self.newer = Some(Ranking { objects, by_memory, by_time, decision, kept: None });
    }

    /// Gives up all maps; which objects had one.
    fn give_up_all(&mut self) -> Vec<u32> {
        self.wanted.clear();
        self.ranking.clear();
        (self.deciding, self.newer) = (None, None);
        let mut dropped = Vec::new();
        for (id, state) in self.states.iter_mut().enumerate().filter(|(_, state)| state.side > 0) {
            state.side = 0;
            dropped.push(id as u32);
        }
        dropped
    }

    /// Whether there is something to decide.
    pub fn is_deciding(&self) -> bool {
        self.deciding.is_some() || self.newer.is_some()
    }

    /// Goes on deciding for as long as there is `work`. Returns the objects whose maps are given up.
    pub fn go_on(&mut self, work: &mut u64) -> Vec<u32> {
        if self.budget == 0 {
            return self.give_up_all();
        }
        let mut dropped = Vec::new();
        while *work > 0 {
            let Some(mut ranking) = self.deciding.take().or_else(|| self.newer.take()) else { break };
            let candidates = if ranking.kept.is_none() { &ranking.by_memory } else { &ranking.by_time };
            // Without any map the cost is 0, so both limits can be met.
            let decided = ranking.decision.go_on(&MapChoices(candidates), None, work).map(|d| d.ok());
            match (decided, ranking.kept.take()) {
                (None, kept) => self.deciding = Some(Ranking { kept, ..ranking }),
                (Some(None), _) => {}
                (Some(Some(kept)), None) => {
                    self.price = kept.price;
                    let decision = Decision::new(Constraint::Nanoseconds(TIME_LIMIT_NS));
                    self.deciding = Some(Ranking { kept: Some(kept.states), decision, ..ranking });
                }
                (Some(Some(soon)), Some(kept)) => {
                    *work = work.saturating_sub(2 * kept.len() as u64);
                    dropped.extend(self.carry_out(&ranking, &kept, &soon.states));
                }
            }
        }
        dropped
    }

    fn carry_out(&mut self, ranking: &Ranking, kept: &[usize], soon: &[usize]) -> Vec<u32> {
        let Ranking { objects, by_memory, by_time, .. } = ranking;
        self.ranking.clear();
        for (i, &(object, wanted)) in objects.iter().enumerate() {
            let c = &by_memory[i];
            let worth = c.saliency * c.pixels * c.visible_error();
            let side = self.states[object as usize].side as u32;
            let kept = kept[i] != 0;
            self.ranking.push(MapRank { object, worth, side, wanted: wanted as u32, kept });
        }
        self.ranking.sort_by(|a, b| b.worth.total_cmp(&a.worth).then(a.object.cmp(&b.object)));
        let mut dropped = Vec::new();
        let mut ranked: Vec<(f32, u32, usize)> = Vec::new();
        for (i, &(id, side)) in objects.iter().enumerate() {
            let state = &mut self.states[id as usize];
            if kept[i] == 0 {
                if state.side > 0 {
                    state.side = 0;
                    dropped.push(id);
                }
            } else if soon[i] == 1 && side >= 2 * state.side.max(1) {
                let c = &by_time[i];
                let gain = c.saliency * c.pixels * c.visible_error() / (c.cost as f32).max(1.0);
                ranked.push((gain, id, side));
            }
        }
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        self.wanted = ranked.into_iter().map(|(_, id, side)| (id, side)).collect();
        dropped
    }

    /// The next job; none while one is out or nothing is wanted.
    pub fn next_order(&mut self) -> Option<EnvironmentOrder> {
        if self.in_flight || self.budget == 0 {
            return None;
        }
        if self.current.is_none() {
            if self.wanted.is_empty() {
                return None;
            }
            let (object, side) = self.wanted.remove(0);
            self.current = Some(Capture { object, side, seen: Vec::with_capacity(texel_count(side)) });
        }
        let capture = self.current.as_mut()?;
        let (first, all) = (capture.seen.len(), texel_count(capture.side));
        let work = if first < all {
            EnvironmentWork::Capture { first: first as u32, count: RAYS_PER_JOB.min(all - first) as u32 }
        } else {
            EnvironmentWork::Filter { seen: Arc::new(std::mem::take(&mut capture.seen)) }
        };
        self.in_flight = true;
        Some(EnvironmentOrder {
            world: self.world.clone(),
            probes: self.probes.clone(),
            object: capture.object,
            side: capture.side as u32,
            exponent: self.states[capture.object as usize].exponent,
            work,
        })
    }

    /// A stretch was captured; an empty one ends the capture (its job was lost).
    pub fn on_captured(&mut self, object: u32, seen: &[Seen], seconds: f32) {
        self.in_flight = false;
        let Some(capture) = self.current.as_mut().filter(|c| c.object == object) else { return };
        if seen.is_empty() {
            self.current = None;
            return;
        }
        let room = texel_count(capture.side) - capture.seen.len();
        capture.seen.extend_from_slice(&seen[..seen.len().min(room)]);
        let ns = seconds * 1e9 / seen.len() as f32;
        if ns > 0.0 && ns.is_finite() {
            self.ray_ns += 0.2 * (ns - self.ray_ns);
        }
    }

    /// A map is done and with the renderer.
    pub fn on_filtered(&mut self, object: u32, contrast: MapContrast) {
        self.in_flight = false;
        if let Some(capture) = self.current.take()
            && let Some(state) = self.states.get_mut(object as usize)
        {
            (state.side, state.contrast) = (capture.side, contrast);
            self.captured += 1;
        }
    }

    /// A job was given up, maybe this one.
    pub fn on_job_lost(&mut self) {
        self.in_flight = false;
        self.current = None;
    }
}

impl Allocator {
    pub(super) fn on_environment_captured(
        &mut self,
        object: u32,
        seen: &[Seen],
        seconds: f32,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.environments.on_captured(object, seen, seconds);
        self.owed_to_samples.maps_took(seconds, !self.order.is_exhausted());
        self.capture_maps(cx);
    }

    pub(super) fn on_environment_filtered(
        &mut self,
        object: u32,
        contrast: MapContrast,
        seconds: f32,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.environments.on_filtered(object, contrast);
        self.owed_to_samples.maps_took(seconds, !self.order.is_exhausted());
        self.capture_maps(cx);
    }

    pub(super) fn rank_maps(&mut self) {
        let Some(drawn) = self.drawn.clone() else { return };
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            self.environments.on_view(&drawn, &self.statistics, &self.attention);
        });
    }

    /// Hands out a job of an environment map, if it is time for one.
    pub(super) fn capture_maps(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        if !self.owed_to_samples.is_maps_turn(!self.order.is_exhausted()) {
            return;
        }
        if let Some(order) = self.environments.next_order() {
            // Maps hold for every view, so they never go stale.
            self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Environment(order));
        }
    }
}

/// Texels along an edge that an object of so many pixels can show, and its lobe keep apart.
fn side_wanted(pixels: u32, exponent: Option<f32>) -> usize {
    let by_pixels = ((pixels as f32).sqrt() * 0.5) as usize;
    let by_lobe = exponent.map_or(128, |n| 2 * side_of_lobe(n));
    by_pixels.next_power_of_two().clamp(16, 128).min(by_lobe)
}

/// How much a probe's directions differ: the best guess before a map is captured.
fn contrast_of_probe(probes: &Probes, id: usize) -> MapContrast {
    let Some(probe) = probes.probes.get(id) else { return MapContrast::default() };
    let texels: Vec<f32> = probe.map.radiance().texels().iter().map(|&t| luminance(t)).collect();
    let mean = vec![luminance(probe.map.mean()); texels.len()];
    let weights: Vec<f32> = (0..texels.len()).map(|i| solid_angle(PROBE_SIDE, i)).collect();
    MapContrast::of_map(&texels, &mean, &weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_as_fine_as_lobe_and_picture_need() {
        assert_eq!(side_wanted(100, None), 16);
        assert_eq!(side_wanted(10_000, None), 64);
        assert_eq!(side_wanted(1_000_000, None), 128);
        assert_eq!(side_wanted(1_000_000, phong_exponent(0.3)), 16);
    }

    /// Jobs of maps have a sixteenth of the time, however long single jobs are, and all of it once samples are done.
    #[test]
    fn maps_get_their_share_of_the_time() {
        for (map, sample) in [(1e-3f32, 2e-3f32), (8e-3, 2e-4), (1e-4, 9e-3)] {
            let mut owed = OwedToSamples::default();
            let (mut of_maps, mut of_samples) = (0.0f32, 0.0f32);
            while of_samples < 2.0 {
                if owed.is_maps_turn(true) {
                    owed.maps_took(map, true);
                    of_maps += map;
                }
                owed.samples_took(sample);
                of_samples += sample;
            }
            // The last job of a map may still be owed for, and each job of samples may pay too much.
            let most = of_samples / SAMPLES_TO_MAPS + map;
            let least = of_samples / (SAMPLES_TO_MAPS + sample / map) - map;
            assert!((least..=1.001 * most).contains(&of_maps), "{map}, {sample}: {of_maps}");
        }
        let mut owed = OwedToSamples::default();
        owed.maps_took(1.0, true);
        assert!(!owed.is_maps_turn(true) && owed.is_maps_turn(false));
        owed.samples_took(1e6);
        owed.maps_took(1.0, false);
        assert!(owed.is_maps_turn(true), "what is done while no samples are left owes nothing");
    }
}
