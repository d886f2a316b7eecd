//! What can be set while walking, as a table: whoever shows a panel makes it of this one.
//!
//! A row says what a value is called, how far it goes, and how it is read from and written to [`Controls`]. What comes from
//! outside goes through [`Controls::put`], which lets nothing through that no panel could have set.

mod setting;
mod table;

use std::fmt;

use serde::{Deserialize, Serialize};

pub use self::setting::{Setting, help};
use crate::source::{Controls, Ranges};

/// One value that can be set.
#[derive(Debug)]
pub struct Control {
    /// Its name in messages.
    pub key: &'static str,
    /// Its name for people.
    pub label: &'static str,
    /// What it does, in a sentence; empty where the name says it.
    pub help: &'static str,
    /// What it belongs to.
    pub group: &'static str,
    /// What its numbers count; empty where they are bare.
    pub unit: &'static str,
    /// What values it takes.
    pub kind: Kind,
    /// The switch that must be on for it to mean anything.
    pub needs: Option<&'static str>,
    /// Whether it can be set of a recording too, which else is as it was.
    pub of_recordings: bool,
    read: fn(&Controls) -> Value,
    write: fn(&mut Controls, &Value),
}

/// What values a control takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A number between two others.
    Slider {
        /// The least.
        least: f64,
        /// The most.
        most: f64,
        /// Whether equal steps of the slider are equal factors.
        logarithmic: bool,
        /// Whether it is counted.
        whole: bool,
    },
    /// One of these names.
    Choice(&'static [&'static str]),
    /// On or off.
    Switch,
}

/// A value as it travels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// Of a switch.
    Switch(bool),
    /// Of a slider.
    Number(f64),
    /// Of a choice.
    Name(String),
}

impl Value {
    fn number(&self) -> f64 {
        if let Self::Number(number) = self { *number } else { 0.0 }
    }

    fn is_on(&self) -> bool {
        *self == Self::Switch(true)
    }

    fn name(&self) -> &str {
        if let Self::Name(name) = self { name } else { "" }
    }
}

/// Why a value was not set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refused {
    /// There is no such control, or this scene has no use for it.
    Unknown(String),
    /// Not such a value.
    Wrong(&'static str),
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(key) => write!(f, "there is nothing to set called \"{key}\""),
            Self::Wrong(key) => write!(f, "not a value of \"{key}\""),
        }
    }
}

impl std::error::Error for Refused {}

/// All that can be set, in the order of a panel.
pub fn controls() -> &'static [Control] {
    &*table::CONTROLS
}

impl Control {
    /// What values it takes in a walk whose controls go so far; `None` where it has no use there.
    pub fn kind(&self, ranges: &Ranges) -> Option<Kind> {
        Some(match self.key {
            "workers" => table::count(1.0, f64::from(ranges.workers.max(1))),
            "texture_bytes" => {
                let [least, most] = ranges.textures?;
                table::slider(least as f64 / table::MIB, most as f64 / table::MIB)
            }
            _ => self.kind,
        })
    }

    /// Its value.
    pub fn value(&self, controls: &Controls) -> Value {
        (self.read)(controls)
    }
}

impl Controls {
    /// Sets the control of this name. Numbers beyond its ends become these.
    ///
    /// # Errors
    /// If there is none, or it takes no such value; nothing has changed then.
    pub fn put(&mut self, key: &str, value: &Value, ranges: &Ranges) -> Result<(), Refused> {
        let control = controls().iter().find(|control| control.key == key);
        let Some((control, kind)) = control.and_then(|c| c.kind(ranges).map(|kind| (c, kind))) else {
            // Names from outside may be of any length.
            return Err(Refused::Unknown(key.chars().take(32).collect()));
        };
        let taken = match (kind, value) {
            (Kind::Slider { least, most, whole, .. }, Value::Number(number)) if number.is_finite() => {
                let number = number.clamp(least, most.max(least));
                Value::Number(if whole { number.round() } else { number })
            }
            (Kind::Choice(names), Value::Name(name)) if names.contains(&name.as_str()) => value.clone(),
            (Kind::Switch, Value::Switch(_)) => value.clone(),
            _ => return Err(Refused::Wrong(control.key)),
        };
        (control.write)(self, &taken);
        // MiB are rounded to bytes.
        if let (Some([least, most]), Some(bytes)) = (ranges.textures, &mut self.set.texture_bytes) {
            *bytes = (*bytes).clamp(least, most);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use foveal::splatting::supersampling::Supersampling;
    use foveal_actors::renderer::overlay::Overlay;
    use foveal_actors::settings::{Adjustment, Settings};

    use super::*;

    const RANGES: Ranges = Ranges { workers: 8, textures: Some([1 << 20, 64 << 20]) };

    fn start() -> Controls {
        let settings = Settings::new(64, 48, 4);
        let set = Adjustment {
            texture_bytes: Some(8 << 20),
            quality: Some(-1.0),
            refine: Some(Supersampling::default()),
            ..Adjustment::of(&settings, &Default::default())
        };
        Controls { set, overlay: Overlay::None }
    }

    /// A value that is not the present one.
    fn another(control: &Control, now: &Controls) -> Value {
        match (control.kind(&RANGES), control.value(now)) {
            (Some(Kind::Slider { least, most, .. }), Value::Number(number)) => {
                Value::Number(if number < 0.5 * (least + most) { most } else { least })
            }
            (Some(Kind::Choice(names)), Value::Name(name)) => {
                Value::Name(names.iter().find(|n| **n != name).expect("another").to_string())
            }
            (Some(Kind::Switch), Value::Switch(on)) => Value::Switch(!on),
            (kind, value) => panic!("{}: {kind:?} {value:?}", control.key),
        }
    }

    #[test]
    fn each_control_changes_something_and_reads_what_was_set() {
        for control in controls() {
            let mut changed = start();
            if control.key == "white" {
                changed.put("compresses", &Value::Switch(true), &RANGES).expect("a switch");
            }
            let before = changed;
            let value = another(control, &changed);
            changed.put(control.key, &value, &RANGES).expect(control.key);
            assert_ne!(before, changed, "{}", control.key);
            match (control.value(&changed), value) {
                (Value::Number(found), Value::Number(set)) => {
                    assert!((found - set).abs() <= 1e-5 * set.abs().max(1.0), "{}: {found}", control.key);
                }
                (found, set) => assert_eq!(found, set, "{}", control.key),
            }
            assert!(!control.label.is_empty() && !control.group.is_empty() && !control.help.is_empty());
            let needed = control.needs.map(|key| controls().iter().find(|c| c.key == key));
            assert!(needed.is_none_or(|c| c.is_some_and(|c| c.kind == Kind::Switch)), "{}", control.key);
        }
    }

    #[test]
    fn every_value_that_actors_take_has_a_control() {
        let before = start();
        let mut after = before;
        for control in controls() {
            // Switches off would hide what they switch.
            if control.kind != Kind::Switch || control.key == "compresses" {
                let value = another(control, &after);
                after.put(control.key, &value, &RANGES).expect(control.key);
            }
        }
        let Controls { set, overlay } = after;
        // A new field does not compile until somebody says who sets it.
        let Adjustment {
            fps,
            quality,
            workers,
            policy,
            saliency_weight,
            samples_per_job,
            ageing,
            environment_bytes,
            texture_bytes,
            refine,
            tone,
        } = set;
        let old = before.set;
        let (new_rules, old_rules) = (refine.expect("rules"), old.refine.expect("rules"));
        assert!(fps != old.fps && quality != old.quality && workers != old.workers && policy != old.policy);
        assert!(saliency_weight != old.saliency_weight && samples_per_job != old.samples_per_job);
        assert!(ageing.delta != old.ageing.delta && ageing.max_age != old.ageing.max_age);
        assert!(ageing.n_min != old.ageing.n_min && environment_bytes != old.environment_bytes);
        assert!(texture_bytes != old.texture_bytes && new_rules.noise != old_rules.noise);
        assert!(new_rules.max_samples != old_rules.max_samples && tone.exposure != old.tone.exposure);
        assert!(tone.curve != old.tone.curve && overlay != before.overlay);
    }

    #[test]
    fn nothing_is_set_that_no_panel_sets() {
        let before = start();
        let mut now = before;
        for (key, value) in [
            ("fps", Value::Number(f64::NAN)),
            ("fps", Value::Name("fast".into())),
            ("fps", Value::Switch(true)),
            ("overlay", Value::Name("all".into())),
            ("refines", Value::Number(1.0)),
            ("", Value::Number(1.0)),
            ("nothing", Value::Switch(true)),
        ] {
            assert!(now.put(key, &value, &RANGES).is_err(), "{key} {value:?}");
        }
        assert_eq!(now, before);
        now.put("fps", &Value::Number(1e300), &RANGES).expect("clamped");
        now.put("workers", &Value::Number(-7.6), &RANGES).expect("clamped");
        assert_eq!((now.set.fps, now.set.workers), (60.0, 1));
        let whole = Ranges { textures: None, ..RANGES };
        assert_eq!(
            now.put("texture_bytes", &Value::Number(1.0), &whole),
            Err(Refused::Unknown("texture_bytes".into()))
        );
    }
}
