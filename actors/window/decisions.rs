//! The panel's part about decisions: texture bars as in Dumont 2003, figure 15, and the ranking of environment maps as in
//! figure 16.

use egui::{Color32, Pos2, Rect, Role, Sense, Ui, Vec2, WidgetInfo};

use foveal_actors::insight::{Insight, MapRank};
use foveal_actors::textures::{Charge, TextureReport};
use foveal_engine::source::Names;

use super::panel::group;

/// Lines that are shown at most.
const LINES: usize = 12;
/// Height of a bar, points.
const BAR: f32 = 12.0;

const TEXTURES: &str = "Which levels of textures are in memory, those whose loss is seen most first: the bar is the \
                        finest level given (full: full size), the mark the finest that the view asks for; red falls \
                        short of it (Dumont 2003 §5.2, figure 15)";
const TEXTURE_SUM: &str = "Memory that textures take, of the limit, and their loss: the visible error of missing \
                           levels, just noticeable differences × pixels (−Q, Dumont 2003, Eq. (1))";
const MAPS: &str = "Objects by what an environment map takes off their visible error, relative to the first: green \
                    has its map, grey wants one, for red there is no room (Dumont 2003 §5.3, Eq. (10), figure 16)";
const MAP_SUM: &str = "Memory that environment maps take, of the most that they may";

/// Both, as far as the scene has them.
pub fn decisions(ui: &mut Ui, insight: &Insight, names: &Names) {
    if let Some((report, limit)) = &insight.textures {
        group(ui, ("Textures", TEXTURES), true, |ui| textures(ui, report, *limit, names));
    }
    if !insight.maps.is_empty() {
        group(ui, ("Environment maps", MAPS), true, |ui| {
            let [used, most] = insight.map_bytes;
            ui.label(format!("{:.1} of {:.1} MiB", mib(used), mib(most))).on_hover_text(MAP_SUM);
            let worth = insight.maps.iter().map(|m| m.worth).fold(0.0, f32::max).max(1e-30);
            for map in insight.maps.iter().take(LINES) {
                environment(ui, map, worth, names);
            }
        });
    }
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// Memory against the limit; and for each texture the finest level given (full bar: full size), with a mark where the view
/// asks for it. What falls short is red.
fn textures(ui: &mut Ui, report: &TextureReport, limit: u64, names: &Names) {
    let sum = format!("{:.1} of {:.1} MiB, loss {:.0}", mib(report.used), mib(limit), report.visible_error());
    ui.label(sum).on_hover_text(TEXTURE_SUM);
    let mut order: Vec<usize> = (0..report.bill.len()).collect();
    let loss = |i: &usize| report.bill[*i].loss;
    order.sort_by(|a, b| {
        let pixels = report.bill[*b].pixels.total_cmp(&report.bill[*a].pixels);
        loss(b).total_cmp(&loss(a)).then(pixels).then(a.cmp(b))
    });
    for i in order.into_iter().take(LINES) {
        let charge = &report.bill[i];
        let size = |level: usize| 1.0 - (level as f32 / 10.0).min(1.0);
        let short = charge.asked.is_some_and(|asked| charge.given > asked);
        let color = if short { Color32::from_rgb(210, 90, 60) } else { Color32::from_rgb(80, 150, 100) };
        let name = names.textures.get(i).map_or("", String::as_str);
        let text = format!("{name}, level {}", charge.given);
        bar(ui, size(charge.given), charge.asked.map(size), color, &text, told(charge));
    }
}

/// What a texture has, and what it lacks.
fn told(charge: &Charge) -> String {
    let Charge { pixels, asked, given, loss } = charge;
    match asked {
        Some(asked) => format!(
            "{pixels:.0} pixels show it; the finest level that they ask for is {asked}, the finest in memory {given}; \
             the loss is {loss:.1} just noticeable differences × pixels"
        ),
        None => format!("No pixel shows it; the finest level in memory is {given}"),
    }
}

/// An object's map: what it is worth, relative to the best; green where it is there, grey where it is wanted.
fn environment(ui: &mut Ui, map: &MapRank, worth: f32, names: &Names) {
    let name = names.objects.get(map.object as usize).map_or("", String::as_str);
    let (color, state) = match map.side {
        0 if map.kept => (Color32::GRAY, format!("wants {}", map.wanted)),
        0 => (Color32::from_rgb(210, 90, 60), "no room".to_owned()),
        side => (Color32::from_rgb(80, 150, 100), format!("{side} × {side} × 6")),
    };
    let help = format!(
        "Its map takes {:.1} off the visible error, saliency × pixels × just noticeable differences",
        map.worth
    );
    bar(ui, map.worth / worth, None, color, &format!("{name}, {state}"), help);
}

/// A bar filled to a share, with its name on it, and by hovering what it says.
fn bar(ui: &mut Ui, share: f32, mark: Option<f32>, color: Color32, text: &str, help: String) {
    let width = ui.available_width();
    let (rect, response) = ui.allocate_exact_size(Vec2::new(width, BAR + 2.0), Sense::hover());
    response.widget_info(|| WidgetInfo {
        value: Some(f64::from(share.clamp(0.0, 1.0))),
        ..WidgetInfo::labeled(Role::Meter, true, text)
    });
    response.on_hover_text(help);
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, ui.visuals().extreme_bg_color);
    let at = |share: f32| rect.left() + rect.width() * share.clamp(0.0, 1.0);
    let filled = Rect::from_min_max(rect.min, Pos2::new(at(share), rect.bottom() - 1.0));
    painter.rect_filled(filled, 0.0, color.gamma_multiply(0.6));
    if let Some(mark) = mark {
        painter.vline(at(mark), rect.y_range(), (2.0, ui.visuals().text_color()));
    }
    let font = egui::FontId::proportional(10.0);
    painter.text(
        rect.left_center() + Vec2::new(4.0, 0.0),
        egui::Align2::LEFT_CENTER,
        text,
        font,
        ui.visuals().strong_text_color(),
    );
}
