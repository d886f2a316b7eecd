//! What the window shows: the picture with the panel beside it, and beneath it a recording's timeline. Painted onto a
//! window by a presenter, or into a picture for whoever has no display.

use egui::{Color32, Context, Rect, TextureHandle, Ui, WidgetInfo};
use foveal::image::Map2d;

use super::legend;
use super::painter::SoftwarePainter;
use super::panel::{self, Shown};
use super::timeline;
use foveal_engine::replay::Segment;
use foveal_engine::source::Controls;
use foveal_engine::source::Wish;
use foveal_engine::walk::Walk;

/// What is there to be shown.
pub struct Interface<'a> {
    /// The walk, once its scene is loaded.
    pub walk: Option<&'a Walk>,
    /// Its picture, columns and rows.
    pub picture: Option<(egui::TextureId, egui::Vec2)>,
    /// A scene is being loaded: its name.
    pub loading: Option<&'a str>,
    /// Who presents: an adapter or the processor.
    pub presenter: &'a str,
}

/// What the user did, and where the picture is.
#[derive(Clone, Debug)]
pub struct Answer {
    /// The controls, where there is a walk.
    pub controls: Option<Controls>,
    /// What is wanted of a recording.
    pub wish: Option<Wish>,
    /// Where the picture is, points.
    pub picture_rect: Rect,
    /// The place that it has.
    pub space: Rect,
}

/// Draws everything. `help`: whether the keys are shown.
pub fn interface(ui: &mut Ui, shown: &Interface<'_>, help: &mut bool) -> Answer {
    let controls = shown.walk.map(|walk| *walk.controls());
    let mut answer = Answer { controls, wish: None, picture_rect: Rect::NOTHING, space: Rect::NOTHING };
    let recording = shown.walk.and_then(Walk::timeline);
    if let (Some(walk), Some(controls)) = (shown.walk, &mut answer.controls) {
        let status = walk.status();
        let shown = Shown {
            status: &status,
            recorded: recording.is_some(),
            times: &walk.times,
            quality: walk.quality(),
            speed: walk.navigator.speed(),
            ranges: walk.ranges(),
            insight: walk.insight(),
            presenter: shown.presenter,
            notices: &walk.notices,
        };
        egui::Panel::right("panel").resizable(false).exact_size(panel::WIDTH).show(ui, |ui| {
            panel::panel(ui, controls, &shown);
        });
    }
    if let Some((recording, plays)) = &recording {
        egui::Panel::bottom("timeline").resizable(false).exact_size(timeline::HEIGHT).show(ui, |ui| {
            answer.wish = timeline::timeline(ui, recording, *plays);
        });
        if !recording.state.0.is_empty() {
            egui::Panel::left("state").resizable(false).exact_size(timeline::STATE_WIDTH).show(ui, |ui| {
                answer.wish = timeline::state(ui, recording).or(answer.wish.take());
            });
        }
    }
    let space = ui.available_rect_before_wrap();
    answer.space = space;
    ui.painter().rect_filled(space, 0.0, Color32::BLACK);
    if let Some((texture, size)) = shown.picture {
        answer.picture_rect = fit(size, space);
        let uv = Rect::from_min_max(egui::Pos2::ZERO, egui::pos2(1.0, 1.0));
        ui.painter().image(texture, answer.picture_rect, uv, Color32::WHITE);
        // Painted, not laid out: who cannot see it is told by this what is there.
        let picture = ui.interact(answer.picture_rect, ui.scope_id().with("picture"), egui::Sense::hover());
        picture.widget_info(|| WidgetInfo::labeled(egui::Role::Image, true, "the walk's picture"));
        let overlay = answer.controls.map_or_else(Default::default, |controls| controls.overlay);
        legend::over_picture(ui.ctx(), overlay, answer.picture_rect);
        if let Some((recording, _)) = &recording {
            path(ui, &recording.path, answer.picture_rect, size);
        }
    }
    if let Some(name) = shown.loading {
        let font = egui::FontId::proportional(20.0);
        let text = format!("Loading {name} ...");
        ui.painter().text(space.center(), egui::Align2::CENTER_CENTER, text, font, Color32::GRAY);
    }
    panel::help(ui.ctx(), help);
    answer
}

/// The way of a sample's light, over the picture.
fn path(ui: &Ui, segments: &[Segment], rect: Rect, size: egui::Vec2) {
    let painter = ui.painter_at(rect);
    let at = |[x, y]: [f32; 2]| rect.min + egui::vec2(x, y) * rect.size() / size;
    for segment in segments {
        let [r, g, b] = segment.color();
        let width = 1.0 + segment.share;
        let ends = segment.ends.map(at);
        painter.line_segment(ends, egui::Stroke::new(width, Color32::from_rgb(r, g, b)));
        painter.circle_filled(ends[0], 2.0, Color32::WHITE);
    }
}

/// A picture as the interface's texture.
pub fn texture(context: &Context, texture: Option<TextureHandle>, picture: &Map2d<[u8; 3]>) -> TextureHandle {
    let size = [picture.width(), picture.height()];
    let image = egui::ColorImage::from_rgb(size, picture.data().as_flattened());
    let options =
        egui::TextureOptions { magnification: egui::TextureFilter::Nearest, ..egui::TextureOptions::LINEAR };
    match texture {
        Some(mut texture) => {
            texture.set(image, options);
            texture
        }
        None => context.load_texture("picture", image, options),
    }
}

/// The whole window of a walk as a picture of `size`, without a window.
pub fn paint(walk: &Walk, size: [usize; 2]) -> Map2d<[u8; 3]> {
    let mut picture = None;
    paint_ui(size, |ui| {
        if let (None, Some(shown)) = (&picture, walk.picture()) {
            picture = Some(texture(ui.ctx(), None, shown));
        }
        let picture = picture.as_ref().map(|p| (p.id(), p.size_vec2()));
        interface(ui, &Interface { walk: Some(walk), picture, loading: None, presenter: "" }, &mut false);
    })
}

/// What is drawn, as a picture of `size`, without a window.
pub fn paint_ui(size: [usize; 2], mut draw: impl FnMut(&mut Ui)) -> Map2d<[u8; 3]> {
    let context = Context::default();
    let mut painter = SoftwarePainter::default();
    let area = Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(size[0] as f32, size[1] as f32));
    let mut pixels = vec![0; size[0] * size[1]];
    // The second time everything knows its size.
    for _ in 0..2 {
        let input = egui::RawInput { screen_rect: Some(area), ..egui::RawInput::default() };
        let output = context.run_ui(input, &mut draw);
        let primitives = context.tessellate(output.shapes, output.pixels_per_point);
        let mut textures = output.textures_delta;
        painter.set_textures(&textures);
        pixels.fill(0);
        painter.paint(&primitives, output.pixels_per_point, size, &mut pixels);
        painter.free_textures(&textures);
        textures.set.clear();
        textures.free.clear();
    }
    let rgb = |word: u32| [(word >> 16) as u8, (word >> 8) as u8, word as u8];
    Map2d::from_vec(size[0], size[1], pixels.into_iter().map(rgb).collect())
}

/// The largest place of a picture of `size` within `space`, in the middle. Whole multiples where it is enlarged
/// would leave black bars, so it fills.
fn fit(size: egui::Vec2, space: Rect) -> Rect {
    if size.x <= 0.0 || size.y <= 0.0 {
        return Rect::NOTHING;
    }
    let scale = (space.width() / size.x).min(space.height() / size.y).max(0.0);
    // Unscaled pictures stay on whole pixels.
    let shown = size * scale;
    let corner = (space.center() - shown * 0.5).round();
    Rect::from_min_size(corner, shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_fill_their_space_without_distortion() {
        let space = Rect::from_min_size(egui::pos2(10.0, 0.0), egui::vec2(400.0, 100.0));
        let rect = fit(egui::vec2(64.0, 32.0), space);
        assert_eq!((rect.width(), rect.height()), (200.0, 100.0));
        assert_eq!(rect.center(), space.center());
        assert_eq!(fit(egui::Vec2::ZERO, space), Rect::NOTHING);
    }
}
