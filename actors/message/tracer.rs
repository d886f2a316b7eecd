//! A tracer's inbox, and the jobs it gets from the pool.

use std::sync::Arc;

use foveal::allocation::jobs::SampleJob;
use foveal::allocation::supersampling::AllSums;
use foveal::display::environment_map::Seen;
use foveal::display::first_approximation::Probes;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::light_tracing::LightSums;
use foveal::splatting::supersampling::Block;
use foveal::world::World;
use foveal_runtime::{Content, Digest, Job, Loader, Message, Saver};

use super::saved::{Hashed, Saved, SnapshotContext, Told};
use super::{DrawnView, View};
use crate::textures::TextureStore;

/// An order for a tracer, complete in itself.
#[derive(Clone, Debug)]
pub enum TraceJob {
    /// Samples of a view.
    Samples(SampleOrder),
    /// More samples for a tile of a converged view.
    Tile(TileWork),
    /// A run of particles, traced to the eye of a converged view.
    Run(RunWork),
    /// The picture of all tiles.
    Settle(SettleWork),
    /// Part of an environment map.
    Environment(EnvironmentOrder),
    /// Which levels of which textures a view wants.
    Prediction(PredictionOrder),
    /// A level of a texture, from disk.
    Level(LevelOrder),
}

/// A view to look ahead from.
#[derive(Clone, Debug)]
pub struct PredictionOrder {
    /// The view.
    pub drawn: Arc<DrawnView>,
    /// The textures.
    pub store: Arc<TextureStore>,
}

/// A level to load.
#[derive(Clone, Debug)]
pub struct LevelOrder {
    /// The textures.
    pub store: Arc<TextureStore>,
    /// Which texture.
    pub texture: u32,
    /// Which level.
    pub level: u32,
    /// Texels of the same kind.
    pub like: Option<LevelTexels>,
}

/// Samples to trace.
#[derive(Clone, Debug)]
pub struct SampleOrder {
    /// The view to trace for.
    pub drawn: Arc<DrawnView>,
    /// Which samples.
    pub order: SampleJob,
    /// Seed of the random numbers.
    pub seed: u64,
    /// The priority it was given, in [0, 1]: it explains the job and decides nothing any more.
    pub priority: f32,
    /// Combined saliency and importance of its object by then, in [0, 1].
    pub attention: f32,
}

/// A block of a tile to sample.
#[derive(Clone, Debug)]
pub struct TileWork {
    /// The view.
    pub drawn: Arc<DrawnView>,
    /// Which samples of which tile.
    pub block: Block,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Particles to trace to an eye.
#[derive(Clone, Debug)]
pub struct RunWork {
    /// The view.
    pub drawn: Arc<DrawnView>,
    /// Which run.
    pub run: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Tiles to make a picture of.
#[derive(Clone, Debug)]
pub struct SettleWork {
    /// The view.
    pub drawn: Arc<DrawnView>,
    /// What each tile has.
    pub tiles: Arc<AllSums>,
    /// What was traced to the eye, where paths do not find all.
    pub traced: Option<Arc<LightSums>>,
}

/// Part of an object's environment map.
#[derive(Clone, Debug)]
pub struct EnvironmentOrder {
    /// What is seen.
    pub world: World,
    /// Where maps are captured.
    pub probes: Arc<Probes>,
    /// The object.
    pub object: u32,
    /// Texels along an edge.
    pub side: u32,
    /// Phong exponent of its lobe; none for a mirror.
    pub exponent: Option<f32>,
    /// What to do.
    pub work: EnvironmentWork,
}

/// What a job was, and how to do it again: what is told of one that is given up.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum TraceBrief {
    /// Samples of a view.
    Samples {
        /// The view.
        view: View,
        /// Which samples.
        order: SampleJob,
        /// Seed of the random numbers.
        seed: u64,
    },
    /// More samples for a tile.
    Tile {
        /// The view.
        view: View,
        /// Which tile.
        tile: u32,
        /// Samples a pixel that it had.
        had: u32,
        /// Samples a pixel that it was to get.
        count: u32,
        /// Seed of the random numbers.
        seed: u64,
    },
    /// A run of particles.
    Run {
        /// The view.
        view: View,
        /// Which run.
        run: u32,
        /// Seed of the random numbers.
        seed: u64,
    },
    /// The picture of all tiles.
    Settle {
        /// The view.
        view: View,
    },
    /// Part of an environment map, or its filter.
    Environment {
        /// Whose map.
        object: u32,
        /// Texels along an edge.
        side: u32,
        /// First texel and number of texels; none for the filter.
        texels: Option<[u32; 2]>,
    },
    /// Which levels of which textures a view wants.
    Prediction {
        /// The view.
        view: View,
    },
    /// A level of a texture.
    Level {
        /// Which texture.
        texture: u32,
        /// Which level.
        level: u32,
    },
}

/// The two steps to a map.
#[derive(Clone, Debug)]
pub enum EnvironmentWork {
    /// Trace `count` texels from `first` on.
    Capture {
        /// First texel.
        first: u32,
        /// Number of texels.
        count: u32,
    },
    /// Filter what was captured, and hand it to the renderer.
    Filter {
        /// All texels.
        seen: Arc<Vec<Seen>>,
    },
}

/// What a tracer can be told. Its work comes from the pool.
#[derive(Clone, Copy, Debug, Message)]
pub enum TracerMessage {
    /// From its own timer, or from the allocator after a panic that may have lost it: send what waits.
    SendAgain,
}

impl Job for TraceJob {
    type Brief = TraceBrief;

    /// Every field is named here: a new one says what becomes of it.
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Samples(SampleOrder { drawn, order, seed, priority: _, attention: _ }) => {
                drawn.digest(digest);
                digest.value(&(order, seed));
            }
            Self::Tile(TileWork { drawn, block, seed }) => {
                drawn.digest(digest);
                digest.value(&(block, seed));
            }
            Self::Run(RunWork { drawn, run, seed }) => {
                drawn.digest(digest);
                digest.value(&(run, seed));
            }
            Self::Settle(SettleWork { drawn, tiles, traced }) => {
                drawn.digest(digest);
                // They were hashed when they came.
                let samples = tiles.iter().flatten().map(|t| u64::from(t.samples)).sum::<u64>();
                digest.value(&(samples, traced.as_ref().map_or(0, |traced| traced.runs())));
            }
            Self::Environment(EnvironmentOrder { world: _, probes: _, object, side, exponent, work }) => {
                digest.value(&(object, side, exponent));
                match work {
                    EnvironmentWork::Capture { first, count } => digest.value(&(0_u8, first, count)),
                    // What was seen was hashed when it came.
                    EnvironmentWork::Filter { seen } => digest.value(&(1_u8, seen.len() as u64)),
                }
            }
            Self::Prediction(PredictionOrder { drawn, store: _ }) => drawn.digest(digest),
            Self::Level(LevelOrder { store, texture, level, like }) => {
                digest.value(&(texture, store.digest(*texture as usize), level));
                like.digest(digest);
            }
        }
    }

    fn brief(&self) -> TraceBrief {
        match self {
            Self::Samples(SampleOrder { drawn, order, seed, priority: _, attention: _ }) => {
                TraceBrief::Samples { view: drawn.view, order: *order, seed: *seed }
            }
            Self::Tile(TileWork { drawn, block: Block { tile, first, count }, seed }) => {
                TraceBrief::Tile { view: drawn.view, tile: *tile, had: *first, count: *count, seed: *seed }
            }
            Self::Run(RunWork { drawn, run, seed }) => {
                TraceBrief::Run { view: drawn.view, run: *run, seed: *seed }
            }
            Self::Settle(work) => TraceBrief::Settle { view: work.drawn.view },
            Self::Environment(o) => TraceBrief::Environment {
                object: o.object,
                side: o.side,
                texels: match o.work {
                    EnvironmentWork::Capture { first, count } => Some([first, count]),
                    EnvironmentWork::Filter { .. } => None,
                },
            },
            Self::Prediction(o) => TraceBrief::Prediction { view: o.drawn.view },
            Self::Level(o) => TraceBrief::Level { texture: o.texture, level: o.level },
        }
    }

    fn travels(&self) -> bool {
        crate::station::travels(self)
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Samples(_) => "TraceJob",
            Self::Tile(_) => "TileJob",
            Self::Run(_) => "RunJob",
            Self::Settle(_) => "SettleJob",
            Self::Environment(_) => "EnvironmentJob",
            Self::Prediction(_) => "PredictionJob",
            Self::Level(_) => "LevelJob",
        }
    }

    fn content(&self) -> Content {
        let fields = match self {
            Self::Samples(SampleOrder { drawn, order, seed, priority, attention }) => vec![
                ("drawn", drawn.content()),
                ("order", Content::of(order)),
                ("seed", Content::of(seed)),
                ("priority", Content::of(priority)),
                ("attention", Content::of(attention)),
            ],
            Self::Tile(TileWork { drawn, block: Block { tile, first, count }, seed }) => vec![
                ("drawn", drawn.content()),
                ("tile", Content::of(tile)),
                ("first", Content::of(first)),
                ("count", Content::of(count)),
                ("seed", Content::of(seed)),
            ],
            Self::Run(RunWork { drawn, run, seed }) => {
                vec![("drawn", drawn.content()), ("run", Content::of(run)), ("seed", Content::of(seed))]
            }
            Self::Settle(SettleWork { drawn, tiles, traced }) => vec![
                ("drawn", drawn.content()),
                ("tiles", Content::list(tiles.iter().map(Told::content))),
                ("traced", traced.content()),
            ],
            Self::Environment(EnvironmentOrder { world: _, probes: _, object, side, exponent, work }) => {
                let work = match work {
                    EnvironmentWork::Capture { first, count } => Content::of(&[first, count]),
                    EnvironmentWork::Filter { seen } => Content::of(seen),
                };
                vec![
                    ("object", Content::of(object)),
                    ("side", Content::of(side)),
                    ("exponent", Content::of(exponent)),
                    ("work", work),
                ]
            }
            Self::Prediction(PredictionOrder { drawn, .. }) => vec![("drawn", drawn.content())],
            Self::Level(LevelOrder { texture, level, .. }) => {
                vec![("texture", Content::of(texture)), ("level", Content::of(level))]
            }
        };
        Content::variant(self.kind(), fields)
    }

    fn save(&self, saver: &mut Saver) {
        match self {
            Self::Samples(SampleOrder { drawn, order, seed, priority, attention }) => {
                saver.put(&(0_u8, order, seed, priority, attention));
                drawn.save(saver);
            }
            Self::Tile(TileWork { drawn, block, seed }) => {
                saver.put(&(2_u8, block, seed));
                drawn.save(saver);
            }
            Self::Run(RunWork { drawn, run, seed }) => {
                saver.put(&(4_u8, run, seed));
                drawn.save(saver);
            }
            Self::Settle(SettleWork { drawn, tiles, traced }) => {
                saver.put(&(3_u8, tiles.len() as u64));
                drawn.save(saver);
                tiles.iter().for_each(|tile| tile.save(saver));
                traced.save(saver);
            }
            Self::Environment(EnvironmentOrder { world: _, probes: _, object, side, exponent, work }) => {
                saver.put(&(1_u8, object, side, exponent));
                match work {
                    EnvironmentWork::Capture { first, count } => saver.put(&(0_u8, first, count)),
                    EnvironmentWork::Filter { seen } => saver.put(&(1_u8, seen.as_slice())),
                }
            }
            Self::Prediction(PredictionOrder { drawn, store: _ }) => {
                saver.put(&5_u8);
                drawn.save(saver);
            }
            Self::Level(LevelOrder { store: _, texture, level, like }) => {
                saver.put(&(6_u8, texture, level));
                like.save(saver);
            }
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        match loader.take::<u8>()? {
            0 => {
                let (order, seed, priority, attention) = loader.take()?;
                let drawn = Saved::restore(loader)?;
                return Some(Self::Samples(SampleOrder { drawn, order, seed, priority, attention }));
            }
            1 => {}
            2 => {
                let (block, seed) = loader.take()?;
                return Some(Self::Tile(TileWork { drawn: Saved::restore(loader)?, block, seed }));
            }
            3 => {
                let count: u64 = loader.take()?;
                let drawn = Saved::restore(loader)?;
                let tiles: Option<AllSums> = (0..count).map(|_| Saved::restore(loader)).collect();
                let (tiles, traced) = (Arc::new(tiles?), Saved::restore(loader)?);
                return Some(Self::Settle(SettleWork { drawn, tiles, traced }));
            }
            4 => {
                let (run, seed) = loader.take()?;
                return Some(Self::Run(RunWork { drawn: Saved::restore(loader)?, run, seed }));
            }
            5 => {
                let drawn = Saved::restore(loader)?;
                let store = loader.context::<SnapshotContext>()?.textures.clone()?;
                return Some(Self::Prediction(PredictionOrder { drawn, store }));
            }
            6 => {
                let (texture, level) = loader.take()?;
                let like = Saved::restore(loader)?;
                let store = loader.context::<SnapshotContext>()?.textures.clone()?;
                let facts = store.facts.get(texture as usize)?;
                if level as usize >= facts.bytes.len() {
                    return None;
                }
                return Some(Self::Level(LevelOrder { store, texture, level, like }));
            }
            _ => return None,
        }
        let context = loader.context::<SnapshotContext>()?;
        let (world, probes) = (context.world.clone(), context.probes.clone()?);
        let (object, side, exponent) = loader.take()?;
        let work = if loader.take::<u8>()? == 0 {
            let (first, count) = loader.take()?;
            EnvironmentWork::Capture { first, count }
        } else {
            EnvironmentWork::Filter { seen: Arc::new(loader.take()?) }
        };
        Some(Self::Environment(EnvironmentOrder { world, probes, object, side, exponent, work }))
    }
}
