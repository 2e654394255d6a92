"use strict";

/* What `payload.py` packed, and how it is thinned to the width of a screen: what is short stays visible. */

const data = JSON.parse(document.getElementById("data").textContent);
const KINDS = ["untouched", "denoised", "repaired", "filled", "unknown"];
const [UNTOUCHED, DENOISED, REPAIRED, FILLED, UNKNOWN] = KINDS.keys();
const STEP = 1e-4, MISSING = -(2 ** 31);
const series = {};

/* The series (frame, column) that `pack` took, flat, NaN where it was not finite. */
async function unpack(text, columns, step = STEP) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / 4, values = new Float32Array(count), sums = new Int32Array(columns);
  for (let k = 0; k < count; k++) {
    const change = planes[k] | (planes[count + k] << 8) | (planes[2 * count + k] << 16) | (planes[3 * count + k] << 24);
    const sum = (sums[k % columns] + change) | 0;  // wraps, as the differences did
    sums[k % columns] = sum;
    values[k] = sum === MISSING ? NaN : sum * step;
  }
  return values;
}

async function unpackAll() {
  const joints = data.names.length;
  const columns = { uncertainty: joints, changed: joints, extent: joints, slide: data.feet.length };
  for (const [name, text] of Object.entries(data.series)) {
    series[name] = await unpack(text, columns[name] ?? 3 * joints, name === "changed" ? 1 : STEP);
  }
}

/* Place of a joint in a drawn frame. */
function place(clip, index, joint) {
  const at = 3 * (index * data.names.length + joint);
  return [clip[at], clip[at + 1], clip[at + 2]];
}

function boneLength(clip, index, bone) {
  const [a, b] = data.edges[bone].map((joint) => place(clip, index, joint));
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/* [start, stop) of at most `limit` bins of the drawn frames [first, last). */
function bins(first, last, limit) {
  const size = Math.max(1, (last - first) / limit), count = Math.ceil((last - first) / size - 1e-9);
  const edge = (k) => Math.min(last, first + Math.round(k * size));
  return Array.from({ length: count }, (_, k) => [edge(k), edge(k + 1)]);
}

/* The index in [start, stop) where `value` is largest; -1 where it is NaN throughout. */
function largest(value, start, stop) {
  let best = -1;
  for (let index = start; index < stop; index++) {
    if (!Number.isNaN(value(index)) && (best < 0 || value(index) > value(best))) best = index;
  }
  return best;
}

/* A curve through the lowest and the highest value of each bin, broken where a bin has none. */
function curve(value, first, last, limit = 800) {
  const x = [], y = [];
  for (const [start, stop] of bins(first, last, limit)) {
    const high = largest(value, start, stop), low = largest((index) => -value(index), start, stop);
    for (const index of high < 0 ? [start] : [...new Set([Math.min(low, high), Math.max(low, high)])]) {
      x.push(data.shown[index]);
      y.push(high < 0 ? null : value(index));
    }
  }
  return { x, y };
}

/* Names as plotly shows them: it would take tags for markup. */
function plain(text) {
  return text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

/* The end of a name, which tells more than its beginning: mixamorig:LeftHandThumb4. */
function shortened(name, letters = 18) {
  const own = name.slice(name.lastIndexOf(":") + 1) || name;
  return plain(own.length > letters ? "…" + own.slice(1 - letters) : own);
}

/* A length in metres for people. */
function millimetres(metres) {
  return metres < 0.01 ? `${(1000 * metres).toFixed(1)} mm` : `${(1000 * metres).toFixed(0)} mm`;
}

/* What happened to a sample, in words. */
function happened(index, joint) {
  const at = index * data.names.length + joint, kind = series.changed[at], far = series.extent[at];
  const how = { [DENOISED]: `moved ${millimetres(far)}`, [REPAIRED]: `moved ${millimetres(far)}` };
  if (kind === FILLED && far > 0) how[FILLED] = `± ${millimetres(far)}`;
  return [KINDS[kind], how[kind]].filter(Boolean).join(", ");
}
