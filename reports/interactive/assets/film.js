// The film of a stream: the hypotheses of one person frame by frame, and how far the depth of a joint
// is known over time.

const data = JSON.parse(element("data").textContent);
if (data.in_world) {
  Object.assign(AXES, { z: "level z", x: "level x", front: "−z" });
  element("along").textContent = "Along the level axis z from the pelvis";
  element("front").textContent = "Front";
  element("told").textContent = "Place";
  element("lengths").textContent = "millimetres";
}
const body = { bones: data.bones, left: data.left };
const people = data.people.map((one) => ({
  ...one,
  poses: unpacked(one.poses, 45).map((row) => grouped(row, 3)), // frame by frame, k each
  bands: unpacked(one.bands, 15 * data.levels.length).map((row) => grouped(row, data.levels.length)),
  measures: unpacked(one.measures, data.measures.length * data.levels.length).map((row) => grouped(row, data.levels.length)),
}));
const state = { frame: 0, person: 0, joint: data.start, measure: 0, playing: null };
const scene = new Scene(element("scene"), body, sceneContent, choose, said);
const there = (pose) => Number.isFinite(pose[0][0]);

function sceneContent() {
  const one = people[state.person], first = state.frame * data.k;
  const bodies = one.poses.slice(first, first + data.k)
    .map((joints, rank) => ({ joints, words: `hypothesis ${rank + 1}`, colour: data.hypothesis_colours[rank], width: rank ? 2 : 3.4, edge: 2 }))
    .filter(({ joints }) => there(joints));
  return { bodies, lines: [], dots: null };
}

function said(one, joint) {
  return `${data.joints[joint]}: ${one.words}\n${placed(one.joints[joint])}`;
}

// --- bands over time

const BOX = { wide: 800, high: 220, left: 44, right: 792, base: 186, top: 8 };

// Stretches of frames that have a pose.
function stretches(rows) {
  const found = [];
  rows.forEach((row, frame) => {
    if (!Number.isFinite(row[0])) return;
    if (found.length && found.at(-1).at(-1) === frame - 1) found.at(-1).push(frame);
    else found.push([frame]);
  });
  return found;
}

function across(frame) {
  return BOX.left + (BOX.right - BOX.left) * frame / Math.max(1, data.frames.length - 1);
}

// Quantiles frame by frame, in a picture from low to high.
function paint(svg, rows, colour, low, high, digits) {
  const parts = stretches(rows), last = Math.max(1, data.frames.length - 1);
  const y = (value) => BOX.top + (BOX.base - BOX.top) * (high - value) / (high - low);
  svg.replaceChildren();
  for (const tick of ticks(low, high)) {
    svg.append(drawn("line", { x1: BOX.left, x2: BOX.right, y1: y(tick), y2: y(tick), stroke: tick ? "#EEEEEE" : "#AAAAAA" }));
    svg.append(drawn("text", { x: BOX.left - 5, y: y(tick) + 4, "text-anchor": "end" }, signed(tick, digits)));
  }
  for (const part of parts) {
    const wide = part.length > 1 ? part : [part[0] - 0.3, part[0] + 0.3];
    const at = (frame, number) => `${across(frame)},${y(rows[Math.round(frame)][number])}`;
    for (const [from, to, strength] of [[0, 4, 0.2], [1, 3, 0.4]])
      svg.append(drawn("polygon", { fill: colour, "fill-opacity": strength,
        points: [...wide.map((frame) => at(frame, to)), ...wide.toReversed().map((frame) => at(frame, from))].join(" ") }));
    svg.append(drawn("polyline", { fill: "none", stroke: colour, "stroke-width": 1.6, points: wide.map((frame) => at(frame, 2)).join(" ") }));
  }
  for (const tick of ticks(0, last)) if (Number.isInteger(tick))
    svg.append(drawn("text", { x: across(tick), y: BOX.base + 16, "text-anchor": "middle" }, tick));
  svg.append(drawn("text", { x: (BOX.left + BOX.right) / 2, y: BOX.high - 3, "text-anchor": "middle" }, "frame"));
  svg.append(drawn("line", { class: "now", x1: 0, x2: 0, y1: BOX.top, y2: BOX.base, stroke: "#222222" }));
}

function known(rows) {
  return stretches(rows).flat().flatMap((frame) => rows[frame]);
}

function paintBands() {
  const rows = people[state.person].bands.map((row) => row[state.joint]);
  const reach = Math.max(0.5, ...known(rows).map(Math.abs)) * 1.05;
  paint(element("bands"), rows, data.colours[state.joint], -reach, reach, 1);
  if (data.measures.length) paintMeasure();
  go(state.frame);
}

function paintMeasure() {
  const rows = people[state.person].measures.map((row) => row[state.measure]), all = known(rows);
  const low = Math.min(0, ...all), high = Math.max(low + 1, ...all), { colour, unit } = data.measures[state.measure];
  paint(element("measures"), rows, colour, low, high, unit === "degrees" ? 0 : 1);
}

// The frame at a place of the bands, in CSS pixels.
function frameAt(offset) {
  const last = data.frames.length - 1, place = offset / element("bands").clientWidth * BOX.wide;
  return Math.max(0, Math.min(last, Math.round(Math.max(1, last) * (place - BOX.left) / (BOX.right - BOX.left))));
}

// What is known of the chosen joint in a frame, or why there is no pose.
function depthOf(frame) {
  const { bands, words } = people[state.person], row = bands[frame][state.joint];
  return Number.isFinite(row[0])
    ? `${data.joints[state.joint]}: ${AXES.z} ${signed(row[2], 2)} body units, 90 % between ${signed(row[0], 2)} and ${signed(row[4], 2)}` : words[frame];
}

// What is known of the chosen measure in a frame, or why there is no pose.
function measureOf(frame) {
  const { measures, words } = people[state.person], { name, unit } = data.measures[state.measure];
  const row = measures[frame][state.measure], digits = unit === "degrees" ? 0 : 2;
  return Number.isFinite(row[0])
    ? `${name}: ${signed(row[2], digits)} ${unit}, 90 % between ${signed(row[0], digits)} and ${signed(row[4], digits)}` : words[frame];
}

// --- controls

function go(frame) {
  state.frame = Math.max(0, Math.min(data.frames.length - 1, frame));
  for (const now of document.querySelectorAll(".now")) {
    now.setAttribute("x1", across(state.frame));
    now.setAttribute("x2", across(state.frame));
  }
  element("frame").value = state.frame;
  element("frame").setAttribute("aria-valuetext", data.frames[state.frame]);
  element("frame-said").textContent = `${data.frames[state.frame]} (${state.frame + 1} of ${data.frames.length}) · ${depthOf(state.frame)}`;
  scene.sheet.refresh();
}

function choose(joint) {
  state.joint = joint;
  element("joint").value = joint;
  paintBands();
}

function play() {
  if (state.playing !== null) { clearInterval(state.playing); state.playing = null; }
  else {
    if (state.frame === data.frames.length - 1) go(0);
    state.playing = setInterval(() => {
      if (state.frame === data.frames.length - 1) play();
      else go(state.frame + 1);
    }, 1000 / Number(element("rate").value));
  }
  element("play").textContent = state.playing === null ? "Play" : "Stop";
  element("play").setAttribute("aria-pressed", state.playing !== null);
}

function choosePerson(person) {
  state.person = person;
  const poses = people[person].poses.filter(there);
  if (poses.length) scene.fit(poses);
  paintBands();
}

element("bands").addEventListener("click", (event) => go(frameAt(event.offsetX)));
connectTip(element("bands"), (x) => `${data.frames[frameAt(x)]}\n${depthOf(frameAt(x))}`);
element("measures").addEventListener("click", (event) => go(frameAt(event.offsetX)));
connectTip(element("measures"), (x) => `${data.frames[frameAt(x)]}\n${measureOf(frameAt(x))}`);
data.measures.forEach(({ name }, index) => element("measure").append(make("option", { value: index }, name)));
element("measure").addEventListener("change", () => { state.measure = Number(element("measure").value); paintBands(); });
element("measured").hidden = !data.measures.length;
element("frame").max = data.frames.length - 1;
element("frame").addEventListener("input", () => go(Number(element("frame").value)));
element("play").addEventListener("click", play);
element("rate").addEventListener("change", () => { if (state.playing !== null) { play(); play(); } });
data.people.forEach((one, index) => element("person").append(make("option", { value: index }, one.name)));
element("person").addEventListener("change", () => choosePerson(Number(element("person").value)));
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
  if (event.key === " ") { event.preventDefault(); play(); }
  if (event.key === "n") go(state.frame + 1);
  if (event.key === "p") go(state.frame - 1);
  if (event.key === "j") choose((state.joint + 1) % data.joints.length);
});

fillJoints(element("joint"), data.joints, state.joint, choose);
connectViews(scene);
state.frame = Math.max(0, people[0].bands.findIndex((row) => Number.isFinite(row[0][0])));
choosePerson(0);
