//! The illuminator: refines the illumination while the walk goes on, uncoupled from the display.
//!
//! Owns a bake in progress. Hears only itself: each turn does one bounded batch. Says: to the renderer,
//! again and again, that there is better light. What it computes depends on its settings only, so the last
//! map is that of `foveal bake`, bit for bit.
//!
//! A walk that begins with light that a former one kept begins its bake anew all the same, and shows none of it until it is
//! better. A turn that takes long ends early where the actor is to stop ([`Cx::while_running`]).
//!
//! What a turn publishes is a function of its number, so a replay that has the maps at hand ([`LightBook`]) does not bake,
//! and a state is the number of turns. Where maps are missing they are baked again, from the first turn on.

use std::cell::OnceCell;
use std::path::PathBuf;
use std::sync::Arc;

use foveal::illumination::bake::orders::WhileWanted;
use foveal::illumination::bake::{BakeSettings, Baker, Step, cache_key, early_key};
use foveal::illumination::stored::{Illumination, Summary};
use foveal::world::World;
use foveal_files::bakes::save;
use foveal_runtime::{Actor, Address, Class, Content, Cx, Loader, Saver};
use serde::{Deserialize, Serialize};

use crate::light_book::{Known, LightBook};
use crate::message::{IlluminatorMessage, PublishedLight, RendererMessage};
use crate::outbox::Outbox;

/// What an illuminator works towards.
#[derive(Clone, Debug)]
pub struct Refinement {
    /// The scene with all its textures, whichever of them the walk keeps, and the light it begins with.
    pub world: World,
    /// Settings of the bake.
    pub settings: BakeSettings,
    /// Rounds of this bake that the light it begins with has; 0 where that is a first estimate.
    pub begun: u32,
    /// Where the last map is kept.
    pub keep: Option<PathBuf>,
    /// Where maps before it are kept, each in the place of the one before, for a walk that begins before there is a last one.
    pub early: Option<PathBuf>,
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

/// What is done beside a turn's work.
#[derive(Clone, Copy)]
struct During {
    replays: bool,
    effects: bool,
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
    /// Threads of its own, so that neither the display nor a tracer waits behind its work: they give way to the thread of its
    /// first turn, which makes them. `None` where there are none to be had.
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
        let during = During { replays: cx.replays(), effects: cx.effects() };
        let published = cx.while_running(|is_wanted| match self.at_hand(turn, during) {
            Known::Published { map, last } => Some(Some(Published { map, last })),
            Known::Silent => Some(None),
            Known::Unknown => self.bake_until(turn, during, is_wanted),
        });
        // Where it is to stop nobody waits for what it was at.
        let Some(published) = published else { return };
        self.turns += 1;
        if let Some(Published { map, last }) = published {
            let Summary { particles, rounds, relative_error, .. } = map.summary;
            self.stated = Stated { turn: Some(turn), paths: particles, rounds, relative_error, last };
            let light = Arc::new(PublishedLight::new(map.clone()));
            let hash = light.digest();
            let message = RendererMessage::Illuminated { map: light, last, hash };
            self.outbox.tell(cx, &self.renderer, message);
            // Shown before it is kept: nobody waits for a file.
            if during.effects {
                self.keep(&map, last);
            }
        }
        if !self.is_done() {
            let own = cx.address().clone();
            self.outbox.tell(cx, &own, IlluminatorMessage::Refine);
        }
    }

    /// What a replay need not bake.
    fn at_hand(&self, turn: u64, during: During) -> Known {
        match &self.refinement.book {
            Some(book) if during.replays => book.turn(turn),
            _ => Known::Unknown,
        }
    }

    /// Does the work of all turns up to this one that nobody has done here, and says what this one publishes; `None` where that
    /// is not wanted any more.
    fn bake_until(
        &mut self,
        turn: u64,
        during: During,
        is_wanted: &(dyn Fn() -> bool + Sync),
    ) -> Option<Option<Published>> {
        if during.replays && self.baked == 0 {
            let trouble = self.refinement.book.as_ref().map(|book| book.trouble());
            tracing::warn!("{}", trouble.unwrap_or_else(|| "the light is baked again".into()));
        }
        let mut published = None;
        while self.baked <= turn {
            published = self.step(is_wanted)?;
            if let Some(Published { map, last }) = &published {
                self.put_down(map, *last, during);
                self.baked_map = Some(self.baked);
            }
            self.baked += 1;
        }
        Some(published)
    }

    /// Keeps a map for replays.
    fn put_down(&self, map: &Illumination, last: bool, during: During) {
        let Some(book) = self.refinement.book.as_ref().filter(|_| during.replays || during.effects) else {
            return;
        };
        if let Err(e) = book.keep(self.baked, self.baked_map, map, last) {
            tracing::warn!("a map of the light is not kept: {e}; who replays the walk has to bake it again");
        }
    }

    /// One step of the bake; `None` where it is not wanted any more, and the bake is of no use then.
    fn step(&mut self, is_wanted: &(dyn Fn() -> bool + Sync)) -> Option<Option<Published>> {
        let bake = std::mem::replace(&mut self.bake, Bake::Done);
        let Refinement { world, settings, begun, .. } = &self.refinement;
        let work = || match bake {
            Bake::Begun => {
                let mut baker = Box::new(Baker::new_while(world.indexed(), settings, is_wanted)?);
                let map = match world.illumination.stored().filter(|_| *begun > 0) {
                    // It is in the storage of what follows, and stays on show until that is better.
                    Some(kept) => Arc::new(kept.clone()),
                    None => {
                        baker.begin_with(&*world.illumination);
                        // The same light in the storage of what follows, so that values can be blended.
                        baker.map().clone()
                    }
                };
                Some((Bake::Going(baker), Some(Published { map, last: false })))
            }
            Bake::Going(mut baker) => {
                let step = baker.step_by(world.indexed(), &WhileWanted(is_wanted));
                is_wanted().then_some(match step {
                    Step::Better(map) if map.summary.rounds > *begun => {
                        (Bake::Going(baker), Some(Published { map, last: false }))
                    }
                    Step::Better(_) | Step::Going => (Bake::Going(baker), None),
                    Step::Done(map) => (Bake::Done, Some(Published { map, last: true })),
                })
            }
            Bake::Done => Some((Bake::Done, None)),
        };
        // As many as there are processors, which give way to the tracers: half of the machine where those have work, all of it
        // where a view has converged.
        let own_threads =
            || rayon::ThreadPoolBuilder::new().start_handler(|_| foveal_runtime::give_way()).build().ok();
        let (bake, published) = match self.pool.get_or_init(own_threads) {
            Some(pool) => pool.install(work),
            None => work(),
        }?;
        self.bake = bake;
        Some(published)
    }

    /// Keeps a map for the next walk. That it cannot be kept costs time then, and nothing now.
    fn keep(&self, map: &Illumination, last: bool) {
        let Refinement { world, settings, keep, early, .. } = &self.refinement;
        let (file, key) = match last {
            true => (keep, cache_key(&world.scene, settings)),
            false => (early, early_key(&world.scene, settings)),
        };
        // What is on show in the first turn was kept by whoever made it.
        let Some(file) = file.as_ref().filter(|_| last || map.summary.rounds > 0) else { return };
        let folder = file.parent().map_or(Ok(()), std::fs::create_dir_all);
        if let Err(e) = folder.map_err(Into::into).and_then(|()| save(file, &key, map)) {
            match last {
                true => tracing::warn!("{}: the illumination cannot be kept: {e}", file.display()),
                false => tracing::debug!("{}: {e}", file.display()),
            }
        }
        if let (true, Some(early)) = (last, early) {
            // Nobody begins with it any more.
            let _ = std::fs::remove_file(early);
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
