// Tile lists and blending, a tile of 16 × 16 pixels per workgroup: `tiles.rs` and `blend.rs` on the CPU, with `Support::Exact`.
// Splats are [N, SPLAT], signals [N, links · channels].

const PART: u32 = 10u; // derivatives of a splat in a tile: those of GEOMETRY, and two of the signal

// Splat i with its signal for a transmitter.
struct Splat { mean: vec2f, opacity: f32, existence: f32, conic: vec3f, signal: vec2f }
fn splat_at(i: u32, link: u32) -> Splat {
  let o = i * SPLAT; let at = (i * s.links + link) * s.channels;
  var signal = vec2f(B[at], 0.0);
  if (s.channels == 2u) { signal.y = B[at + 1u]; }
  return Splat(vec2f(A[o], A[o + 1u]), A[o + 5u], A[o + 6u], vec3f(A[o + 2u], A[o + 3u], A[o + 4u]), signal);
}

// Returns the first pixel of a tile.
fn corner_of(tile: u32) -> vec2f { return vec2f(f32(tile % s.columns * SIDE), f32(tile / s.columns * SIDE)); }

// Wraps a column offset to the nearest copy on an image that wraps.
fn nearest(d: f32) -> f32 {
  let width = f32(s.width);
  return d - width * floor(d / width + 0.5);
}

// Returns whether the box of a splat reaches a tile. The alpha of the splat decides in each pixel.
fn touches(mean: vec2f, half: vec2f, corner: vec2f) -> bool {
  let middle = mean - corner - 7.5;
  return abs(nearest(middle.x)) <= half.x + 7.5 && abs(middle.y) <= half.y + 7.5;
}

// Splat p at the pixel `here`.
struct Drawn { offset: vec2f, gauss: f32, alpha: f32 } // alpha without the existence factor
fn draw_at(p: Splat, here: vec2f) -> Drawn {
  let d = vec2f(nearest(p.mean.x - here.x), p.mean.y - here.y);
  let power = fma(-(p.conic.y * d.y), d.x, -0.5 * p.conic.x * d.x * d.x + -0.5 * p.conic.z * d.y * d.y);
  let gauss = exponential(min(power, 0.0));
  let alpha = min(p.opacity * gauss, ALPHA_MAX);
  return Drawn(d, gauss, select(0.0, alpha, power <= 0.0 && alpha >= ALPHA_MIN));
}

// Compacts those of 256 Gaussians from `first` that touch a tile, in order: the position of each is scan[l] − 1. The upper
// half of the sums counts the pixels that are not final.
fn find_hits(l: u32, first: u32, corner: vec2f, is_live: bool) -> bool {
  let o = (first + l) * SPLAT;
  var hit = false;
  if (first + l < s.n) { hit = touches(vec2f(A[o], A[o + 1u]), vec2f(A[o + 7u], A[o + 8u]), corner); }
  scan_sums(l, select(0u, 1u, hit) + select(0u, 65536u, is_live));
  return hit;
}

// C are the pixels [links, 2, H·W], and then the length of each tile's list.
var<workgroup> hits: array<Splat, 256>;
@compute @workgroup_size(256)
fn blend(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let tile = w.x; let link = w.y; let corner = corner_of(tile);
  let at = vec2u(u32(corner.x) + l % SIDE, u32(corner.y) + l / SIDE);
  let inside = at.x < s.width && at.y < s.height;
  var t = 1.0; var is_live = inside; var sum = vec2f(); var listed = 0u;
  for (var first = 0u; first < s.n; first += 256u) {
    let hit = find_hits(l, first, corner, is_live);
    let position = scan[l] & 65535u;
    let total = workgroupUniformLoad(&scan[255]);
    if (total < 65536u) { break; } // all pixels are final
    if (hit) { hits[position - 1u] = splat_at(first + l, link); }
    let many = total & 65535u;
    listed += many;
    workgroupBarrier();
    for (var k = 0u; k < many && is_live; k++) {
      let p = hits[k];
      let alpha = draw_at(p, vec2f(at)).alpha * p.existence;
      let next = t * (1.0 - alpha);
      if (next < T_MIN) { is_live = false; break; }
      sum += alpha * t * p.signal;
      t = next;
    }
    workgroupBarrier();
  }
  let size = s.width * s.height;
  if (inside) {
    let pixel = 2u * link * size + at.y * s.width + at.x;
    C[pixel] = sum.x; C[pixel + size] = sum.y;
  }
  if (l == 0u && link == 0u) { C[2u * s.links * size + tile] = f32(listed); }
}

// C are the offsets [tiles + 1] of the lists, whose lengths follow the pixels A; one workgroup.
@compute @workgroup_size(256)
fn offsets(@builtin(local_invocation_index) l: u32) {
  let lengths = 2u * s.links * s.width * s.height;
  var sum = 0u;
  if (l == 0u) { C[0] = 0.0; }
  for (var first = 0u; first < s.tiles; first += 256u) {
    let tile = first + l;
    var length = 0u;
    if (tile < s.tiles) { length = u32(A[lengths + tile]); }
    scan_sums(l, length);
    if (tile < s.tiles) { C[tile + 1u] = f32(sum + scan[l]); }
    sum += workgroupUniformLoad(&scan[255]);
  }
}

// C are these offsets, and then the lists.
@compute @workgroup_size(256)
fn list(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let corner = corner_of(w.x); let start = s.tiles + 1u;
  var next = u32(C[w.x]); let end = u32(C[w.x + 1u]);
  for (var first = 0u; first < s.n; first += 256u) {
    let hit = find_hits(l, first, corner, false);
    let entry = next + scan[l] - 1u;
    if (hit && entry < end) { C[start + entry] = f32(first + l); }
    next += workgroupUniformLoad(&scan[255]);
    if (next >= end) { break; }
  }
}

// A workgroup has one invocation per Gaussian of the list, 256 at a time; the pixels pass by. In step k, invocation l is at
// pixel k − l: the state of a pixel goes from Gaussian to Gaussian through workgroup memory. So each Gaussian adds up its own
// derivative. E are the cotangents [links, 3, H·W]: two of the signal, and their product with the pixel. H are offsets and
// lists, and C the derivatives [entries, PART].
var<workgroup> state: array<vec4f, 256>; // transmittance (negative: final), sum behind, and cotangents 2
var<workgroup> bounds: array<u32, 2>;
@compute @workgroup_size(256)
fn blend_vjp(@builtin(local_invocation_index) l: u32, @builtin(workgroup_id) w: vec3u) {
  let tile = w.x; let corner = corner_of(tile); let size = s.width * s.height;
  let at = vec2u(u32(corner.x) + l % SIDE, u32(corner.y) + l / SIDE);
  state[l] = vec4f(-1.0, 0.0, 0.0, 0.0);
  if (at.x < s.width && at.y < s.height) {
    let pixel = 3u * s.link * size + at.y * s.width + at.x;
    state[l] = vec4f(1.0, E[pixel + 2u * size], E[pixel], E[pixel + size]);
  }
  if (l < 2u) { bounds[l] = u32(H[tile + l]); }
  let begin = workgroupUniformLoad(&bounds[0]); // also a barrier
  let end = workgroupUniformLoad(&bounds[1]);
  for (var first = begin; first < end; first += 256u) {
    let many = min(256u, end - first);
    let mine = l < many;
    var p: Splat;
    if (mine) { p = splat_at(u32(H[s.tiles + 1u + first + l]), s.link); }
    var d_mean = vec2f(); var d_conic = vec3f(); var d_opacity = 0.0; var weights = 0.0; var d_existence = 0.0;
    var d_signal = vec2f();
    for (var k = 0u; k < PIXELS + many - 1u; k++) {
      let at_pixel = k - l; // beyond PIXELS if negative
      if (mine && at_pixel < PIXELS && state[at_pixel].x > 0.0) {
        let v = state[at_pixel];
        let drawn = draw_at(p, corner + vec2f(f32(at_pixel % SIDE), f32(at_pixel / SIDE)));
        let alpha = drawn.alpha * p.existence;
        let next = v.x * (1.0 - alpha);
        if (next < T_MIN) {
          state[at_pixel].x = -v.x;
        } else if (drawn.alpha > 0.0) {
          let weight = alpha * v.x;
          let q = dot(p.signal, v.zw);
          let behind = v.y - weight * q;
          let d_alpha = v.x * q - behind / (1.0 - alpha);
          let d_power = d_alpha * p.existence * p.opacity * drawn.gauss;
          let d = drawn.offset;
          d_mean -= d_power * vec2f(p.conic.x * d.x + p.conic.y * d.y, p.conic.z * d.y + p.conic.y * d.x);
          d_conic -= d_power * vec3f(0.5 * d.x * d.x, d.x * d.y, 0.5 * d.y * d.y);
          d_opacity += d_alpha * p.existence * drawn.gauss;
          d_existence += d_alpha * drawn.alpha;
          weights += weight;
          d_signal += weight * v.zw;
          state[at_pixel].x = next; state[at_pixel].y = behind;
        }
      }
      workgroupBarrier();
    }
    if (mine) {
      let o = (first + l) * PART;
      C[o] = d_mean.x; C[o + 1u] = d_mean.y; C[o + 2u] = d_conic.x; C[o + 3u] = d_conic.y; C[o + 4u] = d_conic.z;
      C[o + 5u] = d_opacity; C[o + 6u] = weights; C[o + 7u] = d_existence; C[o + 8u] = d_signal.x; C[o + 9u] = d_signal.y;
    }
  }
}

// Adds the parts H of each Gaussian to its derivatives C [N, GEOMETRY + signals], in the order of the tiles. The lists B are
// sorted, so bisection finds a Gaussian.
@compute @workgroup_size(64)
fn sum_tiles(@builtin(global_invocation_id) g: vec3u) {
  let i = g.x; let o = i * SPLAT;
  if (i >= s.n) { return; }
  let mean = vec2f(A[o], A[o + 1u]); let half = vec2f(A[o + 7u], A[o + 8u]);
  var sums: array<f32, PART>;
  for (var tile = 0u; tile < s.tiles; tile++) {
    if (!touches(mean, half, corner_of(tile))) { continue; }
    var low = u32(B[tile]); let end = u32(B[tile + 1u]); var high = end;
    let start = s.tiles + 1u;
    while (low < high) {
      let middle = (low + high) / 2u;
      if (u32(B[start + middle]) < i) { low = middle + 1u; } else { high = middle; }
    }
    if (low < end && u32(B[start + low]) == i) {
      for (var k = 0u; k < PART; k++) { sums[k] += H[low * PART + k]; }
    }
  }
  let row = i * (GEOMETRY + s.channels * s.links);
  if (s.link > 0u) { sums[6] = 0.0; } // weights do not depend on the signal
  for (var k = 0u; k < GEOMETRY; k++) { C[row + k] += sums[k]; }
  for (var c = 0u; c < s.channels; c++) { C[row + GEOMETRY + s.link * s.channels + c] = sums[GEOMETRY + c]; }
}
