//! A scene's textures on the adapter: of each the levels that are in memory, in a format as large as theirs.
//!
//! The adapter obeys the table of residency: a texture object holds the levels from the finest in memory on, and is made
//! anew when that one changes. So it takes as many bytes as the table says.

use foveal::image::Map2d;
use foveal::scene::texture::MipChain;
use foveal::scene::{Texture, TextureId, Wrap};
use half::f16;

use super::adapter::{Gpu, flat_texture};
use super::geometry::TextureSet;

/// One texture on the adapter.
#[derive(Debug)]
struct Held {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    /// The finest level of the chain that is held.
    first: usize,
    clamps: bool,
    bytes: u64,
}

/// The textures of a scene and what it takes to bind them.
#[derive(Debug)]
pub struct Textures {
    held: Vec<Held>,
    white: Held,
    repeat: wgpu::Sampler,
    clamp: wgpu::Sampler,
}

impl Textures {
    /// Uploads the levels that are in memory. A texture that is larger than the adapter allows begins at a smaller level.
    pub fn new(gpu: &Gpu, textures: &[Texture]) -> Self {
        let white = Texture::new("white", MipChain::from_rgba8(1, 1, vec![[255; 4]], false));
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
        let limit = side_max(gpu);
        let hold = |texture: &Texture| {
            if oversize(texture, limit) > 0 {
                let [width, height] = texture.size(oversize(texture, limit));
                tracing::warn!(
                    "texture {} is larger than the adapter's limit of {limit}; it is shown at {width} × {height}",
                    texture.name
                );
            }
            upload(gpu, texture, first_level(texture, limit))
        };
        Self {
            held: textures.iter().map(hold).collect(),
            white: upload(gpu, &white, 0),
            repeat: sampler(wgpu::AddressMode::Repeat),
            clamp: sampler(wgpu::AddressMode::ClampToEdge),
        }
    }

    /// Makes anew what has other levels in memory now. Whether there was any; then whoever has bound textures must bind
    /// them again.
    pub fn update(&mut self, gpu: &Gpu, textures: &[Texture]) -> bool {
        let limit = side_max(gpu);
        let mut changed = false;
        for (held, texture) in self.held.iter_mut().zip(textures) {
            let first = first_level(texture, limit);
            if first != held.first {
                held.texture.destroy();
                *held = upload(gpu, texture, first);
                changed = true;
            }
        }
        changed
    }

    /// Bytes that the texture objects take.
    pub fn bytes(&self) -> u64 {
        self.held.iter().map(|held| held.bytes).sum()
    }

    /// The finest level that is held, by texture.
    pub fn firsts(&self) -> Vec<usize> {
        self.held.iter().map(|held| held.first).collect()
    }

    /// The bind group of a draw that needs `set`.
    pub fn bind_group(&self, gpu: &Gpu, layout: &wgpu::BindGroupLayout, set: &TextureSet) -> wgpu::BindGroup {
        let held =
            |id: &Option<TextureId>| id.and_then(|id| self.held.get(id.0 as usize)).unwrap_or(&self.white);
        let entries: Vec<wgpu::BindGroupEntry<'_>> = set
            .iter()
            .map(held)
            .enumerate()
            .flat_map(|(i, held)| {
                let sampler = if held.clamps { &self.clamp } else { &self.repeat };
                [
                    wgpu::BindGroupEntry {
                        binding: 2 * i as u32,
                        resource: wgpu::BindingResource::TextureView(&held.view),
                    },
                    wgpu::BindGroupEntry {
                        binding: 2 * i as u32 + 1,
                        resource: wgpu::BindingResource::Sampler(sampler),
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
        let texture = flat_texture(wgpu::TextureSampleType::Float { filterable: true });
        let sampler = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
        let pair = [texture, sampler].map(|ty| (wgpu::ShaderStages::FRAGMENT, ty));
        gpu.layout("textures of a run", &pair.repeat(3))
    }
}

fn side_max(gpu: &Gpu) -> usize {
    gpu.device.limits().max_texture_dimension_2d as usize
}

/// The first level that an adapter of this limit can hold; each level is half of the one before.
fn oversize(texture: &Texture, limit: usize) -> usize {
    (0..texture.level_count())
        .find(|l| texture.size(*l).iter().all(|s| *s <= limit))
        .unwrap_or(texture.level_count() - 1)
}

/// The first level to hold: the finest in memory, if the adapter can.
fn first_level(texture: &Texture, limit: usize) -> usize {
    oversize(texture, limit).max(texture.mips.finest())
}

/// How a texture is stored on the adapter, and bytes of a texel: as many as in memory, but where it holds full floats that
/// the adapter cannot filter.
fn format(gpu: &Gpu, texture: &Texture) -> (wgpu::TextureFormat, usize) {
    let texel = texture.mips.level_bytes(texture.level_count() - 1);
    let filters_floats = gpu.device.features().contains(wgpu::Features::FLOAT32_FILTERABLE);
    match texel {
        4 if texture.mips.is_gamma_encoded() => (wgpu::TextureFormat::Rgba8UnormSrgb, 4),
        4 => (wgpu::TextureFormat::Rgba8Unorm, 4),
        16 if filters_floats => (wgpu::TextureFormat::Rgba32Float, 16),
        _ => (wgpu::TextureFormat::Rgba16Float, 8),
    }
}

fn upload(gpu: &Gpu, texture: &Texture, first: usize) -> Held {
    let size = |level: usize| {
        let [width, height] = texture.size(level);
        wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 }
    };
    let (format, texel_bytes) = format(gpu, texture);
    let target = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(&texture.name),
        size: size(first),
        mip_level_count: (texture.level_count() - first) as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let mut bytes = 0;
    for level in first..texture.level_count() {
        let [width, height] = texture.size(level);
        let copied;
        let texels: &[u8] = match texture.mips.level(level) {
            Some(texels) if format != wgpu::TextureFormat::Rgba16Float => texels.as_bytes(),
            _ => {
                copied = halves(texture, level);
                bytemuck::cast_slice(&copied)
            }
        };
        bytes += texels.len() as u64;
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &target,
                mip_level: (level - first) as u32,
                origin: wgpu::Origin3d::ZERO,
                aspect: wgpu::TextureAspect::All,
            },
            texels,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some((width * texel_bytes) as u32),
                rows_per_image: Some(height as u32),
            },
            size(level),
        );
    }
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    Held { texture: target, view, first, clamps: texture.placement.wrap == [Wrap::Clamp; 2], bytes }
}

/// A level's texels as half floats.
fn halves(texture: &Texture, level: usize) -> Vec<[u16; 4]> {
    let [width, height] = texture.size(level);
    (0..height).flat_map(|y| (0..width).map(move |x| texture.texel(level, x, y).map(half_bits))).collect()
}

/// The nearest finite half; NaN becomes 0.
pub(super) fn half_bits(v: f32) -> u16 {
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
        let texture = Texture { mips: std::sync::Arc::new(texture.mips.without_finer(2)), ..texture };
        assert_eq!([64, 8, 1].map(|limit| first_level(&texture, limit)), [2, 2, 4]);
    }

    #[test]
    fn halves_are_finite() {
        for (v, expected) in [(f32::NAN, 0.0), (f32::INFINITY, 65504.0), (1e9, 65504.0), (0.5, 0.5)] {
            assert_eq!(f16::from_bits(half_bits(v)).to_f32(), expected);
        }
    }
}
