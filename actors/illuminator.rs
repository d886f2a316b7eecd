//! The illuminator: refines the illumination while the walk goes on, uncoupled from the display.
//!
//! Owns a bake in progress. Hears only itself: each turn does one bounded batch. Says: to the renderer,
//! again and again, that there is better light. What it computes depends on its settings only, so the last
//! map is that of `foveal bake`, bit for bit.

use std::cell::OnceCell;
use std::path::PathBuf;

use foveal::illumination::bake::{BakeSettings, Baker, Step, cache_key};
use foveal::illumination::cache::save;
use foveal::illumination::stored::Illumination;
use foveal::world::World;
use foveal_runtime::{Actor, Address, Class, Content, Cx};

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

/// What the next turn does.
enum Stage {
    /// Divides the surfaces.
    Begun,
    /// Goes on.
    Baking(Box<Baker>),
    /// Nothing.
    Done,
}

/// The illuminator's state.
pub struct Illuminator {
    refinement: Refinement,
    stage: Stage,
    /// Threads of its own, so that the display never waits behind its work. Made by its first turn: they give way where the
    /// thread of that does. `None` where there are none to be had.
    pool: OnceCell<Option<rayon::ThreadPool>>,
    renderer: Address<RendererMessage>,
    outbox: Outbox<IlluminatorMessage>,
}

impl Illuminator {
    /// An illuminator that has done nothing.
    pub fn new(refinement: Refinement, renderer: Address<RendererMessage>) -> Self {
        Self {
            refinement,
            stage: Stage::Begun,
            pool: OnceCell::new(),
            renderer,
            outbox: Outbox::new(|| IlluminatorMessage::SendAgain),
        }
    }

    /// Whether the last map has been sent.
    pub fn is_done(&self) -> bool {
        matches!(self.stage, Stage::Done)
    }

    fn refine(&mut self, cx: &mut Cx<'_, IlluminatorMessage>) {
        let stage = std::mem::replace(&mut self.stage, Stage::Done);
        let Refinement { world, settings, .. } = &self.refinement;
        let work = || match stage {
            Stage::Begun => {
                let mut baker = Box::new(Baker::new(world.indexed(), settings));
                baker.begin_with(&*world.illumination);
                // The same light in the storage of what follows, so that values can be blended.
                let map = baker.map().clone();
                (Stage::Baking(baker), Some(map))
            }
            Stage::Baking(mut baker) => match baker.step(world.indexed()) {
                Step::Going => (Stage::Baking(baker), None),
                Step::Better(map) => (Stage::Baking(baker), Some(map)),
                Step::Done(map) => (Stage::Done, Some(map)),
            },
            Stage::Done => (Stage::Done, None),
        };
        let own_threads = || {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            rayon::ThreadPoolBuilder::new().num_threads((cores / 2).max(1)).build().ok()
        };
        let (stage, map) = match self.pool.get_or_init(own_threads) {
            Some(pool) => pool.install(work),
            None => work(),
        };
        self.stage = stage;
        let last = self.is_done();
        if let Some(map) = map {
            if last && cx.effects() {
                self.keep(&map);
            }
            let hash = map.digest();
            let message = RendererMessage::Illuminated { map, last, hash };
            self.outbox.tell(cx, &self.renderer, message);
        }
        if !last {
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

    fn content(&self) -> Content {
        let (stage, baker) = match &self.stage {
            Stage::Begun => ("begun", None),
            Stage::Baking(baker) => ("baking", Some(baker)),
            Stage::Done => ("done", None),
        };
        Content::fields([
            ("stage", Content::Name(stage.into())),
            ("paths", Content::of(&baker.map(|baker| baker.paths()))),
            ("outbox", Content::of(&self.outbox.len())),
        ])
    }
}
