//! Pictures made of others, texel by texel.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::image::srgb_byte_from_linear;
use crate::scene::texture::MipChain;
use crate::scene::{Texture, TextureId};

/// A map of normals that lean `scale` times as far.
pub(super) fn lean(map: TextureId, scale: f32, textures: &mut Vec<Texture>) -> TextureId {
    let of = &textures[map.0 as usize];
    let [w, h] = of.size(0);
    let texel = |i: usize| {
        let [x, y, z, _] = of.texel(0, i % w, i / w).map(|v| 2.0 * v - 1.0);
        let n = Vec3::new(x * scale, y * scale, z).try_normalize().unwrap_or(Vec3::Z);
        let [x, y, z] = n.to_array().map(|v| ((0.5 * v + 0.5) * 65_535.0 + 0.5) as u16);
        [x, y, z, u16::MAX]
    };
    let texels = (0..w * h).into_par_iter().map(texel).collect();
    let mips = Arc::new(MipChain::from_rgba16(w, h, texels));
    let texture = Texture { name: format!("{} (leaning)", of.name), mips, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// A map whose colours are multiplied by its alpha.
pub(super) fn premultiplied(map: TextureId, textures: &mut Vec<Texture>) -> TextureId {
    let of = &textures[map.0 as usize];
    let [w, h] = of.size(0);
    let texel = |i: usize| {
        let [r, g, b, a] = of.texel(0, i % w, i / w);
        encoded(Vec3::new(r, g, b) * a, a)
    };
    let texels = (0..w * h).into_par_iter().map(texel).collect();
    let mips = Arc::new(MipChain::from_rgba8(w, h, texels, true));
    let texture = Texture { name: format!("{} (veil)", of.name), mips, is_color: true, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// Linear colours and an alpha as they are stored.
pub(super) fn encoded(c: Vec3, alpha: f32) -> [u8; 4] {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    // Not by `map`, which is called for each and not written out.
    let color = srgb_byte_from_linear;
    [color(c.x), color(c.y), color(c.z), byte(alpha)]
}
