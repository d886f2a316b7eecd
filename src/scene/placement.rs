//! How a picture lies on surfaces: which coordinates it is read at, and what is beyond its edges.

use glam::Vec2;

use crate::math;

/// What lies beyond the edge of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum Wrap {
    /// The picture again.
    #[default]
    Repeat,
    /// Its outermost texels.
    Clamp,
    /// The picture again, every other time turned round.
    Mirror,
}

impl Wrap {
    /// A coordinate as one of the picture, in [0, 1].
    #[inline]
    fn fold(self, v: f32) -> f32 {
        match self {
            Self::Repeat => v - math::floor(v),
            Self::Clamp => v.clamp(0.0, 1.0),
            Self::Mirror => {
                let v = v - 2.0 * math::floor(0.5 * v);
                if v > 1.0 { 2.0 - v } else { v }
            }
        }
    }

    /// Column (or row) `i` of `n`, at most one beyond either edge.
    #[inline]
    pub(super) fn texel(self, i: i32, n: i32) -> usize {
        let repeats = self == Self::Repeat;
        let i = if i < 0 {
            if repeats { n - 1 } else { 0 }
        } else if i >= n {
            if repeats { 0 } else { n - 1 }
        } else {
            i
        };
        i as usize
    }
}

/// How a texture lies on surfaces. By default it repeats and is read at the mesh's own coordinates.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Placement {
    /// Beyond the left and right edges, and beyond the lower and upper ones.
    pub wrap: [Wrap; 2],
    /// Scale (two numbers) and offset (two numbers) of the coordinates (`-s`, `-o`), origin at the lower left.
    pub scale_offset: [f32; 4],
    /// What v adds to u, and u to v, before the offset: where a picture is turned.
    pub shear: [f32; 2],
    /// Which set of coordinates: the mesh's first, else its second ([`super::Mesh::uvs1`]).
    pub second: bool,
    /// The nearest texel alone is shown where the picture is seen from so near that texels are larger than pixels.
    pub nearest: bool,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            wrap: [Wrap::Repeat; 2],
            scale_offset: [1.0, 1.0, 0.0, 0.0],
            shear: [0.0; 2],
            second: false,
            nearest: false,
        }
    }
}

impl Placement {
    /// Repeated, or clamped at all edges.
    pub fn clamped(is: bool) -> Self {
        Self { wrap: [if is { Wrap::Clamp } else { Wrap::Repeat }; 2], ..Self::default() }
    }

    /// Position in [0, 1]² from the upper left, of coordinates from the lower left.
    #[inline]
    pub fn place(&self, uv: Vec2) -> Vec2 {
        let p = self.moved(uv);
        let p = Vec2::new(p.x, 1.0 - p.y);
        let p = match self.wrap {
            [Wrap::Repeat, Wrap::Repeat] => p - Vec2::new(math::floor(p.x), math::floor(p.y)),
            [u, v] => Vec2::new(u.fold(p.x), v.fold(p.y)),
        };
        if p.is_finite() { p } else { Vec2::ZERO }
    }

    /// Coordinates of the picture, origin at the lower left, before they are wrapped.
    #[inline]
    pub fn moved(&self, uv: Vec2) -> Vec2 {
        let [su, sv, ou, ov] = self.scale_offset;
        if self.shear == [0.0; 2] {
            return Vec2::new(uv.x * su + ou, uv.y * sv + ov);
        }
        let [from_v, from_u] = self.shear;
        Vec2::new(uv.x * su + uv.y * from_v + ou, uv.y * sv + uv.x * from_u + ov)
    }

    /// How many times longer a small step is in the picture's coordinates than in the mesh's, on average.
    #[inline]
    pub fn density(&self) -> f32 {
        let [su, sv, ..] = self.scale_offset;
        let [a, b] = self.shear;
        (su * sv - a * b).abs().sqrt()
    }

    /// Whether both show the same texels at the same places.
    pub fn agrees(&self, other: &Self) -> bool {
        Self { nearest: false, ..*self } == Self { nearest: false, ..*other }
    }

    /// What tells it from others, as bits.
    pub fn bits(&self) -> [u32; 7] {
        let [a, b, c, d] = self.scale_offset.map(f32::to_bits);
        let [e, f] = self.shear.map(f32::to_bits);
        let [u, v] = self.wrap.map(|w| w as u32);
        [a, b, c, d, e, f, u | v << 2 | u32::from(self.second) << 4 | u32::from(self.nearest) << 5]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_an_edge_repeats_stays_or_turns_back() {
        for (v, repeated, clamped, mirrored) in [
            (0.25, 0.25, 0.25, 0.25),
            (1.25, 0.25, 1.0, 0.75),
            (-0.25, 0.75, 0.0, 0.25),
            (2.25, 0.25, 1.0, 0.25),
        ] {
            let all = [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|w| w.fold(v));
            assert_eq!(all, [repeated, clamped, mirrored], "{v}");
        }
        let ends = |w: Wrap| [w.texel(-1, 4), w.texel(2, 4), w.texel(4, 4)];
        assert_eq!(ends(Wrap::Repeat), [3, 2, 0]);
        assert_eq!(ends(Wrap::Clamp), [0, 2, 3]);
        // The neighbour of an edge in the mirror is the edge.
        assert_eq!(ends(Wrap::Mirror), [0, 2, 3]);
    }

    #[test]
    fn axes_wrap_apart_and_a_turn_keeps_lengths() {
        let p = Placement { wrap: [Wrap::Clamp, Wrap::Mirror], ..Placement::default() };
        assert_eq!(p.place(Vec2::new(1.5, 1.25)), Vec2::new(1.0, 0.25));
        let turned =
            Placement { scale_offset: [0.0, 0.0, 0.0, 1.0], shear: [1.0, -1.0], ..Placement::default() };
        assert_eq!((turned.moved(Vec2::new(0.25, 0.5)), turned.density()), (Vec2::new(0.5, 0.75), 1.0));
        assert!(p.place(Vec2::new(f32::NAN, f32::INFINITY)).is_finite());
        assert!(
            p.bits() != turned.bits() && p.agrees(&Placement { nearest: true, ..p }) && !p.agrees(&turned)
        );
    }
}
