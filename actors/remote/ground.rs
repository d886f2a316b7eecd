//! What a guest does pieces of work with: made of the scene that it has, the task that it is told, and the light that comes
//! with that.

use std::sync::{Arc, OnceLock};

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::illumination::bake::{BakeSettings, Baker};
use foveal::illumination::stored::Illumination;
use foveal::scene::camera::CameraFrame;
use foveal::transport::bidirectional::{Bidirectional, Photons};
use foveal::transport::light::bright::BrightSurfaces;
use foveal::world::World;
use foveal_actors::station::wire::SIDE_MAX;
use foveal_engine::batch::{Ground, Picture, Piece, Task};

use crate::work::VIEW_PIXELS_MAX;

/// Texels of a bake that is helped with.
const TEXELS_MAX: u32 = 1 << 26;

/// Photons of a pass, once somebody needed them.
pub type Pass = Arc<OnceLock<Arc<Photons>>>;

/// What pieces are done with.
pub struct OwnGround {
    /// Names it.
    pub number: u32,
    world: World,
    of: Of,
}

enum Of {
    Picture { frame: CameraFrame, seed: u64, base: Option<FrameBuffers> },
    Bake { baker: Arc<Baker>, settings: BakeSettings, map: Illumination, bright: OnceLock<BrightSurfaces> },
}

impl OwnGround {
    /// Of a task in a scene, under this light. A bake's elements are those of the ground `before`, where it is the same bake.
    ///
    /// # Errors
    /// If nobody could mean that, or it is too large for here.
    pub fn new(
        number: u32,
        world: &World,
        task: Task,
        map: Option<Illumination>,
        before: Option<&Self>,
    ) -> Result<Self, String> {
        let scene = &world.scene;
        if let Some(map) = &map
            && (!map.is_sound() || map.triangle_count() != scene.mesh.triangles.len())
        {
            return Err("light of another scene".into());
        }
        let (world, of) = match task {
            Task::Picture { frame, seed } => {
                let vectors = [frame.eye, frame.forward, frame.right, frame.up];
                let sizes = frame.size.iter().all(|side| (1..=SIDE_MAX).contains(side));
                if !sizes || vectors.iter().any(|vector| !vector.is_finite()) {
                    return Err("a picture that cannot be".into());
                }
                let pixels = frame.size.map(u64::from).iter().product::<u64>();
                let is_lit = map.is_some() && pixels <= VIEW_PIXELS_MAX;
                let world = match map {
                    Some(map) => world.with_illumination(Arc::new(map)),
                    None => world.clone(),
                };
                let base = is_lit.then(|| {
                    let mut base = FrameBuffers::new(frame.size[0] as usize, frame.size[1] as usize);
                    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut base);
                    base
                });
                (world, Of::Picture { frame, seed, base })
            }
            Task::Bake(settings) => {
                if settings.texels > TEXELS_MAX {
                    return Err("a bake of more elements than can be".into());
                }
                let baker = match before.map(|ground| &ground.of) {
                    Some(Of::Bake { baker, settings: known, .. }) if *known == settings => Arc::clone(baker),
                    _ => Arc::new(Baker::new(world.indexed(), &settings)),
                };
                let map = map.filter(|map| map.element_count() == baker.atlas().elements.len());
                let map = map.ok_or("a bake without light, or of other elements")?;
                (world.clone(), Of::Bake { baker, settings, map, bright: OnceLock::new() })
            }
        };
        Ok(Self { number, world, of })
    }

    /// Does something with it, where a pass's photons are these.
    pub fn with<T>(&self, photons: &Pass, what: impl FnOnce(&Ground<'_>) -> T) -> T {
        match &self.of {
            Of::Picture { frame, seed, base } => {
                let photons = |paths: &Bidirectional<'_>, pass: u64| {
                    Arc::clone(photons.get_or_init(|| Arc::new(paths.photons(*seed, pass))))
                };
                let (world, base) = (&self.world, base.as_ref());
                what(&Ground::Picture(Picture { world, frame, seed: *seed, base, photons: &photons }))
            }
            Of::Bake { baker, settings, map, bright } => {
                what(&Ground::Bake { baker, indexed: self.world.indexed(), map, bright, settings })
            }
        }
    }

    /// Whether a piece is of this ground.
    pub fn has(&self, piece: &Piece) -> bool {
        self.with(&Pass::default(), |ground| ground.has(piece))
    }
}
