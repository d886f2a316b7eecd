//! Scenes of any size, anywhere.

use glam::Vec3;

use super::{Files, Seen, look, world};
use crate::support::assert_same_bits;

fn placed(files: &Files, what: &str, place: impl Fn(Vec3) -> Vec3) -> Seen {
    let file = files.write_with(what, Vec3::new(0.0, 0.0, 0.95), Vec3::Z * -4.0, 70.0, place);
    look(&world(&file), [40, 30], what)
}

/// Nothing knows an absolute length: at any power of two all but the distances has the same bits, bake and all.
#[test]
fn scenes_of_any_size_look_alike() {
    let files = Files::furnished();
    let unit = placed(&files, "unit", |p| p);
    for exponent in [-20, -7, 7, 20] {
        let factor = 2f32.powi(exponent);
        let what = format!("scaled by 2^{exponent}");
        let seen = placed(&files, &what, |p| p * factor);
        assert_eq!(seen.triangles(), unit.triangles(), "{what}");
        let depth: Vec<f32> = unit.buffers.depth.data().iter().map(|d| d * factor).collect();
        assert_eq!(seen.buffers.depth.data(), depth, "{what}");
        assert_eq!(seen.buffers.object.data(), unit.buffers.object.data(), "{what}");
        for (found, expected, which) in [
            (&seen.buffers.color, &unit.buffers.color, "display"),
            (&seen.traced, &unit.traced, "traced"),
            (&seen.paths, &unit.paths, "paths"),
        ] {
            assert_same_bits(found, expected, &format!("{what}, {which}"));
        }
    }
}

/// Far from the origin coordinates are coarse; what is left of the room is drawn without light from nowhere.
#[test]
fn scenes_far_from_the_origin_are_drawn() {
    let files = Files::furnished();
    let unit = placed(&files, "at the origin", |p| p);
    for extents in [1e3f32, 1e4, 1e5, 1e6] {
        let what = format!("shifted by {extents} extents");
        let shift = Vec3::new(2.0, -1.5, 1.0) * extents;
        let seen = placed(&files, &what, |p| p + shift);
        let (mean, wanted) = (Seen::mean(&seen.paths), Seen::mean(&unit.paths));
        assert!(mean < 3.0 * wanted, "{what}: mean {mean} where {wanted} is right");
        if extents <= 1e4 {
            assert!((mean / wanted - 1.0).abs() < 0.15, "{what}: mean {mean}, not {wanted}");
            let missed = seen.triangles().iter().filter(|t| t.is_none()).count();
            assert_eq!(missed, 0, "{what}: rays left the closed room");
        }
    }
}
