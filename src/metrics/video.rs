//! How a walk looks beside its reference: ColorVideoVDP (Mantiuk et al. 2024), which also sees what flickers.

use glam::Vec3;
use rayon::prelude::*;

use crate::display::tone::ToneMap;
use crate::image::Map2d;
use crate::perception::viewing::Viewing;

/// Visible difference of the frames `test` from the frames `reference`, as `tone` shows them `fps` times a second on
/// the display of `viewing`, in just objectionable differences: 10 is none, one less is what three of four observers
/// object to.
///
/// # Errors
/// Where the sequences are empty or differ in length or size, a value is not finite, or the display is none; in words.
pub fn jod(
    test: &[Map2d<Vec3>],
    reference: &[Map2d<Vec3>],
    fps: f32,
    tone: &ToneMap,
    viewing: &Viewing,
) -> Result<f32, String> {
    let words = |e: colorvideovdp::Error| format!("ColorVideoVDP: {e}");
    let [width, height] = test.first().map_or([0, 0], |frame| [frame.width(), frame.height()]);
    let white = f64::from(viewing.white_cd_m2);
    let contrast = white / f64::from(viewing.black_cd_m2);
    let photometry = colorvideovdp::Photometry::new(white, contrast, 0.0, 0.0, 1.0).map_err(words)?;
    let geometry = colorvideovdp::Geometry::from_ppd([width, height], f64::from(viewing.pixels_per_degree))
        .map_err(words)?;
    let display =
        colorvideovdp::DisplayModel::new("the scene's", photometry, geometry, "sRGB").map_err(words)?;
    let metric = colorvideovdp::Cvvdp::new(display, colorvideovdp::Options::default()).map_err(words)?;
    let shown = |frames: &[Map2d<Vec3>]| -> Result<Vec<_>, _> {
        let shown = |frame: &Map2d<Vec3>| {
            let values: Vec<[f32; 3]> =
                frame.data().par_iter().map(|&rgb| tone.to_display(rgb).to_array()).collect();
            colorvideovdp::Image::new(frame.width(), frame.height(), 3, values.into_flattened())
        };
        frames.iter().map(shown).collect()
    };
    let (test, reference) = (shown(test).map_err(words)?, shown(reference).map_err(words)?);
    let prediction = metric.predict_video(&test, &reference, fps, colorvideovdp::Color::Srgb);
    prediction.map(|p| p.jod).map_err(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grey frames, brighter all the time or by turns: 7.5 times a second at 30 frames.
    fn brighter(by: f32, flickers: bool) -> Vec<Map2d<Vec3>> {
        let frame =
            |t: u32| Map2d::new(48, 32, Vec3::splat(0.2 + if flickers && t & 2 == 0 { 0.0 } else { by }));
        (0..16).map(frame).collect()
    }

    #[test]
    fn what_flickers_is_seen_where_what_stands_still_is_not() {
        let viewing = Viewing::from_centre_of_projection(100.0, 48, 0.1);
        let score = |test: &[Map2d<Vec3>]| {
            jod(test, &brighter(0.0, false), 30.0, &ToneMap::default(), &viewing).expect("a score")
        };
        assert_eq!(score(&brighter(0.0, false)), 10.0);
        let (still, flickering) = (score(&brighter(0.02, false)), score(&brighter(0.02, true)));
        assert!(flickering < still - 0.5 && still > 9.9, "{flickering} {still}");
        assert!(score(&brighter(0.005, true)) > flickering);
    }

    #[test]
    fn sequences_that_cannot_be_compared_are_refused_in_words() {
        let viewing = Viewing::from_centre_of_projection(100.0, 48, 0.1);
        let frames = brighter(0.0, false);
        for (test, reference) in [(&frames[..], &frames[1..]), (&frames[..0], &frames[..0])] {
            let error = jod(test, reference, 30.0, &ToneMap::default(), &viewing).expect_err("refused");
            assert!(error.starts_with("ColorVideoVDP: "), "{error}");
        }
    }
}
