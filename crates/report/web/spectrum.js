/** Converts a table of 256 colours [256, 3] to canvas pixels. */
export function paletteOf(rgb) {
  const bytes = new Uint8ClampedArray(4 * 256);
  for (let i = 0; i < 256; i++) bytes.set([rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2], 255], 4 * i);
  return new Uint32Array(bytes.buffer);
}

/** Spectrum drawn as a map (azimuth by elevation) and as the sky above the receiver. */
export class SpectrumView {
  /** `plane` is that of the room's note; `palette` 256 colours from `low` to `high`. */
  constructor(map, sky, plane, palette, low, high) {
    Object.assign(this, { map, sky, plane, palette, low, high });
    const { width, height } = plane;
    this.small = document.createElement("canvas");
    [this.small.width, this.small.height] = [width, height];
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.index = new Uint8Array(width * height);
    this.disc = plane.angles ? skyTable(plane, SKY_SIDE) : null;
    sky.hidden = !this.disc;
    if (this.disc) this.skyImage = new ImageData(SKY_SIDE, SKY_SIDE);
  }

  /** Draws `picture` [height, width]; marks are `{ pixel, cross }`: a ring, or a cross. */
  draw(picture, marks, ink) {
    const scale = 255 / (this.high - this.low);
    for (let i = 0; i < picture.length; i++) {
      const value = (picture[i] - this.low) * scale + 0.5;
      this.index[i] = value < 0 ? 0 : value > 255 ? 255 : value;
    }
    this.drawMap(marks, ink);
    if (this.disc) this.drawSky(marks, ink);
  }

  drawMap(marks, ink) {
    const { width, height } = this.plane;
    const upwards = this.plane.angles ? this.plane.angles[1].step > 0 : !this.plane.camera;
    for (let y = 0; y < height; y++) {
      const row = (upwards ? height - 1 - y : y) * width;
      for (let x = 0; x < width; x++) this.pixels[y * width + x] = this.palette[this.index[row + x]];
    }
    this.small.getContext("2d").putImageData(this.image, 0, 0);
    const [w, h] = [MAP_WIDTH, Math.max(60, (MAP_WIDTH * height) / width)];
    const pen = penOf(this.map, MAP_LEFT + w + 12, h + MAP_FOOT + MAP_TOP);
    pen.drawImage(this.small, MAP_LEFT, MAP_TOP, w, h);
    pen.strokeStyle = pen.fillStyle = ink;
    pen.strokeRect(MAP_LEFT + 0.5, MAP_TOP + 0.5, w - 1, h - 1);
    drawMapAxes(pen, this.plane, w, h);
    for (const { pixel, cross } of marks) {
      const [column, row] = [(pixel % width) + 0.5, Math.floor(pixel / width) + 0.5];
      const y = upwards ? height - row : row;
      drawSpectrumMark(pen, MAP_LEFT + (w * column) / width, MAP_TOP + (h * y) / height, cross);
    }
  }

  drawSky(marks, ink) {
    const { at, part } = this.disc;
    const out = new Uint32Array(this.skyImage.data.buffer);
    for (let i = 0; i < out.length; i++) {
      if (at[4 * i] < 0) continue;
      let value = 0;
      for (let k = 0; k < 4; k++) value += part[4 * i + k] * this.index[at[4 * i + k]];
      out[i] = this.palette[Math.round(value)];
    }
    const pen = penOf(this.sky, SKY_SIDE + 60, SKY_SIDE + 36);
    this.stamp ??= document.createElement("canvas");
    [this.stamp.width, this.stamp.height] = [SKY_SIDE, SKY_SIDE];
    this.stamp.getContext("2d").putImageData(this.skyImage, 0, 0);
    const [middle, radius] = [[SKY_SIDE / 2 + 30, SKY_SIDE / 2 + 18], SKY_SIDE / 2];
    pen.drawImage(this.stamp, middle[0] - radius, middle[1] - radius);
    drawSkyAxes(pen, middle, radius, ink);
    const [azimuth, elevation] = this.plane.angles;
    for (const { pixel, cross } of marks) {
      const turn = ((azimuth.first + azimuth.step * (pixel % this.plane.width)) * Math.PI) / 180;
      const rise = elevation.first + elevation.step * Math.floor(pixel / this.plane.width);
      const r = radius * Math.min(1, Math.max(0, 1 - rise / 90));
      drawSpectrumMark(pen, middle[0] + r * Math.cos(turn), middle[1] - r * Math.sin(turn), cross);
    }
  }
}

const [MAP_WIDTH, MAP_LEFT, MAP_TOP, MAP_FOOT] = [360, 44, 6, 34];
const SKY_SIDE = 200;

/** Cleared 2D context of a canvas of this size in CSS pixels, with the font of the page. */
export function penOf(canvas, width, height) {
  const ratio = Math.min(2, globalThis.devicePixelRatio || 1);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "11px system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";
  pen.lineWidth = 1;
  return pen;
}

function drawMapAxes(pen, plane, w, h) {
  const bottom = MAP_TOP + h;
  if (!plane.angles) {
    pen.textAlign = "center";
    pen.fillText(`${plane.width} columns, ${plane.height} rows`, MAP_LEFT + w / 2, bottom + 18);
    return;
  }
  const [azimuth, elevation] = plane.angles;
  pen.textAlign = "center";
  for (let degrees = 0; degrees <= 360; degrees += 90) {
    const part = ((degrees - azimuth.first) / azimuth.step + 0.5) / plane.width;
    if (part > -0.01 && part < 1.01) pen.fillText(`${degrees}°`, MAP_LEFT + w * part, bottom + 14);
  }
  pen.fillText("azimuth", MAP_LEFT + w / 2, bottom + 28);
  pen.textAlign = "right";
  for (let degrees = -90; degrees <= 90; degrees += 30) {
    const row = ((degrees - elevation.first) / elevation.step + 0.5) / plane.height;
    const part = elevation.step > 0 ? 1 - row : row;
    if (part > -0.01 && part < 1.01) pen.fillText(`${degrees}°`.replace("-", "−"), MAP_LEFT - 5, MAP_TOP + h * part + 4);
  }
}

function drawSkyAxes(pen, [cx, cy], radius, ink) {
  pen.strokeStyle = "rgba(255, 255, 255, 0.45)";
  for (const part of [1 / 3, 2 / 3]) strokeRing(pen, cx, cy, radius * part);
  pen.beginPath();
  for (const [dx, dy] of [[1, 0], [0, 1]]) {
    pen.moveTo(cx - radius * dx, cy - radius * dy);
    pen.lineTo(cx + radius * dx, cy + radius * dy);
  }
  pen.stroke();
  pen.strokeStyle = pen.fillStyle = ink;
  strokeRing(pen, cx, cy, radius);
  pen.textAlign = "left";
  pen.fillText("0°", cx + radius + 5, cy + 4);
  pen.textAlign = "center";
  pen.fillText("90°", cx, cy - radius - 5);
  pen.fillText("270°", cx, cy + radius + 13);
  pen.textAlign = "right";
  pen.fillText("180°", cx - radius - 5, cy + 4);
}

/** Adds a ring of radius r. */
export function strokeRing(pen, x, y, r) {
  pen.beginPath();
  pen.arc(x, y, r, 0, 2 * Math.PI);
  pen.stroke();
}

/** Draws a ring or a cross, white on a dark halo. */
function drawSpectrumMark(pen, x, y, cross) {
  for (const [style, width] of [["rgba(0, 0, 0, 0.75)", 3.4], ["#fff", 1.6]]) {
    [pen.strokeStyle, pen.lineWidth] = [style, width];
    if (!cross) {
      strokeRing(pen, x, y, 6);
      continue;
    }
    pen.beginPath();
    for (const [dx, dy] of [[4, 4], [4, -4]]) {
      pen.moveTo(x - dx, y - dy);
      pen.lineTo(x + dx, y + dy);
    }
    pen.stroke();
  }
  pen.lineWidth = 1;
}

/** Per pixel of the disc, four pixels of the image and their weights; -1 outside. */
function skyTable(plane, side) {
  const [azimuth, elevation] = plane.angles;
  const { width, height, wraps } = plane;
  const at = new Int32Array(4 * side * side).fill(-1);
  const part = new Float32Array(4 * side * side);
  const column = (x) => (wraps ? ((x % width) + width) % width : Math.min(width - 1, Math.max(0, x)));
  const row = (y) => Math.min(height - 1, Math.max(0, y));
  for (let i = 0; i < side * side; i++) {
    const [x, y] = [((i % side) + 0.5) / (side / 2) - 1, 1 - (Math.floor(i / side) + 0.5) / (side / 2)];
    const radius = Math.hypot(x, y);
    if (radius > 1) continue;
    const turn = ((Math.atan2(y, x) * 180) / Math.PI + 360) % 360;
    const px = (turn - azimuth.first) / azimuth.step;
    const py = (90 * (1 - radius) - elevation.first) / elevation.step;
    const [x0, y0] = [Math.floor(px), Math.floor(py)];
    const [fx, fy] = [px - x0, py - y0];
    [[0, 0], [1, 0], [0, 1], [1, 1]].forEach(([dx, dy], k) => {
      at[4 * i + k] = row(y0 + dy) * width + column(x0 + dx);
      part[4 * i + k] = (dx ? fx : 1 - fx) * (dy ? fy : 1 - fy);
    });
  }
  return { at, part };
}

/** Index of the largest value. */
export function strongestPixel(picture) {
  let best = 0;
  for (let i = 1; i < picture.length; i++) if (picture[i] > picture[best]) best = i;
  return best;
}
