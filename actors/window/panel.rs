//! The panel: how the walk goes, overlays, sliders, what was decided, help.

use egui::{Response, RichText, Slider, Ui};
use foveal::allocation::policy::Policy;
use foveal::display::tone::ToneCurve;
use foveal::splatting::supersampling::Supersampling;

use super::decisions::decisions;
use super::standing::{graph, standing};
use super::tables::{actors, stations};
use foveal_actors::insight::Insight;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::Adjustment;
use foveal_engine::controls::{Control, controls};
use foveal_engine::source::{Controls, Names, Ranges, Status};
use foveal_engine::walk::{FrameTimes, Notices};

/// Quality that frames wait for unless something else is said.
const QUALITY: f32 = -0.25;
/// Points that the panel is wide.
pub const WIDTH: f32 = 310.0;

/// Keys, for the help.
pub const KEYS: [(&str, &str); 19] = [
    ("W A S D", "walk"),
    ("Q E", "down, up"),
    ("right drag", "look around"),
    ("wheel", "speed"),
    ("Shift, Ctrl", "faster, slower"),
    ("O", "orbit about the middle of the view"),
    ("1 - 9", "go to a bookmark (at first the scene's cameras)"),
    ("Ctrl + 1 - 9", "set a bookmark"),
    ("R", "record a path, and end it"),
    ("P", "play the recorded path, or the scene's"),
    ("Tab", "next overlay"),
    ("Space, Left, Right", "in a recording: play, go by frames"),
    ("comma, period, B", "in a recording: go by messages, walk on"),
    ("one finger, two", "look around; walk, and ahead as they part"),
    ("F1", "this help"),
    ("F5", "read the scene again"),
    ("F11", "full screen"),
    ("F12", "screenshot"),
    ("Esc, Ctrl + Q", "release the mouse, quit"),
];

/// What the panel shows beside the controls.
pub struct Shown<'a> {
    /// Where the session stands.
    pub status: &'a Status,
    /// It is a recording, of which only exposure, overlay and pace can be changed.
    pub recorded: bool,
    /// The last frames.
    pub times: &'a FrameTimes,
    /// Quality of the picture on show, as estimated.
    pub quality: Option<f32>,
    /// Speed of walking, scene units per second.
    pub speed: f32,
    /// How far controls go.
    pub ranges: Ranges,
    /// What the allocator thought last.
    pub insight: Option<(&'a Insight, &'a Names)>,
    /// Who presents: an adapter or the processor.
    pub presenter: &'a str,
    /// What went well or wrong last.
    pub notices: &'a Notices,
}

/// The panel's content. Changes `controls` as the user does.
pub fn panel(ui: &mut Ui, controls: &mut Controls, shown: &Shown<'_>) {
    ui.spacing_mut().slider_width = 100.0;
    egui::ScrollArea::vertical().show(ui, |ui| {
        standing(ui, shown);
        ui.separator();
        graph(ui, shown.times, controls.set.fps);
        ui.separator();
        ui.horizontal_wrapped(|ui| {
            for overlay in Overlay::ALL {
                let button = ui.selectable_value(&mut controls.overlay, overlay, overlay.name());
                button.on_hover_text(overlay.help());
            }
        });
        ui.separator();
        let Controls { set, .. } = &mut *controls;
        group(ui, ("Picture", "How the picture is displayed; nothing is traced anew"), true, |ui| {
            exposure(ui, set)
        });
        group(ui, ("Time", "How often a frame is shown, and who works for it"), true, |ui| {
            named(ui, "fps", |text| Slider::new(&mut set.fps, 1.0..=60.0).logarithmic(true).text(text));
            // A recording is as it was.
            ui.add_enabled_ui(!shown.recorded, |ui| {
                quality(ui, &mut set.quality);
                named(ui, "workers", |text| {
                    Slider::new(&mut set.workers, 1..=shown.ranges.workers).text(text)
                });
            });
        });
        ui.add_enabled_ui(!shown.recorded, |ui| settings(ui, controls, shown.ranges));
        ui.separator();
        if let Some((insight, names)) = shown.insight {
            decisions(ui, insight, names);
        }
        if !shown.status.actors.is_empty() {
            let help = "The actors that the walk is made of, and what they have to do";
            group(ui, ("Actors", help), true, |ui| actors(ui, &shown.status.actors));
        }
        if shown.status.stations.iter().any(|station| station.guest.is_some()) {
            let help = "Machines that trace for this walk (--tracers)";
            group(ui, ("Other machines", help), true, |ui| stations(ui, &shown.status.stations));
        }
        ui.separator();
        ui.weak(shown.presenter)
            .on_hover_text("Who draws the picture and brings it into the window (--backend, --display)");
        ui.weak("F1: help").on_hover_text("F1 shows what the keys do");
    });
}

/// The control of a name.
fn control(key: &str) -> Option<&'static Control> {
    let control = controls().iter().find(|control| control.key == key);
    debug_assert!(control.is_some(), "nothing is called {key}");
    control
}

/// Says by hovering what a control does, also where it cannot be changed.
fn explained(response: Response, key: &str) -> Response {
    let help = control(key).map_or("", |control| control.help);
    response.on_hover_text(help).on_disabled_hover_text(help)
}

/// A slider with the name that its control has wherever it is shown, and its help by hovering.
fn named<'v>(ui: &mut Ui, key: &str, slider: impl FnOnce(String) -> Slider<'v>) -> Response {
    let (label, unit) = control(key).map_or(("", ""), |control| (control.label, control.unit));
    let text = if unit.is_empty() { label.to_owned() } else { format!("{label}, {unit}") };
    explained(ui.add(slider(text)), key)
}

/// A checkbox, likewise.
fn switch(ui: &mut Ui, key: &str, on: &mut bool) -> Response {
    explained(ui.checkbox(on, control(key).map_or("", |control| control.label)), key)
}

/// What belongs together, under a heading that folds it away; hovering over that says what it is.
pub(super) fn group(ui: &mut Ui, (name, help): (&str, &str), is_open: bool, content: impl FnOnce(&mut Ui)) {
    let heading = RichText::new(name).strong();
    let shown = egui::CollapsingHeader::new(heading).id_salt(name).default_open(is_open).show(ui, content);
    shown.header_response.on_hover_text(help).on_disabled_hover_text(help);
}

/// What the actors are told.
fn settings(ui: &mut Ui, controls: &mut Controls, ranges: Ranges) {
    let Controls { set, .. } = controls;
    let help = "What happens to a view that has converged";
    group(ui, ("Refinement", help), true, |ui| refinement(ui, &mut set.refine));
    let help = "Which objects are sampled first, and how many samples at once (Haber 2001 §3, §4.4)";
    group(ui, ("Samples", help), true, |ui| {
        let policy = egui::ComboBox::from_label("policy").selected_text(set.policy.name());
        let shown = policy.show_ui(ui, |ui| {
            for policy in Policy::ALL {
                ui.selectable_value(&mut set.policy, policy, policy.name());
            }
        });
        explained(shown.response, "policy");
        ui.horizontal(|ui| {
            explained(ui.label("task"), "saliency_weight");
            named(ui, "saliency_weight", |text| Slider::new(&mut set.saliency_weight, 0.0..=1.0).text(text));
        });
        named(ui, "samples_per_job", |text| {
            Slider::new(&mut set.samples_per_job, 16..=4096).logarithmic(true).text(text)
        });
    });
    let help = "When samples of earlier views expire (Haber 2001 §4.5)";
    group(ui, ("Samples kept", help), false, |ui| {
        named(ui, "delta", |text| Slider::new(&mut set.ageing.delta, 0.01..=0.5).text(text));
        named(ui, "max_age", |text| Slider::new(&mut set.ageing.max_age, 0..=256).text(text));
        named(ui, "n_min", |text| Slider::new(&mut set.ageing.n_min, 1..=100).text(text));
    });
    let help = "How much of it environment maps and textures may take (Dumont 2003 §5.2, §5.3)";
    group(ui, ("Memory", help), false, |ui| budgets(ui, set, ranges));
}

/// Whether frames wait until they are good enough, and for how good a one.
fn quality(ui: &mut Ui, quality: &mut Option<f32>) {
    let mut waits = quality.is_some();
    if switch(ui, "waits", &mut waits).changed() {
        *quality = waits.then_some(QUALITY);
    }
    if let Some(quality) = quality {
        named(ui, "quality", |text| Slider::new(quality, -4.0..=0.0).text(text));
    }
}

/// How far a view goes on once it has converged.
fn refinement(ui: &mut Ui, refine: &mut Option<Supersampling>) {
    let mut refines = refine.is_some();
    if switch(ui, "refines", &mut refines).changed() {
        *refine = refines.then(Supersampling::default);
    }
    if let Some(rules) = refine {
        named(ui, "noise", |text| Slider::new(&mut rules.noise, 0.001..=0.1).logarithmic(true).text(text));
        named(ui, "max_samples", |text| {
            Slider::new(&mut rules.max_samples, 1..=4096).logarithmic(true).text(text)
        });
    }
}

/// Most memory for textures and environment maps.
fn budgets(ui: &mut Ui, set: &mut Adjustment, ranges: Ranges) {
    const MIB: f64 = (1 << 20) as f64;
    let mut maps = set.environment_bytes as f64 / MIB;
    if named(ui, "environment_bytes", |text| Slider::new(&mut maps, 0.0..=256.0).text(text)).changed() {
        set.environment_bytes = (maps * MIB) as u64;
    }
    match (ranges.textures, &mut set.texture_bytes) {
        (Some([least, most]), Some(bytes)) => {
            let mut mib = *bytes as f64 / MIB;
            let range = least as f64 / MIB..=most as f64 / MIB;
            if named(ui, "texture_bytes", |text| Slider::new(&mut mib, range).text(text)).changed() {
                *bytes = ((mib * MIB) as u64).clamp(least, most);
            }
        }
        _ => {
            let help = "All levels of all textures are in memory: there is no limit that they would exceed";
            ui.weak("all textures fit (--texture-budget)").on_hover_text(help).on_disabled_hover_text(help);
        }
    }
}

fn exposure(ui: &mut Ui, set: &mut Adjustment) {
    let mut stops = set.tone.exposure.max(1e-6).log2();
    if named(ui, "exposure", |text| Slider::new(&mut stops, -12.0..=12.0).text(text)).changed() {
        set.tone.exposure = stops.exp2();
    }
    let mut compresses = matches!(set.tone.curve, ToneCurve::Reinhard { .. });
    if switch(ui, "compresses", &mut compresses).changed() {
        set.tone.curve = if compresses { ToneCurve::Reinhard { white: 4.0 } } else { ToneCurve::Clamp };
    }
    if let ToneCurve::Reinhard { white } = &mut set.tone.curve {
        named(ui, "white", |text| Slider::new(white, 0.5..=64.0).logarithmic(true).text(text));
    }
}

/// The help overlay.
pub fn help(ctx: &egui::Context, open: &mut bool) {
    egui::Window::new("Help").open(open).collapsible(false).resizable(false).show(ctx, |ui| {
        egui::Grid::new("keys").num_columns(2).show(ui, |ui| {
            for (key, what) in KEYS {
                ui.strong(key);
                ui.label(what);
                ui.end_row();
            }
        });
    });
}
