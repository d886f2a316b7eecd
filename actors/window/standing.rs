//! The panel's head: where the walk stands, what went wrong, and how the frames go.

use egui::{CollapsingHeader, Color32, Pos2, Rect, RichText, Sense, Shape, Stroke, Ui, Vec2};
use foveal::allocation::supersampling::RefinementProgress;
use foveal_engine::walk::{FrameTimes, Notice, Notices};

use super::panel::{Shown, WIDTH};

const STATE: &str = "A view begins when the camera moves. It is corrected until every pixel that is not diffuse \
                     shows its own ray (converged), and then refined with more samples for each pixel";
const SAMPLES: &str = "Samples in the last frame: traced for this view, reused from earlier views, and expired, \
                       being too old or seen from too different a side (Haber 2001 §4.5)";
const QUALITY: &str = "Speed of walking in scene units; the wheel sets it. Quality is minus the mean visible error of \
                       a pixel in just noticeable differences; 0 is a picture without error (Q, Dumont 2003, Eq. (1))";
const NOISE: &str = "Tiles whose standard error of displayed values, 0 to 1, is below \"noise\", and the largest \
                     standard error of a tile";
const STATED: &str =
    "With 95 % certainty the mean of each block of 8 × 8 pixels is off by less than this share of it";
const LOST: &str = "A job whose tracer panics, or hangs, or is a machine that left, is given to another tracer. One \
                    that several tracers failed at is lost: what it would have traced is left out";
const EARLIER: &str =
    "What you were told before, the newest first; of the earliest only their number is kept";
const TIMES: &str = "Median and 99th percentile of the time that frames took, and the time a frame may take";
const GRAPH: &str = "How long each of the last frames took; the line is the deadline, red came late";

/// Where the walk stands and what the user is told.
pub fn standing(ui: &mut Ui, shown: &Shown<'_>) {
    let status = shown.status;
    let insight = shown.insight.map(|(insight, _)| insight);
    let refinement = insight.filter(|_| status.converged).and_then(|insight| insight.refinement);
    let state = status.state(refinement.is_some());
    ui.label(RichText::new(format!("view {}, {state}", status.view)).strong()).on_hover_text(STATE);
    let samples = format!("{} traced, {} reused, {} expired", status.traced, status.reused, status.expired);
    ui.label(samples).on_hover_text(SAMPLES);
    let quality = shown.quality.map_or_else(|| "not known".to_owned(), |quality| format!("{quality:.3}"));
    ui.label(format!("speed {:.3} per second, quality {quality}", shown.speed)).on_hover_text(QUALITY);
    if let Some(RefinementProgress { tiles, quiet, error: Some(error), stated }) = refinement {
        let noise = format!("{quiet} of {tiles} tiles below the noise bound, worst {error:.4}");
        ui.label(noise).on_hover_text(NOISE);
        if let Some(stated) = stated {
            let stated = 100.0 * stated;
            // No sample finds them, and what refinement replaces had them from the map.
            let but = "but for caustics of points, spots and suns that are seen in mirrors or through glass";
            ui.label(format!("error below {stated:.1} %, {but}")).on_hover_text(STATED);
        }
    }
    if let Some(lost @ 1..) = insight.map(|insight| insight.lost_jobs) {
        let text = format!("{lost} {} lost", if lost == 1 { "job" } else { "jobs" });
        ui.colored_label(ui.visuals().error_fg_color, text).on_hover_text(LOST);
    }
    notices(ui, shown.notices);
}

/// What the user was told last, and folded away, so that sliders stay where they are, what came before.
fn notices(ui: &mut Ui, notices: &Notices) {
    let line = |ui: &mut Ui, notice: &Notice| {
        let color = if notice.failed { ui.visuals().error_fg_color } else { ui.visuals().text_color() };
        ui.colored_label(color, &notice.text);
    };
    let mut kept = notices.iter();
    let Some(newest) = kept.next() else { return };
    line(ui, newest);
    let before: Vec<&Notice> = kept.collect();
    if before.is_empty() {
        return;
    }
    let failed = before.iter().any(|notice| notice.failed);
    let title = RichText::new(format!("{} messages before", before.len() + notices.earlier()));
    let title = if failed { title.color(ui.visuals().error_fg_color) } else { title.weak() };
    let header = CollapsingHeader::new(title).id_salt("messages").show(ui, |ui| {
        before.into_iter().for_each(|notice| line(ui, notice));
        if notices.earlier() > 0 {
            ui.weak(format!("and {} earlier", notices.earlier()));
        }
    });
    header.header_response.on_hover_text(EARLIER);
}

/// Frame times against the deadline.
pub fn graph(ui: &mut Ui, times: &FrameTimes, fps: f32) {
    let deadline = 1.0 / fps.max(0.1);
    let text = match times.median_p99() {
        Some((median, p99)) => format!(
            "frame {:.0} ms, p99 {:.0} ms, deadline {:.0} ms",
            median * 1e3,
            p99 * 1e3,
            deadline * 1e3
        ),
        None => "no frame yet".to_owned(),
    };
    ui.label(text).on_hover_text(TIMES);
    let (rect, drawn) =
        ui.allocate_exact_size(Vec2::new(ui.available_width().min(WIDTH - 20.0), 48.0), Sense::hover());
    drawn.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "times of the last frames"));
    drawn.on_hover_text(GRAPH);
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
