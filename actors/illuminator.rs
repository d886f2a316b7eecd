//! The illuminator: refines the illumination while the walk goes on, uncoupled from the display.
//!
//! Owns a bake in progress. Hears only itself: each turn does one bounded batch. Says: to the renderer,
//! again and again, that there is better light. What it computes depends on its settings only, so the last
//! map is that of `foveal bake`, bit for bit.
//!
//! What a turn publishes is a function of its number, so a replay that has the maps at hand ([`LightBook`]) does not bake,
//! and a state is the number of turns. Where maps are missing they are baked again, from the first turn on.

use std::cell::OnceCell;
use std::path::PathBuf;
use std::sync::Arc;

use foveal::illumination::bake::{BakeSettings, Baker, Step, cache_key};
use foveal::illumination::cache::save;
use foveal::illumination::stored::{Illumination, Summary};
use foveal::world::World;
use foveal_runtime::{Actor, Address, Class, Content, Cx, Loader, Saver};
use serde::{Deserialize, Serialize};

use crate::light_book::{Known, LightBook};
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
    /// Where all maps are kept for replays of the walk.
    pub book: Option<Arc<LightBook>>,
}

/// A bake, as far as it was carried out here.
enum Bake {
    /// Divides the surfaces next.
    Begun,
    /// Goes on.
    Going(Box<Baker>),
    /// The last map was made.
    Done,
}

/// What a turn publishes, if anything.
struct Published {
    map: Arc<Illumination>,
    last: bool,
}

/// What is known of the last map.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Stated {
    /// The turn that published it.
    turn: Option<u64>,
    paths: u64,
    rounds: u32,
    relative_error: f32,
    last: bool,
}

/// The illuminator's state.
pub struct Illuminator {
    refinement: Refinement,
    /// Turns so far.
    turns: u64,
    stated: Stated,
    bake: Bake,
    /// Turns whose work the bake has done: fewer where their maps were at hand.
    baked: u64,
    /// The turn that published the last map of the bake.
    baked_map: Option<u64>,
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
            turns: 0,
            stated: Stated::default(),
            bake: Bake::Begun,
            baked: 0,
            baked_map: None,
            pool: OnceCell::new(),
            renderer,
            outbox: Outbox::new(|| IlluminatorMessage::SendAgain),
        }
    }

    /// Whether the last map has been sent.
    pub fn is_done(&self) -> bool {
        self.stated.last
    }

    /// Whether any of its turns was carried out here, rather than known before.
    pub fn has_baked(&self) -> bool {
        self.baked > 0
    }

    fn refine(&mut self, cx: &mut Cx<'_, IlluminatorMessage>) {
        let turn = self.turns;
        self.turns += 1;
        let published = match self.at_hand(turn, cx) {
            Known::Published { map, last } => Some(Published { map, last }),
            Known::Silent => None,
            Known::Unknown => self.bake_until(turn, cx),
        };
        if let Some(Published { map, last }) = published {
            let Summary { particles, rounds, relative_error, .. } = map.summary;
            self.stated = Stated { turn: Some(turn), paths: particles, rounds, relative_error, last };
            if last && cx.effects() {
                self.keep(&map);
            }
            let hash = map.digest();
            let message = RendererMessage::Illuminated { map, last, hash };
            self.outbox.tell(cx, &self.renderer, message);
        }
        if !self.is_done() {
            let own = cx.address().clone();
            self.outbox.tell(cx, &own, IlluminatorMessage::Refine);
        }
    }

    /// What a replay need not bake.
    fn at_hand(&self, turn: u64, cx: &Cx<'_, IlluminatorMessage>) -> Known {
        match &self.refinement.book {
            Some(book) if cx.replays() => book.turn(turn),
            _ => Known::Unknown,
        }
    }

    /// Does the work of all turns up to this one that nobody has done here, and says what this one publishes.
    fn bake_until(&mut self, turn: u64, cx: &Cx<'_, IlluminatorMessage>) -> Option<Published> {
        if cx.replays() && self.baked == 0 {
            let trouble = self.refinement.book.as_ref().map(|book| book.trouble());
            tracing::warn!("{}", trouble.unwrap_or_else(|| "the light is baked again".into()));
        }
        let mut published = None;
        while self.baked <= turn {
            published = self.step();
            if let Some(Published { map, last }) = &published {
                self.put_down(map, *last, cx);
                self.baked_map = Some(self.baked);
            }
            self.baked += 1;
        }
        published
    }

    /// Keeps a map for replays.
    fn put_down(&self, map: &Illumination, last: bool, cx: &Cx<'_, IlluminatorMessage>) {
        let Some(book) = self.refinement.book.as_ref().filter(|_| cx.replays() || cx.effects()) else {
            return;
        };
        if let Err(e) = book.keep(self.baked, self.baked_map, map, last) {
            tracing::warn!("a map of the light is not kept: {e}; who replays the walk has to bake it again");
        }
    }

    /// One step of the bake.
    fn step(&mut self) -> Option<Published> {
        let bake = std::mem::replace(&mut self.bake, Bake::Done);
        let Refinement { world, settings, .. } = &self.refinement;
        let work = || match bake {
            Bake::Begun => {
                let mut baker = Box::new(Baker::new(world.indexed(), settings));
                baker.begin_with(&*world.illumination);
                // The same light in the storage of what follows, so that values can be blended.
                let map = baker.map().clone();
                (Bake::Going(baker), Some(Published { map, last: false }))
            }
            Bake::Going(mut baker) => match baker.step(world.indexed()) {
                Step::Going => (Bake::Going(baker), None),
                Step::Better(map) => (Bake::Going(baker), Some(Published { map, last: false })),
                Step::Done(map) => (Bake::Done, Some(Published { map, last: true })),
            },
            Bake::Done => (Bake::Done, None),
        };
        let own_threads = || {
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            rayon::ThreadPoolBuilder::new().num_threads((cores / 2).max(1)).build().ok()
        };
        let (bake, published) = match self.pool.get_or_init(own_threads) {
            Some(pool) => pool.install(work),
            None => work(),
        };
        self.bake = bake;
        published
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
        let Stated { turn, paths, rounds, relative_error, last } = self.stated;
        let stage = match (self.turns, last) {
            (0, _) => "begun",
            (_, false) => "baking",
            (_, true) => "done",
        };
        Content::fields([
            ("stage", Content::Name(stage.into())),
            ("turns", Content::of(&self.turns)),
            ("published_in", Content::of(&turn)),
            ("paths", Content::of(&paths)),
            ("rounds", Content::of(&rounds)),
            ("stated_error", Content::of(&relative_error)),
            ("outbox", Content::of(&self.outbox.len())),
        ])
    }

    fn save(&self, saver: &mut Saver) {
        let Self {
            // What the wiring makes alike.
            refinement: _,
            renderer: _,
            pool: _,
            // Goes on from the start where a map is not at hand.
            bake: _,
            baked: _,
            baked_map: _,
            turns,
            stated,
            outbox,
        } = self;
        if !outbox.is_empty() {
            return saver.refuse();
        }
        saver.put(&(turns, stated));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.turns, self.stated) = loader.take()?;
        Some(())
    }
}
