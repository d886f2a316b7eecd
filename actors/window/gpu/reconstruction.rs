//! What is shown between samples, on the adapter. The CPU pass is `foveal::splatting::reconstruction`.

use bytemuck::{Pod, Zeroable};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::Footprint;
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
    padding: [f32; 2],
}

/// The pipeline.
#[derive(Debug)]
pub struct ReconstructionPass {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// The splat layer of one picture with what lies between its samples.
#[derive(Debug)]
pub struct ReconstructionTargets {
    /// As [`SplatTargets::colors`]; none where that is shown as it is.
    shown: Option<wgpu::Buffer>,
    uniform: wgpu::Buffer,
    size: [u32; 2],
}

impl ReconstructionTargets {
    /// For pictures of `size`.
    pub fn new(gpu: &Gpu, size: [u32; 2], footprint: Footprint) -> Self {
        let bytes = u64::from(size[0]) * u64::from(size[1]) * 8;
        let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let is_linear = footprint == Footprint::Linear;
        Self {
            shown: is_linear.then(|| gpu.empty_buffer("reconstruction", bytes, storage)),
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
            ..ViewRecord::zeroed()
        };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&record));
    }

    /// What is shown of the splat layer: three halves of radiance, and as in [`SplatTargets::colors`] who traced it.
    pub fn shown<'a>(&'a self, splats: &'a SplatTargets) -> &'a wgpu::Buffer {
        self.shown.as_ref().unwrap_or(&splats.colors)
    }
}

impl ReconstructionPass {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("reconstruction.wgsl"));
        let layout = layout(device);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("reconstruction"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("reconstruction"),
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("reconstruct"),
            compilation_options: Default::default(),
            cache: None,
        });
        Self { pipeline, layout }
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
            ],
        });
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.dispatch_workgroups(targets.size[0].div_ceil(WORKGROUP), targets.size[1], 1);
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
    ];
    bind_group_layout(device, "reconstruction", wgpu::ShaderStages::COMPUTE, kinds)
}
