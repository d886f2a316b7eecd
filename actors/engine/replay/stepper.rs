//! Stepping through a recording in both directions, one delivery at a time.
//!
//! A step makes the next delivery of the actor that has the least of its recording behind it, so steps come about as
//! they came when it was recorded, in the same order wherever one begins. A step back builds the system again at the
//! snapshot before and replays up to the cut that is asked for.

use std::rc::Rc;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::Renderer;
use foveal_actors::wiring::Actors;
use foveal_runtime::{Runtime, Snapshot, Until};

use super::source::{How, Seen, Source, observe};
use super::why;
use crate::failure::Failure;
use crate::interrupt::interrupted;

/// Steps between two snapshots of a session: what a step back has to make again at most.
const STEPS_MAX: usize = 128;
/// Frames before a place at which steps back begin, where it was jumped to.
const FRAMES_BEFORE: usize = 2;

/// A stretch of steps and where it begins.
struct Stretch {
    /// `None` at the start of the recording.
    from: Option<Arc<Snapshot>>,
    steps: Vec<Seen>,
}

/// A replay that is stepped through.
pub struct Stepper {
    source: Rc<Source>,
    /// What was done, in lines that nobody has fetched yet.
    told: Vec<String>,
    workers: usize,
    runtime: Runtime,
    actors: Actors,
    seen: Arc<SegQueue<Seen>>,
    stretches: Vec<Stretch>,
}

impl Stepper {
    /// At the start of a recording.
    pub fn new(source: Rc<Source>, workers: usize) -> Result<Self, Failure> {
        let seen = Arc::new(SegQueue::new());
        let (runtime, actors) = build(&source, &seen, None)?;
        let stretches = vec![Stretch { from: None, steps: Vec::new() }];
        Ok(Self { source, told: Vec::new(), workers, runtime, actors, seen, stretches })
    }

    /// Says something.
    fn tell(&mut self, text: impl Into<String>) {
        self.told.push(text.into());
    }

    /// What was said since the last call.
    pub fn told(&mut self) -> Vec<String> {
        std::mem::take(&mut self.told)
    }

    /// Looks at the renderer.
    pub fn look<R>(&self, look: impl FnOnce(&Renderer) -> R) -> Option<R> {
        self.runtime.inspect(self.actors.renderer, look)
    }

    /// What the allocator thinks.
    pub fn insight(&self) -> Option<Insight> {
        let allocator = self.actors.correction.as_ref()?.allocator;
        self.runtime.inspect(allocator, |allocator| allocator.insight())
    }

    /// The runtime, to look at.
    pub fn runtime(&self) -> &Runtime {
        &self.runtime
    }

    fn cut(&self) -> Vec<u64> {
        self.runtime.positions().into_iter().map(|(deliveries, _)| deliveries).collect()
    }

    /// The last delivery that was made.
    pub fn here(&self) -> String {
        let last = self.stretches.iter().rev().find_map(|s| s.steps.last());
        last.map_or_else(|| "start".to_owned(), |s| self.source.at((s.actor, s.index)))
    }

    /// The last frame that was shown.
    pub fn frame(&self) -> Option<u32> {
        self.runtime.inspect(self.actors.renderer, |r| r.shown().map(|s| s.index.0)).flatten()
    }

    /// Deliveries made to each actor, in a line.
    pub fn positions(&self) -> String {
        let nodes = &self.source.trace.header().nodes;
        let actors = nodes.iter().zip(self.cut()).filter(|(node, _)| node.class.is_some());
        let made = actors.map(|(node, made)| format!("{} {made}", node.name));
        let frame = self.frame().map_or_else(|| "no frame shown".into(), |f| format!("frame {f} shown"));
        made.chain([frame]).collect::<Vec<_>>().join(", ")
    }

    fn diverged(&mut self) -> Result<(), Failure> {
        if !self.runtime.diverged() {
            return Ok(());
        }
        let divergence = self.runtime.replay_report().divergence;
        let told = divergence.map_or_else(String::new, |d| d.to_string());
        Err(Failure::Check(format!("the replay diverges: {told}")))
    }

    /// Makes one delivery.
    fn step(&mut self) -> Result<Option<Seen>, Failure> {
        let stepped = self.runtime.step(None);
        self.diverged()?;
        let Some(seen) = stepped.and_then(|_| self.seen.pop()) else { return Ok(None) };
        if let Some(stretch) = self.stretches.last_mut() {
            stretch.steps.push(seen.clone());
            if stretch.steps.len() >= STEPS_MAX
                && let Some(snapshot) = self.runtime.snapshot()
            {
                self.stretches.push(Stretch { from: Some(Arc::new(snapshot)), steps: Vec::new() });
            }
        }
        Ok(Some(seen))
    }

    /// Makes deliveries and says which.
    pub fn forward(&mut self, count: u64) -> Result<(), Failure> {
        for _ in 0..count {
            let Some(seen) = self.step()? else {
                self.tell("the end of the recording");
                break;
            };
            self.tell(self.source.line(&seen));
            if interrupted() {
                break;
            }
        }
        Ok(())
    }

    /// Makes deliveries until the next frame is shown.
    pub fn next_frame(&mut self) -> Result<(), Failure> {
        let before = self.frame();
        while self.frame() == before {
            if self.step()?.is_none() || interrupted() {
                self.tell("the end of the recording");
                return Ok(());
            }
        }
        self.tell(self.positions());
        Ok(())
    }

    /// Takes deliveries back and says which, the last one first.
    pub fn back(&mut self, steps: u64) -> Result<(), Failure> {
        let mut cut = self.cut();
        let mut undone = 0;
        while undone < steps {
            let count = self.stretches.len();
            let Some(stretch) = self.stretches.last_mut() else { break };
            if let Some(seen) = stretch.steps.pop() {
                self.tell(format!("back over {}", self.source.line(&seen)));
                cut[seen.actor.0 as usize] -= 1;
                undone += 1;
            } else if count > 1 {
                self.stretches.pop();
            } else if stretch.from.is_some() {
                self.reach_back(&cut)?;
            } else {
                self.tell("the start of the recording");
                break;
            }
        }
        let from = self.stretches.last().and_then(|s| s.from.clone());
        (self.runtime, self.actors) = build(&self.source, &self.seen, from)?;
        let reached = self.runtime.run_to(&cut);
        self.diverged()?;
        while self.seen.pop().is_some() {}
        if reached {
            Ok(())
        } else {
            Err(Failure::Check("the replay does not come back to where it was".into()))
        }
    }

    /// Finds the steps that lead to a cut which was jumped to: from some frames before, or from the start.
    fn reach_back(&mut self, cut: &[u64]) -> Result<(), Failure> {
        let shown = &self.source.shown_in;
        let renderer = self.source.renderer();
        let behind = shown.partition_point(|index| *index < cut[renderer.0 as usize]);
        let before = behind.checked_sub(FRAMES_BEFORE + 1).map(|frame| shown[frame]);
        // One may be kept that is close enough.
        let kept = before.and_then(|index| self.source.kept(renderer, index, cut));
        let (mut runtime, actors) = build(&self.source, &self.seen, kept)?;
        let mut from = None;
        if let Some(index) = before {
            runtime.run_within(cut, Some(Until::Delivery { actor: renderer, index }));
            while self.seen.pop().is_some() {}
            from = runtime.snapshot().map(Arc::new);
            if from.is_none() {
                (runtime, _) = build(&self.source, &self.seen, None)?;
            }
        }
        let mut steps = Vec::new();
        while runtime.step(Some(cut)).is_some() && !runtime.diverged() && !interrupted() {
            steps.extend(self.seen.pop());
        }
        (self.runtime, self.actors) = (runtime, actors);
        self.diverged()?;
        self.stretches = vec![Stretch { from, steps }];
        Ok(())
    }

    /// Goes to a place, or to the end.
    pub fn go(&mut self, place: Option<Until>) -> Result<(), Failure> {
        let how = How { threads: self.workers, until: place, jump: true, ..How::default() };
        let (mut fast, _) = self.source.run(how, |_| ())?;
        let report = fast.replay_report();
        if let Some(divergence) = report.divergence {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        let cut: Vec<u64> = fast.positions().into_iter().map(|(deliveries, _)| deliveries).collect();
        self.stretches.clear();
        match fast.snapshot() {
            Some(snapshot) => {
                let from = Some(Arc::new(snapshot));
                (self.runtime, self.actors) = build(&self.source, &self.seen, from.clone())?;
                self.stretches.push(Stretch { from, steps: Vec::new() });
            }
            // What is on its way cannot be saved: step there.
            None => {
                (self.runtime, self.actors) = build(&self.source, &self.seen, None)?;
                let mut steps = Vec::new();
                while self.runtime.step(Some(&cut)).is_some() && !interrupted() {
                    steps.extend(self.seen.pop());
                }
                self.diverged()?;
                self.stretches.push(Stretch { from: None, steps });
            }
        }
        self.tell(self.positions());
        Ok(())
    }

    /// Why a pixel of the last shown frame looks as it does.
    ///
    /// # Errors
    /// If no frame is shown yet, there is no such pixel, or the replay diverges.
    pub fn why(&self, pixel: (u32, u32)) -> Result<Vec<String>, Failure> {
        match self.frame() {
            None => Err(Failure::Usage("no frame is shown yet".into())),
            frame => why::story(&self.source, pixel, frame, self.workers),
        }
    }
}

fn build(
    source: &Source,
    seen: &Arc<SegQueue<Seen>>,
    from: Option<Arc<Snapshot>>,
) -> Result<(Runtime, Actors), Failure> {
    let observer = Some(observe(seen, |_| true));
    source.system(How { from, observer, ..How::default() })
}
