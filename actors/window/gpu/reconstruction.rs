//! What is shown between samples, on the adapter. The CPU passes are `foveal::splatting::reconstruction` and `pull_push`.

use bytemuck::{Pod, Zeroable};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::Footprint;
use foveal::splatting::pull_push::{ENOUGH, LEVELS};
use foveal::splatting::reconstruction::{DEPTH_SHARES, slope};

use super::adapter::Gpu;
use super::base::BaseTargets;
use super::layout::{bind_group_layout, buffer, storage, texture};
use super::splat::SplatTargets;

/// Invocations of a workgroup, as in `reconstruction.wgsl`.
const WORKGROUP: u32 = 64;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ViewRecord {
    size: [u32; 2],
    slope: f32,
    white: f32,
    depth_shares: [f32; 2],
    is_smooth: u32,
    enough: f32,
    /// Width, height, first cell, and side of a cell in pixels.
    levels: [[u32; 4]; LEVELS],
}

/// Bytes of a cell, as in `reconstruction.wgsl`.
const CELL: u64 = 32;

/// The levels of a picture, and how many cells they have.
fn levels(size: [u32; 2]) -> ([[u32; 4]; LEVELS], u32) {
    let (mut size, mut first) = (size, 0);
    let levels = std::array::from_fn(|n| {
        size = size.map(|v| v.div_ceil(2));
        let level = [size[0], size[1], first, 2 << n];
        first += size[0] * size[1];
        level
    });
    (levels, first)
}

/// The pipelines.
#[derive(Debug)]
pub struct ReconstructionPass {
    pull: wgpu::ComputePipeline,
    push: wgpu::ComputePipeline,
    reconstruct: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// The splat layer of one picture with what lies between its samples.
#[derive(Debug)]
pub struct ReconstructionTargets {
    /// As [`SplatTargets::colors`]; none where that is shown as it is.
    shown: Option<wgpu::Buffer>,
    uniform: wgpu::Buffer,
    /// Of all levels, where samples are mixed however they lie.
    cells: wgpu::Buffer,
    /// The number of each level, for one pass at a time.
    numbers: wgpu::Buffer,
    is_smooth: bool,
    size: [u32; 2],
}

impl ReconstructionTargets {
    /// For pictures of `size`.
    pub fn new(gpu: &Gpu, size: [u32; 2], footprint: Footprint) -> Self {
        let bytes = u64::from(size[0]) * u64::from(size[1]) * 8;
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let is_smooth = footprint == Footprint::Smooth;
        let count = if is_smooth { levels(size).1.max(1) } else { 1 };
        let apart = gpu.device.limits().min_uniform_buffer_offset_alignment.max(16) as usize;
        let mut numbers = vec![0u8; apart * LEVELS];
        for (n, record) in numbers.chunks_mut(apart).enumerate() {
            record[..4].copy_from_slice(&(n as u32).to_le_bytes());
        }
        Self {
            cells: gpu.empty_buffer("cells", u64::from(count) * CELL, wgpu::BufferUsages::STORAGE),
            numbers: gpu.buffer("levels", &numbers, wgpu::BufferUsages::UNIFORM),
            is_smooth,
            shown: footprint.interpolates().then(|| gpu.empty_buffer("reconstruction", bytes, storage)),
            uniform: gpu.buffer(
                "reconstructed view",
                bytemuck::bytes_of(&ViewRecord::zeroed()),
                wgpu::BufferUsages::UNIFORM,
            ),
            size,
        }
    }

    /// A view begins, on a display that shows this radiance as white.
    pub fn begin_view(&mut self, gpu: &Gpu, frame: &CameraFrame, white: f32) {
        let record = ViewRecord {
            size: self.size,
            slope: slope(frame),
            white,
            depth_shares: DEPTH_SHARES,
            is_smooth: u32::from(self.is_smooth),
            enough: ENOUGH,
            levels: levels(self.size).0,
        };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&record));
    }

    /// What is shown of the splat layer: three halves of radiance, and as in [`SplatTargets::colors`] who traced it.
    pub fn shown<'a>(&'a self, splats: &'a SplatTargets) -> &'a wgpu::Buffer {
        self.shown.as_ref().unwrap_or(&splats.colors)
    }
}

impl ReconstructionPass {
    /// Compiles the passes.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("reconstruction.wgsl"));
        let layout = layout(device);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("reconstruction"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = |name: &str| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(name),
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let [pull, push, reconstruct] = ["pull", "push", "reconstruct"].map(pipeline);
        Self { pull, push, reconstruct, layout }
    }

    /// Records the computing of all pixels, after the splats that are drawn by then.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        targets: &ReconstructionTargets,
        splats: &SplatTargets,
        base: &BaseTargets,
    ) {
        let Some(shown) = &targets.shown else { return };
        let (objects, depths) =
            (base.object.create_view(&Default::default()), base.depth.create_view(&Default::default()));
        let apart = targets.numbers.size() / LEVELS as u64;
        let number =
            wgpu::BufferBinding { buffer: &targets.numbers, offset: 0, size: std::num::NonZeroU64::new(16) };
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("reconstruction"),
            layout: &self.layout,
            entries: &[
                entry(0, targets.uniform.as_entire_binding()),
                entry(1, wgpu::BindingResource::TextureView(&objects)),
                entry(2, wgpu::BindingResource::TextureView(&depths)),
                entry(3, splats.ranks.as_entire_binding()),
                entry(4, splats.details.as_entire_binding()),
                entry(5, splats.colors.as_entire_binding()),
                entry(6, splats.guides.as_entire_binding()),
                entry(7, shown.as_entire_binding()),
                entry(8, targets.cells.as_entire_binding()),
                entry(9, wgpu::BindingResource::Buffer(number)),
            ],
        });
        let mut pass = encoder.begin_compute_pass(&Default::default());
        let mut run = |pipeline: &wgpu::ComputePipeline, [width, height]: [u32; 2], n: usize| {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &bind_group, &[(n as u64 * apart) as u32]);
            pass.dispatch_workgroups(width.div_ceil(WORKGROUP), height, 1);
        };
        if targets.is_smooth {
            let of: Vec<[u32; 2]> = levels(targets.size).0.iter().map(|&[w, h, ..]| [w, h]).collect();
            of.iter().enumerate().for_each(|(n, &size)| run(&self.pull, size, n));
            of.iter().enumerate().rev().for_each(|(n, &size)| run(&self.push, size, n));
        }
        run(&self.reconstruct, targets.size, 0);
    }
}

fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let kinds = [
        buffer(wgpu::BufferBindingType::Uniform),
        texture(wgpu::TextureSampleType::Uint),
        texture(wgpu::TextureSampleType::Float { filterable: false }),
        storage(true),
        storage(true),
        storage(true),
        storage(true),
        storage(false),
        storage(false),
        wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: std::num::NonZeroU64::new(16),
        },
    ];
    bind_group_layout(device, "reconstruction", wgpu::ShaderStages::COMPUTE, kinds)
}
