//! Levels of textures that come and go while one walks.

use std::sync::Arc;

use foveal::scene::texture::LevelTexels;
use foveal_runtime::Cx;

use super::Renderer;
use crate::message::{AllocatorMessage, RendererMessage};

/// Bytes of textures that one frame takes at most, if more than one level waits.
const TEXTURE_BYTES_PER_FRAME: usize = 4 << 20;

/// A texture that will have another finest level.
pub(super) struct TextureChange {
    pub texture: u32,
    pub finest: u32,
    /// The finest level, where it is one more.
    pub texels: Option<LevelTexels>,
}

impl Renderer {
    /// Takes as many changes of textures as a frame has time for. Whether there was one.
    pub(super) fn change_textures(&mut self) -> bool {
        let (mut bytes, mut changed) = (0, false);
        let mut textures = Vec::new();
        while let Some(change) = self.waiting.front() {
            bytes += change.texels.as_ref().map_or(0, |texels| texels.as_bytes().len());
            if changed && bytes > TEXTURE_BYTES_PER_FRAME {
                break;
            }
            if !changed {
                textures.clone_from(&self.world.scene.textures);
            }
            changed = true;
            let Some(change) = self.waiting.pop_front() else { break };
            if change.texels.is_none() {
                self.releasing = true;
                self.drops += 1;
            }
            let Some(texture) = textures.get_mut(change.texture as usize) else { continue };
            let mips = match change.texels {
                Some(texels) => texture.mips.with_finer(texels),
                None => Some(texture.mips.without_finer(change.finest as usize)),
            };
            if let Some(mips) = mips {
                texture.mips = Arc::new(mips);
            }
        }
        if changed {
            let world = self.world.with_resident(textures);
            let before = std::mem::replace(&mut self.world, world);
            self.former.push(Arc::downgrade(&before.scene));
        }
        changed
    }

    /// Tells the allocator once nobody holds what was dropped: neither a view that was shown, nor a job, nor a window.
    pub(super) fn look_for_former(&mut self, cx: &mut Cx<'_, RendererMessage>) {
        if !self.releasing {
            return;
        }
        self.retired.retain(|view| Arc::ptr_eq(&view.world.scene, &self.world.scene));
        let held = self.former.iter().skip(1).filter(|scene| scene.strong_count() > 0).count();
        // Who still holds what is a fact of the moment, so it is recorded.
        let held = cx.observe(held as u64);
        if let (0, Some(neighbours)) = (held, &self.neighbours) {
            // The first scene, which others keep for good, has nothing that was ever dropped.
            self.former.truncate(1);
            self.releasing = false;
            let released = AllocatorMessage::TexturesReleased { drops: self.drops };
            self.outbox.tell(cx, &neighbours.allocator, released);
        }
    }
}
