//! Loads real and hostile files: those made here, and the shared ones where they stand beside the
//! checkout.

use std::path::{Path, PathBuf};

use glam::Vec3;

use super::*;

use foveal::math;
use foveal::scene::{Model, Reflectance, TextureId};

/// A folder that is removed when the test ends.
pub(super) struct TempFolder(pub PathBuf);

impl TempFolder {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("foveal-load-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, content).unwrap();
        path
    }
}

impl Drop for TempFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

pub(super) fn png(width: u32, height: u32, rgba: [u8; 4]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let picture = image::RgbaImage::from_pixel(width, height, image::Rgba(rgba));
    picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png).unwrap();
    bytes
}

/// What every loaded scene promises.
pub(super) fn promises(scene: &Scene) {
    let m = &scene.mesh;
    let n = m.positions.len();
    assert!(!m.triangles.is_empty() && !scene.materials.is_empty() && !scene.cameras.is_empty());
    assert!(m.normals.len() == n && m.uvs.len() == n);
    assert!([0, n].contains(&m.uvs1.len()) && [0, n].contains(&m.tangents.len()));
    assert!(m.materials.len() == m.triangles.len() && m.objects.len() == m.triangles.len());
    assert!(m.positions.iter().all(|p| p.is_finite()) && m.uvs.iter().all(|p| p.is_finite()));
    assert!(m.normals.iter().all(|v| *v == Vec3::ZERO || (v.length() - 1.0).abs() < 1e-3));
    assert!(m.triangles.iter().flatten().all(|&v| (v as usize) < n));
    assert!(m.materials.iter().all(|m| (m.0 as usize) < scene.materials.len()));
    assert_eq!(scene.objects.iter().map(|o| o.triangles.len()).sum::<usize>(), m.triangles.len());
    assert!((0..m.triangles.len() as u32).all(|t| scene.things.at(t).is_some()));
    for (i, o) in scene.objects.iter().enumerate() {
        assert!(o.triangles.iter().all(|&t| m.objects[t as usize] == i as u32));
        assert!(i == 0 || !scene.materials[o.material.0 as usize].is_diffuse());
    }
    for p in &scene.paths {
        for i in 0..=20 {
            let c = p.at(p.duration() * i as f32 / 20.0, scene.up, 1.0);
            assert!(c.eye.is_finite() && c.target.is_finite() && c.eye != c.target);
        }
    }
    let ids = |m: &Material| {
        let r = |r: &Reflectance| r.map;
        let of_model = match &m.model {
            Model::Lambert { albedo: a } | Model::Plastic { albedo: a, .. } => [r(a), None],
            Model::Mirror { specular: s } | Model::Metal { specular: s, .. } => [r(s), None],
            Model::CookTorrance { diffuse, specular, .. } | Model::Ward { diffuse, specular, .. } => {
                [r(diffuse), r(specular)]
            }
            Model::MetalRough(m) => [r(&m.diffuse), r(&m.specular)],
            Model::Conductor { .. } | Model::Dielectric { .. } => [None, None],
        };
        [of_model[0], of_model[1], m.emission.map, m.opacity_map, m.bump_map, m.normal_map]
    };
    for id in scene.materials.iter().flat_map(ids).flatten() {
        assert!((id.0 as usize) < scene.textures.len());
    }
}

fn loads(path: &Path) -> Loaded {
    let loaded = load(path).unwrap_or_else(|e| panic!("{e}"));
    promises(&loaded.scene);
    loaded
}

fn said(loaded: &Loaded, part: &str) -> usize {
    loaded.warnings.iter().filter(|w| w.to_string().contains(part)).count()
}

#[test]
fn obj_mtl_and_texture() {
    let place = TempFolder::new("plain");
    place.write("m.mtl", "newmtl wood\nKd 1 1 1\nmap_Kd maps\\Wood 1.PNG\nnewmtl unused\nmap_Kd none.png\n");
    place.write("maps/wood 1.png", png(4, 2, [255, 0, 0, 255]));
    let path = place.write("s.obj", format!("mtllib m.mtl\nusemtl wood\n{TRIANGLE}"));
    let loaded = loads(&path);
    assert_eq!(loaded.scene.textures[0].name, "maps/wood 1.png");
    assert_eq!(loaded.scene.textures[0].mean(), [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(loaded.scene.materials.len(), 1);
    assert_eq!(said(&loaded, "none.png"), 0);
    assert_eq!((loaded.scene.name.as_str(), loaded.scene.cameras.len()), ("s", 1));
    let again = loads(&path);
    assert_eq!(loaded.scene.content_hash, again.scene.content_hash);
    place.write("maps/wood 1.png", png(4, 2, [254, 0, 0, 255]));
    assert_ne!(loads(&path).scene.content_hash, again.scene.content_hash);
}

/// Names of OBJ files are things, diffuse or not; the same name later in a file is the same thing, in another file another.
#[test]
fn names_of_obj_files_are_things() {
    let place = TempFolder::new("things");
    place.write("a.obj", format!("o chair\n{TRIANGLE}g seat\nf 1 2 3\no chair\nf 1 2 3\n"));
    place.write("b.obj", format!("{TRIANGLE}o chair\nf 1 2 3\n"));
    let toml = place.write("s.toml", "format = 1\n[geometry]\nfiles = [\"a.obj\", \"b.obj\"]\n");
    let scene = loads(&toml).scene;
    assert_eq!(scene.objects.len(), 1);
    let of = |t: u32| scene.things.at(t).map(|thing| thing.path.as_str());
    let paths: Vec<Option<&str>> = (0..5).map(of).collect();
    assert_eq!(paths, [Some("chair"), Some("seat"), Some("chair"), Some("b"), Some("chair#2")]);
    assert_eq!(scene.things.at(0).map(|thing| thing.triangles), Some(2));
}

#[test]
fn a_sidecar_beside_or_instead() {
    let place = TempFolder::new("sidecar");
    let obj = place.write("s.obj", format!("usemtl a\n{TRIANGLE}"));
    let toml = place.write(
        "s.toml",
        "format = 1\ntitle = \"T\"\n[geometry]\nfiles = [\"s.obj\", \"parts/b.obj\"]\n[material.\"a\"]\nmodel = \"mirror\"\n\
         [material.\"typo\"]\nmodel = \"mirror\"\n[environment]\nmap = \"no.exr\"\n",
    );
    place.write("parts/b.obj", format!("mtllib b.mtl\nusemtl b\n{TRIANGLE}usemtl a\nf 1 2 3\n"));
    place.write("parts/b.mtl", "newmtl b\nmap_Kd t.png\nnewmtl a\nKd 1 0 0\n");
    place.write("parts/t.png", png(1, 1, [0, 255, 0, 255]));
    for path in [obj, toml] {
        let loaded = loads(&path);
        let names: Vec<&str> = loaded.scene.materials.iter().map(|m| m.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "a (2)"]);
        // The sidecar speaks for the name, whichever file uses it.
        assert!(matches!(loaded.scene.materials[0].model, Model::Mirror { .. }));
        assert!(matches!(loaded.scene.materials[2].model, Model::Mirror { .. }));
        assert_eq!(loaded.scene.textures.len(), 1);
        assert_eq!((loaded.scene.title.as_str(), loaded.scene.mesh.triangles.len()), ("T", 3));
        assert_eq!(said(&loaded, "typo"), 1);
        assert_eq!(said(&loaded, "no.exr"), 1);
        // One object for each of the two, since they are two materials.
        assert_eq!(loaded.scene.objects.len(), 3);
    }
}

#[test]
fn missing_things_are_named_with_who_asked() {
    let place = TempFolder::new("missing");
    let toml = place.write("s.toml", "format = 1\n[geometry]\nfiles = [\n \"gone.obj\"]\n");
    let error = load(&toml).unwrap_err().to_string();
    assert!(error.contains("s.toml:4") && error.contains("gone.obj"), "{error}");
    let alone = place.write("t.toml", "format = 1\n");
    let error = load(&alone).unwrap_err().to_string();
    assert!(error.contains("t.toml") && error.contains("t.obj"), "{error}");
    let error = load(&place.0.join("never.obj")).unwrap_err().to_string();
    assert!(error.contains("never.obj") && error.contains("does not exist"), "{error}");
    assert!(matches!(load(&place.0), Err(SceneError::UnknownFormat { .. })));
    std::fs::create_dir(place.0.join("folder.obj")).unwrap();
    assert!(load(&place.0.join("folder.obj")).is_err());

    let path = place
        .write("s2.obj", format!("mtllib no.mtl\nmtllib m.mtl\nusemtl x\n{TRIANGLE}usemtl t\nf 1 2 3\n"));
    place.write("m.mtl", "newmtl t\nKd 0.8 0.8 0.8\nmap_Kd lost.png\n");
    let loaded = loads(&path);
    assert_eq!(said(&loaded, "s2.obj:1: material library \"no.mtl\" does not exist"), 1);
    assert_eq!(said(&loaded, "m.mtl:3: texture \"lost.png\" does not exist"), 1);
    assert_eq!(said(&loaded, "s2.obj:3: no material library has \"x\""), 1);
    // What is lost is seen to be lost.
    let checker = Reflectance { color: Vec3::splat(0.8), map: Some(TextureId(0)) };
    assert_eq!(loaded.scene.materials[1].model, Model::Lambert { albedo: checker });
    let texture = &loaded.scene.textures[0];
    assert_eq!(texture.name, "lost.png");
    assert_ne!(texture.texel(0, 0, 0), texture.texel(0, 1, 0));
}

#[test]
fn several_libraries_in_one_line_and_one_with_blanks() {
    let place = TempFolder::new("libraries");
    place.write("a.mtl", "newmtl a\nKd 1 0 0\n");
    place.write("b b.mtl", "newmtl b\nKd 0 1 0\n");
    let path = place.write(
        "s.obj",
        format!("mtllib a.mtl a.mtl\nmtllib b b.mtl\nusemtl a\n{TRIANGLE}usemtl b\nf 1 2 3\n"),
    );
    let loaded = loads(&path);
    let albedo = |i: usize| match &loaded.scene.materials[i].model {
        Model::Lambert { albedo } => albedo.color,
        other => panic!("{other:?}"),
    };
    assert_eq!((albedo(0), albedo(1)), (0.99 * Vec3::X, 0.99 * Vec3::Y));
}

#[test]
fn pictures_that_lie_or_end_early() {
    let place = TempFolder::new("pictures");
    let mut cut = png(64, 64, [9, 8, 7, 255]);
    cut.truncate(cut.len() / 2);
    place.write("cut.png", cut);
    let mut vast = png(1, 1, [0; 4]);
    // Width and height of the header; its check sum follows from neither, which is fine.
    vast[16..24].copy_from_slice(&[0, 0, 0xff, 0xff, 0, 0, 0xff, 0xff]);
    place.write("vast.png", vast);
    place.write("text.png", "no picture");
    place.write("empty.jpg", "");
    place.write("m.mtl", "newmtl a\nmap_Kd cut.png\nmap_Ks vast.png\nmap_Ke text.png\nmap_d empty.jpg\nbump /etc/passwd\nnorm ../m.mtl\n");
    let loaded = loads(&place.write("s.obj", format!("mtllib m.mtl\nusemtl a\n{TRIANGLE}")));
    // Three colours show a checker; mask, bump and normal map are left out.
    assert_eq!(loaded.scene.textures.len(), 3);
    let m = &loaded.scene.materials[0];
    assert_eq!((m.opacity_map, m.bump_map, m.normal_map), (None, None, None));
    for name in ["cut.png", "vast.png", "text.png", "empty.jpg", "/etc/passwd", "../m.mtl"] {
        assert_eq!(said(&loaded, name), 1, "{name}: {:#?}", loaded.warnings);
    }
}

#[test]
fn pictures_share_the_limit_on_memory() {
    let place = TempFolder::new("limit");
    place.write("a.png", png(8, 8, [1; 4]));
    place.write("b.png", png(8, 8, [2; 4]));
    place.write("m.mtl", "newmtl a\nmap_Kd a.png\nmap_Ks a.png\nmap_Ke b.png\n");
    let path = place.write("s.obj", format!("mtllib m.mtl\nusemtl a\n{TRIANGLE}"));
    let options = LoadOptions { texture_bytes_max: 300, ..Default::default() };
    let loaded = load_with(&path, &options).unwrap();
    let names: Vec<&str> = loaded.scene.textures.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(names, ["a.png", "b.png"]);
    let corner = |t: usize, x: usize| loaded.scene.textures[t].texel(0, x, 0);
    assert!(corner(0, 0) == corner(0, 1) && corner(1, 0) != corner(1, 1), "the second is a checker");
    assert_eq!(said(&loaded, "one too many"), 1);
    let options = LoadOptions { file_bytes_max: 20, ..Default::default() };
    assert!(load_with(&path, &options).unwrap_err().to_string().contains("limit of 20"));
}

#[test]
fn environment_maps_are_cleaned() {
    let place = TempFolder::new("sky");
    place.write("s.obj", TRIANGLE);
    let values = [1.0f32, 2.0, 3.0, f32::NAN, 1.0, 1.0, f32::INFINITY, 0.0, 0.0, -1.0, 5.0, 5.0];
    let sky = image::Rgb32FImage::from_vec(2, 2, values.to_vec()).unwrap();
    image::DynamicImage::from(sky).save(place.0.join("sky.exr")).unwrap();
    let text = "format = 1\n[environment]\nmap = \"sky.exr\"\nscale = 2.0\n";
    let loaded = loads(&place.write("s.toml", text));
    assert_eq!(said(&loaded, "3 texels are negative, NaN or infinite"), 1, "{:#?}", loaded.warnings);
    assert_eq!(said(&loaded, "no light"), 0);
    let e = loaded.scene.environment.clone().unwrap();
    let map = e.map.as_ref().unwrap();
    assert_eq!(map.at(0, 0), Vec3::new(1.0, 2.0, 3.0));
    assert_eq!(map.at(1, 0), Vec3::new(0.0, 1.0, 1.0));
    assert_eq!(map.at(1, 1), Vec3::new(0.0, 5.0, 5.0));
    assert_eq!(e.radiance, Vec3::splat(2.0));
}

#[test]
fn glass_filters_become_absorption_by_length() {
    let place = TempFolder::new("glass");
    place.write("m.mtl", "newmtl g\nillum 7\nNi 1.5\nTf 0.25 0.25 0.25\n");
    // A cube of side 2: mean chord 4 · 8 / 24 = 4 / 3.
    let cube = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nv 0 0 2\nv 2 0 2\nv 2 2 2\nv 0 2 2\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let loaded = loads(&place.write("s.obj", format!("mtllib m.mtl\nusemtl g\n{cube}")));
    let Model::Dielectric { transmittance, .. } = loaded.scene.materials[0].model else { panic!("no glass") };
    assert!((transmittance.x - math::powf(0.25f32, 0.75)).abs() < 1e-4, "{transmittance}");
}

/// A folder of the shared scenes, beside the checkout or beside the folder that holds it.
fn shared(name: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let places =
        ["../../../shared/scenes/plain", "../../../../shared/scenes/plain"].map(|p| root.join(p).join(name));
    let found = places.into_iter().find(|p| p.is_dir());
    if found.is_none() {
        eprintln!("skipped: no shared scenes beside the checkout");
    }
    found
}

/// Every `.obj` and `.toml` under a folder.
fn scene_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let mut entries: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            scene_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "obj" || e == "toml") {
            out.push(path);
        }
    }
}

#[test]
fn shared_hostile_files_give_a_scene_or_a_message() {
    let Some(folder) = shared("") else { return };
    let mut files = Vec::new();
    scene_files(&folder, &mut files);
    assert!(!files.is_empty());
    for path in files {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        match load(&path) {
            Ok(loaded) => {
                promises(&loaded.scene);
                assert!(loaded.warnings.iter().all(|w| !w.to_string().contains("root:x:")));
            }
            Err(e) => assert!(e.to_string().contains(&stem), "{}: {e}", path.display()),
        }
    }
}

#[test]
fn shared_hand_made_files_end_as_their_readme_says() {
    let Some(folder) = shared("hostile-made") else { return };
    let refused = [
        "empty.obj",
        "only-comments.obj",
        "unknown-key.toml",
        "wrong-type.toml",
        "missing-mesh.toml",
        "fov-0.toml",
        "fov-180.toml",
        "camera-twice.toml",
        "format-2.toml",
        "no-format.toml",
        "empty.toml",
        "eye-is-target.toml",
        "scale-1e-30.obj",
    ];
    let mut files = Vec::new();
    scene_files(&folder, &mut files);
    for path in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let outcome = load(&path);
        assert_eq!(outcome.is_err(), refused.contains(&name.as_str()), "{name}: {:?}", outcome.err());
        let Ok(loaded) = outcome else { continue };
        let triangles = loaded.scene.mesh.triangles.len();
        match name.as_str() {
            "bom.obj"
            | "continuation.obj"
            | "coordinates-1e30.obj"
            | "index-4294967295.obj"
            | "negative-before-start.obj"
            | "normals-nan.obj" => assert_eq!(triangles, 1, "{name}"),
            "face-10000.obj" => assert_eq!(triangles, 9_998),
            "texture-utf8.obj" => assert_eq!(loaded.scene.textures.len(), 1),
            "texture-escapes.obj" => assert_eq!(said(&loaded, "passwd"), 1),
            "texture-cut.obj" => assert_eq!(said(&loaded, "cut.png"), 1),
            "texture-vast.obj" => assert_eq!(said(&loaded, "vast.png"), 1),
            "path-one-key.toml" => assert_eq!(loaded.scene.paths[0].duration(), 0.0),
            _ => {}
        }
    }
}

#[test]
fn unpacked_shared_scenes_load() {
    // A folder that `unpack` of the shared scenes has filled; too large for every run of the tests.
    let Some(folder) = std::env::var_os("FOVEAL_SCENES") else {
        eprintln!("skipped: FOVEAL_SCENES names no folder of unpacked scenes");
        return;
    };
    let mut files = Vec::new();
    scene_files(Path::new(&folder), &mut files);
    assert!(!files.is_empty());
    for path in files {
        match load(&path) {
            Ok(l) => {
                promises(&l.scene);
                let s = &l.scene;
                eprintln!(
                    "{}: {} triangles, {} materials, {} textures, {} objects, {} warnings",
                    path.display(),
                    s.mesh.triangles.len(),
                    s.materials.len(),
                    s.textures.len(),
                    s.objects.len(),
                    l.warnings.len()
                );
                for w in l.warnings.iter().take(5) {
                    eprintln!("    {w}");
                }
            }
            Err(e) => eprintln!("{}: refused: {e}", path.display()),
        }
    }
}

/// A light whose winding says "up" and whose normals say "down" shines down.
#[test]
fn faces_wound_against_their_normals_are_turned() {
    let place = TempFolder::new("winding");
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 -1\nvn 0 0 1\nf 1//1 2//1 3//1\nf 1//2 2//2 3//2\nf 1//1 2//2 3//2\n";
    let loaded = load(&place.write("a.obj", obj)).unwrap();
    let mesh = &loaded.scene.mesh;
    let up: Vec<bool> = (0..3)
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a).z > 0.0
        })
        .collect();
    assert_eq!(up, [false, true, true]);
    assert!(loaded.warnings.iter().any(|w| w.to_string().contains("1 triangle wound against")));
}
