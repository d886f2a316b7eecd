//! Puts what egui painted onto a window: with a graphics adapter, or on the processor.

use std::num::NonZeroU32;
use std::sync::Arc;

use egui::TexturesDelta;
use egui::epaint::ClippedPrimitive;
use egui_wgpu::{Renderer, RendererOptions, ScreenDescriptor};
use winit::event_loop::OwnedDisplayHandle;
use winit::window::Window;

use super::painter::SoftwarePainter;
use crate::gpu::{AdapterInfo, Gpu, Mirror, adapter};

/// What to present with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// An adapter if there is one in hardware, else the processor: it paints a window in less of its time than software
    /// that does as if it were an adapter.
    #[default]
    Auto,
    /// An adapter, or fail.
    Gpu,
    /// The processor.
    Cpu,
}

/// Who draws the picture: base layer, splats, tone map. Actors decide by the processor's in any case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DrawnBy {
    /// The adapter that presents, if it is hardware; else the processor.
    #[default]
    Auto,
    /// The adapter that presents.
    Adapter,
    /// The processor.
    Processor,
}

/// One painted interface.
pub struct Painted<'a> {
    /// Triangles.
    pub primitives: &'a [ClippedPrimitive],
    /// Textures that changed.
    pub textures: &'a TexturesDelta,
    /// Pixels per point.
    pub pixels_per_point: f32,
}

/// How a presentation ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presented {
    /// It is on the window.
    Shown,
    /// Not now (the window is hidden or its surface changed); try again.
    Again,
    /// The presenter is of no use any more; make another.
    Lost,
}

/// Shows pictures on one window.
pub enum Presenter {
    /// With a graphics adapter.
    Gpu(Box<GpuPresenter>),
    /// On the processor.
    Cpu(Box<CpuPresenter>),
}

impl std::fmt::Display for Presenter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.adapter() {
            Some(adapter) if self.is_mirroring() => write!(f, "drawn and shown by {adapter}"),
            Some(adapter) => write!(f, "shown by {adapter}"),
            None => f.write_str("shown by the processor"),
        }
    }
}

impl Presenter {
    /// A presenter for `window`.
    ///
    /// # Errors
    /// Says what was tried and which package would help.
    pub fn new(
        window: &Arc<Window>,
        display: OwnedDisplayHandle,
        backend: Backend,
        drawn_by: DrawnBy,
    ) -> Result<Self, String> {
        if backend != Backend::Cpu {
            let wanted = |info: &AdapterInfo| {
                !info.software || backend == Backend::Gpu || drawn_by == DrawnBy::Adapter
            };
            // Once, also where it has to be opened again.
            static NAMED: std::sync::Once = std::sync::Once::new();
            match GpuPresenter::new(window, display.clone(), drawn_by, wanted) {
                Ok(Ok(presenter)) => {
                    let info = presenter.info();
                    NAMED.call_once(|| {
                        if info.software {
                            tracing::warn!("the graphics adapter is software: {info}");
                        } else {
                            tracing::info!("graphics adapter: {info}");
                        }
                    });
                    return Ok(Self::Gpu(Box::new(presenter)));
                }
                Ok(Err(info)) => NAMED.call_once(|| {
                    tracing::warn!("the graphics adapter is software: {info}; the processor shows pictures itself, which is faster");
                }),
                Err(e) if backend == Backend::Gpu => return Err(e),
                Err(e) => tracing::warn!("{e}; pictures are shown by the processor"),
            }
        }
        CpuPresenter::new(window, display).map(|p| Self::Cpu(Box::new(p)))
    }

    /// The adapter, if it is one.
    pub fn adapter(&self) -> Option<&AdapterInfo> {
        match self {
            Self::Gpu(p) => Some(p.info()),
            Self::Cpu(_) => None,
        }
    }

    /// Whether the adapter draws the picture by itself.
    pub fn is_mirroring(&self) -> bool {
        matches!(self, Self::Gpu(p) if p.mirror.is_wanted())
    }

    /// Compiles what draws the picture, where the adapter does and it is not compiled yet.
    pub fn prepare(&mut self) {
        if let Self::Gpu(p) = self {
            p.mirror.get(&p.gpu);
        }
    }

    /// Who draws the picture on the adapter.
    pub fn mirror(&mut self) -> Option<&mut Mirror> {
        match self {
            Self::Gpu(p) => p.mirror.get(&p.gpu),
            Self::Cpu(_) => None,
        }
    }

    /// The adapter cannot draw this picture: the processor does from now on.
    pub fn end_mirroring(&mut self) {
        if let Self::Gpu(p) = self {
            p.mirror = Mirroring::Off;
        }
    }

    /// What the adapter drew, as a texture of the interface with its columns and rows.
    pub fn mirrored(&mut self) -> Option<(egui::TextureId, [u32; 2])> {
        match self {
            Self::Gpu(p) => p.mirrored(),
            Self::Cpu(_) => None,
        }
    }

    /// As if the driver had failed; for tests of what follows.
    pub fn lose(&mut self) {
        if let Self::Gpu(p) = self {
            p.gpu.device.destroy();
        }
    }

    /// As if the window system had taken the surface back; for tests of what follows.
    pub fn lose_surface(&mut self) {
        if let Self::Gpu(p) = self {
            p.loses_surface = true;
        }
    }

    /// Largest side of a texture, texels.
    pub fn texture_side_max(&self) -> usize {
        match self {
            Self::Gpu(p) => p.gpu.device.limits().max_texture_dimension_2d as usize,
            Self::Cpu(_) => 16384,
        }
    }

    /// The window has another size now.
    pub fn resize(&mut self, size: [u32; 2]) {
        match self {
            Self::Gpu(p) => p.resize(size),
            Self::Cpu(p) => p.size = size,
        }
    }

    /// Shows what was painted.
    pub fn present(&mut self, painted: &Painted<'_>) -> Presented {
        match self {
            Self::Gpu(p) => p.present(painted),
            Self::Cpu(p) => p.present(painted),
        }
    }
}

/// Whether the adapter draws the picture by itself.
enum Mirroring {
    Off,
    /// Not compiled yet, since a window is to be seen first.
    Wanted,
    On(Box<Mirror>),
}

impl Mirroring {
    fn is_wanted(&self) -> bool {
        !matches!(self, Self::Off)
    }

    fn get(&mut self, gpu: &Gpu) -> Option<&mut Mirror> {
        if let Self::Wanted = self {
            *self = Self::On(Box::new(Mirror::new(gpu.clone())));
        }
        match self {
            Self::On(mirror) => Some(mirror),
            _ => None,
        }
    }
}

/// Presents with a graphics adapter.
pub struct GpuPresenter {
    instance: wgpu::Instance,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    gpu: Gpu,
    configuration: wgpu::SurfaceConfiguration,
    renderer: Renderer,
    mirror: Mirroring,
    /// The next picture finds the surface lost.
    loses_surface: bool,
    /// The mirror's picture as the interface knows it.
    registered: Option<(wgpu::Texture, egui::TextureId)>,
}

impl GpuPresenter {
    /// With the best adapter if it is `wanted`; else which one that is.
    fn new(
        window: &Arc<Window>,
        display: OwnedDisplayHandle,
        drawn_by: DrawnBy,
        wanted: impl FnOnce(&AdapterInfo) -> bool,
    ) -> Result<Result<Self, AdapterInfo>, String> {
        let instance = adapter::instance(Some(Box::new(display)));
        let surface = instance.create_surface(window.clone()).map_err(|e| {
            format!("no graphics interface can show a window ({e}); install a Vulkan driver (Debian: `mesa-vulkan-drivers libvulkan1`)")
        })?;
        let gpu = match Gpu::open_if(&instance, Some(&surface), wanted)? {
            Ok(gpu) => gpu,
            Err(info) => return Ok(Err(info)),
        };
        let size = window.inner_size();
        let limit = gpu.device.limits().max_texture_dimension_2d;
        let (width, height) = (size.width.clamp(1, limit), size.height.clamp(1, limit));
        let mut configuration = surface
            .get_default_config(&gpu.adapter, width, height)
            .ok_or_else(|| format!("{} cannot show pictures on this window", gpu.info))?;
        // The interface writes sRGB-encoded values itself.
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        if let Some(format) = formats.iter().find(|f| !f.is_srgb()) {
            configuration.format = *format;
        }
        configuration.present_mode = wgpu::PresentMode::AutoNoVsync;
        configuration.desired_maximum_frame_latency = 1;
        surface.configure(&gpu.device, &configuration);
        let renderer = Renderer::new(&gpu.device, configuration.format, RendererOptions::default());
        let mirror = match drawn_by {
            DrawnBy::Adapter => Mirroring::Wanted,
            DrawnBy::Auto if !gpu.info.software => Mirroring::Wanted,
            DrawnBy::Auto | DrawnBy::Processor => Mirroring::Off,
        };
        let window = window.clone();
        Ok(Ok(Self {
            instance,
            window,
            surface,
            gpu,
            configuration,
            renderer,
            mirror,
            loses_surface: false,
            registered: None,
        }))
    }

    fn mirrored(&mut self) -> Option<(egui::TextureId, [u32; 2])> {
        let Mirroring::On(mirror) = &self.mirror else { return None };
        let picture = mirror.picture()?;
        let size = [picture.width(), picture.height()];
        if let Some((texture, id)) = &self.registered
            && texture == picture
        {
            return Some((*id, size));
        }
        let view = picture.create_view(&Default::default());
        // As pictures of the processor are: `interface::texture`.
        let sampler = wgpu::SamplerDescriptor {
            label: Some("picture"),
            min_filter: wgpu::FilterMode::Linear,
            mag_filter: wgpu::FilterMode::Nearest,
            ..Default::default()
        };
        let (device, renderer) = (&self.gpu.device, &mut self.renderer);
        let id = match self.registered.take() {
            Some((_, id)) => {
                renderer
                    .update_egui_texture_from_wgpu_texture_with_sampler_options(device, &view, sampler, id);
                id
            }
            None => renderer.register_native_texture_with_sampler_options(device, &view, sampler),
        };
        self.registered = Some((picture.clone(), id));
        Some((id, size))
    }

    fn info(&self) -> &AdapterInfo {
        &self.gpu.info
    }

    fn resize(&mut self, size: [u32; 2]) {
        let limit = self.gpu.device.limits().max_texture_dimension_2d;
        // A minimised window has no pixels; the surface keeps its size then.
        if size[0] > 0 && size[1] > 0 {
            self.configuration.width = size[0].min(limit);
            self.configuration.height = size[1].min(limit);
            self.surface.configure(&self.gpu.device, &self.configuration);
        }
    }

    fn present(&mut self, painted: &Painted<'_>) -> Presented {
        if self.gpu.is_lost() {
            return Presented::Lost;
        }
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        // Textures come once: they are taken even where nothing can be shown now.
        for (id, changes) in &painted.textures.set {
            for change in changes {
                self.renderer.update_texture(device, queue, *id, change);
            }
        }
        let shown = self.draw(painted);
        for id in &painted.textures.free {
            self.renderer.free_texture(id);
        }
        shown
    }

    fn draw(&mut self, painted: &Painted<'_>) -> Presented {
        use wgpu::CurrentSurfaceTexture as Current;
        let current = match std::mem::take(&mut self.loses_surface) {
            true => Current::Lost,
            false => self.surface.get_current_texture(),
        };
        let frame = match current {
            Current::Success(frame) | Current::Suboptimal(frame) => frame,
            Current::Timeout | Current::Occluded => return Presented::Again,
            Current::Outdated => {
                self.surface.configure(&self.gpu.device, &self.configuration);
                return Presented::Again;
            }
            Current::Lost => {
                tracing::warn!("the window's surface was lost; another one is made");
                return match self.instance.create_surface(self.window.clone()) {
                    Ok(surface) => {
                        self.surface = surface;
                        self.surface.configure(&self.gpu.device, &self.configuration);
                        Presented::Again
                    }
                    Err(_) => Presented::Lost,
                };
            }
            Current::Validation => return Presented::Lost,
        };
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let screen = ScreenDescriptor {
            size_in_pixels: [self.configuration.width, self.configuration.height],
            pixels_per_point: painted.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&Default::default());
        let mut commands =
            self.renderer.update_buffers(device, queue, &mut encoder, painted.primitives, &screen);
        let view = frame.texture.create_view(&Default::default());
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("window"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        self.renderer.render(&mut pass.forget_lifetime(), painted.primitives, &screen);
        commands.push(encoder.finish());
        queue.submit(commands);
        queue.present(frame);
        if self.gpu.is_lost() { Presented::Lost } else { Presented::Shown }
    }
}

/// Presents on the processor.
pub struct CpuPresenter {
    surface: softbuffer::Surface<OwnedDisplayHandle, Arc<Window>>,
    painter: SoftwarePainter,
    size: [u32; 2],
}

impl CpuPresenter {
    fn new(window: &Arc<Window>, display: OwnedDisplayHandle) -> Result<Self, String> {
        let failed = |e: softbuffer::SoftBufferError| format!("the display takes no pictures: {e}");
        let context = softbuffer::Context::new(display).map_err(failed)?;
        let surface = softbuffer::Surface::new(&context, window.clone()).map_err(failed)?;
        let size = window.inner_size();
        Ok(Self { surface, painter: SoftwarePainter::default(), size: [size.width, size.height] })
    }

    fn present(&mut self, painted: &Painted<'_>) -> Presented {
        self.painter.set_textures(painted.textures);
        let shown = self.draw(painted);
        self.painter.free_textures(painted.textures);
        shown
    }

    fn draw(&mut self, painted: &Painted<'_>) -> Presented {
        let [width, height] = self.size;
        let (Some(columns), Some(rows)) = (NonZeroU32::new(width), NonZeroU32::new(height)) else {
            return Presented::Again;
        };
        if self.surface.resize(columns, rows).is_err() {
            return Presented::Lost;
        }
        let Ok(mut buffer) = self.surface.buffer_mut() else { return Presented::Lost };
        buffer.fill(0);
        let size = [width as usize, height as usize];
        self.painter.paint(painted.primitives, painted.pixels_per_point, size, &mut buffer);
        if buffer.present().is_ok() { Presented::Shown } else { Presented::Lost }
    }
}
