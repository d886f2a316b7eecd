//! Pictures back from the adapter: a ring of buffers, so that no frame waits for one.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use super::adapter::Gpu;

/// Rows of copies start at multiples of this many bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;
const PENDING: u8 = 0;
const READY: u8 = 1;
const FAILED: u8 = 2;

/// The buffer of one picture on its way.
#[derive(Debug)]
struct Slot {
    buffer: wgpu::Buffer,
    row_bytes: u32,
    padded_row_bytes: u32,
    rows: u32,
    tag: u64,
    state: Arc<AtomicU8>,
}

/// A ring of pictures on their way from the adapter, first in, first out.
#[derive(Debug)]
pub struct ReadBack {
    capacity: usize,
    copied: Vec<Slot>,
    mapping: VecDeque<Slot>,
    free: Vec<wgpu::Buffer>,
}

impl ReadBack {
    /// A ring of at most `capacity` pictures.
    pub fn new(capacity: usize) -> Self {
        Self { capacity, copied: Vec::new(), mapping: VecDeque::new(), free: Vec::new() }
    }

    /// Whether another picture can be asked for.
    pub fn has_room(&self) -> bool {
        self.copied.len() + self.mapping.len() < self.capacity
    }

    /// Records the copy of a texture; `false` if the ring is full, and then nothing is recorded.
    /// After the encoder has been submitted, call [`Self::submitted`].
    pub fn request(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        tag: u64,
    ) -> bool {
        if !self.has_room() {
            return false;
        }
        let texel = texture.format().block_copy_size(None).unwrap_or(4);
        let row_bytes = texture.width() * texel;
        let padded_row_bytes = row_bytes.next_multiple_of(ROW_ALIGNMENT);
        let size = u64::from(padded_row_bytes) * u64::from(texture.height());
        let reusable = self.free.iter().position(|b| b.size() == size);
        let buffer = match reusable {
            Some(i) => self.free.swap_remove(i),
            None => {
                self.free.clear();
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("read-back"),
                    size,
                    usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                    mapped_at_creation: false,
                })
            }
        };
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded_row_bytes),
                    rows_per_image: None,
                },
            },
            texture.size(),
        );
        let state = Arc::new(AtomicU8::new(PENDING));
        let rows = texture.height();
        self.copied.push(Slot { buffer, row_bytes, padded_row_bytes, rows, tag, state });
        true
    }

    /// The copies recorded so far have been submitted.
    pub fn submitted(&mut self) {
        for slot in self.copied.drain(..) {
            let state = Arc::clone(&slot.state);
            slot.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
            });
            self.mapping.push_back(slot);
        }
    }

    /// The oldest picture, if it has arrived: its tag and its bytes, rows without padding. Never waits.
    pub fn poll(&mut self, gpu: &Gpu) -> Option<(u64, Vec<u8>)> {
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        loop {
            match self.mapping.front()?.state.load(Ordering::Acquire) {
                PENDING => return None,
                READY => break,
                _ => drop(self.mapping.pop_front()),
            }
        }
        let slot = self.mapping.pop_front()?;
        let bytes = {
            let view = slot.buffer.get_mapped_range(..).ok()?;
            let mut bytes = Vec::with_capacity((slot.row_bytes * slot.rows) as usize);
            for row in view.chunks_exact(slot.padded_row_bytes as usize) {
                bytes.extend_from_slice(&row[..slot.row_bytes as usize]);
            }
            bytes
        };
        slot.buffer.unmap();
        self.free.push(slot.buffer);
        Some((slot.tag, bytes))
    }
}

/// The bytes of a texture, rows without padding; waits for the adapter.
///
/// # Errors
/// If the adapter is lost.
#[cfg(test)]
pub fn read(gpu: &Gpu, texture: &wgpu::Texture) -> Result<Vec<u8>, String> {
    let mut ring = ReadBack::new(1);
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    ring.request(gpu, &mut encoder, texture, 0);
    gpu.queue.submit([encoder.finish()]);
    ring.submitted();
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| e.to_string())?;
    ring.poll(gpu).map(|(_, bytes)| bytes).ok_or_else(|| "the graphics adapter was lost".to_owned())
}

/// The bytes of a buffer; waits for the adapter.
///
/// # Errors
/// If the adapter is lost.
#[cfg(test)]
pub fn read_buffer(gpu: &Gpu, from: &wgpu::Buffer) -> Result<Vec<u8>, String> {
    let usage = wgpu::BufferUsages::MAP_READ;
    let buffer = gpu.empty_buffer("read-back", from.size(), usage);
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.copy_buffer_to_buffer(from, 0, &buffer, 0, from.size());
    gpu.queue.submit([encoder.finish()]);
    buffer.map_async(wgpu::MapMode::Read, .., |_| ());
    gpu.finish()?;
    let view = buffer.get_mapped_range(..).map_err(|e| e.to_string())?;
    Ok(view.to_vec())
}
