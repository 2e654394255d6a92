"use strict";

/* The charts over time. They share one stretch of frames and one pair of margins, so a frame is at one place in all. */

const LEFT = 150, RIGHT = 16, FONT = 'Inter, system-ui, "Segoe UI", Roboto, Arial, sans-serif';
/* From the kind of a change up to, not including, the next kind: how far it went. */
const STOPS = [0, 0.75, 0.9999];
const SCALE = data.shades.flatMap((shades, kind) => shades.map((shade, k) => [(kind + STOPS[k]) / 5, shade]));
SCALE[SCALE.length - 1][0] = 1;
const SLIDING = 0.3;  // metres a second, and above
const full = [];

function chart(id) {
  const frame = document.getElementById(id);
  if (!frame.firstChild) {
    const plot = document.createElement("div"), cursor = document.createElement("div");
    cursor.className = "cursor";
    frame.append(plot, cursor);
  }
  return frame.firstChild;
}

function span() {
  const half = data.size / 2;
  return [data.shown[view.first] - half, data.shown[view.last - 1] + half];
}

function draw(id, drawn, height, layout) {
  const plot = chart(id), fresh = !plot.data;
  const xaxis = { range: span(), title: { text: "frame", standoff: 4 }, showgrid: false, zeroline: false };
  const base = {
    height, margin: { l: LEFT, r: RIGHT, t: 8, b: 40 }, font: { family: FONT, size: 12, color: "#3a4754" },
    showlegend: false, dragmode: "zoom", hovermode: "closest", plot_bgcolor: "#fff", paper_bgcolor: "#fff",
    hoverlabel: { bgcolor: "#16202c", font: { color: "#fff" }, align: "left" },
  };
  Plotly.react(plot, drawn, { ...base, ...layout, xaxis: { ...xaxis, ...layout.xaxis } }, {
    displayModeBar: false, responsive: true, doubleClick: false,
  });
  if (!fresh) return;
  plot.on("plotly_relayout", (change) => {
    const from = change["xaxis.range[0]"], to = change["xaxis.range[1]"];
    if (from !== undefined) zoom(from, to);
  });
  plot.on("plotly_doubleclick", () => zoom(-Infinity, Infinity));
  plot.on("plotly_click", ({ points: [point] }) => {
    if (id === "changes") show(point.customdata, point.y);
    else show(indexOf(point.x));
  });
}

const horizontal = { fixedrange: true, zeroline: false, gridcolor: "#eef1f4" };

/* How far a change of each kind goes at most, nearly: what the darkest shade stands for. */
function measureChanges() {
  const far = KINDS.map(() => []);
  series.changed.forEach((kind, at) => far[kind].push(series.extent[at]));
  full.push(...far.map((values) => quantile(values, 0.98) || 1));
}

function graveness(index, joint) {
  const at = index * data.names.length + joint, kind = series.changed[at];
  return kind + Math.min(0.999, series.extent[at] / full[kind]) * (kind !== UNTOUCHED && kind !== UNKNOWN);
}

function drawChanges() {
  const z = [], text = [], worst = [], parts = bins(view.first, view.last, 560);
  data.names.forEach((name, joint) => {
    const at = parts.map(([start, stop]) => largest((index) => graveness(index, joint), start, stop));
    worst.push(at);
    z.push(at.map((index) => graveness(index, joint)));
    text.push(at.map((index) => `<b>${plain(name)}</b>, frame ${data.shown[index]}<br>${happened(index, joint)}`));
  });
  const row = Math.max(7, Math.min(18, 900 / data.names.length)), every = Math.ceil(11 / row);
  const labelled = data.names.map((_, joint) => joint).filter((joint) => joint % every === 0);
  const [from, to] = span(), wide = (to - from) / parts.length;
  const trace = {
    type: "heatmap", z, text, customdata: worst, x0: from + wide / 2, dx: wide, zmin: 0, zmax: 5, colorscale: SCALE,
    showscale: false, hovertemplate: "%{text}<extra></extra>", ygap: row > 10 ? 1 : 0,
  };
  const yaxis = {
    ...horizontal, showgrid: false, tickvals: labelled, ticktext: labelled.map((joint) => shortened(data.names[joint])),
    range: [data.names.length - 0.5, -0.5],
  };
  draw("changes", [trace], row * data.names.length + 48, { yaxis });
}

const look = (colour, width) => ({ color: colour, width });
const marked = () => (view.last - view.first <= 400 ? "lines+markers" : "lines");

/* Curves of the clips; the axis keeps to what was recovered, so that a spike does not flatten everything. */
function compared(value, room, axis) {
  const drawn = [], heights = [];
  for (const name of ["input", "truth", "recovered"].filter((each) => series[each])) {
    const { x, y } = curve(value(series[name]), view.first, view.last);
    const line = look(CLIPS[name], name === "input" ? 1 : 2), marker = { size: name === "input" ? 4 : 3 };
    drawn.push({ x, y, name, mode: name === "input" ? marked() : "lines", line, marker, yaxis: axis, type: "scatter",
      hovertemplate: `${name}: %{y:.4f} m, frame %{x}<extra></extra>` });
    if (name === "recovered") heights.push(...y.filter((each) => each !== null));
  }
  const low = Math.min(...heights), high = Math.max(...heights), inputs = drawn[0].y.filter((each) => each !== null);
  const reach = [Math.max(low - room, Math.min(low, ...inputs)), Math.min(high + room, Math.max(high, ...inputs))];
  const pad = 0.06 * (reach[1] - reach[0]) + 5e-3;
  return { drawn, range: heights.length ? [reach[0] - pad, reach[1] + pad] : undefined };
}

function drawTrajectory() {
  const joint = view.joint, joints = data.names.length, drawn = [], layout = {};
  ["z", "y", "x"].forEach((name, k) => {
    const component = { x: 0, y: 1, z: 2 }[name], axis = k ? `y${k + 1}` : "y";
    const value = (clip) => (index) => clip[3 * (index * joints + joint) + component];
    const { drawn: curves, range } = compared(value, 0.3, axis);
    const deviation = (index) => (2 * series.uncertainty[index * joints + joint]) / Math.sqrt(3);
    const middle = value(series.recovered), x = [], low = [], high = [];
    for (const [start, stop] of bins(view.first, view.last, 800)) {
      const bottom = largest((index) => deviation(index) - middle(index), start, stop);
      const top = largest((index) => deviation(index) + middle(index), start, stop);
      if (top < 0) continue;
      x.push(data.shown[start]);
      low.push(middle(bottom) - deviation(bottom));
      high.push(middle(top) + deviation(top));
    }
    const edge = { x, mode: "lines", line: { width: 0 }, yaxis: axis, hoverinfo: "skip", type: "scatter" };
    drawn.push({ ...edge, y: low }, { ...edge, y: high, fill: "tonexty", fillcolor: "rgba(0,114,178,.22)" }, ...curves);
    layout[k ? `yaxis${k + 1}` : "yaxis"] = {
      ...horizontal, range, domain: [k / 3 + 0.02, (k + 1) / 3 - 0.02], title: { text: `${name}, metres` },
    };
  });
  draw("trajectory", drawn, 480, { ...layout, xaxis: { anchor: "y" } });
}

function drawBones() {
  if (!data.edges.length) return;
  const bone = view.bone, value = (clip) => (index) => boneLength(clip, index, bone);
  const { drawn, range } = compared(value, 0.25, "y");
  const length = data.lengths[bone], [low, high] = data.intervals[bone], [from, to] = span();
  const shapes = [];
  const wide = { x0: from, x1: to, layer: "below" };
  const dotted = { ...look("#222", 1), dash: "dot" }, shade = { line: { width: 0 }, fillcolor: "rgba(0,0,0,.1)" };
  if (length !== null) shapes.push({ ...wide, type: "line", y0: length, y1: length, line: dotted });
  if (low !== null) shapes.push({ ...wide, type: "rect", y0: low, y1: high, ...shade });
  draw("bones", drawn, 260, { yaxis: { ...horizontal, range, title: { text: "metres" } }, shapes });
}

function drawFeet() {
  const count = data.feet.length;
  if (!count) return;
  const parts = bins(view.first, view.last, 560), [from, to] = span(), wide = (to - from) / parts.length;
  const z = data.feet.map((_, foot) => parts.map(([start, stop]) => {
    const speed = (index) => series.slide[index * count + foot];
    const most = speed(largest(speed, start, stop));
    return most < 0 ? null : most;
  }));
  const trace = {
    type: "heatmap", z, x0: from + wide / 2, dx: wide, zmin: 0, zmax: SLIDING, ygap: 4, hoverongaps: false,
    colorscale: [[0, "#1f4e79"], [0.35, "#56b4e9"], [0.7, "#f0c75e"], [1, "#d55e00"]],
    showscale: false,
    hovertemplate: "frame %{x:.0f}: slides %{z:.2f} m/s<extra></extra>",
  };
  const names = data.feet.map((foot) => shortened(data.names[foot.joint]));
  const yaxis = {
    ...horizontal, showgrid: false, tickvals: [...names.keys()], ticktext: names, range: [count - 0.5, -0.5],
  };
  draw("feet", [trace], 26 * count + 48, { yaxis });
}

function moveCursors() {
  const [from, to] = span(), share = (data.shown[view.index] - from) / (to - from);
  for (const cursor of document.querySelectorAll(".cursor")) {
    cursor.style.display = share < 0 || share > 1 ? "none" : "";
    cursor.style.left = `${LEFT + share * (cursor.parentElement.clientWidth - LEFT - RIGHT)}px`;
  }
}
