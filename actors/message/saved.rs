//! Views, frames and samples in snapshots of a replay. What is drawn is drawn anew, and its hash compared.

use std::sync::Arc;

use foveal::display::FrameBuffers;
use foveal::display::first_approximation::Probes;
use foveal::display::twin::{self, Passes};
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::SampleBatch;
use foveal::splatting::supersampling::TileSums;
use foveal::world::World;
use foveal_runtime::{Loader, Saver};

use super::{DrawnView, FrameIndex, FrameSnapshot, View};

/// What everything that is saved refers to.
pub struct Surroundings {
    /// Scene and illumination.
    pub world: World,
    /// What the display pass fills.
    pub passes: Passes,
    /// Where environment maps are captured; `None` in a scene without any.
    pub probes: Option<Arc<Probes>>,
}

/// Saves a view without its buffers.
pub fn save_drawn(saver: &mut Saver, drawn: &Arc<DrawnView>) {
    saver.shared(drawn, |drawn, saver| {
        let DrawnView { view, frame, buffers: _, world: _, object_count: _, hash } = drawn;
        saver.put(&(view, frame, hash));
    });
}

/// Draws a saved view again.
pub fn load_drawn(loader: &mut Loader<'_>) -> Option<Arc<DrawnView>> {
    loader.shared(|loader| {
        let (view, frame, hash): (View, CameraFrame, u64) = loader.take()?;
        let surroundings = loader.context::<Surroundings>()?;
        let world = surroundings.world.clone();
        let [width, height] = frame.size.map(|s| s as usize);
        let mut buffers = FrameBuffers::new(width, height);
        twin::draw(&world, &frame, surroundings.passes, &mut buffers);
        let object_count = world.scene.objects.len().max(1);
        let same = hash_view(&buffers, view) == hash;
        same.then_some(DrawnView { view, frame, hash, buffers, world, object_count })
    })
}

/// What followers of a view could depend on: ids and depths.
pub fn hash_view(buffers: &FrameBuffers, view: View) -> u64 {
    let mut h = xxhash_rust::xxh3::Xxh3::new();
    h.update(&view.0.to_le_bytes());
    h.update(bytemuck::cast_slice(buffers.object.data()));
    h.update(bytemuck::cast_slice(buffers.depth.data()));
    h.digest()
}

/// Saves a shown frame.
pub fn save_frame(saver: &mut Saver, frame: &Arc<FrameSnapshot>) {
    saver.shared(frame, |frame, saver| {
        let FrameSnapshot { index, drawn, rgb8, hash } = frame;
        saver.put(&(index, hash));
        save_drawn(saver, drawn);
        saver.shared(rgb8, |rgb8, saver| {
            saver.put(&(rgb8.width(), rgb8.height()));
            saver.bytes(rgb8.data().as_flattened());
        });
    });
}

/// Reads a saved frame.
pub fn load_frame(loader: &mut Loader<'_>) -> Option<Arc<FrameSnapshot>> {
    loader.shared(|loader| {
        let (index, hash): (FrameIndex, u64) = loader.take()?;
        let drawn = load_drawn(loader)?;
        let rgb8 = loader.shared(|loader| {
            let (width, height): (usize, usize) = loader.take()?;
            let (pixels, rest) = loader.bytes()?.as_chunks::<3>();
            let fits = rest.is_empty() && width.checked_mul(height) == Some(pixels.len());
            fits.then(|| Map2d::from_vec(width, height, pixels.to_vec()))
        })?;
        Some(FrameSnapshot { index, drawn, rgb8, hash })
    })
}

/// Saves a batch of samples.
pub fn save_batch(saver: &mut Saver, batch: &Arc<SampleBatch>) {
    saver.shared(batch, |batch, saver| saver.put(batch));
}

/// Reads a saved batch; its columns must be of one length.
pub fn load_batch(loader: &mut Loader<'_>) -> Option<Arc<SampleBatch>> {
    loader.shared(|loader| {
        let batch: SampleBatch = loader.take()?;
        let SampleBatch { view: _, object: _, k: _, pixels, positions, normals, views, colors, pixel_widths } =
            &batch;
        let lengths = [positions.len(), normals.len(), views.len(), colors.len(), pixel_widths.len()];
        lengths.iter().all(|length| *length == pixels.len()).then_some(batch)
    })
}

/// Saves what a tile has.
pub fn save_sums(saver: &mut Saver, sums: &Arc<TileSums>) {
    saver.shared(sums, |sums, saver| saver.put(sums));
}

/// Reads what a tile has; who takes it up checks that it fits the picture.
pub fn load_sums(loader: &mut Loader<'_>) -> Option<Arc<TileSums>> {
    loader.shared(|loader| loader.take())
}
