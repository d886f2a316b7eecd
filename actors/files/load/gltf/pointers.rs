//! What an animation moves besides transforms (`KHR_animation_pointer`): visibility, lights, colours, fields of view. A
//! document is changed to what it says at the shown time before anything else of it is read.

use super::animation::Property;
use super::document::{Document, EmissiveStrength, NodeExtensions, Visibility};

/// A place in a document that a JSON pointer names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// A node's transform, or the weights of its mesh.
    Node(u32, Property),
    Value(Value),
}

/// A value that is no transform, of the element at that index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Value {
    Visible(u32),
    LightColor(u32),
    LightIntensity(u32),
    BaseColor(u32),
    EmissiveFactor(u32),
    EmissiveStrength(u32),
    FieldOfView(u32),
}

impl Value {
    /// Numbers that it has.
    pub fn width(self) -> usize {
        match self {
            Self::BaseColor(_) => 4,
            Self::LightColor(_) | Self::EmissiveFactor(_) => 3,
            Self::Visible(_) | Self::LightIntensity(_) | Self::EmissiveStrength(_) | Self::FieldOfView(_) => {
                1
            }
        }
    }
}

/// What a pointer names; `None` where this build shows no change of it.
pub(super) fn named(pointer: &str) -> Option<Place> {
    let mut words = pointer.strip_prefix('/')?.splitn(3, '/');
    let (first, second, rest) = (words.next()?, words.next()?, words.next()?);
    if first == "extensions" {
        let rest = rest.strip_prefix("lights/").filter(|_| second == "KHR_lights_punctual")?;
        let (index, what) = rest.split_once('/')?;
        let index = index.parse().ok()?;
        return match what {
            "color" => Some(Place::Value(Value::LightColor(index))),
            "intensity" => Some(Place::Value(Value::LightIntensity(index))),
            _ => None,
        };
    }
    let index = second.parse().ok()?;
    let node = |property| Some(Place::Node(index, property));
    let value = |value| Some(Place::Value(value));
    match (first, rest) {
        ("nodes", "translation") => node(Property::Translation),
        ("nodes", "rotation") => node(Property::Rotation),
        ("nodes", "scale") => node(Property::Scale),
        ("nodes", "weights") => node(Property::Weights),
        ("nodes", "extensions/KHR_node_visibility/visible") => value(Value::Visible(index)),
        ("materials", "pbrMetallicRoughness/baseColorFactor") => value(Value::BaseColor(index)),
        ("materials", "emissiveFactor") => value(Value::EmissiveFactor(index)),
        ("materials", "extensions/KHR_materials_emissive_strength/emissiveStrength") => {
            value(Value::EmissiveStrength(index))
        }
        ("cameras", "perspective/yfov") => value(Value::FieldOfView(index)),
        _ => None,
    }
}

/// Sets a value, as far as the document has such an element. `to` has as many numbers as the value.
pub(super) fn set(document: &mut Document, value: Value, to: &[f32]) {
    let at = |i: u32| i as usize;
    let [first, ..] = *to else { return };
    match value {
        Value::Visible(i) => {
            if let Some(node) = document.nodes.get_mut(at(i)) {
                let extensions = node.extensions.get_or_insert_with(|| Box::new(NodeExtensions::default()));
                extensions.visibility = Some(Visibility { visible: first != 0.0 });
            }
        }
        Value::LightColor(i) | Value::LightIntensity(i) => {
            let lights = document.extensions.lights.as_mut();
            if let Some(light) = lights.and_then(|l| l.lights.get_mut(at(i))) {
                match (value, to) {
                    (Value::LightColor(_), &[r, g, b]) => light.color = [r, g, b],
                    _ => light.intensity = first,
                }
            }
        }
        Value::BaseColor(i) | Value::EmissiveFactor(i) | Value::EmissiveStrength(i) => {
            if let Some(material) = document.materials.get_mut(at(i)) {
                match (value, to) {
                    (Value::BaseColor(_), &[r, g, b, a]) => {
                        material.pbr_metallic_roughness.base_color_factor = [r, g, b, a];
                    }
                    (Value::EmissiveFactor(_), &[r, g, b]) => material.emissive_factor = [r, g, b],
                    _ => {
                        let strength = EmissiveStrength { emissive_strength: first };
                        material.extensions.emissive_strength = Some(strength);
                    }
                }
            }
        }
        Value::FieldOfView(i) => {
            let camera = document.cameras.get_mut(at(i));
            if let Some(view) = camera.and_then(|c| c.perspective.as_mut()) {
                view.yfov = first;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pointers_name_what_is_shown_and_nothing_else() {
        assert_eq!(named("/nodes/7/rotation"), Some(Place::Node(7, Property::Rotation)));
        assert_eq!(
            named("/extensions/KHR_lights_punctual/lights/2/intensity"),
            Some(Place::Value(Value::LightIntensity(2)))
        );
        assert_eq!(named("/materials/0/emissiveFactor"), Some(Place::Value(Value::EmissiveFactor(0))));
        for bad in [
            "",
            "/",
            "nodes/1/scale",
            "/nodes/x/scale",
            "/nodes/-1/scale",
            "/nodes/1/matrix",
            "/nodes/1",
            "/textures/0/extensions/KHR_texture_transform/offset",
            "/nodes/99999999999/scale",
        ] {
            assert_eq!(named(bad), None, "{bad}");
        }
    }

    #[test]
    fn values_that_there_are_are_set() {
        let mut document: Document = serde_json::from_str(
            r#"{"asset": {"version": "2.0"}, "nodes": [{}], "materials": [{}],
            "cameras": [{"type": "perspective", "perspective": {"yfov": 1}}],
            "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}}"#,
        )
        .unwrap();
        let changes: [(Value, &[f32]); 9] = [
            (Value::Visible(0), &[0.0]),
            (Value::LightColor(0), &[0.1, 0.2, 0.3]),
            (Value::LightIntensity(0), &[7.0]),
            (Value::BaseColor(0), &[0.1, 0.2, 0.3, 0.4]),
            (Value::EmissiveFactor(0), &[0.5, 0.6, 0.7]),
            (Value::EmissiveStrength(0), &[3.0]),
            (Value::FieldOfView(0), &[0.5]),
            (Value::FieldOfView(9), &[0.1]),
            (Value::Visible(u32::MAX), &[]),
        ];
        changes.into_iter().for_each(|(value, to)| set(&mut document, value, to));
        let light = &document.extensions.lights.as_ref().unwrap().lights[0];
        assert_eq!((light.color, light.intensity), ([0.1, 0.2, 0.3], 7.0));
        let material = &document.materials[0];
        assert_eq!(material.pbr_metallic_roughness.base_color_factor, [0.1, 0.2, 0.3, 0.4]);
        assert_eq!(material.emissive_factor, [0.5, 0.6, 0.7]);
        assert_eq!(material.extensions.emissive_strength.as_ref().unwrap().emissive_strength, 3.0);
        assert_eq!(document.cameras[0].perspective.as_ref().unwrap().yfov, 0.5);
        assert!(!document.nodes[0].extensions.as_ref().unwrap().visibility.as_ref().unwrap().visible);
    }
}
