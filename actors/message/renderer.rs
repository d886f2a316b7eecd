//! The renderer's inbox.

use std::sync::Arc;

use foveal::display::environment_map::EnvironmentMap;
use foveal::illumination::stored::Illumination;
use foveal::scene::Camera;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::supersampling::TileSums;
use foveal::splatting::{SampleBatch, WarpedSample};
use foveal_runtime::{Digest, Loader, Message, Saver};

use super::saved::{load_batch, load_sums, save_batch, save_sums};
use super::{FrameIndex, View};
use crate::settings::Adjustment;

/// What reaches the renderer from outside: the clock and the user. Recorded with its payload.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum RendererInput {
    /// A frame begins. The camera is where the path or the user has it at this time.
    FrameBegan {
        /// Its number.
        frame: FrameIndex,
        /// Camera of this moment.
        camera: Camera,
    },
    /// The frame's time is up: show what there is.
    DeadlineReached {
        /// Its number.
        frame: FrameIndex,
    },
    /// The user changed something.
    Adjusted(Adjustment),
}

/// Everything the renderer can be told.
#[derive(Clone, Debug)]
pub enum RendererMessage {
    /// From outside.
    Input(RendererInput),
    /// From the cache ager: the cached samples that still hold, in the picture of `view`.
    SamplesAged {
        /// The view they were warped for.
        view: View,
        /// Coarse before fine.
        samples: Arc<Vec<WarpedSample>>,
        /// How many samples expired for this view.
        expired: u32,
        /// Hash of the samples.
        hash: u64,
    },
    /// From a tracer.
    SamplesTraced {
        /// The samples.
        batch: Arc<SampleBatch>,
        /// Which tracer, counted from 0.
        tracer: u32,
        /// Their hash.
        hash: u64,
    },
    /// From a tracer: an object's environment map is ready; or from the allocator: it is given up.
    EnvironmentChanged {
        /// Whose map.
        object: u32,
        /// The map; none where it is given up.
        map: Option<Arc<EnvironmentMap>>,
        /// Its hash.
        hash: u64,
    },
    /// From the allocator: another level of a texture is to be shown, from the next frame on.
    TextureChanged {
        /// Which texture.
        texture: u32,
        /// The finest level from now on.
        finest: u32,
        /// Its texels where it is one level finer than before; none where finer levels are dropped.
        texels: Option<LevelTexels>,
    },
    /// From the allocator: every sample of the view has been traced, and all of them are in the
    /// mailbox before this message.
    ViewConverged {
        /// Which view.
        view: View,
    },
    /// From a tracer: more samples of a tile of a converged view.
    TileSampled {
        /// Which view.
        view: View,
        /// All that the tile has.
        sums: Arc<TileSums>,
        /// Hash of them.
        hash: u64,
    },
    /// From the allocator: the view is as good as it gets, and all of its tiles are in the mailbox before this message.
    ViewRefined {
        /// Which view.
        view: View,
    },
    /// From the illuminator: better light.
    Illuminated {
        /// The light.
        map: Arc<Illumination>,
        /// Whether it is the last.
        last: bool,
        /// Hash of the values.
        hash: u64,
    },
    /// From its own timer: send what was not accepted.
    SendAgain,
}

impl From<RendererInput> for RendererMessage {
    fn from(input: RendererInput) -> Self {
        Self::Input(input)
    }
}

impl Message for RendererMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Input(RendererInput::FrameBegan { frame, camera }) => {
                digest.u32(frame.0);
                for v in [camera.eye, camera.target, camera.up] {
                    v.to_array().into_iter().for_each(|c| digest.f32(c));
                }
                digest.f32(camera.fov_y);
            }
            Self::Input(RendererInput::DeadlineReached { frame }) => digest.u32(frame.0),
            Self::Input(RendererInput::Adjusted(adjustment)) => digest.bytes(&adjustment.to_bytes()),
            Self::SamplesAged { view, samples: _, expired, hash } => {
                digest.u32(view.0);
                digest.u32(*expired);
                digest.u64(*hash);
            }
            Self::SamplesTraced { batch: _, tracer, hash } => {
                digest.u32(*tracer);
                digest.u64(*hash);
            }
            Self::EnvironmentChanged { object, map: _, hash } => {
                digest.u32(*object);
                digest.u64(*hash);
            }
            Self::TextureChanged { texture, finest, texels } => {
                for word in [*texture, *finest, u32::from(texels.is_some())] {
                    digest.u32(word);
                }
            }
            Self::ViewConverged { view } | Self::ViewRefined { view } => digest.u32(view.0),
            Self::TileSampled { view, sums: _, hash } => {
                digest.u32(view.0);
                digest.u64(*hash);
            }
            Self::Illuminated { map: _, last, hash } => {
                digest.u32(u32::from(*last));
                digest.u64(*hash);
            }
            Self::SendAgain => {}
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Input(RendererInput::FrameBegan { .. }) => "FrameBegan",
            Self::Input(RendererInput::DeadlineReached { .. }) => "DeadlineReached",
            Self::Input(RendererInput::Adjusted(_)) => "Adjusted",
            Self::SamplesAged { .. } => "SamplesAged",
            Self::SamplesTraced { .. } => "SamplesTraced",
            Self::EnvironmentChanged { .. } => "EnvironmentChanged",
            Self::TextureChanged { .. } => "TextureChanged",
            Self::ViewConverged { .. } => "ViewConverged",
            Self::TileSampled { .. } => "TileSampled",
            Self::ViewRefined { .. } => "ViewRefined",
            Self::Illuminated { .. } => "Illuminated",
            Self::SendAgain => "SendAgain",
        }
    }

    fn size_bytes(&self) -> usize {
        match self {
            Self::SamplesAged { samples, .. } => samples.len() * size_of::<WarpedSample>(),
            Self::SamplesTraced { batch, .. } => batch.size_bytes(),
            Self::EnvironmentChanged { map, .. } => map.as_ref().map_or(0, |map| map.bytes()),
            Self::TextureChanged { texels, .. } => texels.as_ref().map_or(0, |t| t.as_bytes().len()),
            Self::TileSampled { sums, .. } => sums.size_bytes(),
            Self::Illuminated { map, .. } => map.bytes(),
            Self::Input(_) | Self::ViewConverged { .. } | Self::ViewRefined { .. } | Self::SendAgain => 0,
        }
    }

    fn save(&self, saver: &mut Saver) {
        match self {
            Self::Input(input) => saver.put(&(0_u8, input)),
            Self::SamplesAged { view, samples, expired, hash } => {
                saver.put(&(1_u8, view, expired, hash, samples.as_slice()));
            }
            Self::SamplesTraced { batch, tracer, hash } => {
                saver.put(&(2_u8, tracer, hash));
                save_batch(saver, batch);
            }
            Self::EnvironmentChanged { object, map, hash } => {
                saver.put(&(3_u8, object, hash, map.is_some()));
                if let Some(map) = map {
                    saver.shared(map, |map, saver| saver.put(map));
                }
            }
            // The allocator that sends these refuses, too.
            Self::TextureChanged { .. } => saver.refuse(),
            Self::ViewConverged { view } => saver.put(&(4_u8, view)),
            Self::TileSampled { view, sums, hash } => {
                saver.put(&(6_u8, view, hash));
                save_sums(saver, sums);
            }
            Self::ViewRefined { view } => saver.put(&(7_u8, view)),
            // A walk whose light is refined has no snapshots: a bake in progress is too large for them.
            Self::Illuminated { .. } => saver.refuse(),
            Self::SendAgain => saver.put(&5_u8),
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Some(match loader.take::<u8>()? {
            0 => Self::Input(loader.take()?),
            1 => {
                let (view, expired, hash, samples): (_, _, _, Vec<WarpedSample>) = loader.take()?;
                Self::SamplesAged { view, samples: Arc::new(samples), expired, hash }
            }
            2 => {
                let (tracer, hash) = loader.take()?;
                Self::SamplesTraced { batch: load_batch(loader)?, tracer, hash }
            }
            3 => {
                let (object, hash, there) = loader.take()?;
                let map = if there { Some(loader.shared(|loader| loader.take())?) } else { None };
                Self::EnvironmentChanged { object, map, hash }
            }
            4 => Self::ViewConverged { view: loader.take()? },
            5 => Self::SendAgain,
            6 => {
                let (view, hash) = loader.take()?;
                Self::TileSampled { view, sums: load_sums(loader)?, hash }
            }
            7 => Self::ViewRefined { view: loader.take()? },
            _ => return None,
        })
    }
}
