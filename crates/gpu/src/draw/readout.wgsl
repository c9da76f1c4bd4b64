// Readout, a transmitter per workgroup: `readout.rs` on the CPU. A are the pixels [links, 2, H·W].

const REAL: u32 = 0u;
const POWER: u32 = 2u;
const MIN_MAX: u32 = 3u; // otherwise the magnitude
const NO_CONTRAST: f32 = 1e-6;

var<workgroup> lowest: array<f32, 256>;
var<workgroup> highest: array<f32, 256>;
var<workgroup> firsts: array<vec2u, 256>;

fn value_at(link: u32, pixel: u32) -> f32 {
  let size = s.width * s.height; let at = 2u * link * size + pixel;
  let power = A[at] * A[at] + A[at + size] * A[at + size];
  return select(select(sqrt(power), power, s.mode == POWER), A[at], s.mode == REAL);
}

struct Range { low: f32, gain: f32, darkest: u32, brightest: u32 }

// Returns smallest value and gain of the image of a link, and the first pixels with the smallest and the largest value.
fn range_of(l: u32, link: u32) -> Range {
  if (s.mode != MIN_MAX) { return Range(0.0, 1.0, 0u, 0u); }
  let size = s.width * s.height;
  var low = value_at(link, 0u); var high = low; var first = vec2u(0u);
  for (var p = l; p < size; p += 256u) {
    let v = value_at(link, p);
    if (v < low || p == l) { low = v; first.x = p; }
    if (v > high || p == l) { high = v; first.y = p; }
  }
  if (l >= size) { low = value_at(link, 0u); high = low; }
  lowest[l] = low; highest[l] = high; firsts[l] = first;
  workgroupBarrier();
  for (var step = 128u; step > 0u; step >>= 1u) {
    if (l < step) {
      let o = l + step;
      if (lowest[o] < lowest[l] || (lowest[o] == lowest[l] && firsts[o].x < firsts[l].x)) {
        lowest[l] = lowest[o]; firsts[l].x = firsts[o].x;
      }
      if (highest[o] > highest[l] || (highest[o] == highest[l] && firsts[o].y < firsts[l].y)) {
        highest[l] = highest[o]; firsts[l].y = firsts[o].y;
      }
    }
    workgroupBarrier();
  }
  let contrast = highest[0] - lowest[0];
  return Range(lowest[0], select(0.0, 1.0 / contrast, contrast > NO_CONTRAST * highest[0]), firsts[0].x, firsts[0].y);
}

// C are the values [links, H·W].
@compute @workgroup_size(256)
fn read_out(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let size = s.width * s.height;
  let range = range_of(l, w.x);
  for (var p = l; p < size; p += 256u) { C[w.x * size + p] = (value_at(w.x, p) - range.low) * range.gain; }
}

// C are the cotangents of the pixels and their products with them [links, 3, H·W], given those B of the values.
var<workgroup> sums: array<vec2f, 256>;
@compute @workgroup_size(256)
fn read_out_vjp(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let size = s.width * s.height;
  let range = range_of(l, w.x);
  var of_ends = vec2f(); // cotangents of the smallest and of the largest value
  if (s.mode == MIN_MAX) {
    var sum = vec2f();
    for (var p = l; p < size; p += 256u) {
      let d = B[w.x * size + p] * range.gain;
      sum += d * vec2f(1.0, (value_at(w.x, p) - range.low) * range.gain);
    }
    sums[l] = sum;
    workgroupBarrier();
    var all = vec2f();
    for (var i = 0u; i < 256u; i++) { all += sums[i]; }
    of_ends = vec2f(all.x - all.y, all.y);
  }
  for (var p = l; p < size; p += 256u) {
    let at = 2u * w.x * size + p;
    let signal = vec2f(A[at], A[at + size]);
    var d = B[w.x * size + p] * range.gain;
    if (s.mode == MIN_MAX && p == range.darkest) { d -= of_ends.x; }
    if (s.mode == MIN_MAX && p == range.brightest) { d -= of_ends.y; }
    var d_signal = vec2f(d, 0.0);
    if (s.mode == POWER) {
      d_signal = 2.0 * signal * d;
    } else if (s.mode != REAL) {
      let size_of_signal = value_at(w.x, p);
      d_signal = select(vec2f(), signal * (d / size_of_signal), size_of_signal > 0.0);
    }
    let o = 3u * w.x * size + p;
    C[o] = d_signal.x; C[o + size] = d_signal.y; C[o + 2u * size] = dot(d_signal, signal);
  }
}
