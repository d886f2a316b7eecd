//! What the colours of an overlay mean, for the page's legend.

use foveal_actors::renderer::overlay::{AGE_FRESH, Overlay, heat};
use serde_json::{Map, Value, json};

/// Colours of a scale.
const STEPS: usize = 16;

/// By the name of an overlay: a sentence, and what stands at both ends of its scale, where it has one.
pub fn scales() -> Value {
    let of = |overlay| {
        let ends = match overlay {
            Overlay::None => return None,
            Overlay::Saliency | Overlay::Importance => Some(["least", "most"]),
            Overlay::Priority => Some(["last", "next"]),
            Overlay::Error => Some(["0", "4 JND"]),
            Overlay::Level => Some(["coarse", "own ray"]),
            Overlay::Age => Some(["1", "63"]),
            Overlay::Tracer | Overlay::Objects => None,
            Overlay::Mip | Overlay::MipGiven => Some(["level 8", "0"]),
        };
        Some((overlay.name().to_owned(), json!({"text": overlay.help(), "ends": ends})))
    };
    let color = |c: foveal_engine::glam::Vec3| {
        let [r, g, b] = c.to_array().map(|v| (v * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    };
    let heat: Vec<String> = (0..STEPS).map(|i| color(heat(i as f32 / (STEPS - 1) as f32))).collect();
    let overlays: Map<String, Value> = Overlay::ALL.into_iter().filter_map(of).collect();
    json!({"overlays": overlays, "heat": heat, "fresh": color(AGE_FRESH)})
}
