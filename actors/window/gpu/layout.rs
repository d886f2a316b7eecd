//! Layouts of bind groups whose entries one stage reads, numbered in their order.

/// A texture of two dimensions.
pub fn texture(sample_type: wgpu::TextureSampleType) -> wgpu::BindingType {
    let view_dimension = wgpu::TextureViewDimension::D2;
    wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

/// A whole buffer.
pub fn buffer(ty: wgpu::BufferBindingType) -> wgpu::BindingType {
    wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
}

/// A buffer that shaders index.
pub fn storage(read_only: bool) -> wgpu::BindingType {
    buffer(wgpu::BufferBindingType::Storage { read_only })
}

/// The layout of entries of these kinds.
pub fn bind_group_layout<const N: usize>(
    device: &wgpu::Device,
    label: &str,
    visibility: wgpu::ShaderStages,
    kinds: [wgpu::BindingType; N],
) -> wgpu::BindGroupLayout {
    let mut binding = 0..;
    let entries = kinds.map(|ty| {
        let binding = binding.next().unwrap_or_default();
        wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None }
    });
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}
