// A room in 3-D on WebGL2: Gaussians as ellipsoids, points, lines, triangles, and a transmitter to drag.
// Lengths are metres, +z is up, places on the screen are CSS pixels from the canvas's upper left corner.
// View coordinates are (right, up, forward) of the camera, so that the third is the depth.

// ---- Vectors -------------------------------------------------------------------------------------

const vec3Dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const vec3Add = (a, b, factor = 1) => [0, 1, 2].map((i) => a[i] + factor * b[i]);
const roomClamp = (value, low, high) => Math.min(Math.max(value, low), high);
const roomGap = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const roomBytes = (rgb, alpha) => [...rgb.map((part) => 255 * part), 255 * alpha].map(Math.round);

// ---- Shaders -------------------------------------------------------------------------------------

/** Begins every shader: the camera, and the step from the world to the view and on to the clip. */
const ROOM_CAMERA = `#version 300 es
precision highp float;
uniform vec3 eye;
uniform mat3 axes;      // columns: right, up, forward
uniform vec2 focal;     // to the edge of the canvas at depth 1, inverted
uniform vec2 range;     // nearest and farthest depth
uniform vec2 viewport;  // CSS pixels
uniform float ratio;    // device pixels to a CSS pixel
vec3 toView(vec3 place) { return (place - eye) * axes; }
float clipDepth(float w) { return ((range.y + range.x) * w - 2.0 * range.y * range.x) / (range.y - range.x); }
vec4 toClip(vec3 view) { return vec4(focal * view.xy, clipDepth(view.z), view.z); }
`;

/** One quad to an ellipsoid, just as large as its projection. */
const ROOM_ELLIPSOID_VERTEX = `${ROOM_CAMERA}
layout(location = 0) in vec3 mean;
layout(location = 1) in vec3 scales;
layout(location = 2) in vec4 quat;
layout(location = 3) in vec4 colour;
uniform float spread;
out vec3 start;             // the ray at the depth of the mean, where the ellipsoid is the unit sphere
out vec3 along;             // the ray from the eye to there, in the same frame
flat out vec3 inverse;      // one over the half-axes
flat out vec3 light;        // towards the light, in the frame of the half-axes
flat out vec4 tint;
flat out float reach;       // depth of start
const float LEAST_PIXELS = 1.5;

mat3 rotation(vec4 q) {
  q = dot(q, q) > 0.0 ? normalize(q) : vec4(1, 0, 0, 0);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Bounds of x / w over the ellipsoid, from the centre and from the half-axes' parts along x and w.
// The discriminant is written so that small ellipsoids far away do not cancel.
vec2 bounds(float x, vec3 halfX, float w, vec3 halfW) {
  if (w - length(halfW) < range.x) return vec2(-1, 1);
  float c = w * w - dot(halfW, halfW);
  vec3 side = x * halfW - w * halfX, area = cross(halfX, halfW);
  float root = sqrt(max(dot(side, side) - dot(area, area), 0.0));
  return (x * w - dot(halfX, halfW) + vec2(-root, root)) / c;
}

void main() {
  vec3 centre = toView(mean);
  reach = max(centre.z, range.x);
  vec3 size = max(abs(scales) * spread, LEAST_PIXELS * reach * 2.0 / (focal.y * viewport.y));
  mat3 local = transpose(rotation(quat)) * axes;  // the camera's axes in the frame of the half-axes
  vec3 deep = local[2] * size;
  vec2 spanX = bounds(focal.x * centre.x, focal.x * local[0] * size, centre.z, deep);
  vec2 spanY = bounds(focal.y * centre.y, focal.y * local[1] * size, centre.z, deep);
  vec2 corner = vec2((gl_VertexID & 1) == 0 ? spanX.x - 2.0 / viewport.x : spanX.y + 2.0 / viewport.x,
                     (gl_VertexID & 2) == 0 ? spanY.x - 2.0 / viewport.y : spanY.y + 2.0 / viewport.y);
  corner = clamp(corner, -1.0, 1.0);
  bool hidden = centre.z + length(deep) < range.x || colour.a == 0.0;
  vec3 place = vec3(corner / focal, 1) * reach;
  start = local * (place - centre) / size;
  along = local * place / size;
  inverse = 1.0 / size;
  light = local * normalize(vec3(-0.45, 0.65, -0.8));
  tint = colour;
  gl_Position = hidden ? vec4(2, 2, 2, 1) : vec4(corner, 0, 1);
}`;

/**
 * Meets the ray with the unit sphere. Pale ellipsoids cover fewer samples of a pixel, in any order of drawing;
 * what a whole number of samples leaves over is mixed with the background.
 */
const ROOM_ELLIPSOID_FRAGMENT = `${ROOM_CAMERA}
in vec3 start;
in vec3 along;
flat in vec3 inverse;
flat in vec3 light;
flat in vec4 tint;
flat in float reach;
uniform float samples;
uniform vec3 background;
out vec4 pixel;

void main() {
  float size = length(along);
  vec3 unit = along / size;
  float middle = dot(unit, start);
  vec3 miss = start - unit * middle;
  float radius = length(miss);
  float edge = clamp((1.0 - radius) / max(fwidth(radius), 1e-6) + 0.5, 0.0, 1.0);
  if (samples < 2.0) edge = step(0.5, edge);
  float cover = samples < 2.0 ? 1.0 : ceil(tint.a * samples) / samples;
  float inside = sqrt(max(1.0 - radius * radius, 0.0));
  float depth = reach * (1.0 - (middle + inside) / size);
  if (edge <= 0.0 || depth < range.x) discard;
  vec3 normal = normalize((miss - unit * inside) * inverse);
  float shade = 0.66 + 0.38 * dot(normal, light);
  pixel = vec4(mix(background, min(tint.rgb * shade, 1.0), tint.a / cover), cover * edge);
  gl_FragDepth = 0.5 + 0.5 * clipDepth(depth) / depth;
}`;

const ROOM_POINT_VERTEX = `${ROOM_CAMERA}
layout(location = 0) in vec3 place;
layout(location = 1) in vec4 colour;
uniform float size;
flat out vec4 tint;
void main() {
  tint = colour;
  gl_Position = toClip(toView(place));
  gl_PointSize = size * ratio;
}`;

/** Shapes: 0 dot, 1 ring, 2 square, 3 ball with a rim. */
const ROOM_POINT_FRAGMENT = `${ROOM_CAMERA}
flat in vec4 tint;
uniform float size;
uniform float shape;
uniform vec3 background;
out vec4 pixel;
void main() {
  vec2 at = gl_PointCoord * 2.0 - 1.0;
  float radius = length(at), device = 0.5 * size * ratio;
  float cover = shape == 2.0 ? 1.0 : clamp((1.0 - radius) * device, 0.0, 1.0);
  if (shape == 1.0) cover *= clamp((radius - 1.0 + 4.0 / size) * device, 0.0, 1.0);
  vec3 colour = tint.rgb;
  if (shape == 3.0) {
    float gleam = 1.15 - 0.55 * length(at + 0.3);
    colour = mix(min(colour * gleam + 0.12 * gleam, 1.0), background, clamp((radius - 0.76) * device, 0.0, 1.0));
  }
  pixel = vec4(colour, tint.a * cover);
  if (pixel.a < 0.02) discard;
}`;

/** One quad to a segment, cut where it passes behind the camera. */
const ROOM_LINE_VERTEX = `${ROOM_CAMERA}
layout(location = 0) in vec3 from;
layout(location = 1) in vec3 to;
layout(location = 2) in vec4 colour;
uniform float width;
flat out vec4 tint;
vec3 cut(vec3 a, vec3 b, float near) { return a.z >= near ? a : mix(a, b, (near - a.z) / (b.z - a.z)); }
void main() {
  tint = colour;
  vec3 a = toView(from), b = toView(to);
  float near = range.x * 1.001;
  if (max(a.z, b.z) <= near) { gl_Position = vec4(2, 2, 2, 1); return; }
  vec4 begin = toClip(cut(a, b, near)), end = toClip(cut(b, a, near));
  vec2 step = (end.xy / end.w - begin.xy / begin.w) * viewport;
  vec2 course = dot(step, step) > 0.0 ? normalize(step) : vec2(1, 0);
  vec2 side = vec2(-course.y, course.x) * width / viewport * ((gl_VertexID & 1) == 0 ? -1.0 : 1.0);
  vec4 here = gl_VertexID < 2 ? begin : end;
  gl_Position = here + vec4(side * here.w, 0, 0);
}`;

const ROOM_LINE_FRAGMENT = `${ROOM_CAMERA}
flat in vec4 tint;
out vec4 pixel;
void main() { pixel = tint; }`;

const ROOM_TRIANGLE_VERTEX = `${ROOM_CAMERA}
layout(location = 0) in vec3 place;
out vec3 view;
void main() {
  view = toView(place);
  gl_Position = toClip(view);
}`;

const ROOM_TRIANGLE_FRAGMENT = `${ROOM_CAMERA}
in vec3 view;
uniform vec4 fill;
out vec4 pixel;
void main() {
  vec3 normal = cross(dFdx(view), dFdy(view));
  float facing = abs(dot(normal, view)) / max(length(normal) * length(view), 1e-20);
  pixel = vec4(fill.rgb * (0.7 + 0.3 * facing), fill.a);
}`;

const ROOM_SHADERS = {
  ellipsoid: [ROOM_ELLIPSOID_VERTEX, ROOM_ELLIPSOID_FRAGMENT],
  point: [ROOM_POINT_VERTEX, ROOM_POINT_FRAGMENT],
  line: [ROOM_LINE_VERTEX, ROOM_LINE_FRAGMENT],
  triangle: [ROOM_TRIANGLE_VERTEX, ROOM_TRIANGLE_FRAGMENT],
};

// ---- The graphics processor ----------------------------------------------------------------------

/** Compiles a program and looks up its uniforms: {program, uniforms: name -> location}. */
function roomProgram(gl, sources) {
  const program = gl.createProgram();
  sources.forEach((source, index) => {
    const shader = gl.createShader(index ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    gl.deleteShader(shader);
  });
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`shader: ${gl.getProgramInfoLog(program)} ${logs.join(" ")}`);
  }
  const uniforms = {};
  for (let i = 0; i < (gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) || 0); i++) {
    const { name } = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

/** Sets those of the values that the program has: numbers, vectors of 2 to 4, and 3 x 3 matrices. */
function roomUniforms(gl, { uniforms }, values) {
  for (const [name, value] of Object.entries(values)) {
    const location = uniforms[name];
    if (!location) continue;
    if (typeof value === "number") gl.uniform1f(location, value);
    else if (value.length === 9) gl.uniformMatrix3fv(location, false, value);
    else gl[`uniform${value.length}fv`](location, value);
  }
}

/**
 * Things that are drawn by one call.
 * `columns` are [array, widths...]: the rows of the array hold attributes of these widths, one after the other.
 * With `corners` every row is an instance of that many vertices; otherwise every row is a vertex.
 */
function roomBatch(kind, columns, { corners = 0, ...style } = {}) {
  const rows = columns.map(([array, ...widths]) => array.length / widths.reduce((a, b) => a + b));
  if (rows.some((count) => count !== rows[0] || !Number.isInteger(count))) {
    throw new Error(`${kind}: arrays of ${rows.join(", ")} rows`);
  }
  return { kind, columns, corners, count: rows[0], style, vao: null, buffers: [] };
}

function roomUpload(gl, batch) {
  batch.vao = gl.createVertexArray();
  gl.bindVertexArray(batch.vao);
  let index = 0;
  batch.buffers = batch.columns.map(([array, ...widths]) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.DYNAMIC_DRAW);
    const floats = array instanceof Float32Array;
    const step = array.BYTES_PER_ELEMENT;
    const stride = step * widths.reduce((a, b) => a + b);
    let offset = 0;
    for (const width of widths) {
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, width, floats ? gl.FLOAT : gl.UNSIGNED_BYTE, !floats, stride, offset);
      gl.vertexAttribDivisor(index++, batch.corners ? 1 : 0);
      offset += step * width;
    }
    return buffer;
  });
}

function roomFree(gl, batch) {
  if (!batch?.vao) return;
  gl.deleteVertexArray(batch.vao);
  batch.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
  batch.vao = null;
}

const roomPoints = (positions, colours, style) => roomBatch("point", [[positions, 3], [colours, 4]], style);
const roomLines = (positions, colours, width) =>
  roomBatch("line", [[positions, 3, 3], [colours, 4]], { corners: 4, width });

/** The edges of a box and whole metres on its floor, as a batch of lines. */
function roomBox(low, high, ink) {
  const ends = [];
  const paint = [];
  const add = (a, b, alpha) => {
    ends.push(...a, ...b);
    paint.push(...roomBytes(ink, alpha));
  };
  const corner = (bits) => [0, 1, 2].map((i) => ((bits >> i) & 1 ? high[i] : low[i]));
  for (let bits = 0; bits < 8; bits++) {
    for (let i = 0; i < 3; i++) if (!((bits >> i) & 1)) add(corner(bits), corner(bits | (1 << i)), 0.5);
  }
  const extent = Math.max(high[0] - low[0], high[1] - low[1]);
  const step = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((metres) => extent <= 16 * metres) ?? extent / 10;
  for (let x = Math.ceil(low[0] / step) * step; x <= high[0]; x += step) {
    add([x, low[1], low[2]], [x, high[1], low[2]], 0.2);
  }
  for (let y = Math.ceil(low[1] / step) * step; y <= high[1]; y += step) {
    add([low[0], y, low[2]], [high[0], y, low[2]], 0.2);
  }
  return roomLines(new Float32Array(ends), new Uint8Array(paint), 1);
}

// ---- The camera ----------------------------------------------------------------------------------

/** Looks at a target from a distance; yaw turns about +z from +x, pitch rises above the floor (radians). */
class RoomCamera {
  constructor() {
    Object.assign(this, { yaw: -1.05, pitch: 0.5, distance: 10, target: [0, 0, 0], width: 1, height: 1 });
    this.setBounds([-1, -1, -1], [1, 1, 1]);
  }

  setBounds(low, high) {
    this.low = [...low];
    this.high = [...high];
    this.reach = Math.max(Math.hypot(...vec3Add(high, low, -1)), 1e-6);
  }

  /** Directions of the camera in the world: right, up and forward [3]. */
  get axes() {
    const [cy, sy] = [Math.cos(this.yaw), Math.sin(this.yaw)];
    const [cp, sp] = [Math.cos(this.pitch), Math.sin(this.pitch)];
    return { right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp], forward: [-cp * cy, -cp * sy, -sp] };
  }

  get eye() {
    return vec3Add(this.target, this.axes.forward, -this.distance);
  }

  /** One over the tangents [2] from the middle to the edges; the shorter side spans 40 degrees. */
  get focal() {
    const focal = 1 / Math.tan(Math.PI / 9);
    const shorter = Math.min(this.width, this.height);
    return [(focal * shorter) / this.width, (focal * shorter) / this.height];
  }

  get uniforms() {
    const { right, up, forward } = this.axes;
    const centre = vec3Add(this.low, this.high).map((part) => part / 2);
    const far = Math.hypot(...vec3Add(this.eye, centre, -1)) + 2 * this.reach;
    const range = [Math.max(0.01 * this.distance, 0.002 * this.reach), far];
    const viewport = [this.width, this.height];
    return { eye: this.eye, axes: [...right, ...up, ...forward], focal: this.focal, range, viewport };
  }

  /** Place [3] on the screen and its depth: [x, y, metres]; no numbers behind the camera. */
  project(place) {
    const { right, up, forward } = this.axes;
    const ray = vec3Add(place, this.eye, -1);
    const depth = vec3Dot(ray, forward);
    if (!(depth > 0)) return [NaN, NaN, depth];
    const [fx, fy] = this.focal;
    const [x, y] = [(fx * vec3Dot(ray, right)) / depth, (fy * vec3Dot(ray, up)) / depth];
    return [(this.width * (1 + x)) / 2, (this.height * (1 - y)) / 2, depth];
  }

  /** Direction [3] from the eye through a place [2] of the screen, one metre deep. */
  ray(at) {
    const { right, up, forward } = this.axes;
    const [fx, fy] = this.focal;
    const across = vec3Add(forward, right, ((2 * at[0]) / this.width - 1) / fx);
    return vec3Add(across, up, (1 - (2 * at[1]) / this.height) / fy);
  }

  /** Metres to a CSS pixel at a depth. */
  metres(depth) {
    return (2 * depth) / (this.focal[1] * this.height);
  }

  /** Steps back until the whole box is seen, with a margin. */
  frame() {
    const { right, up, forward } = this.axes;
    const [fx, fy] = this.focal;
    this.target = vec3Add(this.low, this.high).map((part) => part / 2);
    this.distance = 0;
    for (let bits = 0; bits < 8; bits++) {
      const corner = [0, 1, 2].map((i) => ((bits >> i) & 1 ? 0.5 : -0.5) * (this.high[i] - this.low[i]));
      const wide = Math.max(fx * Math.abs(vec3Dot(corner, right)), fy * Math.abs(vec3Dot(corner, up)));
      this.distance = Math.max(this.distance, 1.08 * wide - vec3Dot(corner, forward));
    }
  }

  turn(yaw, pitch) {
    this.yaw = (this.yaw + yaw) % (2 * Math.PI);
    this.pitch = roomClamp(this.pitch + pitch, -Math.PI / 2, Math.PI / 2);
  }

  zoom(factor) {
    this.distance = roomClamp(this.distance * factor, 0.02 * this.reach, 8 * this.reach);
  }

  /** Moves the target so that the picture follows the pointer by (dx, dy) pixels. */
  pan(dx, dy) {
    const metres = this.metres(this.distance);
    this.target = vec3Add(vec3Add(this.target, this.axes.right, -dx * metres), this.axes.up, dy * metres);
  }
}

// ---- The hand ------------------------------------------------------------------------------------

/** Turns pointer events on the canvas into views, places of the transmitter, and picks. */
class RoomHand {
  constructor(room) {
    this.room = room;
    this.pointers = new Map();
    this.act = null;
    this.ends = new AbortController();
    const listen = (type, react) =>
      room.canvas.addEventListener(type, react, { signal: this.ends.signal, passive: false });
    listen("pointerdown", (event) => this.down(event));
    listen("pointermove", (event) => this.move(event));
    listen("pointerup", (event) => this.up(event));
    listen("pointercancel", (event) => this.up(event));
    listen("contextmenu", (event) => event.preventDefault());
    listen("wheel", (event) => this.wheel(event));
    room.canvas.style.touchAction = "none";
    room.canvas.style.cursor = "grab";
  }

  place(event) {
    const { canvas } = this.room;
    const { left, top } = canvas.getBoundingClientRect();
    return [event.clientX - left - canvas.clientLeft, event.clientY - top - canvas.clientTop];
  }

  onTransmitter(at) {
    const { transmitter } = this.room;
    return transmitter !== null && roomGap(this.room.project(transmitter), at) <= 22;
  }

  down(event) {
    const at = this.place(event);
    this.pointers.set(event.pointerId, at);
    try {
      this.room.canvas.setPointerCapture(event.pointerId);
    } catch {
      // An event made by a script has no pointer to capture.
    }
    let kind = event.button === 0 ? "orbit" : "pan";
    if (event.button === 0 && this.onTransmitter(at)) kind = "carry";
    if (this.pointers.size > 1) kind = "pinch";
    this.act = { kind, start: at, last: at, moved: kind === "pinch", clicks: event.button === 0 };
    this.room.canvas.style.cursor = kind === "carry" ? "move" : "grabbing";
  }

  move(event) {
    const at = this.place(event);
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.room.canvas.style.cursor = this.onTransmitter(at) ? "move" : "grab";
      return;
    }
    this.pointers.set(event.pointerId, at);
    const { act } = this;
    if (act.kind === "pinch") act.last = before;
    if (!act.moved && roomGap(act.start, at) < 4) return;
    act.moved = true;
    this[act.kind](at, event);
    act.last = at;
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const { act } = this;
    const [rest] = this.pointers.values();
    if (rest) {
      this.act = { kind: this.pointers.size > 1 ? "pinch" : "orbit", start: rest, last: rest, moved: true };
      return;
    }
    this.act = null;
    this.room.canvas.style.cursor = this.onTransmitter(this.place(event)) ? "move" : "grab";
    if (event.type === "pointerup" && act.clicks && !act.moved) this.room.pick(act.start);
  }

  wheel(event) {
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    this.room.zoom(Math.exp(roomClamp(pixels * (event.ctrlKey ? 0.01 : 0.0012), -0.5, 0.5)));
  }

  orbit(at) {
    this.room.turn((this.act.last[0] - at[0]) * 0.006, (at[1] - this.act.last[1]) * 0.006);
  }

  pan(at, _event, share = 1) {
    this.room.camera.pan(share * (at[0] - this.act.last[0]), share * (at[1] - this.act.last[1]));
    this.room.viewed();
  }

  pinch(at, event) {
    const [, other] = [...this.pointers].find(([id]) => id !== event.pointerId);
    this.room.camera.zoom(Math.max(roomGap(this.act.last, other), 1) / Math.max(roomGap(at, other), 1));
    this.pan(at, event, 0.5);
  }

  /** Moves the transmitter so that it stays under the pointer where it was taken. */
  carry(at, event) {
    const { act, room } = this;
    const lifts = event.shiftKey || room.dragsHeight;
    if (act.lifts !== lifts) {
      const [x, y] = room.camera.project(room.transmitter);
      const edge = Math.abs(room.camera.ray([x, y])[2]) < 0.1;
      Object.assign(act, { lifts, edge, grip: [act.last[0] - x, act.last[1] - y] });
    }
    const ray = room.camera.ray([at[0] - act.grip[0], at[1] - act.grip[1]]);
    const step = [at[0] - act.last[0], at[1] - act.last[1]];
    room.carried(lifts ? this.lifted(ray, step) : this.slid(ray, step));
  }

  /** In the horizontal plane; along the screen where the plane is seen edge-on. */
  slid(ray, [dx, dy]) {
    const { camera, transmitter } = this.room;
    const { eye, axes } = camera;
    if (this.act.edge) {
      const metres = camera.metres(camera.project(transmitter)[2]);
      const away = [-Math.cos(camera.yaw), -Math.sin(camera.yaw), 0];
      return vec3Add(vec3Add(transmitter, axes.right, dx * metres), away, -dy * metres);
    }
    const depth = (transmitter[2] - eye[2]) / ray[2];
    return depth > 0 ? [...vec3Add(eye, ray, depth).slice(0, 2), transmitter[2]] : transmitter;
  }

  /** In height only; along the screen where the vertical is seen end-on. */
  lifted(ray, [, dy]) {
    const { camera, transmitter } = this.room;
    const [x, y, z] = transmitter;
    const away = [-Math.cos(camera.yaw), -Math.sin(camera.yaw), 0];
    const pace = vec3Dot(ray, away);
    if (Math.cos(camera.pitch) < 0.1 || pace < 0.02) {
      return [x, y, z - dy * camera.metres(camera.project(transmitter)[2])];
    }
    return [x, y, camera.eye[2] + (ray[2] * vec3Dot(vec3Add(transmitter, camera.eye, -1), away)) / pace];
  }
}

// ---- The room ------------------------------------------------------------------------------------

const ROOM_SHAPES = { dot: 0, ring: 1, square: 2, ball: 3 };
const ROOM_TRANSMITTER = [0.9, 0.22, 0.16];

/** The renderer of one canvas, whose size must be given by CSS. */
export class Room {
  /** Throws an Error where the browser has no WebGL2. */
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: true });
    if (!this.gl) throw new Error("this browser has no WebGL2");
    this.camera = new RoomCamera();
    this.batches = new Map();
    this.transmitter = null;
    this.selected = null;
    this.dragsHeight = false;
    this.onTransmitter = () => {};
    this.onPick = () => {};
    this.onView = () => {};
    this.frames = 0;
    this.lastFrameMs = 0;
    this.spread = 1;
    this.request = 0;
    this.kept = false; // whether the view is the user's, not to be framed again
    this.compile();
    this.setTheme({ background: [1, 1, 1], ink: [0.1, 0.1, 0.12] });
    this.hand = new RoomHand(this);
    this.listen();
  }

  listen() {
    const options = { signal: this.hand.ends.signal };
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault(), options);
    this.canvas.addEventListener("webglcontextrestored", () => this.restore(), options);
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(this.canvas);
  }

  compile() {
    this.programs = {};
    for (const [kind, sources] of Object.entries(ROOM_SHADERS)) {
      this.programs[kind] = roomProgram(this.gl, sources);
    }
    this.samples = this.gl.getParameter(this.gl.SAMPLES) || 0;
  }

  restore() {
    for (const batch of this.batches.values()) batch.vao = null;
    this.compile();
    this.redraw();
  }

  /** Puts a batch (or null) in the place of the one of that name. */
  put(name, batch) {
    roomFree(this.gl, this.batches.get(name));
    if (batch) this.batches.set(name, batch);
    else this.batches.delete(name);
    this.redraw();
  }

  /** Colours of the background and of lines and marks, [3] each in 0..1. */
  setTheme({ background, ink }) {
    this.background = [...background];
    this.ink = [...ink];
    if (this.batches.has("box")) this.drawBounds();
    this.mark();
  }

  /** Corners [3] of the room; frames it as long as nobody has chosen a view. */
  setBounds(low, high) {
    this.camera.setBounds(low, high);
    this.drawBounds();
    this.mark();
    if (!this.kept) this.frame();
  }

  drawBounds() {
    this.put("box", roomBox(this.camera.low, this.camera.high, this.ink));
  }

  /** A named layer of points: positions [N, 3], RGBA colours [N, 4], size in pixels; null removes it. */
  setPoints(name, layer) {
    if (!layer) return this.put(`points ${name}`, null);
    const { positions, colours, size = 4, shape = "dot", pickable = false } = layer;
    const style = { layer: name, size, shape: ROOM_SHAPES[shape] ?? 0, pickable };
    this.put(`points ${name}`, roomPoints(positions, colours, style));
  }

  /** A named layer of segments: positions [K, 2, 3], RGBA colours [K, 4]; null removes it. */
  setLines(name, layer) {
    this.put(`lines ${name}`, layer && roomLines(layer.positions, layer.colours, 1.6));
  }

  /** A translucent mesh: positions [T, 3, 3], one colour [r, g, b, a] in 0..1; null removes it. */
  setTriangles(mesh) {
    const batch = mesh && roomBatch("triangle", [[mesh.positions, 3]], { fill: [...mesh.colour] });
    this.put("mesh", batch);
  }

  /** Means [N, 3], standard deviations [N, 3], quaternions w x y z [N, 4], RGBA colours [N, 4]; or null. */
  setGaussians(cloud) {
    if (!cloud) return this.put("gaussians", null);
    const columns = [[cloud.means, 3], [cloud.scales, 3], [cloud.quats, 4], [cloud.colours, 4]];
    this.put("gaussians", roomBatch("ellipsoid", columns, { corners: 4 }));
  }

  /** New RGBA colours [N, 4] for the Gaussians that are there. */
  setGaussianColours(colours) {
    const batch = this.batches.get("gaussians");
    if (!batch || colours.length !== 4 * batch.count) {
      throw new Error(`${colours.length / 4} colours for ${batch?.count ?? 0} Gaussians`);
    }
    batch.columns[3][0] = colours;
    if (batch.vao) {
      this.gl.bindBuffer(this.gl.ARRAY_BUFFER, batch.buffers[3]);
      this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, colours);
    }
    this.redraw();
  }

  /** Ellipsoids reach to this many standard deviations. */
  setSpread(deviations) {
    this.spread = deviations;
    this.redraw();
  }

  /** Place [3] of the transmitter, or null. */
  setTransmitter(position) {
    this.transmitter = position && [...position];
    this.mark();
  }

  /** Place [3] to put a ring around, or null. */
  setSelected(position) {
    this.selected = position && [...position];
    this.mark();
  }

  /** Makes the marks on top anew: the transmitter, its stem and its foot on the floor, and the selection. */
  mark() {
    const single = (place, colour, size, shape) =>
      place && roomPoints(new Float32Array(place), new Uint8Array(roomBytes(colour, 1)), { size, shape });
    const { transmitter: at, selected } = this;
    const foot = at && [at[0], at[1], this.camera.low[2]];
    const red = new Uint8Array(roomBytes(ROOM_TRANSMITTER, 0.85));
    this.put("over stem", at && roomLines(new Float32Array([...at, ...foot]), red, 2));
    this.put("over foot", single(foot, ROOM_TRANSMITTER, 11, ROOM_SHAPES.ring));
    this.put("over selected", single(selected, this.ink, 19, ROOM_SHAPES.ring));
    this.put("over ball", single(at, ROOM_TRANSMITTER, 22, ROOM_SHAPES.ball));
  }

  /** Takes the transmitter where the hand has moved it, within the room grown by half its size. */
  carried(position) {
    const { low, high } = this.camera;
    const size = vec3Add(high, low, -1);
    this.setTransmitter(position.map((p, i) => roomClamp(p, low[i] - size[i] / 2, high[i] + size[i] / 2)));
    this.onTransmitter([...this.transmitter]);
  }

  /** Tells of the pickable point that is nearest to a place of the screen, if one is near. */
  pick(at) {
    let best = null;
    this.measure();
    for (const { style, columns } of this.batches.values()) {
      if (!style.pickable) continue;
      const [positions] = columns[0];
      const limit = Math.max(10, style.size / 2 + 4);
      for (let i = 0; 3 * i < positions.length; i++) {
        const [x, y, depth] = this.camera.project(positions.subarray(3 * i, 3 * i + 3));
        const rank = roomGap([x, y], at) + (1e-3 * depth) / this.camera.reach;
        if (rank <= limit && !(best?.rank <= rank)) best = { rank, layer: style.layer, index: i };
      }
    }
    if (best) this.onPick(best.layer, best.index);
  }

  /** Yaw, pitch, distance and target as plain numbers. */
  get view() {
    const { yaw, pitch, distance, target } = this.camera;
    return { yaw, pitch, distance, target: [...target] };
  }

  set view({ yaw, pitch, distance, target }) {
    Object.assign(this.camera, { yaw, pitch, distance, target: [...target] });
    this.kept = true;
    this.redraw();
  }

  /** Steps back until the whole room is seen. */
  frame() {
    this.kept = false;
    this.measure();
    this.camera.frame();
    this.redraw();
  }

  /** Turns about the target by angles in radians. */
  turn(dyaw, dpitch) {
    this.camera.turn(dyaw, dpitch);
    this.viewed();
  }

  /** Multiplies the distance to the target. */
  zoom(factor) {
    this.camera.zoom(factor);
    this.viewed();
  }

  viewed() {
    this.kept = true;
    this.redraw();
    this.onView();
  }

  /** Place [3] on the canvas in CSS pixels [2]; no numbers behind the camera. */
  project(place) {
    this.measure();
    return this.camera.project(place).slice(0, 2);
  }

  /** Takes the canvas's CSS size; says whether there is one. */
  measure() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return false;
    const changed = width !== this.camera.width || height !== this.camera.height;
    Object.assign(this.camera, { width, height });
    if (changed && !this.kept) this.camera.frame();
    return true;
  }

  /** Asks for a frame; many calls make one. */
  redraw() {
    if (this.request || this.disposed) return;
    this.request = requestAnimationFrame(() => {
      this.request = 0;
      this.draw();
    });
  }

  /** Draws at once. */
  draw() {
    const { gl } = this;
    if (gl.isContextLost() || !this.measure()) return;
    const begin = performance.now();
    this.clear();
    const batches = [...this.batches].filter(([name]) => !name.startsWith("over "));
    const over = [...this.batches].filter(([name]) => name.startsWith("over "));
    const paint = (list, kind) => list.forEach(([, batch]) => batch.kind === kind && this.paint(batch));
    gl.enable(gl.DEPTH_TEST);
    for (const kind of ["ellipsoid", "line", "point"]) paint(batches, kind);
    gl.depthMask(false);
    paint(batches, "triangle");
    gl.disable(gl.DEPTH_TEST);
    for (const kind of ["line", "point"]) paint(over, kind);
    gl.depthMask(true);
    gl.bindVertexArray(null);
    this.frames += 1;
    this.lastFrameMs = performance.now() - begin;
  }

  /** Fits the buffer to the canvas, clears it and tells every program of the camera. */
  clear() {
    const { gl, canvas, camera } = this;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(camera.width * ratio), Math.round(camera.height * ratio)];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    gl.viewport(0, 0, width, height);
    gl.clearColor(...this.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const shared = { spread: this.spread, samples: this.samples, background: this.background, ratio };
    for (const program of Object.values(this.programs)) {
      gl.useProgram(program.program);
      roomUniforms(gl, program, { ...camera.uniforms, ...shared });
    }
  }

  /** Draws one batch; ellipsoids cover samples by their alpha, all others blend. */
  paint(batch) {
    const { gl } = this;
    const solid = batch.kind === "ellipsoid";
    if (!batch.count) return;
    if (!batch.vao) roomUpload(gl, batch);
    gl[solid ? "disable" : "enable"](gl.BLEND);
    gl[solid ? "enable" : "disable"](gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.useProgram(this.programs[batch.kind].program);
    roomUniforms(gl, this.programs[batch.kind], batch.style);
    gl.bindVertexArray(batch.vao);
    if (batch.corners) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, batch.corners, batch.count);
    else gl.drawArrays(batch.kind === "point" ? gl.POINTS : gl.TRIANGLES, 0, batch.count);
  }

  /** Ends listening and frees what the graphics processor holds. */
  dispose() {
    this.disposed = true;
    cancelAnimationFrame(this.request);
    this.observer.disconnect();
    this.hand.ends.abort();
    for (const batch of this.batches.values()) roomFree(this.gl, batch);
    for (const { program } of Object.values(this.programs)) this.gl.deleteProgram(program);
    this.batches.clear();
  }
}
