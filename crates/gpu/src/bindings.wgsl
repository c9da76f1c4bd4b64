// Arguments of a kernel, up to four inputs, and the output.
@group(0) @binding(0) var<uniform> s: Op;
@group(0) @binding(1) var<storage, read> A: array<f32>;
@group(0) @binding(2) var<storage, read> B: array<f32>;
@group(0) @binding(3) var<storage, read> H: array<f32>;
@group(0) @binding(4) var<storage, read> E: array<f32>;
@group(0) @binding(5) var<storage, read_write> C: array<f32>;
