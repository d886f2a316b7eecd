//! What a walk cannot take up while it goes on, and so begins anew for: its files read again, pictures of another size,
//! other lamps. Camera, bookmarks and controls stay; a recording goes on in another file.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::edit::SceneEdit;
use crate::engine::Engine;
use crate::opened::Opened;
use crate::source::{Build, FrameSource};

/// Why a walk begins anew.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Its files are read again; lamps are as these say.
    Reload,
    /// Its pictures have so many columns and rows.
    Size([u32; 2]),
    /// Its scene is another one.
    Edit(SceneEdit),
}

impl Change {
    /// Whether nothing is left of `other` after this one.
    pub fn replaces(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Reload, Self::Reload | Self::Edit(_)) | (Self::Size(_), Self::Size(_)) => true,
            (Self::Edit(edit), Self::Edit(other)) => edit.replaces(other),
            _ => false,
        }
    }

    /// What to tell people once it is done.
    pub fn told(&self) -> String {
        match self {
            Self::Reload => "the scene was read again".to_owned(),
            Self::Size([width, height]) => format!("pictures have {width} × {height} pixels now"),
            Self::Edit(_) => "the scene is lit anew".to_owned(),
        }
    }
}

/// Begins the walk that takes the place of one with pictures of this size that is made of this, after a change. Called
/// [apart] from the walk, which goes on meanwhile.
pub type Changer = Arc<dyn Fn(Change, Opened, [u32; 2]) -> Result<Build, String> + Send + Sync>;

/// A walk that has begun.
pub struct Begun {
    /// The walk.
    pub source: Box<dyn FrameSource>,
    /// What changes it; a recording has none.
    pub changer: Option<Changer>,
}

impl From<Box<dyn FrameSource>> for Begun {
    fn from(source: Box<dyn FrameSource>) -> Self {
        Self { source, changer: None }
    }
}

impl From<Engine> for Begun {
    fn from(engine: Engine) -> Self {
        let source: Box<dyn FrameSource> = Box::new(engine);
        source.into()
    }
}

/// Does `work` on threads of its own, which give way. On those that all share each frame would wait until they have done
/// all that was begun there before, however long that takes.
///
/// # Errors
/// What went wrong, if it panics with that.
pub fn apart<T: Send>(work: impl FnOnce() -> Result<T, String> + Send) -> Result<T, String> {
    let threads = rayon::ThreadPoolBuilder::new()
        .thread_name(|i| format!("loader-{i}"))
        .start_handler(|_| foveal_runtime::give_way())
        .build();
    let work = || match threads {
        Ok(threads) => threads.install(work),
        Err(_) => work(),
    };
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err("loading the scene failed unexpectedly".into()))
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::thread;

    use foveal::scene::edit::Lamp;
    use glam::Vec3;

    use super::*;

    #[test]
    fn what_is_loaded_leaves_alone_the_threads_that_frames_are_drawn_on() {
        let here = || rayon::broadcast(|_| thread::current().id());
        let shared: HashSet<_> = here().into_iter().collect();
        let own = apart(|| Ok(here())).expect("threads");
        assert!(!own.is_empty() && own.iter().all(|id| !shared.contains(id)));
        assert!(apart(|| -> Result<(), String> { panic!("as a reader would") }).is_err());
    }

    #[test]
    fn the_newer_change_of_a_thing_is_enough() {
        let dim = |i| Change::Edit(SceneEdit::LampDimmed { lamp: Lamp::Light(i), gain: Vec3::ZERO });
        assert!(Change::Size([2, 2]).replaces(&Change::Size([4, 4])) && dim(1).replaces(&dim(1)));
        assert!(!dim(1).replaces(&dim(2)) && !dim(1).replaces(&Change::Reload));
        // What is read again has lamps as the files say.
        assert!(Change::Reload.replaces(&dim(1)) && !Change::Reload.replaces(&Change::Size([2, 2])));
    }
}
