//! Fingers on the picture: one looks around; two walk, to where both are dragged, and ahead as they part.

/// A place in the window, pixels to the right and down.
type At = (f64, f64);

/// What fingers ask for as one of them moves, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drag {
    /// To look around: so far to the right and down.
    Look([f64; 2]),
    /// To walk: so far to the right, up and ahead.
    Walk([f64; 3]),
}

/// Fingers on the picture, two at most, and where they are.
#[derive(Clone, Debug, Default)]
pub struct Fingers(Vec<(u64, At)>);

impl Fingers {
    /// Whether one more counts.
    pub fn have_room(&self) -> bool {
        self.0.len() < 2
    }

    /// One touches the picture; a third does not count.
    pub fn press(&mut self, finger: u64, at: At) {
        if self.have_room() {
            self.0.push((finger, at));
        }
    }

    /// One moves. Nothing is asked for by one that does not count.
    pub fn drag(&mut self, finger: u64, at: At) -> Option<Drag> {
        let apart = self.apart();
        let (_, place) = self.0.iter_mut().find(|(id, _)| *id == finger)?;
        let before = std::mem::replace(place, at);
        let (right, down) = (at.0 - before.0, at.1 - before.1);
        Some(match self.0.len() {
            1 => Drag::Look([right, down]),
            // Both fingers' way counts, half of it each. The scene follows them.
            _ => Drag::Walk([-0.5 * right, 0.5 * down, self.apart() - apart]),
        })
    }

    /// One is lifted.
    pub fn release(&mut self, finger: u64) {
        self.0.retain(|(id, _)| *id != finger);
    }

    /// How far two are apart, along the axis along which they are more so.
    fn apart(&self) -> f64 {
        match self.0[..] {
            [(_, a), (_, b)] => (a.0 - b.0).abs().max((a.1 - b.1).abs()),
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fingers at these places, by number.
    fn fingers(at: &[At]) -> Fingers {
        let mut fingers = Fingers::default();
        at.iter().zip(0..).for_each(|(at, finger)| fingers.press(finger, *at));
        fingers
    }

    #[test]
    fn one_finger_looks_around() {
        let mut one = fingers(&[(100.0, 100.0)]);
        assert_eq!(one.drag(0, (110.0, 95.0)), Some(Drag::Look([10.0, -5.0])));
        assert_eq!(one.drag(0, (110.0, 100.0)), Some(Drag::Look([0.0, 5.0])), "from where it is by now");
        assert_eq!(one.drag(7, (0.0, 0.0)), None, "it lies elsewhere");
        one.release(0);
        assert_eq!(one.drag(0, (0.0, 0.0)), None);
    }

    #[test]
    fn two_fingers_walk_and_ahead_as_they_part() {
        let mut two = fingers(&[(100.0, 100.0), (200.0, 100.0)]);
        // Dragged aside together, step by step: to the left and up, by what both went.
        assert_eq!(two.drag(1, (220.0, 110.0)), Some(Drag::Walk([-10.0, 5.0, 20.0])));
        assert_eq!(two.drag(0, (120.0, 110.0)), Some(Drag::Walk([-10.0, 5.0, -20.0])));
        // One goes away from the other: ahead; and comes back.
        assert_eq!(two.drag(1, (250.0, 110.0)), Some(Drag::Walk([-15.0, 0.0, 30.0])));
        assert_eq!(two.drag(1, (220.0, 110.0)), Some(Drag::Walk([15.0, 0.0, -30.0])));
    }

    #[test]
    fn spreading_evenly_walks_straight_ahead() {
        let mut two = fingers(&[(100.0, 100.0), (100.0, 200.0)]);
        let mut sum = [0.0; 3];
        for (finger, at) in [(0, (100.0, 80.0)), (1, (100.0, 220.0))] {
            let Some(Drag::Walk(way)) = two.drag(finger, at) else { panic!("two fingers walk") };
            sum.iter_mut().zip(way).for_each(|(sum, way)| *sum += way);
        }
        assert_eq!(sum, [0.0, 0.0, 40.0]);
    }

    #[test]
    fn a_third_finger_does_not_count_and_the_last_one_looks_on() {
        let mut fingers = fingers(&[(0.0, 0.0), (50.0, 0.0), (90.0, 90.0)]);
        assert!(!fingers.have_room());
        assert_eq!(fingers.drag(2, (95.0, 90.0)), None);
        fingers.release(0);
        assert!(fingers.have_room());
        assert_eq!(fingers.drag(1, (53.0, 4.0)), Some(Drag::Look([3.0, 4.0])), "without a jump");
    }
}
