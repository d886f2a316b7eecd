//! Colours of texels that a mask cuts away.
//!
//! What lies in a picture beside a cut-out leaf is often white or black. Nobody sees it close by; but coarser levels of the
//! picture mix it with the leaf, and a distant leaf turns pale. So texels that are mostly cut away take the colour of those
//! around that are not: that of the smallest square of 2ᵏ × 2ᵏ texels that has some.

use std::collections::HashMap;
use std::sync::Arc;

use glam::Vec2;
use rayon::prelude::*;

use foveal::scene::{Material, Model, Placement, Reflectance, Texture, TextureId};

/// Texels that show less count as cut away.
const VISIBLE: f32 = 0.5;

/// Gives pictures of materials with a mask colours where it cuts them away. A picture that something else shows whole is
/// kept beside the new one.
pub fn recolor(materials: &mut [Material], textures: &mut Vec<Texture>) {
    let mut users: HashMap<TextureId, Vec<Option<TextureId>>> = HashMap::new();
    for m in materials.iter() {
        for id in pictures(m) {
            users.entry(id).or_default().push(m.opacity_map);
        }
    }
    let mut made: HashMap<(TextureId, TextureId), TextureId> = HashMap::new();
    for m in materials {
        let (Some(mask), Some(diffuse)) = (m.opacity_map, diffuse(&mut m.model)) else { continue };
        let Some(color) = diffuse.map else { continue };
        if let Some(id) = made.get(&(color, mask)) {
            diffuse.map = Some(*id);
            continue;
        }
        let (Some(picture), Some(cut)) = (textures.get(color.0 as usize), textures.get(mask.0 as usize))
        else {
            continue;
        };
        let Some(new) = recolored(picture, cut) else { continue };
        let alone = users.get(&color).is_none_or(|all| all.iter().all(|by| *by == Some(mask)));
        let id = if alone { color } else { TextureId(textures.len() as u32) };
        match textures.get_mut(id.0 as usize) {
            Some(old) => *old = new,
            None => textures.push(new),
        }
        made.insert((color, mask), id);
        diffuse.map = Some(id);
    }
}

/// All that a material reads but its mask.
fn pictures(m: &Material) -> impl Iterator<Item = TextureId> {
    let [a, b] = match &m.model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => [albedo.map, None],
        Model::Mirror { specular } | Model::Metal { specular, .. } => [specular.map, None],
        Model::CookTorrance { diffuse, specular, .. } | Model::Ward { diffuse, specular, .. } => {
            [diffuse.map, specular.map]
        }
        Model::MetalRough(m) => [m.diffuse.map, m.specular.map],
        Model::Conductor { .. } | Model::Dielectric { .. } => [None, None],
    };
    let others = [m.emission.map, m.bump_map, m.normal_map, m.tint.map];
    [a, b].into_iter().chain(others).flatten().chain(m.maps_by_point())
}

fn diffuse(model: &mut Model) -> Option<&mut Reflectance> {
    match model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => Some(albedo),
        Model::CookTorrance { diffuse, .. } | Model::Ward { diffuse, .. } => Some(diffuse),
        Model::MetalRough(m) => Some(&mut m.diffuse),
        Model::Mirror { .. } | Model::Conductor { .. } | Model::Metal { .. } | Model::Dielectric { .. } => {
            None
        }
    }
}

/// The picture with new colours; `None` where all or nothing of it is seen, or the two do not lie on each other.
fn recolored(picture: &Texture, mask: &Texture) -> Option<Texture> {
    if !picture.placement.agrees(&mask.placement) {
        return None;
    }
    let [width, height] = picture.size(0);
    // Where texels lie in the picture is known: look-ups are not to move it.
    let mask = Texture {
        placement: Placement { wrap: mask.placement.wrap, ..Placement::default() },
        ..mask.clone()
    };
    let shown = |i: usize| {
        let at = Vec2::new((i % width) as f32 + 0.5, (height - 1 - i / width) as f32 + 0.5)
            / Vec2::new(width as f32, height as f32);
        mask.mask(at, 0.0)
    };
    let shown: Vec<f32> = (0..width * height).into_par_iter().map(shown).collect();
    let hidden = shown.iter().filter(|s| **s < VISIBLE).count();
    if hidden == 0 || hidden == shown.len() {
        return None;
    }
    let color = |i: usize| picture.texel(0, i % width, i / width);
    // Weighted sums over squares of 2 × 2 texels, 4 × 4 and so on.
    let mut sums = vec![halved([width, height], |i| {
        let [r, g, b, _] = color(i);
        let weight = if shown[i] < VISIBLE { 0.0 } else { shown[i] };
        [r * weight, g * weight, b * weight, weight]
    })];
    while let Some((size, from)) = sums.last().filter(|(size, _)| *size != [1, 1]) {
        let next = halved(*size, |i| from[i]);
        sums.push(next);
    }
    let around = |i: usize| {
        (1..).zip(&sums).find_map(|(level, ([columns, _], sums))| {
            let [r, g, b, weight] = sums[((i / width) >> level) * columns + ((i % width) >> level)];
            (weight > 0.0).then(|| [r, g, b].map(|c| c / weight))
        })
    };
    let mips = picture.mips.with_texels(|i| {
        let [r, g, b, a] = color(i);
        let [r, g, b] = if shown[i] < VISIBLE { around(i)? } else { [r, g, b] };
        Some([r, g, b, a])
    })?;
    Some(Texture { mips: Arc::new(mips), ..picture.clone() })
}

/// Sums over squares of 2 × 2 values, and how many columns and rows of them there are.
fn halved([w, h]: [usize; 2], value: impl Fn(usize) -> [f32; 4]) -> ([usize; 2], Vec<[f32; 4]>) {
    let [columns, rows] = [w.div_ceil(2), h.div_ceil(2)];
    let mut sums = vec![[0.0; 4]; columns * rows];
    for i in 0..w * h {
        let (sum, value) = (&mut sums[i / w / 2 * columns + i % w / 2], value(i));
        *sum = std::array::from_fn(|c| sum[c] + value[c]);
    }
    ([columns, rows], sums)
}

#[cfg(test)]
mod tests {
    use super::super::from_mtl::default_material;
    use super::*;
    use foveal::scene::texture::MipChain;
    use glam::Vec3;

    const GREEN: [u8; 4] = [20, 120, 10, 255];

    /// A green disc on white, and its mask.
    fn leaf() -> [Texture; 2] {
        let inside = |i: usize| (i as f32 % 16.0 - 7.5).powi(2) + ((i / 16) as f32 - 7.5).powi(2) < 30.0;
        let of = |a: [u8; 4], b: [u8; 4]| {
            (0..256).map(|i| if inside(i) { a } else { b }).collect::<Vec<[u8; 4]>>()
        };
        [
            Texture::new("leaf", MipChain::from_rgba8(16, 16, of(GREEN, [255; 4]), true)),
            Texture::new("mask", MipChain::from_rgba8(16, 16, of([255; 4], [0, 0, 0, 255]), false)),
        ]
    }

    fn material(color: u32, mask: Option<u32>) -> Material {
        let albedo = Reflectance { color: Vec3::ONE, map: Some(TextureId(color)) };
        let plain = default_material("leaf");
        Material { model: Model::Lambert { albedo }, opacity_map: mask.map(TextureId), ..plain }
    }

    #[test]
    fn a_distant_leaf_is_as_green() {
        let mut textures = leaf().to_vec();
        let close = textures[0].texel(0, 8, 8);
        assert!(textures[0].mean()[0] > 0.3);
        recolor(&mut [material(0, Some(1))], &mut textures);
        assert_eq!(textures.len(), 2);
        for level in 0..textures[0].level_count() {
            let far = textures[0].texel(level, 0, 0);
            assert!(close.iter().zip(far).all(|(a, b)| (a - b).abs() < 0.01), "{level}: {far:?}");
        }
    }

    #[test]
    fn whoever_shows_it_whole_keeps_it() {
        let mut textures = leaf().to_vec();
        let mut materials = [material(0, Some(1)), material(0, None), material(0, Some(1))];
        recolor(&mut materials, &mut textures);
        let shown = |m: &Material| m.picture().map(|id| textures[id.0 as usize].mean()[0]);
        assert_eq!(textures.len(), 3);
        assert!(shown(&materials[0]) < Some(0.05) && shown(&materials[1]) > Some(0.3));
        assert_eq!(materials[0].picture(), materials[2].picture());
    }

    /// Masks that cut nothing or everything, or lie elsewhere, change nothing.
    #[test]
    fn the_rest_stays() {
        let [leaf, mask] = leaf();
        let of = |value| Texture::new("", MipChain::from_rgba8(1, 1, vec![value], false));
        for mask in
            [of([255; 4]), of([0, 0, 0, 255]), Texture { placement: Placement::clamped(true), ..mask }]
        {
            assert!(recolored(&leaf, &mask).is_none());
        }
    }
}
