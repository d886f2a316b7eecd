//! The panel's part about decisions: texture bars as in Dumont 2003, figure 15, and the ranking of environment maps as in
//! figure 16.

use egui::{Color32, Pos2, Rect, Sense, Ui, Vec2};

use foveal_actors::insight::{Insight, MapRank};
use foveal_actors::textures::TextureReport;
use foveal_engine::source::Names;

/// Lines that are shown at most.
const LINES: usize = 12;
/// Height of a bar, points.
const BAR: f32 = 12.0;

/// Both, as far as the scene has them.
pub fn decisions(ui: &mut Ui, insight: &Insight, names: &Names) {
    if let Some((report, limit)) = &insight.textures {
        egui::CollapsingHeader::new("textures").default_open(true).show(ui, |ui| {
            textures(ui, report, *limit, names);
        });
    }
    if !insight.maps.is_empty() {
        egui::CollapsingHeader::new("environment maps").default_open(true).show(ui, |ui| {
            let [used, most] = insight.map_bytes;
            ui.label(format!("{:.1} of {:.1} MiB", mib(used), mib(most)));
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
    ui.label(format!("{:.1} of {:.1} MiB, loss {:.0}", mib(report.used), mib(limit), report.visible_error()));
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
        bar(
            ui,
            size(charge.given),
            charge.asked.map(size),
            color,
            &format!("{name}, level {}", charge.given),
        );
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
    bar(ui, map.worth / worth, None, color, &format!("{name}, {state}"));
}

fn bar(ui: &mut Ui, share: f32, mark: Option<f32>, color: Color32, text: &str) {
    let width = ui.available_width();
    let (rect, _) = ui.allocate_exact_size(Vec2::new(width, BAR + 2.0), Sense::hover());
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
