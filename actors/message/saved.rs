//! Views, frames and samples in snapshots of a replay. What is drawn is drawn anew, and its hash compared.

use std::sync::Arc;

use bytemuck::{AnyBitPattern, NoUninit};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::environment_map::EnvironmentMap;
use foveal::display::first_approximation::Probes;
use foveal::illumination::stored::Illumination;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::light_tracing::{LightSums, Splats};
use foveal::splatting::settled::Settled;
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::{Guides, SampleBatch};
use foveal::world::World;
use foveal_runtime::{Content, Digest, Loader, Saver};
use glam::Vec3;

use super::{DrawnBuffers, DrawnView, FrameIndex, FrameSnapshot, View};
use crate::light_book::LightBook;
use crate::textures::TextureStore;

/// What everything that is saved refers to.
pub struct SnapshotContext {
    /// Scene and illumination.
    pub world: World,
    /// What the display pass fills.
    pub passes: Passes,
    /// Where environment maps are captured; `None` in a scene without any.
    pub probes: Option<Arc<Probes>>,
    /// Textures, where they do not all fit into their limit.
    pub textures: Option<Arc<TextureStore>>,
    /// The maps that the illuminator published, where there is one.
    pub book: Option<Arc<LightBook>>,
}

/// Bulk data of a message or a state, each piece of which is saved once however many own it. A message's field says
/// `#[message(with = saved)]`.
pub trait Saved: Sized {
    /// Writes it.
    fn save(&self, saver: &mut Saver);

    /// Reads it; `None` where it was not written here, or is not sound.
    fn restore(loader: &mut Loader<'_>) -> Option<Self>;
}

/// Bulk data that carries what tells it apart, so that no message hashes it again.
pub trait Hashed {
    /// Adds that.
    fn digest(&self, digest: &mut Digest);
}

/// Bulk data, for whoever looks at a replay.
pub trait Told {
    /// What it is, large buffers by length, hash and extremes.
    fn content(&self) -> Content;
}

/// What `value` is.
pub fn content(value: &impl Told) -> Content {
    value.content()
}

/// Adds what tells `value` apart.
pub fn digest(value: &impl Hashed, digest: &mut Digest) {
    value.digest(digest);
}

/// Writes `value`.
pub fn save(value: &impl Saved, saver: &mut Saver) {
    value.save(saver);
}

/// Reads a value.
pub fn restore<T: Saved>(loader: &mut Loader<'_>) -> Option<T> {
    T::restore(loader)
}

impl<T: Told> Told for Option<T> {
    fn content(&self) -> Content {
        self.as_ref().map_or(Content::Name("none".into()), T::content)
    }
}

impl Told for Arc<DrawnView> {
    fn content(&self) -> Content {
        let DrawnView { view, frame, drawn, world: _, object_count, hash: _ } = &**self;
        Content::fields([
            ("view", Content::of(view)),
            ("camera", Content::of(frame)),
            ("cell", Content::of(&drawn.cell())),
            ("objects", Content::of(object_count)),
            ("hash", Content::of(&self.hash())),
        ])
    }
}

impl Told for Arc<FrameSnapshot> {
    fn content(&self) -> Content {
        let FrameSnapshot { index, drawn, rgb8: _, hash } = &**self;
        Content::fields([
            ("frame", Content::of(index)),
            ("drawn", drawn.content()),
            ("hash", Content::of(hash)),
        ])
    }
}

impl Told for LevelTexels {
    fn content(&self) -> Content {
        Content::fields([("bytes", Content::of(&self.as_bytes().len()))])
    }
}

/// What serde knows of it.
macro_rules! told_by_serde {
    ($($kind:ty),* $(,)?) => {$(
        impl Told for Arc<$kind> {
            fn content(&self) -> Content {
                Content::of(&**self)
            }
        }
    )*};
}

told_by_serde!(SampleBatch, Guides, TileSums, LightSums, Splats, Settled, EnvironmentMap, Illumination);

impl<T: Saved> Saved for Option<T> {
    fn save(&self, saver: &mut Saver) {
        saver.put(&self.is_some());
        self.iter().for_each(|value| value.save(saver));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Some(if loader.take()? { Some(T::restore(loader)?) } else { None })
    }
}

/// A view is saved without its buffers, and drawn again when they are asked for.
impl Saved for Arc<DrawnView> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |drawn, saver| {
            let hash = drawn.hash();
            let DrawnView { view, frame, drawn, world, object_count: _, hash: _ } = drawn;
            saver.put(&(view, frame, drawn.cell(), hash));
            world.save(saver);
        });
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let (view, frame, cell, hash): (View, CameraFrame, u32, u64) = loader.take()?;
            if !cpu_pass::CELLS.contains(&cell) {
                return None;
            }
            let world = World::restore(loader)?;
            let passes = loader.context::<SnapshotContext>()?.passes;
            let object_count = world.scene.objects.len().max(1);
            let shown_in = world.clone();
            let draw = move || {
                let [width, height] = frame.size.map(|s| s as usize);
                let mut buffers = FrameBuffers::new(width, height);
                // Read before rows are drawn beside each other.
                let _ = shown_in.illumination.stored();
                cpu_pass::draw_in_cells(&shown_in, &frame, passes, cell, &mut buffers);
                if hash_view(&buffers, view) != hash {
                    let View(view) = view;
                    tracing::warn!("view {view} is drawn otherwise than it was when its snapshot was taken");
                }
                buffers
            };
            let drawn = DrawnBuffers::later(cell, draw);
            Some(DrawnView { view, frame, hash: hash.into(), drawn, world, object_count })
        })
    }
}

impl Hashed for Arc<DrawnView> {
    fn digest(&self, digest: &mut Digest) {
        let DrawnView { view, frame, drawn: _, world: _, object_count: _, hash: _ } = &**self;
        digest.value(&(view, frame, self.hash()));
    }
}

impl Saved for Arc<FrameSnapshot> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |frame, saver| {
            let FrameSnapshot { index, drawn, rgb8, hash } = frame;
            saver.put(&(index, hash));
            drawn.save(saver);
            saver.shared(rgb8, |rgb8, saver| {
                saver.put(&(rgb8.width(), rgb8.height()));
                saver.bytes(rgb8.data().as_flattened());
            });
        });
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let (index, hash): (FrameIndex, u64) = loader.take()?;
            let drawn = Saved::restore(loader)?;
            let rgb8 = loader.shared(|loader| {
                let (width, height): (usize, usize) = loader.take()?;
                let (pixels, rest) = loader.bytes()?.as_chunks::<3>();
                let fits = rest.is_empty() && width.checked_mul(height) == Some(pixels.len());
                fits.then(|| Map2d::from_vec(width, height, pixels.to_vec()))
            })?;
            Some(FrameSnapshot { index, drawn, rgb8, hash })
        })
    }
}

impl Hashed for Arc<FrameSnapshot> {
    fn digest(&self, digest: &mut Digest) {
        let FrameSnapshot { index, drawn, rgb8: _, hash } = &**self;
        digest.value(&(index, hash));
        drawn.digest(digest);
    }
}

/// Writes the numbers of a column as they lie in memory.
fn put_column<T: NoUninit>(saver: &mut Saver, column: &[T]) {
    saver.bytes(bytemuck::cast_slice(column));
}

/// Reads such a column.
fn column<T: AnyBitPattern + NoUninit>(loader: &mut Loader<'_>) -> Option<Vec<T>> {
    let bytes = loader.bytes()?;
    let size = size_of::<T>();
    let mut column = vec![T::zeroed(); bytes.len() / size];
    bytes.len().is_multiple_of(size).then(|| bytemuck::cast_slice_mut(&mut column).copy_from_slice(bytes))?;
    Some(column)
}

/// Most of a snapshot is samples: whoever looks at a moment waits for them to be read.
impl Saved for Arc<SampleBatch> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |batch, saver| {
            let SampleBatch {
                view,
                object,
                k,
                pixels,
                positions,
                normals,
                views,
                colors,
                pixel_widths,
                guides,
            } = batch;
            saver.put(&(view, object, k));
            put_column(saver, pixels);
            for column in [positions, normals, views, colors, guides] {
                put_column(saver, column);
            }
            put_column(saver, pixel_widths);
        });
    }

    /// Its columns must be of one length.
    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let (view, object, k) = loader.take()?;
            let pixels: Vec<[u16; 2]> = column(loader)?;
            let [positions, normals, views, colors, guides] =
                [(); 5].map(|()| column::<Vec3>(loader).unwrap_or_default());
            let pixel_widths: Vec<f32> = column(loader)?;
            let lengths = [positions.len(), normals.len(), views.len(), colors.len(), pixel_widths.len()];
            let is_guided = guides.is_empty() || guides.len() == pixels.len();
            (is_guided && lengths.iter().all(|length| *length == pixels.len())).then_some(SampleBatch {
                view,
                object,
                k,
                pixels,
                positions,
                normals,
                views,
                colors,
                pixel_widths,
                guides,
            })
        })
    }
}

impl Saved for Arc<Guides> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |guides, saver| saver.put(guides));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let guides: Guides = loader.take()?;
            (guides.pixels.len() == guides.colors.len()).then_some(guides)
        })
    }
}

/// Who takes it up checks that it fits the picture.
impl Saved for Arc<TileSums> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |sums, saver| saver.put(sums));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| loader.take())
    }
}

/// Who takes it up checks that it fits the picture.
impl Saved for Arc<LightSums> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |sums, saver| saver.put(sums));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| loader.take())
    }
}

/// What lies beside the picture is not added.
impl Saved for Arc<Splats> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |splats, saver| saver.put(splats));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| loader.take())
    }
}

/// Who takes it up checks that it fits the picture.
impl Saved for Arc<Settled> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |settled, saver| saver.put(settled));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| loader.take())
    }
}

impl Saved for Arc<EnvironmentMap> {
    fn save(&self, saver: &mut Saver) {
        saver.shared(self, |map, saver| saver.put(map));
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| loader.take())
    }
}

/// Levels that are on their way are few.
impl Saved for LevelTexels {
    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.size() as u64));
        saver.bytes(self.as_bytes());
    }

    /// Who takes it up checks that it fits the texture.
    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        let size: u64 = loader.take()?;
        Self::of_size(usize::try_from(size).ok()?, loader.bytes()?)
    }
}

/// Levels come seldom, and from files that others may change.
impl Hashed for Option<LevelTexels> {
    fn digest(&self, digest: &mut Digest) {
        digest.value(&self.is_some());
        self.iter().for_each(|texels| digest.bytes(texels.as_bytes()));
    }
}

/// All of a view that followers read: what pixels hit, which samples begin at, ids, depths, and the light they show.
pub fn hash_view(buffers: &FrameBuffers, view: View) -> u64 {
    let mut h = xxhash_rust::xxh3::Xxh3::new();
    h.update(&view.0.to_le_bytes());
    h.update(bytemuck::cast_slice(buffers.object.data()));
    h.update(bytemuck::cast_slice(buffers.depth.data()));
    h.update(bytemuck::cast_slice(buffers.hit.data()));
    h.update(bytemuck::cast_slice(buffers.color.data()));
    h.digest()
}
