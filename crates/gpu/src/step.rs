//! `GpuStep`: passes over the buffers of the GPU, which a step holds for itself.

use crate::adapters::{Gpu, KERNELS, keep_first, wait_for};
use crate::block::Block;
use crate::shaders::{DRAWING, RESIDENT};
use crate::workspace::Workspace;
use pwrfgs_core::{Error, Real, Result, device};
use std::sync::{Mutex, MutexGuard, PoisonError};
use wgpu::{Buffer, BufferUsages};

/// Number of arguments of a kernel: `Op` of `kernels.wgsl`, of `draw/common.wgsl` and of `resident.wgsl`.
pub(crate) const ARGUMENTS: usize = 16;

/// Distance of arguments in their buffer, bytes: the largest alignment of any GPU.
const ALIGNMENT: usize = 256;

/// Number of commands after which recorded passes are sent to the GPU.
const SENT_TOGETHER: usize = 512;

/// Recorded command.
#[derive(Debug)]
pub(crate) enum Command {
    Pass { kernel: usize, slots: [usize; 5], argument: u32, groups: [u32; 3] },
    Clear { slot: usize, bytes: u64 },
    Read { slot: usize, offset: u64, bytes: u64 },
    Copy { from: (Buffer, u64), to: Buffer, bytes: u64 },
}

/// Passes on a GPU, which the step holds until it is dropped.
#[derive(Debug)]
pub struct GpuStep<'g> {
    gpu: &'g Gpu,
    workspace: MutexGuard<'g, Workspace>,
    commands: Vec<Command>,
    arguments: Vec<u32>,
    /// Numbers per slot.
    sizes: Vec<usize>,
    /// Slot that operations count as 0.
    base: usize,
    /// Buffers with results that were sent, and the lengths of the results.
    sent: Vec<(Buffer, Vec<u64>)>,
    /// Bytes of all buffers of the step.
    bytes: u64,
}

/// Returns the size of single-precision numbers, bytes.
pub(crate) fn bytes_of(numbers: usize) -> u64 {
    (size_of::<f32>() * numbers) as u64
}

/// Returns a number of bytes as text, in multiples of 2²⁰ or 2³⁰ bytes.
fn describe_bytes(bytes: u64) -> String {
    if bytes < 1 << 30 {
        format!("{} MB", bytes.div_ceil(1 << 20))
    } else {
        format!("{:.1} GB", bytes as f64 / f64::from(1 << 30))
    }
}

impl Gpu {
    /// Begins a step of networks with buffers of at least `sizes` numbers by slot, once no other step holds them.
    ///
    /// # Errors
    /// [`Error::Config`] if the memory of the GPU does not suffice, before any work is done.
    pub fn step(&self, sizes: &[usize]) -> Result<GpuStep<'_>> {
        self.step_in(&self.workspace, sizes, "use a smaller `width` or `depth`, or the CPU")
    }

    /// Begins a step with the buffers of `workspace`, which grow to at least `sizes` numbers by slot.
    ///
    /// # Errors
    /// As [`Self::step`], with this `advice`.
    pub(crate) fn step_in<'g>(
        &'g self,
        workspace: &'g Mutex<Workspace>,
        sizes: &[usize],
        advice: &str,
    ) -> Result<GpuStep<'g>> {
        device::mark_used();
        let mut workspace = workspace.lock().unwrap_or_else(PoisonError::into_inner);
        workspace.steps += 1;
        let needed: Vec<u64> = sizes.iter().map(|size| bytes_of((*size).max(1))).collect();
        let total: u64 = needed.iter().sum();
        let refuse = |limit: String| {
            let total = describe_bytes(total);
            Error::Config(format!("--device: a step needs {total} of GPU memory{limit}; {advice}"))
        };
        self.check_limits(&needed).map_err(refuse)?;
        for (slot, &bytes) in needed.iter().enumerate() {
            if workspace.buffers.get(slot).is_some_and(|buffer| buffer.size() >= bytes) {
                continue;
            }
            workspace.changed = workspace.steps;
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
            let Ok(buffer) = self.create_buffer(bytes, usage) else {
                workspace.release();
                return Err(refuse(format!(", and {} has less free", self.name())));
            };
            match workspace.buffers.get_mut(slot) {
                Some(old) => *old = buffer,
                None => workspace.buffers.push(buffer),
            }
        }
        Ok(GpuStep {
            gpu: self,
            workspace,
            commands: Vec::new(),
            arguments: Vec::new(),
            sizes: sizes.to_vec(),
            base: 0,
            sent: Vec::new(),
            bytes: total,
        })
    }

    /// Checks the bytes of the buffers of a step; the error describes the limit that they exceed.
    fn check_limits(&self, needed: &[u64]) -> Result<(), String> {
        if let Some(largest) = needed.iter().copied().max().filter(|bytes| *bytes > self.most_bytes) {
            let (largest, most) = (describe_bytes(largest), describe_bytes(self.most_bytes));
            return Err(format!(", {largest} of them in one buffer, and the limit of {} is {most}", self.name()));
        }
        if needed.iter().sum::<u64>() > self.memory {
            return Err(format!(", and {} has {}", self.name(), describe_bytes(self.memory)));
        }
        Ok(())
    }

    /// Creates a buffer of `bytes` bytes; the error is that of the driver.
    pub(crate) fn create_buffer(&self, bytes: u64, usage: BufferUsages) -> Result<Buffer, String> {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let limits = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: bytes,
            usage,
            mapped_at_creation: false,
        });
        let errors = [wait_for(limits.pop()), wait_for(memory.pop())];
        errors.into_iter().flatten().next().map_or(Ok(buffer), |error| Err(error.to_string()))
    }
}

impl GpuStep<'_> {
    /// Returns the number of the step, for [`Self::follows`] of the next one.
    pub fn number(&self) -> u64 {
        self.workspace.steps
    }

    /// Returns whether this step is the next after step `number` and its buffers still have the content of that one.
    pub fn follows(&self, number: u64) -> bool {
        self.workspace.steps == number + 1 && self.workspace.changed <= number
    }

    /// Records operations whose slots count from `base`.
    pub fn with_base(&mut self, base: usize, record: impl FnOnce(&mut Self)) {
        let before = std::mem::replace(&mut self.base, base);
        record(self);
        self.base = before;
    }

    /// Copies `len` numbers of slot `from`, from `start`, to the beginning of slot `to`, after the passes recorded so far.
    pub fn copy_numbers(&mut self, (from, start): (usize, usize), to: usize, len: usize) {
        let (from, to) = (self.buffer_of(from), self.buffer_of(to));
        self.record(Command::Copy { from: (from, bytes_of(start)), to, bytes: bytes_of(len) });
    }

    /// Writes values to a slot from number `start` on, after all passes recorded so far, which it sends.
    pub fn upload(&mut self, slot: usize, start: usize, values: &[Real]) {
        self.send();
        let single: Vec<f32>;
        let bytes: &[u8] = if size_of::<Real>() == size_of::<f32>() {
            bytemuck::cast_slice(values)
        } else {
            single = values.iter().map(|value| *value as f32).collect();
            bytemuck::cast_slice(&single)
        };
        self.gpu.queue.write_buffer(&self.workspace.buffers[self.base + slot], bytes_of(start), bytes);
    }

    /// Sets the first `len` numbers of a slot to zero.
    pub fn clear(&mut self, slot: usize, len: usize) {
        self.commands.push(Command::Clear { slot: self.base + slot, bytes: bytes_of(len) });
    }

    /// Requests `len` numbers of a slot from `start`, as they are after the passes recorded so far: the next result of
    /// [`Self::finish`].
    pub fn read(&mut self, slot: usize, start: usize, len: usize) {
        self.commands.push(Command::Read { slot: self.base + slot, offset: bytes_of(start), bytes: bytes_of(len) });
    }

    /// Returns the buffer of a slot.
    pub(crate) fn buffer_of(&self, slot: usize) -> Buffer {
        self.workspace.buffers[self.base + slot].clone()
    }

    /// Records a command.
    pub(crate) fn record(&mut self, command: Command) {
        self.commands.push(command);
    }

    /// Checks that a matrix with this shape lies inside its slot: the GPU ignores numbers outside without an error.
    ///
    /// # Panics
    /// If the matrix does not.
    pub(crate) fn check(&self, block: Block, (rows, columns): (usize, usize)) {
        let last = |count: usize, stride: usize| count.saturating_sub(1) * stride;
        let end = block.start + last(rows, block.strides.0) + last(columns, block.strides.1);
        assert!(rows * columns == 0 || end < self.sizes[self.base + block.slot], "a matrix lies inside its slot");
    }

    /// Records a kernel for `groups` workgroups; none if an axis has 0. `slots` are those of A, B, H, E and C.
    pub(crate) fn pass(&mut self, name: &str, slots: [usize; 5], arguments: [usize; ARGUMENTS], groups: [usize; 3]) {
        if groups.contains(&0) {
            return;
        }
        // The order of `Gpu::kernels`.
        let mut kernels = KERNELS.iter().chain(&DRAWING).chain(&RESIDENT);
        let kernel = kernels.position(|kernel| *kernel == name).expect("a kernel of that name");
        let slots = slots.map(|slot| self.base + slot);
        let argument = (self.arguments.len() * size_of::<u32>()) as u32;
        self.arguments.extend(arguments.map(|number| number as u32));
        self.arguments.resize(self.arguments.len().next_multiple_of(ALIGNMENT / size_of::<u32>()), 0);
        self.commands.push(Command::Pass { kernel, slots, argument, groups: groups.map(|n| n as u32) });
        if self.commands.len() >= SENT_TOGETHER {
            self.send();
        }
    }

    /// Sends the recorded commands to the GPU, which runs them while the CPU continues. [`Self::finish`] reports a failure.
    pub fn send(&mut self) {
        let (commands, arguments) = (std::mem::take(&mut self.commands), std::mem::take(&mut self.arguments));
        if commands.is_empty() {
            return;
        }
        let reads =
            commands.iter().filter_map(|c| if let Command::Read { bytes, .. } = c { Some(*bytes) } else { None });
        let reads: Vec<u64> = reads.collect();
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        let read_bytes: u64 = reads.iter().sum();
        self.bytes += read_bytes;
        if self.bytes > self.gpu.memory {
            return keep_first(
                &self.gpu.failure,
                format!("out of memory, of which it has {}", describe_bytes(self.gpu.memory)),
            );
        }
        let results = self.gpu.create_buffer(read_bytes.max(bytes_of(1)), usage); // a buffer has at least one number
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let uniforms = self.gpu.create_buffer((size_of::<u32>() * arguments.len()).max(ALIGNMENT) as u64, uniform);
        let (results, uniforms) = match (results, uniforms) {
            (Ok(results), Ok(uniforms)) => (results, uniforms),
            (Err(why), _) | (_, Err(why)) => return keep_first(&self.gpu.failure, why),
        };
        self.gpu.queue.write_buffer(&uniforms, 0, bytemuck::cast_slice(&arguments));
        self.gpu.queue.submit([self.encode_commands(&commands, &uniforms, &results)]);
        if !reads.is_empty() {
            self.sent.push((results, reads));
        }
    }

    /// Encodes `commands`, with the arguments of passes in `uniforms`; reads fill `results`, one after the other.
    fn encode_commands(&self, commands: &[Command], uniforms: &Buffer, results: &Buffer) -> wgpu::CommandBuffer {
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut filled = 0;
        let mut remaining = commands;
        while let Some(command) = remaining.first() {
            let passes = remaining.iter().take_while(|c| matches!(c, Command::Pass { .. })).count();
            match command {
                Command::Pass { .. } => self.encode_passes(&mut encoder, uniforms, &remaining[..passes]),
                Command::Clear { slot, bytes } => encoder.clear_buffer(&self.workspace.buffers[*slot], 0, Some(*bytes)),
                Command::Read { slot, offset, bytes } => {
                    encoder.copy_buffer_to_buffer(&self.workspace.buffers[*slot], *offset, results, filled, *bytes);
                    filled += bytes;
                }
                Command::Copy { from, to, bytes } => encoder.copy_buffer_to_buffer(&from.0, from.1, to, 0, *bytes),
            }
            remaining = &remaining[passes.max(1)..];
        }
        encoder.finish()
    }

    /// Encodes neighbouring passes.
    fn encode_passes(&self, encoder: &mut wgpu::CommandEncoder, uniforms: &Buffer, passes: &[Command]) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        let size = std::num::NonZeroU64::new((size_of::<u32>() * ARGUMENTS) as u64);
        for command in passes {
            let Command::Pass { kernel, slots, argument, groups } = command else { continue };
            let arguments = wgpu::BufferBinding { buffer: uniforms, offset: 0, size };
            let mut entries =
                vec![wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(arguments) }];
            entries.extend((1..).zip(slots).map(|(binding, slot)| wgpu::BindGroupEntry {
                binding,
                resource: self.workspace.buffers[*slot].as_entire_binding(),
            }));
            let group = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &self.gpu.layout,
                entries: &entries,
            });
            pass.set_pipeline(&self.gpu.kernels[*kernel]);
            pass.set_bind_group(0, &group, &[*argument]);
            pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
        }
    }

    /// Waits for all passes; returns the requested numbers in the order of the requests.
    ///
    /// # Errors
    /// [`Error::Device`] if the GPU failed, for example out of memory; results are then lost.
    pub fn finish(mut self) -> Result<Vec<Vec<Real>>> {
        self.send();
        let failed = |e: &dyn std::fmt::Display| Error::Device(format!("{}: {e}", self.gpu.name()));
        for (buffer, _) in &self.sent {
            buffer.map_async(wgpu::MapMode::Read, .., |_| ()); // an error of mapping is one of the range below
        }
        let poll = self.gpu.device.poll(wgpu::PollType::wait_indefinitely());
        if let Some(why) = self.gpu.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(failed(&why));
        }
        poll.map_err(|e| failed(&e))?;
        let mut results = Vec::new();
        for (buffer, reads) in &self.sent {
            let view = buffer.get_mapped_range(..).map_err(|e| failed(&e))?;
            let mut unread: &[u8] = &view;
            for bytes in reads {
                let (part, after) = unread.split_at(*bytes as usize);
                let values: Vec<f32> = bytemuck::pod_collect_to_vec(part);
                results.push(values.into_iter().map(|value| value as Real).collect());
                unread = after;
            }
        }
        Ok(results)
    }
}
