//! Which levels of which textures are in memory, from one moment to the next: Dumont's decision (2003 §5.2.4) carried
//! out step by step, so that the limit holds at every instant and no frame has much to do.
//!
//! In: what views show, and what became of the orders given. Out: orders to load the next finer level of a texture or to
//! drop its finest ones. A level counts from the moment its load is ordered until nobody holds it any more.

use super::decision::{Constraint, decide};
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

/// The state of all textures.
#[derive(Clone, Debug)]
pub struct Residency {
    limit: u64,
    facts: Vec<TextureFacts>,
    /// Bytes of each level of each, as the optimiser takes them; a single one where pinned.
    costs: Vec<Vec<u64>>,
    spatial: Vec<SpatialErrors>,
    uses: Vec<TextureUse>,
    /// Finest level in memory or ordered to be.
    states: Vec<usize>,
    /// Finest level that is wanted.
    targets: Vec<usize>,
    /// Loads ordered and not there yet.
    loading: Vec<(usize, usize)>,
    /// Levels that could not be read: nothing finer is asked for.
    broken: Vec<usize>,
    /// Bytes dropped that somebody may still hold.
    releasing: u64,
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
            targets: states.clone(),
            states,
            loading: Vec::new(),
            broken: vec![0; facts.len()],
            releasing: 0,
            price: 0.0,
            facts,
        })
    }

    /// The limit, bytes.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// Another limit, decided for at once; what is over it goes step by step.
    ///
    /// # Errors
    /// Where not even the coarsest levels fit into it; the old limit stays.
    pub fn set_limit(&mut self, limit: u64) -> Result<(), LimitTooSmall> {
        let smallest = smallest(&self.facts);
        if smallest > limit {
            return Err(LimitTooSmall { limit, smallest });
        }
        self.limit = limit;
        self.decide(self.uses.clone());
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
        let resident: u64 = self.facts.iter().zip(&self.states).map(|(f, &s)| f.bytes_from(s)).sum();
        resident + self.releasing
    }

    /// Loads that are not there yet.
    pub fn loading(&self) -> usize {
        self.loading.len()
    }

    /// Whether nothing more is to be done for the last view.
    pub fn is_settled(&self) -> bool {
        self.loading.is_empty() && self.releasing == 0 && self.states == self.targets
    }

    /// −Σ q of the last view in the present state, just noticeable differences × pixels.
    pub fn visible_error(&self) -> f64 {
        let of = |i: usize| self.uses[i].error(&self.spatial[i], self.states[i]);
        (0..self.facts.len()).filter(|&i| !self.facts[i].pinned).map(of).sum()
    }

    /// Decides anew for what a view shows.
    pub fn decide(&mut self, uses: Vec<TextureUse>) {
        if uses.len() != self.facts.len() {
            return;
        }
        self.uses = uses;
        let now: Vec<usize> =
            self.facts.iter().zip(&self.states).map(|(f, &s)| if f.pinned { 0 } else { s }).collect();
        let choices = TextureChoices { bytes: &self.costs, uses: &self.uses, spatial: &self.spatial };
        // The coarsest states fit, as `new` has made sure.
        let Ok(chosen) = decide(&choices, Constraint::Bytes(self.limit), Some(&now)) else { return };
        self.price = chosen.price;
        for (i, facts) in self.facts.iter().enumerate() {
            self.targets[i] = if facts.pinned { 0 } else { chosen.states[i].max(self.broken[i]) };
        }
    }

    /// The next order: the load that brings most per byte while there is room, else the drop that makes room. None while
    /// `loads_max` loads are out, or room is yet to come free, or all is as wanted.
    pub fn next_step(&mut self, loads_max: usize) -> Option<Step> {
        if self.loading.len() >= loads_max {
            return None;
        }
        let gain = |i: usize| {
            let level = self.states[i] - 1;
            let error = |finest| self.uses[i].error(&self.spatial[i], finest);
            (error(level + 1) - error(level)).max(0.0) / self.facts[i].bytes[level].max(1) as f64
        };
        let waiting = |i: &usize| {
            self.states[*i] > self.targets[*i] && self.loading.iter().all(|(texture, _)| texture != i)
        };
        let best = (0..self.facts.len())
            .filter(waiting)
            .map(|i| (gain(i), i))
            .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        if let Some((_, texture)) = best {
            let level = self.states[texture] - 1;
            if self.used() + self.facts[texture].bytes[level] <= self.limit {
                self.states[texture] = level;
                self.loading.push((texture, level));
                return Some(Step::Load { texture, level });
            }
        } else if self.used() <= self.limit {
            return None;
        }
        if self.releasing > 0 {
            return None;
        }
        // Nothing is dropped that room is not needed for: what was seen may be seen again.
        let surplus = |i: &usize| {
            self.states[*i] < self.targets[*i] && self.loading.iter().all(|(texture, _)| texture != i)
        };
        let texture = (0..self.facts.len()).find(surplus)?;
        let finest = self.targets[texture];
        self.releasing +=
            self.facts[texture].bytes_from(self.states[texture]) - self.facts[texture].bytes_from(finest);
        self.states[texture] = finest;
        Some(Step::Drop { texture, finest })
    }

    /// A load is there, or failed: then nothing finer of that texture is asked for again.
    pub fn on_loaded(&mut self, texture: usize, level: usize, is_there: bool) {
        let Some(at) = self.loading.iter().position(|&load| load == (texture, level)) else { return };
        self.loading.swap_remove(at);
        if !is_there {
            self.states[texture] = level + 1;
            self.broken[texture] = level + 1;
            self.targets[texture] = self.targets[texture].max(level + 1);
        }
    }

    /// Nobody holds what was dropped so far.
    pub fn on_released(&mut self) {
        self.releasing = 0;
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
        let mut late = Vec::new();
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
                    Step::Drop { .. } => residency.on_released(),
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
