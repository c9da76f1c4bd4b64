//! Sources of the kernels, and those of drawing in the order of their pipelines.

/// Passes of networks.
pub(crate) const NETWORKS_SOURCE: &str = concat!(include_str!("bindings.wgsl"), include_str!("kernels.wgsl"));

/// Entry points of [`DRAWING_SOURCE`].
pub(crate) const DRAWING: [&str; 14] = [
    "project",
    "project_vjp",
    "blend",
    "offsets",
    "list",
    "blend_vjp",
    "sum_tiles",
    "read_out",
    "read_out_vjp",
    "blur_moments",
    "similarity",
    "blur_d_similarity",
    "loss_vjp",
    "sum_loss",
];

/// Entry points of [`RESIDENT_SOURCE`].
pub(crate) const RESIDENT: [&str; 11] = [
    "encode",
    "depth_keys",
    "sort_pairs",
    "sort_block",
    "arrange_cloud",
    "arrange_terms",
    "arrange_signals",
    "scatter_cloud",
    "scatter_terms",
    "statistics",
    "adam",
];

/// Passes of whole training steps.
pub(crate) const RESIDENT_SOURCE: &str =
    concat!(include_str!("bindings.wgsl"), include_str!("draw/columns.wgsl"), include_str!("resident.wgsl"));

/// Files of the folder `draw`.
pub(crate) const DRAWING_SOURCE: &str = concat!(
    include_str!("bindings.wgsl"),
    include_str!("draw/columns.wgsl"),
    include_str!("draw/common.wgsl"),
    include_str!("draw/project.wgsl"),
    include_str!("draw/blend.wgsl"),
    include_str!("draw/readout.wgsl"),
    include_str!("draw/loss.wgsl")
);
