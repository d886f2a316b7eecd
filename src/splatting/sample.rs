//! Ray-traced samples of the view-dependent radiance, and batches of them.

use glam::Vec3;
use xxhash_rust::xxh3::Xxh3;

/// One ray-traced sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Pixel in the view it was traced for.
    pub pixel: [u16; 2],
    /// Where the primary ray hit, world space.
    pub position: Vec3,
    /// Shading normal there, unit, towards the viewer's side.
    pub normal: Vec3,
    /// Unit vector to the eye it was traced for.
    pub view: Vec3,
    /// View-dependent radiance, linear.
    pub color: Vec3,
    /// World size of one pixel at the hit: depth × pixel angle.
    pub pixel_width: f32,
}

/// What the guides of some pixels of one object show in one view.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Guides {
    /// The view.
    pub view: u32,
    /// Pixels.
    pub pixels: Vec<[u16; 2]>,
    /// View-dependent radiance of each.
    pub colors: Vec<Vec3>,
}

impl Guides {
    /// Each pixel with its radiance.
    pub fn iter(&self) -> impl Iterator<Item = ([u16; 2], Vec3)> {
        self.pixels.iter().copied().zip(self.colors.iter().copied())
    }

    /// Bytes of them.
    pub fn size_bytes(&self) -> usize {
        self.pixels.len() * (4 + 12) + size_of::<Self>()
    }

    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(&self.view.to_le_bytes());
        h.update(bytemuck::cast_slice(&self.pixels));
        h.update(bytemuck::cast_slice(&self.colors));
        h.digest()
    }
}

/// Samples of one level of one object, traced for one view. A structure of arrays: ageing reads
/// positions, normals and views only, warping reads positions, colours and widths.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SampleBatch {
    /// The view (age of the camera) it was traced for.
    pub view: u32,
    /// Object id, ≥ 1.
    pub object: u32,
    /// Level set of the lattice: 0 is the finest.
    pub k: u32,
    /// Pixels.
    pub pixels: Vec<[u16; 2]>,
    /// Hit points.
    pub positions: Vec<Vec3>,
    /// Shading normals.
    pub normals: Vec<Vec3>,
    /// Unit vectors to the eye.
    pub views: Vec<Vec3>,
    /// View-dependent radiance.
    pub colors: Vec<Vec3>,
    /// World size of a pixel at each hit.
    pub pixel_widths: Vec<f32>,
    /// What the guides of these pixels show ([`crate::transport::tracer::guide`]); empty where the object has none.
    pub guides: Vec<Vec3>,
}

impl SampleBatch {
    /// An empty batch with room for `capacity` samples.
    pub fn new(view: u32, object: u32, k: u32, capacity: usize) -> Self {
        Self {
            view,
            object,
            k,
            pixels: Vec::with_capacity(capacity),
            positions: Vec::with_capacity(capacity),
            normals: Vec::with_capacity(capacity),
            views: Vec::with_capacity(capacity),
            colors: Vec::with_capacity(capacity),
            pixel_widths: Vec::with_capacity(capacity),
            guides: Vec::new(),
        }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether it holds no sample.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Adds a sample.
    pub fn push(&mut self, s: Sample) {
        self.pixels.push(s.pixel);
        self.positions.push(s.position);
        self.normals.push(s.normal);
        self.views.push(s.view);
        self.colors.push(s.color);
        self.pixel_widths.push(s.pixel_width);
    }

    /// The guide of sample number `i`; not a number where it has none.
    pub fn guide(&self, i: usize) -> Vec3 {
        self.guides.get(i).copied().unwrap_or(Vec3::NAN)
    }

    /// Bytes of the samples.
    pub fn size_bytes(&self) -> usize {
        self.len() * (4 + 4 * 12 + 4) + self.guides.len() * 12 + size_of::<Self>()
    }

    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        for word in [self.view, self.object, self.k] {
            h.update(&word.to_le_bytes());
        }
        h.update(bytemuck::cast_slice(&self.pixels));
        for v in [&self.positions, &self.normals, &self.views, &self.colors, &self.guides] {
            h.update(bytemuck::cast_slice(v));
        }
        h.update(bytemuck::cast_slice(&self.pixel_widths));
        h.digest()
    }
}
