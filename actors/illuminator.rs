//! The illuminator: refines the illumination while the walk goes on, uncoupled from the display.
//!
//! Owns a bake in progress. Hears only itself: each turn does one bounded batch. Says: to the renderer,
//! after each pass, that there is better light. What it computes depends on its settings only, so the last
//! map is that of `foveal bake`, bit for bit.

use std::path::PathBuf;
use std::sync::Arc;

use foveal::illumination::bake::{BakeSettings, Baker, Step, cache_key};
use foveal::illumination::cache::save;
use foveal::illumination::stored::Illumination;
use foveal::transport::particle::SharedTransport;
use foveal::world::World;
use foveal_runtime::{Actor, Address, Class, Cx};

use crate::message::{IlluminatorMessage, RendererMessage};
use crate::outbox::Outbox;

/// What an illuminator works towards.
#[derive(Clone, Debug)]
pub struct Refinement {
    /// The scene with all its textures, whichever of them the walk keeps, and the light it begins with.
    pub world: World,
    /// Settings of the bake.
    pub settings: BakeSettings,
    /// Where the last map is kept.
    pub keep: Option<PathBuf>,
}

/// The illuminator's state.
pub struct Illuminator {
    refinement: Refinement,
    /// `None` before the first turn and after the last.
    baker: Option<Baker<'static>>,
    done: bool,
    /// Threads of its own, so that the display never waits behind its work.
    pool: Option<rayon::ThreadPool>,
    renderer: Address<RendererMessage>,
    outbox: Outbox<IlluminatorMessage>,
}

impl Illuminator {
    /// An illuminator that has done nothing.
    pub fn new(refinement: Refinement, renderer: Address<RendererMessage>) -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let pool = rayon::ThreadPoolBuilder::new().num_threads((cores / 2).max(1)).build();
        Self {
            refinement,
            baker: None,
            done: false,
            pool: pool.ok(),
            renderer,
            outbox: Outbox::new(|| IlluminatorMessage::SendAgain),
        }
    }

    /// Whether the last map has been sent.
    pub fn is_done(&self) -> bool {
        self.done
    }

    fn refine(&mut self, cx: &mut Cx<'_, IlluminatorMessage>) {
        if self.done {
            return;
        }
        let Refinement { world, settings, .. } = &self.refinement;
        let baker = self.baker.take();
        let work = || match baker {
            None => {
                let w = world.clone();
                let transport = SharedTransport::new(w.scene.clone(), w.accel, w.lights);
                let baker = Baker::new(&w.scene, transport, settings);
                // The same light in the storage of what follows, so that values can be blended.
                let map = Illumination::resampled(baker.atlas(), &*world.illumination);
                (baker, Some(map), false)
            }
            Some(mut baker) => match baker.step() {
                Step::Going => (baker, None, false),
                Step::Appraised(_) => {
                    let map = baker.illumination();
                    (baker, Some(map), false)
                }
                Step::Done(_) => {
                    let map = baker.illumination();
                    (baker, Some(map), true)
                }
            },
        };
        let (baker, map, last) = match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        };
        self.done = last;
        if let Some(map) = map {
            if last && cx.effects() {
                self.keep(&map);
            }
            let hash = map.digest();
            let message = RendererMessage::Illuminated { map: Arc::new(map), last, hash };
            self.outbox.tell(cx, &self.renderer, message);
        }
        if !last {
            self.baker = Some(baker);
            let own = cx.address().clone();
            self.outbox.tell(cx, &own, IlluminatorMessage::Refine);
        }
    }

    /// Keeps the last map for the next walk. That it cannot be kept costs time then, and nothing now.
    fn keep(&self, map: &Illumination) {
        let Some(file) = &self.refinement.keep else { return };
        let key = cache_key(&self.refinement.world.scene, &self.refinement.settings);
        let folder = file.parent().map_or(Ok(()), std::fs::create_dir_all);
        if let Err(e) = folder.map_err(Into::into).and_then(|()| save(file, &key, map)) {
            tracing::warn!("{}: the illumination cannot be kept: {e}", file.display());
        }
    }
}

impl Actor for Illuminator {
    type Msg = IlluminatorMessage;
    const NAME: &'static str = "illuminator";
    const CLASS: Class = Class::Heavy;

    fn started(&mut self, cx: &mut Cx<'_, IlluminatorMessage>) {
        let own = cx.address().clone();
        self.outbox.tell(cx, &own, IlluminatorMessage::Refine);
    }

    fn handle(&mut self, message: IlluminatorMessage, cx: &mut Cx<'_, IlluminatorMessage>) {
        match message {
            IlluminatorMessage::Refine => self.refine(cx),
            IlluminatorMessage::SendAgain => self.outbox.send(cx),
        }
    }
}
