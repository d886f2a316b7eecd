//! All passes together: one picture of one scene.

use std::sync::Arc;

use foveal::display::tone::ToneMap;
use foveal::illumination::Irradiance;
use foveal::sampling::Rect;
use foveal::scene::Scene;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::{Footprint, Guides, SampleBatch, WarpedSample};
use glam::Vec3;

use super::adapter::Gpu;
use super::base::{BasePass, BaseScene, BaseTargets};
use super::compose::{ComposePass, ComposeTargets};
use super::geometry;
use super::readback::ReadBack;
use super::reconstruction::{ReconstructionPass, ReconstructionTargets};
use super::splat::{self, SplatPass, SplatTargets};
use foveal_actors::renderer::overlay::Overlay;

/// Pictures on their way back at most.
const READ_BACK_RING: usize = 3;

/// The compiled passes, which serve any scene.
#[derive(Debug)]
pub struct Passes {
    gpu: Gpu,
    base: BasePass,
    splat: SplatPass,
    reconstruction: ReconstructionPass,
    compose: ComposePass,
}

impl Passes {
    /// Compiles all.
    pub fn new(gpu: Gpu) -> Self {
        Self {
            base: BasePass::new(&gpu),
            splat: SplatPass::new(&gpu),
            reconstruction: ReconstructionPass::new(&gpu),
            compose: ComposePass::new(&gpu),
            gpu,
        }
    }

    /// The adapter.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }
}

/// The display of one scene on an adapter.
#[derive(Debug)]
pub struct GpuDisplay {
    gpu: Gpu,
    passes: Arc<Passes>,
    base: BaseScene,
    targets: BaseTargets,
    splats: SplatTargets,
    between: ReconstructionTargets,
    compose: ComposeTargets,
    k_max: u32,
    footprint: Footprint,
    ring: ReadBack,
    /// The view to draw before the next splat, if a new one began.
    begun: Option<CameraFrame>,
}

/// What one call of [`GpuDisplay::draw`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Drawn {
    /// Triangles handed to the rasteriser.
    pub triangles: u32,
    /// Samples splatted.
    pub samples: usize,
}

impl GpuDisplay {
    /// Whether the adapter has room for a scene and pictures of `size`.
    pub fn fits(gpu: &Gpu, scene: &Scene, size: [u32; 2]) -> bool {
        let limits = gpu.device.limits();
        let binding = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        size.iter().all(|s| (1..=limits.max_texture_dimension_2d).contains(s))
            && splat::largest_buffer(size) <= binding
            && geometry::shows(scene)
            && geometry::most_rows(scene) <= limits.max_texture_dimension_2d as usize
    }

    /// Puts a scene on the adapter, for pictures of `size`.
    pub fn new(
        passes: Arc<Passes>,
        scene: Arc<Scene>,
        illumination: &dyn Irradiance,
        size: [u32; 2],
        k_max: u32,
        footprint: Footprint,
    ) -> Self {
        let gpu = passes.gpu.clone();
        let targets = BaseTargets::new(&gpu, size);
        Self {
            base: passes.base.upload(&gpu, scene, illumination),
            splats: SplatTargets::new(&gpu, &targets, k_max, footprint),
            between: ReconstructionTargets::new(&gpu, targets.size, footprint),
            compose: ComposeTargets::new(&gpu, targets.size),
            passes,
            targets,
            k_max,
            footprint,
            ring: ReadBack::new(READ_BACK_RING),
            begun: None,
            gpu,
        }
    }

    /// The adapter.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Columns and rows of the picture.
    pub fn size(&self) -> [u32; 2] {
        self.targets.size
    }

    /// The buffers of the base layer.
    pub fn targets(&self) -> &BaseTargets {
        &self.targets
    }

    /// The splat layer.
    pub fn splats(&self) -> &SplatTargets {
        &self.splats
    }

    /// What is shown of the splat layer, as the colours that splats are laid into.
    pub fn between(&self) -> &wgpu::Buffer {
        self.between.shown(&self.splats)
    }

    /// The triangle of the scene that a number in `BaseTargets::visible` stands for.
    pub fn triangle(&self, visible: u32) -> Option<u32> {
        self.base.triangle(visible)
    }

    /// The picture: sRGB-encoded bytes.
    pub fn picture(&self) -> &wgpu::Texture {
        &self.compose.picture
    }

    /// The scene, with the levels of textures that are held.
    pub fn scene(&self) -> &Arc<Scene> {
        self.base.scene()
    }

    /// Bytes that textures take on the adapter.
    pub fn texture_bytes(&self) -> u64 {
        self.base.texture_bytes()
    }

    /// Pictures of another size from now on; the next view begins with nothing.
    pub fn resize(&mut self, size: [u32; 2]) {
        if size != self.targets.size {
            self.targets = BaseTargets::new(&self.gpu, size);
            self.splats = SplatTargets::new(&self.gpu, &self.targets, self.k_max, self.footprint);
            self.between = ReconstructionTargets::new(&self.gpu, self.targets.size, self.footprint);
            self.compose = ComposeTargets::new(&self.gpu, self.targets.size);
        }
    }

    /// Another illumination of the same scene; shown from the next view on.
    pub fn set_illumination(&mut self, illumination: &dyn Irradiance) {
        self.passes.base.update_light(&self.gpu, &mut self.base, illumination);
    }

    /// The same scene with other levels of its textures in memory; shown from the next view on.
    pub fn set_textures(&mut self, scene: &Arc<Scene>) {
        self.passes.base.update_textures(&self.gpu, &mut self.base, scene);
    }

    /// What the overlay shows of objects or textures: `Sources::values`.
    pub fn set_values(&mut self, values: &[f32]) {
        self.compose.set_values(&self.gpu, values);
    }

    /// A new view begins: its base layer replaces the old one, and all splats go.
    pub fn begin_view(&mut self, frame: &CameraFrame) {
        self.begun = Some(*frame);
        let white = ToneMap::from(&self.base.scene().display).white();
        self.between.begin_view(&self.gpu, frame, white);
        self.splats.clear();
        self.compose.clear();
    }

    /// No pixel is refined any more.
    pub fn unrefine(&mut self) {
        self.compose.clear();
    }

    /// What pixels show until a sample reaches them: column, row, object id and view-dependent radiance.
    pub fn approximate(&mut self, pixels: impl Iterator<Item = (u16, u16, u32, Vec3)>) {
        self.splats.approximate(pixels);
    }

    /// Pixels that are refined show this radiance, row by row, whatever the layers say; and overlays this error.
    pub fn refine(&mut self, rect: Rect, radiance: &[Vec3], error: f32) {
        self.compose.refine(&self.gpu, rect, radiance, error);
    }

    /// Cached samples moved into this view.
    pub fn splat_warped(&mut self, samples: &[WarpedSample]) {
        self.splats.splat_warped(samples);
    }

    /// Samples traced for this view by `source`.
    pub fn splat_fresh(&mut self, batch: &SampleBatch, source: u8) {
        self.splats.splat_fresh(batch, source);
    }

    /// What guides show in this view.
    pub fn guide(&mut self, guides: &Guides) {
        self.splats.guide(guides);
    }

    /// Draws what is new and the picture.
    pub fn draw(&mut self, tone: &ToneMap, overlay: Overlay) -> Drawn {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut drawn = Drawn::default();
        let (gpu, passes) = (&self.gpu, &self.passes);
        let begun = self.begun.take();
        if let Some(frame) = &begun {
            drawn.triangles = passes.base.draw(gpu, &mut encoder, &self.base, &self.targets, frame);
        }
        drawn.samples = passes.splat.draw(gpu, &mut encoder, &mut self.splats, &self.targets);
        let is_guided_anew = self.splats.send_guides(gpu);
        if begun.is_some() || drawn.samples > 0 || is_guided_anew {
            passes.reconstruction.draw(gpu, &mut encoder, &self.between, &self.splats, &self.targets);
        }
        let layers = (&self.targets, &self.splats, self.between.shown(&self.splats));
        passes.compose.draw(gpu, &mut encoder, layers, &mut self.compose, tone, overlay);
        self.gpu.queue.submit([encoder.finish()]);
        drawn
    }

    /// Asks for the picture as it is now; `false` if too many are on their way. It arrives at
    /// [`Self::poll_picture`] some frames later.
    pub fn request_picture(&mut self, tag: u64) -> bool {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let room = self.ring.request(&self.gpu, &mut encoder, &self.compose.picture, tag);
        if room {
            self.gpu.queue.submit([encoder.finish()]);
            self.ring.submitted();
        }
        room
    }

    /// A picture that has arrived: its tag and its RGBA bytes in rows. Never waits.
    pub fn poll_picture(&mut self) -> Option<(u64, Vec<u8>)> {
        self.ring.poll(&self.gpu)
    }

    /// The picture as it is now, RGBA bytes in rows. Waits for the adapter.
    ///
    /// # Errors
    /// If the adapter is lost.
    #[cfg(test)]
    pub fn read_picture(&self) -> Result<Vec<u8>, String> {
        super::readback::read(&self.gpu, &self.compose.picture)
    }
}
