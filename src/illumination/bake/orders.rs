//! Parts of a round, for whoever gathers: at which sites, and what is known of each.
//!
//! What an order comes to is a function of scene, settings, the map of the round before and the order itself. So it does
//! not matter who gathers, where, or how often.

use std::sync::OnceLock;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::particles::Arrived;
use super::rounds::{FIRST_ROUND, ROUNDS_MAX};
use super::{AHEAD, BATCH, BLOCK, Baker, Doing, FIRST_LOOK, UNSEEN};
use crate::illumination::gathered::Gathered;
use crate::illumination::points::Look;
use crate::illumination::stored::Illumination;
use crate::transport::Indexed;
use crate::transport::gather::Trust;
use crate::transport::light::bright::BrightSurfaces;

/// Samples of an order, about: some milliseconds.
const SAMPLES: u64 = 1 << 10;
/// Sites of an order at most.
const SITES: usize = 256;

/// Sites to gather light at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Samples of a site in the round.
    samples: u32,
    /// When it is.
    phase: Phase,
    /// By number, with what is known of each.
    sites: Vec<(u32, Gathered)>,
}

/// When a round is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Phase {
    /// Before the rounds over all sites.
    Early,
    /// The first of these.
    First,
    /// After that.
    Later,
}

/// What is known of an order's sites once light was gathered there, in the same order.
pub type Answer = Vec<Gathered>;

impl Order {
    /// Whether an answer may be one to it: what came from elsewhere must.
    pub fn may_be_answered_by(&self, answer: &Answer) -> bool {
        answer.len() == self.sites.len()
            && answer.iter().zip(&self.sites).all(|(sums, (_, before))| {
                sums.is_sound()
                    && (before.samples()..=before.samples() + most(self.samples)).contains(&sums.samples())
            })
    }
}

/// Samples that a site takes in a round at most.
fn most(samples: u32) -> u32 {
    (AHEAD * samples).max(FIRST_LOOK)
}

/// Who gathers.
pub trait Gatherers: Sync {
    /// What these orders of a bake come to ([`Baker::answer`]), in the same order.
    fn gather(&self, baker: &Baker, indexed: Indexed<'_>, orders: &[Order]) -> Vec<Answer>;

    /// What these parts of the particles of a bake bring ([`Baker::arrived`]), in the same order.
    fn trace(&self, baker: &Baker, indexed: Indexed<'_>, parts: &[u64]) -> Vec<Vec<Arrived>> {
        let of = |part: &u64| if self.is_wanted() { baker.arrived(indexed, *part) } else { Vec::new() };
        parts.par_iter().map(of).collect()
    }

    /// How much they do in the time that the threads of this machine take for 1.
    fn worth(&self) -> u64 {
        1
    }

    /// Whether the bake is wanted still. Where not, a step that takes long ends early, and the bake is of no use any more.
    fn is_wanted(&self) -> bool {
        true
    }
}

/// The threads of this machine.
#[derive(Clone, Copy, Debug)]
pub struct Here;

impl Gatherers for Here {
    fn gather(&self, baker: &Baker, indexed: Indexed<'_>, orders: &[Order]) -> Vec<Answer> {
        orders.par_iter().map(|order| baker.answer(indexed, (baker.map(), baker.bright()), order)).collect()
    }
}

/// The threads of this machine, as long as this says so.
pub struct WhileWanted<'a>(pub &'a (dyn Fn() -> bool + Sync));

impl Gatherers for WhileWanted<'_> {
    fn gather(&self, baker: &Baker, indexed: Indexed<'_>, orders: &[Order]) -> Vec<Answer> {
        let of =
            |order| self.is_wanted().then(|| baker.answer(indexed, (baker.map(), baker.bright()), order));
        orders.par_iter().map(of).collect::<Option<_>>().unwrap_or_default()
    }

    fn is_wanted(&self) -> bool {
        (self.0)()
    }
}

impl Baker {
    /// Gathers at some more sites of the round.
    pub(super) fn gather(&mut self, indexed: Indexed<'_>, gatherers: &dyn Gatherers) {
        let phase = self.rounds.phase(self.round);
        // Decided at the beginning of the round; later the paths that are left say something else.
        let samples = self.round_samples.unwrap_or_else(|| self.samples_of_round());
        self.round_samples = Some(samples);
        let sites = self.rounds.sites(self.round);
        let count = sites.len();
        let (mut end, mut batch, most) = (self.next, 0, BATCH * gatherers.worth());
        let (mut orders, mut in_order): (Vec<Order>, u64) = (Vec::new(), SAMPLES);
        while end < count && batch < most {
            let i = sites[end] as usize;
            end += 1;
            if self.dark[i / BLOCK] {
                continue;
            }
            if in_order >= SAMPLES || orders.last().is_none_or(|order| order.sites.len() >= SITES) {
                orders.push(Order { samples, phase, sites: Vec::new() });
                in_order = 0;
            }
            let taken = u64::from(self.samples_at(i, samples, phase));
            (batch, in_order) = (batch + taken, in_order + taken);
            if let Some(order) = orders.last_mut() {
                order.sites.push((i as u32, self.gathered[i]));
            }
        }
        let answers = gatherers.gather(self, indexed, &orders);
        if !gatherers.is_wanted() {
            return;
        }
        for ((site, before), sums) in orders.iter().flat_map(|o| &o.sites).zip(answers.into_iter().flatten())
        {
            self.gathered[*site as usize] = sums;
            self.paths += u64::from(sums.samples() - before.samples());
        }
        self.next = end;
        if end < count {
            return;
        }
        // The first round that comes to all sites tells which are dark.
        if phase == Phase::First {
            let blocks = self.gathered.chunks(BLOCK).map(|block| !block.iter().any(Gathered::is_lit));
            self.dark = blocks.collect();
        }
        self.round_samples = None;
        self.doing = Doing::Smooth(self.smoothing());
    }

    /// Samples that a site takes in a round.
    pub(super) fn samples_at(&self, i: usize, samples: u32, phase: Phase) -> u32 {
        match (phase, self.ahead[i], self.seen[i]) {
            // It had its share of this round in the one before.
            (Phase::First, true, _) => FIRST_LOOK,
            (_, true, _) => AHEAD * samples,
            (Phase::First, ..) if self.sites.all()[i].back => FIRST_LOOK,
            (.., true) => samples,
            _ => (samples / UNSEEN).next_multiple_of(2).max(2),
        }
    }

    /// Whether an order is one of this bake: what came from elsewhere must be.
    pub fn has(&self, order: &Order) -> bool {
        let is_known =
            |(site, sums): &(u32, Gathered)| (*site as usize) < self.gathered.len() && sums.is_sound();
        order.samples <= FIRST_ROUND << ROUNDS_MAX
            && order.sites.len() <= SITES
            && order.sites.iter().all(is_known)
    }

    /// What an order comes to under the `map` of the round before, whose `bright` surfaces are looked for once. Of the bake
    /// itself only scene and settings count.
    pub fn answer(
        &self,
        indexed: Indexed<'_>,
        (map, bright): (&Illumination, &OnceLock<BrightSurfaces>),
        order: &Order,
    ) -> Answer {
        let bright = bright.get_or_init(|| BrightSurfaces::new(indexed.scene, map));
        let gather = indexed.gather(Trust::Map(map)).without_caustics().without_named();
        let gather = gather.looking_for(bright).looking_out();
        let (atlas, points) = (&self.atlas, &self.points);
        let at = |&(site, mut sums): &(u32, Gathered)| {
            let i = site as usize;
            let site = &self.sites.all()[i];
            let look = if self.seen[i] { Look::Close } else { Look::Brief };
            if !sums.find_points((indexed.scene, indexed.accel), atlas, points, (site, look)) {
                return sums;
            }
            let count = self.samples_at(i, order.samples, order.phase);
            sums.begin_round();
            sums.gather(indexed.scene, (atlas, points), &gather, site, (self.settings.seed, count));
            sums
        };
        order.sites.iter().map(at).collect()
    }
}
