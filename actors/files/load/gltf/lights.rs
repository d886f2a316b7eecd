//! Lights and cameras of nodes. Both look along −z of their node, whose scale means nothing to them.

use glam::{DMat4, Vec3};

use super::Oddities;
use super::document::{Camera as CameraObject, Light as LightObject};
use foveal::math;
use foveal::scene::{Camera, Light};

/// Half of the view of a camera that stands for an orthographic one, radians: far enough away for parallels to look so.
const FAR_HALF_VIEW: f32 = std::f32::consts::PI / 180.0;

fn position(world: &DMat4) -> Vec3 {
    world.w_axis.truncate().as_vec3()
}

fn axis(v: glam::DVec4) -> Option<Vec3> {
    let v = v.truncate();
    let length = v.length();
    (length > 0.0 && length.is_finite()).then(|| (v / length).as_vec3())
}

/// A light in foveal's terms. Candela, lux and nits are taken for as many radiometric units, which moves the exposure
/// and nothing else. `scale` is the sidecar's.
pub(super) fn light(of: &LightObject, world: &DMat4, scale: f32, odd: &mut Oddities) -> Option<Light> {
    let range = of.range.filter(|r| *r > 0.0 && r.is_finite()).unwrap_or(f32::INFINITY);
    // More than anything is; sums must stay finite.
    const POWER_MAX: f32 = 1e9;
    let clean = |v: f32| if v.is_finite() { v.clamp(0.0, POWER_MAX) } else { 0.0 };
    let power = (Vec3::from(of.color.map(clean)) * clean(of.intensity * scale)).min(Vec3::splat(POWER_MAX));
    let (place, towards) = (position(world), axis(-world.z_axis));
    if power.max_element() <= 0.0 || !place.is_finite() {
        return None;
    }
    match of.kind.as_str() {
        "point" => Some(Light::Point { position: place, intensity: power, range }),
        "directional" => towards.map(|direction| Light::Directional { direction, irradiance: power }),
        "spot" => {
            let (inner, outer) = of
                .spot
                .as_ref()
                .map_or((0.0, std::f32::consts::FRAC_PI_4), |s| (s.inner_cone_angle, s.outer_cone_angle));
            let outer = outer.clamp(1e-4, std::f32::consts::FRAC_PI_2);
            let inner = inner.clamp(0.0, outer);
            towards.map(|direction| Light::Spot {
                position: place,
                direction,
                intensity: power,
                inner,
                outer,
                range,
            })
        }
        _ => {
            odd.count("a light of unknown type", "left out");
            None
        }
    }
}

/// A node's camera; `None` where it sees nothing.
pub(super) fn camera(of: &CameraObject, world: &DMat4, odd: &mut Oddities) -> Option<Camera> {
    let (eye, forward, up) = (position(world), axis(-world.z_axis)?, axis(world.y_axis)?);
    let fov = |v: f32| v.clamp(0.01f32.to_radians(), 179.99f32.to_radians());
    let (eye, fov_y) = match (of.kind.as_str(), &of.perspective, &of.orthographic) {
        ("perspective", Some(p), _) if p.yfov.is_finite() => (eye, fov(p.yfov)),
        ("orthographic", _, Some(o)) if o.ymag.is_finite() && o.ymag != 0.0 => {
            odd.count("an orthographic camera", "shown by a distant one of 2 degrees");
            (eye - forward * (o.ymag.abs() / math::tan(FAR_HALF_VIEW)), 2.0 * FAR_HALF_VIEW)
        }
        _ => {
            odd.count("a camera without a view", "left out");
            return None;
        }
    };
    // Far enough for the direction to survive single precision.
    let target = eye + forward * (1e-3 * eye.abs().max_element()).max(1.0);
    let good = eye.is_finite() && target.is_finite() && forward.cross(up).length() > 1e-4;
    good.then_some(Camera { eye, target, up, fov_y })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn read(text: &str) -> LightObject {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn lights_shine_along_minus_z_and_know_no_scale() {
        let odd = &mut Oddities::default();
        let world = DMat4::from_translation(DVec3::X) * DMat4::from_scale(DVec3::splat(5.0));
        let light = |text: &str, odd: &mut Oddities| light(&read(text), &world, 2.0, odd);
        assert_eq!(
            light(r#"{"type": "point", "color": [1, 0.5, 0], "intensity": 3}"#, odd),
            Some(Light::Point {
                position: Vec3::X,
                intensity: Vec3::new(6.0, 3.0, 0.0),
                range: f32::INFINITY
            })
        );
        assert_eq!(
            light(r#"{"type": "directional"}"#, odd),
            Some(Light::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::splat(2.0) })
        );
        let Some(Light::Spot { inner, outer, .. }) =
            light(r#"{"type": "spot", "spot": {"innerConeAngle": 9, "outerConeAngle": 0.5}}"#, odd)
        else {
            panic!("no spot")
        };
        assert_eq!((inner, outer), (0.5, 0.5));
        assert!(odd.is_empty());
        assert_eq!(light(r#"{"type": "tube"}"#, odd), None);
        assert_eq!(light(r#"{"type": "point", "intensity": -1}"#, odd), None);
        assert!(!odd.is_empty());
    }

    #[test]
    fn a_camera_stands_where_its_node_is() {
        let odd = &mut Oddities::default();
        let of: CameraObject =
            serde_json::from_str(r#"{"type": "perspective", "perspective": {"yfov": 0.5, "znear": 1}}"#)
                .unwrap();
        let c = camera(&of, &DMat4::from_translation(DVec3::new(0.0, 1.0, 4.0)), odd).unwrap();
        assert_eq!((c.eye, c.up, c.fov_y), (Vec3::new(0.0, 1.0, 4.0), Vec3::Y, 0.5));
        assert_eq!((c.target - c.eye).normalize(), Vec3::NEG_Z);
        let flat: CameraObject =
            serde_json::from_str(r#"{"type": "orthographic", "orthographic": {"ymag": 1, "xmag": 1}}"#)
                .unwrap();
        let c = camera(&flat, &DMat4::IDENTITY, odd).unwrap();
        let frame = c.frame(10, 10);
        let (_, y, _) = frame.project(Vec3::Y).unwrap();
        assert!(y.abs() < 1e-2, "{y}");
    }
}
