//! Pictures made of others, texel by texel.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use foveal::image::SrgbSteps;
use foveal::scene::texture::Pixels;
use foveal::scene::texture::{MipChain, complete};
use foveal::scene::{Texture, TextureId};

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
    let mips = Arc::new(MipChain::alone(w, h, Pixels::Word(texels)));
    let texture = Texture { name: format!("{} (leaning)", of.name), mips, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// A map whose colours are multiplied by its alpha.
pub(super) fn premultiplied(map: TextureId, textures: &mut Vec<Texture>) -> TextureId {
    let of = &textures[map.0 as usize];
    let ([w, h], steps) = (of.size(0), SrgbSteps::shared());
    let texel = |i: usize| {
        let [r, g, b, a] = of.texel(0, i % w, i / w);
        encoded(Vec3::new(r, g, b) * a, a, steps)
    };
    let texels = (0..w * h).into_par_iter().map(texel).collect();
    let mips = Arc::new(MipChain::alone(w, h, Pixels::Byte { texels, gamma: true }));
    let texture = Texture { name: format!("{} (veil)", of.name), mips, is_color: true, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// Linear colours and an alpha as they are stored.
#[inline]
pub(super) fn encoded(c: Vec3, alpha: f32, steps: &SrgbSteps) -> [u8; 4] {
    let alpha = (alpha.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    [steps.byte(c.x), steps.byte(c.y), steps.byte(c.z), alpha]
}

/// The mean of a map, for which it and those that share its picture get all of their levels.
pub(super) fn mean_of(map: TextureId, textures: &mut [Texture]) -> [f32; 4] {
    let mips = textures[map.0 as usize].mips.clone();
    if !mips.is_complete() {
        complete(textures, |t| Arc::ptr_eq(&t.mips, &mips));
    }
    textures[map.0 as usize].mean()
}
