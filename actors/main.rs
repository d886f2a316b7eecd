//! The program `foveal`.
fn main() {}
