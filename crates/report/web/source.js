import { readTensors } from "./tensors.js";
import { Predictor } from "./predict.js";
import { structuralSimilarity } from "./ssim.js";
import { strongestPixel } from "./spectrum.js";

/** Data of a page from the server of `pwrfgs view`. Positions are metres in the world frame. */
export class ServerSource {
  constructor() {
    this.free = true;
  }

  async fetch(path, asked = {}) {
    const query = Object.entries(asked).filter(([, value]) => value !== null && value !== undefined);
    const text = query.map(([name, value]) => `${name}=${value}`).join("&");
    const answer = await fetch(text ? `${path}?${text}` : path);
    if (!answer.ok) throw new Error((await answer.text()).trim());
    return readTensors(new Uint8Array(await answer.arrayBuffer()));
  }

  room() {
    return this.fetch("room");
  }

  gaussians(side, { snapshot, tx, receiver, contribution }) {
    return this.fetch("gaussians", { side, snapshot, tx, receiver, with: contribution ? "contribution" : null });
  }

  predict(side, { tx, link, receiver }) {
    return this.fetch("predict", { side, tx, link, receiver });
  }

  link(side, link) {
    return this.fetch("link", { side, link });
  }

  map(side, z, receiver) {
    return this.fetch("map", { side, z, receiver });
  }

  /** Located position of a link's transmitter; the first answer of a side takes longest. */
  locate(side, link) {
    return this.fetch("locate", { side, link });
  }

  curve(side) {
    return this.fetch("curve", { side });
  }

  /** Reports events of runs in progress, and the end of the server. */
  listen(news, gone) {
    const events = new EventSource("events");
    events.onmessage = (event) => news(JSON.parse(event.data));
    events.onerror = () => gone();
  }
}

/** Data of a page from its own file (`report.html`). */
export class FileSource {
  constructor() {
    const bytes = (id) => {
      const text = document.getElementById(id)?.textContent;
      return text ? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)) : null;
    };
    this.packs = Object.fromEntries(["room", "gaussians", "observations", "model"].map((id) => [id, bytes(`live-${id}`)]));
    this.known = readTensors(this.packs.room);
    this.observations = readTensors(this.packs.observations);
    this.predictor = this.packs.model && new Predictor(readTensors(this.packs.model));
    this.free = Boolean(this.predictor);
    this.links = this.observations.note.links;
  }

  async room() {
    return this.known;
  }

  async gaussians(side, { tx }) {
    const all = (this.cloud ??= readTensors(this.packs.gaussians));
    if (!tx || !this.predictor) return all;
    const { strengths, scales, quats, opacities } = this.predictor.predict(tx);
    const own = { strengths, scales, quats, opacities };
    return { ...all, has: (name) => name in own || all.has(name), get: (name) => own[name] ?? all.get(name) };
  }

  async predict(side, { tx, link }) {
    const begun = performance.now();
    const { width, height } = this.known.note.plane;
    const nearest = link === null ? this.nearest(tx) : { link, metres: 0 };
    const picture = this.predictor ? this.predictor.predict(tx ?? this.position(link)).picture : this.stored("predicted", nearest.link);
    const note = { ms: this.predictor ? performance.now() - begun : null, strongest: this.direction(picture), nearest };
    const limit = this.known.note.sides[0].training_limit_m;
    const metres = (tx && this.predictor?.trainingDistance(tx)) ?? null;
    if (metres !== null && typeof limit === "number") note.training = { metres, limit };
    if (nearest) {
      const score = () => structuralSimilarity(picture, this.stored("truth", nearest.link), width, height);
      nearest.score = this.known.note.has_pixels ? score() : this.known.get("links.score")[nearest.link];
      nearest.part = this.known.get("links.part")[nearest.link];
    }
    return this.observation(note, picture);
  }

  async link(side, link) {
    const picture = this.stored("truth", link);
    return this.observation({ strongest: this.direction(picture) }, picture);
  }

  /** Arrays of one observation, as the server sends them. */
  observation(note, values) {
    const own = this.known.note.is_scalar ? "powers" : "picture";
    return { note, has: (name) => name === own, get: () => values };
  }

  listen() {}

  /** Observation in the page; grey values of an image from 0 to 1. */
  stored(name, link) {
    const values = this.observations.get(`${name}.${link}`);
    return this.known.note.has_pixels ? Float32Array.from(values, (byte) => byte / 255) : values;
  }

  position(link) {
    const at = this.known.get("links.tx");
    return [0, 1, 2].map((k) => at[3 * link + k] + this.known.note.origin[k]);
  }

  /** Nearest sample whose observation is in the page. */
  nearest(tx) {
    let best = null;
    for (const link of this.links) {
      const metres = Math.hypot(...this.position(link).map((v, k) => v - tx[k]));
      if (!best || metres < best.metres) best = { link, metres };
    }
    return best;
  }

  direction(picture) {
    const { angles, width } = this.known.note.plane;
    if (!angles) return null;
    const pixel = strongestPixel(picture);
    const [azimuth, elevation] = angles;
    const row = Math.floor(pixel / width);
    return [azimuth.first + azimuth.step * (pixel % width), elevation.first + elevation.step * row];
  }
}
