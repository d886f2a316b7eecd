//! What the allocator says of itself: to whoever looks on while it runs, and to whoever inspects it at rest.

use std::collections::VecDeque;

use foveal::allocation::ray_order::ObjectProgress;
use foveal::allocation::supersampling::Supersampler;
use foveal::perception::importance::importance;
use foveal_runtime::{DeadJob, Incident};

use super::Allocator;
use super::maps::Environments;
use super::textures::Textures;
use crate::insight::{Insight, ObjectInsight};
use crate::message::View;
use crate::message::tracer::TraceBrief;

/// Jobs of samples that are done until whoever looks on is told anew.
const JOBS_BETWEEN_INSIGHTS: u32 = 32;

impl Allocator {
    /// What it thinks.
    pub fn insight(&self) -> Insight {
        let size = (self.settings.width as usize, self.settings.height as usize);
        let mut objects: Vec<ObjectInsight> = self
            .statistics
            .iter()
            .enumerate()
            .map(|(id, s)| ObjectInsight {
                pixels: s.pixels,
                saliency: s.saliency,
                importance: if id == 0 { 0.0 } else { importance(s, size.0, size.1) },
                attention: self.attention.get(id).copied().unwrap_or(0.0),
                ..ObjectInsight::default()
            })
            .collect();
        for ObjectProgress { object, level, priority, error } in self.order.object_progress() {
            if let Some(object) = objects.get_mut(object as usize) {
                (object.level, object.priority, object.error) = (level, priority, error);
            }
        }
        Insight {
            view: self.drawn.as_ref().map_or(View(0), |d| d.view),
            objects,
            maps: self.environments.ranking(),
            map_bytes: [self.environments.bytes(), self.settings.environment_bytes],
            map_price_per_mib: self.environments.price_per_mib(),
            textures: self.textures.as_ref().map(|t| (t.current(), t.residency().limit())),
            refinement: self.supersampler.as_ref().and_then(Supersampler::progress),
            quality: self.quality(),
            lost_jobs: self.lost_jobs,
        }
    }

    /// Q per pixel.
    fn quality(&self) -> f32 {
        if self.drawn.is_none() {
            return f32::NEG_INFINITY;
        }
        let textures = self.textures.as_ref().map_or(0.0, Textures::visible_error);
        let pixels = f64::from(self.settings.width) * f64::from(self.settings.height);
        -((self.order.visible_error() + textures) / pixels.max(1.0)) as f32
    }

    pub(super) fn tell_insight(&mut self) {
        if let Some(slot) = &self.insight {
            self.since_insight = 0;
            slot.put(self.insight());
        }
    }

    pub(super) fn tell_insight_if_due(&mut self) {
        if self.since_insight >= JOBS_BETWEEN_INSIGHTS {
            self.tell_insight();
        }
    }

    /// Jobs that were given up after killing their tracers.
    pub fn lost_jobs(&self) -> u32 {
        self.lost_jobs
    }

    /// Jobs that nobody has answered yet, in the pool, with a tracer or on their way.
    pub fn in_flight(&self) -> u32 {
        let textures = self.textures.as_ref().map_or(0, Textures::in_flight);
        self.in_flight + u32::from(self.environments.in_flight()) + textures
    }

    /// Textures, where they do not all fit into memory.
    pub fn textures(&self) -> Option<&Textures> {
        self.textures.as_ref()
    }

    /// Environment maps.
    pub fn environments(&self) -> &Environments {
        &self.environments
    }

    /// Panics and tracers that were stopped, the newest last; of very many only those.
    pub fn incidents(&self) -> &VecDeque<Incident> {
        &self.incidents
    }

    /// Jobs that were given up, the newest last; of very many only those.
    pub fn dead_jobs(&self) -> &VecDeque<DeadJob<TraceBrief>> {
        &self.dead_jobs
    }
}
