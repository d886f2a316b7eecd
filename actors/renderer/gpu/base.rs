//! The pass that draws the base layer and its buffers. Twin of `foveal::display`.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use foveal::illumination::Irradiance;
use foveal::scene::camera::CameraFrame;
use foveal::scene::{Environment, Scene};
use glam::{Vec3, Vec4};

use super::adapter::Gpu;
use super::geometry::{BaseGeometry, BaseLight, Run};
use super::textures::{self, Textures};

/// Linear radiance of both layers.
pub const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Depth along the view axis, infinite on a miss.
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Object ids, texture levels and triangles.
pub const WORD: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// What the rasteriser compares: near / depth.
const INVERSE_DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// The buffers of one view.
#[derive(Debug)]
pub struct BaseTargets {
    /// Columns and rows.
    pub size: [u32; 2],
    /// Linear radiance.
    pub color: wgpu::Texture,
    /// Depth along the view axis.
    pub depth: wgpu::Texture,
    /// Object ids.
    pub object: wgpu::Texture,
    /// Texture and mip level wanted, as `foveal::display::TextureLevel`.
    pub texture: wgpu::Texture,
    /// Triangle seen, `u32::MAX` on a miss.
    pub triangle: wgpu::Texture,
    inverse_depth: wgpu::Texture,
}

impl BaseTargets {
    /// Buffers for pictures of `size`, at least 1 × 1.
    pub fn new(gpu: &Gpu, size: [u32; 2]) -> Self {
        let size = size.map(|s| s.clamp(1, gpu.device.limits().max_texture_dimension_2d));
        Self {
            size,
            color: gpu.target("base color", size, COLOR),
            depth: gpu.target("depth", size, DEPTH),
            object: gpu.target("object", size, WORD),
            texture: gpu.target("texture level", size, WORD),
            triangle: gpu.target("triangle", size, WORD),
            inverse_depth: gpu.target("inverse depth", size, INVERSE_DEPTH),
        }
    }
}

/// The `View` of `base.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ViewRecord {
    clip_from_world: [[f32; 4]; 4],
    eye: [f32; 4],
    forward: [f32; 4],
    right: [f32; 4],
    up: [f32; 4],
    sizes: [u32; 4],
    flags: [u32; 4],
    environment_radiance: [f32; 4],
    environment_rows: [[f32; 4]; 3],
    pixel: [f32; 4],
}

/// A scene on the adapter.
#[derive(Debug)]
pub struct BaseScene {
    scene: Arc<Scene>,
    geometry: BaseGeometry,
    lightmap: [u32; 2],
    back_is_lit: bool,
    has_map: bool,
    /// How the light of the triangles is stored, to know whether new values fit.
    layout: Vec<foveal::illumination::atlas::Corners>,
    view: wgpu::Buffer,
    positions: wgpu::Buffer,
    records: wgpu::Buffer,
    materials: wgpu::Buffer,
    front: wgpu::Buffer,
    back: wgpu::Buffer,
    environment: wgpu::TextureView,
    bind_group: wgpu::BindGroup,
    runs: Vec<wgpu::BindGroup>,
}

/// The pipelines of the pass.
#[derive(Debug)]
pub struct BasePass {
    surfaces: wgpu::RenderPipeline,
    masked_surfaces: wgpu::RenderPipeline,
    background: wgpu::RenderPipeline,
    scene_layout: wgpu::BindGroupLayout,
    textures_layout: wgpu::BindGroupLayout,
}

impl BasePass {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("base.wgsl"));
        let scene_layout = scene_layout(device);
        let textures_layout = Textures::layout(gpu);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("base"),
            bind_group_layouts: &[Some(&scene_layout), Some(&textures_layout)],
            ..Default::default()
        });
        let formats = [COLOR, DEPTH, WORD, WORD, WORD];
        let pipeline = |vertex, fragment, buffers: &[_], is_surface: bool, is_masked: bool| {
            let targets: Vec<_> = formats
                .iter()
                .enumerate()
                .map(|(i, format)| {
                    let write_mask = if is_surface || i == 0 {
                        wgpu::ColorWrites::ALL
                    } else {
                        wgpu::ColorWrites::empty()
                    };
                    Some(wgpu::ColorTargetState { format: *format, blend: None, write_mask })
                })
                .collect();
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(vertex),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: Default::default(),
                    buffers,
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: INVERSE_DEPTH,
                    depth_write_enabled: Some(is_surface),
                    // Of two surfaces in one place the first drawn stays; the background goes where
                    // nothing is.
                    depth_compare: Some(if is_surface {
                        wgpu::CompareFunction::Greater
                    } else {
                        wgpu::CompareFunction::GreaterEqual
                    }),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &[("MASKED", f64::from(u8::from(is_masked)))],
                        ..Default::default()
                    },
                    targets: &targets,
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let corner = wgpu::VertexBufferLayout {
            array_stride: 12,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3],
        };
        Self {
            surfaces: pipeline("vertex", "fragment", &[Some(corner.clone())], true, false),
            masked_surfaces: pipeline("vertex", "fragment", &[Some(corner)], true, true),
            background: pipeline("background_vertex", "background_fragment", &[], false, false),
            scene_layout,
            textures_layout,
        }
    }

    /// Puts a scene and its light on the adapter.
    pub fn upload(&self, gpu: &Gpu, scene: Arc<Scene>, illumination: &dyn Irradiance) -> BaseScene {
        let light = BaseLight::new(&scene.mesh, illumination);
        let geometry = BaseGeometry::new(&scene, &light);
        let textures = Textures::new(gpu, &scene.textures);
        let environment = textures::environment(gpu, scene.environment.as_ref().and_then(|e| e.map.as_ref()));
        let storage = wgpu::BufferUsages::STORAGE;
        let view = gpu.buffer("view", bytemuck::bytes_of(&ViewRecord::zeroed()), wgpu::BufferUsages::UNIFORM);
        let records = gpu.buffer("triangles", bytemuck::cast_slice(&geometry.triangles), storage);
        let materials = gpu.buffer("materials", bytemuck::cast_slice(&geometry.materials), storage);
        let front = gpu.buffer("front light", bytemuck::cast_slice(&light.front), storage);
        let back = gpu.buffer("back light", bytemuck::cast_slice(&light.back), storage);
        let bind_group = self.bind_scene(gpu, [&view, &records, &materials, &front, &back], &environment);
        BaseScene {
            positions: gpu.buffer(
                "positions",
                bytemuck::cast_slice(&geometry.positions),
                wgpu::BufferUsages::VERTEX,
            ),
            runs: geometry
                .runs
                .iter()
                .map(|run: &Run| textures.bind_group(gpu, &self.textures_layout, &run.textures))
                .collect(),
            lightmap: light.lightmap,
            back_is_lit: !light.back.is_empty(),
            has_map: scene.environment.as_ref().is_some_and(|e| e.map.is_some()),
            layout: light.corners,
            scene,
            geometry,
            view,
            records,
            materials,
            front,
            back,
            environment,
            bind_group,
        }
    }

    /// Replaces the light: only its values where they are stored as before.
    pub fn update_light(&self, gpu: &Gpu, base: &mut BaseScene, illumination: &dyn Irradiance) {
        let light = BaseLight::new(&base.scene.mesh, illumination);
        let (front, back) = (bytemuck::cast_slice(&light.front), bytemuck::cast_slice(&light.back));
        let storage = wgpu::BufferUsages::STORAGE;
        let fits = |buffer: &wgpu::Buffer, bytes: &[u8]| buffer.size() >= bytes.len() as u64;
        if light.corners != base.layout {
            base.geometry = BaseGeometry::new(&base.scene, &light);
            base.records = gpu.buffer("triangles", bytemuck::cast_slice(&base.geometry.triangles), storage);
        } else if fits(&base.front, front) && fits(&base.back, back) {
            gpu.queue.write_buffer(&base.front, 0, front);
            if !back.is_empty() {
                gpu.queue.write_buffer(&base.back, 0, back);
            }
            base.back_is_lit = !back.is_empty();
            return;
        }
        base.front = gpu.buffer("front light", front, storage);
        base.back = gpu.buffer("back light", back, storage);
        base.lightmap = light.lightmap;
        base.back_is_lit = !back.is_empty();
        base.layout = light.corners;
        let buffers = [&base.view, &base.records, &base.materials, &base.front, &base.back];
        base.bind_group = self.bind_scene(gpu, buffers, &base.environment);
    }

    fn bind_scene(
        &self,
        gpu: &Gpu,
        buffers: [&wgpu::Buffer; 5],
        environment: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        let mut entries: Vec<wgpu::BindGroupEntry<'_>> = buffers
            .iter()
            .enumerate()
            .map(|(i, b)| wgpu::BindGroupEntry { binding: i as u32, resource: b.as_entire_binding() })
            .collect();
        entries.push(wgpu::BindGroupEntry {
            binding: 5,
            resource: wgpu::BindingResource::TextureView(environment),
        });
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &self.scene_layout,
            entries: &entries,
        })
    }

    /// Records the drawing of `base` as `frame` sees it. Returns how many triangles were not cut off.
    pub fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        base: &BaseScene,
        targets: &BaseTargets,
        frame: &CameraFrame,
    ) -> u32 {
        gpu.queue.write_buffer(&base.view, 0, bytemuck::bytes_of(&view_record(base, targets.size, frame)));
        let views = [&targets.color, &targets.depth, &targets.object, &targets.texture, &targets.triangle]
            .map(|t| t.create_view(&Default::default()));
        let clear = [0.0, f64::INFINITY, 0.0, f64::from(u32::MAX), f64::from(u32::MAX)];
        let attachments: Vec<_> = views
            .iter()
            .zip(clear)
            .map(|(view, r)| {
                let color = wgpu::Color { r, g: 0.0, b: 0.0, a: 0.0 };
                Some(wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: wgpu::LoadOp::Clear(color), store: wgpu::StoreOp::Store },
                })
            })
            .collect();
        let inverse_depth = targets.inverse_depth.create_view(&Default::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("base"),
            color_attachments: &attachments,
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &inverse_depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_bind_group(0, &base.bind_group, &[]);
        pass.set_vertex_buffer(0, base.positions.slice(..));
        let mut drawn = 0;
        let mut bound = None;
        base.geometry.visible(frame, |run, range| {
            if bound != Some(run) {
                let is_masked = base.geometry.runs[run].masked;
                pass.set_pipeline(if is_masked { &self.masked_surfaces } else { &self.surfaces });
                pass.set_bind_group(1, &base.runs[run], &[]);
                bound = Some(run);
            }
            drawn += range.end - range.start;
            pass.draw(3 * range.start..3 * range.end, 0..1);
        });
        if let (Some(textures), true) = (base.runs.first(), base.scene.environment.is_some()) {
            pass.set_pipeline(&self.background);
            pass.set_bind_group(1, textures, &[]);
            pass.draw(0..3, 0..1);
        }
        drawn
    }
}

fn scene_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let both = wgpu::ShaderStages::VERTEX_FRAGMENT;
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let storage = buffer(wgpu::BufferBindingType::Storage { read_only: true });
    let texture = wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable: false },
        view_dimension: wgpu::TextureViewDimension::D2,
        multisampled: false,
    };
    let kinds = [
        (both, buffer(wgpu::BufferBindingType::Uniform)),
        (wgpu::ShaderStages::FRAGMENT, storage),
        (wgpu::ShaderStages::FRAGMENT, storage),
        (wgpu::ShaderStages::FRAGMENT, storage),
        (wgpu::ShaderStages::FRAGMENT, storage),
        (wgpu::ShaderStages::FRAGMENT, texture),
    ];
    let entries: Vec<_> = kinds
        .into_iter()
        .enumerate()
        .map(|(i, (visibility, ty))| wgpu::BindGroupLayoutEntry {
            binding: i as u32,
            visibility,
            ty,
            count: None,
        })
        .collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("scene"),
        entries: &entries,
    })
}

fn view_record(base: &BaseScene, size: [u32; 2], frame: &CameraFrame) -> ViewRecord {
    let wide = |v: Vec3| v.extend(0.0).to_array();
    // Inverse depth: near / depth keeps its relative precision at any distance, so near can be tiny.
    let near = base.scene.diagonal() * 1e-5;
    let mut clip_from_world = frame.clip_from_world(near);
    for column in 0..4 {
        clip_from_world.col_mut(column).z = 0.0;
    }
    clip_from_world.w_axis.z = near;
    let environment = base.scene.environment.as_ref();
    ViewRecord {
        clip_from_world: clip_from_world.to_cols_array_2d(),
        eye: wide(frame.eye),
        forward: wide(frame.forward),
        right: wide(frame.right),
        up: wide(frame.up),
        sizes: [size[0], size[1], base.lightmap[0], base.lightmap[1]],
        flags: [u32::from(base.back_is_lit) | (u32::from(base.has_map) << 1), 0, 0, 0],
        environment_radiance: environment
            .map_or(Vec4::ZERO, |e| e.radiance.extend(e.rotate_up / std::f32::consts::TAU))
            .to_array(),
        environment_rows: environment.map_or([Vec3::ZERO; 3], environment_axes).map(wide),
        pixel: [frame.pixel_angle(), 0.0, 0.0, 0.0],
    }
}

/// The axes of the environment's frame, in which +y is up, in the world.
fn environment_axes(environment: &Environment) -> [Vec3; 3] {
    let unturned = Environment { rotate_up: 0.0, ..Environment::constant(Vec3::ONE) };
    let unturned = Environment { up: environment.up, ..unturned };
    [unturned.direction([0.25, 0.5]), unturned.direction([0.0, 0.0]), -unturned.direction([0.0, 0.5])]
}
