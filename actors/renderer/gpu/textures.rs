//! A scene's textures on the adapter, half floats with their mip chain.

use foveal::image::Map2d;
use foveal::scene::texture::MipChain;
use foveal::scene::{Texture, TextureId};
use half::f16;

use super::adapter::Gpu;
use super::geometry::TextureSet;

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// The textures of a scene and what it takes to bind them.
#[derive(Debug)]
pub struct Textures {
    views: Vec<wgpu::TextureView>,
    clamps: Vec<bool>,
    white: wgpu::TextureView,
    repeat: wgpu::Sampler,
    clamp: wgpu::Sampler,
}

impl Textures {
    /// Uploads all textures. One that is larger than the adapter allows begins at a smaller level.
    pub fn new(gpu: &Gpu, textures: &[Texture]) -> Self {
        let white = Texture::new("white", MipChain::from_linear(1, 1, vec![[1.0; 4]]));
        let sampler = |mode| {
            gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("trilinear"),
                address_mode_u: mode,
                address_mode_v: mode,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                mipmap_filter: wgpu::MipmapFilterMode::Linear,
                ..Default::default()
            })
        };
        Self {
            views: textures.iter().map(|t| upload(gpu, t)).collect(),
            clamps: textures.iter().map(|t| t.clamp).collect(),
            white: upload(gpu, &white),
            repeat: sampler(wgpu::AddressMode::Repeat),
            clamp: sampler(wgpu::AddressMode::ClampToEdge),
        }
    }

    /// The bind group of a draw that needs `set`.
    pub fn bind_group(&self, gpu: &Gpu, layout: &wgpu::BindGroupLayout, set: &TextureSet) -> wgpu::BindGroup {
        let view =
            |id: Option<TextureId>| id.and_then(|id| self.views.get(id.0 as usize)).unwrap_or(&self.white);
        let sampler = |id: Option<TextureId>| match id.and_then(|id| self.clamps.get(id.0 as usize)) {
            Some(true) => &self.clamp,
            _ => &self.repeat,
        };
        let entries: Vec<wgpu::BindGroupEntry<'_>> = set
            .iter()
            .enumerate()
            .flat_map(|(i, id)| {
                [
                    wgpu::BindGroupEntry {
                        binding: 2 * i as u32,
                        resource: wgpu::BindingResource::TextureView(view(*id)),
                    },
                    wgpu::BindGroupEntry {
                        binding: 2 * i as u32 + 1,
                        resource: wgpu::BindingResource::Sampler(sampler(*id)),
                    },
                ]
            })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("textures of a run"),
            layout,
            entries: &entries,
        })
    }

    /// Layout of [`Self::bind_group`].
    pub fn layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let texture = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        let entries: Vec<_> = (0..6).map(|b| entry(b, if b % 2 == 0 { texture } else { sampler })).collect();
        gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("textures of a run"),
            entries: &entries,
        })
    }
}

/// The first level that the adapter can hold; each level is half of the one before.
fn first_level(texture: &Texture, limit: usize) -> usize {
    (0..texture.level_count())
        .find(|l| texture.size(*l).iter().all(|s| *s <= limit))
        .unwrap_or(texture.level_count() - 1)
}

fn upload(gpu: &Gpu, texture: &Texture) -> wgpu::TextureView {
    let limit = gpu.device.limits().max_texture_dimension_2d as usize;
    let first = first_level(texture, limit);
    if first > 0 {
        let [width, height] = texture.size(first);
        tracing::warn!(
            "texture {} is larger than the adapter's limit of {limit}; it is shown at {width} × {height}",
            texture.name
        );
    }
    let size = |level: usize| {
        let [width, height] = texture.size(level);
        wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 }
    };
    let target = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(&texture.name),
        size: size(first),
        mip_level_count: (texture.level_count() - first) as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    for level in first..texture.level_count() {
        let [width, height] = texture.size(level);
        let texels: Vec<[u16; 4]> = (0..height)
            .flat_map(|y| (0..width).map(move |x| texture.texel(level, x, y).map(half_bits)))
            .collect();
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &target,
                mip_level: (level - first) as u32,
                origin: wgpu::Origin3d::ZERO,
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(&texels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(width as u32 * 8),
                rows_per_image: None,
            },
            size(level),
        );
    }
    target.create_view(&wgpu::TextureViewDescriptor::default())
}

/// The nearest finite half; NaN becomes 0.
fn half_bits(v: f32) -> u16 {
    f16::from_f32(if v.is_nan() { 0.0 } else { v.clamp(-65504.0, 65504.0) }).to_bits()
}

/// An environment map, full floats: suns are brighter than a half can say. It is scaled down by
/// leaving out rows and columns where the adapter's limit demands it.
pub(super) fn environment(gpu: &Gpu, map: Option<&Map2d<glam::Vec3>>) -> wgpu::TextureView {
    let limit = gpu.device.limits().max_texture_dimension_2d as usize;
    let black = Map2d::new(1, 1, glam::Vec3::ZERO);
    let map = map.filter(|m| !m.data().is_empty()).unwrap_or(&black);
    let step = map.width().max(map.height()).div_ceil(limit);
    let (width, height) = (map.width() / step, map.height() / step);
    let texels: Vec<[f32; 4]> = (0..height.max(1))
        .flat_map(|y| (0..width.max(1)).map(move |x| map.at(x * step, y * step).extend(1.0).to_array()))
        .collect();
    let size =
        wgpu::Extent3d { width: width.max(1) as u32, height: height.max(1) as u32, depth_or_array_layers: 1 };
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("environment"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    gpu.queue.write_texture(
        texture.as_image_copy(),
        bytemuck::cast_slice(&texels),
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(size.width * 16), rows_per_image: None },
        size,
    );
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_begin_at_the_level_that_fits() {
        let texture = Texture::new("t", MipChain::from_linear(16, 4, vec![[0.0; 4]; 64]));
        for (limit, first) in [(64, 0), (16, 0), (8, 1), (1, 4), (0, 4)] {
            assert_eq!(first_level(&texture, limit), first, "limit {limit}");
        }
    }

    #[test]
    fn halves_are_finite() {
        for (v, expected) in [(f32::NAN, 0.0), (f32::INFINITY, 65504.0), (1e9, 65504.0), (0.5, 0.5)] {
            assert_eq!(f16::from_bits(half_bits(v)).to_f32(), expected);
        }
    }
}
