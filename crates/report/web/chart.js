import { penOf } from "./spectrum.js";

/** Draws lines on axes: `lines` are `{ points: [[x, y], ..], colour, dash, dots, stems, name }`, stems from 0. */
export function drawChart(canvas, { x, y, lines }, ink) {
  const [width, height] = [420, 220];
  const pen = penOf(canvas, width, height);
  const all = lines.flatMap((line) => line.points).filter(([a, b]) => Number.isFinite(a) && Number.isFinite(b));
  if (!all.length) return;
  const [left, top, right, bottom] = [52, 22, width - 10, height - 36];
  const [ax, bx] = chartEnds(all.map((point) => point[0]));
  const zero = lines.some((line) => line.stems) ? [0] : [];
  const [ay, by] = chartEnds([...all.map((point) => point[1]), ...zero]);
  const place = ([u, v]) => [left + ((u - ax) / (bx - ax)) * (right - left), bottom - ((v - ay) / (by - ay)) * (bottom - top)];
  pen.strokeStyle = pen.fillStyle = ink;
  pen.strokeRect(left + 0.5, top + 0.5, right - left, bottom - top);
  pen.textAlign = "center";
  for (const tick of chartTicks(ax, bx)) pen.fillText(chartNumber(tick), place([tick, ay])[0], bottom + 14);
  pen.fillText(x, (left + right) / 2, bottom + 29);
  pen.textAlign = "right";
  for (const tick of chartTicks(ay, by)) pen.fillText(chartNumber(tick), left - 5, place([ax, tick])[1] + 4);
  pen.textAlign = "left";
  pen.fillText(y, left, 13);
  let name = right;
  for (const line of lines) {
    drawChartLine(pen, line, place);
    if (!line.name) continue;
    pen.textAlign = "right";
    pen.fillText(line.name, name, 13);
    name -= pen.measureText(line.name).width + 16;
  }
}

function drawChartLine(pen, { points, colour, dash = [], dots = false, stems = false }, place) {
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 1.6;
  pen.setLineDash(dash);
  pen.beginPath();
  let down = false;
  for (const point of points) {
    const [u, v] = place(point);
    if (!Number.isFinite(v)) {
      down = false;
      continue;
    }
    if (stems) strokeLine(pen, [u, v], place([point[0], 0]));
    if (dots) strokeChartDot(pen, u, v, dash.length > 0);
    else if (down) pen.lineTo(u, v);
    else pen.moveTo(u, v);
    down = true;
  }
  if (!dots) pen.stroke();
  pen.setLineDash([]);
  pen.lineWidth = 1;
}

function strokeLine(pen, from, to) {
  pen.beginPath();
  pen.moveTo(...from);
  pen.lineTo(...to);
  pen.stroke();
}

/** Draws a ring, or a cross on dashed lines: print needs no colour. */
function strokeChartDot(pen, u, v, cross) {
  pen.setLineDash([]);
  pen.beginPath();
  if (cross) {
    pen.moveTo(u - 4, v - 4);
    pen.lineTo(u + 4, v + 4);
    pen.moveTo(u + 4, v - 4);
    pen.lineTo(u - 4, v + 4);
  } else {
    pen.arc(u, v, 4, 0, 2 * Math.PI);
  }
  pen.stroke();
}

function chartEnds(values) {
  const [low, high] = [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
  const air = 0.05 * (high - low) || 0.5;
  return [low - air, high + air];
}

/** About five round numbers between two ends. */
function chartTicks(low, high) {
  const raw = (high - low) / 5;
  const unit = 10 ** Math.floor(Math.log10(raw));
  const step = unit * [1, 2, 5, 10].find((k) => k * unit >= raw);
  const ticks = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) ticks.push(k * step);
  return ticks;
}

/** Short notation of a number, with a minus sign. */
export function chartNumber(value) {
  const text = Math.abs(value) >= 1e5 ? value.toExponential(0) : String(Number(value.toPrecision(6)));
  return text.replace("-", "−");
}

/** Power of antenna `a` at subcarrier `f` of a channel [2 A, F]. */
function gainPower(picture, width, a, f) {
  return picture[2 * a * width + f] ** 2 + picture[(2 * a + 1) * width + f] ** 2;
}

/** Antenna of a channel [2 A, F] with the highest power. */
export function strongestAntenna(picture, height, width) {
  let [best, most] = [0, -1];
  for (let a = 0; a < height / 2; a++) {
    let sum = 0;
    for (let f = 0; f < width; f++) sum += gainPower(picture, width, a, f);
    if (sum > most) [best, most] = [a, sum];
  }
  return best;
}

/** Curves of a channel [2 A, F]: dB of an antenna over subcarriers, or over antennas for one subcarrier, and power delay profile. */
export function channelCurves(picture, height, width, hz, antenna) {
  const over = width > 1 ? width : height / 2;
  const level = (k) => 10 * Math.log10((width > 1 ? gainPower(picture, width, antenna, k) : gainPower(picture, width, k, 0)) || 1e-30);
  const magnitude = Array.from({ length: over }, (_, k) => [width > 1 && hz.length === width ? hz[k] / 1e6 : k + 1, level(k)]);
  return { magnitude, over: width > 1 ? "MHz" : "antenna", delays: delayProfile(picture, antenna, width, hz) };
}

/** Power delay profile in nanoseconds for evenly spaced subcarriers; null for few subcarriers. */
function delayProfile(picture, antenna, width, hz) {
  if (width < 4 || hz.length !== width) return [];
  const spacing = (hz[width - 1] - hz[0]) / (width - 1);
  const [re, im] = [picture.subarray(2 * antenna * width), picture.subarray((2 * antenna + 1) * width)];
  return Array.from({ length: width }, (_, tap) => {
    let [a, b] = [0, 0];
    for (let f = 0; f < width; f++) {
      const turn = (2 * Math.PI * ((f * tap) % width)) / width;
      const [c, s] = [Math.cos(turn), Math.sin(turn)];
      a += re[f] * c - im[f] * s;
      b += re[f] * s + im[f] * c;
    }
    return [(tap / width / spacing) * 1e9, 10 * Math.log10((a * a + b * b) / (width * width) || 1e-30)];
  });
}
