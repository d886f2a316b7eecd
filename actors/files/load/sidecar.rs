//! The sidecar: what OBJ and MTL cannot say (`SCENES.md`).

use std::path::Path;

use glam::Vec3;

use super::error::{Place, SceneError};
use super::gltf::Choices;
use super::sidecar_material::{MaterialTable, material_table};
use super::toml_table::{Document, Table};
use foveal::scene::camera::PathKey;
use foveal::scene::{Budget, Camera, CameraPath, Display, Light, NamedCamera, Screen};

/// The sidecar format that this build reads.
pub const FORMAT: i64 = 1;

/// Radiance, intensity and irradiance beyond this are taken for a slip.
pub(super) const RADIANCE_MAX: f32 = 1e9;

/// A file that the sidecar asks for, and where.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FileName {
    pub name: String,
    pub place: Place,
}

/// `[environment]`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct EnvironmentTable {
    pub radiance: Vec3,
    pub map: Option<FileName>,
    /// Radians.
    pub rotate_up: f32,
}

/// A sidecar, with all angles in radians.
#[derive(Clone, Debug)]
pub(super) struct Sidecar {
    pub title: Option<String>,
    pub files: Option<Vec<FileName>>,
    pub metres_per_unit: f32,
    pub up: Vec3,
    pub cameras: Vec<NamedCamera>,
    pub paths: Vec<CameraPath>,
    pub environment: Option<EnvironmentTable>,
    pub lights: Vec<Light>,
    pub materials: Vec<MaterialTable>,
    pub display: Display,
    /// Whether the display's exposure was said.
    pub exposure_given: bool,
    pub gltf: Choices,
    pub budget: Budget,
}

impl Default for Sidecar {
    fn default() -> Self {
        Self {
            title: None,
            files: None,
            metres_per_unit: 1.0,
            up: Vec3::Y,
            cameras: Vec::new(),
            paths: Vec::new(),
            environment: None,
            lights: Vec::new(),
            materials: Vec::new(),
            display: Display::default(),
            exposure_given: false,
            gltf: Choices::default(),
            budget: Budget::default(),
        }
    }
}

/// Reads a sidecar. `path` is for messages.
pub(super) fn parse(bytes: &[u8], path: &Path) -> Result<Sidecar, SceneError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = std::str::from_utf8(bytes).map_err(|e| SceneError::Syntax {
        place: Place::new(path, 1 + bytes[..e.valid_up_to()].iter().filter(|b| **b == b'\n').count() as u32),
        message: "the text is not UTF-8; save it as UTF-8".to_owned(),
    })?;
    let document = Document::new(path, text);
    let parsed = document.parse()?;
    let root = document.root(&parsed);
    let format = root.number("format")?;
    match format {
        Some(f) if f == FORMAT as f32 => {}
        Some(f) => {
            return Err(root.invalid("format", format_args!("is {f}; this build reads format = {FORMAT}")));
        }
        None => {
            return Err(SceneError::invalid(
                Place::new(path, 1),
                format!(
                    "no `format`; a sidecar begins with format = {FORMAT}, which is what this build reads"
                ),
            ));
        }
    }
    let mut sidecar = Sidecar { title: root.string("title")?.map(str::to_owned), ..Default::default() };
    root.string("attribution")?;
    if let Some(t) = root.table("geometry")? {
        geometry(&t, &mut sidecar)?;
    }
    let cameras = root.tables("camera")?;
    for t in &cameras {
        let camera = camera(t, sidecar.up)?;
        if sidecar.cameras.iter().any(|c| c.name == camera.name) {
            return Err(t.invalid(
                "name",
                format_args!("\"{}\" is that of an earlier camera; rename one", camera.name),
            ));
        }
        sidecar.cameras.push(camera);
    }
    for t in root.tables("path")? {
        let path = camera_path(&t)?;
        if sidecar.paths.iter().any(|p| p.name == path.name) {
            return Err(
                t.invalid("name", format_args!("\"{}\" is that of an earlier path; rename one", path.name))
            );
        }
        sidecar.paths.push(path);
    }
    if let Some(t) = root.table("environment")? {
        sidecar.environment = Some(environment(&t)?);
    }
    for t in root.tables("light")? {
        sidecar.lights.push(light(&t)?);
    }
    if let Some(all) = root.table("material")? {
        for (name, value) in all.entries() {
            let table = all.as_table(name, value, format!("[material.\"{name}\"]"))?;
            sidecar.materials.push(material_table(name, &table)?);
        }
    }
    if let Some(t) = root.table("display")? {
        let d = Display::default();
        let metres = |key| t.number_in(key, |v| v > 0.0, "above 0");
        let (width, distance) = (metres("width")?, metres("distance")?);
        let pixels = t.number_in("pixels", |v| v >= 1.0, "at least 1")?.unwrap_or(1920.0);
        if width.is_some() != distance.is_some() {
            return Err(t.invalid("width", "and `distance` belong together: both or neither, metres"));
        }
        let lab = match t.string("difference")? {
            None | Some("luminance") => false,
            Some("lab") => true,
            Some(other) => {
                return Err(
                    t.invalid("difference", format_args!("is \"{other}\"; it is \"luminance\" or \"lab\""))
                );
            }
        };
        let exposure = t.number_in("exposure", |v| v > 0.0, "above 0")?;
        sidecar.exposure_given = exposure.is_some();
        sidecar.display = Display {
            screen: width.zip(distance).map(|(width, distance)| Screen { pixels, width, distance }),
            lab,
            exposure: exposure.unwrap_or(d.exposure),
            metered: false,
            white_cd_m2: t.number_in("white_cd_m2", |v| v > 0.0, "above 0")?.unwrap_or(d.white_cd_m2),
        };
        t.finish()?;
    }
    if let Some(t) = root.table("gltf")? {
        sidecar.gltf = gltf(&t)?;
    }
    if let Some(t) = root.table("budget")? {
        let textures = t.string("textures")?;
        let bytes = textures.map(|s| {
            parse_bytes(s)
                .ok_or_else(|| t.invalid("textures", format_args!("is \"{s}\"; write a size as \"64MiB\"")))
        });
        sidecar.budget = Budget {
            texture_bytes: bytes.transpose()?,
            fps: t.number_in("fps", |v| v > 0.0 && v <= 1000.0, "above 0 and at most 1000")?,
        };
        t.finish()?;
    }
    root.finish()?;
    Ok(sidecar)
}

fn gltf(t: &Table<'_>) -> Result<Choices, SceneError> {
    let good = |v: f32| (1e-9..=1e9).contains(&v);
    let choices = Choices {
        scene: t.string("scene")?.map(str::to_owned),
        variant: t.string("variant")?.map(str::to_owned),
        light_scale: t.number_in("light_scale", good, "between 1e-9 and 1e9")?.unwrap_or(1.0),
        play: t.string("play")?.map(str::to_owned),
        time: t.number_in("time", |v| (-1e6..=1e6).contains(&v), "between -1e6 and 1e6 seconds")?,
        cull: t.boolean("cull")?.unwrap_or(true),
        gloss_floor: t
            .number_in("gloss_floor", |v| (0.0..=2.0).contains(&v), "between 0 and 2")?
            .unwrap_or(Choices::default().gloss_floor),
        ignored: t.strings("ignore")?.unwrap_or_default().into_iter().map(|(n, _)| n.to_owned()).collect(),
    };
    t.finish()?;
    Ok(choices)
}

fn geometry(t: &Table<'_>, sidecar: &mut Sidecar) -> Result<(), SceneError> {
    let files = t.strings("files")?;
    if files.as_ref().is_some_and(Vec::is_empty) {
        return Err(t.invalid("files", "names no file; name an .obj, .gltf or .glb file"));
    }
    sidecar.files =
        files.map(|l| l.into_iter().map(|(name, place)| FileName { name: name.to_owned(), place }).collect());
    if let Some(m) = t.number_in("metres_per_unit", |v| (1e-9..=1e9).contains(&v), "between 1e-9 and 1e9")? {
        sidecar.metres_per_unit = m;
    }
    if let Some(up) = t.string("up")? {
        sidecar.up = match up {
            "+x" | "x" => Vec3::X,
            "-x" => Vec3::NEG_X,
            "+y" | "y" => Vec3::Y,
            "-y" => Vec3::NEG_Y,
            "+z" | "z" => Vec3::Z,
            "-z" => Vec3::NEG_Z,
            _ => return Err(t.invalid("up", "must be one of +x -x +y -y +z -z")),
        };
    }
    t.finish()
}

/// Whether a view from `eye` to `target` has a direction in single precision.
fn looks(eye: Vec3, target: Vec3) -> bool {
    let d = target - eye;
    let scale = eye.abs().max(target.abs()).max_element();
    d.is_finite() && d.length() > scale * 1e-6 && d.length_squared().is_normal()
}

fn camera(t: &Table<'_>, scene_up: Vec3) -> Result<NamedCamera, SceneError> {
    let name = t.required("name", t.string("name")?)?.to_owned();
    let eye = t.required("eye", t.vec3("eye")?)?;
    let target = t.required("target", t.vec3("target")?)?;
    let up = t.vec3("up")?;
    // Less than a hundredth of a degree from 0 or 180 has no picture in single precision.
    let good = |v: f32| (0.01..=179.99).contains(&v);
    let fov = t.number_in("fov_y", good, "between 0 and 180 degrees, for example 45.0")?;
    let fov_y = t.required("fov_y", fov)?.to_radians();
    t.finish()?;
    if !looks(eye, target) {
        return Err(t.invalid("target", "equals `eye`, so the camera looks nowhere; move one of them"));
    }
    let view = (target - eye).normalize();
    let across = |up: Vec3| up.normalize_or_zero().cross(view).length() > 1e-4;
    let up = match up {
        Some(up) if !across(up) => {
            return Err(t.invalid("up", "is zero or along the view; give another direction"));
        }
        Some(up) => up.normalize(),
        None if across(scene_up) => scene_up,
        None => view.any_orthonormal_vector(),
    };
    Ok(NamedCamera { name, camera: Camera { eye, target, up, fov_y } })
}

fn camera_path(t: &Table<'_>) -> Result<CameraPath, SceneError> {
    let name = t.required("name", t.string("name")?)?.to_owned();
    let mut keys: Vec<PathKey> = Vec::new();
    for k in t.tables("keys")? {
        let key = PathKey {
            t: k.required("t", k.number("t")?)?,
            eye: k.required("eye", k.vec3("eye")?)?,
            target: k.required("target", k.vec3("target")?)?,
        };
        k.finish()?;
        if !looks(key.eye, key.target) {
            return Err(k.invalid("target", "equals `eye`, so the camera looks nowhere; move one of them"));
        }
        if keys.last().is_some_and(|last| last.t >= key.t) {
            return Err(k.invalid("t", "is not later than the key before; order the keys by time"));
        }
        keys.push(key);
    }
    t.finish()?;
    if keys.is_empty() {
        return Err(t.invalid("keys", "holds no key; add at least one { t, eye, target }"));
    }
    Ok(CameraPath { name, keys })
}

fn environment(t: &Table<'_>) -> Result<EnvironmentTable, SceneError> {
    let radiance = t.color("radiance", RADIANCE_MAX)?.unwrap_or(Vec3::ONE);
    let map = t.string("map")?.map(|name| FileName { name: name.to_owned(), place: t.place_of("map") });
    let good = |v: f32| (0.0..=RADIANCE_MAX).contains(&v);
    let scale = t.number_in("scale", good, "between 0 and 1e9")?.unwrap_or(1.0);
    let rotate_up = t.number("rotate_up")?.unwrap_or(0.0) % 360.0;
    t.finish()?;
    let radiance = radiance * scale;
    if radiance.max_element() > RADIANCE_MAX {
        return Err(t.invalid("scale", "times `radiance` is more than 1e9"));
    }
    Ok(EnvironmentTable { radiance, map, rotate_up: rotate_up.to_radians() })
}

fn light(t: &Table<'_>) -> Result<Light, SceneError> {
    let direction = || -> Result<Vec3, SceneError> {
        let d = t.required("direction", t.vec3("direction")?)?;
        d.try_normalize().ok_or_else(|| t.invalid("direction", "has no length; give a direction of travel"))
    };
    let position = || t.required("position", t.vec3("position")?);
    let power = |key: &'static str| t.required(key, t.color(key, RADIANCE_MAX)?);
    let half_angle = |key: &'static str| -> Result<f32, SceneError> {
        let v = t.number_in(key, |v| (0.0..=180.0).contains(&v), "a half angle between 0 and 180 degrees")?;
        Ok(t.required(key, v)?.to_radians())
    };
    let kind = t.required("kind", t.string("kind")?)?;
    let light = match kind {
        "point" => {
            Light::Point { position: position()?, intensity: power("intensity")?, range: f32::INFINITY }
        }
        "spot" => {
            let (inner, outer) = (half_angle("inner")?, half_angle("outer")?);
            if outer < inner || outer == 0.0 {
                return Err(t.invalid("outer", "must be above 0 and not less than `inner`"));
            }
            let (position, direction, intensity) = (position()?, direction()?, power("intensity")?);
            Light::Spot { position, direction, intensity, inner, outer, range: f32::INFINITY }
        }
        "directional" => Light::Directional { direction: direction()?, irradiance: power("irradiance")? },
        other => {
            return Err(
                t.invalid("kind", format_args!("is \"{other}\"; it must be point, spot or directional"))
            );
        }
    };
    t.finish()?;
    Ok(light)
}

/// A size as `64MiB`, `1.5 GB` or `4096`, bytes.
fn parse_bytes(text: &str) -> Option<u64> {
    let text = text.trim();
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let value: f64 = text[..end].parse().ok()?;
    let unit = match text[end..].trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        _ => return None,
    };
    let bytes = value * unit;
    (bytes.is_finite() && bytes < 1e18).then_some(bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: &str = "[[camera]]\nname = \"main\"\neye = [0, 0, 3]\ntarget = [0, 0, 0]\nfov_y = 45\n";

    fn read(text: &str) -> Result<Sidecar, SceneError> {
        parse(text.as_bytes(), Path::new("s.toml"))
    }

    /// The message of a sidecar that is `format = 1` and `text`.
    fn check(text: &str, message: &str) {
        let error = read(&format!("format = 1\n{text}")).unwrap_err().to_string();
        assert_eq!(error, format!("s.toml:{message}"), "{text}");
    }

    #[test]
    fn everything_at_once() {
        let s = read(
            r#"format = 1
title = "T"
attribution = "A"
[geometry]
files = ["a.obj", "b/c.obj"]
metres_per_unit = 0.01
up = "+z"
[[camera]]
name = "main"
eye = [0.0, 1, 3.0]
target = [0.0, 1.2, 0.0]
up = [0.0, 2.0, 0.0]
fov_y = 90
[[path]]
name = "tour"
keys = [ { t = 0, eye = [0, 0, 1], target = [0, 0, 0] }, { t = 4.5, eye = [0, 0, 2], target = [0, 0, 0] } ]
[environment]
radiance = [1, 2, 3]
map = "sky.exr"
scale = 2.0
rotate_up = 90.0
[[light]]
kind = "point"
position = [0, 2, 0]
intensity = [10, 10, 10]
[[light]]
kind = "spot"
position = [0, 2, 0]
direction = [0, -2, 0]
inner = 20
outer = 30.0
intensity = [1, 1, 1]
[[light]]
kind = "directional"
direction = [0, -1, 0]
irradiance = [3, 3, 3]
[material."Stainless steel"]
model = "conductor"
eta = [1, 1, 1]
k = [2, 2, 2]
alpha = 0.1
[display]
exposure = 2.0
white_cd_m2 = 80
pixels = 2560
width = 0.6
distance = 0.7
difference = "lab"
[budget]
textures = "64MiB"
fps = 10
"#,
        )
        .unwrap();
        assert_eq!(s.title.as_deref(), Some("T"));
        let files = s.files.unwrap();
        assert_eq!((files[1].name.as_str(), files[1].place.line), ("b/c.obj", 5));
        assert_eq!((s.metres_per_unit, s.up), (0.01, Vec3::Z));
        assert_eq!(s.cameras[0].camera.up, Vec3::Y);
        assert!((s.cameras[0].camera.fov_y - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!(s.paths[0].keys[1].t, 4.5);
        let e = s.environment.unwrap();
        assert_eq!(e.radiance, Vec3::new(2.0, 4.0, 6.0));
        assert!((e.rotate_up - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!(s.lights.len(), 3);
        assert!(matches!(s.lights[1], Light::Spot { direction: Vec3::NEG_Y, .. }));
        assert_eq!(s.materials[0].material.name, "Stainless steel");
        let screen = Some(Screen { pixels: 2560.0, width: 0.6, distance: 0.7 });
        assert_eq!(
            s.display,
            Display { exposure: 2.0, metered: false, white_cd_m2: 80.0, screen, lab: true }
        );
        assert_eq!(s.budget, Budget { texture_bytes: Some(64 << 20), fps: Some(10.0) });
    }

    #[test]
    fn messages_name_line_and_remedy() {
        check(
            "[[camera]]\nname = \"m\"\neye = [0, 0, 3]\ntarget = [0, 0, 0]\nfovy = 45\n",
            "2: [[camera]] has no `fov_y`; add it",
        );
        check(&format!("{CAMERA}fovy = 3\n"), "7: unknown key `fovy` in [[camera]]; did you mean `fov_y`?");
        check("[geomtry]\n", "2: unknown key `geomtry` in the file; did you mean `geometry`?");
        check("[geometry]\nfiles = \"a\"\n", "3: `files` must be a list of strings, but is a string");
        check("[geometry]\nup = \"y+\"\n", "3: `up` must be one of +x -x +y -y +z -z");
        check(&format!("{CAMERA}{CAMERA}"), "8: `name` \"main\" is that of an earlier camera; rename one");
        check(
            &CAMERA.replace("[0, 0, 3]", "\"3 2 1\""),
            "4: `eye` must be three finite numbers in brackets, as [0.0, 1.0, 2.0], but is a string",
        );
        check(
            &CAMERA.replace("[0, 0, 3]", "[nan, 0, 3]"),
            "4: `eye` must be three finite numbers in brackets, as [0.0, 1.0, 2.0], but is a list of 3",
        );
        check(
            &CAMERA.replace("[0, 0, 3]", "[0, 0, 0]"),
            "5: `target` equals `eye`, so the camera looks nowhere; move one of them",
        );
        check(
            &CAMERA.replace("45", "180"),
            "6: `fov_y` is 180; it must be between 0 and 180 degrees, for example 45.0",
        );
        check(
            &format!("{CAMERA}up = [0, 0, 1]"),
            "7: `up` is zero or along the view; give another direction",
        );
        check(
            "[[path]]\nname = \"p\"\nkeys = []\n",
            "4: `keys` holds no key; add at least one { t, eye, target }",
        );
        check("[[light]]\nkind = \"lamp\"\n", "3: `kind` is \"lamp\"; it must be point, spot or directional");
        check("[budget]\ntextures = \"64MB!\"\n", "3: `textures` is \"64MB!\"; write a size as \"64MiB\"");
        check("x = [", "2: not valid TOML: unclosed array, expected `]`");
    }

    #[test]
    fn format_is_needed_and_must_be_known() {
        for (text, part) in [
            ("", "no `format`"),
            ("title = \"x\"", "no `format`"),
            ("format = 2", "is 2; this build reads format = 1"),
            ("format = \"1\"", "must be a finite number"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.starts_with("s.toml:1: ") && error.contains(part), "{error}");
        }
    }

    #[test]
    fn deep_nesting_and_long_keys_end_with_a_message() {
        for text in [
            "x = ".to_owned() + &"[".repeat(200_000),
            "{a=".repeat(100_000),
            "a.".repeat(100_000) + "b = 1",
            "[".to_owned() + &"a.".repeat(100_000) + "b]",
            "k".repeat(1_000_000) + " = 1",
        ] {
            let error = read(&format!("format = 1\n{text}")).unwrap_err().to_string();
            assert!(error.len() < 300, "{}", error.len());
        }
    }

    #[test]
    fn sizes() {
        assert_eq!(parse_bytes("64MiB"), Some(64 << 20));
        assert_eq!(parse_bytes("1.5 GB"), Some(1_500_000_000));
        assert_eq!(parse_bytes("4096"), Some(4096));
        for bad in ["", "MiB", "-1", "1e9", "9999999999999999999GiB"] {
            assert_eq!(parse_bytes(bad), None, "{bad}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_can_break_it(text in "(format = 1\n)?([a-z_]{1,9}( = |\\.)[\\[\\]{}0-9.\",a-z ]{0,20}\n|\\[\\[?(camera|path|light|geometry)\\]?\\]\n){0,12}") {
            let _ = read(&text);
        }
    }
}
