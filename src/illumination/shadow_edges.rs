//! Edges of shadows that lights without area cast: a texel that such an edge crosses gets the mean over its surface, so
//! that edges are as smooth as the map can show them, and no stairs.
//!
//! Found by looking beside: where the light at the middles of two neighbouring texels differs, both are asked at more
//! points; where these differ among themselves, so are the texels around. So edges and thin shadows are followed from
//! texel to texel, and all that lies far from them costs one point.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::atlas::{Corners, NEIGHBOURS};
use super::bake::Baker;
use crate::image::luminance;
use crate::rng::{Stream, hash};
use crate::transport::particle::SurfacePoint;

/// Points per texel are the square of this.
const POINTS: u32 = 4;
/// Fewer points than this on the surface of a clipped texel, and its own point counts as well.
const FEW: usize = 4;
/// Values whose luminances differ by less than this share are of no edge: a bend of the surface, or a light nearby.
const ALIKE: f32 = 0.04;
/// Height over the surface, in texels, at which a point must be seen from the texel's own one: else a wall stands
/// between them, and the light behind it belongs to another room.
const HEIGHT: f32 = 0.25;
fn differ(a: Vec3, b: Vec3) -> bool {
    let (a, b) = (luminance(a), luminance(b));
    (a - b).abs() > ALIKE * a.max(b)
}

impl Baker<'_> {
    /// Makes the certain light of texels at edges of shadows their mean.
    pub(super) fn average_shadow_edges(&mut self) {
        let texels = self.atlas.texel_count() as u32;
        if !self.direct.iter().flatten().any(|bin| bin.certain() != Vec3::ZERO) {
            return;
        }
        let mut done = vec![false; texels as usize];
        let on_edge = |&e: &u32| {
            let differs = |n: u32| {
                let (a, b) = (&self.direct[e as usize], &self.direct[n as usize]);
                [0, 1].iter().any(|&side| differ(a[side].certain(), b[side].certain()))
            };
            self.watched[e as usize] && self.texels_beside(e, &NEIGHBOURS).any(differs)
        };
        let mut open: Vec<u32> = (0..texels).into_par_iter().filter(on_edge).collect();
        while !open.is_empty() {
            for &e in &open {
                done[e as usize] = true;
            }
            let found: Vec<[(Vec3, bool); 2]> = open.par_iter().map(|&e| self.over_texel(e)).collect();
            let mut next = Vec::new();
            for (&e, sides) in open.iter().zip(&found) {
                for (bin, (mean, _)) in self.direct[e as usize].iter_mut().zip(sides) {
                    bin.set_certain(*mean);
                }
                if sides.iter().any(|s| s.1) {
                    let beside = self.texels_beside(e, &NEIGHBOURS[..4]);
                    next.extend(beside.filter(|&n| !done[n as usize] && self.watched[n as usize]));
                }
            }
            next.sort_unstable();
            next.dedup();
            open = next;
        }
    }

    /// Neighbours of a texel on the same chart.
    fn texels_beside<'b>(&'b self, e: u32, ring: &'b [(i32, i32)]) -> impl Iterator<Item = u32> + 'b {
        let (width, height) = (self.atlas.width, self.atlas.height);
        let is_surface = |&n: &u32| self.atlas.elements[n as usize].area > 0.0;
        let beside = ring.iter().filter_map(move |&(dx, dy)| {
            let (x, y) = ((e % width).checked_add_signed(dx)?, (e / width).checked_add_signed(dy)?);
            (x < width && y < height).then_some(y * width + x)
        });
        beside.filter(move |n| is_surface(&e) && is_surface(n))
    }

    /// Mean of the certain light over the surface in a texel, front and back, and whether an edge crosses it.
    fn over_texel(&self, e: u32) -> [(Vec3, bool); 2] {
        let element = &self.atlas.elements[e as usize];
        let own = SurfacePoint { triangle: element.triangle, b1: element.b1, b2: element.b2 };
        let mut points = self.points_in(e);
        if points.len() < FEW {
            points.push(own);
        }
        [0, 1].map(|side| {
            // What is dark on all sides of a body is not asked.
            let lit = |n: u32| self.direct[n as usize][side].certain() != Vec3::ZERO;
            if !lit(e) && !self.texels_beside(e, &NEIGHBOURS).any(lit) {
                return (Vec3::ZERO, false);
            }
            let back = side == 1;
            let light = |p: &SurfacePoint| self.transport.certain(p.triangle, p.b1, p.b2, back);
            let values: Vec<Vec3> = points.iter().map(light).collect();
            let crossed = values.iter().any(|&v| differ(v, values[0]));
            let counts: Vec<bool> = match crossed {
                true => self.in_one_room(own, &points, back),
                false => vec![true; points.len()],
            };
            let n = counts.iter().filter(|&&c| c).count();
            let sum: Vec3 = values.iter().zip(&counts).filter(|(_, c)| **c).map(|(v, _)| *v).sum();
            (if n > 0 { sum / n as f32 } else { self.direct[e as usize][side].certain() }, crossed)
        })
    }

    /// Points spread over the surface in a texel.
    fn points_in(&self, e: u32) -> Vec<SurfacePoint> {
        let (atlas, seed) = (&self.atlas, self.settings.seed);
        let mut near: Vec<u32> = vec![atlas.elements[e as usize].triangle];
        for n in self.texels_beside(e, &NEIGHBOURS) {
            let t = atlas.elements[n as usize].triangle;
            if !near.contains(&t) {
                near.push(t);
            }
        }
        let corner = Vec2::new((e % atlas.width) as f32, (e / atlas.width) as f32);
        let mut stream = Stream::new(hash(seed, 0, 0xed6e), e.into(), 0);
        let mut points = Vec::with_capacity((POINTS * POINTS) as usize);
        for i in 0..POINTS * POINTS {
            let [u, v] = stream.next_2d();
            let p = corner
                + (Vec2::new((i % POINTS) as f32, (i / POINTS) as f32) + Vec2::new(u, v)) / POINTS as f32;
            points.extend(near.iter().find_map(|&triangle| {
                let Corners::Texels([a, b, c]) = atlas.corners[triangle as usize] else { return None };
                let doubled = (b - a).perp_dot(c - a);
                let b1 = (p - a).perp_dot(c - a) / doubled;
                let b2 = (b - a).perp_dot(p - a) / doubled;
                (b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0).then_some(SurfacePoint { triangle, b1, b2 })
            }));
        }
        points
    }

    /// Which points lie in the same room as a texel's own one, and not behind a wall or inside of a body.
    fn in_one_room(&self, own: SurfacePoint, points: &[SurfacePoint], back: bool) -> Vec<bool> {
        let height = HEIGHT / self.atlas.texels_per_unit;
        points.iter().map(|p| self.transport.is_open_between(own, *p, back, height)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Accel;
    use crate::illumination::atlas::Element;
    use crate::illumination::bake::BakeSettings;
    use crate::illumination::test_scenes::{join, lambert, quad, scene};
    use crate::scene::{Light, Mesh, Scene};
    use crate::transport::light::Lights;
    use crate::transport::particle::SceneTransport;

    /// Certain light on the front of each element of a bake under a sun of this direction, beside the side of a texel.
    fn under_sun(mesh: Mesh, direction: Vec3) -> (Vec<(Element, f32)>, f32) {
        let irradiance = Vec3::splat(1.0 / -direction.normalize().y);
        let sun = Light::Directional { direction, irradiance };
        let yard: Scene = scene(mesh, vec![lambert(0.5, 0.0)], vec![sun]);
        let (accel, lights) = (Accel::build(&yard), Lights::build(&yard));
        let transport = SceneTransport::new(&yard, &accel, &lights);
        let settings = BakeSettings { texels: 6000, everything: true, ..BakeSettings::default() };
        let mut baker = Baker::new(&yard, transport, &settings);
        baker.gather_blocks(usize::MAX);
        let found = baker.atlas.elements.iter().zip(&baker.direct);
        let found = found.filter(|(e, _)| e.area > 0.0).map(|(e, d)| (*e, d[0].certain().x)).collect();
        (found, 1.0 / baker.atlas.texels_per_unit)
    }

    fn floor() -> Mesh {
        quad(Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0)
    }

    #[test]
    fn texels_on_an_edge_show_how_much_of_them_is_lit() {
        // A slanted square over the floor.
        let (u, v) = (Vec3::new(0.8, 0.0, 0.3), Vec3::new(0.3, 0.0, -0.8));
        let mut mesh = floor();
        join(&mut mesh, &quad(Vec3::new(-0.5, 0.5, 0.3), u, v), 0);
        let shaded = |p: Vec3| {
            let d = Vec3::new(p.x + 0.5, 0.0, p.z - 0.3);
            let (a, b) = (d.dot(u) / u.length_squared(), d.dot(v) / v.length_squared());
            (0.0..1.0).contains(&a) && (0.0..1.0).contains(&b)
        };
        let (found, size) = under_sun(mesh, Vec3::NEG_Y);
        let (mut area, mut error, mut steps, mut crossed) = (0.0f64, 0.0f32, 0.0f32, 0);
        for (e, value) in found.iter().filter(|(e, _)| e.position.y.abs() < 1e-3) {
            area += f64::from(e.area * value);
            let lit = |i: u32| {
                let offset = Vec3::new((i % 16) as f32 - 7.5, 0.0, (i / 16) as f32 - 7.5) * (size / 16.0);
                u32::from(!shaded(e.position + offset))
            };
            let exact = (0..256).map(lit).sum::<u32>() as f32 / 256.0;
            if exact > 0.02 && exact < 0.98 && e.area > 0.9 * size * size {
                error += (value - exact).powi(2);
                steps += (f32::from(!shaded(e.position)) - exact).powi(2);
                crossed += 1;
            } else if exact == 0.0 || exact == 1.0 {
                assert!((value - exact).abs() < 1e-3, "{}: {value} {exact}", e.position);
            }
        }
        assert!(crossed > 60, "{crossed}");
        let (error, steps) = ((error / crossed as f32).sqrt(), (steps / crossed as f32).sqrt());
        assert!(error < 0.06 && steps > 0.2, "{error} {steps}");
        let exact = 4.0 - u.cross(v).length();
        assert!((area - f64::from(exact)).abs() < 2e-3, "{area} {exact}");
    }

    #[test]
    fn a_wire_thinner_than_a_texel_is_followed() {
        let mut mesh = floor();
        let along = Vec3::new(1.7, 0.0, 0.4);
        join(&mut mesh, &quad(Vec3::new(-0.9, 0.3, 0.2), along, Vec3::new(0.0, 0.0, -0.012)), 0);
        let (found, size) = under_sun(mesh, Vec3::NEG_Y);
        assert!(size > 0.02);
        let shade = |(e, value): &(Element, f32)| f64::from(e.area * (1.0 - value));
        let shaded: f64 = found.iter().filter(|(e, _)| e.position.y.abs() < 1e-3).map(shade).sum();
        let exact = 1.7 * 0.012;
        assert!((shaded / exact - 1.0).abs() < 0.3, "{shaded} {exact}");
    }

    #[test]
    fn no_sun_comes_through_a_wall() {
        // A shed without thickness on the left half of the floor; the walls stand within texels.
        let mut mesh = floor();
        let (x, z) = (0.0123, 0.6543);
        join(&mut mesh, &quad(Vec3::new(x, 0.0, z), Vec3::NEG_Z * 2.0 * z, Vec3::Y), 0);
        for z in [z, -z] {
            join(&mut mesh, &quad(Vec3::new(-1.0, 0.0, z), Vec3::X * (1.0 + x), Vec3::Y), 0);
        }
        join(&mut mesh, &quad(Vec3::new(-1.0, 1.0, z), Vec3::X * (1.0 + x), Vec3::NEG_Z * 2.0 * z), 0);
        join(&mut mesh, &quad(Vec3::new(-1.0, 0.0, -z), Vec3::Z * 2.0 * z, Vec3::Y), 0);
        let (found, _) = under_sun(mesh, Vec3::new(-0.2, -1.0, 0.0));
        let on_floor = |(e, _): &&(Element, f32)| e.position.y.abs() < 1e-3 && e.normal.y > 0.9;
        let (mut inside, mut before) = (0, 0);
        for (e, value) in found.iter().filter(on_floor) {
            let p = e.position;
            if p.x < x && p.z.abs() < z {
                assert_eq!(*value, 0.0, "{p}");
                inside += 1;
            } else if p.x > x {
                assert!((value - 1.0).abs() < 1e-3, "{p}: {value}");
                before += 1;
            }
        }
        assert!(inside > 400 && before > 700, "{inside} {before}");
    }
}
