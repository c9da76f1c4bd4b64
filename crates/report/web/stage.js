import { ROOM_TRANSMITTER, Room } from "./room.js";
import { SpectrumView, paletteOf, strongestPixel } from "./spectrum.js";
import { drawChart, channelCurves, chartNumber, strongestAntenna } from "./chart.js";
import { closerView, drawLocation, locationSentence } from "./location.js";
import { ServerSource } from "./source.js";

/** Colours of sets and of removed and kept Gaussians, for the colour-blind (Okabe and Ito). */
const PART_COLOURS = [[230, 159, 0], [86, 180, 233], [0, 158, 115], [140, 146, 158]];
const PART_NAMES = ["training", "validation", "test", "unused"];
const TEST = 2;
const GOES = [213, 94, 0];
const STAYS = [0, 114, 178];
const MEASURED_LINE = "#0072b2";
const PREDICTED_LINE = "#d55e00";
/** Step of an arrow key, metres. */
const STRIDE = 0.1;

/** One half of the page: a room and the predictions of its model. */
class StageSide {
  constructor(stage, place, about) {
    Object.assign(this, { stage, place, about });
    const article = stage.template("side").querySelector("article");
    this.root = article;
    this.find("name").textContent = stage.abouts.length > 1 ? about.name : "";
    this.numbers = this.find("numbers");
    this.find("pictures").classList.toggle("stage-charts", !stage.note.has_pixels);
    const canvas = this.find("room");
    canvas.setAttribute("aria-label", `3D view of the room, ${about.name}: arrow keys move the transmitter`);
    stage.find("sides").append(article);
    this.room = openRoom(canvas);
    if (!this.room) canvas.replaceWith("3D view not available: this browser does not support WebGL2.");
    this.figures = {};
    this.gaussians = null;
  }

  find(name) {
    return this.root.querySelector(`[data-${name}]`);
  }

  /** Figure for an image, created on first use. */
  figure(name, title, palette, low, high) {
    if (!this.figures[name]) {
      const figure = this.stage.template("figure").querySelector("figure");
      this.find("pictures").append(figure);
      const [map, sky] = [figure.querySelector("[data-map]"), figure.querySelector("[data-sky]")];
      map.setAttribute("role", "img");
      map.setAttribute("aria-label", `${title}, map of azimuth and elevation`);
      sky.setAttribute("aria-label", `${title}, sky above the receiver`);
      sky.setAttribute("role", "img");
      const view = palette ? new SpectrumView(map, sky, this.stage.note.plane, palette, low, high) : null;
      if (!view) sky.remove();
      this.figures[name] = { view, map, caption: figure.querySelector("figcaption") };
    }
    this.figures[name].caption.textContent = title;
    return this.figures[name];
  }

  /** Loads and colours the Gaussians of the snapshot, or of the model for the transmitter. */
  async loadGaussians(tx) {
    const { stage } = this;
    if (!this.room || this.about.baseline || !this.about.gaussians) return;
    if (stage.locates) {
      this.room.setGaussians(null); // they would hide the density
      this.room.setPoints("gaussians", null);
      return;
    }
    const snapshot = stage.snapshotOf(this);
    const moves = snapshot === null && ["strength", "contribution"].includes(stage.colouring);
    const contribution = stage.colouring === "contribution";
    const asked = snapshot === null ? { tx: moves ? tx : null, receiver: stage.receiver, contribution } : { snapshot };
    const all = await stage.source.gaussians(this.place, asked);
    const nextIds = await this.nextIds(snapshot);
    if (stage.locates) return; // chosen during the load
    this.gaussians = all;
    this.drawGaussians(all, nextIds);
  }

  /** IDs of the Gaussians in the next snapshot; null if unknown. */
  async nextIds(snapshot) {
    const { snapshots } = this.about;
    if (snapshot === null || snapshot + 1 >= snapshots.length || !this.gaussians.has("gaussian_ids")) return null;
    const next = await this.stage.source.gaussians(this.place, { snapshot: snapshot + 1 });
    return next.has("gaussian_ids") ? new Set(next.get("gaussian_ids")) : null;
  }

  drawGaussians(all, nextIds) {
    const means = all.get("means");
    const n = means.length / 3;
    const colours = this.stage.coloursOf(all, n, nextIds);
    if (!this.about.ellipsoids || !all.has("scales")) {
      this.room.setGaussians(null);
      this.room.setPoints("gaussians", { positions: means, colours, size: 6, shape: "dot", pickable: false });
      return;
    }
    this.room.setPoints("gaussians", null);
    this.room.setGaussians({ means, scales: all.get("scales"), quats: all.get("quats"), colours });
  }

  /** Shows prediction, nearest measurement and their difference. */
  show(found, truth) {
    const { has_pixels: pixels, is_scalar: scalar } = this.stage.note;
    if (pixels) this.showSpectra(found, truth);
    else if (scalar) this.showPowers(found, truth);
    else this.showChannels(found, truth);
    this.numbers.textContent = this.stage.sentence(found, truth);
    const extrapolates = isExtrapolation(found.note);
    this.root.classList.toggle("stage-extrapolation", extrapolates);
    this.room?.setExtrapolation(extrapolates);
  }

  showSpectra(found, truth) {
    const { palettes, ink, note, word } = this.stage;
    const picture = (this.picture = found.get("picture"));
    const mine = { pixel: strongestPixel(picture), cross: true };
    const predicted = this.figure("predicted", "Predicted", palettes.power, 0, 1);
    if (!truth) {
      predicted.view.draw(picture, [mine], ink);
    } else {
      const measured = truth.get("picture");
      const theirs = { pixel: strongestPixel(measured), cross: false };
      predicted.view.draw(picture, [theirs, mine], ink);
      const { metres } = found.note.nearest;
      const kind = note.simulated ? "Simulated" : "Measured";
      const title = metres ? `${kind} nearest, ${metres.toFixed(2)} m away` : kind;
      this.figure("measured", title, palettes.power, 0, 1).view.draw(measured, [theirs], ink);
      this.difference ??= new Float32Array(picture.length);
      for (let i = 0; i < picture.length; i++) this.difference[i] = Math.min(1, Math.max(0, picture[i])) - measured[i];
      this.figure("difference", `Predicted − ${word}, −0.5 to 0.5`, palettes.error, -0.5, 0.5).view.draw(this.difference, [], ink);
    }
    if (found.has("deviation")) {
      const title = "Spread of the members, 0 to 0.5";
      this.figure("spread", title, palettes.power, 0, 0.5).view.draw(found.get("deviation"), [], ink);
    }
  }

  showPowers(found, truth) {
    const points = (values) => Array.from(values, (dbm, k) => [k + 1, dbm]);
    const lines = [{ points: points(found.get("powers")), colour: PREDICTED_LINE, dots: true, dash: [4, 3], name: "× predicted" }];
    if (truth) lines.push({ points: points(truth.get("powers")), colour: MEASURED_LINE, dots: true, name: `○ nearest ${this.stage.note.simulated ? "simulation" : "measurement"}` });
    const { map } = this.figure("powers", "Received power", null);
    drawChart(map, { x: "receiver", y: "dBm", lines }, this.stage.ink);
    if (!truth) return;
    const measured = truth.get("powers");
    const errors = points(found.get("powers")).map(([k, dbm]) => [k, dbm - measured[k - 1]]);
    const error = this.figure("difference", `Predicted − ${this.stage.word}`, null);
    drawChart(error.map, { x: "receiver", y: "dB", lines: [{ points: errors, colour: this.stage.ink, dots: true, stems: true }] }, this.stage.ink);
  }

  showChannels(found, truth) {
    const { plane, frequencies_hz: hz } = this.stage.note;
    const antenna = strongestAntenna((truth ?? found).get("picture"), plane.height, plane.width);
    const curves = (pack) => channelCurves(pack.get("picture"), plane.height, plane.width, hz, antenna);
    const both = [[curves(found), PREDICTED_LINE, [6, 4], "- - predicted"]];
    if (truth) both.push([curves(truth), MEASURED_LINE, [], `— nearest ${this.stage.note.simulated ? "simulation" : "measurement"}`]);
    const lines = (key) => both.map(([curve, colour, dash, name]) => ({ points: curve[key], colour, dash, name }));
    const dots = (all) => (both[0][0].magnitude.length === 1 ? all.map((line) => ({ ...line, dots: true })) : all);
    const magnitude = this.figure("magnitude", "Magnitude", null);
    drawChart(magnitude.map, { x: both[0][0].over, y: "dB", lines: dots(lines("magnitude")) }, this.stage.ink);
    if (truth) {
      const measured = truth.get("picture");
      const error = curves({ get: () => found.get("picture").map((v, k) => v - measured[k]) });
      const { map } = this.figure("difference", `Modulus of predicted − ${this.stage.word}`, null);
      drawChart(map, { x: error.over, y: "dB", lines: dots([{ points: error.magnitude, colour: this.stage.ink }]) }, this.stage.ink);
    }
    if (!both[0][0].delays.length) return;
    const delays = this.figure("delays", "Power delay profile", null);
    drawChart(delays.map, { x: "ns", y: "dB", lines: lines("delays") }, this.stage.ink);
  }

  /** Shows the radio map at this height as squares in the room. */
  async showMap(z, receiver) {
    if (!this.room || this.stage.note.has_pixels || !this.stage.source.map || !this.about.by_position) return;
    const pack = await this.stage.source.map(this.place, z, receiver);
    if (this.stage.locates) return; // the density is at the same height
    const [values, [rows, columns]] = [pack.get("map"), pack.shape("map")];
    const finite = values.filter(Number.isFinite);
    const [low, high] = [finite.reduce((a, b) => Math.min(a, b), Infinity), finite.reduce((a, b) => Math.max(a, b), -Infinity)];
    const { first, step } = pack.note;
    const beyond = pack.has("extrapolated") ? pack.get("extrapolated") : null;
    const cells = { positions: new Float32Array(3 * rows * columns), colours: new Uint8Array(4 * rows * columns) };
    for (let k = 0; k < values.length; k++) {
      cells.positions.set([first[0] + step * (k % columns), first[1] + step * Math.floor(k / columns), first[2]], 3 * k);
      const faint = beyond?.[k] ? 50 : 200;
      const at = Math.round((255 * (values[k] - low)) / (high - low || 1));
      cells.colours.set(Number.isFinite(values[k]) ? [...this.stage.rgb(at), faint] : [128, 128, 128, 60], 4 * k);
    }
    this.room.setPoints("map", { ...cells, size: 7, shape: "square", pickable: false });
    this.stage.mapEnds = [low, high];
    this.stage.drawLegend();
  }

  /** Locates the sample of a link, or says what to do if there is none. */
  async locate(link) {
    const { stage } = this;
    this.sayLocating(link);
    const found = link === null ? null : await stage.source.locate(this.place, link).catch((error) => error.message);
    if (!stage.locates || stage.link !== link) return;
    const isLocated = Boolean(found?.note);
    this.hasLocated ||= isLocated;
    this.located = isLocated ? found : null;
    this.drawLocated();
    const number = (v) => chartNumber(Number(v.toPrecision(3)));
    const hint = "Select a sample to locate it: click a dot, or use the buttons ‹ and ›.";
    this.sayLocated(isLocated ? locationSentence(found.note, number) : found ?? hint);
  }

  /** Draws the located sample, or removes it. */
  drawLocated() {
    if (this.room) drawLocation(this.room, this.located, { origin: this.stage.note.origin, rgb: (at) => this.stage.rgb(at) });
    this.stage.find("closer").disabled = !this.stage.sides.some((side) => side.located);
  }

  /** Explains the wait for the first sample. */
  sayLocating(link) {
    if (this.hasLocated || link === null) return;
    this.sayLocated(`Locating sample ${this.stage.ids[link]}. The first sample takes seconds to minutes, because the model predicts all training positions.`);
  }

  sayLocated(text) {
    const own = this.find("located");
    [own.textContent, own.hidden] = [text, !this.stage.locates];
  }

  /** Shows loss and N of a run in progress. */
  async showCurve() {
    if (!this.about.running) return;
    const curve = (await this.stage.source.curve(this.place)).get("curve");
    const rows = Array.from({ length: curve.length / 3 }, (_, k) => curve.subarray(3 * k, 3 * k + 3));
    const line = (k, colour) => [{ points: rows.map((row) => [row[0], k === 1 ? Math.log10(row[k]) : row[k]]), colour }];
    const { ink } = this.stage;
    drawChart(this.figure("loss", "Training loss", null).map, { x: "step", y: "log10 loss", lines: line(1, PREDICTED_LINE) }, ink);
    drawChart(this.figure("count", "Number of Gaussians", null).map, { x: "step", y: "N", lines: line(2, MEASURED_LINE) }, ink);
  }
}

/** Whether the transmitter is farther from all training positions than their limit. */
function isExtrapolation({ training }) {
  return Boolean(training && training.metres > training.limit);
}

function openRoom(canvas) {
  try {
    return new Room(canvas);
  } catch {
    return null;
  }
}

/** Stage: one transmitter, one or two sides. */
export class Stage {
  constructor(root, source) {
    Object.assign(this, { root, source, sides: [], abouts: [], updates: 0, times: { page: 0, prediction: 0 } });
    this.colouring = "opacity";
    this.receiver = 0;
    this.snapshot = null;
    this.truths = new Map();
  }

  find(name) {
    return this.root.querySelector(`[data-${name}]`);
  }

  template(name) {
    return this.root.parentElement.querySelector(`template[data-${name}]`).content.cloneNode(true);
  }

  async start() {
    this.known = await this.source.room();
    this.note = this.known.note;
    this.abouts = this.note.sides;
    this.root.hidden = false;
    this.palettes = { power: paletteOf(this.known.get("colours.power")), error: paletteOf(this.known.get("colours.error")) };
    this.find("title").textContent = this.note.title ?? this.abouts[0].name;
    const word = this.note.simulated === undefined ? "no data next to the model" : this.note.simulated ? "simulated data" : "measured data";
    this.find("tag").textContent = word;
    this.find("sides").classList.toggle("stage-two", this.abouts.length > 1);
    this.sides = this.abouts.map((about, place) => new StageSide(this, place, about));
    this.placeLinks();
    this.buildControls();
    this.drawRooms();
    this.listenToRooms();
    this.setTheme();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.setTheme());
    this.source.listen((news) => this.hear(news).catch((error) => this.say(error.message)), () => this.say("The server of this page has stopped."));
    await this.refresh();
    this.root.dataset.ready = "yes";
  }

  /** Samples to step through: [link, ..] in the selected order. */
  placeLinks() {
    const has = this.known.has("links.tx");
    this.positions = has ? this.known.get("links.tx") : new Float32Array(0);
    this.ids = has ? this.known.get("links.id") : new Float32Array(0);
    this.scores = has ? this.known.get("links.score") : new Float32Array(0);
    this.parts = has ? this.known.get("links.part") : new Uint8Array(0);
    this.receivers = has ? this.known.get("links.receiver") : new Float32Array(0);
    const [low, high] = this.note.bounds;
    this.tx = low.map((v, k) => (v + high[k]) / 2);
    this.link = null;
    this.median = this.note.median ?? this.medianLink();
    this.receiver = this.receivers[this.median] ?? 0;
    const first = this.median ?? this.firstLink();
    if (first !== undefined) this.goTo(first, false);
  }

  /** Word for the observations of the data. */
  get word() {
    return this.note.simulated ? "simulated" : "measured";
  }

  /** Test sample with the median score; undefined without scores. */
  medianLink() {
    const { higher } = this.note.score ?? {};
    const links = Array.from(this.scores.keys()).filter((i) => this.parts[i] === TEST && Number.isFinite(this.scores[i]));
    links.sort((a, b) => (higher ? this.scores[b] - this.scores[a] : this.scores[a] - this.scores[b]) || a - b);
    return links[Math.floor((links.length - 1) / 2)];
  }

  /** First test sample of the selected receiver, else any sample. */
  firstLink() {
    const all = this.ordered("id");
    return all.find((i) => this.parts[i] === TEST) ?? all[0];
  }

  /** Sorted links of the selected receiver. */
  ordered(order) {
    const own = this.source.links ?? Array.from(this.ids.keys());
    const links = own.filter((i) => this.receivers[i] === this.receiver);
    if (order === "id") return links.sort((a, b) => this.ids[a] - this.ids[b]);
    const scored = links.filter((i) => Number.isFinite(this.scores[i]));
    const sign = (order === "best") === this.note.score.higher ? -1 : 1;
    return scored.sort((a, b) => sign * (this.scores[a] - this.scores[b]));
  }

  goTo(link, ask = true) {
    this.link = link;
    if (this.note.placed !== false) this.tx = Array.from(this.positions.subarray(3 * link, 3 * link + 3));
    this.find("sample").value = this.ids[link];
    if (ask) this.moved();
  }

  /** Transmitter position, metres in the world frame. */
  world(tx) {
    return tx.map((v, k) => v + this.note.origin[k]);
  }

  get byPosition() {
    return this.source.free && this.note.placed !== false && this.abouts.every((about) => about.by_position !== false);
  }

  buildControls() {
    const bar = this.find("controls");
    bar.addEventListener("submit", (event) => event.preventDefault());
    const on = (name, event, act) => this.root.querySelectorAll(`[data-${name}]`).forEach((own) => own.addEventListener(event, () => act(own)));
    on("tx", "change", (own) => this.moveTo(this.tx.map((v, k) => (k === Number(own.dataset.tx) ? own.valueAsNumber - this.note.origin[k] : v))));
    on("height", "input", (own) => this.moveTo([this.tx[0], this.tx[1], own.valueAsNumber - this.note.origin[2]]));
    on("sample", "change", (own) => this.seek(own.valueAsNumber));
    on("step", "click", (own) => this.step(Number(own.dataset.step)));
    on("order", "change", (own) => this.step(0, own.value));
    on("receiver", "change", (own) => this.listenAt(Number(own.value)));
    on("colour", "change", (own) => this.colourBy(own.value));
    on("spread", "input", (own) => this.sides.forEach((side) => side.room?.setSpread(own.valueAsNumber)));
    on("samples", "change", () => this.drawSamples());
    on("surfaces", "change", () => this.drawSurfaces());
    on("reset", "click", () => this.resetView());
    on("locate", "change", (own) => this.locateSamples(own.checked));
    on("closer", "click", () => this.zoomToLocated());
    this.find("of-locating").hidden = !this.source.locate;
    on("snapshot", "input", (own) => this.showSnapshot(own.valueAsNumber));
    this.offerColours();
    this.offerSnapshots();
    const names = this.note.receivers.map((receiver, k) => new Option(receiver.name, k));
    this.find("receiver").append(...names);
    this.find("receiver").value = this.receiver;
    this.find("of-receivers").hidden = names.length < 2;
    const [low, high] = this.note.bounds;
    const height = this.find("height");
    [height.min, height.max] = [low[2] + this.note.origin[2], high[2] + this.note.origin[2]];
    this.root.querySelectorAll("[data-tx], [data-height]").forEach((own) => (own.disabled = !this.byPosition));
    this.find("sample").disabled = !this.ids.length;
  }

  offerColours() {
    const some = this.abouts.some((about) => about.gaussians && !about.baseline);
    this.root.querySelectorAll("[data-of-gaussians]").forEach((own) => (own.hidden = !some));
    const all = [["opacity", "opacity"]];
    if (this.byPosition) all.push(["strength", "strength for this transmitter"]);
    if (this.byPosition && this.source.map) all.push(["contribution", "contribution to this prediction"]);
    if (this.abouts.some((about) => about.snapshots?.length)) all.push(["fate", "removed next"], ["mask", "mask"]);
    this.find("colour").replaceChildren(...all.map(([value, text]) => new Option(text, value)));
    this.find("colour").value = this.colouring;
  }

  offerSnapshots() {
    const count = Math.max(0, ...this.abouts.map((about) => (about.gaussians === 0 ? 0 : about.snapshots?.length ?? 0)));
    this.find("of-time").hidden = count === 0;
    const slider = this.find("snapshot");
    slider.max = count;
    if (this.snapshot === null) slider.value = count;
    this.nameSnapshot();
  }

  nameSnapshot() {
    const about = this.abouts.find((own) => own.snapshots?.length) ?? this.abouts[0];
    const at = this.snapshot === null ? null : about.snapshots?.[this.snapshot];
    const n = at ? at.gaussians : about.gaussians;
    const title = at ? at.title : about.running ? "Current" : "Final";
    this.find("snapshot-title").textContent = n === null ? title : `${title}: N = ${n.toLocaleString("en")}`;
    this.find("snapshot").setAttribute("aria-valuetext", this.find("snapshot-title").textContent);
  }

  /** Snapshot of a side; null for the final model. */
  snapshotOf(side) {
    return this.snapshot !== null && this.snapshot < (side.about.snapshots?.length ?? 0) ? this.snapshot : null;
  }

  showSnapshot(place) {
    const count = Number(this.find("snapshot").max);
    this.snapshot = place >= count ? null : place;
    this.nameSnapshot();
    if (this.snapshot !== null && this.colouring !== "mask") this.colouring = this.find("colour").value = "fate";
    if (this.snapshot === null && ["fate", "mask"].includes(this.colouring)) this.colouring = this.find("colour").value = "opacity";
    this.reloadGaussians();
  }

  colourBy(name) {
    this.colouring = name;
    this.reloadGaussians();
  }

  /** Reloads the Gaussians; the last request wins. */
  async reloadGaussians() {
    const wish = (this.wish = (this.wish ?? 0) + 1);
    for (const side of this.sides) {
      if (wish === this.wish) await side.loadGaussians(this.world(this.tx)).catch((error) => this.say(error.message));
    }
    this.drawLegend();
  }

  listenAt(receiver) {
    this.receiver = receiver;
    this.goTo(this.firstLink() ?? this.link);
  }

  seek(id) {
    const links = this.ordered("id");
    if (!links.length || !Number.isFinite(id)) return;
    this.goTo(links.reduce((best, i) => (Math.abs(this.ids[i] - id) < Math.abs(this.ids[best] - id) ? i : best)));
  }

  step(by, order = this.find("order").value) {
    const links = this.ordered(order);
    if (!links.length) {
      this.say("No sample has a score.");
      return;
    }
    const at = by === 0 ? 0 : links.indexOf(this.link) + by;
    this.goTo(links[(at + links.length) % links.length]);
  }

  drawRooms() {
    const [low, high] = this.note.bounds;
    const receivers = this.note.receivers;
    const reach = 0.12 * Math.hypot(...high.map((v, k) => v - low[k]));
    for (const { room } of this.sides.filter((side) => side.room)) {
      room.setBounds(low, high);
      const colours = new Uint8Array(receivers.flatMap(() => [213, 94, 0, 255]));
      room.setPoints("receivers", { positions: new Float32Array(receivers.flatMap((own) => own.position)), colours, size: 13, shape: "square", pickable: false, onTop: true });
      const lines = receivers.flatMap(({ position, boresight }) => [...position, ...position.map((v, k) => v + reach * boresight[k])]);
      room.setLines("boresights", { positions: new Float32Array(lines), colours, onTop: true });
    }
    this.drawSurfaces();
    this.drawSamples();
  }

  drawSurfaces() {
    const shown = this.find("surfaces").checked && this.known.has("points");
    for (const { room } of this.sides.filter((side) => side.room)) {
      const positions = shown ? this.known.get("points") : new Float32Array(0);
      const colours = new Uint8Array((positions.length / 3) * 4);
      for (let i = 0; i < colours.length; i += 4) colours.set([141, 148, 161, 150], i);
      const walls = this.find("surfaces").checked && this.known.has("surfaces") ? this.known.get("surfaces") : [];
      room.setTriangles("walls", walls.length ? { positions: walls, colour: [0.55, 0.58, 0.63, 0.16] } : null);
      room.setPoints("surface", positions.length ? { positions, colours, size: 2, shape: "dot", pickable: false } : null);
    }
  }

  drawSamples() {
    const by = this.find("samples").value;
    const n = this.ids.length;
    const colours = new Uint8Array(4 * n);
    const finite = Array.from(this.scores).filter(Number.isFinite).sort((a, b) => a - b);
    const [low, high] = [finite[Math.floor(0.02 * finite.length)], finite[Math.floor(0.98 * (finite.length - 1))]];
    for (let i = 0; i < n; i++) {
      const scored = by === "score" && Number.isFinite(this.scores[i]);
      const part = (this.scores[i] - low) / (high - low || 1);
      const good = Math.min(255, Math.max(0, Math.round(255 * (this.note.score.higher ? part : 1 - part))));
      colours.set(scored ? [...this.rgb(good), 255] : [...PART_COLOURS[by === "score" ? 3 : this.parts[i]], by === "score" ? 70 : 200], 4 * i);
    }
    const layer = n && by !== "none" && this.note.placed !== false ? { positions: this.positions, colours, size: 5, shape: "dot", pickable: true } : null;
    this.sides.forEach((side) => side.room?.setPoints("samples", layer));
    this.drawLegend();
  }

  /** Legend of the colours. */
  drawLegend() {
    const mark = ([r, g, b], text) => {
      const dot = document.createElement("i");
      dot.style.background = `rgb(${r}, ${g}, ${b})`;
      return [dot, text];
    };
    const by = this.find("samples").value;
    const parts = PART_NAMES.map((name, k) => mark(PART_COLOURS[k], name)).filter((_, k) => this.parts.includes(k));
    const all = by === "part" ? ["Transmitters:", ...parts.flat()] : [];
    if (by === "score") all.push(`Transmitters by ${this.note.score.name} on the test set:`, ...mark(this.rgb(0), "worst"), ...mark(this.rgb(255), "best"));
    if (this.locates) all.push(" · Gaussians are hidden · Location: density of the transmitter over the floor,", ...mark(this.rgb(0), "low"), ...mark(this.rgb(255), "high"), "; outline: 90 % region; white diamond: estimate;", ...mark(ROOM_TRANSMITTER, "true position"));
    else if (this.colouring === "fate" && this.snapshot !== null) all.push(" · Gaussians:", ...mark(GOES, "removed before the next snapshot"), ...mark(STAYS, "kept"));
    else if (this.abouts.some((about) => about.gaussians)) all.push(` · Gaussians by ${this.colouring}:`, ...mark(this.rgb(0), "least"), ...mark(this.rgb(255), "most"));
    if (this.mapEnds) {
      const [low, high] = this.mapEnds.map((v) => chartNumber(Math.round(v)));
      const { unit } = this.note;
      all.push(` · Squares: prediction at ${this.note.receivers[this.receiver].name} for a transmitter at this height (faint: extrapolation),`);
      all.push(...mark(this.rgb(0), `${low} ${unit}`), ...mark(this.rgb(255), `${high} ${unit}`));
    }
    all.push(" · Receivers:", ...mark([213, 94, 0], "with boresight"));
    this.find("legend").replaceChildren(...all);
  }

  rgb(index) {
    const all = this.known.get("colours.power");
    return [all[3 * index], all[3 * index + 1], all[3 * index + 2]];
  }

  /** RGBA colours of the Gaussians. */
  coloursOf(all, n, nextIds) {
    const colours = new Uint8Array(4 * n);
    const names = { opacity: "opacities", strength: "strengths", contribution: "contributions", mask: "gates" };
    const name = names[this.colouring];
    const ids = nextIds && this.colouring === "fate" ? all.get("gaussian_ids") : null;
    const values = !ids && all.has(name) ? all.get(name) : all.get("opacities");
    const most = this.colouring === "mask" ? 1 : values.reduce((a, b) => Math.max(a, b), 1e-12);
    for (let i = 0; i < n; i++) {
      const own = ids ? (nextIds.has(ids[i]) ? STAYS : GOES) : this.rgb(Math.min(255, Math.max(0, Math.round((255 * values[i]) / most))));
      colours.set([...own, 255], 4 * i);
    }
    return colours;
  }

  listenToRooms() {
    for (const side of this.sides.filter((own) => own.room)) {
      const { room } = side;
      room.onTransmitter = (place) => this.moveTo(Array.from(place));
      room.onPick = (layer, index) => layer === "samples" && this.goTo(this.pickable(index));
      room.onView = () => this.sides.forEach((other) => other !== side && other.room && (other.room.view = room.view));
      side.find("room").addEventListener("keydown", (event) => this.press(event, room));
    }
    this.firstView = this.sides.find((side) => side.room)?.room.view;
  }

  /** Sample itself, or the nearest sample that can be shown. */
  pickable(link) {
    const { links } = this.source;
    if (!links || links.includes(link)) return link;
    return this.source.nearest(this.world(Array.from(this.positions.subarray(3 * link, 3 * link + 3)))).link;
  }

  resetView() {
    this.sides.forEach((side) => side.room && (side.room.view = this.firstView));
  }

  /** Starts or stops locating the selected samples. */
  locateSamples(locates) {
    this.locates = locates;
    this.mapped = this.mapEnds = null;
    this.sides.forEach((side) => side.room?.setPoints("map", null));
    this.removeLocated();
    this.reloadGaussians();
    this.settle();
  }

  removeLocated() {
    this.sought = undefined;
    for (const side of this.sides.filter((own) => own.located || !this.locates)) {
      side.located = null;
      side.drawLocated();
      side.sayLocated("");
    }
  }

  /** Locates the selected sample on every side; requests of samples that were left are not shown. */
  async locate() {
    if (this.isLocating) {
      if (this.locates) this.sides.forEach((side) => side.sayLocating(this.link));
      return;
    }
    this.isLocating = true;
    try {
      while (this.locates && this.sought !== this.link) {
        this.sought = this.link;
        await Promise.all(this.sides.map((side) => side.locate(this.sought)));
        this.say(this.sides.map((side) => `${side.about.name}: ${side.find("located").textContent}`).join(". "));
      }
    } finally {
      this.isLocating = false;
    }
  }

  zoomToLocated() {
    const { note } = this.sides.find((side) => side.located).located;
    this.sides.forEach((side) => side.room && (side.room.view = closerView(side.room.view, note, this.note.origin)));
  }

  press(event, room) {
    const moves = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
    const looks = { "+": () => room.zoom(0.9), "-": () => room.zoom(1.1), "[": () => room.turn(-0.1, 0), "]": () => room.turn(0.1, 0) };
    if (moves[event.key]) this.moveTo(this.tx.map((v, k) => v + STRIDE * moves[event.key][k]));
    else if (looks[event.key]) looks[event.key]();
    else return;
    event.preventDefault();
  }

  moveTo(tx) {
    if (!this.byPosition) {
      const near = this.source.nearest?.(this.world(tx));
      if (near && near.link !== this.link) this.goTo(near.link);
      return;
    }
    if (!tx.every(Number.isFinite)) return;
    this.link = null;
    this.tx = tx;
    this.moved();
  }

  /** Moves the transmitter and updates predictions as fast as the source answers. */
  moved() {
    if (this.locates && this.sought !== this.link) this.removeLocated();
    this.sides.forEach((side) => side.room?.setTransmitter(this.tx));
    this.world(this.tx).forEach((v, k) => (this.root.querySelector(`[data-tx="${k}"]`).value = v.toFixed(2)));
    this.find("height").value = this.world(this.tx)[2];
    this.refresh();
  }

  async refresh() {
    if (this.busy) {
      this.again = true;
      return;
    }
    this.busy = true;
    do {
      this.again = false;
      await this.update().catch((error) => this.say(error.message));
    } while (this.again);
    this.busy = false;
    await this.settle();
  }

  async update() {
    const { tx, link, receiver } = this;
    const asked = { tx: this.byPosition ? this.world(tx) : null, link, receiver };
    const found = await Promise.all(this.sides.map((side) => this.source.predict(side.place, asked)));
    const truths = await Promise.all(found.map((one, k) => one.note.nearest && this.truth(k, one.note.nearest.link)));
    const begun = performance.now();
    this.sides.forEach((side, k) => side.show(found[k], truths[k]));
    const near = found[0].note.nearest;
    const at = near && this.note.placed !== false ? Array.from(this.positions.subarray(3 * near.link, 3 * near.link + 3)) : null;
    this.sides.forEach((side) => side.room?.setSelected(at));
    this.times = { page: performance.now() - begun, prediction: found[0].note.ms };
    this.updates += 1;
    if (["strength", "contribution"].includes(this.colouring) && this.snapshot === null) await this.reloadGaussians();
  }

  /** Updates slower parts once the transmitter is at rest. */
  async settle() {
    clearTimeout(this.resting);
    this.resting = setTimeout(async () => {
      this.say(this.sides.map((side) => `${side.about.name}: ${side.numbers.textContent}`).join(". "));
      if (this.locates) return this.locate();
      const z = this.world(this.tx)[2];
      if (this.note.has_pixels || (z === this.mapped?.[0] && this.receiver === this.mapped?.[1])) return;
      this.mapped = [z, this.receiver];
      for (const side of this.sides) await side.showMap(z, this.receiver).catch((error) => this.say(error.message));
    }, 150);
    if (!this.drawn) {
      this.drawn = true;
      this.sides.forEach((side) => side.room?.setTransmitter(this.tx));
      this.world(this.tx).forEach((v, k) => (this.root.querySelector(`[data-tx="${k}"]`).value = v.toFixed(2)));
      this.find("height").value = this.world(this.tx)[2];
      await this.reloadGaussians();
      for (const side of this.sides) await side.showCurve();
    }
  }

  /** Measurement of a link, cached. */
  async truth(side, link) {
    const key = `${side} ${link}`;
    if (!this.truths.has(key)) {
      if (this.truths.size > 200) this.truths.clear();
      this.truths.set(key, await this.source.link(side, link));
    }
    return this.truths.get(key);
  }

  /** Description of a prediction. */
  sentence({ note, has }, truth) {
    const degrees = (pair) => pair && pair.map((v) => `${Math.round(v)}°`).join(" / ").replace(/-/g, "−");
    const parts = [];
    if (isExtrapolation(note)) {
      const { metres, limit } = note.training;
      parts.push(`Extrapolation: ${metres.toFixed(2)} m from the nearest training position, limit ${limit.toFixed(2)} m`);
    }
    if (note.nearest) {
      const { score, link, metres, part, fitted } = note.nearest;
      const value = Number.isFinite(score) ? chartNumber(Number(score.toFixed(3))) : "n/a";
      const scored = fitted ? "not scored: the baseline was fitted to" : `${this.note.score.name} ${value} against`;
      parts.push(`${scored} sample ${this.ids[link]} (${PART_NAMES[part]}), ${metres.toFixed(2)} m away`);
      if (link === this.median) parts.push("median of the test set");
    }
    if (note.strongest) {
      const other = truth?.note.strongest ? ` (${this.note.simulated ? "simulated" : "measured"} ${degrees(truth.note.strongest)})` : "";
      parts.push(`strongest at ${degrees(note.strongest)}${other}`);
    }
    if (has("deviation")) parts.push(`mean spread ${note.spread.toFixed(3)}`);
    if (note.ms !== null) parts.push(`latency ${note.ms.toFixed(2)} ms`);
    return parts.join(" · ");
  }

  say(text) {
    this.find("said").textContent = text;
    if (this.note === undefined) {
      this.root.hidden = false;
      this.find("title").textContent = text;
    }
  }

  /** Handles an event of a run in progress. */
  async hear(news) {
    const side = this.sides[news.side];
    if (!side) return;
    if (news.changed) {
      this.known = await this.source.room();
      this.abouts = this.note.sides = this.known.note.sides;
      this.sides.forEach((own, k) => Object.assign(own, { about: this.abouts[k], hasLocated: false }));
      this.removeLocated();
      this.offerSnapshots();
      this.offerColours();
      await this.reloadGaussians();
      await this.refresh();
    }
    side.about.running = !news.finished;
    await side.showCurve();
    const of = news.steps ? ` of ${news.steps.toLocaleString("en")}` : "";
    const state = news.finished ? "finished" : `step ${news.step?.toLocaleString("en") ?? 0}${of}, N = ${news.gaussians ?? "?"}, loss ${news.loss?.toPrecision(3) ?? "?"}`;
    side.find("name").textContent = `${side.about.name}: ${state}`;
  }

  setTheme() {
    const style = getComputedStyle(this.root);
    const rgb = (name) => {
      const hex = style.getPropertyValue(name).trim();
      const full = hex.length === 4 ? [...hex.slice(1)].map((c) => c + c).join("") : hex.slice(1);
      return [0, 2, 4].map((k) => parseInt(full.slice(k, k + 2), 16) / 255);
    };
    this.ink = style.getPropertyValue("--stage-ink").trim();
    this.sides.forEach((side) => side.room?.setTheme({ background: rgb("--stage-paper"), ink: rgb("--stage-ink") }));
    this.sides.filter((side) => side.located).forEach((side) => side.drawLocated());
    if (this.drawn) this.refresh();
  }
}

/** Starts the stage of a page that `pwrfgs view` serves. */
function startServed() {
  const main = document.querySelector("[data-source=server]");
  if (!main) return;
  const stage = new Stage(main.querySelector("[data-stage]"), new ServerSource());
  main.stage = stage;
  stage.start().catch((error) => stage.say(error.message));
}

startServed();
