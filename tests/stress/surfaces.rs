//! Materials and lights at the ends of their ranges.

use foveal_files::load::load;
use glam::Vec3;

use super::{Files, Seen, baked, check, look, world};

fn with_model(lines: &str) -> Files {
    Files::room().model("thing", lines).ball("thing", Vec3::new(0.3, -0.3, 0.0), 0.4, 6).block(
        "thing",
        Vec3::new(-0.8, -1.0, -0.6),
        Vec3::new(-0.2, 0.0, 0.0),
        true,
    )
}

/// A ball and a block of each of up to six models, all of them in sight.
fn with_models(models: &[String]) -> Files {
    let mut files = Files::room();
    for (i, lines) in models.iter().enumerate() {
        let name = format!("thing{i}");
        let (column, row) = ((i % 3) as f32 - 1.0, (i / 3) as f32);
        let centre = Vec3::new(0.6 * column, 0.6 * row - 0.25, 0.1 - 0.6 * row);
        let below = centre - Vec3::Y * 0.42;
        let half = Vec3::new(0.2, 0.14, 0.14);
        files = files.model(&name, lines).ball(&name, centre, 0.25, 6).block(
            &name,
            below - half,
            below + half,
            true,
        );
    }
    files
}

/// Looks at all of these models in one room.
fn check_all(models: &[String], what: &str) {
    let world = world(&with_models(models).write(what));
    let seen = look(&world, [96, 72], what).triangles();
    let named = |t: u32| &world.scene.materials[world.scene.mesh.materials[t as usize].0 as usize].name;
    for i in 0..models.len() {
        let name = format!("thing{i}");
        assert!(seen.iter().flatten().any(|&t| *named(t) == name), "{what}: {name} is out of sight");
    }
}

#[test]
fn roughness_from_0_to_1() {
    for alpha in [0.0, 1e-7, 1e-4, 1e-2, 0.5, 1.0] {
        let models = [
            "model = \"conductor\"\nspecular = [1.0, 1.0, 1.0]",
            "model = \"conductor\"\neta = [0.2, 0.9, 1.1]\nk = [3.9, 2.4, 2.1]\ndistribution = \"beckmann\"",
            "model = \"plastic\"\nalbedo = [1.0, 1.0, 1.0]\nior = 1.5",
            "model = \"dielectric\"\nior = 1.5",
            "model = \"cook_torrance\"\ndiffuse = [0.5, 0.5, 0.5]\nspecular = [0.5, 0.5, 0.5]",
            "model = \"ward\"\ndiffuse = [0.5, 0.5, 0.5]\nspecular = [0.5, 0.5, 0.5]",
        ];
        check_all(&models.map(|m| format!("{m}\nalpha = {alpha:?}")), &format!("roughness {alpha:?}"));
    }
}

#[test]
fn indices_from_1_to_3() {
    for ior in [1.0, 1.0 + f32::EPSILON, 1.33, 3.0] {
        let kinds = ["", "thin = true", "alpha = 0.3", "transmittance = [0.0, 1e-9, 1.0]"];
        let mut models: Vec<String> =
            kinds.map(|rest| format!("model = \"dielectric\"\nior = {ior:?}\n{rest}")).to_vec();
        models.push(format!("model = \"plastic\"\nalbedo = [0.0, 0.5, 1.0]\nior = {ior:?}\nalpha = 0.05"));
        check_all(&models, &format!("index {ior:?}"));
    }
}

/// Glass of index 1 is not there.
#[test]
fn glass_like_air_is_invisible() {
    let glowing = |files: Files| Files {
        mtl: files.mtl.replace("Kd 0.6 0.6 0.6", "Kd 0.3 0.3 0.3\nKe 0.7 0.4 0.1"),
        ..files
    };
    let glass = check(&glowing(with_model("model = \"dielectric\"\nior = 1.0")), "air");
    let empty = check(&glowing(Files::room()), "empty");
    let (mean, wanted) = (Seen::mean(&glass.paths), Seen::mean(&empty.paths));
    assert!((mean / wanted - 1.0).abs() < 0.03, "mean {mean}, not {wanted}");
}

/// Sixty glass boxes, one in the other.
#[test]
fn nested_glass() {
    for inside_out in [false, true] {
        let mut files = Files::room();
        for i in 0..60 {
            let name = format!("glass{i}");
            let half = Vec3::splat(0.7 - 0.011 * i as f32);
            let ior = 1.0 + 0.03 * (i % 20) as f32;
            files = files.model(&name, &format!("model = \"dielectric\"\nior = {ior:?}")).block(
                &name,
                -half,
                half,
                !(inside_out && i % 2 == 0),
            );
        }
        check(&files, "sixty boxes of glass");
    }
}

/// Everything black, and walls that lose nothing around a lamp: a closed white room never comes to an end of its own.
#[test]
fn albedo_0_and_1() {
    for albedo in [0.0, 1.0] {
        let mut files = Files::furnished();
        files.mtl = files.mtl.replace("Kd 0.6 0.6 0.6", &format!("Kd {albedo} {albedo} {albedo}"));
        check(&files, &format!("albedo {albedo}"));
    }
}

/// Where nothing emits, nothing is seen. (A file without light is given some, so it is taken away again.)
#[test]
fn without_light_all_is_black() {
    let mut files = Files::furnished();
    files.mtl = files.mtl.replace("Ke 5e0 5e0 5e0", "Ke 0 0 0");
    let mut scene = load(&files.write("dark")).unwrap_or_else(|e| panic!("{e}")).scene;
    scene.lights.clear();
    scene.environment = None;
    let seen = look(&baked(scene), [40, 30], "dark");
    assert!(seen.traced.data().iter().chain(seen.paths.data()).all(|c| *c == Vec3::ZERO));
}

/// Light is linear: 10⁹ times the radiance is 10⁹ times the picture.
#[test]
fn black_and_bright_lights() {
    let of = |radiance: f32| {
        let files = Files::default()
            .grey("wall", 0.6)
            .lamp("lamp", radiance)
            .block("wall", Vec3::NEG_ONE, Vec3::ONE, false)
            .block("lamp", Vec3::new(-0.3, 0.5, -0.3), Vec3::new(0.3, 0.8, 0.3), true)
            .model("glass", "model = \"dielectric\"\nior = 1.5")
            .ball("glass", Vec3::new(0.3, -0.3, 0.0), 0.4, 6);
        check(&files, &format!("radiance {radiance}"))
    };
    let (one, bright, faint) = (of(1.0), of(1e9), of(1e-12));
    for (seen, factor) in [(&bright, 1e9), (&faint, 1e-12)] {
        for (found, of_one) in [(&seen.paths, &one.paths), (&seen.buffers.color, &one.buffers.color)] {
            let ratio = Seen::mean(found) / Seen::mean(of_one) / factor;
            assert!((ratio - 1.0).abs() < 1e-3, "{factor}: {ratio}");
        }
    }
}

/// A lamp in the plane of a wall, on it, in it and against a mirror; point lights on surfaces, in corners and at the eye.
#[test]
fn lights_that_touch() {
    for y in [1.0, 1.0f32.next_down(), 1.0f32.next_up(), 0.999_999, -1.0] {
        let corners = [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)].map(|(x, z)| Vec3::new(x, y, z));
        let mut back = corners;
        back.reverse();
        let files = Files::furnished().lamp("other", 3.0).face("other", &corners).face("other", &back);
        check(&files, &format!("a lamp at {y}"));
    }
    let against = Files::furnished().lamp("other", 3.0).block(
        "other",
        Vec3::new(-0.2, -1.0, -0.8),
        Vec3::new(0.0, -0.6, -0.3),
        true,
    );
    check(&against, "a lamp against a mirror");
    let mut lights = String::new();
    for position in
        ["[0.0, -1.0, 0.0]", "[1.0, 1.0, 1.0]", "[0.0, 0.0, 0.95]", "[0.4, -0.6, 0.3]", "[-0.2, 0.1, -0.3]"]
    {
        lights +=
            &format!("[[light]]\nkind = \"point\"\nposition = {position}\nintensity = [1.0, 1.0, 1.0]\n");
    }
    check(&Files::furnished().sidecar(&lights), "point lights that touch");
    let spot = "[[light]]\nkind = \"spot\"\nposition = [0.0, 0.98, 0.0]\ndirection = [0.0, -1.0, 0.0]\n\
                intensity = [1.0, 1.0, 1.0]\ninner = 0.0\nouter = 90.0\n[[light]]\nkind = \"directional\"\n\
                direction = [0.0, -1.0, 0.0]\nirradiance = [1.0, 1.0, 1.0]";
    check(&Files::furnished().sidecar(spot), "a spot and parallel light");
}

/// In a room in which everything emits half and reflects half, radiance is 1, whatever stands in it.
#[test]
fn furnaces_hold_their_energy() {
    let things = [
        "model = \"mirror\"",
        "model = \"dielectric\"\nior = 1.5",
        "model = \"dielectric\"\nior = 3.0",
        "model = \"dielectric\"\nior = 1.5\nthin = true",
        "model = \"conductor\"\nspecular = [1.0, 1.0, 1.0]\nalpha = 0.3",
        "model = \"plastic\"\nalbedo = [1.0, 1.0, 1.0]\nior = 1.5\nalpha = 0.1",
    ];
    for lines in things {
        let files = Files::default()
            .material("wall", "Kd 0.5 0.5 0.5\nKe 0.5 0.5 0.5")
            .block("wall", Vec3::NEG_ONE, Vec3::ONE, false)
            .model("thing", lines)
            .ball("thing", Vec3::new(0.3, -0.3, 0.0), 0.4, 16)
            .block("thing", Vec3::new(-0.8, -1.0, -0.6), Vec3::new(-0.2, 0.0, 0.0), true);
        let seen = check(&files, lines);
        let mean = Seen::mean(&seen.paths);
        assert!(mean < 1.03, "{lines}: {mean} is more than was emitted");
        // A single scattering lobe loses what it would scatter twice.
        assert!(mean > 0.88, "{lines}: {mean}");
        assert!(Seen::mean(&seen.traced) < 1.1, "{lines}: {} by corrections", Seen::mean(&seen.traced));
    }
}
