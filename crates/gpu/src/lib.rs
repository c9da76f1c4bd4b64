//! Passes of networks, of drawing, of the loss and of [whole training steps](resident) on a GPU through wgpu (Vulkan, Metal,
//! DX12), in single precision.
//!
//! [`select`] chooses the GPU of the process, [`current`] returns it. A [`GpuStep`] holds the GPU for one pass of a network,
//! of a [drawing](draw) or of training steps: upload, products and other passes over [`Block`]s of its buffers, read. The
//! kernels are in `kernels.wgsl`, `resident.wgsl` and the folder `draw`. They use no atomics and no subgroups, and add in an
//! order that depends only on the inputs: on one GPU with one driver, equal inputs give equal bits.

mod adapters;
mod block;
pub mod draw;
mod kept;
mod passes;
pub mod resident;
mod shaders;
mod step;
#[cfg(test)]
mod tests;
mod workspace;

pub use adapters::{Gpu, GpuLine, current, for_tests, list, select};
pub use block::{Block, Epilogue};
pub use kept::KeptBuffer;
pub use step::GpuStep;

/// Slot of partial sums, `[planes, numbers]`, which a second pass adds up in order.
pub const SCRATCH: usize = 0;

/// Number of rows per partial sum.
pub const SLICE: usize = 1024;

/// Maximum number of rows per chunk.
const MOST_ROWS: usize = 65_536;

/// Returns the number of values that slot [`SCRATCH`] needs for the derivative of a matrix with `numbers` numbers, over
/// `rows` rows.
pub fn scratch_len(rows: usize, numbers: usize) -> usize {
    rows.div_ceil(SLICE) * numbers
}
