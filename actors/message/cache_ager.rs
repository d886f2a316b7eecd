//! The cache ager's inbox.

use std::sync::Arc;

use foveal::scene::camera::CameraFrame;
use foveal::splatting::SampleBatch;
use foveal_runtime::{Digest, Loader, Message, Saver};

use super::View;
use super::saved::{load_batch, save_batch};
use crate::settings::Adjustment;

/// Everything the cache ager can be told.
#[derive(Clone, Debug)]
pub enum CacheAgerMessage {
    /// From the renderer, as a view begins: age and warp for it.
    CameraMoved {
        /// The new view.
        view: View,
        /// Its camera.
        frame: CameraFrame,
        /// The illumination changed, so no sample holds.
        forget: Forget,
    },
    /// From a tracer.
    SamplesTraced {
        /// The samples.
        batch: Arc<SampleBatch>,
        /// Their hash.
        hash: u64,
    },
    /// From the renderer: the user changed something.
    Adjusted(Adjustment),
    /// From its own timer: send what was not accepted.
    SendAgain,
}

/// Whether older samples may still hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Forget {
    /// Ageing decides.
    Nothing,
    /// Nothing of before holds.
    Everything,
}

impl Message for CacheAgerMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::CameraMoved { view, frame, forget } => {
                digest.u32(view.0);
                for v in [frame.eye, frame.forward, frame.right, frame.up] {
                    v.to_array().into_iter().for_each(|c| digest.f32(c));
                }
                digest.u32(u32::from(*forget == Forget::Everything));
            }
            Self::SamplesTraced { batch: _, hash } => digest.u64(*hash),
            Self::Adjusted(adjustment) => digest.bytes(&adjustment.to_bytes()),
            Self::SendAgain => {}
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::CameraMoved { .. } => "CameraMoved",
            Self::SamplesTraced { .. } => "SamplesTraced",
            Self::Adjusted(_) => "Adjusted",
            Self::SendAgain => "SendAgain",
        }
    }

    fn size_bytes(&self) -> usize {
        match self {
            Self::CameraMoved { .. } | Self::Adjusted(_) | Self::SendAgain => 0,
            Self::SamplesTraced { batch, .. } => batch.size_bytes(),
        }
    }

    fn save(&self, saver: &mut Saver) {
        match self {
            Self::CameraMoved { view, frame, forget } => saver.put(&(0_u8, view, frame, forget)),
            Self::SamplesTraced { batch, hash } => {
                saver.put(&(1_u8, hash));
                save_batch(saver, batch);
            }
            Self::SendAgain => saver.put(&2_u8),
            Self::Adjusted(adjustment) => saver.put(&(3_u8, adjustment)),
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Some(match loader.take::<u8>()? {
            0 => {
                let (view, frame, forget) = loader.take()?;
                Self::CameraMoved { view, frame, forget }
            }
            1 => {
                let hash = loader.take()?;
                Self::SamplesTraced { batch: load_batch(loader)?, hash }
            }
            2 => Self::SendAgain,
            3 => Self::Adjusted(loader.take()?),
            _ => return None,
        })
    }
}
