//! The splat layer on the adapter. The CPU pass is `foveal::splatting::layer`.
//!
//! Only new samples travel: the layer keeps its picture between frames of one view. What a pixel shows is found by
//! computing, not by rasterising: most splats are smaller than what it takes to set up their triangles.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use foveal::sampling::Lattice;
use foveal::splatting::layer::{APPROXIMATED, OWN, rank};
use foveal::splatting::{Footprint, Guides, SampleBatch, WarpedSample};
use glam::Vec3;

use super::adapter::Gpu;
use super::base::BaseTargets;
use super::layout::{bind_group_layout, buffer, storage, texture};
use super::textures::half_bits;

/// Pixels that one invocation of a shader covers, as in `splat.wgsl`.
const CHUNK: u32 = 64;
/// Invocations of a workgroup, as in `splat.wgsl`.
const WORKGROUP: u32 = 64;
/// Splats that cover so many chunks at most are drawn together.
const GROUPS: [u32; 3] = [1, 16, u32::MAX];
/// Kinds of splats, as in `splat.wgsl`.
const FRESH: u32 = 1;
const FIRST: u32 = 2;

/// A splat as `splat.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct SplatRecord {
    place: u32,
    object: u32,
    rank: u32,
    shape: u32,
    depth: [f32; 2],
    color: [u16; 4],
    guide: [u16; 4],
    number: u32,
    padding: u32,
}

/// The pipelines.
#[derive(Debug)]
pub struct SplatPass {
    /// One after the other: ranks, owners, colours.
    steps: [wgpu::ComputePipeline; 3],
    layout: wgpu::BindGroupLayout,
    group_layout: wgpu::BindGroupLayout,
}

/// The splat layer of one picture.
#[derive(Debug)]
pub struct SplatTargets {
    /// View-dependent radiance per pixel, three halves; the fourth is 0 without splat, else 1 + who traced it.
    pub colors: wgpu::Buffer,
    /// Rank per pixel of what is shown, as in [`foveal::splatting::SplatLayer`].
    pub ranks: wgpu::Buffer,
    /// Of the sample that each pixel shows, as in [`foveal::splatting::SplatLayer`]: its pixel, and three halves of what its
    /// guide showed; the fourth is 1 where it has one.
    pub details: wgpu::Buffer,
    /// What the guides of pixels show: three halves, and 1 where there is one.
    pub guides: wgpu::Buffer,
    /// The same as it is to be there after the next draw.
    guides_by_pixel: GuidesByPixel,
    owners: wgpu::Buffer,
    size: [u32; 2],
    k_max: u32,
    /// Pixels of the square around each tile.
    areas: Vec<u32>,
    uniform: wgpu::Buffer,
    tiles: wgpu::Buffer,
    instances: wgpu::Buffer,
    groups: wgpu::Buffer,
    /// New splats, in the groups of [`GROUPS`], and the most chunks of one.
    new: [(Vec<SplatRecord>, u32); 3],
    /// Splats of the view so far.
    count: u32,
    clear: bool,
}

/// What guides show, pixel by pixel, and what of it the adapter has. Most views have few guides or none: only the
/// pixels between the first and the last travel.
#[derive(Debug)]
struct GuidesByPixel {
    guides: Vec<[u16; 4]>,
    /// Pixels that may have one.
    used: Range<usize>,
    /// Pixels that may have one on the adapter.
    sent: Range<usize>,
    is_sent: bool,
}

impl GuidesByPixel {
    fn clear(&mut self) {
        self.guides[self.used.clone()].fill([0; 4]);
        self.used = 0..0;
        self.is_sent = self.sent.is_empty();
    }

    fn set(&mut self, i: usize, color: Vec3) {
        if let Some(guide) = self.guides.get_mut(i) {
            *guide = halves(color, 1);
            self.used = enclosing(&self.used, &(i..i + 1));
            self.is_sent = false;
        }
    }

    /// The first pixel to be written and what, if the adapter has others; it is taken to have them from then on.
    fn take_changed(&mut self) -> Option<(usize, &[[u16; 4]])> {
        let changed = enclosing(&self.used, &self.sent);
        self.sent = self.used.clone();
        let is_sent = std::mem::replace(&mut self.is_sent, true);
        (!is_sent).then(|| (changed.start, &self.guides[changed]))
    }
}

/// The smallest range around both.
fn enclosing(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b.clone(),
        (_, true) => a.clone(),
        _ => a.start.min(b.start)..a.end.max(b.end),
    }
}

/// Most bytes of a buffer that [`SplatTargets`] binds, for pictures of `size`.
pub fn largest_buffer(size: [u32; 2]) -> u64 {
    u64::from(size[0]) * u64::from(size[1]) * 16
}

impl SplatTargets {
    /// An empty layer for pictures of the size of `base`, level sets up to `k_max`.
    pub fn new(gpu: &Gpu, base: &BaseTargets, k_max: u32, footprint: Footprint) -> Self {
        let size = base.size;
        let header = [size[0], size[1], k_max, if footprint == Footprint::Smooth { OWN } else { 0 }];
        let table = tile_table(k_max, footprint);
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let per_pixel = |label, bytes| {
            let size = u64::from(size[0]) * u64::from(size[1]) * bytes;
            gpu.empty_buffer(label, size, storage)
        };
        Self {
            colors: per_pixel("splat colors", 8),
            ranks: per_pixel("splat ranks", 4),
            details: per_pixel("splat details", 16),
            guides: gpu.empty_buffer(
                "guides",
                u64::from(size[0]) * u64::from(size[1]) * 8,
                storage | wgpu::BufferUsages::COPY_DST,
            ),
            guides_by_pixel: GuidesByPixel {
                guides: vec![[0; 4]; size[0] as usize * size[1] as usize],
                used: 0..0,
                sent: 0..0,
                is_sent: true,
            },
            owners: per_pixel("splat owners", 4),
            size,
            k_max,
            areas: table.chunks_exact(2).take(k_max as usize + 1).map(|t| (2 * t[0] + 1).pow(2)).collect(),
            uniform: gpu.buffer("splat layer", bytemuck::cast_slice(&header), wgpu::BufferUsages::UNIFORM),
            tiles: gpu.buffer("tiles", bytemuck::cast_slice(&table), wgpu::BufferUsages::STORAGE),
            instances: gpu.empty_buffer("splats", 1 << 16, wgpu::BufferUsages::STORAGE),
            groups: gpu.empty_buffer("groups of splats", 3 * 256, wgpu::BufferUsages::UNIFORM),
            new: Default::default(),
            count: 0,
            clear: true,
        }
    }

    /// K of the lattice.
    pub fn k_max(&self) -> u32 {
        self.k_max
    }

    /// Forgets all splats: a new view begins.
    pub fn clear(&mut self) {
        self.new.iter_mut().for_each(|(records, chunks)| {
            records.clear();
            *chunks = 0;
        });
        self.count = 0;
        self.clear = true;
        self.guides_by_pixel.clear();
    }

    /// Takes what guides show.
    pub fn guide(&mut self, guides: &Guides) {
        for ([x, y], color) in guides.iter() {
            self.guides_by_pixel.set(usize::from(y) * self.size[0] as usize + usize::from(x), color);
        }
    }

    /// Brings the guides to the adapter where they changed. Whether they did.
    pub fn send_guides(&mut self, gpu: &Gpu) -> bool {
        let Some((first, guides)) = self.guides_by_pixel.take_changed() else { return false };
        gpu.queue.write_buffer(&self.guides, first as u64 * 8, bytemuck::cast_slice(guides));
        true
    }

    fn push(&mut self, mut record: SplatRecord, area: u32) {
        self.count += 1;
        record.number = self.count;
        let chunks = area.div_ceil(CHUNK);
        let group = GROUPS.iter().position(|most| chunks <= *most).unwrap_or(GROUPS.len() - 1);
        let (records, most) = &mut self.new[group];
        records.push(record);
        *most = chunks.max(*most);
    }

    /// Takes first approximations, which lie below all samples, to be drawn by the next [`SplatPass::draw`]: column, row,
    /// object id and radiance.
    pub fn approximate(&mut self, pixels: impl Iterator<Item = (u16, u16, u32, Vec3)>) {
        for (x, y, object, color) in pixels {
            let record = SplatRecord {
                place: u32::from(x) | (u32::from(y) << 16),
                object,
                rank: APPROXIMATED,
                shape: (1 << 16) | (FIRST << 28),
                color: halves(color, 1),
                ..SplatRecord::zeroed()
            };
            self.push(record, 1);
        }
    }

    /// Takes warped samples, to be drawn by the next [`SplatPass::draw`].
    pub fn splat_warped(&mut self, samples: &[WarpedSample]) {
        for s in samples {
            let side = 2 * u32::from(s.half_side) + 1;
            let record = SplatRecord {
                place: u32::from(s.x) | (u32::from(s.y) << 16),
                object: s.object,
                rank: rank(u32::from(s.k), u32::from(s.age).max(1)),
                shape: u32::from(s.half_side) | (u32::from(s.k) << 8) | (1 << 16),
                depth: [s.depth, s.depth_tolerance],
                color: halves(s.color, 1),
                guide: guide_halves(s.guide),
                ..SplatRecord::zeroed()
            };
            self.push(record, side * side);
        }
    }

    /// Takes fresh samples, to be drawn by the next [`SplatPass::draw`]. `source`: who traced them.
    pub fn splat_fresh(&mut self, batch: &SampleBatch, source: u8) {
        let k = batch.k.min(self.k_max);
        let source = u32::from(source) + 1;
        let area = self.areas.get(k as usize).copied().unwrap_or(1);
        for (i, (pixel, color)) in batch.pixels.iter().zip(&batch.colors).enumerate() {
            let record = SplatRecord {
                place: u32::from(pixel[0]) | (u32::from(pixel[1]) << 16),
                object: batch.object,
                rank: rank(batch.k, 0),
                shape: (k << 8) | (source << 16) | (FRESH << 28),
                color: halves(*color, source),
                guide: guide_halves(batch.guide(i)),
                ..SplatRecord::zeroed()
            };
            self.push(record, area);
        }
    }
}

fn halves(color: Vec3, source: u32) -> [u16; 4] {
    color.extend(source as f32).to_array().map(half_bits)
}

fn guide_halves(guide: Vec3) -> [u16; 4] {
    if guide.is_nan() { [0; 4] } else { halves(guide, 1) }
}

/// Per k the half side and first bit of its tile, then the bits of all tiles in rows.
fn tile_table(k_max: u32, footprint: Footprint) -> Vec<u32> {
    let mut header = Vec::new();
    let mut bits = Vec::new();
    let mut bit_count = 0;
    for k in 0..=k_max {
        let tile = Lattice::tile(k);
        let half = match footprint {
            Footprint::Tile | Footprint::Linear | Footprint::Smooth => {
                tile.iter().map(|&(x, y)| i32::from(x).abs().max(i32::from(y).abs())).max()
            }
            Footprint::Square => None,
        }
        .unwrap_or(Lattice::square_side(k) / 2);
        let side = 2 * half + 1;
        header.extend([half as u32, bit_count]);
        let area = (side * side) as u32;
        bits.resize(((bit_count + area) as usize).div_ceil(32), 0u32);
        let mut set = |x: i32, y: i32| {
            let bit = bit_count as usize + ((y + half) * side + x + half) as usize;
            bits[bit / 32] |= 1 << (bit % 32);
        };
        match footprint {
            Footprint::Tile | Footprint::Linear | Footprint::Smooth => {
                tile.iter().for_each(|&(x, y)| set(i32::from(x), i32::from(y)))
            }
            Footprint::Square => (-half..=half).for_each(|y| (-half..=half).for_each(|x| set(x, y))),
        }
        bit_count += area;
    }
    header.extend(bits);
    header
}

impl SplatPass {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("splat.wgsl"));
        let layout = splat_layout(device);
        let group_layout = group_layout(device);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("splats"),
            bind_group_layouts: &[Some(&layout), Some(&group_layout)],
            ..Default::default()
        });
        let steps = ["raise", "own", "color"].map(|entry_point| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: Default::default(),
                cache: None,
            })
        });
        Self { steps, layout, group_layout }
    }

    /// Records the drawing of the samples taken since the last call. Returns their number.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        splats: &mut SplatTargets,
        base: &BaseTargets,
    ) -> usize {
        if std::mem::take(&mut splats.clear) {
            for buffer in [&splats.ranks, &splats.owners, &splats.colors] {
                encoder.clear_buffer(buffer, 0, None);
            }
        }
        // Splats beyond what one binding can hold wait for the next frame; there are never so many at once.
        let record = size_of::<SplatRecord>() as u64;
        let most = (gpu.device.limits().max_storage_buffer_binding_size / record) as usize;
        let drawn = splats.new.iter().map(|(new, _)| new.len()).sum::<usize>().min(most);
        if drawn == 0 {
            return 0;
        }
        let needed = drawn as u64 * record;
        if splats.instances.size() < needed {
            splats.instances =
                gpu.empty_buffer("splats", needed.next_power_of_two(), wgpu::BufferUsages::STORAGE);
        }
        let (mut groups, mut dispatches, mut first) = ([[0u32; 64]; 3], [[0u32; 2]; 3], 0);
        for (i, (new, chunks)) in splats.new.iter_mut().enumerate() {
            let taken = new.len().min(drawn - first);
            groups[i][..2].copy_from_slice(&[first as u32, taken as u32]);
            dispatches[i] = [(taken as u32).div_ceil(WORKGROUP), *chunks];
            if taken > 0 {
                let to = first as u64 * record;
                gpu.queue.write_buffer(&splats.instances, to, bytemuck::cast_slice(&new[..taken]));
            }
            new.drain(..taken);
            first += taken;
        }
        gpu.queue.write_buffer(&splats.groups, 0, bytemuck::cast_slice(&groups));
        let [bind_group, group] = self.bind(gpu, splats, base);
        for pipeline in &self.steps {
            // Each pass sees what the one before has written.
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            for (i, [splats, chunks]) in dispatches.into_iter().enumerate() {
                if splats > 0 {
                    pass.set_bind_group(1, &group, &[256 * i as u32]);
                    pass.dispatch_workgroups(splats, chunks, 1);
                }
            }
        }
        drawn
    }

    fn bind(&self, gpu: &Gpu, splats: &SplatTargets, base: &BaseTargets) -> [wgpu::BindGroup; 2] {
        debug_assert_eq!(splats.size, base.size);
        let (objects, depths) =
            (base.object.create_view(&Default::default()), base.depth.create_view(&Default::default()));
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let layer = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("splats"),
            layout: &self.layout,
            entries: &[
                entry(0, splats.uniform.as_entire_binding()),
                entry(1, splats.tiles.as_entire_binding()),
                entry(2, wgpu::BindingResource::TextureView(&objects)),
                entry(3, wgpu::BindingResource::TextureView(&depths)),
                entry(4, splats.instances.as_entire_binding()),
                entry(5, splats.ranks.as_entire_binding()),
                entry(6, splats.owners.as_entire_binding()),
                entry(7, splats.colors.as_entire_binding()),
                entry(8, splats.details.as_entire_binding()),
            ],
        });
        let group =
            wgpu::BufferBinding { buffer: &splats.groups, offset: 0, size: std::num::NonZeroU64::new(16) };
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("group of splats"),
            layout: &self.group_layout,
            entries: &[entry(0, wgpu::BindingResource::Buffer(group))],
        });
        [layer, group]
    }
}

fn splat_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let kinds = [
        buffer(wgpu::BufferBindingType::Uniform),
        storage(true),
        texture(wgpu::TextureSampleType::Uint),
        texture(wgpu::TextureSampleType::Float { filterable: false }),
        storage(true),
        storage(false),
        storage(false),
        storage(false),
        storage(false),
    ];
    bind_group_layout(device, "splats", wgpu::ShaderStages::COMPUTE, kinds)
}

fn group_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("group of splats"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: true,
                min_binding_size: None,
            },
            count: None,
        }],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_holds_as_many_bits_as_tiles_have_pixels() {
        for (footprint, area) in [
            (Footprint::Tile, (|k| 5u32.pow(k)) as fn(u32) -> u32),
            (Footprint::Square, |k| (Lattice::square_side(k) * Lattice::square_side(k)) as u32),
        ] {
            let table = tile_table(4, footprint);
            let ones: u32 = table[10..].iter().map(|w| w.count_ones()).sum();
            assert_eq!(ones, (0..=4).map(area).sum::<u32>());
        }
    }

    #[test]
    fn only_guides_that_change_travel_and_old_ones_go() {
        let mut guides = GuidesByPixel { guides: vec![[0; 4]; 100], used: 0..0, sent: 0..0, is_sent: true };
        let mut adapter = guides.guides.clone();
        let mut send = |guides: &mut GuidesByPixel| {
            let Some((first, new)) = guides.take_changed() else { return 0 };
            adapter[first..first + new.len()].copy_from_slice(new);
            let sent = new.len();
            assert_eq!(adapter, guides.guides);
            sent
        };
        assert_eq!(send(&mut guides), 0, "there are none");
        guides.set(30, Vec3::ONE);
        guides.set(10, Vec3::X);
        guides.set(100, Vec3::ONE);
        assert_eq!(send(&mut guides), 21, "from the first to the last inside of the picture");
        assert_eq!(send(&mut guides), 0, "they are there");
        guides.clear();
        guides.set(50, Vec3::Y);
        assert_eq!(send(&mut guides), 41, "old ones are taken away");
        guides.clear();
        assert_eq!(send(&mut guides), 1);
        guides.clear();
        assert_eq!(send(&mut guides), 0, "a view without guides after one without");
    }
}
