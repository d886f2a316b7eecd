//! Two recordings side by side, at the same frame, with the first frame marked that differs.

use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::MARK_FRAME;
use foveal_runtime::{ActorId, Trace};

use super::beside::Beside;
use super::why_path::Segment;
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

    /// The first column of the right picture.
    fn right_begins(&self) -> u32 {
        self.left().size()[0] + GAP as u32
    }
}

impl Timeline for Pair {
    fn shown(&self) -> TimelineShown {
        let [left, right] = self.sides.each_ref().map(Timeline::shown);
        let mut lines = left.lines;
        lines.extend(right.lines.iter().map(|line| format!("right: {line}")));
        let mut story = left.story;
        story.extend(right.story.iter().map(|line| format!("right: {line}")));
        let mut path = left.path;
        path.extend(right.path.into_iter().map(|segment| Segment {
            ends: segment.ends.map(|[x, y]| [x + self.right_begins() as f32, y]),
            ..segment
        }));
        TimelineShown {
            lines,
            story,
            path,
            frames: left.frames.max(right.frames),
            parted: self.parted,
            ..left
        }
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
        match x.checked_sub(self.right_begins()) {
            Some(x) => self.sides[1].why(x, y),
            None => {
                let last = self.sides[0].size()[0].saturating_sub(1);
                self.sides[0].why(x.min(last), y);
            }
        }
    }

    fn find(&mut self, condition: &str) {
        self.sides[0].find(condition);
    }

    fn go_to_place(&mut self, place: &str) {
        // Up to where they part it is the same one; where one has no such place, it says so and stays.
        self.sides.iter_mut().for_each(|side| side.go_to_place(place));
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
        let [[_, left], [width, right]] = self.sides.each_ref().map(FrameSource::size);
        [self.right_begins() + width, left.max(right)]
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::source::Source;
    use super::*;
    use crate::recording::Elsewhere;

    fn side(name: &str, cache: &Path) -> Beside {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces").join(name);
        let elsewhere = Elsewhere { cache: Some(cache.to_owned()), ..Elsewhere::default() };
        Beside::new(Source::open(&path, &elsewhere, true, &()).expect("a walk"), 1).expect("a player")
    }

    fn wait(pair: &mut Pair) {
        while pair.is_busy() {
            std::thread::sleep(Duration::from_millis(1));
            pair.take_news();
        }
    }

    fn trace(name: &str) -> Trace {
        Trace::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces").join(name)).expect("a trace")
    }

    /// Whatever is done to one, the other shows the same moment; what is drawn over a picture is drawn over its own.
    #[test]
    fn both_sides_show_the_same_moment() {
        let folder = tempfile::tempdir().expect("a folder");
        let sides = || ["gallery.fvl"; 2].map(|name| side(name, folder.path()));
        let [left, right] = sides();
        let parted = first_other_frame(&trace("gallery.fvl"), &trace("gallery.fvl"));
        assert_eq!(parted, None, "one recording");
        let mut pair = Pair::new(left, right, parted);
        let frames = |pair: &Pair| pair.sides.each_ref().map(|side| Timeline::shown(side).frame);
        pair.go_to(4);
        wait(&mut pair);
        assert_eq!(frames(&pair), [Some(4); 2]);
        assert!(pair.next_frame());
        wait(&mut pair);
        assert_eq!(frames(&pair), [Some(5); 2]);
        pair.go_to_place("renderer:3");
        wait(&mut pair);
        // How far the others are by then differs from replay to replay.
        let at_place = |side: &Beside| Timeline::shown(side).position.starts_with("renderer 4,");
        assert!(pair.sides.iter().all(at_place));
        pair.go_to(5);
        wait(&mut pair);
        // A pixel and the same one of the other picture: the same path, on the other side.
        let [width, height] = pair.left().size();
        let begins = pair.right_begins();
        let path = |pair: &mut Pair, x: u32, y: u32| {
            pair.go_to(5);
            pair.why(x, y);
            wait(pair);
            Timeline::shown(pair).path
        };
        let pixels = (0..64).map(|i| [(i % 8) * width / 8, (i / 8) * height / 8]);
        let found = pixels.map(|[x, y]| ([x, y], path(&mut pair, x, y))).find(|(_, path)| !path.is_empty());
        let ([x, y], left) = found.expect("some pixel shows a sample");
        let right = path(&mut pair, begins + x, y);
        assert_eq!(left.len(), right.len());
        for (left, right) in left.iter().zip(&right) {
            for (left, right) in left.ends.iter().zip(&right.ends) {
                assert_eq!([left[0] + begins as f32, left[1]], *right);
            }
        }
        let picture = pair.picture().expect("a picture");
        assert_eq!(picture.width() as u32, begins + width);
        assert_eq!(picture.at(x as usize, y as usize), picture.at((begins + x) as usize, y as usize));
    }

    #[test]
    fn where_pictures_differ_is_known_from_the_marks() {
        let [gallery, table] = ["gallery.fvl", "table.fvl"].map(trace);
        assert_eq!(first_other_frame(&gallery, &table), Some(0));
    }
}
