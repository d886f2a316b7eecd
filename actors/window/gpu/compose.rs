//! The pass that joins both layers into the picture that is shown. The CPU pass is `foveal::display::tone`
//! and of `renderer::overlay`.

use bytemuck::{Pod, Zeroable};
use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::sampling::Rect;
use glam::Vec3;

use super::adapter::Gpu;
use super::base::{BaseTargets, COLOR};
use super::layout::{bind_group_layout, buffer, storage, texture};
use super::splat::SplatTargets;
use super::textures::half_bits;
use foveal_actors::renderer::overlay::Overlay;

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
    /// Without and with an overlay.
    pipelines: [wgpu::RenderPipeline; 2],
    layout: wgpu::BindGroupLayout,
}

/// What is composed, beside the layers, and the picture.
#[derive(Debug)]
pub struct ComposeTargets {
    /// The picture: sRGB-encoded bytes.
    pub picture: wgpu::Texture,
    /// Linear radiance of pixels that are refined, and 1 + the error that overlays show; alpha is 0 elsewhere.
    refined: wgpu::Texture,
    is_refined: bool,
    clear: bool,
    uniform: wgpu::Buffer,
    values: wgpu::Buffer,
}

impl ComposeTargets {
    /// For pictures of `size`, at least 1 × 1.
    pub fn new(gpu: &Gpu, size: [u32; 2]) -> Self {
        let uniform =
            gpu.buffer("compose", bytemuck::bytes_of(&ComposeRecord::zeroed()), wgpu::BufferUsages::UNIFORM);
        Self {
            picture: gpu.target("picture", size, PICTURE),
            refined: gpu.target_with("refined", size, COLOR, wgpu::TextureUsages::COPY_DST),
            is_refined: false,
            clear: true,
            uniform,
            values: gpu.buffer("overlay values", &[], wgpu::BufferUsages::STORAGE),
        }
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

    /// No pixel is refined any more.
    pub fn clear(&mut self) {
        self.clear |= self.is_refined;
        self.is_refined = false;
    }

    /// Pixels that show this radiance, row by row, and the error that overlays show of them.
    pub fn refine(&mut self, gpu: &Gpu, rect: Rect, radiance: &[Vec3], error: f32) {
        if std::mem::take(&mut self.clear) {
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            let view = self.refined.create_view(&Default::default());
            encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("nothing is refined"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            gpu.queue.submit([encoder.finish()]);
        }
        self.is_refined = true;
        let (width, height) = ((rect.x1 - rect.x0) as u32, (rect.y1 - rect.y0) as u32);
        if width * height == 0 || radiance.len() != (width * height) as usize {
            return;
        }
        let texels: Vec<[u16; 4]> =
            radiance.iter().map(|r| r.extend(1.0 + error).to_array().map(half_bits)).collect();
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &self.refined,
                mip_level: 0,
                origin: wgpu::Origin3d { x: rect.x0 as u32, y: rect.y0 as u32, z: 0 },
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(&texels),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(width * 8), rows_per_image: None },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
    }
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
        let pipeline = |is_overlaid: bool| {
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
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
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &[("OVERLAID", f64::from(u8::from(is_overlaid)))],
                        ..Default::default()
                    },
                    targets: &[Some(PICTURE.into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        Self { pipelines: [false, true].map(pipeline), layout }
    }

    /// Records the drawing of the picture. `shown`: the colours of the splat layer, with what lies between its samples.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (base, splats, shown): (&BaseTargets, &SplatTargets, &wgpu::Buffer),
        targets: &mut ComposeTargets,
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
            k_max: splats.k_max() | (u32::from(targets.is_refined) << 31),
        };
        gpu.queue.write_buffer(&targets.uniform, 0, bytemuck::bytes_of(&record));
        let views = [&base.color, &base.object, &base.texture, &targets.refined]
            .map(|t| t.create_view(&Default::default()));
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let texture = |i: usize| wgpu::BindingResource::TextureView(&views[i]);
        let entries = [
            entry(0, targets.uniform.as_entire_binding()),
            entry(1, texture(0)),
            entry(2, shown.as_entire_binding()),
            entry(3, splats.ranks.as_entire_binding()),
            entry(4, texture(1)),
            entry(5, texture(2)),
            entry(6, texture(3)),
            entry(7, targets.values.as_entire_binding()),
        ];
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("compose"),
            layout: &self.layout,
            entries: &entries,
        });
        let target = targets.picture.create_view(&Default::default());
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
        pass.set_pipeline(&self.pipelines[usize::from(overlay != Overlay::None)]);
        pass.set_bind_group(0, &bind_group, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn compose_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let float = texture(wgpu::TextureSampleType::Float { filterable: false });
    let kinds = [
        buffer(wgpu::BufferBindingType::Uniform),
        float,
        storage(true),
        storage(true),
        texture(wgpu::TextureSampleType::Uint),
        texture(wgpu::TextureSampleType::Uint),
        float,
        storage(true),
    ];
    bind_group_layout(device, "compose", wgpu::ShaderStages::FRAGMENT, kinds)
}
