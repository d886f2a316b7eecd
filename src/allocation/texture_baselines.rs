//! What others do about too many textures, to compare the decision with.
//!
//! In: bytes per level, what the view shows, a limit. Out: per texture the finest level that is resident. The coarsest
//! level of every texture always is; where not even these fit there is no answer.

use super::texture_demand::TextureUse;

/// Ways to choose what is resident.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// A visible texture is there in full or not at all, as long as there is room, the one with most pixels first: the
    /// case of 4 frames per second in Dumont 2003 §5.2.5.
    AllOrNothing,
    /// The level the nearest visible pixel asks for; coarser by one for all, as often as needed.
    MipRequest,
    /// The same without the view: all textures lose their finest levels alike.
    DropLevels,
    /// The level asked for; where that is too much, textures whose last use is longest ago lose theirs ([`LeastRecentlyUsed`]).
    LeastRecentlyUsed,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::AllOrNothing, Self::MipRequest, Self::DropLevels, Self::LeastRecentlyUsed];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::AllOrNothing => "all or nothing",
            Self::MipRequest => "mip request",
            Self::DropLevels => "drop levels",
            Self::LeastRecentlyUsed => "least recently used",
        }
    }
}

/// Bytes of level `finest` of a texture and all coarser ones.
fn bytes_from(levels: &[u64], finest: usize) -> u64 {
    levels.get(finest..).unwrap_or_default().iter().fold(0, |sum, &bytes| sum.saturating_add(bytes))
}

fn total(bytes: &[Vec<u64>], states: &[usize]) -> u64 {
    bytes.iter().zip(states).fold(0, |sum, (levels, &finest)| sum.saturating_add(bytes_from(levels, finest)))
}

fn coarsest(bytes: &[Vec<u64>]) -> Vec<usize> {
    bytes.iter().map(|levels| levels.len().saturating_sub(1)).collect()
}

/// Which textures are shown, in full where `wanted` is level 0.
fn requested(bytes: &[Vec<u64>], uses: &[TextureUse]) -> Vec<usize> {
    let finest = |i: usize| uses.get(i).and_then(TextureUse::finest);
    coarsest(bytes)
        .iter()
        .enumerate()
        .map(|(i, &last)| finest(i).map_or(last, |level| level.min(last)))
        .collect()
}

/// All textures coarser by the fewest levels that fit.
fn coarser_until_it_fits(bytes: &[Vec<u64>], states: &[usize], limit: u64) -> Option<Vec<usize>> {
    let last = coarsest(bytes);
    let most = last.iter().copied().max().unwrap_or(0);
    (0..=most)
        .map(|bias| states.iter().zip(&last).map(|(&state, &last)| (state + bias).min(last)).collect())
        .find(|states: &Vec<usize>| total(bytes, states) <= limit)
}

fn all_or_nothing(bytes: &[Vec<u64>], uses: &[TextureUse], limit: u64) -> Option<Vec<usize>> {
    let mut states = coarsest(bytes);
    let mut left = limit.checked_sub(total(bytes, &states))?;
    let pixels = |i: usize| uses.get(i).map_or(0.0, TextureUse::total_pixels);
    let mut order: Vec<usize> = (0..bytes.len()).filter(|&i| pixels(i) > 0.0).collect();
    order.sort_by(|&a, &b| pixels(b).total_cmp(&pixels(a)));
    for i in order {
        let extra = bytes_from(&bytes[i], 0) - bytes_from(&bytes[i], states[i]);
        if extra <= left {
            left -= extra;
            states[i] = 0;
        }
    }
    Some(states)
}

/// A cache of mip levels: loads what is asked for, gives up the finest level of what was used longest ago.
#[derive(Clone, Debug, Default)]
pub struct LeastRecentlyUsed {
    states: Vec<usize>,
    last_use: Vec<u64>,
    frame: u64,
}

impl LeastRecentlyUsed {
    /// The states after a frame that shows `uses`; none if not even the coarsest levels fit.
    pub fn update(&mut self, bytes: &[Vec<u64>], uses: &[TextureUse], limit: u64) -> Option<&[usize]> {
        let last = coarsest(bytes);
        if total(bytes, &last) > limit {
            return None;
        }
        if self.states.len() != bytes.len() {
            self.states = last.clone();
            self.last_use = vec![0; bytes.len()];
        }
        self.frame += 1;
        for (i, wanted) in requested(bytes, uses).into_iter().enumerate() {
            if uses.get(i).is_some_and(|used| used.total_pixels() > 0.0) {
                self.last_use[i] = self.frame;
                self.states[i] = self.states[i].min(wanted);
            }
        }
        let mut order: Vec<usize> = (0..bytes.len()).collect();
        order.sort_by_key(|&i| (self.last_use[i], i));
        let mut cost = total(bytes, &self.states);
        for i in order {
            while cost > limit && self.states[i] < last[i] {
                cost -= bytes[i][self.states[i]];
                self.states[i] += 1;
            }
        }
        Some(&self.states)
    }
}

/// The finest resident level of each texture for one view; none if not even the coarsest levels fit.
pub fn choose(baseline: Baseline, bytes: &[Vec<u64>], uses: &[TextureUse], limit: u64) -> Option<Vec<usize>> {
    match baseline {
        Baseline::AllOrNothing => all_or_nothing(bytes, uses, limit),
        Baseline::MipRequest => coarser_until_it_fits(bytes, &requested(bytes, uses), limit),
        Baseline::DropLevels => coarser_until_it_fits(bytes, &vec![0; bytes.len()], limit),
        Baseline::LeastRecentlyUsed => {
            LeastRecentlyUsed::default().update(bytes, uses, limit).map(<[usize]>::to_vec)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocation::decision::{Constraint, decide};
    use crate::allocation::spatial_error::{SpatialErrors, SpatialSettings};
    use crate::allocation::texture_demand::TextureChoices;
    use crate::image::Map2d;
    use crate::rng;
    use glam::Vec3;

    const LEVELS: usize = 6;

    fn bytes(textures: usize) -> Vec<Vec<u64>> {
        vec![(0..LEVELS as u32).map(|l| 4u64 << (2 * (5 - l))).collect(); textures]
    }

    fn shown(pixels: f32, level: usize) -> TextureUse {
        let mut shown = TextureUse::default();
        shown.pixels[level] = pixels;
        shown.visibility[level] = 15.0 * pixels;
        shown
    }

    #[test]
    fn each_does_what_it_says() {
        let bytes = bytes(3);
        let uses = [shown(10.0, 0), shown(500.0, 2), TextureUse::default()];
        let full: u64 = bytes[0].iter().sum();
        let chosen = |baseline, limit| choose(baseline, &bytes, &uses, limit).unwrap();
        assert_eq!(chosen(Baseline::AllOrNothing, full + 8), [5, 0, 5]);
        assert_eq!(chosen(Baseline::AllOrNothing, 2 * full + 4), [0, 0, 5]);
        assert_eq!(chosen(Baseline::MipRequest, 3 * full), [0, 2, 5]);
        assert_eq!(chosen(Baseline::MipRequest, full), [1, 3, 5]);
        assert_eq!(chosen(Baseline::DropLevels, full), [1, 1, 1]);
        assert_eq!(chosen(Baseline::LeastRecentlyUsed, full + 100), [1, 2, 5]);
        for baseline in Baseline::ALL {
            assert_eq!(choose(baseline, &bytes, &uses, 11), None);
            assert_eq!(chosen(baseline, 12), [5, 5, 5]);
            assert_eq!(choose(baseline, &[], &[], 0), Some(vec![]));
        }
    }

    #[test]
    fn what_was_used_longest_ago_goes_first() {
        let bytes = bytes(2);
        let full: u64 = bytes[0].iter().sum();
        let mut cache = LeastRecentlyUsed::default();
        let (first, second) =
            ([shown(9.0, 0), TextureUse::default()], [TextureUse::default(), shown(9.0, 0)]);
        assert_eq!(cache.update(&bytes, &first, full + 500), Some(&[0, 5][..]));
        assert_eq!(cache.update(&bytes, &second, full + 500), Some(&[2, 0][..]));
        assert_eq!(cache.update(&bytes, &second, full + 4), Some(&[5, 0][..]));
    }

    #[test]
    fn the_decision_is_never_worse() {
        let settings = SpatialSettings::new(10.8, 100.0);
        let texture = |seed: u64| {
            let contrast = rng::unit_f32(rng::hash(seed, 1, 1));
            let noise = |x: usize, y: usize| rng::unit_f32(rng::hash(x as u64, y as u64, seed)) - 0.5;
            let level = |l: usize| {
                let n = 1usize << l;
                Map2d::from_fn(32 / n, 32 / n, |x, y| {
                    let sum: f32 = (0..n * n).map(|i| noise(x * n + i % n, y * n + i / n)).sum();
                    Vec3::splat(0.5 + contrast * sum / (n * n) as f32)
                })
            };
            SpatialErrors::of_levels(&(0..LEVELS).map(level).collect::<Vec<_>>(), &settings)
        };
        let spatial: Vec<SpatialErrors> = (0..12).map(texture).collect();
        let bytes = bytes(12);
        for view in 0..10 {
            let random = |i: u64, dimension| rng::unit_f32(rng::hash(view, i, dimension));
            let uses: Vec<TextureUse> = (0..12)
                .map(|i| match random(i, 0) {
                    r if r < 0.3 => TextureUse::default(),
                    r => shown(3000.0 * r, (4.0 * random(i, 1)) as usize),
                })
                .collect();
            let limit = 12 * bytes[0].iter().sum::<u64>() / 4;
            let choices = TextureChoices { bytes: &bytes, uses: &uses, spatial: &spatial };
            let decided = decide(&choices, Constraint::Bytes(limit), None).unwrap();
            assert!(decided.cost <= limit);
            let error =
                |states: &[usize]| -> f64 { (0..12).map(|i| uses[i].error(&spatial[i], states[i])).sum() };
            for baseline in Baseline::ALL {
                let states = choose(baseline, &bytes, &uses, limit).unwrap();
                assert!(total(&bytes, &states) <= limit);
                let (ours, theirs) = (error(&decided.states), error(&states));
                assert!(ours <= theirs + 1e-3, "view {view}, {}: {ours} {theirs}", baseline.name());
            }
        }
    }
}
