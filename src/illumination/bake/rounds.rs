//! In which order a bake comes to its sites, and how often: what the start view shows first.

use std::cmp::Ordering;

use super::orders::Phase;

/// Samples of a site in the first round over all of them; every later round doubles them.
pub(super) const FIRST_ROUND: u32 = 4;
/// Rounds over all sites at most; by then there is nothing left to see.
pub(super) const ROUNDS_MAX: u32 = 16;
/// Samples of rounds before them over what the start view shows, [`super::AHEAD`] times as many of a site: few at first,
/// for a map soon, but not so few that chance alone leaves a site without light. What they take in the last of these they need
/// not take in the first round over all.
pub(super) const EARLY: [u32; 3] = [2, 2, FIRST_ROUND];

/// In which order a bake comes to its sites: [`EARLY`] rounds are of those ahead alone, then each is over all.
pub(super) struct Rounds {
    /// All sites, those ahead first.
    order: Vec<u32>,
    /// How many of them are ahead.
    ahead: usize,
}

impl Rounds {
    /// `ahead`: per site whether it comes first.
    pub(super) fn new(ahead: &[bool]) -> Self {
        let of = |which: bool| (0..ahead.len() as u32).filter(move |i| ahead[*i as usize] == which);
        Self { order: of(true).chain(of(false)).collect(), ahead: of(true).count() }
    }

    /// Rounds that are not over all sites.
    pub(super) fn early(&self) -> u32 {
        if self.ahead == 0 { 0 } else { EARLY.len() as u32 }
    }

    /// Rounds over all sites before this one.
    pub(super) fn whole(&self, round: u32) -> u32 {
        round.saturating_sub(self.early())
    }

    /// When a round is.
    pub(super) fn phase(&self, round: u32) -> Phase {
        match round.cmp(&self.early()) {
            Ordering::Less => Phase::Early,
            Ordering::Equal => Phase::First,
            Ordering::Greater => Phase::Later,
        }
    }

    /// The sites of a round.
    pub(super) fn sites(&self, round: u32) -> &[u32] {
        if round < self.early() { &self.order[..self.ahead] } else { &self.order }
    }

    /// Samples of a site of a round at most; those ahead take [`super::AHEAD`] times as many.
    pub(super) fn samples(&self, round: u32) -> u32 {
        match EARLY.get(round as usize) {
            Some(samples) if self.ahead > 0 => *samples,
            _ => FIRST_ROUND << self.whole(round),
        }
    }

    /// How many there are at most.
    pub(super) fn most(&self) -> u32 {
        self.early() + ROUNDS_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::super::AHEAD;
    use super::*;

    /// Early rounds come to those ahead alone, all others to each site once with twice the samples of the one before; all take
    /// as many for each half.
    #[test]
    fn each_round_comes_to_its_sites_once() {
        for ahead in [vec![false; 7], vec![true; 7], (0..7).map(|i| i % 3 == 1).collect::<Vec<_>>()] {
            let rounds = Rounds::new(&ahead);
            let is_any = ahead.contains(&true);
            assert_eq!(rounds.early(), if is_any { 3 } else { 0 });
            for round in 0..rounds.most() {
                let mut sites = rounds.sites(round).to_vec();
                sites.sort_unstable();
                let of = |i: &u32| round >= rounds.early() || ahead[*i as usize];
                assert!(sites.into_iter().eq((0..7).filter(of)), "{round}");
                assert!(round <= rounds.early() || rounds.samples(round) == 2 * rounds.samples(round - 1));
                let spared = round == rounds.early() && is_any;
                assert!(!spared || rounds.samples(round) == rounds.samples(round - 1));
                assert!((AHEAD * rounds.samples(round)).is_multiple_of(2));
            }
            assert_eq!(
                (rounds.samples(rounds.early()), rounds.whole(rounds.most())),
                (FIRST_ROUND, ROUNDS_MAX)
            );
        }
    }
}
