//! What the colours of an overlay mean: its name and its scale, beside the picture; and all overlays of one moment on a sheet.

use egui::{Align2, Color32, CornerRadius, Frame, Rect, RichText, Sense, Ui, Vec2};
use foveal::image::Map2d;
use glam::Vec3;

use super::interface::{paint_ui, texture};
use foveal_actors::renderer::overlay::{AGE_FRESH, Overlay, distinct, heat};

/// Points that a scale is wide and high.
const BAR: Vec2 = Vec2::new(56.0, 9.0);
/// Colours of a scale.
const STEPS: usize = 28;
/// Numbers that are told apart by colours of their own.
const DISTINCT: u32 = 4;

/// What stands at both ends of an overlay's scale from black to white. `None` where colours only tell apart.
fn ends(overlay: Overlay) -> Option<[&'static str; 2]> {
    Some(match overlay {
        Overlay::None | Overlay::Tracer | Overlay::Objects => return None,
        Overlay::Saliency | Overlay::Importance => ["least", "most"],
        Overlay::Priority => ["last", "next"],
        Overlay::Error => ["0", "4 JND (middle: 1)"],
        Overlay::Level => ["coarse", "own ray"],
        Overlay::Age => ["1", "63 views"],
        Overlay::Mip | Overlay::MipGiven => ["level 8", "0"],
    })
}

/// Draws the name of an overlay and what its colours mean, in one line.
pub fn legend(ui: &mut Ui, overlay: Overlay) {
    ui.spacing_mut().item_spacing.x = 4.0;
    ui.label(RichText::new(overlay.name()).strong().size(12.0));
    ui.add_space(4.0);
    let small = |ui: &mut Ui, text: &str| ui.label(RichText::new(text).size(11.0).color(Color32::LIGHT_GRAY));
    if overlay == Overlay::Age {
        small(ui, "new");
        colors(ui, Vec2::splat(BAR.y), &[AGE_FRESH]);
    }
    match (overlay, ends(overlay)) {
        (_, Some([least, most])) => {
            small(ui, least);
            let scale: Vec<Vec3> = (0..STEPS).map(|i| heat(i as f32 / (STEPS - 1) as f32)).collect();
            colors(ui, BAR, &scale);
            small(ui, most);
        }
        (Overlay::Tracer, None) => {
            for tracer in 1..=DISTINCT {
                small(ui, &tracer.to_string());
                colors(ui, Vec2::splat(BAR.y), &[distinct(tracer)]);
            }
        }
        (Overlay::Objects, None) => {
            small(ui, "a colour each");
        }
        _ => {}
    }
}

/// A bar of colours.
fn colors(ui: &mut Ui, size: Vec2, colors: &[Vec3]) {
    let (rect, _) = ui.allocate_exact_size(size, Sense::hover());
    let painter = ui.painter_at(rect);
    let width = rect.width() / colors.len().max(1) as f32;
    for (i, color) in colors.iter().enumerate() {
        let [r, g, b] = color.to_array().map(|v| (v * 255.0).round() as u8);
        let corner = rect.min + Vec2::new(i as f32 * width, 0.0);
        painter.rect_filled(
            Rect::from_min_size(corner, Vec2::new(width, rect.height())),
            0.0,
            Color32::from_rgb(r, g, b),
        );
    }
    painter.rect_stroke(rect, 0.0, (1.0, Color32::GRAY), egui::StrokeKind::Inside);
}

/// The same in the lower left corner of the picture, where there is an overlay. The pointer goes through it.
pub fn over_picture(context: &egui::Context, overlay: Overlay, picture: Rect) {
    if overlay == Overlay::None || !picture.is_positive() {
        return;
    }
    egui::Area::new(egui::Id::unique("legend"))
        .pivot(Align2::LEFT_BOTTOM)
        .fixed_pos(picture.left_bottom() + Vec2::new(6.0, -6.0))
        .interactable(false)
        .order(egui::Order::Middle)
        .show(context, |ui| {
            let frame = Frame::new()
                .fill(Color32::from_black_alpha(200))
                .inner_margin(4)
                .corner_radius(CornerRadius::same(3));
            frame.show(ui, |ui| ui.horizontal(|ui| legend(ui, overlay)));
        });
}

/// Pictures with different overlays, so many in a row, each beneath its legend.
pub fn sheet(pictures: &[(Overlay, Map2d<[u8; 3]>)], columns: usize) -> Map2d<[u8; 3]> {
    /// Points between two pictures, and for a legend.
    const GAP: usize = 6;
    const LINE: usize = 20;
    let [width, height] = pictures.first().map_or([1, 1], |(_, p)| [p.width() + GAP, p.height() + LINE]);
    let size = [columns * width + GAP, pictures.len().div_ceil(columns).max(1) * height + GAP];
    let mut textures = Vec::new();
    paint_ui(size, |ui| {
        if textures.is_empty() {
            textures.extend(pictures.iter().map(|(_, picture)| texture(ui.ctx(), None, picture)));
        }
        for (i, ((overlay, _), texture)) in pictures.iter().zip(&textures).enumerate() {
            let corner = egui::pos2((GAP + i % columns * width) as f32, (i / columns * height) as f32);
            let line = Rect::from_min_size(corner, Vec2::new((width - GAP) as f32, LINE as f32));
            ui.scope_builder(egui::UiBuilder::new().max_rect(line), |ui| {
                ui.horizontal_centered(|ui| match overlay {
                    Overlay::None => _ = ui.label(RichText::new("picture").strong().size(12.0)),
                    _ => legend(ui, *overlay),
                });
            });
            let place = Rect::from_min_size(line.left_bottom(), texture.size_vec2());
            let uv = Rect::from_min_max(egui::Pos2::ZERO, egui::pos2(1.0, 1.0));
            ui.painter().image(texture.id(), place, uv, Color32::WHITE);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_overlay_says_what_its_colours_mean() {
        let plain = Map2d::new(240, 40, [90, 90, 90]);
        let of = |overlay| sheet(&[(overlay, plain.clone())], 1);
        let ink = |picture: &Map2d<[u8; 3]>, from: usize| {
            let rows = picture.data()[..20 * picture.width()].chunks_exact(picture.width());
            rows.flat_map(|row| &row[from..]).filter(|p| p.iter().any(|c| *c > 140)).count()
        };
        for overlay in Overlay::ALL {
            let picture = of(overlay);
            assert_eq!(picture.at(120, 40), [90; 3], "{overlay:?}");
            assert!(ink(&picture, 0) > 20, "{overlay:?} has no name");
            // Beyond its name there is a scale, and none of it is cut off.
            assert!(overlay == Overlay::None || ink(&picture, 90) > 20, "{overlay:?} has no scale");
            assert_eq!(ink(&picture, 238), 0, "{overlay:?} is cut off");
        }
    }
}
