//! The cache ager: owns the samples of earlier views and says which still hold.
//!
//! Hears: the camera moved; samples were traced. Says: to the renderer, the samples that still hold,
//! warped into the new view.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytemuck::bytes_of;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::{SampleBatch, SampleCache, WarpedSample, warp};
use foveal::world::World;
use foveal_runtime::{Actor, Address, Content, Cx, Loader, Saver};
use xxhash_rust::xxh3::Xxh3;

use crate::message::saved::Saved;
use crate::message::{CacheAgerMessage, RendererMessage, View};
use crate::outbox::Outbox;
use crate::settings::Settings;
use crate::stages::{Stage, StageTimes};

/// The cache ager's state.
pub struct CacheAger {
    settings: Settings,
    cache: SampleCache,
    /// Cosine of the largest turn of the view direction that each object's lobe allows, by object id.
    angle_limits: Vec<f32>,
    renderer: Address<RendererMessage>,
    outbox: Outbox<CacheAgerMessage>,
    stages: StageTimes,
}

impl CacheAger {
    /// Samples of an object that are kept.
    pub fn samples_of(&self, object: u32) -> usize {
        self.cache.shared().filter(|batch| batch.object == object).map(|batch| batch.pixels.len()).sum()
    }

    /// An empty cache for the objects of a world.
    pub fn new(
        settings: Settings,
        world: &World,
        renderer: Address<RendererMessage>,
        stages: StageTimes,
    ) -> Self {
        Self {
            cache: SampleCache::new(settings.cache_capacity),
            angle_limits: world.scene.objects.iter().map(|o| angle_limit(world, o.material)).collect(),
            settings,
            renderer,
            outbox: Outbox::new(|| CacheAgerMessage::SendAgain),
            stages,
        }
    }

    /// Settings as it was last told of them.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Number of samples kept.
    pub fn len(&self) -> usize {
        self.cache.len()
    }

    /// Whether no sample is kept.
    pub fn is_empty(&self) -> bool {
        self.cache.is_empty()
    }

    /// Samples per level set k.
    pub fn len_per_level(&self) -> Vec<usize> {
        self.cache.len_per_level()
    }

    fn on_camera_moved(&mut self, view: View, frame: &CameraFrame, cx: &mut Cx<'_, CacheAgerMessage>) {
        let limits = &self.angle_limits;
        let expired = self.stages.time(Stage::Age, || {
            self.cache.age(view.0, frame.eye, &self.settings.ageing, |object| {
                limits.get(object as usize).copied().unwrap_or(-1.0)
            })
        });
        let samples = self.stages.time(Stage::WarpSplat, || warp(&self.cache, view.0, frame));
        let hash = digest(&samples);
        let aged =
            RendererMessage::SamplesAged { view, samples: Arc::new(samples), expired: expired as u32, hash };
        self.outbox.tell(cx, &self.renderer, aged);
    }

    fn on_samples_traced(&mut self, batch: Arc<SampleBatch>) {
        self.cache.insert(batch);
    }
}

/// Cosine of the turn of the view direction within which samples of a material still hold: a few degrees for
/// mirrors, whose reflections slide but keep their look under small turns, more for rough lobes
/// (REFERENCE §11: half of atan α on top).
pub fn angle_limit(world: &World, material: foveal::scene::MaterialId) -> f32 {
    use foveal::{math, scene::Model};
    const SMOOTH_DEGREES: f32 = 4.0;
    let alpha = match &world.scene.materials[material.0 as usize].model {
        Model::Dielectric { roughness, .. } => roughness.alpha_x.max(roughness.alpha_y),
        // The smoothest texel keeps its look for the smallest turn.
        model => model.roughness_range().map_or(0.0, |[least, _, _]| least.alpha_x.max(least.alpha_y)),
    };
    math::cos(SMOOTH_DEGREES.to_radians() + 0.5 * math::atan(alpha))
}

fn digest(samples: &[WarpedSample]) -> u64 {
    let mut h = Xxh3::new();
    for s in samples {
        let words: [u32; 11] = [
            u32::from(s.x) | u32::from(s.y) << 16,
            s.depth.to_bits(),
            s.color.x.to_bits(),
            s.color.y.to_bits(),
            s.color.z.to_bits(),
            s.object,
            u32::from(s.age) | u32::from(s.half_side) << 16 | u32::from(s.k) << 24,
            s.depth_tolerance.to_bits(),
            s.guide.x.to_bits(),
            s.guide.y.to_bits(),
            s.guide.z.to_bits(),
        ];
        h.update(bytes_of(&words));
    }
    h.digest()
}

impl Actor for CacheAger {
    type Msg = CacheAgerMessage;
    const NAME: &'static str = "cache ager";

    fn handle(&mut self, message: CacheAgerMessage, cx: &mut Cx<'_, CacheAgerMessage>) {
        match message {
            CacheAgerMessage::CameraMoved { view, frame } => self.on_camera_moved(view, &frame, cx),
            CacheAgerMessage::SamplesTraced { batch, hash: _ } => self.on_samples_traced(batch),
            CacheAgerMessage::Adjusted(adjustment) => self.settings.adjust(&adjustment),
            CacheAgerMessage::SendAgain => self.outbox.send(cx),
            CacheAgerMessage::Doubted => {
                self.cache = SampleCache::new(self.settings.cache_capacity);
                // From here, so that nothing of before is warped into the view that begins then.
                self.outbox.tell(cx, &self.renderer, RendererMessage::SamplesDoubted);
            }
        }
    }

    fn content(&self) -> Content {
        let Self { settings, cache, angle_limits: _, renderer: _, outbox, stages: _ } = self;
        // By object: so that one sees whose samples go.
        let mut samples = BTreeMap::<u32, usize>::new();
        cache.shared().for_each(|batch| *samples.entry(batch.object).or_default() += batch.pixels.len());
        Content::fields([
            ("ageing", Content::of(&settings.ageing)),
            ("samples", Content::of(&cache.len())),
            ("by_object", Content::of(&samples)),
            ("by_level", Content::of(&cache.len_per_level())),
            ("outbox", Content::of(&outbox.len())),
        ])
    }

    fn save(&self, saver: &mut Saver) {
        let Self { settings, cache, angle_limits: _, renderer: _, outbox, stages: _ } = self;
        if !outbox.is_empty() {
            return saver.refuse();
        }
        // The rest of the settings does not change.
        saver.put(&settings.ageing);
        saver.put(&(cache.shared().count() as u64));
        cache.shared().for_each(|batch| batch.save(saver));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.settings.ageing = loader.take()?;
        let count: u64 = loader.take()?;
        for _ in 0..count {
            self.cache.insert(Saved::restore(loader)?);
        }
        Some(())
    }
}
