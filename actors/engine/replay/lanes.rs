//! Deliveries on a line of time: a lane for each actor, and what led from one delivery to another.
//!
//! A recording says in which order things came, not when: times are those of a replay with as many threads, in which each
//! delivery is a turn of its own. What an actor measured while it was recorded is told beside them.

use std::collections::BTreeMap;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_runtime::{ActorId, Event, Runtime, Trace};

use super::source::{How, Seen, Source, Telling, observe};
use crate::failure::Failure;

/// Most turns kept of an actor: those at the end of a long replay.
const RING_TURNS_MAX: u64 = 1 << 18;

/// A delivery on its lane.
#[derive(Clone, Debug)]
pub struct Timed {
    /// What was delivered.
    pub seen: Seen,
    /// When its turn began, nanoseconds since the replay did.
    pub start_ns: u64,
    /// How long it took.
    pub duration_ns: u64,
    /// On which thread of the replay: 0 the main one.
    pub thread: u16,
    /// What the actor measured in it when it was recorded.
    pub measured_ns: Option<u64>,
}

impl Timed {
    /// When its turn ended.
    pub fn end_ns(&self) -> u64 {
        self.start_ns + self.duration_ns
    }

    /// What it takes: what was measured of it then, or else in the replay.
    pub fn cost_ns(&self) -> u64 {
        self.measured_ns.map_or(self.duration_ns, |then| then.max(1))
    }
}

/// Deliveries in the order of actor and number, and the causes among them.
#[derive(Clone, Debug, Default)]
pub struct Lanes {
    /// The deliveries.
    pub all: Vec<Timed>,
    /// From a delivery to one whose message was sent in it, by their places in `all`.
    pub causes: Vec<(usize, usize)>,
}

/// Turns to keep of each actor so that every delivery has its time.
pub fn ring_turns(trace: &Trace) -> usize {
    let most = (0..trace.header().nodes.len() as u32).map(|actor| trace.deliveries(ActorId(actor))).max();
    // Turns that found nothing to deliver lie between.
    (most.unwrap_or(0) * 2 + 1024).min(RING_TURNS_MAX) as usize
}

/// What each actor measured while it was recorded, by the delivery in which it did.
fn measured(trace: &Trace) -> BTreeMap<(ActorId, u64), u64> {
    let mut all = BTreeMap::new();
    for actor in (0..trace.header().nodes.len() as u32).map(ActorId) {
        for event in trace.events(actor) {
            if let Event::Measured { index, nanoseconds } = event {
                *all.entry((actor, index.saturating_sub(1))).or_default() += nanoseconds;
            }
        }
    }
    all
}

impl Lanes {
    /// Of a replay with one delivery a turn, whose turns are still in the rings.
    pub fn of(source: &Source, runtime: &Runtime, seen: &[Seen]) -> Self {
        let mut of_actor: Vec<Vec<&Seen>> = vec![Vec::new(); source.trace.header().nodes.len()];
        for s in seen {
            if let Some(list) = of_actor.get_mut(s.actor.0 as usize) {
                list.push(s);
            }
        }
        let then = measured(&source.trace);
        let (mut all, mut places) = (Vec::new(), BTreeMap::new());
        for (deliveries, (_, turns)) in of_actor.iter_mut().zip(runtime.turn_times()) {
            deliveries.sort_by_key(|s| s.index);
            let turns: Vec<_> = turns.into_iter().filter(|turn| turn.messages == 1).collect();
            // The ring may have lost the first ones.
            let kept = turns.len().min(deliveries.len());
            for (s, turn) in deliveries[deliveries.len() - kept..].iter().zip(&turns[turns.len() - kept..]) {
                places.insert((s.actor, s.index), all.len());
                all.push(Timed {
                    seen: (*s).clone(),
                    start_ns: turn.start_ns,
                    duration_ns: u64::from(turn.duration_ns),
                    thread: turn.thread,
                    measured_ns: then.get(&(s.actor, s.index)).copied(),
                });
            }
        }
        let cause = |(to, timed): (usize, &Timed)| Some((*places.get(&timed.seen.cause?)?, to));
        let causes = all.iter().enumerate().filter_map(cause).collect();
        Self { all, causes }
    }

    /// What was delivered from where `first` began until `last` was shown, from the last snapshot before that.
    ///
    /// # Errors
    /// If there are no such frames, or the replay diverges.
    pub fn of_frames(source: &Source, first: u32, last: u32, workers: usize) -> Result<Self, Failure> {
        let until = source.frame_shown(last)?;
        let (queue, telling) = (Arc::new(SegQueue::new()), Telling::Nothing);
        let how = How {
            threads: workers,
            until: Some(until),
            jump: true,
            frames_before: (last - first.min(last)) as usize + 1,
            observer: Some(observe(&queue, telling, |_| true)),
            turn: Some(1),
            ring_turns: Some(ring_turns(&source.trace)),
            ..How::default()
        };
        let (mut runtime, _) = source.run(how, |_| ())?;
        if let Some(divergence) = runtime.replay_report().divergence {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        runtime.positions();
        let seen: Vec<Seen> = std::iter::from_fn(|| queue.pop()).collect();
        let mut lanes = Self::of(source, &runtime, &seen);
        lanes.begin_at(source, first);
        Ok(lanes)
    }

    /// Leaves out what ended before a frame began.
    fn begin_at(&mut self, source: &Source, frame: u32) {
        let Some(began) = self.began(source, frame).map(|began| self.all[began].start_ns) else { return };
        let mut places = vec![None; self.all.len()];
        let mut kept = Vec::new();
        for (place, timed) in self.all.drain(..).enumerate() {
            if timed.end_ns() >= began {
                places[place] = Some(kept.len());
                kept.push(timed);
            }
        }
        self.all = kept;
        self.causes = std::mem::take(&mut self.causes)
            .into_iter()
            .filter_map(|(from, to)| Some((places[from]?, places[to]?)))
            .collect();
    }

    /// The delivery in which a frame began: the last such before it was shown.
    pub fn began(&self, source: &Source, frame: u32) -> Option<usize> {
        let shown = *source.shown_in.get(frame as usize)?;
        let renderer = source.renderer();
        self.all.iter().rposition(|timed| {
            let Seen { actor, index, kind, .. } = timed.seen;
            actor == renderer && index <= shown && kind == "FrameBegan"
        })
    }

    /// The delivery in which a frame was shown.
    pub fn shown(&self, source: &Source, frame: u32) -> Option<usize> {
        let shown = *source.shown_in.get(frame as usize)?;
        self.all.iter().position(|timed| timed.seen.actor == source.renderer() && timed.seen.index == shown)
    }
}
