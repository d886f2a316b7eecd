//! Long rows of records in textures: software fetches texels faster than words of a buffer.

use super::adapter::Gpu;
use super::geometry;

/// A long row of texels, in rows of a texture.
#[derive(Debug)]
pub struct Rows {
    texture: wgpu::Texture,
    /// What is bound.
    pub view: wgpu::TextureView,
}

/// Four words.
pub const RECORDS: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;

impl Rows {
    /// Holds `bytes`, texels of `format`, as far as the adapter has room.
    pub fn new(gpu: &Gpu, label: &str, format: wgpu::TextureFormat, bytes: &[u8]) -> Self {
        let texel = format.block_copy_size(None).unwrap_or(16) as usize;
        let limit = gpu.device.limits().max_texture_dimension_2d as usize;
        let height = (bytes.len() / texel).div_ceil(geometry::ROW).clamp(1, limit);
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d {
                width: geometry::ROW as u32,
                height: height as u32,
                depth_or_array_layers: 1,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        let rows = Self { texture, view };
        rows.write(gpu, bytes);
        rows
    }

    /// Whether there is room for so many texels.
    pub fn holds(&self, texels: usize) -> bool {
        self.texture.height() as usize * geometry::ROW >= texels
    }

    /// Replaces what is there, as far as there is room.
    pub fn write(&self, gpu: &Gpu, bytes: &[u8]) {
        let texel = self.texture.format().block_copy_size(None).unwrap_or(16) as usize;
        let row = geometry::ROW * texel;
        let bytes = &bytes[..bytes.len().min(row * self.texture.height() as usize)];
        // Whole rows, and the rest of the last one.
        let whole = bytes.len() / row;
        let parts = [(0, whole * row, geometry::ROW), (whole, bytes.len(), bytes.len() % row / texel)];
        for (first, end, width) in parts {
            let part = &bytes[first * row..end];
            if part.is_empty() {
                continue;
            }
            gpu.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    texture: &self.texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: 0, y: first as u32, z: 0 },
                    aspect: wgpu::TextureAspect::All,
                },
                part,
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row as u32),
                    rows_per_image: None,
                },
                wgpu::Extent3d {
                    width: width as u32,
                    height: part.len().div_ceil(row) as u32,
                    depth_or_array_layers: 1,
                },
            );
        }
    }
}
