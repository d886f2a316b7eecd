//! What each actor did in a frame: a lane for each, a box for each delivery, arrows from where a message was sent to where
//! it was delivered. What the frame waited for is bright.

use egui::{Color32, Pos2, Rect, Role, Sense, Stroke, Ui, WidgetInfo, pos2};

use foveal_engine::source::{LaneSlice, LanesShown, Wish};

/// Points that a lane is high.
const LANE: f32 = 16.0;
/// Points for the names.
const NAMES: f32 = 92.0;
/// Arrows drawn at most where none is pointed at: more would hide each other.
const ARROWS_MAX: usize = 150;

const QUIET: Color32 = Color32::from_rgb(70, 100, 140);
const CRITICAL: Color32 = Color32::from_rgb(225, 150, 50);
const ARROW: Color32 = Color32::from_rgb(120, 130, 140);

/// Draws the lanes. Returns where the user wants to go.
pub fn lanes(ui: &mut Ui, lanes: &LanesShown) -> Option<Wish> {
    let mut wish = None;
    ui.weak(format!(
        "{:.2} ms in the replay; bright is what the frame waited for; click a box to go there",
        lanes.whole_ns as f64 * 1e-6
    ));
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let size = egui::vec2(ui.available_width(), LANE * lanes.names.len() as f32 + 4.0);
        let (area, response) = ui.allocate_exact_size(size, Sense::click());
        response.widget_info(|| WidgetInfo::labeled(Role::Canvas, true, spoken(lanes)));
        let painter = ui.painter_at(area);
        for (lane, name) in lanes.names.iter().enumerate() {
            let y = area.top() + LANE * (lane as f32 + 0.5);
            let at = pos2(area.left() + 2.0, y);
            painter.text(at, egui::Align2::LEFT_CENTER, name, egui::FontId::monospace(11.0), Color32::GRAY);
            let line = [pos2(area.left() + NAMES, y), pos2(area.right(), y)];
            painter.line_segment(line, Stroke::new(1.0, Color32::from_gray(45)));
        }
        let boxes: Vec<Rect> = lanes.slices.iter().map(|slice| place(slice, lanes, area)).collect();
        let pointed = response.hover_pos().and_then(|at| pointed_at(&boxes, at));
        // What is bright lies over the rest.
        for is_critical in [false, true] {
            for (slice, rect) in lanes.slices.iter().zip(&boxes) {
                if slice.is_critical == is_critical {
                    painter.rect_filled(*rect, 1.0, if is_critical { CRITICAL } else { QUIET });
                }
            }
        }
        let all = lanes.arrows.len() <= ARROWS_MAX;
        for (from, to) in &lanes.arrows {
            let is_pointed = pointed.is_some_and(|pointed| pointed == *from || pointed == *to);
            let is_critical = lanes.slices[*from].is_critical && lanes.slices[*to].is_critical;
            if is_pointed || (pointed.is_none() && (all || is_critical)) {
                let color = if is_pointed { Color32::WHITE } else { ARROW };
                arrow(&painter, boxes[*from], boxes[*to], Stroke::new(1.0, color));
            }
        }
        let Some(pointed) = pointed else { return };
        let slice = &lanes.slices[pointed];
        painter.rect_stroke(boxes[pointed], 1.0, Stroke::new(1.0, Color32::WHITE), egui::StrokeKind::Outside);
        if response.clicked() {
            wish = Some(Wish::Place(slice.at.clone()));
        }
        let text = format!("{} {}, {:.3} ms", slice.at, slice.kind, slice.duration_ns as f64 * 1e-6);
        response.on_hover_text_at_pointer(text);
    });
    wish
}

/// What is drawn, for who cannot see it.
fn spoken(lanes: &LanesShown) -> String {
    format!("deliveries in this frame: {}, to {}", lanes.slices.len(), lanes.names.join(", "))
}

/// Where a delivery is drawn: never so narrow that it cannot be seen.
fn place(slice: &LaneSlice, lanes: &LanesShown, area: Rect) -> Rect {
    let (left, width) = (area.left() + NAMES, (area.width() - NAMES - 4.0).max(1.0));
    let at = |ns: u64| left + width * (ns as f64 / lanes.whole_ns.max(1) as f64).min(1.0) as f32;
    let (x0, x1) = (at(slice.start_ns), at(slice.start_ns + slice.duration_ns));
    let y = area.top() + LANE * slice.lane as f32;
    Rect::from_min_max(pos2(x0, y + 2.0), pos2(x1.max(x0 + 1.5), y + LANE - 2.0))
}

/// The box at a point, or the one next to it.
fn pointed_at(boxes: &[Rect], at: Pos2) -> Option<usize> {
    const REACH: f32 = 3.0;
    let near = boxes.iter().enumerate().map(|(number, rect)| (rect.distance_to_pos(at), number));
    let (distance, number) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (distance <= REACH).then_some(number)
}

fn arrow(painter: &egui::Painter, from: Rect, to: Rect, stroke: Stroke) {
    const HEAD: f32 = 3.0;
    let (a, b) = (pos2(from.right().min(to.left()).max(from.left()), from.center().y), to.left_center());
    painter.line_segment([a, b], stroke);
    for side in [-HEAD, HEAD] {
        painter.line_segment([b, b + egui::vec2(-HEAD, side)], stroke);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slice(lane: usize, start_ns: u64, duration_ns: u64) -> LaneSlice {
        LaneSlice { lane, start_ns, duration_ns, kind: "Order", at: "a:1".into(), is_critical: false }
    }

    #[test]
    fn deliveries_lie_on_their_lanes_in_their_time() {
        let slices = vec![slice(0, 0, 500), slice(1, 500, 500), slice(1, 1000, 0)];
        let names = vec!["a".into(), "b".into()];
        let lanes = LanesShown { names, whole_ns: 1000, slices, arrows: vec![(0, 1)] };
        let area = Rect::from_min_size(pos2(10.0, 20.0), egui::vec2(NAMES + 204.0, 40.0));
        let boxes: Vec<Rect> = lanes.slices.iter().map(|slice| place(slice, &lanes, area)).collect();
        assert_eq!((boxes[0].left(), boxes[0].right()), (10.0 + NAMES, 110.0 + NAMES));
        assert_eq!(boxes[1].left(), boxes[0].right());
        assert!(boxes[1].top() > boxes[0].bottom() && boxes[2].width() >= 1.0);
        assert_eq!(pointed_at(&boxes, boxes[1].center()), Some(1));
        assert_eq!(pointed_at(&boxes, pos2(0.0, 0.0)), None);
    }
}
