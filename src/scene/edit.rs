//! Changes of a scene that was read: what its lamps emit, and where those without area are.
//!
//! Edits are absolute, against what the files say, so that of two edits of one thing the newer one is enough, and the
//! order of edits of different things means nothing. An edited scene is a scene like any other: a bake, a reference, a
//! recording of it are those of files that say the same.
//!
//! Deliberately absent: whatever changes geometry or reflectance. It will come as further kinds of edits.

use std::fmt;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{Light, Scene};

/// Something that emits light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Lamp {
    /// All triangles of a material: an index into [`SceneParts::materials`](super::SceneParts::materials).
    Material(u32),
    /// A light without area: an index into [`SceneParts::lights`](super::SceneParts::lights).
    Light(u32),
    /// The environment.
    Environment,
}

/// One change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum SceneEdit {
    /// A lamp emits `gain` times, per band, what the files say: 0 is off, 1 takes the edit back.
    LampDimmed {
        /// Which lamp.
        lamp: Lamp,
        /// The factor, from 0 to [`GAIN_MAX`].
        gain: Vec3,
    },
    /// A light without area is here now. A point light keeps no direction and a directional one no position: what it has
    /// not is not looked at.
    LightMoved {
        /// Which of [`SceneParts::lights`](super::SceneParts::lights).
        light: u32,
        /// Position, scene units.
        position: Vec3,
        /// Axis of its cone, or direction of travel; need not be unit.
        direction: Vec3,
    },
}

/// Most by which a lamp is made brighter.
pub const GAIN_MAX: f32 = 1e6;

/// Why an edit is not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum EditError {
    /// The scene has no such lamp, or it emits nothing that could be dimmed.
    NoLamp(Lamp),
    /// A factor that is negative, too large, or no number.
    Gain(Vec3),
    /// A position that is not finite, or a direction without one.
    Place {
        /// The position.
        position: Vec3,
        /// The direction.
        direction: Vec3,
    },
}

impl fmt::Display for EditError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLamp(Lamp::Material(i)) => write!(f, "no material {i} that emits light"),
            Self::NoLamp(Lamp::Light(i)) => write!(f, "no light {i}"),
            Self::NoLamp(Lamp::Environment) => f.write_str("no light comes from the environment"),
            Self::Gain(gain) => write!(f, "a lamp cannot emit {gain} times as much: 0 to {GAIN_MAX} are"),
            Self::Place { position, direction } => {
                write!(f, "no light can be at {position} and shine along {direction}")
            }
        }
    }
}

impl std::error::Error for EditError {}

impl SceneEdit {
    /// Whether it changes what `other` changed, so that nothing of the other one is left.
    pub fn replaces(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::LampDimmed { lamp: a, .. }, Self::LampDimmed { lamp: b, .. }) => a == b,
            (Self::LightMoved { light: a, .. }, Self::LightMoved { light: b, .. }) => a == b,
            _ => false,
        }
    }

    /// Whether it leaves things as the files have them.
    fn is_nothing(&self) -> bool {
        matches!(self, Self::LampDimmed { gain: Vec3::ONE, .. })
    }

    /// By what it changes.
    fn rank(&self) -> (u8, Lamp) {
        match self {
            Self::LampDimmed { lamp, .. } => (0, *lamp),
            Self::LightMoved { light, .. } => (1, Lamp::Light(*light)),
        }
    }
}

/// Adds an edit to others, in the one order that the same changes have however they came about.
pub fn add(edits: &mut Vec<SceneEdit>, edit: SceneEdit) {
    edits.retain(|other| !edit.replaces(other));
    if !edit.is_nothing() {
        edits.push(edit);
        edits.sort_by_key(SceneEdit::rank);
    }
}

/// What a light emits: intensity, or irradiance where it is parallel.
fn power(light: &mut Light) -> &mut Vec3 {
    match light {
        Light::Point { intensity, .. } | Light::Spot { intensity, .. } => intensity,
        Light::Directional { irradiance, .. } => irradiance,
    }
}

/// What of a scene edits change, as its files have it.
#[derive(Clone, Debug)]
pub struct AsRead {
    content_hash: [u8; 32],
    emissions: Vec<Vec3>,
    lights: Vec<Light>,
    environment: Option<Vec3>,
}

impl AsRead {
    /// Of a scene that was not edited.
    pub fn of(scene: &Scene) -> Self {
        Self {
            content_hash: scene.content_hash,
            emissions: scene.materials.iter().map(|m| m.emission.color).collect(),
            lights: scene.lights.clone(),
            environment: scene.environment.as_ref().map(|e| e.radiance),
        }
    }

    /// All that can be dimmed.
    pub fn lamps(&self) -> impl Iterator<Item = Lamp> {
        let emits = |(_, emission): &(usize, &Vec3)| emission.max_element() > 0.0;
        let materials =
            self.emissions.iter().enumerate().filter(emits).map(|(i, _)| Lamp::Material(i as u32));
        let lights = (0..self.lights.len()).map(|i| Lamp::Light(i as u32));
        materials.chain(lights).chain(self.environment.map(|_| Lamp::Environment))
    }

    /// What [`SceneParts::content_hash`](super::SceneParts::content_hash) is after these edits.
    pub fn hash(&self, edits: &[SceneEdit]) -> [u8; 32] {
        if edits.is_empty() {
            return self.content_hash;
        }
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"foveal edited scene");
        hasher.update(&self.content_hash);
        hasher.update(&postcard::to_stdvec(edits).unwrap_or_default());
        *hasher.finalize().as_bytes()
    }

    /// `scene` with these edits and no others, whichever it had.
    ///
    /// # Errors
    /// If one of them cannot be made.
    pub fn edited(&self, scene: &Scene, edits: &[SceneEdit]) -> Result<Scene, EditError> {
        let Self { content_hash: _, mut emissions, mut lights, mut environment } = self.clone();
        for edit in edits {
            match *edit {
                SceneEdit::LampDimmed { gain, .. }
                    if !(gain.cmpge(Vec3::ZERO).all() && gain.max_element() <= GAIN_MAX) =>
                {
                    return Err(EditError::Gain(gain));
                }
                SceneEdit::LampDimmed { lamp, gain } => {
                    let emits = |c: &&mut Vec3| c.max_element() > 0.0;
                    *match lamp {
                        Lamp::Material(i) => emissions.get_mut(i as usize).filter(emits),
                        Lamp::Light(i) => lights.get_mut(i as usize).map(power),
                        Lamp::Environment => environment.as_mut(),
                    }
                    .ok_or(EditError::NoLamp(lamp))? *= gain;
                }
                SceneEdit::LightMoved { light, position: to, direction: along } => {
                    let lamp = Lamp::Light(light);
                    let light = lights.get_mut(light as usize).ok_or(EditError::NoLamp(lamp))?;
                    let wrong = EditError::Place { position: to, direction: along };
                    let unit = along.try_normalize().ok_or(wrong);
                    match light {
                        Light::Point { position, .. } => *position = to,
                        Light::Spot { position, direction, .. } => (*position, *direction) = (to, unit?),
                        Light::Directional { direction, .. } => *direction = unit?,
                    }
                    if !to.is_finite() && !matches!(light, Light::Directional { .. }) {
                        return Err(wrong);
                    }
                }
            }
        }
        let mut edited = scene.clone();
        for (material, emission) in edited.materials.iter_mut().zip(emissions) {
            material.emission.color = emission;
        }
        edited.lights = lights;
        if let (Some(environment), Some(radiance)) = (&mut edited.environment, environment) {
            environment.radiance = radiance;
        }
        edited.content_hash = self.hash(edits);
        Ok(edited)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::{Mesh, Reflectance};

    /// A lamp of material 1 and parallel light.
    fn lit() -> Scene {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::ZERO, Vec3::ONE, 0, false);
        let mut lamp = grey();
        lamp.emission = Reflectance::constant(Vec3::new(4.0, 2.0, 1.0));
        let mut lit = scene(mesh, vec![grey(), lamp]);
        lit.lights = vec![Light::Directional { direction: Vec3::Y, irradiance: Vec3::ONE }];
        lit.content_hash = [7; 32];
        lit
    }

    #[test]
    fn edits_are_absolute_and_taken_back() {
        let read = AsRead::of(&lit());
        assert_eq!(read.lamps().collect::<Vec<_>>(), [Lamp::Material(1), Lamp::Light(0)]);
        let dim = |gain: f32| SceneEdit::LampDimmed { lamp: Lamp::Material(1), gain: Vec3::splat(gain) };
        let mut edits = Vec::new();
        let mut now = lit();
        for (gain, expected) in [(0.5, 2.0), (0.25, 1.0), (0.0, 0.0), (2.0, 8.0)] {
            add(&mut edits, dim(gain));
            assert_eq!(edits.len(), 1, "the newest is enough");
            now = read.edited(&now, &edits).expect("a lamp");
            assert_eq!(now.materials[1].emission.color.x, expected);
            assert_ne!(now.content_hash, lit().content_hash);
        }
        add(&mut edits, dim(1.0));
        assert_eq!(edits, []);
        now = read.edited(&now, &edits).expect("nothing");
        assert_eq!((now.materials[1].emission.color.x, now.content_hash), (4.0, lit().content_hash));
    }

    #[test]
    fn the_same_changes_are_the_same_scene() {
        let moved = SceneEdit::LightMoved { light: 0, position: Vec3::ZERO, direction: Vec3::X * 3.0 };
        let off = SceneEdit::LampDimmed { lamp: Lamp::Light(0), gain: Vec3::ZERO };
        let (mut there, mut back) = (vec![], vec![]);
        [moved, off].into_iter().for_each(|e| add(&mut there, e));
        [off, moved].into_iter().for_each(|e| add(&mut back, e));
        assert_eq!(there, back);
        let edited = AsRead::of(&lit()).edited(&lit(), &there).expect("a light");
        assert_eq!(edited.lights, [Light::Directional { direction: Vec3::X, irradiance: Vec3::ZERO }]);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let refused = |edit| AsRead::of(&lit()).edited(&lit(), &[edit]).map(drop);
        let dim = |lamp, gain| SceneEdit::LampDimmed { lamp, gain };
        for lamp in [Lamp::Material(0), Lamp::Material(9), Lamp::Light(1), Lamp::Environment] {
            assert_eq!(refused(dim(lamp, Vec3::ONE)), Err(EditError::NoLamp(lamp)));
        }
        for wrong in [-1.0, 2.0 * GAIN_MAX, f32::INFINITY] {
            let gain = Vec3::new(1.0, wrong, 1.0);
            assert_eq!(refused(dim(Lamp::Light(0), gain)), Err(EditError::Gain(gain)));
        }
        assert!(refused(dim(Lamp::Light(0), Vec3::NAN)).is_err());
        let moved = |direction| SceneEdit::LightMoved { light: 0, position: Vec3::NAN, direction };
        assert!(refused(moved(Vec3::ZERO)).is_err() && refused(moved(Vec3::NAN)).is_err());
        assert!(refused(moved(Vec3::ONE)).is_ok(), "what is far away has no position");
    }
}
