//! The allocator's inbox.

use std::sync::Arc;

use foveal::allocation::environment::MapContrast;
use foveal::allocation::rays::Residual;
use foveal::allocation::texture_demand::TextureUse;
use foveal::display::environment_map::Seen;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::supersampling::TileSums;
use foveal_runtime::{Digest, Incident, Lane, Loader, Message, Saver};

use super::saved::{load_drawn, load_sums, save_drawn, save_sums};
use super::{DrawnView, View};
use crate::settings::Adjustment;

/// Everything the allocator can be told.
#[derive(Clone, Debug)]
pub enum AllocatorMessage {
    /// From the renderer: a new view is being drawn; jobs of older ones are void, so that the tracers leave the
    /// cores to the drawing.
    ViewBegun {
        /// The view.
        view: View,
    },
    /// From the renderer: a new view is drawn; jobs of older ones are void.
    ViewDrawn {
        /// The view.
        drawn: Arc<DrawnView>,
    },
    /// From the analyzer: how much each object matters to the eye.
    ObjectsRanked {
        /// The view that was looked at.
        view: View,
        /// Mean saliency of each object's pixels, by object id, in [0, 1].
        saliency: Arc<Vec<f32>>,
    },
    /// From a tracer: a job is done and its samples are on their way.
    JobDone {
        /// The view it was for.
        view: View,
        /// Object id.
        object: u32,
        /// Level.
        level: u32,
        /// Samples traced.
        samples: u32,
        /// How long that took on one core, seconds, as measured.
        seconds: f32,
    },
    /// From the renderer, where the policy learns from it: how far samples were from what was shown.
    ResidualsMeasured {
        /// The view they were splatted into.
        view: View,
        /// Object id.
        object: u32,
        /// Level.
        level: u32,
        /// Where the first of them is.
        pixel: [u16; 2],
        /// The differences.
        residual: Residual,
    },
    /// From a tracer: a tile of a converged view has more samples, which are with the renderer.
    TileSampled {
        /// The view.
        view: View,
        /// What the tile has; none where the order came back.
        sums: Option<Arc<TileSums>>,
        /// Hash of it.
        hash: u64,
    },
    /// From a tracer: part of an environment map is captured.
    EnvironmentCaptured {
        /// Whose map.
        object: u32,
        /// What was seen; nothing where the order came back.
        seen: Arc<Vec<Seen>>,
        /// Hash of it.
        hash: u64,
        /// How long that took on one core, seconds, as measured.
        seconds: f32,
    },
    /// From a tracer: a map is with the renderer.
    EnvironmentFiltered {
        /// Whose map.
        object: u32,
        /// What is lost without it.
        contrast: MapContrast,
    },
    /// From a tracer: what a view and the turns that may follow it show of each texture.
    TexturesSeen {
        /// By texture.
        uses: Arc<Vec<TextureUse>>,
        /// Hash of it.
        hash: u64,
    },
    /// From a tracer: a level of a texture.
    LevelLoaded {
        /// Which texture.
        texture: u32,
        /// Which level.
        level: u32,
        /// Its texels; none where it cannot be had.
        texels: Option<LevelTexels>,
    },
    /// From the renderer: nobody holds what was dropped so far any more.
    TexturesReleased {
        /// How many drops that was, since the beginning.
        drops: u32,
    },
    /// From the renderer: the user changed something.
    Adjusted(Adjustment),
    /// From the runtime: an actor panicked, a job was given up, or a tracer was stopped.
    Incident(Incident),
    /// From its own timer: the next portion of a decision.
    DecideOn,
    /// From its own timer: send what was not accepted.
    SendAgain,
}

impl Message for AllocatorMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::ViewBegun { view } => digest.u32(view.0),
            Self::ViewDrawn { drawn } => {
                digest.u32(drawn.view.0);
                digest.u64(drawn.hash);
            }
            Self::ObjectsRanked { view, saliency } => {
                digest.u32(view.0);
                saliency.iter().for_each(|s| digest.f32(*s));
            }
            Self::JobDone { view, object, level, samples, seconds } => {
                for word in [view.0, *object, *level, *samples] {
                    digest.u32(word);
                }
                digest.f32(*seconds);
            }
            Self::ResidualsMeasured { view, object, level, pixel: [x, y], residual } => {
                for word in [view.0, *object, *level, u32::from(*x), u32::from(*y), residual.count()] {
                    digest.u32(word);
                }
                digest.f32(residual.mean().unwrap_or(0.0));
            }
            Self::TileSampled { view, sums: _, hash } => {
                digest.u32(view.0);
                digest.u64(*hash);
            }
            Self::EnvironmentCaptured { object, seen: _, hash, seconds } => {
                digest.u32(*object);
                digest.u64(*hash);
                digest.f32(*seconds);
            }
            Self::EnvironmentFiltered { object, contrast } => {
                digest.u32(*object);
                digest.f32(contrast.mean);
                digest.f32(contrast.relative_difference);
            }
            Self::TexturesSeen { uses: _, hash } => digest.u64(*hash),
            Self::LevelLoaded { texture, level, texels } => {
                for word in [*texture, *level, u32::from(texels.is_some())] {
                    digest.u32(word);
                }
            }
            Self::TexturesReleased { drops } => digest.u32(*drops),
            Self::Adjusted(adjustment) => digest.bytes(&adjustment.to_bytes()),
            Self::Incident(incident) => digest.bytes(format!("{incident:?}").as_bytes()),
            Self::DecideOn | Self::SendAgain => {}
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::ViewBegun { .. } => "ViewBegun",
            Self::ViewDrawn { .. } => "ViewDrawn",
            Self::ObjectsRanked { .. } => "ObjectsRanked",
            Self::JobDone { .. } => "JobDone",
            Self::ResidualsMeasured { .. } => "ResidualsMeasured",
            Self::TileSampled { .. } => "TileSampled",
            Self::EnvironmentCaptured { .. } => "EnvironmentCaptured",
            Self::EnvironmentFiltered { .. } => "EnvironmentFiltered",
            Self::TexturesSeen { .. } => "TexturesSeen",
            Self::LevelLoaded { .. } => "LevelLoaded",
            Self::TexturesReleased { .. } => "TexturesReleased",
            Self::Adjusted(_) => "Adjusted",
            Self::Incident(_) => "Incident",
            Self::DecideOn => "DecideOn",
            Self::SendAgain => "SendAgain",
        }
    }

    fn lane(&self) -> Lane {
        match self {
            Self::Incident(_) => Lane::Control,
            Self::ViewBegun { .. }
            | Self::ViewDrawn { .. }
            | Self::ObjectsRanked { .. }
            | Self::JobDone { .. }
            | Self::ResidualsMeasured { .. }
            | Self::TileSampled { .. }
            | Self::EnvironmentCaptured { .. }
            | Self::EnvironmentFiltered { .. }
            | Self::TexturesSeen { .. }
            | Self::LevelLoaded { .. }
            | Self::TexturesReleased { .. }
            | Self::Adjusted(_)
            | Self::DecideOn
            | Self::SendAgain => Lane::Data,
        }
    }

    fn save(&self, saver: &mut Saver) {
        match self {
            Self::ViewBegun { view } => saver.put(&(0_u8, view)),
            Self::ViewDrawn { drawn } => {
                saver.put(&1_u8);
                save_drawn(saver, drawn);
            }
            Self::ObjectsRanked { view, saliency } => saver.put(&(2_u8, view, saliency.as_slice())),
            Self::JobDone { view, object, level, samples, seconds } => {
                saver.put(&(3_u8, view, object, level, samples, seconds));
            }
            Self::ResidualsMeasured { view, object, level, pixel, residual } => {
                saver.put(&(4_u8, view, object, level, pixel, residual));
            }
            Self::EnvironmentCaptured { object, seen, hash, seconds } => {
                saver.put(&(5_u8, object, hash, seconds, seen.as_slice()));
            }
            Self::EnvironmentFiltered { object, contrast } => saver.put(&(6_u8, object, contrast)),
            // Only an allocator that refuses gets these.
            Self::TexturesSeen { .. } | Self::LevelLoaded { .. } | Self::TexturesReleased { .. } => {
                saver.refuse();
            }
            Self::Incident(incident) => saver.put(&(7_u8, incident)),
            Self::SendAgain => saver.put(&8_u8),
            Self::TileSampled { view, sums, hash } => {
                saver.put(&(9_u8, view, hash, sums.is_some()));
                if let Some(sums) = sums {
                    save_sums(saver, sums);
                }
            }
            Self::Adjusted(adjustment) => saver.put(&(10_u8, adjustment)),
            Self::DecideOn => saver.put(&11_u8),
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Some(match loader.take::<u8>()? {
            0 => Self::ViewBegun { view: loader.take()? },
            1 => Self::ViewDrawn { drawn: load_drawn(loader)? },
            2 => {
                let (view, saliency): (_, Vec<f32>) = loader.take()?;
                Self::ObjectsRanked { view, saliency: Arc::new(saliency) }
            }
            3 => {
                let (view, object, level, samples, seconds) = loader.take()?;
                Self::JobDone { view, object, level, samples, seconds }
            }
            4 => {
                let (view, object, level, pixel, residual) = loader.take()?;
                Self::ResidualsMeasured { view, object, level, pixel, residual }
            }
            5 => {
                let (object, hash, seconds, seen): (_, _, _, Vec<Seen>) = loader.take()?;
                Self::EnvironmentCaptured { object, seen: Arc::new(seen), hash, seconds }
            }
            6 => {
                let (object, contrast) = loader.take()?;
                Self::EnvironmentFiltered { object, contrast }
            }
            7 => Self::Incident(loader.take()?),
            8 => Self::SendAgain,
            9 => {
                let (view, hash, is_sampled) = loader.take()?;
                let sums = if is_sampled { Some(load_sums(loader)?) } else { None };
                Self::TileSampled { view, sums, hash }
            }
            10 => Self::Adjusted(loader.take()?),
            11 => Self::DecideOn,
            _ => return None,
        })
    }
}
