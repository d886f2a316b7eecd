//! The pass that draws the base layer and its buffers. The CPU pass is `foveal::display`.

mod view;

use std::sync::Arc;

use bytemuck::Zeroable;
use foveal::illumination::Irradiance;
use foveal::scene::Scene;
use foveal::scene::camera::CameraFrame;

use super::adapter::{Gpu, flat_texture};
use super::geometry::{self, BaseGeometry, BaseLight, Run};
use super::rows::{RECORDS, Rows};
use super::textures::{self, Textures};

use view::ViewRecord;

/// Linear radiance of both layers.
pub const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Depth along the view axis, infinite on a miss.
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Object ids, texture levels and triangles.
pub const WORD: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// What is known of a pixel: colour, depth, object, texture level.
const SHADED: [wgpu::TextureFormat; 4] = [COLOR, DEPTH, WORD, WORD];
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
    /// Triangle seen, counted in draw order; `u32::MAX` on a miss.
    pub visible: wgpu::Texture,
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
            visible: gpu.target("visible triangles", size, WORD),
            inverse_depth: gpu.target("inverse depth", size, INVERSE_DEPTH),
        }
    }
}

/// A scene on the adapter.
#[derive(Debug)]
pub struct BaseScene {
    scene: Arc<Scene>,
    geometry: BaseGeometry,
    textures: Textures,
    lightmap: [u32; 2],
    back_is_lit: bool,
    has_map: bool,
    /// How the light of the triangles is stored, to know whether new values fit.
    layout: Vec<foveal::illumination::atlas::Corners>,
    view: wgpu::Buffer,
    positions: wgpu::Buffer,
    triangles: Rows,
    materials: Rows,
    light: Rows,
    /// What light on the adapter is divided by, since halves end at 65504.
    light_unit: f32,
    /// Elements of one side.
    elements: u32,
    environment: wgpu::TextureView,
    bind_group: wgpu::BindGroup,
    runs: Vec<wgpu::BindGroup>,
    /// First triangle of each run and the one after its last.
    ranges: wgpu::Buffer,
}

impl BaseScene {
    /// The scene, with the levels of textures that are held.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The triangle of the scene that a number in [`BaseTargets::visible`] stands for.
    pub fn triangle(&self, visible: u32) -> Option<u32> {
        self.geometry.triangles.get(visible as usize).map(|t| t.triangle)
    }

    /// Bytes that textures take on the adapter.
    pub fn texture_bytes(&self) -> u64 {
        self.textures.bytes()
    }
}

/// The pipelines of the pass.
#[derive(Debug)]
pub struct BasePass {
    /// Which triangle is seen; where none of its pixels can be left out, and where some may be.
    visible: [wgpu::RenderPipeline; 2],
    /// What it looks like; without textures, and with some.
    shade: [wgpu::RenderPipeline; 2],
    background: wgpu::RenderPipeline,
    scene_layout: wgpu::BindGroupLayout,
    textures_layout: wgpu::BindGroupLayout,
    visible_layout: wgpu::BindGroupLayout,
}

/// How one of the pipelines differs from the others.
struct Stages<'a> {
    vertex: &'a str,
    fragment: &'a str,
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    targets: &'a [wgpu::TextureFormat],
    /// The first of them, which it writes.
    written: usize,
    depth: Option<wgpu::DepthStencilState>,
    textured: bool,
}

impl BasePass {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Self {
        let device = &gpu.device;
        let module = device.create_shader_module(wgpu::include_wgsl!("base.wgsl"));
        let scene_layout = scene_layout(gpu);
        let textures_layout = Textures::layout(gpu);
        let visible_layout = visible_layout(gpu);
        let layout_of = |groups: &[Option<&wgpu::BindGroupLayout>]| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("base"),
                bind_group_layouts: groups,
                ..Default::default()
            })
        };
        let first = layout_of(&[Some(&scene_layout), Some(&textures_layout)]);
        let second = layout_of(&[Some(&scene_layout), Some(&textures_layout), Some(&visible_layout)]);
        let pipeline = |layout: &wgpu::PipelineLayout, stages: Stages<'_>| {
            let target = |(i, format): (usize, &_)| {
                let is_written = i < stages.written;
                let write_mask = if is_written { wgpu::ColorWrites::ALL } else { wgpu::ColorWrites::empty() };
                Some(wgpu::ColorTargetState { format: *format, blend: None, write_mask })
            };
            let targets: Vec<_> = stages.targets.iter().enumerate().map(target).collect();
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(stages.fragment),
                layout: Some(layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(stages.vertex),
                    compilation_options: Default::default(),
                    buffers: stages.buffers,
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: stages.depth,
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(stages.fragment),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &[("TEXTURED", f64::from(u8::from(stages.textured)))],
                        ..Default::default()
                    },
                    targets: &targets,
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let corner = Some(wgpu::VertexBufferLayout {
            array_stride: 12,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3],
        });
        let range = Some(wgpu::VertexBufferLayout {
            array_stride: 8,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &wgpu::vertex_attr_array![0 => Uint32x2],
        });
        // Of two surfaces in one place the first drawn stays.
        let depth = Some(wgpu::DepthStencilState {
            format: INVERSE_DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        });
        let visible = |fragment| Stages {
            vertex: "vertex",
            fragment,
            buffers: std::slice::from_ref(&corner),
            targets: &[WORD],
            written: 1,
            depth: depth.clone(),
            textured: true,
        };
        let shade = |textured| Stages {
            vertex: "run_vertex",
            fragment: "shade",
            buffers: std::slice::from_ref(&range),
            targets: &SHADED,
            written: SHADED.len(),
            depth: None,
            textured,
        };
        let background = Stages {
            vertex: "background_vertex",
            fragment: "background",
            buffers: &[],
            targets: &SHADED,
            written: 1,
            depth: None,
            textured: true,
        };
        Self {
            visible: ["visible", "visible_through_mask"].map(|f| pipeline(&first, visible(f))),
            shade: [false, true].map(|textured| pipeline(&second, shade(textured))),
            background: pipeline(&second, background),
            scene_layout,
            textures_layout,
            visible_layout,
        }
    }

    /// Puts a scene and its light on the adapter.
    pub fn upload(&self, gpu: &Gpu, scene: Arc<Scene>, illumination: &dyn Irradiance) -> BaseScene {
        let light = BaseLight::new(&scene.mesh, illumination);
        let geometry = BaseGeometry::new(&scene, &light);
        let textures = Textures::new(gpu, &scene.textures);
        let materials = geometry::materials(&scene, &textures.firsts());
        let environment = textures::environment(gpu, scene.environment.as_ref().and_then(|e| e.map.as_ref()));
        let view = gpu.buffer("view", bytemuck::bytes_of(&ViewRecord::zeroed()), wgpu::BufferUsages::UNIFORM);
        let triangles = Rows::new(gpu, "triangles", RECORDS, bytemuck::cast_slice(&geometry.triangles));
        let materials = Rows::new(gpu, "materials", RECORDS, bytemuck::cast_slice(&materials));
        let (texels, light_unit) = light_texels(&light);
        let light_rows = Rows::new(gpu, "light", COLOR, bytemuck::cast_slice(&texels));
        let positions: Vec<[[f32; 3]; 3]> = geometry.triangles.iter().map(|t| [t.a, t.b, t.c]).collect();
        let ranges: Vec<[u32; 2]> = geometry.runs.iter().map(|run| [run.first, run.end]).collect();
        let vertex = wgpu::BufferUsages::VERTEX;
        let bind_group = self.bind_scene(gpu, &view, [&triangles, &materials, &light_rows], &environment);
        BaseScene {
            positions: gpu.buffer("positions", bytemuck::cast_slice(&positions), vertex),
            ranges: gpu.buffer("runs", bytemuck::cast_slice(&ranges), vertex),
            runs: self.bind_runs(gpu, &geometry, &textures),
            lightmap: light.lightmap,
            back_is_lit: !light.back.is_empty(),
            has_map: scene.environment.as_ref().is_some_and(|e| e.map.is_some()),
            elements: light.front.len() as u32,
            layout: light.corners,
            scene,
            geometry,
            textures,
            view,
            triangles,
            materials,
            light: light_rows,
            light_unit,
            environment,
            bind_group,
        }
    }

    fn bind_runs(&self, gpu: &Gpu, geometry: &BaseGeometry, textures: &Textures) -> Vec<wgpu::BindGroup> {
        let bind = |run: &Run| textures.bind_group(gpu, &self.textures_layout, &run.textures);
        geometry.runs.iter().map(bind).collect()
    }

    /// Takes the same scene with other levels of its textures in memory; the old one is let go.
    pub fn update_textures(&self, gpu: &Gpu, base: &mut BaseScene, scene: &Arc<Scene>) {
        base.scene = Arc::clone(scene);
        if base.textures.update(gpu, &scene.textures) {
            let materials = geometry::materials(scene, &base.textures.firsts());
            base.materials.write(gpu, bytemuck::cast_slice(&materials));
            base.runs = self.bind_runs(gpu, &base.geometry, &base.textures);
        }
    }

    /// Replaces the light: only its values where they are stored as before.
    pub fn update_light(&self, gpu: &Gpu, base: &mut BaseScene, illumination: &dyn Irradiance) {
        let light = BaseLight::new(&base.scene.mesh, illumination);
        let (texels, unit) = light_texels(&light);
        let mut is_new = false;
        if light.corners != base.layout {
            base.geometry = BaseGeometry::new(&base.scene, &light);
            base.triangles.write(gpu, bytemuck::cast_slice(&base.geometry.triangles));
            base.layout = light.corners;
        }
        if base.light.holds(texels.len()) {
            base.light.write(gpu, bytemuck::cast_slice(&texels));
        } else {
            base.light = Rows::new(gpu, "light", COLOR, bytemuck::cast_slice(&texels));
            is_new = true;
        }
        base.light_unit = unit;
        base.elements = light.front.len() as u32;
        base.lightmap = light.lightmap;
        base.back_is_lit = !light.back.is_empty();
        if is_new {
            let rows = [&base.triangles, &base.materials, &base.light];
            base.bind_group = self.bind_scene(gpu, &base.view, rows, &base.environment);
        }
    }

    fn bind_scene(
        &self,
        gpu: &Gpu,
        view: &wgpu::Buffer,
        rows: [&Rows; 3],
        environment: &wgpu::TextureView,
    ) -> wgpu::BindGroup {
        let mut entries = vec![wgpu::BindGroupEntry { binding: 0, resource: view.as_entire_binding() }];
        let views = rows.into_iter().map(|rows| &rows.view).chain([environment]);
        entries.extend(views.zip(1..).map(|(view, binding)| wgpu::BindGroupEntry {
            binding,
            resource: wgpu::BindingResource::TextureView(view),
        }));
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
        gpu.queue.write_buffer(
            &base.view,
            0,
            bytemuck::bytes_of(&ViewRecord::new(base, targets.size, frame)),
        );
        let visible = targets.visible.create_view(&Default::default());
        let (drawn, runs) = self.draw_visible(encoder, base, targets, &visible, frame);
        let visible = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("visible triangles"),
            layout: &self.visible_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&visible),
            }],
        });
        self.shade(encoder, base, targets, &visible, &runs);
        drawn
    }

    /// Which triangle each pixel shows. Returns how many were drawn, and the runs that have some among them.
    fn draw_visible(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        base: &BaseScene,
        targets: &BaseTargets,
        visible: &wgpu::TextureView,
        frame: &CameraFrame,
    ) -> (u32, Vec<usize>) {
        let inverse_depth = targets.inverse_depth.create_view(&Default::default());
        let none = f64::from(u32::MAX);
        let mut pass = color_pass(encoder, "visible triangles", &[(visible, none)], Some(&inverse_depth));
        pass.set_bind_group(0, &base.bind_group, &[]);
        pass.set_vertex_buffer(0, base.positions.slice(..));
        let (mut drawn, mut runs) = (0, Vec::new());
        base.geometry.visible(frame, |run, range| {
            if runs.last() != Some(&run) {
                pass.set_pipeline(&self.visible[usize::from(base.geometry.runs[run].masked)]);
                pass.set_bind_group(1, &base.runs[run], &[]);
                runs.push(run);
            }
            drawn += range.end - range.start;
            pass.draw(3 * range.start..3 * range.end, 0..1);
        });
        (drawn, runs)
    }

    /// What the visible triangles look like.
    fn shade(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        base: &BaseScene,
        targets: &BaseTargets,
        visible: &wgpu::BindGroup,
        runs: &[usize],
    ) {
        let views = [&targets.color, &targets.depth, &targets.object, &targets.texture]
            .map(|t| t.create_view(&Default::default()));
        let clear = [0.0, f64::INFINITY, 0.0, f64::from(u32::MAX)];
        let attachments: Vec<_> = views.iter().zip(clear).collect();
        let mut pass = color_pass(encoder, "shade", &attachments, None);
        pass.set_bind_group(0, &base.bind_group, &[]);
        pass.set_bind_group(2, visible, &[]);
        pass.set_vertex_buffer(0, base.ranges.slice(..));
        for &run in runs {
            pass.set_pipeline(&self.shade[usize::from(base.geometry.runs[run].textured)]);
            pass.set_bind_group(1, &base.runs[run], &[]);
            pass.draw(0..3, run as u32..run as u32 + 1);
        }
        if let (Some(textures), true) = (base.runs.first(), base.scene.environment.is_some()) {
            pass.set_pipeline(&self.background);
            pass.set_bind_group(1, textures, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// A pass that clears what it draws into: the red channel to the number beside each.
fn color_pass<'e>(
    encoder: &'e mut wgpu::CommandEncoder,
    label: &str,
    colors: &[(&wgpu::TextureView, f64)],
    depth: Option<&wgpu::TextureView>,
) -> wgpu::RenderPass<'e> {
    let attachments: Vec<_> = colors
        .iter()
        .map(|(view, r)| {
            let color = wgpu::Color { r: *r, g: 0.0, b: 0.0, a: 0.0 };
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(color), store: wgpu::StoreOp::Store },
            })
        })
        .collect();
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: &attachments,
        depth_stencil_attachment: depth.map(|view| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(0.0),
                store: wgpu::StoreOp::Discard,
            }),
            stencil_ops: None,
        }),
        ..Default::default()
    })
}

/// Irradiance of fronts and backs as halves, and what it was divided by to fit.
fn light_texels(light: &BaseLight) -> (Vec<[u16; 4]>, f32) {
    let all = || light.front.iter().chain(&light.back);
    let largest = all().flatten().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let unit = (largest / 60_000.0).max(1.0);
    let half = |[r, g, b]: &[f32; 3]| [r / unit, g / unit, b / unit, 0.0].map(textures::half_bits);
    (all().map(half).collect(), unit)
}

/// What the last pass reads of the first: the triangles seen.
fn visible_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let seen = flat_texture(wgpu::TextureSampleType::Uint);
    gpu.layout("visible triangles", &[(wgpu::ShaderStages::FRAGMENT, seen)])
}

/// The view, triangles, materials, light and the environment.
fn scene_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let view = wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let words = flat_texture(wgpu::TextureSampleType::Uint);
    let floats = flat_texture(wgpu::TextureSampleType::Float { filterable: false });
    let fragment = wgpu::ShaderStages::FRAGMENT;
    let entries = [
        (wgpu::ShaderStages::VERTEX_FRAGMENT, view),
        (fragment, words),
        (fragment, words),
        (fragment, floats),
        (fragment, floats),
    ];
    gpu.layout("scene", &entries)
}
