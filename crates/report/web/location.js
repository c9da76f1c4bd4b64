/*
 * A located sample in the room: density over the floor, outline of the 90 % region, estimate and true position.
 * The transmitter marks the true position.
 */

/** Sizes and colours of the diamond of the estimate: white with a dark rim, which is visible on every density. */
const ESTIMATE_MARKS = [["estimate-rim", 25, [20, 20, 20]], ["estimate", 20, [255, 255, 255]]];
/** Opacity of the highest density. */
const HEAT_ALPHA = 215;
/** Density below which a cell is not drawn, relative to the highest. */
const HEAT_LEAST = 1e-3;

/** Draws an answer of the route `locate`, or removes it; `rgb` returns the colour of a value from 0 to 255. */
export function drawLocation(room, found, { origin, rgb }) {
  const local = found && ((place) => place.map((v, k) => v - origin[k]));
  const [estimate, truth] = found ? [local(found.note.estimate), local(found.note.truth)] : [null, null];
  const { region } = found?.note ?? {};
  room.setTriangles("density", region ? heatMesh(found, truth[2], local, rgb) : null);
  const ink = [...room.ground.ink.map((v) => Math.round(255 * v)), 255];
  const flat = region?.outlines.map((outline) => outline.map((place) => [...local(place), truth[2]]));
  room.setLines("region", region ? { ...closedLines(flat, ink), onTop: true } : null);
  const foot = found && [estimate[0], estimate[1], truth[2]];
  room.setLines("error", found && { ...closedLines([[truth, foot], [foot, estimate]], ink), onTop: true });
  for (const [name, size, colour] of ESTIMATE_MARKS) {
    const colours = new Uint8Array([...colour, 255]);
    room.setPoints(name, found && { positions: new Float32Array(estimate), colours, size, shape: "diamond", pickable: false, onTop: true });
  }
}

/** Two triangles per cell of the density, at height `z`. Colour and opacity are those of its root, as in pictures of `locate`. */
function heatMesh(found, z, local, rgb) {
  const [values, [, columns]] = [found.get("density"), found.shape("density")];
  const { first, step } = found.note.region;
  const most = values.reduce((a, b) => Math.max(a, b), 1e-12);
  const shown = Array.from(values.keys()).filter((k) => values[k] >= HEAT_LEAST * most);
  const mesh = { positions: new Float32Array(18 * shown.length), colours: new Uint8Array(8 * shown.length), onTop: true };
  shown.forEach((k, i) => {
    const root = Math.sqrt(values[k] / most);
    const [x, y] = local([first[0] + step * ((k % columns) - 0.5), first[1] + step * (Math.floor(k / columns) - 0.5)]);
    const [u, v] = [x + step, y + step];
    mesh.positions.set([x, y, z, u, y, z, u, v, z, x, y, z, u, v, z, x, v, z], 18 * i);
    const colour = [...rgb(Math.round(255 * root)), Math.round(HEAT_ALPHA * root)];
    mesh.colours.set([...colour, ...colour], 8 * i);
  });
  return mesh;
}

/** Lines of one colour along closed outlines of corners [x, y, z]. */
function closedLines(outlines, colour) {
  const ends = outlines.flatMap((outline) => outline.flatMap((from, k) => [...from, ...outline[(k + 1) % outline.length]]));
  return { positions: new Float32Array(ends), colours: new Uint8Array(Array(ends.length / 6).fill(colour).flat()) };
}

/** Result in one line. */
export function locationSentence({ error_m: error, misfit, part, left_out, no_region, region }, number) {
  const parts = [`Located ${number(error)} m from the true position`];
  if (region) {
    const count = region.parts > 1 ? ` in ${region.parts} parts` : "";
    parts.push(`90 % region of ${number(region.area_m2)} m²${count}, ${region.holds ? "holds" : "misses"} the true position`);
  }
  parts.push(`misfit ${misfit === null ? "infinite" : number(misfit)} (1: typical sample)`);
  if (left_out) parts.push("training sample, compared without its own fingerprint");
  else if (part === 1) parts.push("validation sample, used to choose the settings");
  if (no_region) parts.push(no_region);
  return parts.join(" · ");
}

/** View of the room that shows region, estimate and true position; `view` has the direction. */
export function closerView(view, { estimate, truth, region }, origin) {
  const flat = [estimate, truth, ...(region?.outlines ?? []).flat()];
  const ends = [0, 1].map((k) => [Math.min(...flat.map((p) => p[k])), Math.max(...flat.map((p) => p[k]))]);
  const target = [...ends.map(([low, high], k) => (low + high) / 2 - origin[k]), truth[2] - origin[2]];
  const extent = Math.max(0.02, Math.hypot(...ends.map(([low, high]) => high - low), estimate[2] - truth[2]));
  return { ...view, target, distance: 2 * extent };
}
