//! The bar beneath a recording: a timeline to scrub, steps by frame and by message, a search, the last deliveries, what each
//! actor did in a frame, and the story of a pixel; and beside the picture an actor's state.

use egui::{Color32, RichText, Slider, Ui};

use super::lanes;
use foveal_engine::source::{TimelineShown, Wish};

/// Points that the bar is high.
pub const HEIGHT: f32 = 260.0;
/// Points that a state is wide.
pub const STATE_WIDTH: f32 = 280.0;

const WHEN: &str =
    "Something to look for in the recording: a value of an actor's state, a pixel, or a message";

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
        button(
            ui,
            if plays { "pause" } else { "play" },
            "Play the recording, or stop there (Space)",
            Wish::Play,
        );
        button(ui, "frame -", "One frame back (Left)", Wish::Frame(at.saturating_sub(1)));
        button(ui, "frame +", "One frame on (Right)", Wish::Frame((at + 1).min(last)));
        button(ui, "message -", "Take the last message back (comma)", Wish::Messages(-1));
        button(ui, "message +", "Deliver one more message (period)", Wish::Messages(1));
        button(
            ui,
            "walk on from here",
            "Leave the recording and walk on from here; samples are traced anew (B)",
            Wish::Branch,
        );
        let shows_lanes = shown.lanes.is_some();
        button(
            ui,
            if shows_lanes { "messages" } else { "lanes" },
            "What each actor did in this frame, or the last messages",
            Wish::Lanes(!shows_lanes),
        );
        let told = &shown.state.0;
        let wanted =
            if told.is_empty() { shown.actors.first().cloned().unwrap_or_default() } else { String::new() };
        button(
            ui,
            if told.is_empty() { "state" } else { "no state" },
            "What an actor knows at this moment",
            Wish::State(wanted),
        );
        if let Some(parted) = shown.parted {
            let hint = "The first frame whose picture differs from that of the recording beside";
            button(ui, &format!("first difference: frame {parted}"), hint, Wish::Frame(parted));
        }
        let text = format!("frame {at} of {}", shown.frames);
        ui.add(egui::Label::new(text).wrap_mode(egui::TextWrapMode::Extend));
    });
    wish = search(ui, shown).or(wish);
    let mut frame = at;
    ui.spacing_mut().slider_width = (ui.available_width() - 20.0).max(50.0);
    let slider = ui.add(Slider::new(&mut frame, 0..=last.max(1)).show_value(false)).accessible_name("frame");
    let slider = slider.on_hover_text("The frame that is shown; drag it to any other");
    if slider.changed() {
        wish = Some(Wish::Frame(frame.min(last)));
    }
    if let Some(parted) = shown.parted {
        mark(ui, slider.rect, parted as f32 / last.max(1) as f32);
    }
    if let Some(lanes) = &shown.lanes {
        return lanes::lanes(ui, lanes).or(wish);
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

/// A field for a condition, and the places where it comes about.
fn search(ui: &mut Ui, shown: &TimelineShown) -> Option<Wish> {
    let mut wish = None;
    let id = ui.scope_id().with("condition");
    let mut text = ui.data_mut(|data| data.get_temp::<String>(id)).unwrap_or_default();
    ui.horizontal(|ui| {
        let label = ui.label("when").on_hover_text(WHEN);
        let hint = "renderer.view > 4    pixel 100,200 changes    allocator hears JobDone";
        let field = ui.add(egui::TextEdit::singleline(&mut text).hint_text(hint).desired_width(330.0));
        let field = field.labelled_by(label.id).on_hover_text(WHEN);
        let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        let find = ui.button("find").on_hover_text("Find all places where that comes about");
        if (find.clicked() || entered) && !text.trim().is_empty() {
            wish = Some(Wish::Find(text.trim().to_owned()));
        }
        if !shown.found.is_empty() {
            let places = shown.found.iter().filter(|(_, place)| !place.is_empty()).count();
            let title = if places > 0 { format!("{places} places") } else { shown.found[0].0.clone() };
            let found = egui::ComboBox::from_id_salt("found").width(260.0).selected_text(title);
            let found = found.show_ui(ui, |ui| {
                for (told, place) in &shown.found {
                    let line = RichText::new(told).monospace().size(11.0);
                    if ui.selectable_label(false, line).clicked() && !place.is_empty() {
                        wish = Some(Wish::Place(place.clone()));
                    }
                }
            });
            found.response.accessible_name("found").on_hover_text("What was found; choose one to go there");
        }
    });
    ui.data_mut(|data| data.insert_temp(id, text));
    wish
}

/// A mark on a slider.
fn mark(ui: &Ui, rect: egui::Rect, share: f32) {
    let x = egui::lerp(rect.left()..=rect.right(), share.clamp(0.0, 1.0));
    let ends = [egui::pos2(x, rect.top()), egui::pos2(x, rect.bottom())];
    ui.painter().line_segment(ends, egui::Stroke::new(2.0, Color32::from_rgb(230, 90, 60)));
}

/// Draws an actor's state. Returns whose state is wanted instead.
pub fn state(ui: &mut Ui, shown: &TimelineShown) -> Option<Wish> {
    let (told, lines) = &shown.state;
    let mut chosen = told.clone();
    let actors = egui::ComboBox::from_id_salt("actor").width(180.0).selected_text(told);
    let actors = actors.show_ui(ui, |ui| {
        for actor in &shown.actors {
            ui.selectable_value(&mut chosen, actor.clone(), actor);
        }
    });
    actors.response.accessible_name("actor").on_hover_text("The actor whose state is shown");
    egui::ScrollArea::both().auto_shrink(false).show(ui, |ui| {
        lines.iter().for_each(|line| line_of(ui, line));
    });
    (chosen != *told).then_some(Wish::State(chosen))
}

fn line_of(ui: &mut Ui, line: &str) {
    let text = RichText::new(line).monospace().size(11.0);
    ui.add(egui::Label::new(text).wrap_mode(egui::TextWrapMode::Extend));
}
