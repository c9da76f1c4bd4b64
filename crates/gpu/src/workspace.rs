//! `Workspace`: buffers that steps reuse.

use wgpu::Buffer;

/// Buffers of a GPU by slot; they grow as steps need them.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    pub(crate) buffers: Vec<Buffer>,
    /// Number of the last step.
    pub(crate) steps: u64,
    /// Number of the last step that created buffers.
    pub(crate) changed: u64,
}

impl Workspace {
    /// Releases all buffers, so that no later step can use their content.
    pub(crate) fn release(&mut self) {
        self.buffers.clear();
        self.changed = self.steps + 1; // the next step creates them
    }
}
