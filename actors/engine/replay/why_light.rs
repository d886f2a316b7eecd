//! What light the surface behind a pixel shows: which lamp brought it straight, what came after other surfaces, which map
//! says so and how far off that is said to be; and why its texture is as fine as it is.

use foveal::display::cpu_pass::{primary_interaction, primary_ray};
use foveal::scene::edit::Lamp;
use foveal::transport::arrivals::arrivals;
use foveal::transport::interaction::Interaction;
use foveal_actors::insight::Insight;
use foveal_actors::message::DrawnView;
use glam::Vec3;
use serde_json::{Value, json};

use crate::opened::lamp_name;
use crate::pick;

/// Samples by which lamps with an area are told apart.
const SAMPLES: u32 = 4096;
/// Seed of these.
const SEED: u64 = 0x0a11;

/// The surface behind a pixel, and its light; null where there is none.
pub fn surface(drawn: &DrawnView, (x, y): (usize, usize), insight: Option<&Insight>) -> Value {
    let (DrawnView { world, frame, .. }, buffers) = (drawn, drawn.buffers());
    let ray = primary_ray(frame, x as u32, y as u32);
    let Some(hit) = buffers.hit.at(x, y).hit() else { return Value::Null };
    let at = primary_interaction(world, frame, &ray, &hit);
    let scene = &world.scene;
    json!({
        "position": at.position.to_array(),
        "normal": at.facing_shading().to_array(),
        "distance": at.t,
        "thing": scene.things.of(at.triangle).and_then(|id| Some(pick::named(id, scene.things.get(id)?))),
        "material": at.material(scene).name,
        "back": at.back,
        "light": light(drawn, &at),
        "texture": texture(drawn, &at, insight),
    })
}

fn light(drawn: &DrawnView, at: &Interaction) -> Value {
    let world = &drawn.world;
    let all = world.illumination.irradiance(at.triangle, at.b1, at.b2, at.back);
    let direct = arrivals(world.indexed(), at, SAMPLES, SEED);
    let straight: Vec3 = direct.iter().map(|arrival| arrival.irradiance).sum();
    let stored = world.illumination.stored();
    let lamps = direct.iter().map(|arrival| {
        json!({
            "lamp": lamp_name(&world.scene, arrival.lamp),
            "is": match arrival.lamp {
                Lamp::Material(_) => "material",
                Lamp::Light(_) => "light",
                Lamp::Environment => "environment",
            },
            "irradiance": arrival.irradiance.to_array(),
            "noise": arrival.noise,
        })
    });
    json!({
        // W/m² per band.
        "irradiance": all.to_array(),
        // Of its luminance at this place. A first estimate holds none: nothing was held back to find it by.
        "stated_error": stored
            .filter(|map| map.summary.rounds > 0 && all != Vec3::ZERO)
            .map(|map| map.lookup(at.triangle, at.b1, at.b2, at.back).w),
        "direct": lamps.collect::<Vec<_>>(),
        // What the map has beyond that, and where it errs; nothing where nothing is stored, as on metal.
        "indirect": (all != Vec3::ZERO).then(|| (all - straight).to_array()),
        "map": stored.map(|map| json!({
            "rounds": map.summary.rounds,
            "paths": map.summary.particles,
            "stated_error": (map.summary.rounds > 0).then_some(map.summary.relative_error),
        })),
    })
}

fn texture(drawn: &DrawnView, at: &Interaction, insight: Option<&Insight>) -> Value {
    let scene = &drawn.world.scene;
    let Some(map) = at.material(scene).picture() else { return Value::Null };
    let (number, texture) = (map.0 as usize, &scene.textures[map.0 as usize]);
    let (wanted, finest) = (at.point().texture_level(texture), texture.mips.finest());
    let limited = insight.and_then(|insight| insight.textures.as_ref());
    let charge = limited.and_then(|(report, _)| report.bill.get(number));
    json!({
        "name": texture.name,
        "levels": texture.level_count(),
        "wanted": wanted,
        "finest": finest,
        "shown": wanted.max(finest as f32),
        "budget": limited.map(|(report, limit)| json!({
            "limit": limit,
            "used": report.used,
            "price_per_mib": report.price_per_mib,
        })),
        "bill": charge.map(|charge| json!({
            "pixels": charge.pixels,
            "asked": charge.asked,
            "given": charge.given,
            "loss": charge.loss,
        })),
    })
}

/// The same in lines.
pub fn told(surface: &Value) -> Vec<String> {
    let mut lines = Vec::new();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let band = |value: &Value| {
        let of = |i: usize| value[i].as_f64().unwrap_or_default();
        format!("{:.4} {:.4} {:.4}", of(0), of(1), of(2))
    };
    if surface.is_null() {
        return vec!["surface   none: the environment is seen".to_owned()];
    }
    let (material, side) =
        (text(&surface["material"]), if surface["back"] == true { ", its back" } else { "" });
    let distance = surface["distance"].as_f64().unwrap_or_default();
    let thing = &surface["thing"]["path"];
    if thing.is_string() {
        lines.push(format!("thing     \"{}\"", text(thing)));
    }
    lines.push(format!(
        "surface   material \"{material}\"{side}, {distance:.3} away, at {}",
        band(&surface["position"])
    ));
    let light = &surface["light"];
    let stated = light["stated_error"].as_f64();
    let stated = stated.map_or_else(
        || ", its error not known".to_owned(),
        |error| format!(", ± {error:.4} stated at this place"),
    );
    let is_stored = !light["indirect"].is_null();
    lines.push(match is_stored {
        true => format!("light     {} W/m²{stated}", band(&light["irradiance"])),
        false => "light     none is stored on this surface".to_owned(),
    });
    for lamp in light["direct"].as_array().into_iter().flatten() {
        let noise = lamp["noise"].as_f64().unwrap_or_default();
        let (is, name) = (text(&lamp["is"]), text(&lamp["lamp"]));
        lines.push(format!("  straight  {} ± {noise:.4} from {is} \"{name}\"", band(&lamp["irradiance"])));
    }
    if is_stored {
        lines.push(format!("  indirect  {}: the rest of what the map holds", band(&light["indirect"])));
    }
    let map = &light["map"];
    if is_stored && !map.is_null() {
        let of = match map["stated_error"].as_f64() {
            Some(error) => {
                format!(
                    "of round {}, {} paths, stated error {:.2} %",
                    map["rounds"],
                    map["paths"],
                    100.0 * error
                )
            }
            None => format!("a first estimate of {} paths", map["paths"]),
        };
        lines.push(format!("  map       {of}"));
    }
    let texture = &surface["texture"];
    if !texture.is_null() {
        let name = text(&texture["name"]);
        let of = |key: &str| texture[key].as_f64().unwrap_or_default();
        let (wanted, finest) = (of("wanted"), of("finest"));
        let why = match (texture["bill"].as_object(), texture["budget"].as_object()) {
            _ if wanted >= finest => "as fine as the pixel can show".to_owned(),
            (Some(bill), Some(budget)) => format!(
                "finer ones are not in memory: of {} bytes {} are used, level {} is wanted over {:.0} pixels, {} is \
                 given, which costs {:.3} (just noticeable differences × pixels); one more MiB would bring {:.3}",
                budget["limit"],
                budget["used"],
                bill["asked"],
                bill["pixels"].as_f64().unwrap_or_default(),
                bill["given"],
                bill["loss"].as_f64().unwrap_or_default(),
                budget["price_per_mib"].as_f64().unwrap_or_default(),
            ),
            _ => "finer ones are not in memory".to_owned(),
        };
        lines.push(format!(
            "texture   \"{name}\": level {:.2} of {} is shown, {wanted:.2} is wanted: {why}",
            of("shown"),
            texture["levels"]
        ));
    }
    lines
}
