//! What masks cut out of elements: particles fly through the holes of leaves and lattices, so only the rest is surface
//! that they could arrive on. Counted whole, such an element would seem to receive too little.

use glam::Vec2;
use rayon::prelude::*;

use super::atlas::{Atlas, Corners};
use crate::rng::Stream;
use crate::scene::Scene;

/// Looks at a texel of the lightmap, and at a triangle that is stored at its corners, are the square of these.
const LOOKS: (u32, u32) = (8, 9);
/// Seed of where they fall: those of a regular grid would all meet holes, or none, of a lattice as regular.
const SEED: u64 = 0xc07;

/// An element, and how many looks at it met a hole and the surface.
type Looks = (u32, [u32; 2]);

impl Atlas {
    /// Takes what masks cut out from the elements of cut-out materials ([`super::atlas::Element::opaque`]). An element
    /// that several triangles share is of the material of its largest.
    pub(super) fn cut_out(&mut self, scene: &Scene) {
        let vanishes: Vec<bool> = scene.materials.iter().map(|m| m.may_vanish()).collect();
        if !vanishes.contains(&true) {
            return;
        }
        let is_cut_out = |t: u32| vanishes[scene.mesh.materials[t as usize].0 as usize];
        let triangles = (0..self.corners.len() as u32).into_par_iter();
        let found: Vec<Vec<Looks>> =
            triangles.filter(|&t| is_cut_out(t)).map(|t| self.look_at(scene, t)).collect();
        let mut looks = vec![[0u32; 2]; self.elements.len()];
        for (element, [holes, surface]) in found.into_iter().flatten() {
            let sums = &mut looks[element as usize];
            *sums = [sums[0] + holes, sums[1] + surface];
        }
        for (e, [holes, surface]) in self.elements.iter_mut().zip(looks) {
            if e.area > 0.0 && is_cut_out(e.triangle) {
                e.opaque = match holes + surface {
                    // A sliver that no look fell on is as it is where direct light is gathered.
                    0 if scene.is_opaque_at(e.triangle, e.b1, e.b2) => e.area,
                    0 => 0.0,
                    all => e.area * (surface as f32 / all as f32),
                };
            }
        }
    }

    /// Looks spread evenly over a triangle.
    fn look_at(&self, scene: &Scene, t: u32) -> Vec<Looks> {
        let mut stream = Stream::new(SEED, t.into(), 0);
        let mut within = |cell: u32, n: u32| {
            let corner = Vec2::new((cell % n) as f32, (cell / n) as f32);
            (corner + Vec2::from(stream.next_2d())) / n as f32
        };
        match &self.corners[t as usize] {
            Corners::Vertices(elements) => {
                let mut looks = elements.map(|e| (e, [0; 2]));
                for cell in 0..LOOKS.1 * LOOKS.1 {
                    let p = within(cell, LOOKS.1);
                    let (b1, b2) = (p.x.sqrt() * (1.0 - p.y), p.x.sqrt() * p.y);
                    let e = self.element_at(t, b1, b2);
                    let of = looks.iter_mut().find(|of| of.0 == e);
                    of.expect("a corner").1[usize::from(scene.is_opaque_at(t, b1, b2))] += 1;
                }
                looks.to_vec()
            }
            &Corners::Texels([a, b, c]) => {
                let doubled = (b - a).perp_dot(c - a);
                let (low, high) = (a.min(b).min(c).max(Vec2::ZERO), a.max(b).max(c).max(Vec2::ZERO));
                let mut found = Vec::new();
                for y in low.y as u32..=(high.y as u32).min(self.height - 1) {
                    for x in low.x as u32..=(high.x as u32).min(self.width - 1) {
                        let mut looks = [0; 2];
                        for cell in 0..LOOKS.0 * LOOKS.0 {
                            let p = Vec2::new(x as f32, y as f32) + within(cell, LOOKS.0) - a;
                            let (b1, b2) = (p.perp_dot(c - a) / doubled, (b - a).perp_dot(p) / doubled);
                            if b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 {
                                looks[usize::from(scene.is_opaque_at(t, b1, b2))] += 1;
                            }
                        }
                        if looks != [0; 2] {
                            found.push((y * self.width + x, looks));
                        }
                    }
                }
                found
            }
        }
    }
}
