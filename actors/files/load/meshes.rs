//! The meshes of a scene, one file after the other, and the material libraries that they name.

use std::path::{Path, PathBuf};

use super::ahead;
use super::assemble::Joined;
use super::error::{FileProblem, Place, SceneError, Warning};
use super::folder::Folder;
use super::mtl::{self, MtlMaterial};
use super::sidecar::Sidecar;
use super::{LoadOptions, MESHES, file_name, gltf, obj};

/// Reads all meshes and the MTL files that they name.
pub(super) fn read_meshes(
    path: &Path,
    is_mesh: bool,
    sidecar_path: &Path,
    sidecar: &Sidecar,
    folder: &mut Folder,
    options: &LoadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Joined, SceneError> {
    let given = file_name(path);
    let mut joined = Joined::default();
    let beside = if sidecar.files.is_none() && !is_mesh {
        MESHES.iter().map(|e| path.with_extension(e)).find(|p| folder.is_file(&file_name(p)))
    } else {
        None
    };
    let mut read = |name: &str, asked_by, joined: &mut Joined, warnings: &mut Vec<Warning>| {
        let source = MeshSource { name, asked_by, sidecar, options };
        read_mesh(&source, folder, joined, warnings)
    };
    let Some(files) = &sidecar.files else {
        let (name, asked_by) = if is_mesh {
            (given, None)
        } else {
            let name = file_name(&beside.unwrap_or_else(|| path.with_extension("obj")));
            (name, Some(Place::new(sidecar_path, 0)))
        };
        read(&name, asked_by, &mut joined, warnings)?;
        return Ok(joined);
    };
    if is_mesh && !files.iter().any(|f| f.name == given) {
        let message =
            format!("does not list \"{given}\" under [geometry] files; its own list is loaded instead");
        warnings.push(Warning::new(Place::new(sidecar_path, 0), message));
    }
    for file in files {
        read(&file.name, Some(file.place.clone()), &mut joined, warnings)?;
    }
    Ok(joined)
}

/// A mesh to be read, and how.
struct MeshSource<'a> {
    name: &'a str,
    asked_by: Option<Place>,
    sidecar: &'a Sidecar,
    options: &'a LoadOptions,
}

fn read_mesh(
    source: &MeshSource<'_>,
    folder: &mut Folder,
    joined: &mut Joined,
    warnings: &mut Vec<Warning>,
) -> Result<(), SceneError> {
    let shown = folder.show(source.name);
    let refuse =
        |problem| SceneError::File { path: shown.clone(), problem, asked_by: source.asked_by.clone() };
    let found = folder.find(Path::new(""), source.name).map_err(refuse)?;
    let bytes = folder.read(&found).map_err(refuse)?;
    let relative = PathBuf::from(folder.relative(&found));
    let base = relative.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let is_gltf =
        found.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb") || e.eq_ignore_ascii_case("gltf"));
    if is_gltf {
        let choices = &source.sidecar.gltf;
        let file = gltf::parse(&bytes, &shown, &base, folder, choices, source.options, warnings)?;
        drop(bytes);
        joined.own.any = true;
        joined.own.lights.extend(file.lights);
        joined.own.cameras.extend(file.cameras);
        joined.own.paths.extend(file.paths);
        joined.own.extensions.extend(file.extensions);
        let cube_map = file.cube_map.map(|cube_map| (cube_map, Place::new(&shown, 0)));
        joined.own.cube_map = joined.own.cube_map.take().or(cube_map);
        let library =
            Library { relative, shown: shown.clone(), materials: Definitions::Gltf(file.materials) };
        joined.add(file.mesh, shown, base, vec![library]);
        return Ok(());
    }
    let pictures = ahead::of_obj(&bytes, &base, source.sidecar, folder);
    let ahead = &mut joined.ahead;
    let (file, ()) =
        rayon::join(|| obj::parse(&bytes, &shown, warnings), || ahead.decode(pictures, source.options));
    let file = file?;
    drop(bytes);
    let mut libraries = Vec::new();
    for (text, line) in &file.libraries {
        let is_there = |base: &Path, name: &str| folder.find(base, name) != Err(FileProblem::Missing);
        for library in library_names(&base, text, is_there) {
            let place = Place::new(&shown, *line);
            let read = folder.find(&base, &library).and_then(|f| Ok((folder.read(&f)?, f)));
            match read {
                Ok((bytes, f)) => {
                    let relative = PathBuf::from(folder.relative(&f));
                    let shown = folder.show(&relative.to_string_lossy());
                    let materials = Definitions::Mtl(mtl::parse(&bytes, &shown, warnings));
                    libraries.push(Library { relative, shown, materials });
                }
                Err(problem) => {
                    let message = format!("material library \"{library}\" {problem}; its materials are grey");
                    warnings.push(Warning::new(place, message));
                }
            }
        }
    }
    joined.add(file, shown, base, libraries);
    Ok(())
}

/// A file with materials.
pub(super) struct Library {
    /// Relative to the scene's folder.
    pub relative: PathBuf,
    pub shown: PathBuf,
    pub materials: Definitions,
}

/// Materials as a file defines them.
pub(super) enum Definitions {
    /// Of an MTL file.
    Mtl(Vec<MtlMaterial>),
    /// Of a glTF file, unique by name.
    Gltf(Vec<gltf::Source>),
}

impl Definitions {
    /// Their names, in order.
    pub fn names(&self) -> Vec<&str> {
        match self {
            Self::Mtl(list) => list.iter().map(|m| m.name.as_str()).collect(),
            Self::Gltf(list) => list.iter().map(|m| m.name.as_str()).collect(),
        }
    }

    /// The line that defines a material; 0 where none does.
    pub fn line_of(&self, name: &str) -> u32 {
        match self {
            Self::Mtl(list) => list.iter().find(|m| m.name == name).map_or(0, |m| m.line),
            Self::Gltf(_) => 0,
        }
    }
}

/// `mtllib` names one file with blanks, or several.
pub(super) fn library_names(base: &Path, text: &str, is_there: impl Fn(&Path, &str) -> bool) -> Vec<String> {
    let whole = text.trim_matches('"');
    if is_there(base, whole) {
        return vec![whole.to_owned()];
    }
    let mut words = escaped_words(text);
    words.dedup();
    let any = words.iter().any(|w| is_there(base, w));
    if any { words } else { vec![whole.to_owned()] }
}

/// Words between blanks; a blank after a backslash belongs to its word.
fn escaped_words(text: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut letters = text.chars().peekable();
    while let Some(c) = letters.next() {
        if c == '\\' && letters.peek() == Some(&' ') {
            letters.next();
            words.last_mut().into_iter().for_each(|w| w.push(' '));
        } else if c.is_whitespace() {
            words.push(String::new());
        } else {
            words.last_mut().into_iter().for_each(|w| w.push(c));
        }
    }
    words.retain(|w| !w.is_empty());
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_part_names_unless_a_backslash_is_before_them() {
        assert_eq!(escaped_words(" a\\ b.mtl  c\\d.mtl\\"), ["a b.mtl", "c\\d.mtl\\"]);
    }
}
