//! All passes together: one picture of one scene.

use std::sync::Arc;

use foveal::display::tone::ToneMap;
use foveal::illumination::Irradiance;
use foveal::scene::Scene;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::{Footprint, SampleBatch, WarpedSample};

use super::adapter::Gpu;
use super::base::{BasePass, BaseScene, BaseTargets};
use super::compose::{ComposePass, PICTURE};
use super::readback::{self, ReadBack};
use super::splat::{SplatPass, SplatTargets};
use crate::renderer::overlay::Overlay;

/// Pictures on their way back at most.
const READ_BACK_RING: usize = 3;

/// The display of one scene on an adapter.
#[derive(Debug)]
pub struct GpuDisplay {
    gpu: Gpu,
    base_pass: BasePass,
    splat_pass: SplatPass,
    compose_pass: ComposePass,
    base: BaseScene,
    targets: BaseTargets,
    splats: SplatTargets,
    picture: wgpu::Texture,
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
    /// Puts a scene on the adapter, for pictures of `size`.
    pub fn new(
        gpu: Gpu,
        scene: Arc<Scene>,
        illumination: &dyn Irradiance,
        size: [u32; 2],
        k_max: u32,
        footprint: Footprint,
    ) -> Self {
        let base_pass = BasePass::new(&gpu);
        let targets = BaseTargets::new(&gpu, size);
        Self {
            base: base_pass.upload(&gpu, scene, illumination),
            base_pass,
            splat_pass: SplatPass::new(&gpu),
            compose_pass: ComposePass::new(&gpu),
            splats: SplatTargets::new(&gpu, &targets, k_max, footprint),
            picture: gpu.target("picture", targets.size, PICTURE),
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

    /// The picture: sRGB-encoded bytes.
    pub fn picture(&self) -> &wgpu::Texture {
        &self.picture
    }

    /// Pictures of another size from now on; the next view begins with nothing.
    pub fn resize(&mut self, size: [u32; 2]) {
        if size != self.targets.size {
            self.targets = BaseTargets::new(&self.gpu, size);
            self.splats = SplatTargets::new(&self.gpu, &self.targets, self.k_max, self.footprint);
            self.picture = self.gpu.target("picture", self.targets.size, PICTURE);
        }
    }

    /// Another illumination of the same scene; shown from the next view on.
    pub fn set_illumination(&mut self, illumination: &dyn Irradiance) {
        self.base_pass.update_light(&self.gpu, &mut self.base, illumination);
    }

    /// What the overlay shows of objects or textures: `Sources::values`.
    pub fn set_values(&mut self, values: &[f32]) {
        self.compose_pass.set_values(&self.gpu, values);
    }

    /// A new view begins: its base layer replaces the old one, and all splats go.
    pub fn begin_view(&mut self, frame: &CameraFrame) {
        self.begun = Some(*frame);
        self.splats.clear();
    }

    /// Cached samples moved into this view.
    pub fn splat_warped(&mut self, samples: &[WarpedSample]) {
        self.splats.splat_warped(samples);
    }

    /// Samples traced for this view by `source`.
    pub fn splat_fresh(&mut self, batch: &SampleBatch, source: u8) {
        self.splats.splat_fresh(batch, source);
    }

    /// Draws what is new and the picture.
    pub fn draw(&mut self, tone: &ToneMap, overlay: Overlay) -> Drawn {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let mut drawn = Drawn::default();
        if let Some(frame) = self.begun.take() {
            drawn.triangles = self.base_pass.draw(&self.gpu, &mut encoder, &self.base, &self.targets, &frame);
        }
        drawn.samples = self.splat_pass.draw(&self.gpu, &mut encoder, &mut self.splats, &self.targets);
        self.compose_pass.draw(
            &self.gpu,
            &mut encoder,
            &self.targets,
            &self.splats,
            &self.picture,
            tone,
            overlay,
        );
        self.gpu.queue.submit([encoder.finish()]);
        drawn
    }

    /// Asks for the picture as it is now; `false` if too many are on their way. It arrives at
    /// [`Self::poll_picture`] some frames later.
    pub fn request_picture(&mut self, tag: u64) -> bool {
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        let room = self.ring.request(&self.gpu, &mut encoder, &self.picture, tag);
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
    pub fn read_picture(&self) -> Result<Vec<u8>, String> {
        readback::read(&self.gpu, &self.picture)
    }
}
