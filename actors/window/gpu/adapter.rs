//! Which graphics adapter there is, and opening it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A graphics adapter that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterInfo {
    /// Name the driver gives it.
    pub name: String,
    /// The graphics interface it is reached by: `vulkan`, `gl`, ….
    pub backend: String,
    /// Driver and its version.
    pub driver: String,
    /// Whether it computes on the processor.
    pub software: bool,
}

impl AdapterInfo {
    fn of(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        Self {
            name: info.name,
            backend: info.backend.to_string(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            software: info.device_type == wgpu::DeviceType::Cpu,
        }
    }
}

impl std::fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let software = if self.software { ", software" } else { "" };
        write!(f, "{} ({}{software}, {})", self.name, self.backend, self.driver)
    }
}

/// What to install where no adapter is found.
const REMEDY: &str =
    "install a Vulkan driver (Debian: `mesa-vulkan-drivers libvulkan1`, which also holds a software one)";

/// The adapter that [`Gpu::open`] would take. Hardware is preferred.
///
/// # Errors
/// Says what was tried and which package would help.
pub fn adapter() -> Result<AdapterInfo, String> {
    guarded(|| {
        let instance = instance(None);
        choose(&instance, None).map(|a| AdapterInfo::of(&a))
    })
}

/// The connection to the graphics drivers; with the display that windows will be on, if any.
pub fn instance(display: Option<Box<dyn wgpu::wgt::WgpuHasDisplayHandle>>) -> wgpu::Instance {
    let mut descriptor = match display {
        Some(display) => wgpu::InstanceDescriptor::new_with_display_handle(display),
        None => wgpu::InstanceDescriptor::new_without_display_handle(),
    };
    descriptor.backends = wgpu::Backends::PRIMARY | wgpu::Backends::GL;
    if !cfg!(debug_assertions) {
        descriptor.flags = wgpu::InstanceFlags::empty();
    }
    wgpu::Instance::new(descriptor)
}

/// Runs what calls drivers: one that panics is one that is not there.
fn guarded<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err(format!("the graphics driver failed while it was opened; {REMEDY}")))
}

/// Hardware before software; in the order the drivers name them otherwise.
fn preference(kind: wgpu::DeviceType) -> u32 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

fn choose(instance: &wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<wgpu::Adapter, String> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let found = adapters.len();
    adapters.retain(|a| {
        surface.is_none_or(|s| a.is_surface_supported(s))
            && a.get_info().backend != wgpu::Backend::Noop
            && a.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
            && a.limits().max_color_attachments >= 4
            && a.limits().max_storage_buffers_per_shader_stage >= 6
    });
    adapters.sort_by_key(|a| preference(a.get_info().device_type));
    adapters.into_iter().next().ok_or_else(|| {
        let tried = if cfg!(feature = "gles") { "Vulkan and OpenGL" } else { "Vulkan" };
        match found {
            0 => format!("no graphics adapter (tried {tried}); {REMEDY}"),
            n => format!("{n} graphics adapters, but none can draw here (tried {tried}); {REMEDY}"),
        }
    })
}

/// An open adapter.
#[derive(Clone, Debug)]
pub struct Gpu {
    /// What it is.
    pub info: AdapterInfo,
    /// Makes buffers, textures and pipelines.
    pub device: wgpu::Device,
    /// Takes work.
    pub queue: wgpu::Queue,
    /// The adapter itself, for what it can do with a surface.
    pub adapter: wgpu::Adapter,
    lost: Arc<AtomicBool>,
}

impl Gpu {
    /// Opens the best adapter, one that can show pictures on `surface` if that is given.
    ///
    /// # Errors
    /// Says what was tried and which package would help.
    pub fn open(instance: &wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self, String> {
        Self::open_if(instance, surface, |_| true)?.map_err(|info| format!("{info} is not wanted"))
    }

    /// The same, unless the best adapter is not `wanted`: then which one that is.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_if(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        wanted: impl FnOnce(&AdapterInfo) -> bool,
    ) -> Result<Result<Self, AdapterInfo>, String> {
        guarded(|| {
            let adapter = choose(instance, surface)?;
            let info = AdapterInfo::of(&adapter);
            if !wanted(&info) {
                return Ok(Err(info));
            }
            let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
                label: Some("foveal"),
                required_limits: adapter.limits(),
                // Textures of full floats stay as they are where they can be filtered.
                required_features: adapter.features() & wgpu::Features::FLOAT32_FILTERABLE,
                ..Default::default()
            }))
            .map_err(|e| format!("{} could not be opened: {e}; {REMEDY}", info.name))?;
            let lost = Arc::new(AtomicBool::new(false));
            let flag = Arc::clone(&lost);
            device.set_device_lost_callback(move |reason, message| {
                if reason != wgpu::DeviceLostReason::Destroyed {
                    tracing::warn!("the graphics adapter was lost: {message}");
                }
                flag.store(true, Ordering::Release);
            });
            let flag = Arc::clone(&lost);
            // The default would end the program; drawing goes on without the adapter instead.
            device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
                tracing::error!("the graphics adapter refused an order: {error}");
                flag.store(true, Ordering::Release);
                #[cfg(test)]
                std::panic::panic_any(error.to_string());
            }));
            Ok(Ok(Self { info, device, queue, adapter, lost }))
        })
    }

    /// Opens the best adapter without a window.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn headless() -> Result<Self, String> {
        guarded(|| Ok(instance(None))).and_then(|i| Self::open(&i, None))
    }

    /// Waits until all that was ordered is done.
    ///
    /// # Errors
    /// If the adapter is lost.
    pub fn finish(&self) -> Result<(), String> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map(drop).map_err(|e| e.to_string())
    }

    /// Whether it can no longer be drawn with.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Acquire)
    }

    /// A buffer that holds `contents`, padded to at least `4` bytes since empty ones cannot be bound.
    pub(super) fn buffer(&self, label: &str, contents: &[u8], usage: wgpu::BufferUsages) -> wgpu::Buffer {
        let size = (contents.len() as u64).next_multiple_of(4).max(16);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let whole = contents.len() / 4 * 4;
        if whole > 0 {
            self.queue.write_buffer(&buffer, 0, &contents[..whole]);
        }
        buffer
    }

    /// A buffer of `size` bytes, at least 16, all zero.
    pub(super) fn empty_buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size.next_multiple_of(4).max(16),
            usage: usage | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// The layout of a bind group: who sees each entry, and what it is.
    pub(super) fn layout(
        &self,
        label: &str,
        entries: &[(wgpu::ShaderStages, wgpu::BindingType)],
    ) -> wgpu::BindGroupLayout {
        let numbered = entries.iter().zip(0..).map(|((visibility, ty), binding)| {
            wgpu::BindGroupLayoutEntry { binding, visibility: *visibility, ty: *ty, count: None }
        });
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(label),
            entries: &numbered.collect::<Vec<_>>(),
        })
    }

    /// A texture to draw into, to read from in later passes and to copy from.
    pub(super) fn target(&self, label: &str, size: [u32; 2], format: wgpu::TextureFormat) -> wgpu::Texture {
        self.target_with(label, size, format, wgpu::TextureUsages::empty())
    }

    /// The same for further uses.
    pub(super) fn target_with(
        &self,
        label: &str,
        size: [u32; 2],
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width: size[0].max(1), height: size[1].max(1), depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC
                | usage,
            view_formats: &[],
        })
    }
}

/// A flat texture with one sample a texel, as it is bound.
pub(super) fn flat_texture(sample_type: wgpu::TextureSampleType) -> wgpu::BindingType {
    let view_dimension = wgpu::TextureViewDimension::D2;
    wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_is_found_or_the_package_is_named() {
        match adapter() {
            Ok(info) => assert!(!info.name.is_empty() && !info.backend.is_empty(), "{info}"),
            Err(e) => assert!(e.contains("mesa-vulkan-drivers"), "{e}"),
        }
    }

    #[test]
    fn hardware_comes_before_software() {
        use wgpu::DeviceType as T;
        let mut kinds = [T::Cpu, T::Other, T::DiscreteGpu, T::VirtualGpu, T::IntegratedGpu];
        kinds.sort_by_key(|k| preference(*k));
        assert_eq!(kinds, [T::DiscreteGpu, T::IntegratedGpu, T::VirtualGpu, T::Other, T::Cpu]);
    }
}
