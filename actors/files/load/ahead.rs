//! Pictures decoded while meshes are read.
//!
//! Which pictures materials will ask for is known before the first face: sidecars and MTL files name them, and a look for
//! two words of an OBJ file tells which materials and libraries it uses. That is a guess. What is decoded here and asked for
//! by nobody is dropped, what was not thought of is decoded later, and nothing of it is said or noted before it is asked for:
//! the scene is the same either way.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use foveal::scene::TextureId;
use foveal::scene::texture::MipChain;
use memchr::memmem;
use rayon::prelude::*;

use super::folder::{Folder, read_file};
use super::from_mtl::{self, Doubts};
use super::meshes::library_names;
use super::mtl::{self, MapStatement};
use super::sidecar::Sidecar;
use super::{LoadOptions, textures};

/// Where a picture is, and whether it is a colour.
pub(super) type Key = (PathBuf, bool);

/// Smaller files are read before another thread is awake.
const WORTH: usize = 1 << 20;

/// A picture decoded ahead.
pub(super) struct Picture {
    /// BLAKE3 of its file.
    pub hash: [u8; 32],
    /// Of its pixels.
    pub bytes: u64,
    /// All its levels and whether it has an alpha channel, or why not.
    pub made: Result<(Arc<MipChain>, bool), String>,
}

/// All that was decoded ahead.
#[derive(Default)]
pub(super) struct Ahead(HashMap<Key, Picture>);

impl Ahead {
    /// What was made of a picture, once.
    pub fn take(&mut self, key: &Key) -> Option<Picture> {
        self.0.remove(key)
    }

    /// Decodes pictures in parallel that are not there yet, as far as all of them together keep within the bound.
    pub fn decode(&mut self, keys: Vec<Key>, options: &LoadOptions) {
        let missing: Vec<Key> = keys.into_iter().filter(|key| !self.0.contains_key(key)).collect();
        let read = missing.into_par_iter().filter_map(|key| {
            let contents = read_file(&key.0, options.file_bytes_max).ok()?;
            let bytes = textures::pixel_bytes(&contents.bytes, &key.0, options).ok()?;
            Some((key, contents, bytes))
        });
        let mut left = options.texture_bytes_max.saturating_sub(self.0.values().map(|p| p.bytes).sum());
        let within = read.collect::<Vec<_>>().into_iter().map_while(|(key, contents, bytes)| {
            left = left.checked_sub(bytes)?;
            Some((key, contents, bytes))
        });
        let within: Vec<_> = within.collect();
        let decoded = within.into_par_iter().map(|(key, contents, bytes)| {
            let made = textures::decode(&contents.bytes, &key.0, key.1, options);
            // With its coarser levels: whoever reads the meshes may take longer.
            let made = made.map(|(mips, alpha)| (Arc::new(mips.completed()), alpha));
            (key, Picture { hash: contents.hash, bytes, made })
        });
        self.0.par_extend(decoded);
    }
}

/// The pictures that materials of an OBJ file, which lies in `base`, will most likely ask for.
pub(super) fn of_obj(obj: &[u8], base: &Path, sidecar: &Sidecar, folder: &Folder) -> Vec<Key> {
    if obj.len() < WORTH {
        return Vec::new();
    }
    let used: HashSet<String> = statements(obj, b"usemtl").collect();
    let mut keys = Vec::new();
    let mut known = HashSet::new();
    let mut add = |bases: &[&Path], map: &MapStatement, is_color: bool| {
        let key = bases.iter().find_map(|base| folder.peek(base, &map.file)).map(|found| (found, is_color));
        keys.extend(key.filter(|key| known.insert(key.clone())));
    };
    let own: HashSet<&str> = sidecar.materials.iter().map(|m| m.material.name.as_str()).collect();
    for table in sidecar.materials.iter().filter(|m| used.contains(&m.material.name)) {
        for map in &table.maps {
            add(&[Path::new("")], &map.statement, map.is_color);
        }
    }
    let mut libraries: Vec<String> = statements(obj, b"mtllib").collect();
    libraries.dedup();
    for name in
        libraries.iter().flat_map(|text| library_names(base, text, |b, n| folder.peek(b, n).is_some()))
    {
        let Some(found) = folder.peek(base, &name) else { continue };
        let Ok(contents) = read_file(&found, folder.limit()) else { continue };
        let relative = PathBuf::from(folder.relative(&found));
        let bases = [relative.parent().unwrap_or(Path::new("")), base];
        for material in mtl::parse(&contents.bytes, &found, &mut Vec::new()) {
            if used.contains(&material.name) && !own.contains(material.name.as_str()) {
                let mut ask = |map: &MapStatement, is_color: bool| {
                    add(&bases, map, is_color);
                    TextureId(0)
                };
                from_mtl::material(&material, &mut ask, &mut Doubts::default());
            }
        }
    }
    keys
}

/// What follows a keyword at the start of lines, without blanks around it.
fn statements<'a>(text: &'a [u8], keyword: &'a [u8]) -> impl Iterator<Item = String> + 'a {
    memmem::find_iter(text, keyword).filter_map(move |at| {
        let starts = at == 0 || matches!(text[at - 1], b'\n' | b'\r' | b' ' | b'\t');
        let rest = &text[at + keyword.len()..];
        let end = memchr::memchr2(b'\n', b'\r', rest).unwrap_or(rest.len());
        starts.then(|| String::from_utf8_lossy(&rest[..end]).trim().to_owned())
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::load_with;
    use super::*;

    /// A scene in a folder of its own: pictures of a used and of an unused material and of one that the sidecar replaces, one
    /// that is nowhere, one that is broken, a mask, and a sky.
    fn scene(folder: &Path, padding: usize) -> PathBuf {
        let picture = |name: &str, value: u8| {
            let pixels = image::RgbaImage::from_fn(8, 4, |x, y| image::Rgba([value, x as u8, y as u8, 200]));
            pixels.save(folder.join("maps").join(name)).expect("written");
        };
        fs::create_dir_all(folder.join("maps")).expect("a folder");
        ["wall.png", "unused.png", "replaced.png", "own.png", "mask.png"]
            .iter()
            .zip(1..)
            .for_each(|(n, v)| picture(n, v));
        fs::write(folder.join("maps/broken.png"), b"\x89PNG\r\n\x1a\n no").expect("written");
        let sky = image::Rgb32FImage::from_pixel(4, 2, image::Rgb([1.0, f32::NAN, 2.0]));
        sky.save(folder.join("maps/sky.exr")).expect("written");
        let mtl = "newmtl wall\nmap_Kd wall.png\nmap_d mask.png\nnewmtl rest\nmap_Kd unused.png\nnewmtl chair\n\
            map_Kd replaced.png\nnewmtl lost\nmap_Kd nowhere.png\nmap_Ks broken.png\n";
        fs::write(folder.join("maps/a b.mtl"), mtl).expect("written");
        let obj = "mtllib maps/a b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nusemtl wall\nf 1/1 2/1 3/1\n\
            usemtl  chair \r\nf 1/1 2/1 4/1\nusemtl lost\nf 2/1 3/1 4/1\n";
        let lines = format!("# {}\n", "x".repeat(97));
        fs::write(folder.join("a.obj"), obj.to_owned() + &lines.repeat(padding / lines.len()))
            .expect("written");
        let toml = "format = 1\n[environment]\nmap = \"maps/sky.exr\"\n[material.\"chair\"]\n\
            model = \"lambert\"\nmap_albedo = \"maps/own.png\"\n";
        fs::write(folder.join("a.toml"), toml).expect("written");
        folder.join("a.obj")
    }

    #[test]
    fn a_scene_is_the_same_with_pictures_decoded_ahead() {
        let told = |padding, options: &LoadOptions| {
            let folder = std::env::temp_dir().join(format!("foveal-ahead-{padding}-{}", std::process::id()));
            let loaded = load_with(&scene(&folder, padding), options).expect("a scene");
            fs::remove_dir_all(&folder).expect("removed");
            let textures: Vec<_> = loaded
                .scene
                .textures
                .iter()
                .map(|t| (t.name.clone(), t.mips.content_hash(), t.has_alpha))
                .collect();
            let files: Vec<_> = loaded.files.into_iter().filter(|(name, _)| name != "a.obj").collect();
            let said: Vec<String> = loaded
                .warnings
                .iter()
                .map(|w| w.to_string().replace(&*folder.to_string_lossy(), ""))
                .collect();
            (textures, files, said, loaded.scene.environment.as_ref().and_then(|e| e.map.clone()))
        };
        let all = LoadOptions::default();
        assert!(told(0, &all) == told(2 * WORTH, &all));
        // Room for two pictures of three: the same two.
        let few = LoadOptions { texture_bytes_max: 2 * 8 * 4 * 4, ..all };
        assert!(told(0, &few) == told(2 * WORTH, &few));
    }

    #[test]
    fn only_pictures_of_used_materials_are_thought_of() {
        let folder = std::env::temp_dir().join(format!("foveal-guess-{}", std::process::id()));
        let path = scene(&folder, 2 * WORTH);
        let root = Folder::of(&path, 1 << 30).expect("a folder");
        let sidecar = fs::read(folder.join("a.toml")).expect("read");
        let sidecar = super::super::sidecar::parse(&sidecar, &path).expect("a sidecar");
        let guess = of_obj(&fs::read(&path).expect("read"), Path::new(""), &sidecar, &root);
        let names: Vec<_> = guess.iter().map(|(found, is_color)| (root.relative(found), *is_color)).collect();
        let expected = [("own", true), ("wall", true), ("mask", false), ("broken", true)];
        assert_eq!(names, expected.map(|(name, is_color)| (format!("maps/{name}.png"), is_color)));
        let mut decoded = Ahead::default();
        decoded.decode(guess.clone(), &LoadOptions::default());
        assert_eq!(decoded.0.len(), 3, "what cannot be read is left to those who say so");

        // Another mesh with the same pictures: none is decoded again, and all keep within one bound.
        let two = LoadOptions { texture_bytes_max: 2 * 8 * 4 * 4, ..LoadOptions::default() };
        let mut decoded = Ahead::default();
        decoded.decode(guess[..2].to_vec(), &two);
        let made = |ahead: &Ahead| ahead.0[&guess[0]].made.clone().expect("decoded").0;
        let first = made(&decoded);
        decoded.decode(guess.clone(), &two);
        assert!(decoded.0.len() == 2 && Arc::ptr_eq(&first, &made(&decoded)));
        fs::remove_dir_all(&folder).expect("removed");
    }
}
