//! `KeptBuffer`: numbers on the GPU that outlive steps, such as those that all predictions of a model share.

use crate::adapters::Gpu;
use crate::step::{Command, GpuStep, bytes_of};
use wgpu::{Buffer, BufferUsages};

/// Numbers on the GPU that outlive steps.
#[derive(Clone, Debug)]
pub struct KeptBuffer(Buffer);

impl Gpu {
    /// Creates a buffer for `len` numbers; `None` if the memory of the GPU does not suffice.
    pub fn create_kept_buffer(&self, len: usize) -> Option<KeptBuffer> {
        let bytes = bytes_of(len.max(1));
        let fits = bytes <= self.most_bytes.min(self.memory);
        let usage = BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        fits.then(|| self.create_buffer(bytes, usage).ok()).flatten().map(KeptBuffer)
    }
}

impl GpuStep<'_> {
    /// Copies the first `len` numbers of a slot to a kept buffer, after the passes recorded so far.
    pub fn save(&mut self, slot: usize, len: usize, kept: &KeptBuffer) {
        self.copy(self.buffer_of(slot), kept.0.clone(), len);
    }

    /// Copies the first `len` numbers of a kept buffer to a slot, after the passes recorded so far.
    pub fn load(&mut self, slot: usize, len: usize, kept: &KeptBuffer) {
        self.copy(kept.0.clone(), self.buffer_of(slot), len);
    }

    /// Records a copy of the first `len` numbers of a buffer.
    fn copy(&mut self, from: Buffer, to: Buffer, len: usize) {
        self.record(Command::Copy { from: (from, 0), to, bytes: bytes_of(len) });
    }
}
