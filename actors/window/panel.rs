//! The panel: sliders, overlays, how the frames go, help.

use egui::{Color32, Pos2, Rect, Response, RichText, Sense, Shape, Slider, Stroke, Ui, Vec2};
use foveal::allocation::policy::Policy;
use foveal::allocation::supersampling::RefinementProgress;
use foveal::display::tone::ToneCurve;
use foveal::splatting::supersampling::Supersampling;

use super::decisions::decisions;
use foveal_actors::insight::Insight;
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::Adjustment;
use foveal_actors::station::StationStatus;
use foveal_engine::controls::controls;
use foveal_engine::source::{ActorStatus, Controls, Names, Ranges, Status};
use foveal_engine::walk::{FrameTimes, Notice};

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
    /// The last thing that went well or wrong.
    pub notice: Option<&'a Notice>,
}

/// The panel's content. Changes `controls` as the user does.
pub fn panel(ui: &mut Ui, controls: &mut Controls, shown: &Shown<'_>) {
    ui.spacing_mut().slider_width = 100.0;
    egui::ScrollArea::vertical().show(ui, |ui| {
        state(ui, shown);
        ui.separator();
        graph(ui, shown.times, controls.set.fps);
        ui.separator();
        ui.horizontal_wrapped(|ui| {
            for overlay in Overlay::ALL {
                ui.selectable_value(&mut controls.overlay, overlay, overlay.name());
            }
        });
        ui.separator();
        let Controls { set, .. } = &mut *controls;
        group(ui, "Picture", true, |ui| exposure(ui, set));
        group(ui, "Time", true, |ui| {
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
            egui::CollapsingHeader::new("actors").default_open(true).show(ui, |ui| {
                actors(ui, &shown.status.actors);
            });
        }
        if shown.status.stations.iter().any(|station| station.guest.is_some()) {
            egui::CollapsingHeader::new("other machines").default_open(true).show(ui, |ui| {
                stations(ui, &shown.status.stations);
            });
        }
        ui.separator();
        ui.weak(shown.presenter);
        ui.weak("F1: help");
    });
}

/// A slider with the name that its control has wherever it is shown, and its help by hovering.
fn named<'v>(ui: &mut Ui, key: &str, slider: impl FnOnce(String) -> Slider<'v>) -> Response {
    let control = controls().iter().find(|control| control.key == key);
    debug_assert!(control.is_some(), "nothing is called {key}");
    let (label, unit, help) = control.map_or(("", "", ""), |c| (c.label, c.unit, c.help));
    let text = if unit.is_empty() { label.to_owned() } else { format!("{label}, {unit}") };
    ui.add(slider(text)).on_hover_text(help)
}

/// The help of a control.
fn help_of(key: &str) -> &'static str {
    controls().iter().find(|control| control.key == key).map_or("", |control| control.help)
}

/// A checkbox, likewise.
fn switch(ui: &mut Ui, key: &str, on: &mut bool) -> Response {
    let control = controls().iter().find(|control| control.key == key);
    debug_assert!(control.is_some(), "nothing is called {key}");
    let (label, help) = control.map_or(("", ""), |c| (c.label, c.help));
    ui.checkbox(on, label).on_hover_text(help)
}

/// Controls that belong together, under a heading that folds them away.
fn group(ui: &mut Ui, name: &str, is_open: bool, content: impl FnOnce(&mut Ui)) {
    let heading = RichText::new(name).strong();
    egui::CollapsingHeader::new(heading).id_salt(name).default_open(is_open).show(ui, content);
}

/// What the actors are told.
fn settings(ui: &mut Ui, controls: &mut Controls, ranges: Ranges) {
    let Controls { set, .. } = controls;
    group(ui, "Refinement", true, |ui| refinement(ui, &mut set.refine));
    group(ui, "Samples", true, |ui| {
        let policy = egui::ComboBox::from_label("policy").selected_text(set.policy.name());
        let shown = policy.show_ui(ui, |ui| {
            for policy in Policy::ALL {
                ui.selectable_value(&mut set.policy, policy, policy.name());
            }
        });
        shown.response.on_hover_text(help_of("policy"));
        ui.horizontal(|ui| {
            ui.label("task").on_hover_text(help_of("saliency_weight"));
            named(ui, "saliency_weight", |text| Slider::new(&mut set.saliency_weight, 0.0..=1.0).text(text));
        });
        named(ui, "samples_per_job", |text| {
            Slider::new(&mut set.samples_per_job, 16..=4096).logarithmic(true).text(text)
        });
    });
    group(ui, "Samples kept", false, |ui| {
        named(ui, "delta", |text| Slider::new(&mut set.ageing.delta, 0.01..=0.5).text(text));
        named(ui, "max_age", |text| Slider::new(&mut set.ageing.max_age, 0..=256).text(text));
        named(ui, "n_min", |text| Slider::new(&mut set.ageing.n_min, 1..=100).text(text));
    });
    group(ui, "Memory", false, |ui| budgets(ui, set, ranges));
}

fn state(ui: &mut Ui, shown: &Shown<'_>) {
    let status = shown.status;
    let refinement = shown.insight.filter(|_| status.converged).and_then(|(insight, _)| insight.refinement);
    let state = match (status.converged, status.lit) {
        (true, _) if status.refined => "refined",
        (true, _) if refinement.is_some() => "converged, being refined",
        (true, _) => "converged",
        (false, true) => "correcting",
        (false, false) => "correcting, light grows",
    };
    ui.label(RichText::new(format!("view {}, {state}", status.view)).strong());
    ui.label(format!("{} traced, {} reused, {} expired", status.traced, status.reused, status.expired));
    let quality = shown.quality.map_or_else(|| "not known".to_owned(), |quality| format!("{quality:.3}"));
    ui.label(format!("speed {:.3} per second, quality {quality}", shown.speed));
    if let Some(RefinementProgress { tiles, quiet, error: Some(error), stated }) = refinement {
        ui.label(format!("{quiet} of {tiles} tiles below the noise bound, worst {error:.4}"));
        if let Some(stated) = stated {
            let stated = 100.0 * stated;
            // No sample finds them, and what refinement replaces had them from the map.
            let but = "but for caustics of points, spots and suns that are seen in mirrors or through glass";
            ui.label(format!("error below {stated:.1} %, {but}"));
        }
    }
    if let Some(notice) = shown.notice {
        let color = if notice.failed { ui.visuals().error_fg_color } else { ui.visuals().text_color() };
        ui.colored_label(color, &notice.text);
    }
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
            ui.weak("all textures fit (--texture-budget)");
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

/// Frame times against the deadline.
fn graph(ui: &mut Ui, times: &FrameTimes, fps: f32) {
    let deadline = 1.0 / fps.max(0.1);
    match times.median_p99() {
        Some((median, p99)) => ui.label(format!(
            "frame {:.0} ms, p99 {:.0} ms, deadline {:.0} ms",
            median * 1e3,
            p99 * 1e3,
            deadline * 1e3
        )),
        None => ui.label("no frame yet"),
    };
    let (rect, drawn) =
        ui.allocate_exact_size(Vec2::new(ui.available_width().min(WIDTH - 20.0), 48.0), Sense::hover());
    let help = "How long each of the last frames took; the line is the deadline, red came late";
    drawn.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, help));
    drawn.on_hover_text(help);
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, ui.visuals().extreme_bg_color);
    let full = 2.0 * deadline;
    let height = |seconds: f32| rect.bottom() - rect.height() * (seconds / full).min(1.0);
    let step = rect.width() / FrameTimes::CAPACITY as f32;
    for (i, time) in times.iter().enumerate() {
        let seconds = time.as_secs_f32();
        let late = seconds > 1.1 * deadline;
        let color = if late { Color32::from_rgb(220, 90, 60) } else { Color32::from_rgb(90, 170, 110) };
        let left = rect.left() + i as f32 * step;
        let bar = Rect::from_min_max(Pos2::new(left, height(seconds)), Pos2::new(left + step, rect.bottom()));
        painter.rect_filled(bar, 0.0, color);
    }
    let line = [Pos2::new(rect.left(), height(deadline)), Pos2::new(rect.right(), height(deadline))];
    painter.add(Shape::line_segment(line, Stroke::new(1.0, ui.visuals().text_color())));
}

fn actors(ui: &mut Ui, actors: &[ActorStatus]) {
    egui::Grid::new("actors").striped(true).num_columns(4).show(ui, |ui| {
        for heading in ["actor", "delivered", "queue / most", "busy, s"] {
            ui.weak(heading);
        }
        ui.end_row();
        for actor in actors {
            ui.label(&actor.name);
            ui.label(actor.delivered.to_string());
            ui.label(format!("{} / {}", actor.waiting, actor.waiting_max));
            ui.label(format!("{:.2}", actor.busy.as_secs_f32()));
            ui.end_row();
        }
    });
}

fn stations(ui: &mut Ui, stations: &[StationStatus]) {
    egui::Grid::new("stations").striped(true).num_columns(7).show(ui, |ui| {
        for heading in ["machine", "cores", "state", "way, ms", "samples/s", "late, shared", "checked"] {
            ui.weak(heading);
        }
        ui.end_row();
        for station in stations {
            let Some(guest) = &station.guest else { continue };
            let counts = &station.counts;
            ui.label(guest);
            ui.label(station.cores.to_string());
            ui.label(station.told());
            ui.label(format!("{:.1}", station.round_trip * 1e3));
            ui.label(format!("{:.0}", station.rate));
            ui.label(format!("{}, {}", counts.late, counts.shared));
            ui.label(counts.checked.to_string());
            ui.end_row();
        }
    });
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
