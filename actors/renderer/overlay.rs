//! Overlays: what the machine decided, painted over the picture. On the processor; `compose.wgsl`
//! is the GPU pass.

use foveal::display::FrameBuffers;
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::math;
use foveal::splatting::SplatLayer;
use foveal::splatting::supersampling::TILE;
use foveal::splatting::tile_sums::TileSums;
use glam::Vec3;

/// What is painted over the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum Overlay {
    /// Nothing.
    #[default]
    None = 0,
    /// How much the eye is drawn to each object that is corrected.
    Saliency = 1,
    /// Object ids, a colour each.
    Objects = 2,
    /// Level of the sample that each pixel shows: white is its own ray, dark a coarse one.
    Level = 3,
    /// Views since the shown sample was traced: green is this view.
    Age = 4,
    /// Which tracer made the shown sample.
    Tracer = 5,
    /// Mip level wanted: white is full size.
    Mip = 6,
    /// How much the task draws the eye to each object: its size and place (Haber 2001 §3).
    Importance = 7,
    /// Which object the next samples go to: white first.
    Priority = 8,
    /// Estimated error that each object shows still: white is four just noticeable differences and more, the middle
    /// is one. In tiles that are
    /// refined, the standard error of displayed values: white is a tenth of their range.
    Error = 9,
    /// Mip level given: wanted, or the finest in memory where that is coarser.
    MipGiven = 10,
}

impl Overlay {
    /// All, in the order of the keys that choose them.
    pub const ALL: [Self; 11] = [
        Self::None,
        Self::Saliency,
        Self::Importance,
        Self::Priority,
        Self::Error,
        Self::Level,
        Self::Age,
        Self::Tracer,
        Self::Objects,
        Self::Mip,
        Self::MipGiven,
    ];

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Saliency => "saliency",
            Self::Objects => "object ids",
            Self::Level => "sample level",
            Self::Age => "sample age",
            Self::Tracer => "tracer",
            Self::Mip => "mip wanted",
            Self::Importance => "importance",
            Self::Priority => "priority",
            Self::Error => "error",
            Self::MipGiven => "mip given",
        }
    }

    /// What it shows, in a sentence for people, with the paper's term and section where it has one.
    pub fn help(self) -> &'static str {
        match self {
            Self::None => "The picture alone",
            Self::Saliency => {
                "How much each object draws the eye, by contrast and colour (saliency, Haber 2001 §3)"
            }
            Self::Importance => {
                "How much each object matters to the task, by its size and place in the picture (importance, Haber 2001 §3)"
            }
            Self::Priority => {
                "Which object gets the next samples; white comes first (priority, Haber 2001 §4.4)"
            }
            Self::Error => {
                "Visible error each object is estimated to have left (ε, Dumont 2003, Eq. (2)); while a view is \
                 refined, the standard error of each tile"
            }
            Self::Level => {
                "Level of the sample each pixel shows; white is the pixel's own ray (l, Haber 2001 §4.3)"
            }
            Self::Age => {
                "Views since the sample shown was traced; green is from the current view (age, Haber 2001 §4.5)"
            }
            Self::Tracer => "Which tracer made the sample each pixel shows, one colour per tracer",
            Self::Objects => {
                "Objects, which are corrected one by one, in a colour each (ids, Haber 2001 §4.1)"
            }
            Self::Mip => {
                "Texture level each pixel asks for; white is full size (mip level, Dumont 2003 §5.2.4.1)"
            }
            Self::MipGiven => {
                "Texture level each pixel gets: the one it asks for, or the finest in memory (Dumont 2003 §5.2.4)"
            }
        }
    }
}

/// Colour of samples that were traced for this view.
pub const AGE_FRESH: Vec3 = Vec3::new(0.0, 0.6, 0.2);

/// A colour per number, far from those of its neighbours. Display values in [0, 1].
pub fn distinct(n: u32) -> Vec3 {
    let hue = (n.wrapping_mul(40503) & 0xffff) as f32 / 65536.0;
    let k = (Vec3::splat(hue) + Vec3::new(0.0, 2.0, 1.0) / 3.0).fract() * 6.0 - 3.0;
    let pure = (k.abs() - 1.0).clamp(Vec3::ZERO, Vec3::ONE);
    Vec3::ONE.lerp(pure, 0.75) * (0.6 + 0.4 * (n.wrapping_mul(7) % 5) as f32 / 4.0)
}

/// Black, blue, red, yellow, white for values from 0 to 1. Display values in [0, 1].
pub fn heat(v: f32) -> Vec3 {
    let t = v.clamp(0.0, 1.0) * 4.0;
    let blue = if t > 2.0 { t - 3.0 } else { 1.0 - (t - 1.0).abs() };
    Vec3::new(t - 1.0, t - 2.0, blue).clamp(Vec3::ZERO, Vec3::ONE)
}

/// What an overlay shows.
#[derive(Clone, Copy, Debug)]
pub struct Sources<'a> {
    /// Buffers of the view.
    pub buffers: &'a FrameBuffers,
    /// Splat layer of the view.
    pub splats: &'a SplatLayer,
    /// K of the lattice.
    pub k_max: u32,
    /// What the overlay shows of each object, in [0, 1], by object id; of [`Overlay::MipGiven`] the finest level in
    /// memory, by texture.
    pub values: &'a [f32],
    /// [`tile_error`] of each tile that is refined; NaN or absent for others.
    pub tile_errors: &'a [f32],
}

/// The error of a refined tile as overlays show it, in [0, 1].
pub fn tile_error(tile: &TileSums, tone: &ToneMap) -> f32 {
    let [rms, _] = tile.error(tone);
    (rms * 10.0).min(1.0)
}

/// The picture with an overlay; `rgb8` is the picture without.
pub fn paint(overlay: Overlay, sources: &Sources<'_>, rgb8: &Map2d<[u8; 3]>) -> Map2d<[u8; 3]> {
    if overlay == Overlay::None {
        return rgb8.clone();
    }
    Map2d::from_fn(rgb8.width(), rgb8.height(), |x, y| {
        let shown = Vec3::from(rgb8.at(x, y).map(|b| f32::from(b) / 255.0));
        let grey = Vec3::splat(foveal::image::luminance(shown) * 0.5);
        let color = overlay_color(overlay, sources, x, y, grey).unwrap_or(grey);
        color.to_array().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8)
    })
}

fn overlay_color(overlay: Overlay, sources: &Sources<'_>, x: usize, y: usize, grey: Vec3) -> Option<Vec3> {
    let object = sources.buffers.object.at(x, y);
    let tinted = |color: Vec3| grey.lerp(color, 0.7);
    match overlay {
        Overlay::None => None,
        Overlay::Error if let Some(error) = tile_error_at(sources, x, y) => Some(tinted(heat(error))),
        Overlay::Saliency | Overlay::Importance | Overlay::Priority | Overlay::Error if object == 0 => None,
        Overlay::Saliency | Overlay::Importance | Overlay::Priority | Overlay::Error => {
            sources.values.get(object as usize).map(|a| tinted(heat(*a)))
        }
        Overlay::Objects => (object != 0).then(|| tinted(distinct(object))),
        Overlay::Level => {
            let (k, _) = sources.splats.shown_level(x, y)?;
            Some(heat(1.0 - k as f32 / (sources.k_max + 1) as f32))
        }
        Overlay::Age => Some(match sources.splats.shown_age(x, y)? {
            0 => AGE_FRESH,
            age => heat(math::log2(age as f32 + 1.0) / 6.0),
        }),
        Overlay::Tracer => match sources.splats.source(x, y) {
            0 => None,
            source => Some(tinted(distinct(u32::from(source)))),
        },
        Overlay::Mip | Overlay::MipGiven => {
            let words = &sources.buffers.texture;
            let word = words.data().get(y * words.width() + x)?;
            let texture = word.texture()?;
            let finest = match overlay {
                Overlay::MipGiven => sources.values.get(texture.0 as usize).copied().unwrap_or(0.0),
                _ => 0.0,
            };
            Some(tinted(heat(1.0 - word.level().max(finest) / 8.0)))
        }
    }
}

fn tile_error_at(sources: &Sources<'_>, x: usize, y: usize) -> Option<f32> {
    let columns = sources.buffers.width().div_ceil(TILE as usize);
    let tile = y / TILE as usize * columns + x / TILE as usize;
    sources.tile_errors.get(tile).copied().filter(|error| !error.is_nan())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_numbers_differ_and_stay_in_range() {
        for n in 0..1000 {
            let (a, b) = (distinct(n), distinct(n + 1));
            assert!((a - b).length() > 0.2, "{n}: {a} {b}");
            assert!(a.min_element() >= 0.0 && a.max_element() <= 1.0);
        }
    }

    #[test]
    fn heat_grows_brighter() {
        let steps: Vec<f32> = (0..=20).map(|i| heat(i as f32 / 20.0).element_sum()).collect();
        assert!(steps.windows(2).all(|w| w[1] >= w[0] - 1e-6), "{steps:?}");
        assert_eq!((heat(0.0), heat(1.0)), (Vec3::ZERO, Vec3::ONE));
    }
}
