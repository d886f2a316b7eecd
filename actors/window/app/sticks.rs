//! Sticks and triggers of a gamepad as ways of a walk.

/// Sticks nearer to their middle rest there: worn ones do not come back to it.
const DEAD: f32 = 0.15;
/// What a stick pushed to its end turns by, dragged pixels of the mouse in a second.
const TURN: f32 = 600.0;

/// Where sticks and triggers are: 0 at rest, 1 to the right, upwards and pressed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sticks {
    /// Right and upwards; it walks.
    pub left: [f32; 2],
    /// Right and upwards; it looks around.
    pub right: [f32; 2],
    /// The right trigger's without the left one's.
    pub up: f32,
}

impl Sticks {
    /// Whether all rest.
    pub fn rest(&self) -> bool {
        eased(self.left) == [0.0; 2] && eased(self.right) == [0.0; 2] && eased([self.up, 0.0])[0] == 0.0
    }

    /// Right, up and ahead, as shares of the speed of a walk; and how the view turns, dragged pixels to the right and down in
    /// a second.
    pub fn motion(&self) -> ([f32; 3], [f32; 2]) {
        let [aside, ahead] = eased(self.left);
        let [right, up] = eased(self.right);
        ([aside, eased([self.up, 0.0])[0], ahead], [TURN * right, -TURN * up])
    }
}

/// A stick's place with a dead middle, from which it goes evenly to 1 in every direction, and finely at first: squared.
/// What is not a number rests.
fn eased([x, y]: [f32; 2]) -> [f32; 2] {
    let length = x.hypot(y);
    if length.is_nan() || length <= DEAD {
        return [0.0; 2];
    }
    let share = ((length.min(1.0) - DEAD) / (1.0 - DEAD)).powi(2);
    [x / length * share, y / length * share]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sticks_rest_in_the_middle_and_reach_one_in_every_direction() {
        for rest in [[0.0, 0.0], [0.1, -0.1], [f32::NAN, 1.0], [0.0, f32::NAN]] {
            assert_eq!(eased(rest), [0.0; 2], "{rest:?}");
        }
        for i in 0..16 {
            let (y, x) = (i as f32 * std::f32::consts::TAU / 16.0).sin_cos();
            let [ex, ey] = eased([1.2 * x, 1.2 * y]);
            assert!((ex - x).abs() < 1e-5 && (ey - y).abs() < 1e-5, "{i}");
        }
        let half = eased([0.0, 0.5])[1];
        assert!(half > 0.1 && half < 0.25, "finely at first: {half}");
    }

    #[test]
    fn the_left_stick_walks_the_right_one_looks_and_triggers_go_up_and_down() {
        let ahead = Sticks { left: [0.0, 1.0], ..Sticks::default() };
        assert_eq!(ahead.motion(), ([0.0, 0.0, 1.0], [0.0, 0.0]));
        let up_and_left = Sticks { right: [-1.0, 0.0], up: 1.0, ..Sticks::default() };
        assert_eq!(up_and_left.motion(), ([0.0, 1.0, 0.0], [-TURN, 0.0]));
        let above = Sticks { right: [0.0, 1.0], ..Sticks::default() };
        assert!(above.motion().1[1] < 0.0, "what is dragged up shows what is above");
        assert!(!ahead.rest() && Sticks::default().rest());
    }
}
