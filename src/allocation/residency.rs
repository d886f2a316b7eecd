//! Which levels of which textures are in memory, from one moment to the next: Dumont's decision (2003 §5.2.4) carried
//! out step by step, so that the limit holds at every instant and no frame has much to do.
//!
//! In: what views show, and what became of the orders given. Out: orders to load the next finer level of a texture or to
//! drop its finest ones. A level counts from the moment its load is ordered until nobody holds it any more.

use std::collections::{BinaryHeap, VecDeque};

use super::decision::{Constraint, Decision};
use super::knapsack::LimitTooSmall;
use super::spatial_error::SpatialErrors;
use super::texture_demand::{TextureChoices, TextureUse};

/// What is known of a texture before anything is shown.
#[derive(Clone, Debug)]
pub struct TextureFacts {
    /// Bytes of each level, the finest first; never empty.
    pub bytes: Vec<u64>,
    /// Needed in full whatever is shown: masks, heights and normals, which decide geometry.
    pub pinned: bool,
    /// What coarser levels lose.
    pub spatial: SpatialErrors,
}

impl TextureFacts {
    /// Bytes of the levels from `finest` on.
    pub fn bytes_from(&self, finest: usize) -> u64 {
        self.bytes.get(finest..).unwrap_or_default().iter().sum()
    }

    /// The coarsest state it may be in.
    pub fn coarsest(&self) -> usize {
        if self.pinned { 0 } else { self.bytes.len().saturating_sub(1) }
    }
}

/// The smallest limit under which every texture has what it cannot do without.
pub fn smallest(facts: &[TextureFacts]) -> u64 {
    facts.iter().map(|f| f.bytes_from(f.coarsest())).sum()
}

/// An order to change what is in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Load this level, the next finer one.
    Load {
        /// Which texture.
        texture: usize,
        /// Which level.
        level: usize,
    },
    /// Drop the levels finer than this one.
    Drop {
        /// Which texture.
        texture: usize,
        /// The finest level that stays.
        finest: usize,
    },
}

/// A level that is wanted, in the order of what it brings per byte.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Wanted {
    /// Visible error that it takes away, per byte.
    gain: f64,
    texture: usize,
    level: usize,
}

impl Eq for Wanted {}

impl Ord for Wanted {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let by_gain = self.gain.total_cmp(&other.gain);
        by_gain.then(other.texture.cmp(&self.texture)).then(self.level.cmp(&other.level))
    }
}

impl PartialOrd for Wanted {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// How far a decision is.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
enum Deciding {
    /// Which levels are wanted, from these states.
    Levels(Box<Decision>, Vec<usize>),
    /// In what order; textures up to here are in it.
    Order(usize),
}

/// The state of all textures. It is saved without what is known of them from the start.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Residency {
    limit: u64,
    #[serde(skip)]
    facts: Vec<TextureFacts>,
    /// Bytes of each level of each, as the optimiser takes them; a single one where pinned.
    #[serde(skip)]
    costs: Vec<Vec<u64>>,
    #[serde(skip)]
    spatial: Vec<SpatialErrors>,
    uses: Vec<TextureUse>,
    /// What the newest view shows, where a decision for an older one is on its way.
    newer: Option<Vec<TextureUse>>,
    deciding: Option<Deciding>,
    /// Finest level in memory or ordered to be.
    states: Vec<usize>,
    /// Bytes of these.
    resident: u64,
    /// Finest level that is wanted.
    targets: Vec<usize>,
    /// The next level of each texture that is to become finer; some may be out of date.
    wanted: BinaryHeap<Wanted>,
    /// Loads ordered and not there yet.
    loading: Vec<(usize, usize)>,
    /// Levels that could not be read: nothing finer is asked for.
    broken: Vec<usize>,
    /// Bytes of each drop that somebody may still hold, in their order.
    releasing: VecDeque<u64>,
    /// Drops that nobody holds any more.
    released: u32,
    /// What one more byte would buy, just noticeable differences × pixels.
    price: f64,
}

impl Residency {
    /// All textures at their coarsest.
    ///
    /// # Errors
    /// Where even that does not fit.
    pub fn new(limit: u64, facts: Vec<TextureFacts>) -> Result<Self, LimitTooSmall> {
        let smallest = smallest(&facts);
        if smallest > limit {
            return Err(LimitTooSmall { limit, smallest });
        }
        let states: Vec<usize> = facts.iter().map(TextureFacts::coarsest).collect();
        // A pinned texture has one state, which costs all of it.
        let cost = |f: &TextureFacts| if f.pinned { vec![f.bytes_from(0)] } else { f.bytes.clone() };
        Ok(Self {
            limit,
            costs: facts.iter().map(cost).collect(),
            spatial: facts.iter().map(|f| f.spatial.clone()).collect(),
            uses: vec![TextureUse::default(); facts.len()],
            newer: None,
            deciding: None,
            targets: states.clone(),
            resident: smallest,
            wanted: BinaryHeap::new(),
            states,
            loading: Vec::new(),
            broken: vec![0; facts.len()],
            releasing: VecDeque::new(),
            released: 0,
            price: 0.0,
            facts,
        })
    }

    /// Goes on from a state that was saved without its facts, which are this one's; `None`, and nothing changed, if it is
    /// of other textures.
    pub fn go_on_from(&mut self, saved: Self) -> Option<()> {
        let count = self.facts.len();
        let levels_of = |texture: usize| self.facts.get(texture).map_or(0, |facts| facts.bytes.len());
        let fit = |states: &[usize]| {
            states.len() == count && states.iter().enumerate().all(|(texture, s)| *s <= levels_of(texture))
        };
        let fits = saved.uses.len() == count
            && saved.newer.as_ref().is_none_or(|uses| uses.len() == count)
            && [&saved.states, &saved.targets, &saved.broken].into_iter().all(|states| fit(states))
            && saved.loading.iter().all(|&(texture, level)| level < levels_of(texture))
            && saved.wanted.iter().all(|wanted| wanted.level < levels_of(wanted.texture));
        fits.then(|| {
            let facts = std::mem::take(&mut self.facts);
            let (costs, spatial) = (std::mem::take(&mut self.costs), std::mem::take(&mut self.spatial));
            *self = Self { facts, costs, spatial, ..saved };
        })
    }

    /// The limit, bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Another limit, decided for next; what is over it goes step by step.
    ///
    /// # Errors
    /// Where not even the coarsest levels fit into it; the old limit stays.
    pub fn set_limit(&mut self, limit: u64) -> Result<(), LimitTooSmall> {
        let smallest = smallest(&self.facts);
        if smallest > limit {
            return Err(LimitTooSmall { limit, smallest });
        }
        self.limit = limit;
        // What is on its way is for the old one.
        self.deciding = None;
        if self.newer.is_none() {
            self.newer = Some(self.uses.clone());
        }
        Ok(())
    }

    /// Finest level of each texture in memory or ordered to be.
    pub fn states(&self) -> &[usize] {
        &self.states
    }

    /// Finest level that is wanted of each.
    pub fn targets(&self) -> &[usize] {
        &self.targets
    }

    /// What the last view showed of each.
    pub fn uses(&self) -> &[TextureUse] {
        &self.uses
    }

    /// The facts of each.
    pub fn facts(&self) -> &[TextureFacts] {
        &self.facts
    }

    /// Visible error that one more MiB would take away, just noticeable differences × pixels.
    pub fn price_per_mib(&self) -> f64 {
        self.price * f64::from(1 << 20)
    }

    /// Bytes in memory, on their way there, or dropped and perhaps still held. Never above the limit, unless that
    /// was lowered a moment ago.
    pub fn used(&self) -> u64 {
        self.resident + self.releasing.iter().sum::<u64>()
    }

    /// Loads that are not there yet.
    pub fn loading(&self) -> usize {
        self.loading.len()
    }

    /// Whether nothing more is to be done for the last view.
    pub fn is_settled(&self) -> bool {
        !self.is_deciding()
            && self.loading.is_empty()
            && self.releasing.is_empty()
            && self.states == self.targets
    }

    /// −Σ q of the last view with the levels that are there, just noticeable differences × pixels.
    pub fn visible_error(&self) -> f64 {
        let of =
            |i: usize| self.uses[i].error(&self.spatial[i], self.states[i] + usize::from(self.is_loading(i)));
        (0..self.facts.len()).filter(|&i| !self.facts[i].pinned).map(of).sum()
    }

    /// Decides anew for what a view shows, as soon as [`Residency::go_on`] has the time; of several views the newest counts.
    pub fn see(&mut self, uses: Vec<TextureUse>) {
        if uses.len() == self.facts.len() {
            self.newer = Some(uses);
        }
    }

    /// Whether there is something to decide.
    pub fn is_deciding(&self) -> bool {
        self.deciding.is_some() || self.newer.is_some()
    }

    /// Goes on deciding for as long as there is `work` ([`super::search::Search::go_on`]). Until it is done the last
    /// decision holds.
    pub fn go_on(&mut self, work: &mut u64) {
        while *work > 0 {
            match self.deciding.take() {
                None => {
                    let Some(uses) = self.newer.take() else { return };
                    self.uses = uses;
                    let now = |(f, &s): (&TextureFacts, &usize)| if f.pinned { 0 } else { s };
                    let now = self.facts.iter().zip(&self.states).map(now).collect();
                    let decision = Box::new(Decision::new(Constraint::Bytes(self.limit)));
                    self.deciding = Some(Deciding::Levels(decision, now));
                }
                Some(Deciding::Levels(mut decision, now)) => {
                    let choices =
                        TextureChoices { bytes: &self.costs, uses: &self.uses, spatial: &self.spatial };
                    match decision.go_on(&choices, Some(&now), work) {
                        None => self.deciding = Some(Deciding::Levels(decision, now)),
                        Some(Ok(chosen)) => {
                            self.price = chosen.price;
                            for (i, facts) in self.facts.iter().enumerate() {
                                let level = chosen.states[i].max(self.broken[i]);
                                self.targets[i] = if facts.pinned { 0 } else { level };
                            }
                            self.wanted.clear();
                            self.deciding = Some(Deciding::Order(0));
                        }
                        // The coarsest states fit, as `new` has made sure.
                        Some(Err(_)) => {}
                    }
                }
                Some(Deciding::Order(first)) => {
                    let last = (first + (*work).min(1 << 20) as usize).min(self.facts.len());
                    (first..last).for_each(|texture| self.want_next(texture));
                    *work -= (last - first) as u64;
                    if last < self.facts.len() {
                        self.deciding = Some(Deciding::Order(last));
                    }
                }
            }
        }
    }

    /// [`Residency::see`] and all that follows, at once.
    pub fn decide(&mut self, uses: Vec<TextureUse>) {
        self.see(uses);
        while self.is_deciding() {
            self.go_on(&mut u64::MAX.clone());
        }
    }

    /// Puts the next finer level of a texture among those wanted, if it is.
    fn want_next(&mut self, texture: usize) {
        let finest = self.states[texture];
        if finest > self.targets[texture] {
            let level = finest - 1;
            let error = |finest| self.uses[texture].error(&self.spatial[texture], finest);
            let gain =
                (error(finest) - error(level)).max(0.0) / self.facts[texture].bytes[level].max(1) as f64;
            self.wanted.push(Wanted { gain, texture, level });
        }
    }

    /// The wanted level that brings most; those that are out of date go.
    fn best_wanted(&mut self) -> Option<Wanted> {
        while let Some(&best) = self.wanted.peek() {
            let is_next = self.states[best.texture] == best.level + 1;
            if is_next && best.level >= self.targets[best.texture] && !self.is_loading(best.texture) {
                return Some(best);
            }
            self.wanted.pop();
        }
        None
    }

    fn is_loading(&self, texture: usize) -> bool {
        self.loading.iter().any(|load| load.0 == texture)
    }

    /// The next order: the load that brings most per byte while there is room, else the drop that makes room. None while
    /// `loads_max` loads are out, or room is yet to come free, or all is as wanted.
    pub fn next_step(&mut self, loads_max: usize) -> Option<Step> {
        if self.loading.len() >= loads_max {
            return None;
        }
        let mut needed = 0;
        if let Some(Wanted { texture, level, .. }) = self.best_wanted() {
            needed = self.facts[texture].bytes[level];
            if self.used() + needed <= self.limit {
                self.wanted.pop();
                self.states[texture] = level;
                self.resident += needed;
                self.loading.push((texture, level));
                return Some(Step::Load { texture, level });
            }
        }
        // What was dropped will be room enough.
        if self.resident + needed <= self.limit {
            return None;
        }
        // Nothing is dropped that room is not needed for: what was seen may be seen again.
        let surplus = |i: &usize| self.states[*i] < self.targets[*i] && !self.is_loading(*i);
        let texture = (0..self.facts.len()).find(surplus)?;
        let finest = self.targets[texture];
        let facts = &self.facts[texture];
        let bytes = facts.bytes_from(self.states[texture]) - facts.bytes_from(finest);
        self.resident -= bytes;
        self.releasing.push_back(bytes);
        self.states[texture] = finest;
        Some(Step::Drop { texture, finest })
    }

    /// A load is there, or failed: then nothing finer of that texture is asked for again.
    pub fn on_loaded(&mut self, texture: usize, level: usize, is_there: bool) {
        let Some(at) = self.loading.iter().position(|&load| load == (texture, level)) else { return };
        self.loading.swap_remove(at);
        if is_there {
            // While it was on its way another decision may have left it out.
            if !matches!(self.deciding, Some(Deciding::Order(first)) if first <= texture) {
                self.want_next(texture);
            }
        } else {
            self.states[texture] = level + 1;
            self.resident -= self.facts[texture].bytes[level];
            self.broken[texture] = level + 1;
            self.targets[texture] = self.targets[texture].max(level + 1);
        }
    }

    /// Nobody holds what the first `drops` drops there ever were have dropped.
    pub fn on_released(&mut self, drops: u32) {
        while self.released < drops && self.releasing.pop_front().is_some() {
            self.released += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocation::spatial_error::SpatialSettings;
    use crate::image::Map2d;
    use crate::rng;
    use glam::Vec3;

    fn facts(seed: u64, contrast: f32) -> TextureFacts {
        let level = |l: usize| {
            let n = 32usize >> l;
            Map2d::from_fn(n, n, |x, y| {
                let noise = rng::unit_f32(rng::hash(x as u64, y as u64, seed + l as u64)) - 0.5;
                Vec3::splat(0.5 + contrast * noise / (1 << l) as f32)
            })
        };
        let levels: Vec<Map2d<Vec3>> = (0..6).map(level).collect();
        TextureFacts {
            bytes: (0..6).map(|l| 4u64 << (2 * (5 - l))).collect(),
            pinned: false,
            spatial: SpatialErrors::of_levels(&levels, &SpatialSettings::new(10.8, 100.0)),
        }
    }

    fn shown(pixels: f32, level: usize) -> TextureUse {
        let mut shown = TextureUse::default();
        shown.pixels[level] = pixels;
        shown.visibility[level] = 15.0 * pixels;
        shown
    }

    /// Carries out everything that is ordered, with loads and releases some steps late; checks the limit at each.
    fn settle(residency: &mut Residency, log: &mut Vec<Step>) {
        let (mut late, mut drops) = (Vec::new(), residency.released);
        for _ in 0..1000 {
            assert!(residency.used() <= residency.limit());
            match residency.next_step(2) {
                Some(step) => {
                    log.push(step);
                    late.push(step);
                }
                None if late.is_empty() => return,
                None => match late.remove(0) {
                    Step::Load { texture, level } => residency.on_loaded(texture, level, true),
                    Step::Drop { .. } => {
                        drops += 1;
                        residency.on_released(drops);
                    }
                },
            }
        }
        panic!("does not settle");
    }

    #[test]
    fn without_pressure_everything_is_loaded() {
        let facts: Vec<TextureFacts> = (0..3).map(|i| facts(i, 0.8)).collect();
        let all = facts.iter().map(|f| f.bytes_from(0)).sum();
        let mut residency = Residency::new(all, facts).unwrap();
        residency.decide(vec![TextureUse::default(), shown(10.0, 2), shown(10.0, 0)]);
        let mut log = Vec::new();
        settle(&mut residency, &mut log);
        assert_eq!(residency.states(), [0, 0, 0]);
        assert_eq!(residency.used(), all);
        assert!(log.iter().all(|step| matches!(step, Step::Load { .. })));
    }

    /// Figure 13: the viewer goes up to a picture; its finest level arrives while those of others go.
    #[test]
    fn what_is_approached_comes_and_others_shrink() {
        let facts: Vec<TextureFacts> = (0..4).map(|i| facts(i, 0.8)).collect();
        let limit = facts[0].bytes_from(0) + 3 * facts[0].bytes_from(2);
        let mut residency = Residency::new(limit, facts).unwrap();
        let mut log = Vec::new();
        residency.decide(vec![shown(500.0, 0), shown(60.0, 2), shown(50.0, 2), shown(40.0, 2)]);
        settle(&mut residency, &mut log);
        let far = residency.states().to_vec();
        assert_eq!(far[0], 0);
        assert!(far[3] > 0);
        // Now the fourth is near.
        residency.decide(vec![TextureUse::default(), shown(60.0, 2), shown(50.0, 2), shown(4000.0, 0)]);
        settle(&mut residency, &mut log);
        let near = residency.states();
        assert_eq!(near[3], 0, "the full level of what is looked at");
        assert!(near[0] > far[0], "what is out of sight shrinks");
        assert!(log.contains(&Step::Load { texture: 3, level: 0 }));
        assert!(log.iter().any(|step| matches!(step, Step::Drop { texture: 0, .. })));
        assert!(residency.is_settled() || residency.states() != residency.targets());
    }

    #[test]
    fn a_limit_below_the_smallest_set_says_what_would_do() {
        let mut all: Vec<TextureFacts> = (0..2).map(|i| facts(i, 0.5)).collect();
        all[1].pinned = true;
        let smallest = 4 + all[1].bytes_from(0);
        assert_eq!(Residency::new(smallest - 1, all.clone()).unwrap_err().smallest, smallest);
        let residency = Residency::new(smallest, all).unwrap();
        assert_eq!((residency.states(), residency.used()), (&[5, 0][..], smallest));
    }

    #[test]
    fn what_cannot_be_read_is_not_asked_for_again() {
        let mut residency = Residency::new(1 << 20, vec![facts(1, 0.5)]).unwrap();
        residency.decide(vec![shown(100.0, 0)]);
        assert_eq!(residency.next_step(1), Some(Step::Load { texture: 0, level: 4 }));
        residency.on_loaded(0, 4, false);
        assert_eq!((residency.states()[0], residency.next_step(1)), (5, None));
        residency.decide(vec![shown(100.0, 0)]);
        assert_eq!(residency.next_step(1), None);
    }
}
