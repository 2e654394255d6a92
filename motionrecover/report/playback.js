"use strict";

/* The skeletons in space, followed as they go; a floor of half-metre squares shows that they do. */

const CLIPS = { input: "#e69f00", recovered: "#0072b2", truth: "#222222" };
const JOINT_COLOURS = [CLIPS.recovered, CLIPS.recovered, ...data.shades.slice(REPAIRED).map((shades) => shades[1])];
const WIDTHS = { input: 4, recovered: 8, truth: 3 }, SIZES = { input: 3, recovered: 5, truth: 2 };
const SQUARE = 0.5, EYE = { x: 0.62, y: 0.3, z: 1.14 };
const scene = document.getElementById("skeletons");
const stage = { centre: [], floor: 0, reach: 1, height: 1, apart: false };

function quantile(values, share) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b);
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : 0;
}

/* The body's middle over the ground, smoothed over a second, and the box in which the body moves about it. */
function measureStage() {
  const clip = series.recovered, joints = data.names.length, frames = data.shown.length;
  const middle = [], reaches = [], lows = [], highs = [];
  for (let index = 0; index < frames; index++) {
    const points = Array.from({ length: joints }, (_, joint) => place(clip, index, joint)).filter((p) => p[0] === p[0]);
    const last = middle.at(-1) ?? [0, 0];
    middle.push(points.length ? [0, 2].map((axis) => points.reduce((s, p) => s + p[axis], 0) / points.length) : last);
    const [x, z] = middle[index];
    if (!points.length) continue;
    reaches.push(Math.max(...points.map((p) => Math.hypot(p[0] - x, p[2] - z))));
    lows.push(Math.min(...points.map((p) => p[1])));
    highs.push(Math.max(...points.map((p) => p[1])));
  }
  const half = Math.round(data.fps / data.size / 2);
  const sums = [[0, 0]];
  for (const [x, z] of middle) sums.push([sums.at(-1)[0] + x, sums.at(-1)[1] + z]);
  stage.centre = middle.map((_, index) => {
    const a = Math.max(0, index - half), b = Math.min(frames, index + half + 1);
    return [0, 1].map((axis) => (sums[b][axis] - sums[a][axis]) / (b - a));
  });
  stage.floor = quantile(lows, 0.02);
  stage.reach = 1.25 * quantile(reaches, 0.995) || 1;
  stage.height = 1.1 * (quantile(highs, 0.995) - stage.floor) || 1;
}

/* Coordinates of a clip's bones, as one broken line, and of its joints. */
function pose(name, index) {
  const [cx, cz] = stage.centre[index], clip = series[name];
  const aside = !stage.apart ? 0 : name === "input" ? -stage.reach * 0.7 : stage.reach * 0.7;
  const points = data.names.map((_, joint) => {
    const [x, y, z] = place(clip, index, joint);
    return [x - cx + aside, y, z - cz];
  });
  const lines = data.edges.flatMap(([i, j]) => [points[i], points[j], [null, null, null]]);
  return { lines, points };
}

/* Lines of a floor that stays in place while the body walks over it. */
function ground(index) {
  const [cx, cz] = stage.centre[index], lines = [], reach = Math.ceil(2.5 * stage.reach), y = stage.floor;
  const past = (c) => c - Math.floor(c / SQUARE) * SQUARE;
  for (let k = -reach; k <= reach; k += SQUARE) {
    const x = k - past(cx), z = k - past(cz);
    lines.push([x, y, -reach], [x, y, reach], [null, null, null], [-reach, y, z], [reach, y, z], [null, null, null]);
  }
  return lines;
}

const axes = (points) => [0, 1, 2].map((axis) => points.map((point) => point[axis]));

/* All traces of a frame: their coordinates, and the colours and texts of the recovered joints. */
function traces(index) {
  const parts = [ground(index)];
  for (const name of Object.keys(CLIPS).filter((each) => series[each])) {
    const { lines, points } = pose(name, index);
    parts.push(lines, points);
  }
  const joints = data.names.length, at = index * joints;
  return {
    parts: parts.map(axes),
    colours: data.names.map((_, joint) => JOINT_COLOURS[series.changed[at + joint]]),
    texts: data.names.map((name, joint) => `${plain(name)}: ${happened(index, joint)}`),
  };
}

/* The axes: equal scales, and floor around the body. */
function room() {
  const wide = stage.reach * (stage.apart ? 2.2 : 1.5), deep = stage.reach * 1.5;
  const unit = Math.max(stage.height / 2, stage.reach * (stage.apart ? 1.1 : 0.8));
  const axis = (low, high) => ({ range: [low, high], visible: false });
  return {
    xaxis: axis(-wide, wide),
    yaxis: axis(stage.floor - 0.02, stage.floor + stage.height),
    zaxis: axis(-deep, deep),
    aspectmode: "manual",
    aspectratio: { x: wide / unit, y: stage.height / 2 / unit, z: deep / unit },
  };
}

function drawScene(index) {
  const { parts, colours, texts } = traces(index);
  const names = ["ground", ...Object.keys(CLIPS).filter((name) => series[name]).flatMap((name) => [name, name])];
  const drawn = parts.map(([x, y, z], k) => {
    const name = names[k], bones = k % 2 === 1;
    const trace = { type: "scatter3d", name, x, y, z, mode: bones || !k ? "lines" : "markers", hoverinfo: "skip" };
    if (!k) return { ...trace, line: { color: "#d5dce3", width: 1.5 } };
    if (bones) return { ...trace, line: { color: CLIPS[name], width: WIDTHS[name] }, connectgaps: false };
    const marker = { color: name === "recovered" ? colours : CLIPS[name], size: SIZES[name], opacity: 1 };
    return { ...trace, marker, hoverinfo: "text", text: name === "recovered" ? texts : data.names.map(plain) };
  });
  const camera = { up: { x: 0, y: 1, z: 0 }, eye: EYE, center: { x: 0, y: -0.05, z: 0 } };
  const layout = { scene: { ...room(), camera }, margin: { l: 0, r: 0, t: 0, b: 0 }, showlegend: false };
  return Plotly.newPlot(scene, drawn, layout, { displaylogo: false, responsive: true, displayModeBar: false });
}

function showPose(index) {
  const { parts, colours, texts } = traces(index);
  const [x, y, z] = [0, 1, 2].map((axis) => parts.map((part) => part[axis]));
  const which = [...parts.keys()], joints = 4;  // ground, input's bones and joints, recovered bones, recovered joints
  const colour = which.map((k) => (k === joints ? colours : scene.data[k].marker?.color));
  const text = which.map((k) => (k === joints ? texts : scene.data[k].text));
  return Plotly.restyle(scene, { x, y, z, "marker.color": colour, text }, which);
}

/* Boxes to show and hide the clips, or to set them side by side. */
function addClipBoxes() {
  const row = document.getElementById("clips");
  const box = (label, checked, colour, change) => {
    const line = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "checkbox", checked });
    input.addEventListener("change", () => change(input.checked));
    line.append(input);
    if (colour) line.append(Object.assign(document.createElement("i"), { style: `background:${colour}` }));
    line.append(label);
    row.append(line);
  };
  for (const name of Object.keys(CLIPS).filter((each) => series[each])) {
    box(name, true, CLIPS[name], (visible) => {
      const which = [...scene.data.keys()].filter((k) => scene.data[k].name === name);
      Plotly.restyle(scene, { visible }, which);
    });
  }
  box("side by side", false, null, (checked) => {
    stage.apart = checked;
    const { xaxis, aspectratio } = room(), eye = checked ? { x: 0, y: 0.3, z: 1.45 } : EYE;
    const change = { "scene.xaxis": xaxis, "scene.aspectratio": aspectratio, "scene.camera.eye": eye };
    Plotly.relayout(scene, change).then(() => showPose(view.index));
  });
  for (const kind of [REPAIRED, FILLED]) {
    const key = document.createElement("span"), dot = document.createElement("i");
    dot.className = "dot";
    dot.style.background = JOINT_COLOURS[kind];
    key.append(dot, `${KINDS[kind]} joint`);
    row.append(key);
  }
}
