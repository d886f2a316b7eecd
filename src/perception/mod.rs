//! Models of the human eye, on maps.
//!
//! Attention: [`saliency`] (bottom-up, Itti 1998) and [`importance`] (top-down, Haber 2001 §3) rank
//! objects. Visibility (Dumont 2003 §5.2.3): [`tvi`], [`csf`], [`masking`] and [`elevation`] say how large an error
//! must be to be seen, [`color_difference`] how large it is, [`viewing`] what the display makes of a value.
//!
//! In: pictures, object ids, luminance in cd/m². Out: saliency, importance and threshold elevation without
//! unit, thresholds in cd/m². Nothing here knows rays or textures.

pub mod color_difference;
pub mod csf;
pub mod elevation;
pub mod importance;
pub mod masking;
pub mod pyramid;
pub mod saliency;
pub mod tvi;
pub mod viewing;
