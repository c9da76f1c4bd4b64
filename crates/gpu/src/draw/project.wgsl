// Activation and projection, a Gaussian per invocation: `activate.rs`, `ewa.rs` and `mercator.rs` on the CPU.
// A is the cloud [N, 13]: mean, log scales, rotation, opacity logit, gate, existence. B has the terms of the network [N, 7]
// for scales and rotation. H is the view: rotation (9, row by row), offset (3), columns and rows per radian (12, 13), columns
// (14), rows above row 0 (15), filter (16), nearest distance (17), sine of the lowest elevation (18), stride and offsets of the
// sampled pixels (19 to 21), rows of the whole image (22).

const CLOUD: u32 = 13u;
const TERMS: u32 = 7u;
const SCALE_FLOOR: f32 = 1e-4;
const COS_FLOOR: f32 = 0.008726535498373935;
const ON_AXIS: f32 = 1e-6;
const REACH: f32 = 3.3290421;

fn per_radian() -> vec2f { return vec2f(H[12], H[13]); }
fn view_rotation() -> mat3x3f { return mat3x3f(H[0], H[3], H[6], H[1], H[4], H[7], H[2], H[5], H[8]); }
fn sampled() -> vec3f { return vec3f(H[19], H[20], H[21]); } // stride and offsets

// Gaussian i after activation: scales and rotation without (`base`, `unit`) and with the terms (`scale`, `sum`, `rotation`).
struct Active { base: vec3f, scale: vec3f, unit: vec4f, sum: vec4f, rotation: vec4f, opacity: f32, gate: f32 }

fn vec3_of(i: u32) -> vec3f { return vec3f(A[i], A[i + 1u], A[i + 2u]); }

// Returns q/|q|, or the identity close to zero, and its derivative.
fn unit_of(q: vec4f) -> vec4f {
  let norm = sqrt(dot(q, q));
  return select(vec4f(1.0, 0.0, 0.0, 0.0), q / max(norm, 1e-12), norm > 1e-12);
}
fn unit_vjp(q: vec4f, d: vec4f) -> vec4f {
  let norm = sqrt(dot(q, q));
  let unit = q / max(norm, 1e-12);
  return select(vec4f(), (d - unit * dot(unit, d)) / max(norm, 1e-12), norm > 1e-12);
}

fn activate(i: u32) -> Active {
  let at = i * CLOUD; let t = i * TERMS;
  var d_scale = vec3f(); var d_turn = vec4f();
  if (s.mode == 1u) {
    d_scale = vec3f(B[t], B[t + 1u], B[t + 2u]);
    d_turn = vec4f(B[t + 3u], B[t + 4u], B[t + 5u], B[t + 6u]);
  }
  var a: Active;
  let logs = vec3_of(at + 3u);
  a.base = vec3f(exponential(logs.x), exponential(logs.y), exponential(logs.z));
  a.scale = a.base + d_scale;
  a.unit = vec4f(A[at + 6u], A[at + 7u], A[at + 8u], A[at + 9u]);
  a.sum = unit_of(a.unit) + d_turn;
  a.rotation = unit_of(a.sum);
  a.opacity = 1.0 / (1.0 + exponential(-A[at + 10u]));
  a.gate = A[at + 11u];
  return a;
}

// Returns the rotation matrix of a unit quaternion, and its derivative.
fn matrix_of(q: vec4f) -> mat3x3f {
  let w = q.x; let x = q.y; let y = q.z; let z = q.w;
  return mat3x3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}
fn matrix_vjp(q: vec4f, d: mat3x3f) -> vec4f {
  let w = q.x; let x = q.y; let y = q.z; let z = q.w;
  return 2.0 * vec4f(z * (d[0].y - d[1].x) + y * (d[2].x - d[0].z) + x * (d[1].z - d[2].y),
                     y * (d[1].x + d[0].y) + z * (d[2].x + d[0].z) + w * (d[1].z - d[2].y) - 2.0 * x * (d[1].y + d[2].z),
                     x * (d[1].x + d[0].y) + z * (d[2].y + d[1].z) + w * (d[2].x - d[0].z) - 2.0 * y * (d[0].x + d[2].z),
                     x * (d[2].x + d[0].z) + y * (d[2].y + d[1].z) + w * (d[0].y - d[1].x) - 2.0 * z * (d[0].x + d[1].y));
}

// The angle of (x, y) by a polynomial: the built-in function may be off by 4096 units in the last place.
fn angle(y: f32, x: f32) -> f32 {
  let most = max(abs(x), abs(y));
  if (!(most > 0.0)) { return 0.0; }
  var t = min(abs(x), abs(y)) / most;
  var start = 0.0;
  if (t > 0.41421357) { start = 0.7853982; t = (t - 1.0) / (t + 1.0); }
  let z = t * t;
  let p = fma(fma(fma(8.0537446e-2, z, -0.13877686), z, 0.19977711), z, -0.3333295);
  var a = start + fma(p * z, t, t);
  if (abs(y) > abs(x)) { a = 1.5707964 - a; }
  if (x < 0.0) { a = 3.1415927 - a; }
  return select(a, -a, y < 0.0);
}

// Distances from the vertical axis and from the receiver, and whether the azimuth is defined.
struct Centre { rho: f32, r: f32, off_axis: bool }
fn centre_of(v: vec3f) -> Centre {
  let rho = sqrt(v.x * v.x + v.y * v.y); let r = length(v);
  return Centre(rho, r, rho > ON_AXIS * r);
}

// Returns column and row on the whole image.
fn pixel_of(v: vec3f, c: Centre) -> vec2f {
  let k = per_radian();
  let row = angle(v.z, select(0.0, c.rho, c.off_axis)) * k.y - H[15];
  var column = select(0.0, angle(v.y, v.x) * k.x, c.off_axis);
  if (column < 0.0) { column += H[14]; }
  return vec2f(select(column, 0.0, column >= H[14]), row);
}

// Gradients of the azimuth, times rho², and of the elevation.
fn azimuth_slope(v: vec3f) -> vec3f { return vec3f(-v.y, v.x, 0.0); }
fn elevation_slope(v: vec3f, c: Centre) -> vec3f {
  return vec3f(-v.z * v.x / c.rho, -v.z * v.y / c.rho, c.rho) / (c.r * c.r);
}

// Returns the gradients of column and row by the position, and their backward pass.
struct Rows { column: vec3f, row: vec3f }
fn jacobian(v: vec3f, c: Centre) -> Rows {
  let k = per_radian();
  if (!c.off_axis) {
    let side = select(1.0, -1.0, v.z < 0.0);
    return Rows(vec3f(0.0, k.x / (COS_FLOOR * c.r), 0.0), vec3f(-side * k.y / c.r, 0.0, 0.0));
  }
  return Rows(azimuth_slope(v) / (c.rho * max(c.rho, COS_FLOOR * c.r)) * k.x, elevation_slope(v, c) * k.y);
}
fn jacobian_vjp(v: vec3f, c: Centre, d: Rows) -> vec3f {
  let k = per_radian();
  let rho = c.rho; let r = c.r;
  let r2 = r * r; let r3 = r2 * r; let rho2 = rho * rho;
  if (!c.off_axis) {
    let side = select(1.0, -1.0, v.z < 0.0);
    return v * ((k.y * side * d.row.x - k.x / COS_FLOOR * d.column.y) / r3);
  }
  let g = v.x * d.column.y - v.y * d.column.x;
  let d_g = vec3f(d.column.y, -d.column.x, 0.0);
  let d_rho = vec3f(v.x, v.y, 0.0) / rho;
  let d_r = v / r;
  var around = d_g / rho2 - d_rho * (2.0 * g / (rho2 * rho));
  if (rho < COS_FLOOR * r) {
    around = (d_g / (rho * r) - d_rho * (g / (rho2 * r)) - d_r * (g / (rho * r2))) / COS_FLOOR;
  }
  let h = v.x * d.row.x + v.y * d.row.y;
  let d_h = vec3f(d.row.x, d.row.y, 0.0);
  let up = (vec3f(0.0, 0.0, h) + d_h * v.z) * (-1.0 / (rho * r2)) + d_rho * (v.z * h / (rho2 * r2) + d.row.z / r2)
         + d_r * (2.0 * v.z * h / (rho * r3) - 2.0 * rho * d.row.z / r3);
  return around * k.x + up * k.y;
}

// Gaussian i on the image. v is its centre in the frame of the view; cov has the entries xx, xy, yy.
struct Projected {
  v: vec3f, centre: Centre, t0: vec3f, t1: vec3f, u0: vec3f, u1: vec3f, turn: mat3x3f, scale: vec3f, cov: vec3f, det: f32,
  pixel: vec2f, radius: f32,    // on the whole image; radius 0 if it is not drawn
}
fn project_one(i: u32, a: Active) -> Projected {
  var p: Projected;
  let view = view_rotation(); let back = transpose(view);
  p.v = view * vec3_of(i * CLOUD) + vec3f(H[9], H[10], H[11]);
  p.centre = centre_of(p.v);
  p.turn = matrix_of(a.rotation);
  p.scale = a.gate * max(a.scale, vec3f(SCALE_FLOOR));
  let j = jacobian(p.v, p.centre);
  p.t0 = back * j.column; p.t1 = back * j.row;
  p.u0 = (p.t0 * p.turn) * p.scale; p.u1 = (p.t1 * p.turn) * p.scale;
  let blur = H[16];
  let aa = dot(p.u0, p.u0); let cc = dot(p.u1, p.u1);
  let crossed = cross(p.u0, p.u1);
  p.det = dot(crossed, crossed) + blur * (aa + cc) + blur * blur;
  p.cov = vec3f(aa + blur, dot(p.u0, p.u1), cc + blur);
  p.pixel = pixel_of(p.v, p.centre);
  let r = p.centre.r;
  let visible = r > H[17] && r > 0.0 && p.v.z >= H[18] * r && p.det > 0.0 && p.det < 3e38;
  let half = REACH * sqrt(p.cov.z);
  let middle = 0.5 * (p.cov.x + p.cov.z);
  let radius = ceil(3.0 * sqrt(middle + sqrt(max(middle * middle - p.det, 0.1))));
  let inside = p.pixel.y + half >= 0.0 && p.pixel.y - half <= H[22] - 1.0;
  p.radius = select(0.0, radius, visible && inside && radius < 3e38);
  return p;
}

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let a = activate(g.x);
  let p = project_one(g.x, a);
  let sample = sampled(); let stride = sample.x;
  var mean = (p.pixel - sample.yz) / stride;
  if (mean.x < 0.0) { mean.x += f32(s.width); }
  let conic = vec3f(p.cov.z, -p.cov.y, p.cov.x) / p.det * (stride * stride);
  let opacity = a.gate * a.opacity;
  var half = vec2f(-1e9); // touches nothing
  if (p.radius > 0.0 && opacity >= ALPHA_MIN) {
    // Rounding in the kernels grows with the ratio of the axes of a slanted splat.
    let margin = 1.003 + 1e-6 * p.cov.z / p.det * p.cov.x;
    let level = 2.0 * max(log(opacity / ALPHA_MIN), 0.0) * margin + 1e-4;
    half = sqrt(p.cov.xz * level) / stride + 0.02;
  }
  let o = g.x * SPLAT;
  C[o] = mean.x; C[o + 1u] = mean.y;
  C[o + 2u] = conic.x; C[o + 3u] = conic.y; C[o + 4u] = conic.z;
  C[o + 5u] = opacity; C[o + 6u] = A[g.x * CLOUD + 12u];
  C[o + 7u] = half.x; C[o + 8u] = half.y;
  C[o + 9u] = ceil(p.radius / stride);
}

// C [N, ROW] from the derivatives E of the splats [N, GEOMETRY + signals].
@compute @workgroup_size(64)
fn project_vjp(@builtin(global_invocation_id) g: vec3u) {
  if (g.x >= s.n) { return; }
  let o = g.x * ROW;
  let a = activate(g.x);
  let p = project_one(g.x, a);
  if (p.radius == 0.0) {
    for (var k = 0u; k < ROW; k++) { C[o + k] = 0.0; }
    return;
  }
  let e = g.x * (GEOMETRY + s.channels * s.links);
  let stride = sampled().x; let k = per_radian();
  let d_pixel = vec2f(E[e], E[e + 1u]) / stride;
  let d_conic = vec3f(E[e + 2u], E[e + 3u], E[e + 4u]) * (stride * stride);
  let d_opacity = E[e + 5u];
  // The derivative of the inverse of the covariance: −Q G Q with the conic Q and the symmetric cotangent G.
  let q = vec3f(p.cov.z, -p.cov.y, p.cov.x) / p.det;
  let h = 0.5 * d_conic.y;
  let m0 = q.x * d_conic.x + q.y * h; let m1 = q.x * h + q.y * d_conic.z;
  let m2 = q.y * d_conic.x + q.z * h; let m3 = q.y * h + q.z * d_conic.z;
  let d_cov = -vec3f(m0 * q.x + m1 * q.y, (m0 * q.y + m1 * q.z) + (m2 * q.x + m3 * q.y), m2 * q.y + m3 * q.z);
  let d_u0 = p.u0 * (2.0 * d_cov.x) + p.u1 * d_cov.y;
  let d_u1 = p.u1 * (2.0 * d_cov.z) + p.u0 * d_cov.y;
  let view = view_rotation();
  var d_v = jacobian_vjp(p.v, p.centre, Rows(view * (p.turn * (p.scale * d_u0)), view * (p.turn * (p.scale * d_u1))));
  if (p.centre.off_axis) {
    d_v += azimuth_slope(p.v) / (p.centre.rho * p.centre.rho) * (d_pixel.x * k.x)
         + elevation_slope(p.v, p.centre) * (d_pixel.y * k.y);
  }
  let d_mean = transpose(view) * d_v;
  // uᵣ = Mᵀ tᵣ with M = R S: column k of ∂L/∂M is Σᵣ tᵣ (∂L/∂uᵣ)ₖ.
  let d_m = mat3x3f(p.t0 * d_u0.x + p.t1 * d_u1.x, p.t0 * d_u0.y + p.t1 * d_u1.y, p.t0 * d_u0.z + p.t1 * d_u1.z);
  let d_scale = vec3f(dot(p.turn[0], d_m[0]), dot(p.turn[1], d_m[1]), dot(p.turn[2], d_m[2]));
  let d_turn = matrix_vjp(a.rotation, mat3x3f(d_m[0] * p.scale.x, d_m[1] * p.scale.y, d_m[2] * p.scale.z));
  let floored = a.scale < vec3f(SCALE_FLOOR);
  let d_term = select(a.gate * d_scale, vec3f(), floored);
  let d_log = d_term * a.base;
  let d_sum = unit_vjp(a.sum, d_turn);
  let d_quat = unit_vjp(a.unit, d_sum);
  C[o] = d_mean.x; C[o + 1u] = d_mean.y; C[o + 2u] = d_mean.z;
  C[o + 3u] = d_log.x; C[o + 4u] = d_log.y; C[o + 5u] = d_log.z;
  C[o + 6u] = d_quat.x; C[o + 7u] = d_quat.y; C[o + 8u] = d_quat.z; C[o + 9u] = d_quat.w;
  C[o + 10u] = a.gate * d_opacity * a.opacity * (1.0 - a.opacity);
  C[o + 11u] = dot(d_scale, max(a.scale, vec3f(SCALE_FLOOR))) + d_opacity * a.opacity;
  C[o + 12u] = d_term.x; C[o + 13u] = d_term.y; C[o + 14u] = d_term.z;
  C[o + 15u] = d_sum.x; C[o + 16u] = d_sum.y; C[o + 17u] = d_sum.z; C[o + 18u] = d_sum.w;
  C[o + 19u] = ceil(p.radius / stride);
}
