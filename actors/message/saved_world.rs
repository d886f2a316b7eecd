//! Worlds in snapshots of a replay: scene, light and textures are named by what they are, and only light between two
//! published maps is held.

use std::any::Any;
use std::sync::Arc;

use foveal::illumination::stored::Illumination;
use foveal::scene::texture::MipChain;
use foveal::scene::{Scene, Texture};
use foveal::world::World;
use foveal_runtime::{Loader, Saver};

use super::saved::{Saved, Surroundings};

/// The light that the walk began with.
const AS_IT_BEGAN: u8 = 0;
/// Another one.
const GROWN: u8 = 1;

/// Where a map is found again.
#[derive(serde::Serialize, serde::Deserialize)]
enum Light {
    /// In the book, by this hash.
    Published(u64),
    /// Here: against the book's first map, or by itself.
    Held { against_first: bool },
}

impl Saved for Arc<Illumination> {
    fn save(&self, saver: &mut Saver) {
        let book = saver.context::<Surroundings>().and_then(|surroundings| surroundings.book.clone());
        saver.shared(self, |map, saver| {
            let digest = map.digest();
            let Some(book) = book else { return saver.refuse() };
            if book.has(digest) {
                return saver.put(&Light::Published(digest));
            }
            let Some((against_first, bytes)) = book.pack(map) else { return saver.refuse() };
            saver.put(&Light::Held { against_first });
            saver.bytes(&bytes);
        });
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.shared(|loader| {
            let book = loader.context::<Surroundings>()?.book.clone()?;
            match loader.take()? {
                Light::Published(digest) => book.with_digest(digest),
                Light::Held { against_first } => book.unpack(against_first, loader.bytes()?),
            }
        })
    }
}

impl Saved for World {
    /// Geometry, lights and materials are those of the surroundings.
    fn save(&self, saver: &mut Saver) {
        let Self { scene, illumination, .. } = self;
        let Some(surroundings) = saver.context::<Surroundings>() else { return saver.refuse() };
        let began = &surroundings.world;
        if std::ptr::addr_eq(Arc::as_ptr(illumination), Arc::as_ptr(&began.illumination)) {
            saver.put(&AS_IT_BEGAN);
        } else {
            let light: Arc<dyn Any + Send + Sync> = Arc::clone(illumination) as _;
            let Ok(map) = light.downcast::<Illumination>() else { return saver.refuse() };
            saver.put(&GROWN);
            map.save(saver);
        }
        saver.put(&Arc::ptr_eq(scene, &began.scene));
        if !Arc::ptr_eq(scene, &began.scene) {
            saver.shared(scene, |scene, saver| {
                for (texture, began) in scene.textures.iter().zip(&began.scene.textures) {
                    saver.put(&Arc::ptr_eq(&texture.mips, &began.mips));
                    if !Arc::ptr_eq(&texture.mips, &began.mips) {
                        saver.shared(&texture.mips, |mips, saver| saver.put(&(mips.finest() as u64)));
                    }
                }
            });
        }
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        let surroundings = loader.context::<Surroundings>()?;
        let mut world = surroundings.world.clone();
        if loader.take::<u8>()? == GROWN {
            world = world.with_illumination(Arc::<Illumination>::restore(loader)?);
        }
        let is_as_it_began: bool = loader.take()?;
        if !is_as_it_began {
            world.scene = loader.shared(|loader| scene(loader, &surroundings))?;
        }
        Some(world)
    }
}

/// The scene with the levels of textures that it had, which are read again.
fn scene(loader: &mut Loader<'_>, surroundings: &Surroundings) -> Option<Scene> {
    let store = surroundings.textures.as_ref()?;
    let began = &surroundings.world.scene;
    let textures: Option<Vec<Texture>> = began
        .textures
        .iter()
        .enumerate()
        .map(|(number, texture)| {
            let is_as_it_began: bool = loader.take()?;
            if is_as_it_began {
                return Some(texture.clone());
            }
            let mips: Arc<MipChain> = loader.shared(|loader| {
                let finest = usize::try_from(loader.take::<u64>()?).ok()?;
                store.refined(number, &texture.mips, finest)
            })?;
            Some(Texture { mips, ..texture.clone() })
        })
        .collect();
    Some(began.with_resident(textures?))
}
