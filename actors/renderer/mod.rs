//! The renderer: what is on screen.
//!
//! Owns the camera, the frame buffers, the splat layer. Hears: a frame began, its deadline, aged
//! samples, traced samples, environment maps, convergence. Says: to the cache ager and the allocator, that there is a new
//! view; to the analyzer, what was shown.

mod growth;
pub mod overlay;
mod samples;
mod saved;
mod show;
mod textures;
mod told;

use std::collections::VecDeque;
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::first_approximation::FirstApproximation;
use foveal::display::tone::{Encoder, ToneMap};
use foveal::image::Map2d;
use foveal::perception::tvi::TviTable;
use foveal::perception::viewing::Viewing;
use foveal::scene::{Camera, Scene};
use foveal::splatting::settled::Settled;
use foveal::splatting::supersampling::Tiles;
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::{Guides, Reconstruction, SampleBatch, SplatLayer, WarpedSample};
use foveal::world::World;
use foveal_runtime::{Actor, Address, Class, Content, Cx, Loader, Saver};
use glam::Vec3;

use crate::foresight::Foresight;
use crate::message::{
    AllocatorMessage, AnalyzerMessage, CacheAgerMessage, DrawnView, FrameSnapshot, RendererInput,
    RendererMessage, View,
};
use crate::outbox::Outbox;
use crate::settings::{Adjustment, Settings};
use crate::stages::{Begun, Stage, StageTimes};
use growth::Growth;
use textures::TextureChange;

/// Kind of the mark that each shown frame leaves in a recording; its value is the picture's hash.
pub const MARK_FRAME: u32 = 0;

/// Share of a frame's time that drawing the base layer may take while the camera moves; where it takes more, it is drawn
/// sparsely, so that the frame is in time and samples come into it.
const DRAWING_SHARE: f32 = 0.4;
/// Seconds that drawing a pixel is expected to take before the first one is drawn: about what the dearest of the bundled scenes,
/// the table, takes on two cores (`foveal bench stages`).
const UNSEEN_PIXEL: f32 = 2.5e-7;
/// Shares of a frame's time that a sparse base layer and what follows it in every frame may take together, before it is drawn
/// coarsely, whose edges show: the first is as late as 1 frame in 100 may be. Once coarse it stays so until there is time for
/// more, or it would change from frame to frame.
const COARSE_FROM: f32 = 1.1;
const COARSE_UNTIL: f32 = 0.95;

/// Counts of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Fresh samples splatted.
    pub traced: u32,
    /// Warped samples that painted something.
    pub reused: u32,
    /// Samples that expired for the frame's view.
    pub expired: u32,
    /// Fresh samples of an older view, which came too late to be shown.
    pub late: u32,
    /// Pixels given a first approximation, because no sample had reached them when the frame was shown.
    pub approximated: u32,
    /// Samples that refined the converged view.
    pub refined: u32,
}

/// Who sees the frames: a window, a writer of files, a comparison.
pub trait FrameSink: Send {
    /// A frame was shown. `renderer` may be asked for its layers.
    fn frame_shown(&mut self, snapshot: &Arc<FrameSnapshot>, counts: FrameCounts, renderer: &Renderer);
    /// Samples were splatted onto a view: for displays that splat by themselves.
    fn splatted(&mut self, _view: View, _splats: Splats) {}
}

/// Shows nothing.
pub struct Unseen;

impl FrameSink for Unseen {
    fn frame_shown(&mut self, _snapshot: &Arc<FrameSnapshot>, _counts: FrameCounts, _renderer: &Renderer) {}
}

/// Samples as they reached the splat layer.
#[derive(Clone, Debug)]
pub enum Splats {
    /// Of former views.
    Warped(Arc<Vec<WarpedSample>>),
    /// Traced for the view.
    Fresh {
        /// The samples.
        batch: Arc<SampleBatch>,
        /// Who traced them: [`SplatLayer::source`].
        source: u8,
    },
    /// What guides show in the view, which lies between samples.
    Guides(Arc<Guides>),
}

/// The renderer's state.
pub struct Renderer {
    settings: Settings,
    world: World,
    passes: Passes,
    tone: ToneMap,
    /// What the user changed last.
    adjustment: Option<Adjustment>,
    /// How the picture is seen, and what differences are noticed then.
    viewing: Viewing,
    thresholds: TviTable,
    encoder: Encoder,
    /// The camera of the current view; `None` before the first frame.
    camera: Option<Camera>,
    view: View,
    drawn: Option<Arc<DrawnView>>,
    /// Views drawn before, whose buffers are used again once nobody else holds them.
    retired: Vec<Arc<DrawnView>>,
    layer: SplatLayer,
    /// Changes of textures that wait for the next frames.
    waiting: VecDeque<TextureChange>,
    /// Scenes with levels that have been dropped since, as long as somebody may hold them.
    former: Vec<Weak<Scene>>,
    /// Whether the allocator waits for what was dropped.
    releasing: bool,
    /// Drops carried out since the beginning.
    drops: u32,
    /// What the splat layer of a view begins with.
    approximation: Option<FirstApproximation>,
    counts: FrameCounts,
    /// Whether every sample of the current view is splatted.
    converged: bool,
    /// What the tiles of the converged view have been refined to, by tile; none before that.
    tiles: Vec<Option<Arc<TileSums>>>,
    /// What is shown of them.
    settled: Option<Arc<Settled>>,
    /// Whether the current view is as good as it gets.
    refined: bool,
    /// Better light that the shown one moves towards.
    target: Option<Growth>,
    /// Whether the shown light is final.
    lit: bool,
    /// Whether anything changed since the last frame was shown.
    changed: bool,
    /// The last frame, shown again while nothing changes.
    shown: Option<Arc<FrameSnapshot>>,
    /// How long drawing a whole base layer takes.
    drawing: Foresight,
    /// Share of that time that a sparse one takes; none, before it is known.
    sparse_share: f32,
    /// How long warped samples and composing take, which follow in every frame.
    following: Foresight,
    /// How long warped samples of the current view took.
    warping: Duration,
    /// When the drawing of the current frame ended; only for the stage's time.
    drawn_at: Option<Begun>,
    /// `None` in a diffuse scene, where there is nothing to correct.
    neighbours: Option<Neighbours>,
    outbox: Outbox<RendererMessage>,
    stages: StageTimes,
    sink: Box<dyn FrameSink>,
}

/// Whom the renderer tells, in a scene that has something to correct.
#[derive(Clone)]
pub struct Neighbours {
    /// Hears of each new view.
    pub cache_ager: Address<CacheAgerMessage>,
    /// Hears of each new view once it is drawn.
    pub allocator: Address<AllocatorMessage>,
    /// Sees each frame.
    pub analyzer: Address<AnalyzerMessage>,
}

impl Renderer {
    /// A renderer that has not shown anything.
    pub fn new(
        settings: Settings,
        world: World,
        passes: Passes,
        neighbours: Option<Neighbours>,
        approximation: Option<FirstApproximation>,
        stages: StageTimes,
        sink: Box<dyn FrameSink>,
    ) -> Self {
        let (width, height) = (settings.width as usize, settings.height as usize);
        Self {
            layer: SplatLayer::new(width, height, settings.k_max, settings.footprint),
            tone: ToneMap::from(&world.scene.display),
            adjustment: None,
            viewing: Viewing::from_centre_of_projection(
                world.scene.display.white_cd_m2,
                width,
                world.scene.cameras.first().map_or(1.0, |c| c.camera.fov_y),
            ),
            thresholds: TviTable::default(),
            settings,
            world,
            passes,
            encoder: Encoder::default(),
            camera: None,
            view: View(0),
            drawn: None,
            retired: Vec::new(),
            waiting: VecDeque::new(),
            former: Vec::new(),
            releasing: false,
            drops: 0,
            approximation,
            counts: FrameCounts::default(),
            converged: false,
            tiles: Vec::new(),
            settled: None,
            refined: false,
            target: None,
            lit: true,
            changed: false,
            shown: None,
            drawing: Foresight::default(),
            sparse_share: 0.0,
            following: Foresight::default(),
            warping: Duration::ZERO,
            drawn_at: None,
            neighbours,
            outbox: Outbox::new(|| RendererMessage::SendAgain),
            stages,
            sink,
        }
    }

    /// Whether an illuminator will bring better light, without which no view has converged.
    pub fn awaiting_light(mut self, awaits: bool) -> Self {
        self.lit = !awaits;
        self
    }

    /// Whether every non-diffuse pixel of the current view shows its own ray, under light that is final.
    pub fn is_converged(&self) -> bool {
        self.converged && self.lit && self.waiting.is_empty() && !self.is_sparse()
    }

    /// Whether the current view is drawn sparsely, until the camera stands still.
    pub fn is_sparse(&self) -> bool {
        self.drawn.as_ref().is_some_and(|drawn| drawn.drawn.cell() != 1)
    }

    /// Whether the current view has converged, and has been refined where that is wanted.
    pub fn is_refined(&self) -> bool {
        self.is_converged() && (self.refined || !self.is_supersampled())
    }

    /// Whether converged views are refined.
    pub fn is_supersampled(&self) -> bool {
        self.settings.supersampling.is_some() && self.neighbours.is_some()
    }

    /// What tiles of the converged view have been refined to.
    pub fn tiles(&self) -> impl Iterator<Item = &TileSums> {
        self.tiles.iter().flatten().map(|sums| &**sums)
    }

    /// Whether the shown light is final.
    pub fn is_lit(&self) -> bool {
        self.lit
    }

    /// K of the lattice.
    pub fn k_max(&self) -> u32 {
        self.settings.k_max
    }

    /// The world with the levels of textures that are shown now.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Whether the last frame shows all there is.
    pub fn is_shown(&self) -> bool {
        !self.changed
    }

    /// The last frame that was shown.
    pub fn shown(&self) -> Option<&Arc<FrameSnapshot>> {
        self.shown.as_ref()
    }

    /// The current view.
    pub fn drawn(&self) -> Option<&Arc<DrawnView>> {
        self.drawn.as_ref()
    }

    /// The camera of the current view.
    pub fn camera(&self) -> Option<Camera> {
        self.camera
    }

    /// The splat layer.
    pub fn layer(&self) -> &SplatLayer {
        &self.layer
    }

    /// The picture as it stands, linear radiance: base layer + splat layer, and what that is refined to. `None` before
    /// the first frame.
    pub fn picture(&self) -> Option<Map2d<Vec3>> {
        let drawn = self.drawn.as_ref()?;
        let base = &drawn.buffers().color;
        let mut picture = Map2d::new(base.width(), base.height(), Vec3::ZERO);
        let settled = self.settled.as_ref();
        self.between(drawn).fill(&mut picture, |x, y, splats| {
            let (base, first) = (base.at(x, y), base.at(x, y) + splats);
            settled.map_or(first, |settled| settled.pixel(x, y, base, first))
        });
        Some(picture)
    }

    /// What the splat layer shows of a view, between samples too.
    fn between<'a>(&'a self, drawn: &'a DrawnView) -> Reconstruction<'a> {
        Reconstruction::new(&self.layer, drawn.buffers(), &drawn.frame, self.tone.white())
    }

    /// What the converged view has been refined to, over its base layer and its first samples.
    pub fn settled(&self) -> Option<&Arc<Settled>> {
        self.settled.as_ref()
    }

    /// What the user changed last; `None` where all is as it began.
    pub fn adjustment(&self) -> Option<&Adjustment> {
        self.adjustment.as_ref()
    }

    /// Messages that came back and wait to be sent again.
    pub fn waiting(&self) -> usize {
        self.outbox.len()
    }

    fn on_adjusted(&mut self, adjustment: Adjustment, cx: &mut Cx<'_, RendererMessage>) {
        self.refined &= self.settings.supersampling == adjustment.refine;
        self.settings.adjust(&adjustment);
        if self.settings.supersampling.is_none() && !self.tiles.is_empty() {
            self.tiles.clear();
            self.settled = None;
            self.changed = true;
        }
        self.adjustment = Some(adjustment);
        if let Some(neighbours) = &self.neighbours {
            self.outbox.tell(cx, &neighbours.cache_ager, CacheAgerMessage::Adjusted(adjustment));
            self.outbox.tell(cx, &neighbours.allocator, AllocatorMessage::Adjusted(adjustment));
        }
    }

    fn on_frame_began(&mut self, camera: Camera, time: f32, cx: &mut Cx<'_, RendererMessage>) {
        let retextured = self.change_textures();
        let brighter = self.approach_light(time);
        if brighter || retextured || self.is_sparse() || self.camera != Some(camera) {
            // A first picture is in time, too; who stands sees the whole one in the next frame.
            let stands = self.camera.replace(camera) == Some(camera);
            self.begin_view(&camera, if stands { 1 } else { self.cell_in(time) }, cx);
        }
        self.look_for_former(cx);
        self.drawn_at = Some(self.stages.begin());
    }

    /// How densely a view is drawn from which the camera moves on in `time` seconds ([`FrameBuffers::cell`]).
    fn cell_in(&self, time: f32) -> u32 {
        let pixels = self.settings.width as f32 * self.settings.height as f32;
        let whole = match self.drawing.is_known() {
            true => self.drawing.expected().as_secs_f32(),
            false => UNSEEN_PIXEL * pixels,
        };
        let following = self.following.expected().as_secs_f32();
        let before = self.drawn.as_ref().map_or(1, |drawn| drawn.drawn.cell());
        cell_for(time, [whole, whole * self.sparse_share + following], before)
    }

    /// Moves the shown light towards the newest, as far as in a frame of `time` seconds; says whether it changed.
    fn approach_light(&mut self, time: f32) -> bool {
        let Some(growth) = self.target.take() else { return false };
        let Some(target) = growth.light.map() else { return false };
        let grown = self.world.illumination.stored().and_then(|shown| growth.step(shown, target, time));
        match grown {
            Some((next, left)) => {
                self.world = self.world.with_illumination(Arc::new(next));
                self.target = Some(Growth { left: Some(left), ..growth });
            }
            None => {
                self.world = self.world.with_illumination(target.clone());
                self.lit |= growth.last;
            }
        }
        true
    }

    /// Draws a new view, as densely as `cell` says ([`FrameBuffers::cell`]); the others work on it meanwhile.
    fn begin_view(&mut self, camera: &Camera, cell: u32, cx: &mut Cx<'_, RendererMessage>) {
        self.view = self.view.next();
        self.converged = self.neighbours.is_none();
        self.refined = false;
        self.tiles.clear();
        self.settled = None;
        self.changed = true;
        self.warping = Duration::ZERO;
        let frame = camera.frame(self.settings.width, self.settings.height);
        if let Some(neighbours) = &self.neighbours {
            let moved = CacheAgerMessage::CameraMoved { view: self.view, frame };
            self.outbox.tell(cx, &neighbours.cache_ager, moved);
            self.outbox.tell(cx, &neighbours.allocator, AllocatorMessage::ViewBegun { view: self.view });
        }
        let mut buffers = self.buffers();
        let draw = || {
            self.stages.clone().time(Stage::Display, || {
                cpu_pass::draw_in_cells(&self.world, &frame, self.passes, cell, &mut buffers)
            })
        };
        let (rays, took) = cx.measure(draw);
        let pixels = self.settings.width as usize * self.settings.height as usize;
        self.drawing.learn(took.mul_f64(pixels as f64 / rays.traced.max(1) as f64));
        if cell != 1 {
            // A pixel between rays takes about half of one's time (`foveal bench stages`).
            let share = |rays: usize| rays as f32 / pixels as f32;
            let (traced, sparse) = (share(rays.traced), share(rays.traced + rays.saved));
            self.sparse_share = traced * (1.0 + sparse) / (1.0 + traced);
        }
        if self.neighbours.is_some() {
            self.layer.clear();
        }
        let drawn = Arc::new(DrawnView {
            view: self.view,
            frame,
            hash: OnceLock::new(),
            drawn: buffers.into(),
            world: self.world.clone(),
            object_count: self.world.scene.objects.len().max(1),
        });
        if let Some(before) = self.drawn.replace(drawn.clone()) {
            self.retired.push(before);
        }
        if let Some(neighbours) = &self.neighbours {
            self.outbox.tell(cx, &neighbours.allocator, AllocatorMessage::ViewDrawn { drawn });
        }
    }

    /// Jobs of the view become stale, as before the next one that does not come.
    fn on_left(&mut self, cx: &mut Cx<'_, RendererMessage>) {
        if let Some(neighbours) = &self.neighbours {
            let next = AllocatorMessage::ViewBegun { view: self.view.next() };
            self.outbox.tell(cx, &neighbours.allocator, next);
        }
    }

    /// Buffers to draw into: those of a view that nobody looks at any more, or new ones.
    fn buffers(&mut self) -> FrameBuffers {
        // A window or a tracer may hold a view for long; beyond these few, memory is given back instead.
        const RETIRED_MAX: usize = 4;
        while self.retired.len() > RETIRED_MAX {
            self.retired.remove(0);
        }
        for i in 0..self.retired.len() {
            if Arc::strong_count(&self.retired[i]) == 1 {
                let free = Arc::try_unwrap(self.retired.swap_remove(i)).ok();
                if let Some(buffers) = free.and_then(|free| free.drawn.into_inner()) {
                    return buffers;
                }
                break;
            }
        }
        FrameBuffers::new(self.settings.width as usize, self.settings.height as usize)
    }

    fn on_samples_doubted(&mut self, cx: &mut Cx<'_, RendererMessage>) {
        if let Some(camera) = self.camera {
            self.begin_view(&camera, 1, cx);
        }
    }

    fn on_view_converged(&mut self, view: View) {
        if view == self.view {
            self.converged = true;
        }
    }

    fn on_tile_sampled(&mut self, view: View, sums: Arc<TileSums>) {
        let tiles = Tiles::of_size(self.settings.width, self.settings.height);
        if view != self.view || !sums.fits(&tiles) || self.settings.supersampling.is_none() {
            return;
        }
        self.tiles.resize(tiles.len(), None);
        let tile = &mut self.tiles[sums.tile as usize];
        let before = tile.as_ref().map_or(0, |tile| tile.samples);
        self.counts.refined += (sums.samples - before.min(sums.samples)) * sums.len() as u32;
        *tile = Some(sums);
    }

    fn on_refined_shown(&mut self, view: View, settled: Arc<Settled>) {
        let (width, height) = (self.settings.width, self.settings.height);
        if view == self.view && settled.fits(width, height) && self.settings.supersampling.is_some() {
            self.settled = Some(settled);
            self.changed = true;
        }
    }
}

/// How densely a view is drawn that has `time`, if drawing all of it takes `whole`, and a sparse one and what follows it `sparse`,
/// all in seconds; `before`: how densely the last one was.
fn cell_for(time: f32, [whole, sparse]: [f32; 2], before: u32) -> u32 {
    let most = if before == 4 { COARSE_UNTIL } else { COARSE_FROM };
    match (whole <= DRAWING_SHARE * time, sparse <= most * time) {
        (true, _) => 1,
        (false, true) => 2,
        (false, false) => 4,
    }
}

impl Actor for Renderer {
    type Msg = RendererMessage;
    const NAME: &'static str = "renderer";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, message: RendererMessage, cx: &mut Cx<'_, RendererMessage>) {
        match message {
            RendererMessage::Input(RendererInput::FrameBegan { frame: _, camera, time }) => {
                self.on_frame_began(camera, time, cx)
            }
            RendererMessage::Input(RendererInput::DeadlineReached { frame }) => {
                self.on_deadline_reached(frame, cx)
            }
            RendererMessage::Input(RendererInput::Adjusted(adjustment)) => self.on_adjusted(adjustment, cx),
            RendererMessage::Input(RendererInput::Left) => self.on_left(cx),
            RendererMessage::SamplesAged { view, samples, expired, hash: _ } => {
                self.on_samples_aged(view, samples, expired, cx);
            }
            RendererMessage::SamplesTraced { batch, tracer, hash: _ } => {
                self.on_samples_traced(batch, tracer, cx)
            }
            RendererMessage::GuidesTraced { guides, hash: _ } => self.on_guides_traced(guides, cx),
            RendererMessage::EnvironmentChanged { object, map, hash: _ } => {
                self.on_environment_changed(object, map);
            }
            RendererMessage::TextureChanged { texture, finest, texels } => {
                self.waiting.push_back(TextureChange { texture, finest, texels });
            }
            RendererMessage::ViewConverged { view } => self.on_view_converged(view),
            RendererMessage::TileSampled { view, sums, hash: _ } => self.on_tile_sampled(view, sums),
            RendererMessage::RefinedShown { view, settled, hash: _ } => self.on_refined_shown(view, settled),
            RendererMessage::ViewRefined { view } => self.refined |= view == self.view,
            RendererMessage::Illuminated { map: light, last, hash: _ } => {
                self.target = Some(Growth { light, last, left: None });
            }
            RendererMessage::SamplesForgotten => self.on_samples_forgotten(cx),
            RendererMessage::SendAgain => self.outbox.send(cx),
            RendererMessage::SamplesDoubted => self.on_samples_doubted(cx),
        }
    }

    fn content(&self) -> Content {
        self.told()
    }

    fn save(&self, saver: &mut Saver) {
        self.save_state(saver);
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.restore_state(loader)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Under more and more load, and less and less again: it changes twice each way, and not at the same place.
    #[test]
    fn what_is_drawn_coarsely_stays_so_until_there_is_time() {
        let load = (1..=40).chain((1..40).rev()).map(|load| load as f32 * 0.05);
        let mut before = 1;
        let cells: Vec<(f32, u32)> = load
            .map(|load| {
                before = cell_for(0.1, [0.08 * load, 0.1 * load], before);
                (load, before)
            })
            .collect();
        let changes: Vec<[u32; 2]> =
            cells.windows(2).map(|pair| [pair[0].1, pair[1].1]).filter(|[a, b]| a != b).collect();
        assert_eq!(changes, [[1, 2], [2, 4], [4, 2], [2, 1]]);
        assert!(cells.iter().all(|(load, cell)| *cell == 4 || *load <= COARSE_FROM));
        assert!(cells.iter().all(|(load, cell)| *cell != 4 || *load > COARSE_UNTIL));
        // What takes no time that can be told is drawn whole, and what was never measured as well.
        assert_eq!([cell_for(0.0, [0.0; 2], 4), cell_for(0.1, [0.0, 1.0], 1)], [1, 1]);
    }
}
