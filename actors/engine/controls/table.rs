//! The rows of the table.

use std::sync::LazyLock;

use foveal::allocation::policy::Policy;
use foveal::display::tone::ToneCurve;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::overlay::Overlay;

use super::{Control, Kind, Value};
use crate::source::Controls;

/// Quality that frames wait for unless something else is said.
const QUALITY: f32 = -0.25;
/// Displayed radiance that becomes white where highlights are compressed, unless something else is said.
const WHITE: f32 = 4.0;
/// Bytes of a MiB, in which sizes are shown.
pub(super) const MIB: f64 = (1 << 20) as f64;

pub(super) const fn slider(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: false, whole: false }
}

const fn scale(least: f64, most: f64) -> Kind {
    Kind::Slider { least, most, logarithmic: true, whole: false }
}

pub(super) const fn count(least: f64, most: f64) -> Kind {
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

/// All of them, in the order of a panel.
pub(super) static CONTROLS: LazyLock<[Control; 19]> = LazyLock::new(|| {
    [
        Control {
            key: "exposure",
            label: "exposure",
            help: "Brightness of the picture; one stop more doubles it",
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
            help: "Keep differences visible in what is brighter than white",
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
            help: "Radiance, once exposed, that is shown as white",
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
            help: "What was decided about each object or pixel, painted over the picture",
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
            help: "How many pictures are shown per second while you move",
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
            help: "Show no frame before it is good enough; the frame rate drops instead (fixed quality, Dumont 2003 §3)",
            group: "Time",
            read: |c| Value::Switch(c.set.quality.is_some()),
            write: |c, v| c.set.quality = v.is_on().then_some(c.set.quality.unwrap_or(QUALITY)),
            ..ROW
        },
        Control {
            key: "quality",
            label: "least quality",
            help: "Minus the mean visible error of a pixel; 0 is without error (Q, Dumont 2003, Eq. (1))",
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
            help: "How many tracers work; the others rest",
            group: "Time",
            kind: count(1.0, 1.0),
            read: |c| Value::Number(f64::from(c.set.workers)),
            write: |c, v| c.set.workers = v.number() as u32,
            ..ROW
        },
        Control {
            key: "refines",
            label: "refine what has converged",
            help: "Go on taking samples of each pixel once the picture has converged",
            group: "Refinement",
            read: |c| Value::Switch(c.set.refine.is_some()),
            write: |c, v| c.set.refine = v.is_on().then(|| c.set.refine.unwrap_or_default()),
            ..ROW
        },
        Control {
            key: "noise",
            label: "noise",
            help: "A tile is done once the standard error of its displayed values, 0 to 1, is below this",
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
            help: "The most samples that refining takes of a pixel",
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
            help: "How it is decided which samples come first (attention is the order of Haber 2001 §4.4)",
            group: "Samples",
            kind: Kind::Choice(&*POLICIES),
            read: |c| Value::Name(c.set.policy.name().to_owned()),
            write: |c, v| c.set.policy = v.name().parse().unwrap_or(c.set.policy),
            ..ROW
        },
        Control {
            key: "saliency_weight",
            label: "saliency",
            help: "What draws the eye against the task: 0 counts the task alone, 1 saliency alone (w_s, Haber 2001 §3)",
            group: "Samples",
            kind: slider(0.0, 1.0),
            read: |c| Value::Number(f64::from(c.set.saliency_weight)),
            write: |c, v| c.set.saliency_weight = v.number() as f32,
            ..ROW
        },
        Control {
            key: "samples_per_job",
            label: "samples per job",
            help: "How many samples a tracer takes on at once (n_job, Haber 2001 §4.4)",
            group: "Samples",
            kind: counts(16.0, 4096.0),
            read: |c| Value::Number(f64::from(c.set.samples_per_job)),
            write: |c, v| c.set.samples_per_job = v.number() as u32,
            ..ROW
        },
        Control {
            key: "delta",
            label: "delta",
            help: "Samples expire once the cosine between normal and view has changed by more than this (δ, Haber 2001 §4.5)",
            group: "Samples kept",
            kind: slider(0.01, 0.5),
            read: |c| Value::Number(f64::from(c.set.ageing.delta)),
            write: |c, v| c.set.ageing.delta = v.number() as f32,
            ..ROW
        },
        Control {
            key: "max_age",
            label: "largest age",
            help: "Samples expire after this many views (MAX_AGE, Haber 2001 §4.5)",
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
            help: "How many samples of an age a level needs to vote on whether they expire (N_min, Haber 2001 §4.5)",
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
            help: "The most memory environment maps may take; which objects have one follows Dumont 2003, Eq. (10)",
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
            help: "The most memory textures may take; which mip levels stay follows Dumont 2003 §5.2",
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
