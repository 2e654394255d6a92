"use strict";

/* What the reader looks at, and what moves it: slider, play, moments, menus, zoom. */

const view = { index: 0, first: 0, last: data.shown.length, joint: 0, bone: 0, playing: null };
const element = (id) => document.getElementById(id);

const seconds = (frame) => `${(frame / data.fps).toFixed(2)} s`;

/* The drawn frame that stands for a frame. */
function indexOf(frame) {
  return Math.max(0, Math.min(data.shown.length - 1, Math.floor(frame / data.size)));
}

/* Goes to a drawn frame and, if one is given, to a joint. */
function show(index, joint) {
  view.index = index;
  const frame = data.shown[index];
  element("slider").value = index;
  element("now").textContent = `frame ${frame} · ${seconds(frame)}`;
  for (const button of document.querySelectorAll("#moments button")) {
    button.parentElement.classList.toggle("here", Number(button.dataset.frame) === frame);
  }
  if (index < view.first || index >= view.last) zoom(-Infinity, Infinity);
  moveCursors();
  if (joint !== undefined && joint !== view.joint) chooseJoint(joint);
  return showPose(index);
}

function chooseJoint(joint) {
  view.joint = joint;
  element("joint").value = joint;
  drawTrajectory();
}

/* Shows the frames from `from` to `to` in all charts over time. */
function zoom(from, to) {
  const first = indexOf(Math.max(0, from)), last = indexOf(Math.min(data.frames, to)) + 1;
  [view.first, view.last] = last - first < 4 ? [0, data.shown.length] : [first, last];
  drawChanges();
  drawTrajectory();
  drawBones();
  drawFeet();
  moveCursors();
}

function play(on) {
  view.playing = on ? { since: performance.now(), from: view.index === data.shown.length - 1 ? 0 : view.index } : null;
  element("play").textContent = on ? "Pause" : "Play";
  if (on) requestAnimationFrame(tick);
}

/* In step with the clock: frames are left out where the browser is slower than the clip. */
async function tick(now) {
  if (!view.playing) return;
  const passed = Math.max(0, (now - view.playing.since) / 1000) * Number(element("speed").value);
  const index = view.playing.from + Math.floor((passed * data.fps) / data.size);
  if (index !== view.index) await show(Math.min(index, data.shown.length - 1));
  if (index >= data.shown.length - 1) play(false);
  else requestAnimationFrame(tick);
}

function fill(select, order, names, change) {
  for (const k of order) select.append(new Option(names[k], k));
  select.addEventListener("change", () => change(Number(select.value)));
}

/* Bones whose measured length strays most from the length used come first. */
function bonesByError() {
  const worst = data.edges.map((_, bone) => {
    let sum = 0;
    for (let index = 0; index < data.shown.length; index++) {
      sum += Math.abs(boneLength(series.input, index, bone) - data.lengths[bone]) || 0;
    }
    return sum;
  });
  return [...worst.keys()].sort((a, b) => worst[b] - worst[a]);
}

async function start() {
  await unpackAll();
  const slider = element("slider"), bones = bonesByError(), firstMoment = document.querySelector("#moments button");
  slider.max = data.shown.length - 1;
  view.joint = Number(firstMoment?.dataset.joint ?? 0);
  view.bone = bones[0];
  measureStage();
  measureChanges();
  fill(element("joint"), data.names.keys(), data.names, chooseJoint);
  fill(element("bone"), bones, data.bones, (bone) => {
    view.bone = bone;
    drawBones();
  });
  element("joint").value = view.joint;
  element("lengths").hidden = !bones.length;
  for (const button of document.querySelectorAll("button[data-frame]")) {
    const time = document.createElement("small");
    time.textContent = seconds(button.dataset.frame);
    button.append(time);
  }
  addClipBoxes();
  await drawScene(0);
  zoom(-Infinity, Infinity);
  slider.addEventListener("input", () => {
    play(false);
    show(Number(slider.value));
  });
  element("play").addEventListener("click", () => play(!view.playing));
  element("speed").addEventListener("change", () => view.playing && play(true));
  document.addEventListener("click", ({ target }) => {
    const button = target.closest("button[data-frame]");
    if (!button) return;
    play(false);
    show(indexOf(Number(button.dataset.frame)), Number(button.dataset.joint));
  });
  document.addEventListener("keydown", (event) => {
    if (event.target.closest("select, input, button") && event.target !== slider) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === " ") play(!view.playing);
    else if (step && event.target !== slider) {
      play(false);
      show(Math.max(0, Math.min(data.shown.length - 1, view.index + step)));
    } else return;
    event.preventDefault();
  });
  window.addEventListener("resize", moveCursors);
  await show(firstMoment ? indexOf(Number(firstMoment.dataset.frame)) : 0);
  document.body.dataset.ready = "yes";
}

start().catch((error) => {
  element("skeletons").textContent = `This browser cannot draw the report: ${error}`;
  throw error;
});
