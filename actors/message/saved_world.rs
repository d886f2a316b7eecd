//! Worlds in snapshots of a replay: scene, light and textures are named by what they are, and only light between two
//! published maps is held.

use std::any::Any;
use std::sync::Arc;

use foveal::illumination::stored::Illumination;
use foveal::scene::texture::MipChain;
use foveal::scene::{Scene, Texture};
use foveal::world::World;
use foveal_runtime::{Loader, Saver};

use super::later_light::LaterLight;
use super::saved::{Saved, SnapshotContext};

/// The light that the walk began with.
const AS_IT_BEGAN: u8 = 0;
/// Another one.
const GROWN: u8 = 1;

impl Saved for World {
    /// Geometry, lights and materials are those of the context.
    fn save(&self, saver: &mut Saver) {
        let Self { scene, illumination, .. } = self;
        let Some(context) = saver.context::<SnapshotContext>() else { return saver.refuse() };
        let began = &context.world;
        if std::ptr::addr_eq(Arc::as_ptr(illumination), Arc::as_ptr(&began.illumination)) {
            saver.put(&AS_IT_BEGAN);
        } else {
            let light: Arc<dyn Any + Send + Sync> = Arc::clone(illumination) as _;
            saver.put(&GROWN);
            match light.downcast::<Illumination>() {
                Ok(map) => map.save(saver),
                Err(light) => match light.downcast::<LaterLight>() {
                    Ok(light) => light.save(saver),
                    Err(_) => return saver.refuse(),
                },
            }
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
        let context = loader.context::<SnapshotContext>()?;
        let mut world = context.world.clone();
        if loader.take::<u8>()? == GROWN {
            world = world.with_illumination(Arc::<LaterLight>::restore(loader)?);
        }
        let is_as_it_began: bool = loader.take()?;
        if !is_as_it_began {
            world.scene = loader.shared(|loader| scene(loader, &context))?;
        }
        Some(world)
    }
}

/// The scene with the levels of textures that it had, which are read again.
fn scene(loader: &mut Loader<'_>, context: &SnapshotContext) -> Option<Scene> {
    let store = context.textures.as_ref()?;
    let began = &context.world.scene;
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
