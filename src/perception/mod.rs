//! Models of the human eye, on maps.
//!
//! Attention: [`saliency`] (bottom-up, Itti 1998) and [`importance`] (top-down, Haber 2001 §3) rank
//! objects; [`selection`] turns ranks into an order.
//!
//! In: pictures, object ids. Out: saliency and importance, numbers without unit. Nothing here knows
//! scenes, rays or textures.

pub mod color_difference;
pub mod importance;
pub mod pyramid;
pub mod saliency;
pub mod selection;
