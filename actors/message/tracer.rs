//! A tracer's inbox, and the jobs it gets from the pool.

use std::sync::Arc;

use foveal::allocation::jobs::SampleJob;
use foveal::allocation::supersampling::TileOrder;
use foveal::display::environment_map::Seen;
use foveal::display::first_approximation::Probes;
use foveal::scene::texture::LevelTexels;
use foveal::world::World;
use foveal_runtime::{Digest, Job, Loader, Message, Saver};

use super::DrawnView;
use super::saved::{Surroundings, load_drawn, load_sums, save_drawn, save_sums};
use crate::textures::TextureStore;

/// An order for a tracer, complete in itself.
#[derive(Clone, Debug)]
pub enum TraceJob {
    /// Samples of a view.
    Samples(SampleOrder),
    /// More samples for a tile of a converged view.
    Tile(TileWork),
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

/// A tile to sample on.
#[derive(Clone, Debug)]
pub struct TileWork {
    /// The view.
    pub drawn: Arc<DrawnView>,
    /// Which tile, what it has, how many samples.
    pub order: TileOrder,
    /// Seed of the random numbers.
    pub seed: u64,
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

/// What the description of a job says if it belongs to a map.
pub const ENVIRONMENT_MAP: &str = "of the environment map";

/// What the description of a job that samples a tile begins with.
pub const TILE_OF_VIEW: &str = "supersampling of view";

/// What the description of a job that looks ahead begins with.
pub const TEXTURES_WANTED: &str = "the textures wanted";

/// What the description of a job that loads a level begins with; texture and level follow.
pub const LEVEL_OF_TEXTURE: &str = "loading texture";

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
#[derive(Clone, Copy, Debug)]
pub enum TracerMessage {
    /// From its own timer, or from the allocator after a panic that may have lost it: send what waits.
    SendAgain,
}

impl Message for TracerMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::SendAgain => digest.u32(0),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::SendAgain => "SendAgain",
        }
    }

    fn save(&self, saver: &mut Saver) {
        let Self::SendAgain = self;
        saver.put(&0_u8);
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        (loader.take::<u8>()? == 0).then_some(Self::SendAgain)
    }
}

impl Job for TraceJob {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Samples(SampleOrder { drawn, order: o, seed: _, priority: _, attention: _ }) => {
                digest.u32(drawn.view.0);
                digest.u64(drawn.hash);
                for word in [o.object, o.level, o.count, o.start.x as u32, o.start.y as u32] {
                    digest.u32(word);
                }
            }
            Self::Tile(TileWork { drawn, order, seed: _ }) => {
                digest.u32(drawn.view.0);
                let samples = order.on.as_ref().map_or(0, |on| on.samples);
                for word in [order.tile, order.count, samples] {
                    digest.u32(word);
                }
            }
            Self::Environment(o) => {
                digest.u32(o.object);
                digest.u32(o.side);
                match &o.work {
                    EnvironmentWork::Capture { first, count } => {
                        digest.u32(*first);
                        digest.u32(*count);
                    }
                    EnvironmentWork::Filter { seen } => digest.u32(seen.len() as u32),
                }
            }
            Self::Prediction(o) => digest.u32(o.drawn.view.0),
            Self::Level(o) => {
                digest.u64(o.store.digest(o.texture as usize));
                digest.u32(o.level);
            }
        }
    }

    fn describe(&self) -> String {
        match self {
            Self::Samples(SampleOrder { drawn, order: o, seed, priority: _, attention: _ }) => {
                let r = &o.rect;
                format!(
                    "{} samples of object {}, level {}, view {}, pixels [{}, {}) × [{}, {}) from ({}, {}), seed {}",
                    o.count,
                    o.object,
                    o.level,
                    drawn.view.0,
                    r.x0,
                    r.x1,
                    r.y0,
                    r.y1,
                    o.start.x,
                    o.start.y,
                    seed
                )
            }
            Self::Tile(TileWork { drawn, order, seed }) => {
                let had = order.on.as_ref().map_or(0, |on| on.samples);
                format!(
                    "{TILE_OF_VIEW} {}, tile {}, {} samples a pixel after {had}, seed {seed}",
                    drawn.view.0, order.tile, order.count
                )
            }
            Self::Environment(o) => {
                let what = match &o.work {
                    EnvironmentWork::Capture { first, count } => format!("{count} texels from {first} on"),
                    EnvironmentWork::Filter { .. } => "the filter".to_owned(),
                };
                format!("{what} {ENVIRONMENT_MAP} of object {}, side {}", o.object, o.side)
            }
            Self::Prediction(o) => format!("{TEXTURES_WANTED} by view {}", o.drawn.view.0),
            Self::Level(o) => format!("{LEVEL_OF_TEXTURE} {}, level {}", o.texture, o.level),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Samples(_) => "TraceJob",
            Self::Tile(_) => "TileJob",
            Self::Environment(_) => "EnvironmentJob",
            Self::Prediction(_) => "PredictionJob",
            Self::Level(_) => "LevelJob",
        }
    }

    fn save(&self, saver: &mut Saver) {
        match self {
            Self::Samples(SampleOrder { drawn, order, seed, priority, attention }) => {
                saver.put(&(0_u8, order, seed, priority, attention));
                save_drawn(saver, drawn);
            }
            Self::Tile(TileWork { drawn, order: TileOrder { tile, on, count }, seed }) => {
                saver.put(&(2_u8, tile, count, seed, on.is_some()));
                save_drawn(saver, drawn);
                if let Some(on) = on {
                    save_sums(saver, on);
                }
            }
            Self::Environment(EnvironmentOrder { world: _, probes: _, object, side, exponent, work }) => {
                saver.put(&(1_u8, object, side, exponent));
                match work {
                    EnvironmentWork::Capture { first, count } => saver.put(&(0_u8, first, count)),
                    EnvironmentWork::Filter { seen } => saver.put(&(1_u8, seen.as_slice())),
                }
            }
            // The allocator that orders these refuses, too.
            Self::Prediction(_) | Self::Level(_) => saver.refuse(),
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        match loader.take::<u8>()? {
            0 => {
                let (order, seed, priority, attention) = loader.take()?;
                let drawn = load_drawn(loader)?;
                return Some(Self::Samples(SampleOrder { drawn, order, seed, priority, attention }));
            }
            1 => {}
            2 => {
                let (tile, count, seed, begun) = loader.take()?;
                let drawn = load_drawn(loader)?;
                let on = if begun { Some(load_sums(loader)?) } else { None };
                return Some(Self::Tile(TileWork { drawn, order: TileOrder { tile, on, count }, seed }));
            }
            _ => return None,
        }
        let surroundings = loader.context::<Surroundings>()?;
        let (world, probes) = (surroundings.world.clone(), surroundings.probes.clone()?);
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
