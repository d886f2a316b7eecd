//! The pass that joins both layers into the picture that is shown. Twin of `foveal::display::tone`
//! and of `renderer::overlay`.

use bytemuck::{Pod, Zeroable};
use foveal::display::tone::{ToneCurve, ToneMap};

use super::adapter::Gpu;
use super::base::BaseTargets;
use super::splat::SplatTargets;
use crate::renderer::overlay::Overlay;

/// The picture's format: sRGB-encoded values, not decoded when read.
pub const PICTURE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ComposeRecord {
    white: f32,
    exposure: f32,
    overlay: u32,
    k_max: u32,
}

/// The pipeline.
#[derive(Debug)]
pub struct ComposePass {
    pipeline: wgpu::RenderPipeline,
    layout: wgpu::BindGroupLayout,
    uniform: wgpu::Buffer,
    values: wgpu::Buffer,
}

impl ComposePass {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("compose.wgsl"));
        let layout = compose_layout(device);
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("compose"),
            bind_group_layouts: &[Some(&layout)],
            ..Default::default()
        });
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("compose"),
            layout: Some(&pipeline_layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("vertex"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("fragment"),
                compilation_options: Default::default(),
                targets: &[Some(PICTURE.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let uniform =
            gpu.buffer("compose", bytemuck::bytes_of(&ComposeRecord::zeroed()), wgpu::BufferUsages::UNIFORM);
        let values = gpu.buffer("overlay values", &[], wgpu::BufferUsages::STORAGE);
        Self { pipeline, layout, uniform, values }
    }

    /// Replaces what overlays show of objects or textures: `Sources::values`.
    pub fn set_values(&mut self, gpu: &Gpu, values: &[f32]) {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        if self.values.size() == bytes.len() as u64 {
            gpu.queue.write_buffer(&self.values, 0, bytes);
        } else {
            self.values = gpu.buffer("overlay values", bytes, wgpu::BufferUsages::STORAGE);
        }
    }

    /// Records the drawing of the picture.
    #[expect(clippy::too_many_arguments, reason = "one pass, its inputs and its output")]
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        base: &BaseTargets,
        splats: &SplatTargets,
        picture: &wgpu::Texture,
        tone: &ToneMap,
        overlay: Overlay,
    ) {
        let record = ComposeRecord {
            white: match tone.curve {
                ToneCurve::Clamp => -1.0,
                ToneCurve::Reinhard { white } => white.max(0.0),
            },
            exposure: tone.exposure,
            overlay: overlay as u32,
            k_max: splats.k_max(),
        };
        gpu.queue.write_buffer(&self.uniform, 0, bytemuck::bytes_of(&record));
        let views = [&base.color, &splats.color, &splats.rank, &base.object, &base.texture]
            .map(|t| t.create_view(&Default::default()));
        let mut entries =
            vec![wgpu::BindGroupEntry { binding: 0, resource: self.uniform.as_entire_binding() }];
        entries.extend(views.iter().enumerate().map(|(i, view)| wgpu::BindGroupEntry {
            binding: i as u32 + 1,
            resource: wgpu::BindingResource::TextureView(view),
        }));
        entries.push(wgpu::BindGroupEntry { binding: 6, resource: self.values.as_entire_binding() });
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("compose"),
            layout: &self.layout,
            entries: &entries,
        });
        let target = picture.create_view(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("compose"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn compose_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let texture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let float = texture(wgpu::TextureSampleType::Float { filterable: false });
    let kinds = [
        buffer(wgpu::BufferBindingType::Uniform),
        float,
        float,
        texture(wgpu::TextureSampleType::Depth),
        texture(wgpu::TextureSampleType::Uint),
        texture(wgpu::TextureSampleType::Uint),
        buffer(wgpu::BufferBindingType::Storage { read_only: true }),
    ];
    let entries: Vec<_> = kinds
        .into_iter()
        .enumerate()
        .map(|(i, ty)| wgpu::BindGroupLayoutEntry {
            binding: i as u32,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("compose"),
        entries: &entries,
    })
}
