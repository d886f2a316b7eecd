//! Stepping through a recording in both directions, one delivery at a time.
//!
//! A step makes the next delivery of the actor that has the least of its recording behind it, so steps come about as
//! they came when it was recorded, in the same order wherever one begins. A step back builds the system again at the
//! snapshot before and replays up to the cut that is asked for.

use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use crossbeam_queue::SegQueue;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::Renderer;
use foveal_actors::wiring::Actors;
use foveal_runtime::{ActorId, Content, Delivery, Observer, Runtime, Snapshot, Until};
use serde_json::json;

use super::source::{How, Seen, Source, Telling};
use super::when::{self, Condition};
use super::why;
use super::why_path::Segment;
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
    sink: Arc<Sink>,
    stretches: Vec<Stretch>,
}

/// Where deliveries are told to.
struct Sink {
    seen: SegQueue<Seen>,
    telling: Telling,
    /// Whether anybody reads what they say: not on the way to a place.
    is_read: AtomicBool,
}

impl Sink {
    fn observer(self: &Arc<Self>) -> Observer {
        let sink = Arc::clone(self);
        Arc::new(move |d: &Delivery<'_>| {
            let telling = if sink.is_read.load(Relaxed) { sink.telling } else { Telling::Nothing };
            sink.seen.push(Seen::of(d, telling));
        })
    }
}

impl Stepper {
    /// At the start of a recording. Says of each step forward what the message says, and what it changes.
    pub fn new(source: Rc<Source>, workers: usize, telling: Telling) -> Result<Self, Failure> {
        let sink = Arc::new(Sink { seen: SegQueue::new(), telling, is_read: AtomicBool::new(false) });
        let (runtime, actors) = build(&source, &sink, None)?;
        let stretches = vec![Stretch { from: None, steps: Vec::new() }];
        Ok(Self { source, told: Vec::new(), workers, runtime, actors, sink, stretches })
    }

    /// Says something.
    fn tell(&mut self, text: impl Into<String>) {
        let text = text.into();
        self.told.push(match self.sink.telling {
            Telling::Json => json!({"note": text}).to_string(),
            _ => text,
        });
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
        let Some(seen) = stepped.and_then(|_| self.sink.seen.pop()) else { return Ok(None) };
        if let Some(stretch) = self.stretches.last_mut() {
            // What it says would take much more room than that it came.
            stretch.steps.push(Seen { told: None, ..seen.clone() });
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
            // Whose turn it is shows in the step alone.
            let before = self.states();
            self.sink.is_read.store(true, Relaxed);
            let stepped = self.step();
            self.sink.is_read.store(false, Relaxed);
            let Some(seen) = stepped? else {
                self.tell("the end of the recording");
                break;
            };
            self.tell_step(&seen, before);
            if interrupted() {
                break;
            }
        }
        Ok(())
    }

    /// The states of all actors, where they are told.
    fn states(&self) -> Vec<Content> {
        if self.sink.telling == Telling::Nothing {
            return Vec::new();
        }
        let nodes = 0..self.source.trace.header().nodes.len() as u32;
        nodes.map(|number| self.runtime.content(ActorId(number)).unwrap_or_default()).collect()
    }

    /// Says what was delivered, and what that changed in its receiver.
    fn tell_step(&mut self, seen: &Seen, before: Vec<Content>) {
        let before = before.into_iter().nth(seen.actor.0 as usize).unwrap_or_default();
        let changes = before.differences(&self.runtime.content(seen.actor).unwrap_or_default());
        match self.sink.telling {
            Telling::Nothing => self.tell(self.source.line(seen)),
            Telling::Text => {
                self.tell(self.source.line(seen));
                self.told.extend(seen.told.iter().map(|told| format!("    {told}")));
                let lines = changes.iter().map(|c| format!("    {}: {} → {}", c.path, c.left, c.right));
                self.told.extend(lines);
            }
            Telling::Json => {
                let mut document = self.source.document(seen);
                let changes = changes.iter().map(|c| json!({"path": c.path, "from": c.left, "to": c.right}));
                document["changes"] = changes.collect();
                self.told.push(document.to_string());
            }
        }
    }

    /// What an actor's state says here; all of it, or what stands at a path.
    ///
    /// # Errors
    /// If there is no such actor, or nothing stands there.
    pub fn state(&self, name: &str) -> Result<Content, Failure> {
        let (actor, path) = match self.source.actor(name) {
            Ok(actor) => (actor, ""),
            Err(e) => {
                let (name, path) = name.split_once('.').ok_or(e)?;
                (self.source.actor(name)?, path)
            }
        };
        let content = self.runtime.content(actor).unwrap_or_default();
        content
            .at(path)
            .cloned()
            .ok_or_else(|| Failure::Usage(format!("nothing stands at {path} of {}", self.source.name(actor))))
    }

    /// Goes to where a condition comes to hold next, after where this is.
    ///
    /// # Errors
    /// If the condition names what is not there, or the replay diverges.
    pub fn go_when(&mut self, condition: &Condition) -> Result<(), Failure> {
        let cut = self.cut();
        let met = when::when(&self.source, condition, self.workers)?;
        let Some(next) = met.into_iter().find(|met| met.at.1 >= cut[met.at.0.0 as usize]) else {
            self.tell("it does not come about any more");
            return Ok(());
        };
        let (actor, index) = next.at;
        self.go(Some(Until::Delivery { actor, index }))?;
        self.tell(format!("{}: {next}", self.source.at(next.at)));
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
        (self.runtime, self.actors) = build(&self.source, &self.sink, from)?;
        let reached = self.runtime.run_to(&cut);
        self.diverged()?;
        while self.sink.seen.pop().is_some() {}
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
        let (mut runtime, actors) = build(&self.source, &self.sink, kept)?;
        let mut from = None;
        if let Some(index) = before {
            runtime.run_within(cut, Some(Until::Delivery { actor: renderer, index }));
            while self.sink.seen.pop().is_some() {}
            from = runtime.snapshot().map(Arc::new);
            if from.is_none() {
                (runtime, _) = build(&self.source, &self.sink, None)?;
            }
        }
        let mut steps = Vec::new();
        while runtime.step(Some(cut)).is_some() && !runtime.diverged() && !interrupted() {
            steps.extend(self.sink.seen.pop());
        }
        (self.runtime, self.actors) = (runtime, actors);
        self.diverged()?;
        self.stretches = vec![Stretch { from, steps }];
        Ok(())
    }

    /// Goes to a place, or to the end.
    pub fn go(&mut self, place: Option<Until>) -> Result<(), Failure> {
        if self.goes_back_to(place) {
            self.tell(self.positions());
            return Ok(());
        }
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
                (self.runtime, self.actors) = build(&self.source, &self.sink, from.clone())?;
                self.stretches.push(Stretch { from, steps: Vec::new() });
            }
            // What is on its way cannot be saved: step there.
            None => {
                (self.runtime, self.actors) = build(&self.source, &self.sink, None)?;
                let mut steps = Vec::new();
                while self.runtime.step(Some(&cut)).is_some() && !interrupted() {
                    steps.extend(self.sink.seen.pop());
                }
                self.diverged()?;
                self.stretches.push(Stretch { from: None, steps });
            }
        }
        self.tell(self.positions());
        Ok(())
    }

    /// Goes to where one looked before, whose snapshot is kept: nothing runs. Returns whether it is.
    fn goes_back_to(&mut self, place: Option<Until>) -> bool {
        let Some(Until::Delivery { actor, index }) = place else { return false };
        let Some(from) = self.source.index().right_after(actor, index).map(Arc::new) else { return false };
        let Ok((runtime, actors)) = build(&self.source, &self.sink, Some(from.clone())) else { return false };
        (self.runtime, self.actors) = (runtime, actors);
        self.stretches = vec![Stretch { from: Some(from), steps: Vec::new() }];
        true
    }

    /// Why a pixel of the last shown frame looks as it does, and the path of its sample over the picture.
    ///
    /// # Errors
    /// If no frame is shown yet, there is no such pixel, or the replay diverges.
    pub fn why(&self, pixel: (u32, u32)) -> Result<(Vec<String>, Vec<Segment>), Failure> {
        match self.frame() {
            None => Err(Failure::Usage("no frame is shown yet".into())),
            frame => why::story(&self.source, pixel, frame, self.workers),
        }
    }
}

fn build(
    source: &Source,
    sink: &Arc<Sink>,
    from: Option<Arc<Snapshot>>,
) -> Result<(Runtime, Actors), Failure> {
    let observer = Some(sink.observer());
    source.system(How { from, observer, ..How::default() })
}
