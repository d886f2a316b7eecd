//! What maps and textures have in common: decisions about memory that take longer than a turn may, made in portions.

use std::time::Duration;

use foveal_runtime::Cx;

use super::Allocator;
use crate::message::{AllocatorMessage, RendererMessage};
use crate::stages::Stage;

/// Work of one portion of a decision about maps and textures ([`foveal::allocation::search`]): some 50 µs.
pub const WORK_AT_ONCE: u64 = 1500;
/// Time between two portions: a frame of a fast display.
const BETWEEN_PORTIONS: Duration = Duration::from_millis(16);

impl Allocator {
    pub(super) fn on_decide_on(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        self.portion_waits = false;
        self.decide(cx);
        self.fill_pool(cx);
    }

    /// Goes on with decisions about maps and textures: one portion, the next after a while.
    pub(super) fn decide(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        if !self.portion_waits {
            self.decide_for(WORK_AT_ONCE, cx);
            if self.is_deciding() {
                self.portion_waits = cx.after(BETWEEN_PORTIONS, AllocatorMessage::DecideOn).is_ok();
                if !self.portion_waits {
                    // Nobody will say when to go on.
                    self.decide_for(u64::MAX, cx);
                }
            }
        }
        self.change_textures(cx);
    }

    fn is_deciding(&self) -> bool {
        let textures = self.textures.as_ref().is_some_and(|t| t.residency().is_deciding());
        textures || self.environments.is_deciding()
    }

    fn decide_for(&mut self, mut work: u64, cx: &mut Cx<'_, AllocatorMessage>) {
        let stages = self.stages.clone();
        let dropped = stages.time(Stage::Allocate, || {
            let dropped = self.environments.go_on(&mut work);
            if let Some(textures) = &mut self.textures {
                textures.go_on(&mut work);
            }
            dropped
        });
        for object in dropped {
            let changed = RendererMessage::EnvironmentChanged { object, map: None, hash: 0 };
            self.outbox.tell(cx, &self.renderer, changed);
        }
    }
}
