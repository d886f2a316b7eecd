//! Two recordings side by side, at the same frame, with the first frame marked that differs.

use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::MARK_FRAME;
use foveal_runtime::{ActorId, Trace};

use super::beside::Beside;
use crate::engine::Event;
use crate::source::{Branch, Controls, FrameSource, Names, Place, Ranges, Status, Timeline, TimelineShown};

/// Columns between the pictures.
const GAP: usize = 4;
const GAP_COLOR: [u8; 3] = [40, 40, 40];

/// Two recordings that are looked at together.
pub struct Pair {
    sides: [Beside; 2],
    /// The first frame whose pictures differ, or that one of them does not have.
    parted: Option<u32>,
}

/// The first frame that two recordings show differently.
pub fn first_other_frame(left: &Trace, right: &Trace) -> Option<u32> {
    let frames = |trace: &Trace| -> Vec<u64> {
        let renderer = trace.find("renderer").unwrap_or(ActorId(0));
        trace.marks(renderer).filter(|(_, kind, _)| *kind == MARK_FRAME).map(|(.., hash)| hash).collect()
    };
    let (left, right) = (frames(left), frames(right));
    let same = left.iter().zip(&right).take_while(|(a, b)| a == b).count();
    (same < left.len().max(right.len())).then_some(same as u32)
}

impl Pair {
    /// Of two recordings that part at a frame, as [`first_other_frame`] says.
    pub fn new(left: Beside, right: Beside, parted: Option<u32>) -> Self {
        Self { sides: [left, right], parted }
    }

    fn left(&self) -> &Beside {
        &self.sides[0]
    }
}

impl Timeline for Pair {
    fn shown(&self) -> TimelineShown {
        let [left, right] = self.sides.each_ref().map(Timeline::shown);
        let mut lines = left.lines;
        lines.extend(right.lines.iter().map(|line| format!("right: {line}")));
        let mut story = left.story;
        story.extend(right.story.iter().map(|line| format!("right: {line}")));
        TimelineShown { lines, story, frames: left.frames.max(right.frames), parted: self.parted, ..left }
    }

    fn go_to(&mut self, frame: u32) {
        for side in &mut self.sides {
            let last = Timeline::shown(side).frames.saturating_sub(1);
            side.go_to(frame.min(last));
        }
    }

    fn next_frame(&mut self) -> bool {
        // Neither goes ahead of the other.
        if self.is_busy() {
            return true;
        }
        let [left, right] = &mut self.sides;
        left.next_frame() | right.next_frame()
    }

    fn step(&mut self, messages: i64) {
        self.sides[0].step(messages);
    }

    fn why(&mut self, x: u32, y: u32) {
        let width = self.sides[0].size()[0];
        match x.checked_sub(width + GAP as u32) {
            Some(x) => self.sides[1].why(x, y),
            None => self.sides[0].why(x.min(width - 1), y),
        }
    }

    fn find(&mut self, condition: &str) {
        self.sides[0].find(condition);
    }

    fn go_to_place(&mut self, place: &str) {
        self.sides[0].go_to_place(place);
    }

    fn tell_state(&mut self, actor: &str) {
        self.sides[0].tell_state(actor);
    }

    fn show_lanes(&mut self, shows: bool) {
        self.sides[0].show_lanes(shows);
    }

    fn branch(&mut self) -> Result<Branch, String> {
        self.sides[0].branch()
    }
}

impl FrameSource for Pair {
    fn place(&self) -> Place {
        self.left().place()
    }

    fn size(&self) -> [u32; 2] {
        let [[a, b], [c, d]] = self.sides.each_ref().map(FrameSource::size);
        [a + GAP as u32 + c, b.max(d)]
    }

    fn controls(&self) -> Controls {
        self.left().controls()
    }

    fn ranges(&self) -> Ranges {
        self.left().ranges()
    }

    fn insight(&self) -> Option<(&Insight, &Names)> {
        self.left().insight()
    }

    fn set_controls(&mut self, controls: &Controls) {
        self.sides.iter_mut().for_each(|side| side.set_controls(controls));
    }

    fn begin_frame(&mut self, _camera: &Camera) {}

    fn work(&mut self, _time: Duration) {}

    fn end_frame(&mut self) -> Vec<Event> {
        Vec::new()
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        let [left, right] = self.sides.each_mut().map(FrameSource::picture);
        let (left, right) = (left?, right?);
        let (begin, height) = (left.width() + GAP, left.height().max(right.height()));
        let pixel = |picture: &Map2d<[u8; 3]>, x: usize, y: usize| match y < picture.height() {
            true => picture.at(x, y),
            false => GAP_COLOR,
        };
        Some(Map2d::from_fn(begin + right.width(), height, |x, y| match x {
            x if x < left.width() => pixel(&left, x, y),
            x if x < begin => GAP_COLOR,
            x => pixel(&right, x - begin, y),
        }))
    }

    fn quality(&mut self) -> f32 {
        self.sides[0].quality()
    }

    fn is_done(&self) -> bool {
        true
    }

    fn is_busy(&self) -> bool {
        self.sides.iter().any(FrameSource::is_busy)
    }

    fn take_news(&mut self) -> bool {
        let [left, right] = &mut self.sides;
        left.take_news() | right.take_news()
    }

    fn ended(&self) -> Option<String> {
        self.sides.iter().find_map(FrameSource::ended)
    }

    fn status(&self) -> Status {
        self.left().status()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.left().facts()
    }

    fn timeline(&self) -> Option<&dyn Timeline> {
        Some(self)
    }

    fn timeline_mut(&mut self) -> Option<&mut dyn Timeline> {
        Some(self)
    }
}
