//! Faces that no modeller means to make.

use foveal_files::load::load;
use glam::Vec3;

use super::{Files, Seen, check, look, world};

fn room_with(faces: &[[Vec3; 3]], material: &str) -> Files {
    faces.iter().fold(Files::furnished(), |files, face| files.face(material, face))
}

/// Slivers, needles and points of every material change a room by next to nothing.
#[test]
fn slivers_needles_and_points_are_harmless() {
    let plain = check(&Files::furnished(), "plain");
    let tiny = f32::MIN_POSITIVE;
    let p = Vec3::new(0.1, 0.3, 0.2);
    let faces = [
        [p; 3],
        [p, p, p + Vec3::X * 0.3],
        [p, p + Vec3::X * 0.3, p + Vec3::X * 0.15],
        [p, p + Vec3::Y * 0.5, p + Vec3::Y * 0.25 + Vec3::X * 1e-7],
        [Vec3::splat(-1.0), Vec3::splat(1.0), Vec3::splat(-1.0) + Vec3::X * 1e-6],
        [p, p + Vec3::Z * 0.4, p + Vec3::new(1e-20, 1e-20, 0.2)],
        [Vec3::splat(tiny), Vec3::X * tiny, Vec3::Y * tiny],
        [Vec3::splat(1e-38), Vec3::X * 1e-41, Vec3::ZERO],
    ];
    for material in ["wall", "lamp", "mirror", "glass", "metal", "varnish"] {
        let seen = check(&room_with(&faces, material), material);
        let (mean, wanted) = (Seen::mean(&seen.paths), Seen::mean(&plain.paths));
        assert!((mean / wanted - 1.0).abs() < 0.25, "{material}: mean {mean}, not {wanted}");
    }
}

/// The same face twice, and faces in one plane with others: one is seen, and always the same.
#[test]
fn coplanar_and_duplicate_faces_have_one_winner() {
    let quad = |low: f32, high: f32| {
        [(low, low), (low, high), (high, high), (high, low)].map(|(x, z)| Vec3::new(x, -1.0, z))
    };
    let files = Files::furnished()
        .grey("red", 0.9)
        .face("wall", &quad(-1.0, 1.0))
        .face("wall", &quad(-1.0, 1.0))
        .face("red", &quad(-0.5, 0.5))
        .face("mirror", &quad(-0.3, 0.7))
        .face("glass", &quad(-0.9, -0.2))
        .face("lamp", &quad(0.5, 0.9));
    let (one, two) = (check(&files, "coplanar"), check(&files, "coplanar again"));
    assert_eq!(one.triangles(), two.triangles());
    assert_eq!(one.traced.data(), two.traced.data());
}

/// Glass and mirror that are there twice, and a box in a box with no room between.
#[test]
fn duplicate_solids_are_harmless() {
    let (low, high) = (Vec3::new(-0.2, -1.0, 0.2), Vec3::new(0.2, -0.6, 0.6));
    let mut files = Files::furnished();
    for material in ["glass", "glass", "mirror", "metal", "glass"] {
        files = files.block(material, low, high, true);
    }
    check(&files, "duplicate solids");
    check(&files.block("glass", low, high, false), "and inside out");
}

/// Normals of any length, without one, against the face, across it and not a number.
#[test]
fn normals_of_all_kinds() {
    let normals = [
        Vec3::Z,
        Vec3::Z * 1e-30,
        Vec3::Z * 1e30,
        Vec3::ZERO,
        Vec3::NEG_Z,
        Vec3::X,
        Vec3::new(1.0, 0.0, 1e-6),
        Vec3::NAN,
        Vec3::INFINITY,
        Vec3::new(f32::NAN, 0.0, 1.0),
    ];
    for material in ["wall", "mirror", "glass", "metal", "varnish"] {
        // Panes beside each other, one for each of them, before the room's things.
        let mut files = Files::furnished();
        for (i, &first) in normals.iter().enumerate() {
            let (x, y) = (-0.5 + 0.25 * (i % 4) as f32, -0.3 + 0.27 * (i / 4) as f32);
            let corner = |right: f32, up: f32| Vec3::new(x + 0.24 * right, y + 0.26 * up, 0.2 - 0.05 * up);
            let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
            let others = normals[(i + 3) % normals.len()];
            files = files.smooth(material, &corners, &[first, others, first, Vec3::Z]);
        }
        let what = format!("{material} with odd normals");
        let world = world(&files.write(&what));
        let seen = look(&world, [160, 120], &what).triangles();
        let all = world.scene.mesh.triangles.len() as u32;
        for t in all - 2 * normals.len() as u32..all {
            assert!(seen.contains(&Some(t)), "{what}: triangle {t} of {all} is out of sight");
        }
    }
}

/// Corners at infinity and not a number are left out; what is large is kept.
#[test]
fn corners_of_all_kinds() {
    for far in [1e6f32, 1e18, 1e30, 3e38] {
        let face = [Vec3::new(-far, -far, -2.0), Vec3::new(far, -far, -2.0), Vec3::new(0.0, far, -2.0)];
        check(&room_with(&[face], "wall"), &format!("a triangle of {far}"));
    }
    for bad in [f32::NAN, f32::INFINITY] {
        let file = room_with(&[[Vec3::splat(bad), Vec3::X, Vec3::Y]], "wall").write("bad corner");
        if let Ok(loaded) = load(&file) {
            assert!(!loaded.warnings.is_empty(), "{bad} is said to be left out");
            assert!(loaded.scene.mesh.positions.iter().all(|p| p.is_finite()));
        }
    }
}
