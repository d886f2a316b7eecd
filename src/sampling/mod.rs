//! Where samples go: the √5 lattice on the picture plane and low-discrepancy points in the unit cube.

pub mod sqrt5;

pub use sqrt5::{Cursor, Lattice, Rect};
