// Loss of images A against measured ones B, [links, H·W]: `loss.rs` and `ssim.rs` on the CPU. H has the taps of the window of
// SSIM, and the shares of the error and of SSIM of a pixel in the loss.

const TAPS: u32 = 11u;
const HALF_TAPS: u32 = 5u;
const ERROR_SHARE: u32 = 11u;
const SSIM_SHARE: u32 = 12u;
const C1: f32 = 1e-4;
const C2: f32 = 9e-4;
// Bits of `mode`.
const SQUARED: u32 = 1u;
const SSIM: u32 = 2u;

// C are the means of P, G, P² + G² and PG along the row of each pixel, [links, 4, H·W]; zeros beyond the border.
@compute @workgroup_size(256)
fn blur_moments(@builtin(global_invocation_id) g: vec3u) {
  let size = s.width * s.height;
  if (g.x >= size) { return; }
  let x = g.x % s.width; let row = g.y * size + g.x - x;
  var sum = vec4f();
  for (var k = 0u; k < TAPS; k++) {
    let at = x + k - HALF_TAPS; // large if negative
    if (at < s.width) {
      let p = A[row + at]; let t = B[row + at];
      sum += H[k] * vec4f(p, t, p * p + t * t, p * t);
    }
  }
  for (var m = 0u; m < 4u; m++) { C[(4u * g.y + m) * size + g.x] = sum[m]; }
}

// The blur of plane m of E [links, 4, H·W] along the column of a pixel.
fn blur_column(link: u32, m: u32, pixel: u32) -> f32 {
  let size = s.width * s.height; let y = pixel / s.width; let start = (4u * link + m) * size + pixel % s.width;
  var sum = 0.0;
  for (var k = 0u; k < TAPS; k++) {
    let at = y + k - HALF_TAPS;
    if (at < s.height) { sum += H[k] * E[start + at * s.width]; }
  }
  return sum;
}

// C are the derivatives of the similarity m by μ₁, σ₁² and σ₁₂, and m, [links, 4, H·W].
@compute @workgroup_size(256)
fn similarity(@builtin(global_invocation_id) g: vec3u) {
  let size = s.width * s.height;
  if (g.x >= size) { return; }
  let m1 = blur_column(g.y, 0u, g.x); let m2 = blur_column(g.y, 1u, g.x);
  let squares = blur_column(g.y, 2u, g.x); let e12 = blur_column(g.y, 3u, g.x);
  let a = m1 * m1 + m2 * m2 + C1;
  let b = (squares - (m1 * m1 + m2 * m2)) + C2;
  let c = 2.0 * m1 * m2 + C1;
  let d = 2.0 * (e12 - m1 * m2) + C2;
  let inverse = 1.0 / (a * b);
  let m = c * d * inverse;
  let o = 4u * g.y * size + g.x;
  C[o] = 2.0 * (m2 * (d - c) + m1 * m * (a - b)) * inverse;
  C[o + size] = -m * a * inverse;
  C[o + 2u * size] = 2.0 * c * inverse;
  C[o + 3u * size] = m;
}

// C are the first three planes of A [links, 4, H·W], blurred along rows.
@compute @workgroup_size(256)
fn blur_d_similarity(@builtin(global_invocation_id) g: vec3u) {
  let size = s.width * s.height;
  if (g.x >= size) { return; }
  let x = g.x % s.width;
  for (var m = 0u; m < 3u; m++) {
    let row = (4u * g.y + m) * size + g.x - x;
    var sum = 0.0;
    for (var k = 0u; k < TAPS; k++) {
      let at = x + k - HALF_TAPS;
      if (at < s.width) { sum += H[k] * A[row + at]; }
    }
    C[row + x] = sum;
  }
}

// C is the derivative of the loss by A, given what `blur_d_similarity` left in E.
@compute @workgroup_size(256)
fn loss_vjp(@builtin(global_invocation_id) g: vec3u) {
  let size = s.width * s.height;
  if (g.x >= size) { return; }
  let at = g.y * size + g.x; let p = A[at]; let t = B[at]; let error = p - t; let share = H[ERROR_SHARE];
  var d = select(share * sign(error), 2.0 * share * error, (s.mode & SQUARED) != 0u);
  if ((s.mode & SSIM) != 0u) {
    d -= H[SSIM_SHARE] * (blur_column(g.y, 0u, g.x) + 2.0 * p * blur_column(g.y, 1u, g.x) + t * blur_column(g.y, 2u, g.x));
  }
  C[at] = d;
}

// C are the sums of the errors and of 1 − m over the pixels, [links, 2], with the m of `similarity` in E; a workgroup per link.
var<workgroup> of_lanes: array<vec2f, 256>;
@compute @workgroup_size(256)
fn sum_loss(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let size = s.width * s.height;
  var lane = vec2f();
  for (var p = l; p < size; p += 256u) {
    let error = A[w.x * size + p] - B[w.x * size + p];
    lane.x += select(abs(error), error * error, (s.mode & SQUARED) != 0u);
    if ((s.mode & SSIM) != 0u) { lane.y += 1.0 - E[(4u * w.x + 3u) * size + p]; }
  }
  of_lanes[l] = lane;
  workgroupBarrier();
  if (l > 0u) { return; }
  var all = vec2f();
  for (var i = 0u; i < 256u; i++) { all += of_lanes[i]; }
  C[2u * w.x] = all.x; C[2u * w.x + 1u] = all.y;
}
