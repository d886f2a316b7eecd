//! Walking: keys and mouse become a camera, by time.
//!
//! The pose depends on the times of the input events only, never on when frames are drawn: between two
//! events it moves with constant velocity, and is advanced at events alone.

use foveal::scene::Camera;
use glam::Vec3;

/// A direction to walk in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Along the view.
    Forward,
    /// Against it.
    Backward,
    /// To the left.
    Left,
    /// To the right.
    Right,
    /// Along the scene's up.
    Up,
    /// Against it.
    Down,
}

/// How fast, beside the wheel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Four times as fast (Shift).
    Fast,
    /// A quarter as fast (Ctrl).
    Slow,
    /// As the wheel says.
    Normal,
}

/// Scale of the speed per step of the wheel.
const WHEEL: f32 = 1.2;
/// Radians per pixel of dragging.
const LOOK: f32 = 0.004;
/// The steepest view, radians: looking straight along `up` has no heading.
const PITCH_MAX: f32 = 1.55;

/// Whoever walks.
#[derive(Clone, Debug)]
pub struct Navigator {
    eye: Vec3,
    yaw: f32,
    pitch: f32,
    /// Distance of the point that orbiting turns about.
    distance: f32,
    fov_y: f32,
    /// Right-handed axes: heading at yaw 0, left of it, up.
    axes: [Vec3; 3],
    /// Scene units per second.
    speed: f32,
    pace: Pace,
    held: Vec<Motion>,
    orbits: bool,
    /// Time of the last event, seconds.
    at: f64,
    /// The camera as given, as long as nothing has moved: no rounding by angles.
    exact: Option<Camera>,
}

impl Navigator {
    /// Stands at `camera` in a scene with this up axis and diagonal.
    pub fn new(camera: &Camera, up: Vec3, diagonal: f32, now: f64) -> Self {
        let up = up.normalize_or(Vec3::Y);
        let ahead = up.any_orthonormal_vector();
        let mut navigator = Self {
            eye: Vec3::ZERO,
            yaw: 0.0,
            pitch: 0.0,
            distance: 1.0,
            fov_y: 1.0,
            axes: [ahead, up.cross(ahead), up],
            speed: diagonal * 0.125,
            pace: Pace::Normal,
            held: Vec::new(),
            orbits: false,
            at: now,
            exact: None,
        };
        navigator.set_camera(camera, now);
        navigator
    }

    /// Jumps to `camera`.
    pub fn set_camera(&mut self, camera: &Camera, now: f64) {
        self.advance(now);
        let view = camera.target - camera.eye;
        self.distance = view.length().max(1e-6);
        let d = view / self.distance;
        self.eye = camera.eye;
        self.pitch = d.dot(self.axes[2]).clamp(-1.0, 1.0).asin().clamp(-PITCH_MAX, PITCH_MAX);
        self.yaw = d.dot(self.axes[1]).atan2(d.dot(self.axes[0]));
        self.fov_y = camera.fov_y;
        self.exact = Some(*camera);
    }

    /// The camera at `now`, which may be later than the last event.
    pub fn camera(&self, now: f64) -> Camera {
        let eye = self.eye_at(now);
        match self.exact {
            Some(camera) if eye == self.eye => camera,
            _ => {
                let target = eye + self.forward() * self.distance;
                Camera { eye, target, up: self.axes[2], fov_y: self.fov_y }
            }
        }
    }

    /// Whether the camera moves without further input.
    pub fn is_moving(&self) -> bool {
        self.velocity() != Vec3::ZERO
    }

    /// Speed with the pace, scene units per second.
    pub fn speed(&self) -> f32 {
        self.speed
            * match self.pace {
                Pace::Fast => 4.0,
                Pace::Slow => 0.25,
                Pace::Normal => 1.0,
            }
    }

    /// Whether dragging turns about the point in the middle instead of the eye.
    pub fn orbits(&self) -> bool {
        self.orbits
    }

    /// Switches orbiting.
    pub fn set_orbits(&mut self, orbits: bool) {
        self.orbits = orbits;
    }

    /// A key of motion went down.
    pub fn press(&mut self, motion: Motion, now: f64) {
        self.advance(now);
        if !self.held.contains(&motion) {
            self.held.push(motion);
        }
    }

    /// A key of motion went up.
    pub fn release(&mut self, motion: Motion, now: f64) {
        self.advance(now);
        self.held.retain(|m| *m != motion);
    }

    /// All keys went up: the window lost the keyboard.
    pub fn release_all(&mut self, now: f64) {
        self.advance(now);
        self.held.clear();
        self.pace = Pace::Normal;
    }

    /// Shift or Ctrl changed.
    pub fn set_pace(&mut self, pace: Pace, now: f64) {
        if pace != self.pace {
            self.advance(now);
            self.pace = pace;
        }
    }

    /// The wheel turned by so many steps, up is positive.
    pub fn wheel(&mut self, steps: f32, now: f64) {
        self.advance(now);
        if steps.is_finite() {
            self.speed = (self.speed * WHEEL.powf(steps.clamp(-20.0, 20.0))).clamp(1e-6, 1e9);
        }
    }

    /// The mouse was dragged by so many pixels, right and down are positive.
    pub fn look(&mut self, dx: f32, dy: f32, now: f64) {
        self.advance(now);
        if !(dx.is_finite() && dy.is_finite()) || (dx == 0.0 && dy == 0.0) {
            return;
        }
        self.exact = None;
        let center = self.eye + self.forward() * self.distance;
        self.yaw -= dx * LOOK;
        self.pitch = (self.pitch - dy * LOOK).clamp(-PITCH_MAX, PITCH_MAX);
        if self.orbits {
            self.eye = center - self.forward() * self.distance;
        }
    }

    fn forward(&self) -> Vec3 {
        let [ahead, left, up] = self.axes;
        (ahead * self.yaw.cos() + left * self.yaw.sin()) * self.pitch.cos() + up * self.pitch.sin()
    }

    fn velocity(&self) -> Vec3 {
        let forward = self.forward();
        let right = forward.cross(self.axes[2]).normalize_or_zero();
        let sum: Vec3 = self
            .held
            .iter()
            .map(|motion| match motion {
                Motion::Forward => forward,
                Motion::Backward => -forward,
                Motion::Left => -right,
                Motion::Right => right,
                Motion::Up => self.axes[2],
                Motion::Down => -self.axes[2],
            })
            .sum();
        // Opposite keys cancel exactly or all but exactly.
        if sum.length_squared() < 1e-6 { Vec3::ZERO } else { sum.normalize() * self.speed() }
    }

    fn eye_at(&self, now: f64) -> Vec3 {
        let seconds = (now - self.at).max(0.0);
        (self.eye.as_dvec3() + self.velocity().as_dvec3() * seconds).as_vec3()
    }

    fn advance(&mut self, now: f64) {
        let eye = self.eye_at(now);
        if eye != self.eye {
            self.eye = eye;
            self.exact = None;
        }
        self.at = self.at.max(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start() -> Navigator {
        let camera = Camera {
            eye: Vec3::new(0.0, 1.6, 3.0),
            target: Vec3::new(0.0, 1.2, 0.0),
            up: Vec3::Y,
            fov_y: 0.8,
        };
        Navigator::new(&camera, Vec3::Y, 8.0, 0.0)
    }

    #[test]
    fn a_camera_that_was_given_comes_back_bit_for_bit() {
        let mut n = start();
        let camera = n.camera(5.0);
        assert_eq!(camera.target, Vec3::new(0.0, 1.2, 0.0));
        n.look(0.0, 0.0, 6.0);
        n.press(Motion::Forward, 7.0);
        n.press(Motion::Backward, 7.0);
        assert!(!n.is_moving());
        assert_eq!(n.camera(8.0), camera);
        n.look(3.0, 1.0, 9.0);
        assert_ne!(n.camera(9.0), camera);
    }

    #[test]
    fn the_way_depends_on_the_times_of_events_not_on_frames() {
        let walk = |frames: &[f64]| {
            let mut n = start();
            n.press(Motion::Forward, 1.0);
            for t in frames {
                let _ = n.camera(*t);
            }
            n.press(Motion::Right, 1.37);
            n.set_pace(Pace::Fast, 1.5);
            n.look(40.0, -10.0, 1.8);
            n.release(Motion::Forward, 2.0);
            n.camera(2.5)
        };
        assert_eq!(walk(&[]), walk(&[1.01, 1.1, 1.2, 1.3]));
    }

    #[test]
    fn keys_move_along_their_direction_at_the_speed() {
        for (motion, direction) in [
            (Motion::Right, Vec3::X),
            (Motion::Left, Vec3::NEG_X),
            (Motion::Up, Vec3::Y),
            (Motion::Down, Vec3::NEG_Y),
            (Motion::Forward, Vec3::new(0.0, -0.4, -3.0).normalize()),
            (Motion::Backward, Vec3::new(0.0, 0.4, 3.0).normalize()),
        ] {
            let mut n = start();
            let before = n.camera(0.0).eye;
            n.press(motion, 0.0);
            assert!(n.is_moving());
            let moved = n.camera(2.0).eye - before;
            assert!((moved - direction * 2.0).length() < 1e-4, "{motion:?}: {moved}");
            n.release(motion, 2.0);
            assert_eq!(n.camera(2.0).eye, n.camera(9.0).eye);
        }
    }

    #[test]
    fn pace_and_wheel_change_the_speed() {
        let mut n = start();
        assert_eq!(n.speed(), 1.0);
        n.set_pace(Pace::Fast, 0.0);
        assert_eq!(n.speed(), 4.0);
        n.set_pace(Pace::Slow, 0.0);
        assert_eq!(n.speed(), 0.25);
        n.set_pace(Pace::Normal, 0.0);
        n.wheel(2.0, 0.0);
        n.wheel(f32::NAN, 0.0);
        assert!((n.speed() - 1.44).abs() < 1e-5);
    }

    #[test]
    fn dragging_turns_right_and_orbiting_keeps_the_middle() {
        let mut n = start();
        n.look(100.0, 0.0, 0.0);
        let d = n.camera(0.0).target - n.camera(0.0).eye;
        assert!(d.x > 0.1, "to the right: {d}");
        let mut n = start();
        n.set_orbits(true);
        let target = n.camera(0.0).target;
        n.look(70.0, 20.0, 0.0);
        assert!((n.camera(0.0).target - target).length() < 1e-4);
        assert!((n.camera(0.0).eye - Vec3::new(0.0, 1.6, 3.0)).length() > 0.1);
    }

    #[test]
    fn no_view_is_too_steep() {
        let mut n = start();
        n.look(0.0, 1e9, 0.0);
        let camera = n.camera(0.0);
        assert!(camera.frame(10, 10).right.is_finite());
        let down = Camera { eye: Vec3::ZERO, target: Vec3::NEG_Y, up: Vec3::X, fov_y: 1.0 };
        n.set_camera(&down, 1.0);
        assert_eq!(n.camera(1.0), down);
        n.look(1.0, 0.0, 1.0);
        assert!(n.camera(1.0).target.is_finite());
    }
}
