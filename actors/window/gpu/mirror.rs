//! What a renderer shows, on an adapter: takes over what has changed since it last looked, and draws it there.
//!
//! In: the renderer and the samples of its view, in the order in which it splatted them. Out: the same picture as the
//! renderer's, as a texture. Decides nothing.

use std::sync::Arc;

use foveal::display::tone::ToneMap;
use foveal::illumination::Irradiance;
use foveal::splatting::layer::APPROXIMATED;
use foveal::splatting::settled::Settled;
use foveal::splatting::supersampling::Tiles;
use foveal::splatting::{Footprint, SplatLayer};
use glam::Vec3;

use super::adapter::Gpu;
use super::display::{Drawn, GpuDisplay, Passes};
use foveal_actors::message::{DrawnView, View};
use foveal_actors::renderer::overlay::tile_error;
use foveal_actors::renderer::{Renderer, Splats};
use foveal_engine::look::DisplayInput;

/// A renderer's picture on an adapter.
pub struct Mirror {
    passes: Arc<Passes>,
    scene: Option<OfScene>,
    /// Read-backs that are on their way are told apart by this.
    asked: u64,
}

/// What belongs to one scene.
struct OfScene {
    display: GpuDisplay,
    content: [u8; 32],
    illumination: Arc<dyn Irradiance>,
    /// The view that is drawn, and how many of its splats.
    view: Option<View>,
    splats: usize,
    /// What is shown of a refined view.
    settled: Option<Arc<Settled>>,
    /// First approximations that were sent, by pixel; NaN where none was.
    approximated: Vec<Vec3>,
}

impl Mirror {
    /// Compiles the passes.
    pub fn new(gpu: Gpu) -> Self {
        Self { passes: Arc::new(Passes::new(gpu)), scene: None, asked: 0 }
    }

    /// The adapter.
    pub fn gpu(&self) -> &Gpu {
        self.passes.gpu()
    }

    /// The picture: sRGB-encoded bytes. `None` before the first.
    pub fn picture(&self) -> Option<&wgpu::Texture> {
        self.scene.as_ref().map(|s| s.display.picture())
    }

    /// Bytes that the scene's textures take on the adapter.
    pub fn texture_bytes(&self) -> u64 {
        self.scene.as_ref().map_or(0, |s| s.display.texture_bytes())
    }

    /// Shows what the renderer shows. `None`, and nothing changes, where it shows nothing or the adapter cannot hold it.
    pub fn draw(&mut self, shown: &DisplayInput<'_>) -> Option<Drawn> {
        let drawn = shown.renderer.drawn()?;
        self.take_scene(drawn, shown.renderer.k_max(), shown.footprint)?;
        let scene = self.scene.as_mut()?;
        scene.take_view(drawn);
        let (view, splats) = shown.splats;
        if view == drawn.view {
            for splats in splats.get(scene.splats..).unwrap_or_default() {
                match splats {
                    Splats::Warped(samples) => scene.display.splat_warped(samples),
                    Splats::Fresh { batch, source } => scene.display.splat_fresh(batch, *source),
                    Splats::Guides(guides) => scene.display.guide(guides),
                }
            }
            scene.splats = splats.len();
        }
        scene.take_approximations(drawn, shown.renderer.layer());
        scene.take_tiles(drawn, shown.renderer, &shown.tone);
        scene.display.set_values(shown.values);
        Some(scene.display.draw(&shown.tone, shown.overlay))
    }

    /// Another scene, or the same one with other light or other levels of its textures.
    fn take_scene(&mut self, drawn: &Arc<DrawnView>, k_max: u32, footprint: Footprint) -> Option<()> {
        let world = &drawn.world;
        let size = drawn.frame.size;
        let content = world.scene.content_hash;
        if let Some(scene) = self.scene.as_mut().filter(|s| s.content == content && s.display.size() == size)
        {
            if !Arc::ptr_eq(scene.display.scene(), &world.scene) {
                scene.display.set_textures(&world.scene);
            }
            if !Arc::ptr_eq(&scene.illumination, &world.illumination) {
                scene.display.set_illumination(&*world.illumination);
                scene.illumination = Arc::clone(&world.illumination);
            }
            return Some(());
        }
        if !GpuDisplay::fits(self.passes.gpu(), &world.scene, size) {
            return None;
        }
        self.scene = None;
        let display = GpuDisplay::new(
            Arc::clone(&self.passes),
            Arc::clone(&world.scene),
            &*world.illumination,
            size,
            k_max,
            footprint,
        );
        self.scene = Some(OfScene {
            display,
            content,
            illumination: Arc::clone(&world.illumination),
            view: None,
            splats: 0,
            settled: None,
            approximated: vec![Vec3::NAN; size[0] as usize * size[1] as usize],
        });
        Some(())
    }

    /// Asks for the picture as it is now; `false` if too many are on their way. It arrives at [`Self::poll_picture`].
    pub fn request_picture(&mut self) -> Option<u64> {
        let tag = self.asked + 1;
        let asked = self.scene.as_mut()?.display.request_picture(tag);
        self.asked = if asked { tag } else { self.asked };
        asked.then_some(tag)
    }

    /// A picture that has arrived: its tag, columns and rows, and RGBA bytes. Never waits.
    pub fn poll_picture(&mut self) -> Option<(u64, [u32; 2], Vec<u8>)> {
        let display = &mut self.scene.as_mut()?.display;
        let size = display.size();
        let (tag, bytes) = display.poll_picture()?;
        Some((tag, size, bytes))
    }
}

impl foveal_engine::look::Mirror for Mirror {
    fn show(&mut self, shown: &DisplayInput<'_>) -> bool {
        self.draw(shown).is_some()
    }
}

impl OfScene {
    fn take_view(&mut self, drawn: &Arc<DrawnView>) {
        if self.view == Some(drawn.view) {
            return;
        }
        self.view = Some(drawn.view);
        self.splats = 0;
        self.settled = None;
        self.approximated.fill(Vec3::NAN);
        self.display.begin_view(&drawn.frame);
    }

    /// Pixels without sample, where that is new or shows something else now.
    fn take_approximations(&mut self, drawn: &DrawnView, layer: &SplatLayer) {
        let (colors, ranks, ..) = layer.maps();
        let (width, objects) = (colors.width().max(1), drawn.buffers().object.data());
        let pixels = ranks.data().iter().zip(colors.data()).zip(objects).zip(&mut self.approximated);
        let new = pixels.enumerate().filter_map(|(i, (((rank, color), object), before))| {
            // Those that a better map will replace are shown until then.
            if *rank > APPROXIMATED || before == color {
                return None;
            }
            // Where nothing lies nothing is shown, so that the many diffuse pixels stay here.
            let is_needed = *color != Vec3::ZERO || before.is_finite();
            *before = *color;
            is_needed.then_some(((i % width) as u16, (i / width) as u16, *object, *color))
        });
        self.display.approximate(new);
    }

    /// What the view was refined to, where that is new.
    fn take_tiles(&mut self, drawn: &DrawnView, renderer: &Renderer, tone: &ToneMap) {
        let settled = renderer.settled();
        if self.settled.as_ref().map(Arc::as_ptr) == settled.map(Arc::as_ptr) {
            return;
        }
        self.settled = settled.cloned();
        let Some(settled) = settled else { return self.display.unrefine() };
        let [width, height] = self.display.size();
        let grid = Tiles::of_size(width, height);
        let (base, splats) = (&drawn.buffers().color, renderer.layer());
        for tile in renderer.tiles() {
            let pixel = |(x, y)| settled.pixel(x, y, base.at(x, y), base.at(x, y) + splats.color(x, y));
            let radiance: Vec<Vec3> = grid.pixels(tile.tile).map(pixel).collect();
            self.display.refine(grid.rect(tile.tile), &radiance, tile_error(tile, tone));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{readback, test_scene};
    use foveal::display::{FrameBuffers, cpu_pass};
    use foveal::illumination::Uniform;
    use foveal::world::World;
    use foveal_actors::renderer::overlay::Overlay;

    /// What an adapter shows that first looks at the view now.
    fn shown(drawn: &Arc<DrawnView>, layer: &SplatLayer, gpu: &Gpu) -> Vec<u8> {
        let mut mirror = Mirror::new(gpu.clone());
        mirror.take_scene(drawn, 2, Footprint::Tile).expect("it fits");
        let scene = mirror.scene.as_mut().expect("a scene");
        scene.take_view(drawn);
        scene.take_approximations(drawn, layer);
        scene.display.draw(&ToneMap::default(), Overlay::None);
        readback::read(gpu, mirror.picture().expect("drawn")).expect("an adapter")
    }

    #[test]
    fn first_approximations_are_shown_until_a_better_map_replaces_them() {
        let Ok(gpu) = Gpu::headless() else { return };
        let world = World::new(Arc::new(test_scene::room(4)), Arc::new(Uniform(Vec3::ONE)));
        let frame = world.scene.cameras[0].camera.frame(80, 60);
        let mut buffers = FrameBuffers::new(80, 60);
        cpu_pass::draw(&world, &frame, cpu_pass::Passes { texture_ids: false }, &mut buffers);
        let drawn = Arc::new(DrawnView {
            view: View(1),
            frame,
            drawn: buffers.into(),
            world,
            object_count: 3,
            hash: 0.into(),
        });
        let mut layer = SplatLayer::new(80, 60, 2, Footprint::Tile);
        let without = shown(&drawn, &layer, &gpu);
        layer.approximate(|x, y| Vec3::splat(if drawn.buffers().object.at(x, y) == 0 { 0.0 } else { 0.25 }));
        let with = shown(&drawn, &layer, &gpu);
        assert_ne!(with, without);
        layer.disapprove(|_, _| true);
        assert!(layer.is_bare(40, 30) && shown(&drawn, &layer, &gpu) == with, "nothing better is there yet");
    }
}
