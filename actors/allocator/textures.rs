//! The allocator's part about textures: which of their levels are in memory.
//!
//! Each view is seen ahead by a job of the tracers; what it shows decides which levels are wanted; loads (jobs as well) and
//! drops (orders to the renderer) follow one by one, so that they spread over frames and the limit holds all the time.

use std::sync::Arc;

use foveal::allocation::residency::{Residency, Step, TextureFacts};
use foveal::allocation::texture_demand::TextureUse;
use foveal::scene::texture::{LevelTexels, held_bytes};
use foveal::world::World;
use foveal_runtime::{Cx, Loader, Saver};

use super::Allocator;
use crate::message::saved::Saved;
use crate::message::tracer::{LevelOrder, PredictionOrder};
use crate::message::{AllocatorMessage, DrawnView, RendererMessage, TraceJob};
use crate::textures::{Charge, TextureReport, TextureStore};

/// Loads that may be on their way at once.
const LOADS_MAX: usize = 2;

/// What is to be sent.
#[derive(Debug)]
pub enum TextureWork {
    /// A job for the tracers.
    Load(LevelOrder),
    /// An order for the renderer.
    Drop {
        /// Which texture.
        texture: u32,
        /// The finest level that stays.
        finest: u32,
    },
}

/// The allocator's textures.
#[derive(Debug)]
pub struct Textures {
    store: Arc<TextureStore>,
    residency: Residency,
    /// Texels of the coarsest level of each: what a loaded level's must be like.
    like: Vec<Option<LevelTexels>>,
    /// A view that is to be seen ahead.
    waiting: Option<Arc<DrawnView>>,
    /// Whether a view is being seen ahead.
    predicting: bool,
    /// Whether any view was seen ahead.
    has_seen: bool,
    /// Whether there was nothing left to do when this was looked at last.
    was_quiet: bool,
    /// Levels loaded and dropped.
    counts: [u32; 2],
}

impl Textures {
    /// All at their coarsest, as in `world`. `None` if that does not fit, which whoever made the store has checked.
    pub fn new(store: Arc<TextureStore>, world: &World) -> Option<Self> {
        let residency = Residency::new(store.limit, store.facts.clone()).ok()?;
        let coarsest = |t: &foveal::scene::Texture| t.mips.level(t.level_count() - 1).cloned();
        let like = world.scene.textures.iter().map(coarsest).collect();
        Some(Self {
            store,
            residency,
            like,
            waiting: None,
            predicting: false,
            has_seen: false,
            was_quiet: false,
            counts: [0; 2],
        })
    }

    /// What is in memory, and why.
    pub fn residency(&self) -> &Residency {
        &self.residency
    }

    /// Puts down what they hold and what is ordered, without the texels, which are on disk.
    pub(super) fn save(&self, saver: &mut Saver) {
        let Self { store: _, like: _, residency, waiting, predicting, has_seen, was_quiet, counts } = self;
        saver.put(&(residency, predicting, has_seen, was_quiet, counts));
        waiting.save(saver);
    }

    /// Takes it up again; `None` if the snapshot holds something else.
    pub(super) fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        let residency: Residency;
        (residency, self.predicting, self.has_seen, self.was_quiet, self.counts) = loader.take()?;
        self.waiting = Saved::restore(loader)?;
        self.residency.go_on_from(residency)
    }

    /// Another limit, bytes; one that cannot be met changes nothing.
    pub fn set_limit(&mut self, bytes: u64) {
        if self.residency.limit() != bytes && self.residency.set_limit(bytes).is_err() {
            tracing::warn!("textures cannot be kept within {bytes} bytes");
        }
    }

    /// −Q of the last view that was seen ahead, just noticeable differences × pixels; infinite before the first.
    pub fn visible_error(&self) -> f64 {
        if self.has_seen { self.residency.visible_error() } else { f64::INFINITY }
    }

    /// Jobs of this kind that are out.
    pub fn in_flight(&self) -> u32 {
        self.residency.loading() as u32 + u32::from(self.predicting)
    }

    /// Whether all that can be done for the newest view is done.
    pub fn is_quiet(&self) -> bool {
        self.waiting.is_none() && !self.predicting && self.residency.is_settled()
    }

    /// A view to look ahead from.
    pub fn on_view(&mut self, drawn: &Arc<DrawnView>) {
        self.waiting = Some(drawn.clone());
    }

    /// The order to look ahead, if one is due.
    pub fn next_prediction(&mut self) -> Option<PredictionOrder> {
        if self.predicting {
            return None;
        }
        let drawn = self.waiting.take()?;
        self.predicting = true;
        Some(PredictionOrder { drawn, store: self.store.clone() })
    }

    /// A view was seen ahead.
    pub fn on_seen(&mut self, uses: &[TextureUse]) {
        self.predicting = false;
        self.has_seen = true;
        self.residency.see(uses.to_vec());
    }

    /// Goes on deciding for as long as there is `work`.
    pub fn go_on(&mut self, work: &mut u64) {
        self.residency.go_on(work);
    }

    /// The next step towards what is wanted.
    pub fn next_work(&mut self) -> Option<TextureWork> {
        Some(match self.residency.next_step(LOADS_MAX)? {
            Step::Load { texture, level } => {
                self.counts[0] += 1;
                TextureWork::Load(LevelOrder {
                    store: self.store.clone(),
                    texture: texture as u32,
                    level: level as u32,
                    like: self.like[texture].clone(),
                })
            }
            Step::Drop { texture, finest } => {
                self.counts[1] += 1;
                TextureWork::Drop { texture: texture as u32, finest: finest as u32 }
            }
        })
    }

    /// Says how things stand, where orders were given or nothing is left to do since.
    pub fn report(&mut self, orders_given: bool) {
        let is_quiet = self.is_quiet();
        if orders_given || is_quiet != self.was_quiet {
            self.store.report.force_push(self.current());
        }
        self.was_quiet = is_quiet;
    }

    /// How things stand.
    pub fn current(&self) -> TextureReport {
        let residency = &self.residency;
        let charge = |(i, facts): (usize, &TextureFacts)| {
            let (used, given) = (&residency.uses()[i], residency.states()[i]);
            let loss = if facts.pinned { 0.0 } else { used.error(&facts.spatial, given) };
            Charge { pixels: used.total_pixels(), asked: used.finest(), given, loss }
        };
        TextureReport {
            used: residency.used(),
            held: held_bytes().0,
            price_per_mib: residency.price_per_mib(),
            counts: self.counts,
            bill: residency.facts().iter().enumerate().map(charge).collect(),
        }
    }

    /// A level is there, or is not to be had.
    pub fn on_loaded(&mut self, texture: u32, level: u32, is_there: bool) {
        self.residency.on_loaded(texture as usize, level as usize, is_there);
    }

    /// Nobody holds what the first `drops` drops have dropped.
    pub fn on_released(&mut self, drops: u32) {
        self.residency.on_released(drops);
    }

    /// A job was given up, maybe the one that looks ahead.
    pub fn on_prediction_lost(&mut self) {
        self.predicting = false;
    }
}

impl Allocator {
    pub(super) fn on_textures_seen(&mut self, uses: &[TextureUse], cx: &mut Cx<'_, AllocatorMessage>) {
        if let Some(textures) = &mut self.textures {
            textures.on_seen(uses);
        }
        self.decide(cx);
        self.fill_pool(cx);
    }

    pub(super) fn on_level_loaded(
        &mut self,
        texture: u32,
        level: u32,
        texels: Option<LevelTexels>,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        let Some(textures) = &mut self.textures else { return };
        textures.on_loaded(texture, level, texels.is_some());
        if let Some(texels) = texels {
            let changed = RendererMessage::TextureChanged { texture, finest: level, texels: Some(texels) };
            self.outbox.tell(cx, &self.renderer, changed);
        }
        self.change_textures(cx);
        self.fill_pool(cx);
    }

    pub(super) fn on_textures_released(&mut self, drops: u32, cx: &mut Cx<'_, AllocatorMessage>) {
        if let Some(textures) = &mut self.textures {
            textures.on_released(drops);
        }
        self.change_textures(cx);
        self.fill_pool(cx);
    }

    /// Gives the orders that textures need now.
    pub(super) fn change_textures(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(textures) = &mut self.textures else { return };
        // Neither goes stale with a view.
        if let Some(order) = textures.next_prediction() {
            self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Prediction(order));
        }
        let mut changed = false;
        while let Some(work) = textures.next_work() {
            changed = true;
            match work {
                TextureWork::Load(order) => {
                    self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Level(order));
                }
                TextureWork::Drop { texture, finest } => {
                    let changed = RendererMessage::TextureChanged { texture, finest, texels: None };
                    self.outbox.tell(cx, &self.renderer, changed);
                }
            }
        }
        textures.report(changed);
    }
}
