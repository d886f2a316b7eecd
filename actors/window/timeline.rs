//! The bar beneath a recording: a timeline to scrub, steps by frame and by message, the last deliveries, and the story of
//! a pixel.

use egui::{RichText, Slider, Ui};

use foveal_engine::source::{TimelineShown, Wish};

/// Points that the bar is high.
pub const HEIGHT: f32 = 230.0;

/// Draws the bar. Returns what the user wants.
pub fn timeline(ui: &mut Ui, shown: &TimelineShown, plays: bool) -> Option<Wish> {
    let mut wish = None;
    let last = shown.frames.saturating_sub(1);
    let at = shown.frame.unwrap_or(0);
    ui.horizontal_wrapped(|ui| {
        let mut button = |ui: &mut Ui, text: &str, hint: &str, what: Wish| {
            if ui.button(text).on_hover_text(hint).clicked() {
                wish = Some(what);
            }
        };
        button(ui, if plays { "pause" } else { "play" }, "Space", Wish::Play);
        button(ui, "frame -", "Left", Wish::Frame(at.saturating_sub(1)));
        button(ui, "frame +", "Right", Wish::Frame((at + 1).min(last)));
        button(ui, "message -", ",", Wish::Messages(-1));
        button(ui, "message +", ".", Wish::Messages(1));
        button(ui, "walk on from here", "B", Wish::Branch);
        let text = format!("frame {at} of {}", shown.frames);
        ui.add(egui::Label::new(text).wrap_mode(egui::TextWrapMode::Extend));
    });
    let mut frame = at;
    ui.spacing_mut().slider_width = (ui.available_width() - 20.0).max(50.0);
    if ui.add(Slider::new(&mut frame, 0..=last.max(1)).show_value(false)).changed() {
        wish = Some(Wish::Frame(frame.min(last)));
    }
    egui::ScrollArea::both().auto_shrink(false).stick_to_bottom(shown.story.is_empty()).show(ui, |ui| {
        line_of(ui, &shown.position);
        if shown.story.is_empty() {
            ui.weak("click a pixel for its story");
            shown.lines.iter().for_each(|line| line_of(ui, line));
        } else {
            shown.story.iter().for_each(|line| line_of(ui, line));
        }
    });
    wish
}

fn line_of(ui: &mut Ui, line: &str) {
    let text = RichText::new(line).monospace().size(11.0);
    ui.add(egui::Label::new(text).wrap_mode(egui::TextWrapMode::Extend));
}
