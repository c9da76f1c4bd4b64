/*
 * Predicts from a model file in the page, step by step as in crates/cli/tests/model_format.py, in double precision.
 * Arrays are flat, row by row; N Gaussians, W columns, H rows.
 */

/** Parses `Name(field: 1, other: Waves(count: 2), third: None)` to an object; the key "" holds the name. */
function parseRon(text) {
  const tokens = text.match(/[A-Za-z_]\w*|[-+]?[\d.]+(?:[eE][-+]?\d+)?|[():,[\]]/g);
  const value = () => {
    const token = tokens.shift();
    if (token === "(" || token === "[") {
      const items = [];
      while (tokens[0] !== ")" && tokens[0] !== "]") {
        items.push(value());
        if (tokens[0] === ",") tokens.shift();
      }
      tokens.shift();
      return items;
    }
    if (!/^[A-Za-z_]/.test(token)) return Number(token);
    if (["None", "true", "false"].includes(token)) return { None: null, true: true, false: false }[token];
    const fields = { "": token };
    if (tokens[0] === "(") {
      tokens.shift();
      while (tokens[0] !== ")") {
        const named = tokens[1] === ":"; // the single value of `Octaves(5)` has no name and gets the key 0
        const key = named ? tokens[0] : 0;
        tokens.splice(0, named ? 2 : 0);
        fields[key] = value();
        if (tokens[0] === ",") tokens.shift();
      }
      tokens.shift();
    }
    return token === "Some" ? fields[0] : fields;
  };
  return value();
}

/** Encoding x, sin x, cos x, sin 2x, cos 2x, sin 4x, ..: blocks of three numbers. */
function octavesOf(x, frequencies) {
  const all = [...x];
  for (let f = 0; f < frequencies; f++) {
    all.push(...x.map((v) => Math.sin(2 ** f * v)), ...x.map((v) => Math.cos(2 ** f * v)));
  }
  return all;
}

/** Encoding: x times `scale`, then sine and cosine of the product of x with each wave vector [count, 3]. */
function wavesOf(x, vectors, scale) {
  const all = x.map((v) => v * scale);
  for (let i = 0; i < vectors.length; i += 3) {
    const phase = x[0] * vectors[i] + x[1] * vectors[i + 1] + x[2] * vectors[i + 2];
    all.push(Math.sin(phase), Math.cos(phase));
  }
  return all;
}

/** Network layer: weight [out, in] times x plus bias, optionally with ReLU. */
class NetworkLayer {
  constructor(file, name) {
    this.weight = file.get(`network.${name}.weight`);
    this.bias = file.get(`network.${name}.bias`);
    [this.outputs, this.inputs] = file.shape(`network.${name}.weight`);
  }

  /** Reads `inputs` numbers from x at `from`, writes `outputs` to `out` at `to`. */
  apply(x, relu, out = new Float64Array(this.outputs), from = 0, to = 0) {
    const { weight, bias, inputs, outputs } = this;
    for (let o = 0; o < outputs; o++) {
      const row = o * inputs;
      let [a, b] = [bias[o], 0];
      let i = 0;
      for (; i + 1 < inputs; i += 2) {
        a += weight[row + i] * x[from + i];
        b += weight[row + i + 1] * x[from + i + 1];
      }
      if (i < inputs) a += weight[row + i] * x[from + i];
      const sum = a + b;
      out[to + o] = relu && sum < 0 ? 0 : sum;
    }
    return out;
  }
}

/** Deformation without changes. */
class FixedDeformation {
  constructor() {
    this.keepsGeometry = true;
  }

  add() {
    return {};
  }
}

class MlpDeformation {
  constructor(file, settings, means) {
    const layer = (name) => new NetworkLayer(file, name);
    Object.assign(this, settings, { n: means.length / 3 });
    this.first = [layer("tx.0"), layer("tx.1")];
    this.trunk = Array.from({ length: this.depth }, (_, k) => layer(`trunk.${k}`));
    this.heads = (this.outputs[""] === "All" ? ["rotation", "scaling", "signal"] : ["signal"]).map((name) => [name, layer(name)]);
    this.keepsGeometry = this.outputs[""] !== "All";
    this.places = Array.from({ length: this.n }, (_, i) => octavesOf(Array.from(means.subarray(3 * i, 3 * i + 3)), this.position_frequencies));
  }

  add(tx) {
    const gamma = octavesOf(tx, this.tx_frequencies);
    const e = this.first[1].apply(this.first[0].apply(gamma, true), false);
    const added = Object.fromEntries(this.heads.map(([name, head]) => [name, new Float64Array(this.n * head.outputs)]));
    for (let i = 0; i < this.n; i++) {
      const inputs = Float64Array.from([...this.places[i], ...e]);
      let h = inputs;
      this.trunk.forEach((own, k) => {
        const again = this.skip !== null && k === this.skip + 1;
        h = own.apply(again ? Float64Array.from([...inputs, ...h]) : h, true);
      });
      for (const [name, head] of this.heads) head.apply(h, false, added[name], 0, i * head.outputs);
    }
    return added;
  }
}

class FactoredDeformation {
  constructor(file, settings, means) {
    Object.assign(this, settings, { n: means.length / 3, keepsGeometry: true });
    const vectors = (name) => (file.has(`constants.${name}`) ? file.get(`constants.${name}`) : null);
    const scaleOf = (own) => (own[""] === "Wavelengths" ? (2 * Math.PI) / own.longest_m : 1);
    const encoder = (own, table) => (own[""] === "Octaves" ? (x) => octavesOf(x, own[0]) : (x) => wavesOf(x, table, scaleOf(own)));
    this.encode = encoder(this.tx_encoding, vectors("tx_encoding"));
    const waves = encoder(this.position_encoding, vectors("position_encoding"));
    this.layers = Array.from({ length: this.depth }, (_, k) => new NetworkLayer(file, `tx.${k}`));
    const branch = new NetworkLayer(file, "branch");
    this.row = branch.outputs;
    this.rows = new Float64Array(this.n * this.row);
    this.waves = [];
    if (this.near) this.near = { ...this.near, positions: file.get("network.near.positions"), weight: file.get("network.near.weight") };
    for (let i = 0; i < this.n; i++) {
      const own = waves(Array.from(means.subarray(3 * i, 3 * i + 3))).slice(3);
      const scaled = Float64Array.from(own, (v) => (v * Math.PI) / (2 * own.length));
      branch.apply(scaled, false, this.rows, 0, i * this.row);
      this.waves.push(scaled);
    }
  }

  /** Adds to the signals what follows from correlations with training positions. */
  addNear(tx, signal) {
    const { positions, weight, length_m, count } = this.near;
    const waves = this.waves.length ? this.waves[0].length : 0;
    const sums = [new Float64Array(waves), new Float64Array(waves)];
    for (let m = 0; m < count; m++) {
      const distance = Math.hypot(...tx.map((x, k) => x - positions[3 * m + k]));
      if (distance >= 16 * length_m) continue;
      const correlation = 6 * Math.exp(-distance / length_m);
      sums.forEach((sum, c) => sum.forEach((_, b) => (sum[b] += correlation * weight[(c * count + m) * waves + b])));
    }
    this.waves.forEach((own, i) => sums.forEach((sum, c) => own.forEach((w, b) => (signal[2 * i + c] += w * sum[b]))));
  }

  add(tx) {
    let t = this.encode(tx);
    for (const layer of this.layers) t = layer.apply(t, true);
    const signal = new Float64Array(2 * this.n);
    const width = this.row / 2;
    for (let k = 0; k < 2 * this.n; k++) {
      const from = k * width;
      let sum = this.rows[from + width - 1];
      for (let j = 0; j < width - 1; j++) sum += this.rows[from + j] * t[j];
      signal[k] = sum;
    }
    if (this.near) this.addNear(tx, signal);
    return { signal };
  }
}

const DEFORMATIONS = { Fixed: FixedDeformation, Mlp: MlpDeformation, Factored: FactoredDeformation };

/** Rotation matrix, row by row, of a quaternion, by the formula for unit quaternions. */
function rotationOf(w, x, y, z) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

/** First tile, and the one after the last, that overlap a square of this radius along one axis of `count` pixels. */
function tilesOf(centre, radius, count) {
  const most = Math.ceil(count / 16);
  const bounded = (v) => Math.min(most, Math.max(0, Math.trunc(v)));
  return [bounded((centre - radius) / 16), bounded((centre + radius + 15) / 16)];
}

/** Projects a position in the receiver frame: pixel, two rows of the Jacobian, and whether it is visible. */
function mercatorPoint(settings, [x, y, z], { width, height, angles }) {
  const elevation = angles[1];
  const r = Math.hypot(x, y, z);
  if (Math.hypot(x, y) <= 1e-6 * r) [x, y] = [1e-9 * r, 0];
  const rho = Math.hypot(x, y);
  const [perColumn, perRow] = [width / (2 * Math.PI), 180 / Math.PI / elevation.step];
  const [first, end] = [elevation.first, elevation.first + height * elevation.step];
  const turn = (Math.atan2(y, x) + 2 * Math.PI) % (2 * Math.PI);
  const floored = rho * Math.max(rho, Math.cos((89.5 * Math.PI) / 180) * r);
  const lowest = Math.min(first, end) - settings.margin_deg;
  const [around, up] = [perColumn / floored, perRow / (r * r)];
  return {
    pixel: [turn * perColumn, (Math.atan2(z, rho) - (first * Math.PI) / 180) * perRow],
    jacobian: [-y * around, x * around, 0, ((-z * x) / rho) * up, ((-z * y) / rho) * up, rho * up],
    seen: r > settings.near_m && (lowest <= -90 || z >= Math.sin((lowest * Math.PI) / 180) * r),
  };
}

/** Projection of the released WRF-GS. */
function releasedPoint(settings, [x, y, z], { width, height }) {
  const [r, rho] = [Math.hypot(x, y, z), Math.hypot(x, z)];
  const [longitude, latitude] = [Math.atan2(x, z), Math.asin(Math.min(1, Math.max(-1, y / (r + 1e-7))))];
  const [a, p, q] = [1 / (rho * rho + 1e-7), 1 / (rho + 1e-7), 1 / (r * r + 1e-7)];
  const [u, v] = [width / (2 * Math.PI), height / Math.PI];
  return {
    pixel: [((longitude / Math.PI + 1) * width - 1) / 2, (((2 * latitude) / Math.PI + 1) * height - 1) / 2],
    jacobian: [z * a * u, 0, -x * a * u, -x * y * p * q * v, rho * q * v, -z * y * p * q * v],
    seen: r * r > 0.04,
  };
}

/** Projected visible Gaussians with pixel, covariance, distance, radius and direction. */
function projectGaussians(model, scales, quats) {
  const { pose, means, n, plane, projector } = model;
  const [x, y, z, w] = pose.orientation.map((v) => v / Math.hypot(...pose.orientation));
  const frame = rotationOf(w, x, y, z); // columns are the receiver axes
  const place = pose.position.map((v, k) => v - model.origin[k]);
  const mercator = projector[""] === "Mercator";
  const splats = [];
  for (let i = 0; i < n; i++) {
    const from = [0, 1, 2].map((k) => means[3 * i + k] - (mercator ? place[k] : 0));
    const turned = [0, 1, 2].map((c) => frame[c] * from[0] + frame[3 + c] * from[1] + frame[6 + c] * from[2]);
    const v = mercator ? turned : turned.map((own, k) => own + place[k]);
    const { pixel, jacobian, seen } = (mercator ? mercatorPoint : releasedPoint)(projector, v, plane);
    const [a, b, c] = covarianceOf(jacobian, frame, rotationOf(...quats.subarray(4 * i, 4 * i + 4)), scales.subarray(3 * i, 3 * i + 3));
    const blur = mercator ? projector.blur : 0.3;
    const distance = Math.hypot(...v);
    const splat = { i, pixel, cov: [a + blur, b, c + blur], distance, depth: Math.fround(distance), v };
    if (seen && splatReaches(splat, plane, mercator)) splats.push(splat);
  }
  return splats.sort((a, b) => a.depth - b.depth || a.i - b.i);
}

/** Upper triangle of J Rᵀ M (J Rᵀ M)ᵀ. */
function covarianceOf(jacobian, frame, turn, scales) {
  const rows = [0, 3].map((from) => {
    const [p, q, s] = [0, 1, 2].map((k) => jacobian[from + k]);
    const world = [0, 1, 2].map((k) => p * frame[3 * k] + q * frame[3 * k + 1] + s * frame[3 * k + 2]);
    return [0, 1, 2].map((k) => (world[0] * turn[k] + world[1] * turn[3 + k] + world[2] * turn[6 + k]) * scales[k]);
  });
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  return [dot(rows[0], rows[0]), dot(rows[0], rows[1]), dot(rows[1], rows[1])];
}

/** Sets the radius; returns whether the Gaussian overlaps the image. */
function splatReaches(splat, { width, height }, mercator) {
  const [a, b, c] = splat.cov;
  const [middle, det] = [(a + c) / 2, a * c - b * b];
  splat.radius = Math.ceil(3 * Math.sqrt(middle + Math.sqrt(Math.max(0.1, middle * middle - det))));
  const [column, row] = splat.pixel;
  if (mercator) {
    const half = Math.sqrt(2 * Math.log(255) * c);
    return row + half >= 0 && row - half <= height - 1;
  }
  const [across, up] = [tilesOf(column, splat.radius, width), tilesOf(row, splat.radius, height)];
  return across[0] < across[1] && up[0] < up[1];
}

/** Alpha blending: lists of pixels and weights γ·T per Gaussian, front to back. */
function blendingWeights(model, splats, opacities) {
  const { width, height } = model.plane;
  const light = new Float64Array(width * height).fill(1);
  const full = new Uint8Array(width * height);
  const tiled = model.rasterizer.support?.[""] === "TileSquares";
  return splats.map((splat) => {
    const [pixels, weights] = [[], []];
    eachPixel(splat, opacities[splat.i], model.plane, tiled, (at, gamma) => {
      if (full[at]) return;
      const left = light[at] * (1 - gamma);
      if (left < 1e-4) {
        full[at] = 1;
        return;
      }
      pixels.push(at);
      weights.push(gamma * light[at]);
      light[at] = left;
    });
    return { i: splat.i, pixels: Int32Array.from(pixels), weights: Float64Array.from(weights) };
  });
}

/** Calls `act` for every pixel with γ of at least 1/255. */
function eachPixel({ pixel, cov, radius }, opacity, { width, height, wraps }, tiled, act) {
  const [a, b, c] = cov;
  const det = a * c - b * b;
  const [A, B, C] = [c / det, -b / det, a / det];
  const reach = 2 * Math.log(255 * opacity);
  if (!(reach >= 0)) return;
  const [right, up] = [Math.sqrt(reach * a) + 1, Math.sqrt(reach * c) + 1];
  const [across, along] = [tilesOf(pixel[0], radius, width), tilesOf(pixel[1], radius, height)];
  const whole = wraps && 2 * right >= width;
  const [from, to] = whole ? [0, width - 1] : [Math.ceil(pixel[0] - right), Math.floor(pixel[0] + right)];
  for (let y = Math.max(0, Math.ceil(pixel[1] - up)); y <= Math.min(height - 1, pixel[1] + up); y++) {
    if (tiled && (y < 16 * along[0] || y >= 16 * along[1])) continue;
    const dy = pixel[1] - y;
    for (let x = from; x <= to; x++) {
      const column = wraps ? ((x % width) + width) % width : x;
      if (column < 0 || column >= width || (tiled && (column < 16 * across[0] || column >= 16 * across[1]))) continue;
      let dx = pixel[0] - column;
      if (wraps) dx -= width * Math.floor(dx / width + 0.5);
      const gamma = Math.min(0.99, opacity * Math.exp(-(A * dx * dx + C * dy * dy) / 2 - B * dx * dy));
      if (gamma >= 1 / 255) act(y * width + column, gamma);
    }
  }
}

/** Antenna positions of an array, wavelengths, [K, 3]. */
function antennasOf({ rows, columns, spacing_wavelengths: spacing, positions_wavelengths: given }) {
  if (given) return given;
  const all = [];
  for (let i = 0; i < rows; i++) {
    for (let j = 0; j < columns; j++) all.push([spacing * (j - (columns - 1) / 2), spacing * (i - (rows - 1) / 2), 0]);
  }
  return all;
}

/** Field of a Gaussian on each antenna: real and imaginary parts, [2, K]. */
function waveOf(splat, antennas, rasterizer, { angles }) {
  const radians = Math.PI / 180;
  const u = splat.v.map((v) => v / splat.distance);
  const spherical = rasterizer.wavefront?.[""] === "Spherical";
  const r = spherical ? splat.distance / rasterizer.wavefront.wavelength_m : 0;
  const az = (angles[0].first + angles[0].step * splat.pixel[0]) * radians;
  const el = (angles[1].first + angles[1].step * splat.pixel[1]) * radians;
  const [da, de] = [angles[0].step * radians, angles[1].step * radians];
  const [a, b, c] = splat.cov;
  const wave = new Float64Array(2 * antennas.length);
  antennas.forEach(([px, py, pz], k) => {
    const along = px * u[0] + py * u[1] + pz * u[2];
    const way = Math.sqrt(Math.max(1e-6, r * r - 2 * r * along + px * px + py * py + pz * pz));
    const phase = spherical ? -2 * Math.PI * (way - r) : 2 * Math.PI * along;
    const w = Math.cos(el) * da * (-Math.sin(az) * px + Math.cos(az) * py);
    const q = de * (Math.cos(el) * pz - Math.sin(el) * (Math.cos(az) * px + Math.sin(az) * py));
    const size = rasterizer.widened ? Math.exp(-2 * Math.PI ** 2 * (a * w * w + 2 * b * w * q + c * q * q)) : 1;
    wave[k] = size * Math.cos(phase);
    wave[antennas.length + k] = size * Math.sin(phase);
  });
  return wave;
}

/** Steering vectors exp(-j 2π p·u) / K per pixel and antenna, [2, H W, K]. */
function steeringOf(antennas, { width, height, angles }) {
  const count = antennas.length;
  const table = [new Float64Array(width * height * count), new Float64Array(width * height * count)];
  for (let at = 0; at < width * height; at++) {
    const az = ((angles[0].first + angles[0].step * (at % width)) * Math.PI) / 180;
    const el = ((angles[1].first + angles[1].step * Math.floor(at / width)) * Math.PI) / 180;
    const [ux, uy, uz] = [Math.cos(el) * Math.cos(az), Math.cos(el) * Math.sin(az), Math.sin(el)];
    antennas.forEach(([px, py, pz], k) => {
      const phase = -2 * Math.PI * (px * ux + py * uy + pz * uz);
      table[0][at * count + k] = Math.cos(phase) / count;
      table[1][at * count + k] = Math.sin(phase) / count;
    });
  }
  return table;
}

/** Model that predicts spectra. */
export class Predictor {
  /** Reason why the page cannot predict with a file, or null. */
  static refuses({ note }) {
    const { kind, receivers } = note?.links ?? {};
    const plain = note?.format === "pwrfgs-model" && kind === "Spectrum" && receivers.length === 1;
    if (!plain || !note.method.startsWith("Splatting(")) return "not a single model of splatted spectra";
    const { deformation, projector, rasterizer } = parseRon(note.method);
    if (!DEFORMATIONS[deformation[""]]) return `unsupported deformation ${deformation[""]}`;
    if (!["Mercator", "WrfgsCompat"].includes(projector[""])) return `unsupported projector ${projector[""]}`;
    if (!["AlphaBlending", "ArrayResponse"].includes(rasterizer[""])) return `unsupported rasterizer ${rasterizer[""]}`;
    return null;
  }

  /** Computes values that do not depend on the transmitter. */
  constructor(file) {
    const why = Predictor.refuses(file);
    if (why) throw new Error(`the page cannot predict with this model: ${why}`);
    const { note } = file;
    const column = (name) => file.get(`gaussians.${name}`);
    const { deformation: settings, projector, rasterizer, calibration, readout } = parseRon(note.method);
    Object.assign(this, { projector, rasterizer, physical: calibration[""] === "Physical", readout: readout[""] });
    Object.assign(this, { pose: note.links.receivers[0].pose, plane: note.plane, means: column("means"), origin: note.origin ?? [0, 0, 0] });
    this.n = this.means.length / 3;
    this.trainingPositions = file.has("training_positions") ? file.get("training_positions") : null;
    const scales = Float64Array.from(column("log_scales"), Math.exp);
    this.base = { scales, quats: column("quats"), signals: column("signals") };
    this.opacities = Float64Array.from(column("opacity_logits"), (logit) => 1 / (1 + Math.exp(-logit)));
    this.deformation = new DEFORMATIONS[settings[""]](file, settings, this.means);
    this.blends = this.rasterizer[""] === "AlphaBlending";
    if (!this.blends) {
      this.antennas = antennasOf(this.rasterizer);
      this.steering = steeringOf(this.antennas, this.plane);
    }
    const size = this.plane.width * this.plane.height;
    this.channels = [new Float64Array(size), new Float64Array(size)];
    this.picture = new Float32Array(size);
    this.strengths = new Float32Array(this.n);
  }

  /** Distance from `tx`, metres in the world frame, to the nearest training position; null if unknown. */
  trainingDistance(tx) {
    const all = this.trainingPositions;
    if (!all) return null;
    const [x, y, z] = tx.map((v, k) => v - this.origin[k]);
    let squared = Infinity;
    for (let i = 0; i < all.length; i += 3) squared = Math.min(squared, (x - all[i]) ** 2 + (y - all[i + 1]) ** 2 + (z - all[i + 2]) ** 2);
    return Math.sqrt(squared);
  }

  /**
   * Predicts the spectrum of a transmitter at `tx`, metres in the world frame: `picture` [H, W], not clamped; per Gaussian
   * `strengths` [N] (its grey value alone), `scales`, `quats` and `opacities`. The next call overwrites these arrays.
   */
  predict(tx) {
    const local = tx.map((v, k) => Math.fround(v - this.origin[k]));
    const added = this.deformation.add(local);
    const geometry = this.geometry(added);
    const signals = this.signals(added);
    const drawn = (this.kept ??= this.deformation.keepsGeometry ? this.prepare(geometry) : null) ?? this.prepare(geometry);
    if (this.blends) this.blend(drawn, signals);
    else this.hear(drawn, signals);
    this.readOut(this.channels, this.picture);
    this.weigh(signals);
    const [scales, quats] = [Float32Array.from(geometry.scales), Float32Array.from(geometry.quats)];
    return { picture: this.picture, strengths: this.strengths, scales, quats, opacities: Float32Array.from(this.opacities) };
  }

  /** Scales and rotations with the changes for the transmitter. */
  geometry({ scaling, rotation }) {
    const { physical } = this;
    const scales = this.base.scales.map((v, k) => v + (scaling ? scaling[k] : 0));
    const quats = new Float64Array(4 * this.n);
    for (let i = 0; i < this.n; i++) {
      const unit = (q) => {
        const length = Math.hypot(...q);
        return length < 1e-12 ? [1, 0, 0, 0] : q.map((v) => v / length);
      };
      const q = unit(Array.from(this.base.quats.subarray(4 * i, 4 * i + 4))).map((v, k) => v + (rotation ? rotation[4 * i + k] : 0));
      quats.set(physical ? unit(q) : q, 4 * i);
    }
    return { scales: physical ? scales.map((v) => Math.max(1e-4, v)) : scales, quats };
  }

  /** Signals, [N, 2]. */
  signals({ signal }) {
    const { physical } = this;
    return Float64Array.from(this.base.signals, (v, k) => {
      const delta = signal ? signal[k] : 0;
      return physical ? v + delta : Math.max(0, 0.28209479177387814 * (v + Math.abs(delta)) + 0.5);
    });
  }

  /** Values that depend only on the geometry. */
  prepare({ scales, quats }) {
    const splats = projectGaussians(this, scales, quats);
    if (this.blends) return blendingWeights(this, splats, this.opacities);
    return splats.map((splat) => ({ i: splat.i, wave: waveOf(splat, this.antennas, this.rasterizer, this.plane) }));
  }

  blend(drawn, signals) {
    const [re, im] = this.channels;
    re.fill(0);
    im.fill(0);
    for (const { i, pixels, weights } of drawn) {
      const [a, b] = [signals[2 * i], signals[2 * i + 1]];
      for (let k = 0; k < pixels.length; k++) {
        re[pixels[k]] += weights[k] * a;
        im[pixels[k]] += weights[k] * b;
      }
    }
  }

  /** Adds the waves on the antennas and steers the array to every pixel. */
  hear(drawn, signals) {
    const count = this.antennas.length;
    const [x, y] = [new Float64Array(count), new Float64Array(count)];
    for (const { i, wave } of drawn) {
      const [a, b] = [this.opacities[i] * signals[2 * i], this.opacities[i] * signals[2 * i + 1]];
      for (let k = 0; k < count; k++) {
        x[k] += a * wave[k] - b * wave[count + k];
        y[k] += a * wave[count + k] + b * wave[k];
      }
    }
    const [[re, im], [c, s]] = [this.channels, this.steering];
    for (let at = 0, from = 0; at < re.length; at++, from += count) {
      let [p, q] = [0, 0];
      for (let k = 0; k < count; k++) {
        p += c[from + k] * x[k] - s[from + k] * y[k];
        q += c[from + k] * y[k] + s[from + k] * x[k];
      }
      re[at] = p;
      im[at] = q;
    }
  }

  readOut([re, im], out) {
    const { readout } = this;
    for (let at = 0; at < out.length; at++) {
      const power = re[at] * re[at] + im[at] * im[at];
      out[at] = readout === "Real" ? re[at] : readout === "Power" ? power : Math.sqrt(power);
    }
    if (readout !== "MinMax") return;
    const [low, high] = [out.reduce((a, b) => Math.min(a, b)), out.reduce((a, b) => Math.max(a, b))];
    const gap = high - low > 1e-6 * high ? high - low : Infinity;
    for (let at = 0; at < out.length; at++) out[at] = (out[at] - low) / gap;
  }

  weigh(signals) {
    const { readout } = this;
    for (let i = 0; i < this.n; i++) {
      const [a, b] = [signals[2 * i], signals[2 * i + 1]];
      const power = a * a + b * b;
      this.strengths[i] = Math.min(1, Math.max(0, readout === "Real" ? a : readout === "Power" ? power : Math.sqrt(power)));
    }
  }
}
