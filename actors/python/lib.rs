//! Foveal for Python. What Python sees is described in `foveal/_foveal.pyi`; this is how it comes about.
//!
//! An [`Engine`](foveal_engine::Engine) and a replay belong to the thread that began them. Here that is a thread of their own
//! (`beside`): whichever Python thread asks waits for the answer without the interpreter's lock, so that others go on, and
//! looks for Ctrl-C meanwhile.
//!
//! `pyo3`'s macros write the `unsafe` of the C interface into their expansions, which allow it themselves; there is none in
//! these files.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

mod bake;
mod beside;
mod camera;
mod compare;
mod failure;
mod frame;
mod pictures;
mod reference;
mod replay;
mod walk;

use pyo3::prelude::*;

/// The native part of the package `foveal`.
#[pymodule]
mod _foveal {
    #[pymodule_export]
    use crate::bake::{Bake, bake};
    #[pymodule_export]
    use crate::camera::{Camera, Path};
    #[pymodule_export]
    use crate::compare::{Comparison, compare};
    #[pymodule_export]
    use crate::failure::Error;
    #[pymodule_export]
    use crate::frame::Frame;
    #[pymodule_export]
    use crate::reference::{Reference, reference};
    #[pymodule_export]
    use crate::replay::{Replay, replay};
    #[pymodule_export]
    use crate::walk::{Walk, open};

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
