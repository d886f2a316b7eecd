//! The splat layer on the adapter. Twin of `foveal::splatting::layer`.
//!
//! Only new samples travel: the layer keeps its picture between frames of one view.

use bytemuck::{Pod, Zeroable};
use foveal::sampling::Lattice;
use foveal::splatting::layer::rank;
use foveal::splatting::{Footprint, SampleBatch, WarpedSample};

use super::adapter::Gpu;
use super::base::{BaseTargets, COLOR};

/// Ranks, as the depth that the rasteriser compares.
const RANK: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Depth of a rank: a power of two, so that no rank is rounded.
const DEPTH_OF_RANK: f32 = 1.0 / 16_777_216.0;

/// A splat as `splat.wgsl` reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct SplatRecord {
    place: u32,
    object: u32,
    rank: f32,
    shape: u32,
    depth: [f32; 2],
    color: [f32; 3],
}

/// The pipelines.
#[derive(Debug)]
pub struct SplatPass {
    warped: wgpu::RenderPipeline,
    fresh: wgpu::RenderPipeline,
    exact: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
}

/// The splat layer of one picture.
#[derive(Debug)]
pub struct SplatTargets {
    /// View-dependent radiance; alpha is 0 without splat, else 1 + who traced it.
    pub color: wgpu::Texture,
    /// Rank of what is shown, × 2⁻²⁴; 1 on the pixel's own ray.
    pub rank: wgpu::Texture,
    size: [u32; 2],
    k_max: u32,
    uniform: wgpu::Buffer,
    tiles: wgpu::Buffer,
    instances: wgpu::Buffer,
    warped: Vec<SplatRecord>,
    fresh: Vec<SplatRecord>,
    clear: bool,
}

impl SplatTargets {
    /// An empty layer for pictures of the size of `base`, level sets up to `k_max`.
    pub fn new(gpu: &Gpu, base: &BaseTargets, k_max: u32, footprint: Footprint) -> Self {
        let size = base.size;
        let header = [size[0], size[1], k_max, 0];
        Self {
            color: gpu.target("splat color", size, COLOR),
            rank: gpu.target("splat rank", size, RANK),
            size,
            k_max,
            uniform: gpu.buffer("splat layer", bytemuck::cast_slice(&header), wgpu::BufferUsages::UNIFORM),
            tiles: gpu.buffer(
                "tiles",
                bytemuck::cast_slice(&tile_table(k_max, footprint)),
                wgpu::BufferUsages::STORAGE,
            ),
            instances: gpu.buffer("splats", &[], wgpu::BufferUsages::VERTEX),
            warped: Vec::new(),
            fresh: Vec::new(),
            clear: true,
        }
    }

    /// K of the lattice.
    pub fn k_max(&self) -> u32 {
        self.k_max
    }

    /// Forgets all splats: a new view begins.
    pub fn clear(&mut self) {
        self.warped.clear();
        self.fresh.clear();
        self.clear = true;
    }

    /// Takes warped samples, to be drawn by the next [`SplatPass::draw`].
    pub fn splat_warped(&mut self, samples: &[WarpedSample]) {
        self.warped.extend(samples.iter().map(|s| SplatRecord {
            place: u32::from(s.x) | (u32::from(s.y) << 16),
            object: s.object,
            rank: rank(u32::from(s.k), u32::from(s.age).max(1)) as f32 * DEPTH_OF_RANK,
            shape: u32::from(s.half_side) | (u32::from(s.k) << 8) | (1 << 16),
            depth: [s.depth, s.depth_tolerance],
            color: s.color.to_array(),
        }));
    }

    /// Takes fresh samples, to be drawn by the next [`SplatPass::draw`]. `source`: who traced them.
    pub fn splat_fresh(&mut self, batch: &SampleBatch, source: u8) {
        let k = batch.k.min(self.k_max);
        let rank = rank(batch.k, 0) as f32 * DEPTH_OF_RANK;
        let shape = (k << 8) | ((u32::from(source) + 1) << 16);
        self.fresh.extend(batch.pixels.iter().zip(&batch.colors).map(|(pixel, color)| SplatRecord {
            place: u32::from(pixel[0]) | (u32::from(pixel[1]) << 16),
            object: batch.object,
            rank,
            shape,
            depth: [0.0; 2],
            color: color.to_array(),
        }));
    }
}

/// Per k the half side and first bit of its tile, then the bits of all tiles in rows.
fn tile_table(k_max: u32, footprint: Footprint) -> Vec<u32> {
    let mut header = Vec::new();
    let mut bits = Vec::new();
    let mut bit_count = 0;
    for k in 0..=k_max {
        let tile = Lattice::tile(k);
        let half = match footprint {
            Footprint::Tile => tile.iter().map(|&(x, y)| i32::from(x).abs().max(i32::from(y).abs())).max(),
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
            Footprint::Tile => tile.iter().for_each(|&(x, y)| set(i32::from(x), i32::from(y))),
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
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("splats"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = |vertex, fragment| {
            let attributes = wgpu::vertex_attr_array![0 => Uint32, 1 => Uint32, 2 => Float32, 3 => Uint32, 4 => Float32x2, 5 => Float32x3];
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(vertex),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: Default::default(),
                    buffers: &[Some(wgpu::VertexBufferLayout {
                        array_stride: size_of::<SplatRecord>() as u64,
                        step_mode: wgpu::VertexStepMode::Instance,
                        attributes: &attributes,
                    })],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: RANK,
                    depth_write_enabled: Some(true),
                    // A splat replaces what has a lower or equal rank.
                    depth_compare: Some(wgpu::CompareFunction::GreaterEqual),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: Default::default(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: COLOR,
                        blend: None,
                        write_mask: wgpu::ColorWrites::ALL,
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        Self {
            warped: pipeline("warped_vertex", "fragment"),
            fresh: pipeline("fresh_vertex", "tile_fragment"),
            exact: pipeline("exact_vertex", "fragment"),
            layout,
        }
    }

    /// Records the drawing of the samples taken since the last call. Returns their number.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        splats: &mut SplatTargets,
        base: &BaseTargets,
    ) -> usize {
        let (warped, fresh) = (splats.warped.len() as u32, splats.fresh.len() as u32);
        if !splats.clear && warped + fresh == 0 {
            return 0;
        }
        let record = size_of::<SplatRecord>() as u64;
        let needed = u64::from(warped + fresh) * record;
        if splats.instances.size() < needed {
            let empty = vec![0; needed.next_power_of_two() as usize];
            splats.instances = gpu.buffer("splats", &empty, wgpu::BufferUsages::VERTEX);
        }
        if warped > 0 {
            gpu.queue.write_buffer(&splats.instances, 0, bytemuck::cast_slice(&splats.warped));
        }
        if fresh > 0 {
            let offset = u64::from(warped) * record;
            gpu.queue.write_buffer(&splats.instances, offset, bytemuck::cast_slice(&splats.fresh));
        }
        let bind_group = self.bind(gpu, splats, base);
        let (color, rank) =
            (splats.color.create_view(&Default::default()), splats.rank.create_view(&Default::default()));
        let (load_color, load_rank) = if splats.clear {
            (wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), wgpu::LoadOp::Clear(0.0))
        } else {
            (wgpu::LoadOp::Load, wgpu::LoadOp::Load)
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("splats"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &color,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: load_color, store: wgpu::StoreOp::Store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &rank,
                depth_ops: Some(wgpu::Operations { load: load_rank, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_bind_group(0, &bind_group, &[]);
        pass.set_vertex_buffer(0, splats.instances.slice(..));
        for (pipeline, instances) in [
            (&self.warped, 0..warped),
            (&self.fresh, warped..warped + fresh),
            (&self.exact, warped..warped + fresh),
        ] {
            if !instances.is_empty() {
                pass.set_pipeline(pipeline);
                pass.draw(0..6, instances);
            }
        }
        drop(pass);
        splats.warped.clear();
        splats.fresh.clear();
        splats.clear = false;
        (warped + fresh) as usize
    }

    fn bind(&self, gpu: &Gpu, splats: &SplatTargets, base: &BaseTargets) -> wgpu::BindGroup {
        debug_assert_eq!(splats.size, base.size);
        let (objects, depths) =
            (base.object.create_view(&Default::default()), base.depth.create_view(&Default::default()));
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("splats"),
            layout: &self.layout,
            entries: &[
                entry(0, splats.uniform.as_entire_binding()),
                entry(1, splats.tiles.as_entire_binding()),
                entry(2, wgpu::BindingResource::TextureView(&objects)),
                entry(3, wgpu::BindingResource::TextureView(&depths)),
            ],
        })
    }
}

fn splat_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let texture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let kinds = [
        buffer(wgpu::BufferBindingType::Uniform),
        buffer(wgpu::BufferBindingType::Storage { read_only: true }),
        texture(wgpu::TextureSampleType::Uint),
        texture(wgpu::TextureSampleType::Float { filterable: false }),
    ];
    let entries: Vec<_> = kinds
        .into_iter()
        .enumerate()
        .map(|(i, ty)| wgpu::BindGroupLayoutEntry {
            binding: i as u32,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("splats"),
        entries: &entries,
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
    fn ranks_survive_as_depths() {
        for (k, age) in [(0, 0), (0, 1), (9, 0xffff), (9, 0), (3, 77)] {
            let r = rank(k, age);
            assert_eq!((r as f32 * DEPTH_OF_RANK / DEPTH_OF_RANK) as u32, r);
        }
    }
}
