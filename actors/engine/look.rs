//! What can be seen of a running walk: its picture with exposure and overlay, its actors.

use std::time::Duration;

use foveal::display::tone::{Encoder, ToneMap};
use foveal::image::Map2d;
use foveal::splatting::Footprint;
use foveal::world::World;
use foveal_runtime::Runtime;

use foveal_actors::insight::{Insight, ObjectInsight};
use foveal_actors::message::View;
use foveal_actors::renderer::overlay::{Overlay, Sources, paint, tile_error};
use foveal_actors::renderer::{Renderer, Splats};

use crate::source::{ActorStatus, Controls};

/// Just noticeable differences that the overlay of errors shows white. Below, by the square root, since most are small.
const ERROR_MAX: f32 = 4.0;

/// What is to be shown, and how.
pub struct DisplayInput<'a> {
    /// Whose picture it is.
    pub renderer: &'a Renderer,
    /// Everything that was splatted in a view, in order, and which view that is.
    pub splats: (View, &'a [Splats]),
    /// The area that fresh samples paint.
    pub footprint: Footprint,
    /// How radiance is shown.
    pub tone: ToneMap,
    /// What is painted over it.
    pub overlay: Overlay,
    /// What that shows of objects or textures: [`Sources::values`].
    pub values: &'a [f32],
}

/// A display that draws by itself what the renderer shows, as a graphics adapter does.
pub trait Mirror {
    /// Draws it. `false`, and nothing changes, where there is nothing to show or no room for it.
    fn show(&mut self, shown: &DisplayInput<'_>) -> bool;
}

/// The renderer's last picture as `controls` want it seen; `between_frames` the picture as it has become since.
pub fn picture(
    renderer: &Renderer,
    world: &World,
    controls: &Controls,
    insight: Option<&Insight>,
    encoder: &Encoder,
    between_frames: bool,
) -> Option<Map2d<[u8; 3]>> {
    let shown = renderer.shown()?;
    let as_shown = renderer.is_shown() || !between_frames;
    let rgb8 = if as_shown && controls.set.tone == ToneMap::from(&world.scene.display) {
        (*shown.rgb8).clone()
    } else {
        renderer.picture()?.map(|radiance| encoder.rgb8(&controls.set.tone, radiance))
    };
    if controls.overlay == Overlay::None {
        return Some(rgb8);
    }
    let values = values(controls.overlay, renderer, insight);
    let buffers = renderer.drawn()?.buffers();
    let k_max = renderer.k_max();
    let tile_errors = tile_errors(renderer, &controls.set.tone);
    let sources =
        Sources { buffers, splats: renderer.layer(), k_max, values: &values, tile_errors: &tile_errors };
    Some(paint(controls.overlay, &sources, &rgb8))
}

/// Lets `mirror` show the same, by itself. Whether it could.
pub fn draw_on(
    renderer: &Renderer,
    controls: &Controls,
    insight: Option<&Insight>,
    (view, splats): (View, &[Splats]),
    footprint: Footprint,
    mirror: &mut dyn Mirror,
) -> bool {
    let (tone, overlay) = (controls.set.tone, controls.overlay);
    let values = &values(overlay, renderer, insight);
    let shown = DisplayInput { renderer, splats: (view, splats), footprint, tone, overlay, values };
    mirror.show(&shown)
}

/// What is left of the error in each tile of a refined view, as overlays show it; NaN in the others.
fn tile_errors(renderer: &Renderer, tone: &ToneMap) -> Vec<f32> {
    let mut errors = Vec::new();
    for tile in renderer.tiles() {
        let index = tile.tile as usize;
        if errors.len() <= index {
            errors.resize(index + 1, f32::NAN);
        }
        errors[index] = tile_error(tile, tone);
    }
    errors
}

/// What an overlay shows of each object or texture: [`Sources::values`].
fn values(overlay: Overlay, renderer: &Renderer, insight: Option<&Insight>) -> Vec<f32> {
    let objects = insight.map_or(&[][..], |insight| &insight.objects);
    let of = |value: fn(&ObjectInsight) -> f32| objects.iter().map(value).collect::<Vec<f32>>();
    match overlay {
        Overlay::Saliency => relative(of(|o| if o.pixels > 0 { o.saliency } else { 0.0 })),
        Overlay::Importance => relative(of(|o| o.importance)),
        Overlay::Priority => relative(of(|o| o.priority)),
        Overlay::Error => of(|o| o.error.map_or(1.0, |e| (e / ERROR_MAX).max(0.0).sqrt())),
        Overlay::MipGiven => renderer.world().scene.textures.iter().map(|t| t.mips.finest() as f32).collect(),
        _ => Vec::new(),
    }
}

/// Relative to the largest finite value of the objects that can be corrected; what is infinite is 1.
fn relative(mut values: Vec<f32>) -> Vec<f32> {
    let highest = values.iter().skip(1).copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let scale = if highest > 0.0 { 1.0 / highest } else { 0.0 };
    for value in &mut values {
        *value = if value.is_finite() { *value * scale } else { 1.0 };
    }
    values
}

/// The actors as they are.
pub fn actors(runtime: &Runtime) -> Vec<ActorStatus> {
    let status = |c: foveal_runtime::ActorCounters| ActorStatus {
        name: c.name,
        delivered: c.delivered,
        waiting: c.depth,
        waiting_max: c.depth_max.max(c.depth),
        busy: Duration::from_nanos(c.busy_ns),
    };
    // Ports have no turns.
    runtime.counters().into_iter().filter(|c| c.turns > 0).map(status).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_relative_to_the_largest_finite_one() {
        assert_eq!(relative(vec![9.0, 1.0, 4.0, f32::INFINITY]), [2.25, 0.25, 1.0, 1.0]);
        assert_eq!(relative(vec![0.0, 0.0]), [0.0, 0.0]);
    }
}
