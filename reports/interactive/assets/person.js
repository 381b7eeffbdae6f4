// One person's posterior: the photo, the scene, and the marginals of the joint that is touched.

const data = JSON.parse(element("data").textContent);
const body = { bones: data.bones, left: data.left };
const draws = unpacked(data.draws, 45).map((row) => grouped(row, 3));
const projected = unpacked(data.projected, 30).map((row) => grouped(row, 2));
const RANDOM = 150; // draws shown at first; more of them make a grey block
const state = {
  joint: data.start,
  shown: new Set(data.hypotheses.keys()),
  draws: Math.min(RANDOM, draws.length),
  truth: data.truth !== null,
};

const scene = new Scene(element("scene"), body, sceneContent, choose, said);
const photo = new Sheet(element("photo"), paintPhoto);
const picture = data.photo ? new Image() : null;
let places = [], photographed = []; // joints of the photo in CSS pixels, for picking: detected ones, then bodies

function sceneContent() {
  const bodies = [...state.shown].sort((p, q) => p - q)
    .map((rank) => ({ ...data.hypotheses[rank], width: 3.2, edge: 2.5 }));
  if (state.truth) bodies.unshift({ joints: data.truth, words: "the true pose", colour: "#000000", width: 1.8, edge: 1.5, dashed: true });
  const dots = { points: draws.slice(0, state.draws).map((pose) => pose[state.joint]), colour: data.colours[state.joint] };
  return { bodies, lines: draws.slice(0, state.draws), dots };
}

function paintPhoto(pen, wide, high) {
  const [left, top, right, bottom] = data.window;
  const scale = Math.min(wide / (right - left), high / (bottom - top));
  const aside = (wide - scale * (right - left)) / 2;
  const at = ([u, v]) => [aside + scale * (u - left), scale * (v - top), 0];
  if (picture && picture.complete) {
    const [x0, y0] = at(data.photo.box), [x1, y1] = at(data.photo.box.slice(2));
    pen.globalAlpha = 0.75; pen.drawImage(picture, x0, y0, x1 - x0, y1 - y0); pen.globalAlpha = 1;
  }
  const dots = projected.slice(0, Math.max(state.draws, 1)).map((pose) => at(pose[state.joint]));
  drawDots(pen, dots, data.colours[state.joint], 2.6, 0.5);
  const points = data.detection.points.map((point) => point && at(point));
  points.forEach((point, joint) => {
    if (!point) return;
    pen.strokeStyle = data.colours[joint]; pen.lineWidth = 1;
    const radius = data.detection.radius[joint];
    if (radius !== null) {
      pen.beginPath(); pen.arc(point[0], point[1], scale * radius, 0, 2 * Math.PI);
      pen.globalAlpha = 0.15; pen.fillStyle = data.colours[joint]; pen.fill(); pen.globalAlpha = 1; pen.stroke();
    }
  });
  const bodies = [...state.shown].sort((p, q) => q - p)
    .map((rank) => ({ points: data.hypotheses[rank].projected.map(at), ...data.hypotheses[rank], width: 1.8, edge: 0.8 }));
  for (const one of bodies) drawBody(pen, one.points, one, body);
  points.forEach((point, joint) => {
    if (!point) return;
    pen.fillStyle = data.colours[joint]; pen.strokeStyle = "white"; pen.lineWidth = 1.2;
    pen.beginPath(); pen.arc(point[0], point[1], 4, 0, 2 * Math.PI); pen.fill(); pen.stroke();
  });
  places = [points, ...bodies.map((one) => one.points)];
  photographed = bodies;
}

function said(one, joint) {
  return `${data.joints[joint]}: ${one.words}\n${placed(one.joints[joint])}\nall draws: depth ${data.marginals.depth[joint].words}`;
}

function saidOfPhoto(x, y) {
  const found = nearest(places, x, y);
  if (!found) return "";
  if (found.rank) return said(photographed[found.rank - 1], found.joint);
  const [u, v] = data.detection.points[found.joint], radius = data.detection.radius[found.joint];
  const disc = radius === null ? "" : `, disc of ${radius.toFixed(1)} px`;
  return `${data.joints[found.joint]}: detected at ${u.toFixed(1)}, ${v.toFixed(1)} px${disc}`;
}

// --- marginals

const LABELS = {
  depth: ["Depth behind the pelvis", "← towards the camera, away →", (place) => place[2]],
  across: ["Across the image", "← left, right →", (place) => place[0]],
  height: ["Height above the pelvis", "← below, above →", (place) => -place[1]],
};
const BOX = { wide: 320, high: 130, left: 8, right: 312, base: 100, top: 10 };

function marginal(name) {
  const one = data.marginals[name][state.joint], [title, ends, along] = LABELS[name];
  const figure = make("figure", { class: "marginal", "data-axis": name });
  figure.append(make("h3", {}, title), make("p", {}, one.words));
  if (one.counts === null) return figure;
  const place = (value) => BOX.left + (BOX.right - BOX.left) * (value - one.low) / (one.high - one.low);
  const most = Math.max(...one.counts[0].map((count, bin) => count + one.counts[1][bin]));
  const tall = (count) => (BOX.base - BOX.top) * count / most;
  const svg = drawn("svg", { viewBox: `0 0 ${BOX.wide} ${BOX.high}`, role: "img", "aria-label": `${title}: ${one.words}` });
  const step = (one.high - one.low) / one.counts[0].length;
  one.counts[0].forEach((heavy, bin) => {
    const light = one.counts[1][bin], low = one.low + bin * step, x = place(low), width = place(one.low + step) - BOX.left;
    const bar = (count, below, style) => {
      const rect = drawn("rect", { x, width, y: BOX.base - tall(count + below), height: tall(count), ...style });
      rect.append(drawn("title", {}, `${signed(low, 2)} to ${signed(low + step, 2)}: ${heavy + light} draws`));
      svg.append(rect);
    };
    bar(heavy, 0, { fill: data.colours[state.joint], "fill-opacity": 0.6 });
    bar(light, heavy, { fill: "#9A9A9A" });
  });
  svg.append(drawn("line", { x1: place(one.interval[0]), x2: place(one.interval[1]), y1: BOX.base + 2, y2: BOX.base + 2, stroke: data.colours[state.joint], "stroke-width": 3 }));
  const line = (value, colour, dash) => svg.append(drawn("line", {
    x1: place(value), x2: place(value), y1: BOX.top - 6, y2: BOX.base, stroke: colour, "stroke-width": 2, "stroke-dasharray": dash }));
  for (const rank of state.shown) line(along(data.hypotheses[rank].joints[state.joint]), data.hypotheses[rank].colour, "none");
  if (state.truth) line(along(data.truth[state.joint]), "#000000", "4 3");
  for (const tick of ticks(one.low, one.high)) svg.append(drawn("text", { x: place(tick), y: BOX.base + 15, "text-anchor": "middle" }, signed(tick, tick % 1 ? 2 : 0)));
  svg.append(drawn("text", { x: BOX.wide / 2, y: BOX.high - 2, "text-anchor": "middle" }, `${ends} (body units)`));
  figure.append(svg);
  return figure;
}

// --- controls

function choose(joint) {
  state.joint = joint;
  element("joint").value = joint;
  refresh();
}

function refresh() {
  scene.sheet.refresh();
  photo.refresh();
  element("marginals").replaceChildren(...Object.keys(LABELS).map(marginal));
  element("single").textContent = state.shown.size === data.hypotheses.length ? "One by one" : "All together";
  document.querySelectorAll("#hypotheses button").forEach((button, rank) =>
    button.setAttribute("aria-pressed", state.shown.has(rank)));
}

// The next hypothesis alone; after the last one, all of them.
function step() {
  const count = data.hypotheses.length;
  const next = state.shown.size === 1 ? [...state.shown][0] + 1 : 0;
  state.shown = new Set(next < count ? [next] : data.hypotheses.keys());
  refresh();
}

function listHypotheses() {
  data.hypotheses.forEach((one, rank) => {
    const button = make("button", { type: "button" });
    const chip = make("span", { class: "chip" });
    chip.style.background = one.colour;
    button.append(chip, one.words);
    button.addEventListener("click", () => {
      if (!state.shown.delete(rank)) state.shown.add(rank);
      refresh();
    });
    const item = make("li");
    item.append(button);
    element("hypotheses").append(item);
  });
}

element("photo").addEventListener("click", (event) => {
  const found = nearest(places, event.offsetX, event.offsetY);
  if (found) choose(found.joint);
});
connectTip(element("photo"), saidOfPhoto);
element("draws").max = draws.length;
element("draws").value = state.draws;
element("draws").addEventListener("input", () => {
  state.draws = Number(element("draws").value);
  element("draws-said").textContent = state.draws.toLocaleString("en");
  refresh();
});
element("draws-said").textContent = state.draws;
element("single").addEventListener("click", () => {
  if (state.shown.size === data.hypotheses.length) step();
  else { state.shown = new Set(data.hypotheses.keys()); refresh(); }
});
element("next").addEventListener("click", step);
element("truth-choice").hidden = data.truth === null;
element("truth").addEventListener("change", () => { state.truth = element("truth").checked; refresh(); });
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT)$/.test(event.target.tagName)) return;
  if (event.key === "n") step();
  if (event.key === "j") choose((state.joint + 1) % data.joints.length);
});

fillJoints(element("joint"), data.joints, state.joint, choose);
listHypotheses();
connectViews(scene);
scene.fit([...data.hypotheses.map((one) => one.joints), ...draws.slice(0, 50), ...(data.truth ? [data.truth] : [])]);
if (picture) { picture.onload = () => photo.refresh(); picture.src = data.photo.src; }
refresh();
