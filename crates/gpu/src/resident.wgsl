// Whole training steps whose parameters stay on the GPU. The state [x, m, v] of P parameters has their values, then both moments
// of Adam. Columns of the Gaussians follow each other: means [n, 3], log scales [n, 3], rotations [n, 4], opacity logits [n],
// signals [n, 2]. Outputs of the network are [9, n]: rotations 4, scales 3, signals 2. Rows of drawings are in depth order; the
// keys are [2, k]: depths, and the index of the Gaussian of each row.

struct Op {
  n: u32,                       // Gaussians, or numbers
  a: u32, c: u32,               // offsets in A and C
  k: u32, j: u32,
  x0: f32, x1: f32, x2: f32, x3: f32, x4: f32, x5: f32, x6: f32, x7: f32, x8: f32,
}

struct Wave { sine: f32, cosine: f32 }
// Sine and cosine of up to about 50,000 rad: the built-in functions may be off by 5e-4. The parts of pi/2 have few bits, so that
// their multiples are exact.
fn wave_of(x: f32) -> Wave {
  let quarter = floor(x * 0.63661977 + 0.5);
  let r = ((x - quarter * 1.5703125) - quarter * 4.837512969970703e-4) - quarter * 7.54978995489188e-8;
  let z = r * r;
  let sine = fma(fma(fma(-1.9515295891e-4, z, 8.3321608736e-3), z, -1.6666654611e-1) * z, r, r);
  let cosine = fma(fma(fma(2.443315711809948e-5, z, -1.388731625493765e-3), z, 4.166664568298827e-2) * z, z, 1.0 - 0.5 * z);
  let turn = u32(i32(quarter)) & 3u;
  let swapped = (turn & 1u) == 1u;
  let s = select(sine, cosine, swapped); let c = select(cosine, sine, swapped);
  return Wave(select(s, -s, turn >= 2u), select(c, -c, turn == 1u || turn == 2u));
}

// C is the encoding [3 + 6 k, n] of the n means from offset a.
@compute @workgroup_size(256)
fn encode(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  for (var i = g.x; i < 3u * s.n; i += w.x * 256u) {
    let axis = i / s.n; let r = i % s.n;
    let x = A[s.a + 3u * r + axis];
    C[i] = x;
    var scale = 1.0;
    for (var f = 0u; f < s.k; f++) {
      let wave = wave_of(scale * x);
      let at = (3u + 6u * f + axis) * s.n + r;
      C[at] = wave.sine; C[at + 3u * s.n] = wave.cosine;
      scale *= 2.0;
    }
  }
}

// C are the keys of the means A, in index order; those beyond n come last.
@compute @workgroup_size(256)
fn depth_keys(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.k) { return; }
  var depth = 3e38;
  if (g.x < s.n) { depth = min(2e38, distance(vec3f(A[3u * g.x], A[3u * g.x + 1u], A[3u * g.x + 2u]), vec3f(s.x0, s.x1, s.x2))); }
  C[g.x] = depth; C[s.k + g.x] = f32(g.x);
}

// A bitonic sort by depth, then by index.
fn is_before(a: vec2f, b: vec2f) -> bool { return a.x < b.x || (a.x == b.x && a.y < b.y); }

// Exchanges of the pairs with distance j in blocks of a.
@compute @workgroup_size(256)
fn sort_pairs(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.k / 2u) { return; }
  let low = 2u * s.j * (g.x / s.j) + g.x % s.j; let high = low + s.j;
  let first = vec2f(C[low], C[s.k + low]); let second = vec2f(C[high], C[s.k + high]);
  if (is_before(second, first) == ((low & s.a) == 0u)) {
    C[low] = second.x; C[s.k + low] = second.y;
    C[high] = first.x; C[s.k + high] = first.y;
  }
}

// All exchanges with distances below 512, in blocks of j to a: a workgroup sorts 512 keys.
var<workgroup> sorted: array<vec2f, 512>;
@compute @workgroup_size(256)
fn sort_block(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let first = 512u * w.x;
  for (var i = l; i < 512u; i += 256u) { sorted[i] = vec2f(C[first + i], C[s.k + first + i]); }
  for (var block = s.j; block <= s.a; block *= 2u) {
    for (var d = min(block / 2u, 256u); d > 0u; d /= 2u) {
      workgroupBarrier();
      let low = 2u * d * (l / d) + l % d;
      let a = sorted[low]; let b = sorted[low + d];
      if (is_before(b, a) == (((first + low) & block) == 0u)) { sorted[low] = b; sorted[low + d] = a; }
    }
  }
  workgroupBarrier();
  for (var i = l; i < 512u; i += 256u) { C[first + i] = sorted[i].x; C[s.k + first + i] = sorted[i].y; }
}

// The index of the Gaussian in a row of a drawing.
fn gaussian_of(row: u32) -> u32 { return u32(B[s.k + row]); }

// C is the cloud of a drawing [n, 13] from the parameters A.
@compute @workgroup_size(64)
fn arrange_cloud(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x); let o = 13u * g.x;
  for (var c = 0u; c < 3u; c++) { C[o + c] = A[3u * i + c]; C[o + 3u + c] = A[3u * s.n + 3u * i + c]; }
  for (var c = 0u; c < 4u; c++) { C[o + 6u + c] = A[6u * s.n + 4u * i + c]; }
  C[o + 10u] = A[10u * s.n + i]; C[o + 11u] = 1.0; C[o + 12u] = 1.0;
}

// C are the terms of a drawing [n, 7] from the outputs A.
@compute @workgroup_size(64)
fn arrange_terms(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x);
  for (var c = 0u; c < 7u; c++) { C[7u * g.x + c] = A[((c + 4u) % 7u) * s.n + i]; }
}

// C are the signals of a drawing [n, j]: those of the parameters H and the outputs A.
@compute @workgroup_size(64)
fn arrange_signals(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x);
  for (var c = 0u; c < s.j; c++) { C[s.j * g.x + c] = H[11u * s.n + 2u * i + c] + A[(7u + c) * s.n + i]; }
}

// Adds the derivatives of a drawing, A by rows and H by splats with j signals, to those C by the parameters.
@compute @workgroup_size(64)
fn scatter_cloud(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x); let o = ROW * g.x; let signal = (GEOMETRY + s.j) * g.x + GEOMETRY;
  for (var c = 0u; c < 3u; c++) { C[3u * i + c] += A[o + c]; C[3u * s.n + 3u * i + c] += A[o + 3u + c]; }
  for (var c = 0u; c < 4u; c++) { C[6u * s.n + 4u * i + c] += A[o + 6u + c]; }
  C[10u * s.n + i] += A[o + 10u];
  for (var c = 0u; c < s.j; c++) { C[11u * s.n + 2u * i + c] += H[signal + c]; }
}

// C are the cotangents of the outputs [9, n] from the derivatives A by rows and H by splats with j signals.
@compute @workgroup_size(64)
fn scatter_terms(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x); let signal = (GEOMETRY + s.j) * g.x + GEOMETRY;
  for (var c = 0u; c < 7u; c++) { C[((c + 4u) % 7u) * s.n + i] = A[ROW * g.x + 12u + c]; }
  for (var c = 0u; c < 2u; c++) {
    var d = 0.0;
    if (c < s.j) { d = H[signal + c]; }
    C[(7u + c) * s.n + i] = d;
  }
}

// Adds a drawing to the statistics C [4, n]: renders in which it was visible, 2-D gradient, largest radius, weight; none for
// Gaussians whose splats E are too faint to be drawn. x0 and x1 are half the columns and rows, x2 the number of drawings of a
// step.
@compute @workgroup_size(64)
fn statistics(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let i = gaussian_of(g.x); let radius = A[ROW * g.x + 19u]; let o = (GEOMETRY + s.j) * g.x;
  if (radius <= 0.0 || E[SPLAT * g.x + 5u] < ALPHA_MIN) { return; }
  C[i] += 1.0;
  C[s.n + i] += s.x2 * length(vec2f(H[o] * s.x0, H[o + 1u] * s.x1));
  C[2u * s.n + i] = max(C[2u * s.n + i], radius);
  C[3u * s.n + i] += H[o + 6u];
}

// A step of Adam for n parameters from offset c of the state C [3, k], with their derivatives A from offset a. x0 is the rate, x1
// the addend, x2 and x3 the bias corrections, x4 the L2 decay, x5 the decay, x6 and x7 the rates of the moments, x8 negligible.
@compute @workgroup_size(256)
fn adam(@builtin(global_invocation_id) g: vec3u, @builtin(num_workgroups) w: vec3u) {
  const TINY = 1.1754944e-38;
  for (var i = g.x; i < s.n; i += w.x * 256u) {
    let at = s.c + i; let x = C[at];
    let d = A[s.a + i] + s.x4 * x;
    var m = s.x6 * C[at + s.k] + (1.0 - s.x6) * d;
    var v = s.x7 * C[at + 2u * s.k] + (1.0 - s.x7) * d * d;
    if (abs(m) < TINY) {
      m = 0.0;
      if (v < TINY) { v = 0.0; }
    }
    let step = (m / s.x2) / (sqrt(v / s.x3) + s.x1);
    var next = x - s.x0 * (step + s.x5 * x);
    if (s.x4 > 0.0 && abs(next) < s.x8) { next = 0.0; }
    C[at] = next; C[at + s.k] = m; C[at + 2u * s.k] = v;
  }
}
