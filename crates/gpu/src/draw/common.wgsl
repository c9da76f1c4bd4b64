// Drawing of Gaussians: shared code of the kernels of this folder. Gaussians come in depth order, nearest first. Numbers that
// count are stored as floats, exact up to 2^24. Every sum has one order, which depends only on the inputs.

struct Op {
  n: u32,                     // Gaussians
  links: u32,                 // transmitters with this geometry
  link: u32,                  // transmitter of a backward pass
  width: u32, height: u32,    // pixels
  columns: u32, tiles: u32,   // tiles per row, and in all
  channels: u32,              // 1 or 2 per transmitter
  mode: u32,                  // readout; whether there are terms of a network
}

const SIDE: u32 = 16u;
const PIXELS: u32 = 256u;
const ALPHA_MAX: f32 = 0.99;
const T_MIN: f32 = 1e-4;

// Computes eˣ with the polynomial of the CPU: the built-in function may be off by 3 + 2|x| units in the last place.
fn exponential(value: f32) -> f32 {
  let x = clamp(value, -87.0, 88.0);
  let n = floor(x * 1.4426950408889634 + 0.5);
  let r = fma(n, 2.1219444e-4, fma(n, -0.6933594, x));
  var p = fma(r, 0.0013889, 0.00836338);
  p = fma(p, r, 0.04166573); p = fma(p, r, 0.16666655); p = fma(p, r, 0.5); p = fma(p, r, 1.0); p = fma(p, r, 1.0);
  return p * bitcast<f32>(u32(i32(n) + 127) << 23u);
}

// Sums one number per invocation of a workgroup of 256: element l becomes the sum of the numbers 0 to l.
var<workgroup> scan: array<u32, 256>;
fn scan_sums(l: u32, value: u32) {
  scan[l] = value;
  workgroupBarrier();
  for (var step = 1u; step < 256u; step <<= 1u) {
    var v = scan[l];
    if (l >= step) { v += scan[l - step]; }
    workgroupBarrier();
    scan[l] = v;
    workgroupBarrier();
  }
}
