//! What of a map its summary says: sums over all sites.

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::Baker;
use crate::illumination::atlas::Element;
use crate::illumination::filter::Parts;
use crate::illumination::stored::Summary;
use crate::image::luminance;

/// Sums over all sites.
#[derive(Default)]
pub(super) struct Totals {
    power: DVec3,
    area: f64,
    /// Of what is in sight, times the area: squared luminance, and the variances of straight and of all other light.
    squared: f64,
    variances: [f64; 2],
    soft: f64,
}

/// Sites that are summed at once.
const SUMMED: usize = 4096;

impl Totals {
    /// Over so many sites, each of which `add` adds; alike for any number of threads.
    pub fn over(count: usize, add: impl Fn(usize, &mut Self) + Sync) -> Self {
        let some = |first: usize| {
            let mut totals = Self::default();
            (first..(first + SUMMED).min(count)).for_each(|i| add(i, &mut totals));
            totals
        };
        let all: Vec<Self> = (0..count).into_par_iter().step_by(SUMMED).map(some).collect();
        all.into_iter().fold(Self::default(), Self::and)
    }

    fn and(self, other: Self) -> Self {
        Self {
            power: self.power + other.power,
            area: self.area + other.area,
            squared: self.squared + other.squared,
            variances: [0, 1].map(|k| self.variances[k] + other.variances[k]),
            soft: self.soft + other.soft,
        }
    }

    pub fn add(&mut self, element: &Element, value: Vec4, parts: &Parts, seen: bool) {
        let area = f64::from(element.opaque);
        self.power += value.truncate().as_dvec3() * area;
        self.area += 0.5 * area;
        self.soft += f64::from(luminance(parts[1].mean())) * area;
        if seen {
            self.squared += f64::from(luminance(value.truncate())).powi(2) * area;
            self.variances[0] += f64::from(0.5 * parts[0].variance) * area;
            self.variances[1] += f64::from(0.5 * (parts[1].variance + parts[2].variance)) * area;
        }
    }

    pub fn summary(&self, baker: &Baker) -> Summary {
        let relative = |v: f64| if self.squared > 0.0 { (v / self.squared).sqrt() as f32 } else { 0.0 };
        let mean = if self.area > 0.0 { (self.power / self.area).as_vec3() } else { Vec3::ZERO };
        Summary {
            particles: baker.paths,
            rounds: baker.round + 1,
            direct_error: relative(self.variances[0]),
            particle_error: relative(self.variances[1]),
            mean: mean.to_array(),
            has_indirect: self.soft > 0.0,
            notes: baker.atlas.notes.clone(),
            ..Summary::default()
        }
    }
}
