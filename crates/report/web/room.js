/*
 * Renderer of a room in WebGL2: Gaussians as ellipsoids, points, lines, triangles, and a transmitter to drag.
 * Vectors are arrays of three numbers in metres; z is up. Matrices are column-major, as in WebGL.
 */

function vec3Sub(a, b) {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

/** Vector a + k b. */
function vec3Add(a, b, k = 1) {
  return [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
}

function vec3Dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

function vec3Cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

function vec3Unit(a) {
  const length = Math.hypot(...a) || 1;
  return a.map((v) => v / length);
}

function mat4Multiply(a, b) {
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) {
    for (let r = 0; r < 4; r++) {
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    }
  }
  return out;
}

/** Perspective matrix; `half` is the tangent of half the vertical angle of view. */
function mat4Perspective(half, aspect, near, far) {
  const f = 1 / half;
  const d = near - far;
  return new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) / d, -1, 0, 0, (2 * near * far) / d, 0]);
}

/** Matrix from the room to the view with these axes. */
function mat4View(eye, [x, y, z]) {
  const at = (axis) => -vec3Dot(axis, eye);
  return new Float32Array([x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, at(x), at(y), at(z), 1]);
}

const ROOM_POINT_VERTEX = `#version 300 es
uniform mat4 camera; uniform float size;
layout(location = 0) in vec3 position; layout(location = 1) in vec4 colour;
out vec4 shade;
void main() { gl_Position = camera * vec4(position, 1.0); gl_PointSize = size; shade = colour; }`;

const ROOM_POINT_FRAGMENT = `#version 300 es
precision highp float;
uniform int shape; in vec4 shade; out vec4 pixel;
void main() {
  vec2 p = 2.0 * gl_PointCoord - 1.0;
  float r = shape == 1 ? max(abs(p.x), abs(p.y)) : shape == 3 ? abs(p.x) + abs(p.y) : length(p);
  if (shape >= 0 && r > 1.0 || shape >= 2 && r < 0.6) discard;
  pixel = shade;
}`;

const ROOM_ELLIPSOID_VERTEX = `#version 300 es
uniform mat4 camera; uniform vec3 eye; uniform vec3 right; uniform vec3 up; uniform float spread; uniform float pixelSize;
layout(location = 0) in vec2 corner; layout(location = 1) in vec3 mean; layout(location = 2) in vec3 scale;
layout(location = 3) in vec4 quat; layout(location = 4) in vec4 colour;
out vec3 ray; flat out vec3 origin; flat out mat3 turn; flat out vec3 radii; out vec4 shade; flat out vec3 middle;
mat3 rotation(vec4 q) {
  q /= max(length(q), 1e-12); float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}
void main() {
  float far = max(length(mean - eye), 1e-6);
  radii = max(abs(scale) * spread, vec3(1.5 * pixelSize * far));
  float reach = max(radii.x, max(radii.y, radii.z));
  // The square faces the eye, and holds the sphere around the ellipsoid in perspective too.
  vec3 ahead = (mean - eye) / far;
  vec3 side = normalize(cross(ahead, abs(ahead.z) > 0.99 ? right : vec3(0.0, 0.0, 1.0)));
  float grown = reach * far / sqrt(max(far * far - reach * reach, 1e-4 * far * far));
  vec3 place = mean + min(grown, 20.0 * reach) * (corner.x * side + corner.y * cross(side, ahead));
  turn = transpose(rotation(quat)); origin = turn * (eye - mean) / radii; ray = place - eye;
  middle = mean; shade = colour; gl_Position = camera * vec4(place, 1.0);
}`;

const ROOM_ELLIPSOID_FRAGMENT = `#version 300 es
precision highp float;
uniform mat4 camera; uniform vec3 eye; uniform vec3 light; uniform vec3 ahead; uniform float front;
in vec3 ray; flat in vec3 origin; flat in mat3 turn; flat in vec3 radii; in vec4 shade; flat in vec3 middle;
out vec4 pixel;
void main() {
  vec3 along = turn * ray / radii;
  float a = dot(along, along), b = dot(origin, along), c = dot(origin, origin) - 1.0;
  float root = b * b - a * c;
  if (root < 0.0) discard;
  float t = (-b - sqrt(root)) / a;
  if (t < 0.0 || dot(middle - eye, ahead) < front) discard;
  vec3 hit = origin + t * along;
  vec3 normal = normalize(transpose(turn) * (hit / radii));
  vec4 clip = camera * vec4(eye + t * ray, 1.0);
  gl_FragDepth = clamp(0.5 * clip.z / clip.w + 0.5, 0.0, 1.0);
  float lit = 0.62 + 0.38 * max(dot(normal, light), 0.0);
  pixel = vec4(shade.rgb * lit, shade.a);
}`;

const ROOM_FOV = 0.75;
/** Time without requested frames after which the view is at rest, ms. */
const ROOM_REST = 1500;
/** Minimum number of drawn Gaussians. */
const ROOM_LEAST = 1500;
/** Distance within which the pointer grasps the transmitter, pixels. */
const ROOM_GRASP = 22;
export const ROOM_TRANSMITTER = [204, 0, 119];

/** Room on a canvas. Throws if the browser has no WebGL2. */
export class Room {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!this.gl) throw new Error("WebGL2 is missing");
    this.layers = new Map();
    this.lines = new Map();
    this.meshes = new Map();
    this.ground = { background: [1, 1, 1], ink: [0.1, 0.1, 0.1] };
    this.spread = 0.4;
    this.frames = 0;
    this.most = Infinity;
    this.steady = 0;
    this.whole = true;
    this.lastFrameMs = 0;
    this.dragsHeight = false;
    this.onTransmitter = this.onPick = this.onView = () => {};
    this.looking = { yaw: -2.1, pitch: 0.55, distance: 10, target: [0, 0, 0] };
    canvas.style.touchAction = "none";
    canvas.style.cursor = "grab";
    this.prepare();
    this.listen();
    this.sizes = new ResizeObserver(() => this.redraw());
    this.sizes.observe(canvas);
  }

  /** Compiles the shaders, again after a lost context. */
  prepare() {
    const { gl } = this;
    this.pointProgram = roomProgram(gl, ROOM_POINT_VERTEX, ROOM_POINT_FRAGMENT);
    this.ellipsoidProgram = roomProgram(gl, ROOM_ELLIPSOID_VERTEX, ROOM_ELLIPSOID_FRAGMENT);
    this.corners = roomBuffer(gl, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
    for (const layer of [...this.layers.values(), ...this.lines.values(), ...this.meshes.values(), this.gaussians]) {
      if (layer) layer.buffers = null;
    }
  }

  /** Sets the colours of background and axes, from 0 to 1. */
  setTheme(ground) {
    this.ground = ground;
    if (this.bounds) this.drawBox();
    this.redraw();
  }

  /** Sets the corners of the room, metres: draws its box and fits it to the first view. */
  setBounds(low, high) {
    this.bounds = [low, high];
    const target = low.map((v, k) => (v + high[k]) / 2);
    this.looking = { ...this.looking, target, distance: 1.45 * Math.hypot(...vec3Sub(high, low)) };
    this.drawBox();
    this.redraw();
  }

  /** Twelve edges, and a grid of whole metres on the floor. */
  drawBox() {
    const [low, high] = this.bounds;
    const ends = [];
    const corner = (bits) => [0, 1, 2].map((k) => ((bits >> k) & 1 ? high[k] : low[k]));
    for (let bits = 0; bits < 8; bits++) {
      for (let k = 0; k < 3; k++) if (!((bits >> k) & 1)) ends.push([...corner(bits), ...corner(bits | (1 << k)), 150]);
    }
    const longest = Math.max(high[0] - low[0], high[1] - low[1]);
    const step = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((metres) => longest / metres <= 14) ?? longest;
    for (const [k, other] of [[0, 1], [1, 0]]) {
      for (let v = Math.ceil(low[k] / step) * step; v < high[k]; v += step) {
        const end = (to) => [0, 0, low[2]].map((z, axis) => (axis === k ? v : axis === other ? to[other] : z));
        ends.push([...end(low), ...end(high), 60]);
      }
    }
    const colours = ends.flatMap((end) => [...this.ground.ink.map((v) => Math.round(255 * v)), end[6]]);
    this.setLines("box", { positions: new Float32Array(ends.flatMap((end) => end.slice(0, 6))), colours: new Uint8Array(colours) });
  }

  /**
   * Sets a layer of points: `positions` [N, 3], `colours` [N, 4], `size` in pixels, `shape` "dot", "square", "ring" or
   * "diamond";
   * `onTop` disables hiding by nearer objects; or null.
   */
  setPoints(name, layer) {
    this.replace(this.layers, name, layer);
  }

  /** Sets a layer of lines: `positions` [K, 2, 3], `colours` [K, 4]; or null. */
  setLines(name, layer) {
    this.replace(this.lines, name, layer);
  }

  /** Replaces the layer of this name and frees its memory. */
  replace(layers, name, layer) {
    this.free(layers.get(name));
    layers.delete(name);
    if (layer) layers.set(name, { ...layer, buffers: null });
    this.redraw();
  }

  free(layer) {
    layer?.buffers?.forEach((buffer) => this.gl.deleteBuffer(buffer));
  }

  /** Sets a transparent mesh: `positions` [T, 3, 3], and one `colour` from 0 to 1 or `colours` [T, 4]; or null. */
  setTriangles(name, layer) {
    this.replace(this.meshes, name, layer);
  }

  /** Sets the Gaussians: `means`, `scales` [N, 3], `quats` [N, 4] as w, x, y, z, `colours` [N, 4]; or null. */
  setGaussians(layer) {
    this.free(this.gaussians);
    this.gaussians = layer && { ...roomLargestFirst(layer), buffers: null };
    this.redraw();
  }

  /** Radius of the ellipsoids in standard deviations. */
  setSpread(spread) {
    this.spread = spread;
    this.redraw();
  }

  setTransmitter(place) {
    this.transmitter = place;
    this.markLayer("transmitter", place, 17, "dot", this.extrapolates ? 90 : 255);
    const down = this.bounds ? [place[0], place[1], Math.min(this.bounds[0][2], place[2])] : place;
    this.setLines("stem", { positions: new Float32Array([...place, ...down]), colours: new Uint8Array([...ROOM_TRANSMITTER, 255]), onTop: true });
  }

  /** Draws the transmitter faintly if its prediction is an extrapolation. */
  setExtrapolation(extrapolates) {
    if (extrapolates === Boolean(this.extrapolates)) return;
    this.extrapolates = extrapolates;
    if (this.transmitter) this.setTransmitter(this.transmitter);
  }

  /** Sets the ring around a measured sample, or removes it. */
  setSelected(place) {
    this.markLayer("selected", place, 20, "ring");
  }

  markLayer(name, place, size, shape, alpha = 255) {
    const colours = new Uint8Array([...ROOM_TRANSMITTER, alpha]);
    this.setPoints(name, place && { positions: new Float32Array(place), colours, size, shape, pickable: false, onTop: true });
  }

  get view() {
    return { ...this.looking, target: [...this.looking.target] };
  }

  set view(looking) {
    this.looking = { ...looking, target: [...looking.target] };
    this.redraw();
  }

  turn(yaw, pitch) {
    const to = Math.min(1.55, Math.max(-1.55, this.looking.pitch + pitch));
    this.look({ yaw: this.looking.yaw + yaw, pitch: to });
  }

  zoom(factor) {
    this.look({ distance: Math.min(1e6, Math.max(0.05, this.looking.distance * factor)) });
  }

  look(change) {
    this.view = { ...this.looking, ...change };
    this.onView();
  }

  /** Requests a frame. A moving view is drawn with fewer Gaussians if needed, a view at rest with all. */
  redraw() {
    this.asked ??= requestAnimationFrame((now) => {
      this.asked = null;
      this.pace(now - (this.lastFrame ?? -Infinity));
      this.lastFrame = now;
      this.draw();
    });
  }

  /** Adapts the number of Gaussians of a moving view to the frame time. */
  pace(since) {
    clearTimeout(this.resting);
    if (!this.gaussians) return;
    const drawn = Math.min(this.most, this.gaussians.means.length / 3);
    const moving = since < ROOM_REST;
    if (!moving) this.steady = 0;
    else if (++this.steady > 2 && since > 80) this.most = Math.max(ROOM_LEAST, Math.round((drawn * 50) / since));
    this.whole = !moving || since > ROOM_REST;
    if (drawn < this.gaussians.means.length / 3 && !this.whole) {
      this.resting = setTimeout(() => {
        this.lastFrame = undefined;
        this.redraw();
      }, ROOM_REST);
    }
  }

  aspect() {
    return this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
  }

  /** Tangent of half the vertical angle of view; constant for the shorter side of the canvas. */
  half() {
    return Math.tan(ROOM_FOV / 2) / Math.min(1, this.aspect());
  }

  /** Camera position, its axes (right, up, back) and the matrix from room to screen. */
  camera() {
    const { yaw, pitch, distance, target } = this.looking;
    const back = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
    const eye = vec3Add(target, back, distance);
    const right = [-Math.sin(yaw), Math.cos(yaw), 0];
    const axes = [right, vec3Cross(back, right), back];
    const lens = mat4Perspective(this.half(), this.aspect(), distance / 50, distance * 20);
    return { eye, axes, matrix: mat4Multiply(lens, mat4View(eye, axes)) };
  }

  draw() {
    const begun = performance.now();
    const { gl, canvas } = this;
    if (gl.isContextLost() || !canvas.clientWidth) return;
    const ratio = Math.min(2, devicePixelRatio || 1);
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    gl.clearColor(...this.ground.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const camera = this.camera();
    this.drawEllipsoids(camera, h);
    const lines = [...this.lines.values()].map((layer) => [layer, gl.LINES, 2, camera, 1]);
    const points = [...this.layers.values()].map((layer) => [layer, gl.POINTS, 1, camera, ratio]);
    const opaque = [...lines, ...points];
    opaque.filter(([layer]) => !layer.onTop).forEach((drawn) => this.drawLayer(...drawn));
    gl.depthMask(false);
    this.meshes.forEach((layer) => this.drawLayer(layer, gl.TRIANGLES, 3, camera, 1));
    gl.depthMask(true);
    opaque.filter(([layer]) => layer.onTop).forEach((drawn) => this.drawLayer(...drawn));
    this.frames += 1;
    this.lastFrameMs = performance.now() - begun;
  }

  /** Draws points, lines or triangles, with one colour per `corners` vertices. */
  drawLayer(layer, mode, corners, camera, ratio) {
    const { gl } = this;
    const program = this.pointProgram;
    const count = layer.positions.length / 3;
    layer.buffers ??= [roomBuffer(gl, layer.positions), roomBuffer(gl, roomColours(layer, count, corners))];
    gl.useProgram(program);
    if (layer.onTop) gl.disable(gl.DEPTH_TEST);
    else gl.enable(gl.DEPTH_TEST);
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "camera"), false, camera.matrix);
    gl.uniform1f(gl.getUniformLocation(program, "size"), (layer.size ?? 1) * ratio);
    const shape = mode === gl.POINTS ? ["dot", "square", "ring", "diamond"].indexOf(layer.shape ?? "dot") : -1;
    gl.uniform1i(gl.getUniformLocation(program, "shape"), shape);
    roomAttribute(gl, 0, layer.buffers[0], 3, gl.FLOAT, 0);
    roomAttribute(gl, 1, layer.buffers[1], 4, gl.UNSIGNED_BYTE, 0);
    gl.drawArrays(mode, 0, count);
    [0, 1].forEach((place) => gl.disableVertexAttribArray(place));
  }

  /** Distance of the room ahead of the camera: nearer Gaussians are not drawn, because they would hide the room. */
  front(eye, back) {
    if (!this.bounds) return 0;
    const far = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) => {
      const corner = [0, 1, 2].map((k) => this.bounds[(bits >> k) & 1][k]);
      return vec3Dot(vec3Sub(eye, corner), back);
    });
    return Math.max(0, Math.min(...far));
  }

  drawEllipsoids({ eye, axes, matrix }, height) {
    const { gl, gaussians } = this;
    if (!gaussians || !gaussians.means.length) return;
    const program = this.ellipsoidProgram;
    const { means, scales, quats, colours } = gaussians;
    gaussians.buffers ??= [means, scales, quats, colours].map((values) => roomBuffer(gl, values));
    gl.useProgram(program);
    const at = (name) => gl.getUniformLocation(program, name);
    gl.uniformMatrix4fv(at("camera"), false, matrix);
    gl.uniform3fv(at("eye"), eye);
    gl.uniform3fv(at("right"), axes[0]);
    gl.uniform3fv(at("light"), vec3Unit(vec3Add(vec3Add(axes[2], axes[1], 0.6), axes[0], 0.3)));
    gl.uniform3fv(at("ahead"), axes[2].map((v) => -v));
    gl.uniform1f(at("front"), this.front(eye, axes[2]));
    gl.uniform1f(at("spread"), this.spread);
    gl.uniform1f(at("pixelSize"), (2 * this.half()) / height);
    roomAttribute(gl, 0, this.corners, 2, gl.FLOAT, 0);
    [3, 3, 4].forEach((size, k) => roomAttribute(gl, k + 1, gaussians.buffers[k], size, gl.FLOAT, 1));
    roomAttribute(gl, 4, gaussians.buffers[3], 4, gl.UNSIGNED_BYTE, 1);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, Math.min(this.whole ? Infinity : this.most, means.length / 3));
    for (let place = 0; place < 5; place++) {
      gl.vertexAttribDivisor(place, 0);
      gl.disableVertexAttribArray(place);
    }
  }

  /** Position on the canvas, CSS pixels from its corner; null behind the camera. */
  project(place, m = this.camera().matrix) {
    const [x, y, w] = [0, 1, 3].map((r) => m[r] * place[0] + m[4 + r] * place[1] + m[8 + r] * place[2] + m[12 + r]);
    if (w <= 0) return null;
    return [((x / w + 1) / 2) * this.canvas.clientWidth, ((1 - y / w) / 2) * this.canvas.clientHeight];
  }

  /** Ray through a position on the canvas. */
  ray([x, y]) {
    const { eye, axes } = this.camera();
    const half = this.half();
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const [u, v] = [((2 * x) / w - 1) * half * (w / h), (1 - (2 * y) / h) * half];
    return [eye, vec3Unit(vec3Add(vec3Add(vec3Add([0, 0, 0], axes[0], u), axes[1], v), axes[2], -1))];
  }

  /** Handles mouse, pen and touch. */
  listen() {
    const { canvas } = this;
    this.fingers = new Map();
    const on = (name, act, options) => canvas.addEventListener(name, act, options);
    on("pointerdown", (event) => this.press(event));
    on("pointermove", (event) => this.drag(event));
    on("pointerup", (event) => this.release(event));
    on("pointercancel", (event) => this.fingers.delete(event.pointerId));
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(0.0012 * Math.max(-300, Math.min(300, event.deltaY))));
    }, { passive: false });
    on("webglcontextlost", (event) => event.preventDefault());
    on("webglcontextrestored", () => {
      this.prepare();
      this.redraw();
    });
  }

  press(event) {
    const at = this.at(event);
    this.fingers.set(event.pointerId, at);
    this.canvas.setPointerCapture?.(event.pointerId);
    const tx = this.transmitter && this.project(this.transmitter);
    const grasped = tx && Math.hypot(at[0] - tx[0], at[1] - tx[1]) < ROOM_GRASP && event.button === 0;
    this.dragging = this.fingers.size > 1 || event.button === 2 ? "pan" : grasped ? "transmitter" : "orbit";
    if (grasped) this.grip = [at[0] - tx[0], at[1] - tx[1]];
    this.travelled = 0;
    this.canvas.style.cursor = grasped ? "move" : "grabbing";
  }

  drag(event) {
    const before = this.fingers.get(event.pointerId);
    const at = this.at(event);
    if (!before) {
      const tx = this.transmitter && this.project(this.transmitter);
      this.canvas.style.cursor = tx && Math.hypot(at[0] - tx[0], at[1] - tx[1]) < ROOM_GRASP ? "move" : "grab";
      return;
    }
    const [dx, dy] = [at[0] - before[0], at[1] - before[1]];
    this.travelled += Math.hypot(dx, dy);
    const others = [...this.fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    this.fingers.set(event.pointerId, at);
    if (this.dragging === "transmitter") this.dragTransmitter(at, dy, event.shiftKey || this.dragsHeight);
    else if (this.dragging === "orbit") this.turn(-0.008 * dx, 0.008 * dy);
    else this.pan(dx / Math.max(1, this.fingers.size), dy / Math.max(1, this.fingers.size));
    if (others.length) {
      const far = (a) => Math.hypot(a[0] - others[0][0], a[1] - others[0][1]) || 1;
      this.zoom(far(before) / far(at));
    }
  }

  release(event) {
    const at = this.at(event);
    const clicked = this.dragging === "orbit" && this.travelled < 4 && this.fingers.size === 1;
    this.fingers.delete(event.pointerId);
    this.canvas.style.cursor = "grab";
    if (clicked) this.pick(at);
    this.dragging = null;
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** Metres per pixel at the target. */
  metresAPixel(distance = this.looking.distance) {
    return (2 * this.half() * distance) / Math.max(1, this.canvas.clientHeight);
  }

  pan(dx, dy) {
    const [right, up] = this.camera().axes;
    const metres = this.metresAPixel();
    this.look({ target: vec3Add(vec3Add(this.looking.target, right, -dx * metres), up, dy * metres) });
  }

  /** Moves the transmitter in its horizontal plane, or changes its height. */
  dragTransmitter(at, dy, vertical) {
    const { eye } = this.camera();
    const place = [...this.transmitter];
    const far = Math.hypot(...vec3Sub(place, eye));
    if (vertical) {
      place[2] -= dy * this.metresAPixel(far);
    } else {
      const [from, along] = this.ray([at[0] - this.grip[0], at[1] - this.grip[1]]);
      const t = (place[2] - from[2]) / along[2];
      const hit = vec3Add(from, along, t);
      if (Math.abs(along[2]) > 0.03 && t > 0) [place[0], place[1]] = hit;
      else return; // the plane is edge-on
    }
    this.transmitter = this.within(place);
    this.onTransmitter(this.transmitter);
  }

  /** Limits a position to half a room outside the room. */
  within(place) {
    if (!this.bounds) return place;
    const [low, high] = this.bounds;
    return place.map((v, k) => {
      const air = 0.5 * (high[k] - low[k]) + 0.5;
      return Math.min(high[k] + air, Math.max(low[k] - air, v));
    });
  }

  /** Reports the nearest pickable point within 9 pixels. */
  pick(at) {
    let best = { far: 9 };
    const { matrix } = this.camera();
    for (const [name, layer] of this.layers) {
      if (!layer.pickable) continue;
      for (let i = 0; i < layer.positions.length / 3; i++) {
        const place = this.project(layer.positions.subarray(3 * i, 3 * i + 3), matrix);
        const far = place ? Math.hypot(place[0] - at[0], place[1] - at[1]) : Infinity;
        if (far < best.far) best = { far, name, index: i };
      }
    }
    if (best.name) this.onPick(best.name, best.index);
  }

  dispose() {
    this.sizes.disconnect();
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** Gaussians sorted by size: the smallest are omitted first to save time. */
function roomLargestFirst({ means, scales, quats, colours }) {
  const n = means.length / 3;
  const size = Float32Array.from({ length: n }, (_, i) => Math.max(scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]));
  const order = Uint32Array.from({ length: n }, (_, i) => i).sort((a, b) => size[b] - size[a]);
  const sorted = (values, width) => {
    const out = new values.constructor(values.length);
    order.forEach((i, k) => out.set(values.subarray(width * i, width * i + width), width * k));
    return out;
  };
  return { means: sorted(means, 3), scales: sorted(scales, 3), quats: sorted(quats, 4), colours: sorted(colours, 4) };
}

function roomBuffer(gl, values) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  return buffer;
}

function roomAttribute(gl, place, buffer, size, type, divisor) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
  gl.vertexAttribDivisor(place, divisor);
}

/** Colours, one per vertex. */
function roomColours({ colours, colour }, count, corners) {
  const all = new Uint8Array(4 * count);
  for (let i = 0; i < count; i++) {
    const k = Math.floor(i / corners);
    all.set(colour ? colour.map((v) => Math.round(255 * v)) : colours.subarray(4 * k, 4 * k + 4), 4 * i);
  }
  return all;
}

function roomProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader)).join(" ");
    throw new Error(`cannot compile a shader of the 3D view: ${gl.getProgramInfoLog(program)} ${logs}`);
  }
  return program;
}
