// Passes of networks over blocks of rows. A block is feature-major, as on the CPU: `[F, R]`, rows contiguous. Matrices lie in
// buffers with offsets and strides, in numbers. Every sum has one order, which depends only on the shapes.

struct Op {
  m: u32, n: u32, k: u32,       // C is [m, n]; k terms in a sum
  slice: u32,                   // terms in the sum of one plane
  a: u32, a0: u32, a1: u32,     // offset and strides of A
  b: u32, b0: u32, b1: u32,
  c: u32, c0: u32,              // offset of C and its stride from row to row
  h: u32, e: u32,               // offsets of H and E
  mode: u32,
  planes: u32,
}

// Bits of `mode`.
const BIAS: u32 = 1u;   // + H[row]
const RELU: u32 = 2u;   // zero if negative
const PLUS: u32 = 4u;   // + E
const MASK: u32 = 8u;   // zero where E is not positive
const ADD: u32 = 16u;   // added to C

fn relu(v: f32) -> f32 {
  return select(v, 0.0, v < 0.0); // NaN stays NaN, as on the CPU
}

// C = A·B, [m, n]. A workgroup computes 64 × 64 numbers, an invocation 8 × 8 of them. The z-th layer of workgroups sums the z-th
// slice of terms, into the z-th plane of C.
const SIDE: u32 = 64u;
const DEPTH: u32 = 16u;
const PITCH: u32 = 17u; // vectors from one term to the next in workgroup memory, against bank conflicts
var<workgroup> tile_a: array<vec4f, 272>;
var<workgroup> tile_b: array<vec4f, 272>;

// Numbers of A and B; 0 outside the matrix, and from term `end` on.
fn load_a(row: u32, k: u32, end: u32) -> f32 {
  let at = s.a + min(row, s.m - 1u) * s.a0 + min(k, s.k - 1u) * s.a1;
  return select(0.0, A[at], row < s.m && k < end);
}

fn load_b(k: u32, column: u32, end: u32) -> f32 {
  let at = s.b + min(k, s.k - 1u) * s.b0 + min(column, s.n - 1u) * s.b1;
  return select(0.0, B[at], column < s.n && k < end);
}

// Stores a number of C with the operations of `mode`; nothing outside the matrix.
fn store(row: u32, column: u32, plane: u32, sum: f32) {
  if (row >= s.m || column >= s.n) { return; }
  var v = sum;
  let other = s.e + row * s.n + column;
  if ((s.mode & PLUS) != 0u) { v += E[other]; }
  if ((s.mode & BIAS) != 0u) { v += H[s.h + row]; }
  if ((s.mode & RELU) != 0u) { v = relu(v); }
  if ((s.mode & MASK) != 0u) { v = select(0.0, v, E[other] > 0.0); }
  let at = s.c + plane * s.m * s.n + row * s.c0 + column;
  if ((s.mode & ADD) != 0u) { v += C[at]; }
  C[at] = v;
}

// Stores four numbers of neighbouring columns.
fn store4(row: u32, column: u32, plane: u32, sums: vec4f) {
  store(row, column, plane, sums.x);
  store(row, column + 1u, plane, sums.y);
  store(row, column + 2u, plane, sums.z);
  store(row, column + 3u, plane, sums.w);
}

@compute @workgroup_size(64)
fn product(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let row0 = w.y * SIDE; let column0 = w.x * SIDE;
  let tx = l % 8u; let ty = l / 8u;
  var acc: array<vec4f, 16>;
  let begin = w.z * s.slice;
  let end = min(begin + s.slice, s.k);
  for (var k0 = begin; k0 < end; k0 += DEPTH) {
    // Neighbouring invocations read along the smaller stride.
    for (var i = 0u; i < 4u; i++) {
      let q = l + i * 64u;
      var k = q / 16u; var r = q % 16u;
      if (s.a1 == 1u) { k = q % 16u; r = q / 16u; }
      let row = row0 + 4u * r;
      tile_a[k * PITCH + r] = vec4f(load_a(row, k0 + k, end), load_a(row + 1u, k0 + k, end),
                                    load_a(row + 2u, k0 + k, end), load_a(row + 3u, k0 + k, end));
      k = q / 16u; r = q % 16u;
      if (s.b0 == 1u) { k = q % 16u; r = q / 16u; }
      let column = column0 + 4u * r;
      tile_b[k * PITCH + r] = vec4f(load_b(k0 + k, column, end), load_b(k0 + k, column + 1u, end),
                                    load_b(k0 + k, column + 2u, end), load_b(k0 + k, column + 3u, end));
    }
    workgroupBarrier();
    for (var k = 0u; k < DEPTH; k++) {
      let b0 = tile_b[k * PITCH + tx]; let b1 = tile_b[k * PITCH + 8u + tx];
      let a0 = tile_a[k * PITCH + ty]; let a1 = tile_a[k * PITCH + 8u + ty];
      acc[0] = fma(vec4f(a0.x), b0, acc[0]); acc[1] = fma(vec4f(a0.x), b1, acc[1]);
      acc[2] = fma(vec4f(a0.y), b0, acc[2]); acc[3] = fma(vec4f(a0.y), b1, acc[3]);
      acc[4] = fma(vec4f(a0.z), b0, acc[4]); acc[5] = fma(vec4f(a0.z), b1, acc[5]);
      acc[6] = fma(vec4f(a0.w), b0, acc[6]); acc[7] = fma(vec4f(a0.w), b1, acc[7]);
      acc[8] = fma(vec4f(a1.x), b0, acc[8]); acc[9] = fma(vec4f(a1.x), b1, acc[9]);
      acc[10] = fma(vec4f(a1.y), b0, acc[10]); acc[11] = fma(vec4f(a1.y), b1, acc[11]);
      acc[12] = fma(vec4f(a1.z), b0, acc[12]); acc[13] = fma(vec4f(a1.z), b1, acc[13]);
      acc[14] = fma(vec4f(a1.w), b0, acc[14]); acc[15] = fma(vec4f(a1.w), b1, acc[15]);
    }
    workgroupBarrier();
  }
  for (var i = 0u; i < 8u; i++) {
    let row = row0 + (i / 4u) * 32u + ty * 4u + i % 4u;
    store4(row, column0 + tx * 4u, w.z, acc[2u * i]);
    store4(row, column0 + 32u + tx * 4u, w.z, acc[2u * i + 1u]);
  }
}

// C[m, n] += the sum of the planes of A, in order.
@compute @workgroup_size(64)
fn sum_planes(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.m * s.n) { return; }
  var sum = 0.0;
  for (var p = 0u; p < s.planes; p++) { sum += A[p * s.m * s.n + g.x]; }
  C[s.c + (g.x / s.n) * s.c0 + g.x % s.n] += sum;
}

// C[slice, feature] = the sum of a slice of rows of A [m, n]; a workgroup for each.
var<workgroup> lanes: array<f32, 64>;
@compute @workgroup_size(64)
fn sum_rows(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let end = min((w.x + 1u) * s.slice, s.n);
  var lane = 0.0;
  for (var r = w.x * s.slice + l; r < end; r += 64u) { lane += A[s.a + w.y * s.n + r]; }
  lanes[l] = lane;
  workgroupBarrier();
  if (l > 0u) { return; }
  var sum = 0.0;
  for (var i = 0u; i < 64u; i++) { sum += lanes[i]; }
  C[w.x * s.m + w.y] = sum;
}

// C = relu(A + H[feature]), [m, n].
@compute @workgroup_size(256)
fn bias_relu(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  for (var i = g.x; i < s.m * s.n; i += w.x * 256u) { C[i] = relu(A[i] + H[s.h + i / s.n]); }
}

// C += A, m · n numbers.
@compute @workgroup_size(256)
fn add(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  for (var i = g.x; i < s.m * s.n; i += w.x * 256u) { C[s.c + i] += A[s.a + i]; }
}

// Backward pass of S·A = |lrelu(A)|·|lrelu(B)| for n rows, with the cotangents E: C is [3, n]. Its first row becomes the
// cotangent before |lrelu| of A; that of B is added to the second row, and E·S·A to the third. The slope 0.01 is that of
// `dense.rs`.
fn amplitude(z: f32) -> f32 { return select(z, -0.01 * z, z < 0.0); }
fn slope(z: f32) -> f32 { return select(select(0.0, -0.01, z < 0.0), 1.0, z > 0.0); }
@compute @workgroup_size(256)
fn amplitudes_vjp(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  for (var i = g.x; i < s.n; i += w.x * 256u) {
    let signal = A[i]; let attenuation = B[i]; let d = E[i];
    C[i] = d * amplitude(attenuation) * slope(signal);
    C[s.n + i] += d * amplitude(signal) * slope(attenuation);
    C[2u * s.n + i] += d * amplitude(signal) * amplitude(attenuation);
  }
}

// Adds the derivative through the encoding A [3 + 6 L, n], with L = k and cotangent B, to C [3, n].
@compute @workgroup_size(256)
fn encode_vjp(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  for (var i = g.x; i < 3u * s.n; i += w.x * 256u) {
    var sum = B[i];
    var scale = 1.0;
    for (var f = 0u; f < s.k; f++) {
      let sine = (3u + 6u * f) * s.n + i; let cosine = sine + 3u * s.n;
      sum += scale * (A[cosine] * B[sine] - A[sine] * B[cosine]);
      scale *= 2.0;
    }
    C[i] += sum;
  }
}
