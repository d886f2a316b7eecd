//! What can be set while walking, as a table: whoever shows a panel makes it of this one.
//!
//! A row says what a value is called, how far it goes, and how it is read from and written to [`Controls`]. What comes from
//! outside goes through [`Controls::put`], which lets nothing through that no panel could have set.

use std::fmt;
use std::sync::LazyLock;

use foveal::allocation::policy::Policy;
use foveal::display::tone::ToneCurve;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::overlay::Overlay;
use serde::{Deserialize, Serialize};

use crate::source::{Controls, Ranges};

/// Quality that frames wait for unless something else is said.
const QUALITY: f32 = -0.25;
/// Displayed radiance that becomes white where highlights are compressed, unless something else is said.
const WHITE: f32 = 4.0;
/// Bytes of a MiB, in which sizes are shown.
const MIB: f64 = (1 << 20) as f64;

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

const fn slider(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: false, whole: false }
}

const fn scale(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: true, whole: false }
}

const fn count(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: false, whole: true }
}

const fn counts(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: true, whole: true }
}

/// Names of all overlays, in their order.
static OVERLAYS: LazyLock<[&'static str; Overlay::ALL.len()]> =
    LazyLock::new(|| Overlay::ALL.map(Overlay::name));

/// Names of all policies, in their order.
static POLICIES: LazyLock<[&'static str; Policy::ALL.len()]> =
    LazyLock::new(|| Policy::ALL.map(Policy::name));

/// What most rows say of themselves.
const ROW: Control = Control {
    key: "",
    label: "",
    help: "",
    group: "",
    unit: "",
    kind: Kind::Switch,
    needs: None,
    of_recordings: false,
    read: |_| Value::Switch(false),
    write: |_, _| {},
};

static CONTROLS: LazyLock<[Control; 19]> = LazyLock::new(|| {
    [
        Control {
            key: "exposure",
            label: "exposure",
            help: "Brightness of the picture; one stop doubles it",
            group: "Picture",
            unit: "stops",
            kind: slider(-12.0, 12.0),
            of_recordings: true,
            read: |c| Value::Number(f64::from(c.set.tone.exposure.max(1e-6).log2())),
            write: |c, v| c.set.tone.exposure = (v.number() as f32).exp2(),
            ..ROW
        },
        Control {
            key: "compresses",
            label: "compress highlights",
            help: "What is brighter than white keeps its differences",
            group: "Picture",
            of_recordings: true,
            read: |c| Value::Switch(matches!(c.set.tone.curve, ToneCurve::Reinhard { .. })),
            write: |c, v| {
                let white = if let ToneCurve::Reinhard { white } = c.set.tone.curve { white } else { WHITE };
                c.set.tone.curve = if v.is_on() { ToneCurve::Reinhard { white } } else { ToneCurve::Clamp };
            },
            ..ROW
        },
        Control {
            key: "white",
            label: "white",
            help: "Radiance that is shown white",
            group: "Picture",
            kind: scale(0.5, 64.0),
            needs: Some("compresses"),
            of_recordings: true,
            read: |c| match c.set.tone.curve {
                ToneCurve::Reinhard { white } => Value::Number(f64::from(white)),
                ToneCurve::Clamp => Value::Number(f64::from(WHITE)),
            },
            write: |c, v| {
                if let ToneCurve::Reinhard { white } = &mut c.set.tone.curve {
                    *white = v.number() as f32;
                }
            },
            ..ROW
        },
        Control {
            key: "overlay",
            label: "overlay",
            help: "What was decided, painted over the picture",
            group: "Overlay",
            kind: Kind::Choice(&*OVERLAYS),
            of_recordings: true,
            read: |c| Value::Name(c.overlay.name().to_owned()),
            write: |c, v| {
                c.overlay = Overlay::ALL.into_iter().find(|o| o.name() == v.name()).unwrap_or(c.overlay);
            },
            ..ROW
        },
        Control {
            key: "fps",
            label: "frames per second",
            help: "How often a picture is shown while you move",
            group: "Time",
            kind: scale(1.0, 60.0),
            of_recordings: true,
            read: |c| Value::Number(f64::from(c.set.fps)),
            write: |c, v| c.set.fps = v.number() as f32,
            ..ROW
        },
        Control {
            key: "waits",
            label: "wait until good enough",
            help: "Frames wait until they are good enough, so the frame rate falls",
            group: "Time",
            read: |c| Value::Switch(c.set.quality.is_some()),
            write: |c, v| c.set.quality = v.is_on().then_some(c.set.quality.unwrap_or(QUALITY)),
            ..ROW
        },
        Control {
            key: "quality",
            label: "least quality",
            help: "0 less the mean visible error of a pixel",
            group: "Time",
            unit: "JND",
            kind: slider(-4.0, 0.0),
            needs: Some("waits"),
            read: |c| Value::Number(f64::from(c.set.quality.unwrap_or(QUALITY))),
            write: |c, v| c.set.quality = c.set.quality.map(|_| v.number() as f32),
            ..ROW
        },
        Control {
            key: "workers",
            label: "workers",
            help: "Tracers at work; the others rest",
            group: "Time",
            kind: count(1.0, 1.0),
            read: |c| Value::Number(f64::from(c.set.workers)),
            write: |c, v| c.set.workers = v.number() as u32,
            ..ROW
        },
        Control {
            key: "refines",
            label: "refine what has converged",
            help: "A picture that has converged takes more samples of each pixel",
            group: "Refinement",
            read: |c| Value::Switch(c.set.refine.is_some()),
            write: |c, v| c.set.refine = v.is_on().then(|| c.set.refine.unwrap_or_default()),
            ..ROW
        },
        Control {
            key: "noise",
            label: "noise",
            help: "Standard error of displayed values at which a tile is done",
            group: "Refinement",
            kind: scale(0.001, 0.1),
            needs: Some("refines"),
            read: |c| Value::Number(f64::from(rules(c).noise)),
            write: |c, v| {
                if let Some(rules) = &mut c.set.refine {
                    rules.noise = v.number() as f32;
                }
            },
            ..ROW
        },
        Control {
            key: "max_samples",
            label: "most samples",
            help: "Most samples of a pixel",
            group: "Refinement",
            unit: "a pixel",
            kind: counts(1.0, 4096.0),
            needs: Some("refines"),
            read: |c| Value::Number(f64::from(rules(c).max_samples)),
            write: |c, v| {
                if let Some(rules) = &mut c.set.refine {
                    rules.max_samples = v.number() as u32;
                }
            },
            ..ROW
        },
        Control {
            key: "policy",
            label: "policy",
            help: "What decides which samples come first",
            group: "Samples",
            kind: Kind::Choice(&*POLICIES),
            read: |c| Value::Name(c.set.policy.name().to_owned()),
            write: |c, v| c.set.policy = v.name().parse().unwrap_or(c.set.policy),
            ..ROW
        },
        Control {
            key: "saliency_weight",
            label: "saliency",
            help: "From 0, only the task counts, to 1, only what draws the eye",
            group: "Samples",
            kind: slider(0.0, 1.0),
            read: |c| Value::Number(f64::from(c.set.saliency_weight)),
            write: |c, v| c.set.saliency_weight = v.number() as f32,
            ..ROW
        },
        Control {
            key: "samples_per_job",
            label: "samples per job",
            help: "What a tracer takes at once (n_job)",
            group: "Samples",
            kind: counts(16.0, 4096.0),
            read: |c| Value::Number(f64::from(c.set.samples_per_job)),
            write: |c, v| c.set.samples_per_job = v.number() as u32,
            ..ROW
        },
        Control {
            key: "delta",
            label: "delta",
            help: "Samples expire once the cosine between normal and view has changed by this",
            group: "Samples kept",
            kind: slider(0.01, 0.5),
            read: |c| Value::Number(f64::from(c.set.ageing.delta)),
            write: |c, v| c.set.ageing.delta = v.number() as f32,
            ..ROW
        },
        Control {
            key: "max_age",
            label: "largest age",
            help: "Samples expire after so many views (MAX_AGE)",
            group: "Samples kept",
            unit: "views",
            kind: count(0.0, 256.0),
            read: |c| Value::Number(f64::from(c.set.ageing.max_age)),
            write: |c, v| c.set.ageing.max_age = v.number() as u32,
            ..ROW
        },
        Control {
            key: "n_min",
            label: "votes",
            help: "Samples that a level needs to have a say in what expires (N_min)",
            group: "Samples kept",
            unit: "samples",
            kind: count(1.0, 100.0),
            read: |c| Value::Number(c.set.ageing.n_min as f64),
            write: |c, v| c.set.ageing.n_min = v.number() as usize,
            ..ROW
        },
        Control {
            key: "environment_bytes",
            label: "environments",
            help: "Most memory for environment maps",
            group: "Memory",
            unit: "MiB",
            kind: slider(0.0, 256.0),
            read: |c| Value::Number(c.set.environment_bytes as f64 / MIB),
            write: |c, v| c.set.environment_bytes = (v.number() * MIB) as u64,
            ..ROW
        },
        Control {
            key: "texture_bytes",
            label: "textures",
            help: "Most memory for textures",
            group: "Memory",
            unit: "MiB",
            kind: slider(0.0, 0.0),
            read: |c| Value::Number(c.set.texture_bytes.unwrap_or(0) as f64 / MIB),
            write: |c, v| c.set.texture_bytes = c.set.texture_bytes.map(|_| (v.number() * MIB) as u64),
            ..ROW
        },
    ]
});

/// How far a view is refined, or would be.
fn rules(controls: &Controls) -> Supersampling {
    controls.set.refine.unwrap_or_default()
}

/// All that can be set, in the order of a panel.
pub fn controls() -> &'static [Control] {
    &*CONTROLS
}

impl Control {
    /// What values it takes in a walk whose controls go so far; `None` where it has no use there.
    pub fn kind(&self, ranges: &Ranges) -> Option<Kind> {
        Some(match self.key {
            "workers" => count(1.0, f64::from(ranges.workers.max(1))),
            "texture_bytes" => {
                let [least, most] = ranges.textures?;
                slider(least as f64 / MIB, most as f64 / MIB)
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
