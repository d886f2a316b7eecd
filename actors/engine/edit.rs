//! Changing the scene of a walk.

use std::fmt;

use foveal::scene::edit;

use crate::bake_clock::Watch;
use crate::engine::Engine;
use crate::failure::Failure;

pub use foveal::scene::edit::{Lamp, SceneEdit};

/// Why a scene is left as it is.
#[derive(Debug)]
#[non_exhaustive]
pub enum EditError {
    /// The scene cannot be edited so.
    Scene(edit::EditError),
    /// The walk is recorded, and a recording is of one scene: edits that are there when it begins
    /// ([`Light::edits`](crate::Light::edits)) are part of it.
    Recorded,
    /// The textures do not fit into their limit: what is not in memory cannot be lit anew.
    LimitedTextures,
    /// The scene can be edited so, but not shown.
    Failed(Failure),
}

impl fmt::Display for EditError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scene(error) => write!(f, "{error}"),
            Self::Recorded => {
                f.write_str("a walk that is recorded keeps its scene: edit it before it begins")
            }
            Self::LimitedTextures => f.write_str("a scene whose textures are limited cannot be lit anew"),
            Self::Failed(failure) => write!(f, "{failure}"),
        }
    }
}

impl std::error::Error for EditError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Scene(error) => Some(error),
            Self::Failed(failure) => Some(failure),
            Self::Recorded | Self::LimitedTextures => None,
        }
    }
}

impl From<edit::EditError> for EditError {
    fn from(error: edit::EditError) -> Self {
        Self::Scene(error)
    }
}

impl From<Failure> for EditError {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

impl Engine {
    /// Changes the scene and goes on: with the light that is kept of the changed scene, else with a first estimate of it
    /// (which takes about a second, during which nothing is shown) that becomes better as after [`Engine::open`]. Samples
    /// are traced anew. So a view settles to the bits of a walk that began with this edit.
    ///
    /// # Errors
    /// If the edit is refused, which leaves everything as it was.
    pub fn edit(&mut self, edit: SceneEdit, watch: &dyn Watch) -> Result<(), EditError> {
        if self.is_recorded() {
            return Err(EditError::Recorded);
        }
        let opened = self.opened().edited(edit, watch)?;
        Ok(self.go_on_in(opened, *self.settings())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::{Options, Recording};
    use crate::recording::Elsewhere;
    use crate::replay::{How, Source};
    use crate::{Light, Opened, Settings, opened};
    use foveal_actors::renderer::Renderer;
    use glam::Vec3;
    use std::path::{Path, PathBuf};
    use std::time::Duration;

    /// A floor, a mirror above it and a lamp above both.
    fn scene(folder: &Path) -> PathBuf {
        let quad = |y: f32, size: f32, x: f32, first: usize, material: &str| {
            let corner = |a: f32, b: f32| format!("v {} {y} {}\n", x + a * size, b * size);
            let corners =
                [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(a, b)| corner(a, b)).concat();
            let [a, b, c, d] = [0, 1, 2, 3].map(|i| first + i);
            let face =
                if material == "lamp" { format!("f {d} {c} {b} {a}") } else { format!("f {a} {b} {c} {d}") };
            format!("{corners}usemtl {material}\n{face}\n")
        };
        let parts = [
            quad(0.0, 2.0, 0.0, 1, "floor"),
            quad(0.3, 0.5, 1.0, 5, "mirror"),
            quad(2.0, 0.4, 0.0, 9, "lamp"),
        ];
        std::fs::write(folder.join("a.obj"), format!("mtllib a.mtl\n{}", parts.concat())).expect("written");
        let materials = "newmtl floor\nKd 0.6 0.5 0.4\nnewmtl mirror\nKd 0 0 0\nKs 0.9 0.9 0.9\nNs 1000\nillum 3\n\
                         newmtl lamp\nKd 0 0 0\nKe 5 5 5\n";
        std::fs::write(folder.join("a.mtl"), materials).expect("written");
        folder.join("a.obj")
    }

    fn options() -> Options {
        Options::new(Settings { environment_bytes: 0, ..Settings::new(48, 32, 2) })
    }

    fn open(file: &Path, edits: Vec<SceneEdit>) -> Opened {
        let light = Light { quick: true, edits, ..Light::default() };
        opened::open(file, &light, &()).expect("a scene")
    }

    /// The picture that a walk settles to.
    fn settled(walk: &mut Engine) -> Vec<[u8; 3]> {
        let camera = walk.opened().world.scene.cameras[0].camera;
        walk.begin(&camera).expect("a walk");
        walk.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
        walk.end().expect("a frame").snapshot.rgb8.data().to_vec()
    }

    fn dimmed(opened: &Opened, gain: f32) -> SceneEdit {
        let lamp = opened.world.scene.materials.iter().position(|m| m.is_emissive()).expect("a lamp");
        SceneEdit::LampDimmed { lamp: Lamp::Material(lamp as u32), gain: Vec3::splat(gain) }
    }

    #[test]
    fn an_edited_walk_settles_to_the_bits_of_one_that_began_so() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = scene(folder.path());
        let as_read = open(&file, vec![]);
        let edit = dimmed(&as_read, 0.25);
        let mut walk = Engine::start(as_read.clone(), options()).expect("actors");
        let plain = settled(&mut walk);
        walk.edit(edit, &()).expect("a lamp");
        let dark = settled(&mut walk);
        let sum = |picture: &[[u8; 3]]| picture.iter().flatten().map(|b| u64::from(*b)).sum::<u64>();
        assert!(sum(&dark) < sum(&plain) * 3 / 4, "{} of {}", sum(&dark), sum(&plain));
        let mut begun = Engine::start(open(&file, vec![edit]), options()).expect("actors");
        assert_eq!(settled(&mut begun), dark);
        walk.edit(dimmed(&as_read, 1.0), &()).expect("a lamp");
        assert_eq!(settled(&mut walk), plain, "taken back");
    }

    #[test]
    fn an_edited_walk_is_recorded_and_replays() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = scene(folder.path());
        let edit = dimmed(&open(&file, vec![]), 0.5);
        let trace = folder.path().join("a.fvl");
        let recording = Some(Recording::file(&trace, "test"));
        let mut walk =
            Engine::start(open(&file, vec![edit]), Options { recording, ..options() }).expect("actors");
        settled(&mut walk);
        assert!(matches!(walk.edit(edit, &()), Err(EditError::Recorded)));
        drop(walk);
        let source = Source::open(&trace, &Elsewhere::default(), true, &()).expect("a recording");
        assert_eq!(source.recorded.illumination.edits, [edit]);
        let (mut runtime, _) = source.system(How::default()).expect("a replay");
        let report = runtime.replay();
        assert!(report.complete, "{:?}", report.divergence);
    }

    #[test]
    fn what_is_refused_changes_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut walk = Engine::start(open(&scene(folder.path()), vec![]), options()).expect("actors");
        let plain = settled(&mut walk);
        let gone = SceneEdit::LampDimmed { lamp: Lamp::Light(3), gain: Vec3::ZERO };
        let refused = walk.edit(gone, &()).expect_err("no such lamp");
        assert_eq!(refused.to_string(), "no light 3");
        assert_eq!(settled(&mut walk), plain);
    }
}
