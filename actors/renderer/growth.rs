//! Better light is seen to grow: in the time of some frames, as much in each.

use std::sync::Arc;

use foveal::illumination::stored::Illumination;

use crate::message::PublishedLight;

/// Better light is shown at once where it changes no irradiance by more than this share of itself and of the scene's mean.
const LIGHT_CHANGE: f32 = 0.06;
/// Else it grows for so many seconds. Each frame of that is a view of its own.
const LIGHT_GROWS: f32 = 0.4;
/// A frame counts as so many seconds at least, or light would never be there.
const FRAME_MIN: f32 = 0.01;

/// Light that the shown one becomes.
pub(super) struct Growth {
    /// That light.
    pub light: Arc<PublishedLight>,
    /// Whether it is the last.
    pub last: bool,
    /// Seconds until it is shown; `None` before the first frame of them.
    pub left: Option<f32>,
}

impl Growth {
    /// What a frame of `time` seconds shows on the way from the `shown` light to the `target`, and how many seconds are left
    /// then; `None` where it shows the target itself: at the end, where both hardly differ, and where they are stored
    /// differently, as a bake's first map is.
    pub fn step(
        &self,
        shown: &Illumination,
        target: &Illumination,
        time: f32,
    ) -> Option<(Illumination, f32)> {
        let [r, g, b] = target.summary.mean;
        let absolute = LIGHT_CHANGE * (r + g + b) / 3.0;
        if self.left.is_none() && shown.is_near(target, LIGHT_CHANGE, absolute)? {
            return None;
        }
        let (share, left) = share(self.left.unwrap_or(LIGHT_GROWS), time)?;
        Some((shown.approached(target, share)?, left))
    }
}

/// The share of the way that is `left`, seconds, in a frame of so many, and what is left after it; `None` where it ends.
fn share(left: f32, time: f32) -> Option<(f32, f32)> {
    // Also where it is not a number.
    let time = time.max(FRAME_MIN);
    let share = time / left;
    // Roundings of a frame's time make no frame.
    (share < 0.99).then_some((share, left - time))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How far it is after each frame.
    fn grown(time: f32) -> Vec<f32> {
        let (mut shown, mut left, mut all) = (0.0, LIGHT_GROWS, Vec::new());
        while let Some((share, then)) = share(left, time) {
            shown += (1.0 - shown) * share;
            left = then;
            all.push(shown);
            assert!(all.len() < 100, "it never ends");
        }
        all.push(1.0);
        all
    }

    #[test]
    fn light_grows_evenly_and_is_there_in_its_time() {
        for (time, frames) in [(0.1, 4), (0.2, 2), (0.4, 1), (3.0, 1), (f32::INFINITY, 1), (1.0 / 60.0, 24)] {
            let grown = grown(time);
            assert_eq!(grown.len(), frames, "{time}: {grown:?}");
            for (i, shown) in grown.iter().enumerate() {
                assert!((shown - (i + 1) as f32 / frames as f32).abs() < 1e-3, "{time}: {grown:?}");
            }
        }
        // Times that are none.
        for time in [0.0, -1.0, f32::NAN] {
            assert_eq!(grown(time).len(), 40);
        }
    }
}
