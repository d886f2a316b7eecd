//! The five actors of foveal, their messages and wiring.
