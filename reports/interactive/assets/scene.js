// The 3D scene: bodies in camera axes (x right, y down, z away) that turn, on a plain canvas.
// A view is a turn about the vertical and a tilt; at 0, 0 the scene is seen from the camera.

const VIEWS = { camera: [0, 0], side: [Math.PI / 2, 0], above: [0, Math.PI / 2], oblique: [-0.7, 0.3] };
const TAP = 5, NEAR = 22; // pixels: a finger may move so far, and miss by so much

// A canvas as sharp as its screen; `paint` gets its context, width and height in CSS pixels.
class Sheet {
  constructor(canvas, paint) {
    this.canvas = canvas;
    this.paint = paint;
    this.waiting = false;
    new ResizeObserver(() => this.refresh()).observe(canvas);
  }
  refresh() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }
  draw() {
    const wide = this.canvas.clientWidth, high = this.canvas.clientHeight;
    if (!wide || !high) return;
    const sharp = Math.max(2, window.devicePixelRatio || 1); // paper is sharper than screens
    if (this.canvas.width !== Math.round(wide * sharp) || this.canvas.height !== Math.round(high * sharp)) {
      this.canvas.width = Math.round(wide * sharp);
      this.canvas.height = Math.round(high * sharp);
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, wide, high);
    pen.lineCap = pen.lineJoin = "round";
    this.paint(pen, wide, high);
  }
}

// The point that is nearest to a place, if any is near: {rank, joint}; bodies are arrays of [x, y] or null.
function nearest(bodies, x, y) {
  let found = null, least = NEAR;
  bodies.forEach((points, rank) => points.forEach((point, joint) => {
    const far = point ? Math.hypot(point[0] - x, point[1] - y) : Infinity;
    if (far < least) [found, least] = [{ rank, joint }, far];
  }));
  return found;
}

// What the axes are called, and who stands in front: of a world, which has no one camera, others.
const AXES = { z: "depth", x: "across", front: "camera" };

// A place in camera axes, in words.
function placed([x, y, z]) {
  return `${AXES.z} ${signed(z, 2)}, ${AXES.x} ${signed(x, 2)}, height ${signed(-y, 2)} body units`;
}

// Words beside the pointer: `words(x, y)` says what is there, or nothing.
function connectTip(target, words) {
  const tip = element("tip");
  target.addEventListener("pointermove", (event) => {
    tip.textContent = event.buttons ? "" : words(event.offsetX, event.offsetY);
    tip.hidden = !tip.textContent;
    tip.style.left = `${Math.max(0, Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${Math.min(event.clientY + 14, innerHeight - tip.offsetHeight - 8)}px`;
  });
  target.addEventListener("pointerleave", () => { tip.hidden = true; });
}

// A body of points [x, y, depth]: far bones first, each with a white edge that hides what is behind it.
function drawBody(pen, points, style, body) { // style: colour, width, edge, dashed
  const bones = body.bones.filter(([a, b]) => points[a] && points[b])
    .sort((p, q) => points[q[0]][2] + points[q[1]][2] - points[p[0]][2] - points[p[1]][2]);
  for (const [a, b] of bones) {
    const line = () => { pen.beginPath(); pen.moveTo(...points[a]); pen.lineTo(points[b][0], points[b][1]); pen.stroke(); };
    pen.setLineDash([]);
    pen.strokeStyle = "white"; pen.lineWidth = style.width + style.edge; line();
    pen.strokeStyle = style.colour; pen.lineWidth = style.width;
    pen.setLineDash(style.dashed || body.left.includes(b) ? [2 * style.width, 1.6 * style.width] : []);
    line();
  }
  pen.setLineDash([]);
  points.forEach((point, joint) => {
    if (!point) return;
    pen.beginPath(); pen.arc(point[0], point[1], 0.9 * style.width + 0.8, 0, 2 * Math.PI);
    pen.fillStyle = body.left.includes(joint) ? "white" : style.colour; pen.fill();
    pen.strokeStyle = style.colour; pen.lineWidth = 1; pen.stroke();
  });
}

function drawDots(pen, points, colour, size, alpha) {
  pen.globalAlpha = alpha; pen.fillStyle = colour;
  for (const [x, y] of points) pen.fillRect(x - size / 2, y - size / 2, size, size);
  pen.globalAlpha = 1;
}

class Scene {
  // `body`: bones and left joints. `content()`: {bodies: [{joints, colour, width, edge, dashed}], lines: poses
  // drawn faintly, dots: {points, colour} or null}; `words` of a body say which it is.
  // `picked(joint)` is called where one is touched, `said(body, joint)` is what stands beside the pointer.
  constructor(canvas, body, content, picked, said) {
    Object.assign(this, { body, content, picked, said, zoom: 1, centre: [0, 0, 0], reach: 2, floor: null });
    this.view("oblique", true);
    this.sheet = new Sheet(canvas, (pen, wide, high) => this.paint(pen, wide, high));
    this.listen(canvas);
  }
  // What has to fit: `poses` are arrays of 15 points.
  fit(poses) {
    const low = [0, 1, 2].map((axis) => Math.min(...poses.map((pose) => Math.min(...pose.map((p) => p[axis])))));
    const high = [0, 1, 2].map((axis) => Math.max(...poses.map((pose) => Math.max(...pose.map((p) => p[axis])))));
    this.centre = low.map((value, axis) => (value + high[axis]) / 2);
    this.reach = 1.15 * Math.max(...poses.map((pose) =>
      Math.max(...pose.map((p) => Math.hypot(...p.map((value, axis) => value - this.centre[axis]))))));
    this.floor = high[1];
    this.sheet.refresh();
  }
  view(name, quiet) {
    [this.yaw, this.pitch] = VIEWS[name];
    if (!quiet) this.sheet.refresh();
  }
  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, this.pitch + pitch));
    this.sheet.refresh();
  }
  enlarge(factor) {
    this.zoom = Math.max(0.4, Math.min(6, this.zoom * factor));
    this.sheet.refresh();
  }
  // A function from camera axes to [right, down, depth] in pixels of the canvas.
  lens(wide, high) {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const scale = this.zoom * Math.min(wide, high) / 2 / this.reach, [a, b, c] = this.centre;
    return ([x, y, z]) => {
      const across = (x - a) * cy + (z - c) * sy, away = (z - c) * cy - (x - a) * sy;
      const down = (y - b) * cp - away * sp;
      return [wide / 2 + scale * across, high / 2 + scale * down, away * cp + (y - b) * sp];
    };
  }
  paint(pen, wide, high) {
    const lens = this.lens(wide, high), content = this.content();
    if (this.floor !== null) this.paintFloor(pen, lens, high);
    pen.strokeStyle = "#8A8A8A"; pen.lineWidth = 0.7;
    pen.globalAlpha = Math.max(0.03, Math.min(0.3, 12 / Math.max(1, content.lines.length)));
    for (const pose of content.lines) {
      const at = pose.map(lens);
      pen.beginPath();
      for (const [a, b] of this.body.bones) { pen.moveTo(at[a][0], at[a][1]); pen.lineTo(at[b][0], at[b][1]); }
      pen.stroke();
    }
    pen.globalAlpha = 1;
    if (content.dots) drawDots(pen, content.dots.points.map(lens), content.dots.colour, 2.4, 0.45);
    this.bodies = content.bodies;
    this.shown = content.bodies.map((one) => one.joints.map(lens));
    for (let rank = content.bodies.length - 1; rank >= 0; rank--)
      drawBody(pen, this.shown[rank], content.bodies[rank], this.body);
  }
  // A grid of body units at the lowest point, and an arrow that says where the camera is.
  paintFloor(pen, lens, high) {
    const [a, , c] = this.centre, half = Math.max(1, Math.round(this.reach / 1.8));
    pen.strokeStyle = "#E2E2E2"; pen.lineWidth = 1;
    for (let step = -half; step <= half; step++) for (const ends of [
      [[a + step, this.floor, c - half], [a + step, this.floor, c + half]],
      [[a - half, this.floor, c + step], [a + half, this.floor, c + step]]]) {
      const [from, to] = ends.map(lens);
      pen.beginPath(); pen.moveTo(from[0], from[1]); pen.lineTo(to[0], to[1]); pen.stroke();
    }
    const [root, tip] = [[a, this.floor, c - half + 0.6], [a, this.floor, c - half]].map(lens);
    if (Math.hypot(tip[0] - root[0], tip[1] - root[1]) < 8) return; // it points at the reader
    pen.strokeStyle = pen.fillStyle = "#777777";
    pen.beginPath(); pen.moveTo(root[0], root[1]); pen.lineTo(tip[0], tip[1]); pen.stroke();
    pen.beginPath(); pen.arc(tip[0], tip[1], 3, 0, 2 * Math.PI); pen.fill();
    pen.font = "12px sans-serif"; pen.textAlign = "center"; pen.textBaseline = "top";
    pen.fillText(AXES.front, tip[0], Math.min(tip[1] + 5, high - 14));
  }
  listen(canvas) {
    const fingers = new Map();
    let moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      if (!fingers.size) moved = 0;
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId), now = [event.offsetX, event.offsetY];
      if (!before) return;
      const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const by = [now[0] - before[0], now[1] - before[1]];
      moved += Math.abs(by[0]) + Math.abs(by[1]);
      if (!others.length) this.turn(-by[0] / 120, by[1] / 120);
      else if (Math.hypot(before[0] - others[0][0], before[1] - others[0][1]) > 1)
        this.enlarge(Math.hypot(now[0] - others[0][0], now[1] - others[0][1])
          / Math.hypot(before[0] - others[0][0], before[1] - others[0][1]));
      fingers.set(event.pointerId, now);
    });
    canvas.addEventListener("pointerup", (event) => {
      fingers.delete(event.pointerId);
      const found = moved < TAP ? nearest(this.shown, event.offsetX, event.offsetY) : null;
      if (found) this.picked(found.joint);
    });
    canvas.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
    connectTip(canvas, (x, y) => {
      const found = nearest(this.shown, x, y);
      return found ? this.said(this.bodies[found.rank], found.joint) : "";
    });
    canvas.addEventListener("wheel", (event) => {
      const before = this.zoom;
      this.enlarge(Math.exp(-event.deltaY / 400));
      if (this.zoom !== before || event.ctrlKey) event.preventDefault(); // at the last size the page scrolls on
    }, { passive: false });
    const keys = {
      ArrowLeft: () => this.turn(0.1, 0), ArrowRight: () => this.turn(-0.1, 0),
      ArrowUp: () => this.turn(0, -0.1), ArrowDown: () => this.turn(0, 0.1),
      "+": () => this.enlarge(1.15), "=": () => this.enlarge(1.15), "-": () => this.enlarge(1 / 1.15),
      c: () => this.view("camera"), s: () => this.view("side"), a: () => this.view("above"), o: () => this.view("oblique"),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
    });
  }
}

// --- what both kinds of page share

const element = (id) => document.getElementById(id);

// Numbers that were packed as little-endian 32-bit floats, as rows of `width` numbers.
function unpacked(text, width) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const numbers = new Float32Array(bytes.buffer), rows = [];
  for (let start = 0; start < numbers.length; start += width) rows.push(numbers.subarray(start, start + width));
  return rows;
}

const grouped = (row, size) => Array.from({ length: row.length / size }, (_, i) => [...row.subarray(size * i, size * i + size)]);

function make(kind, attributes, text) {
  const found = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes || {})) found.setAttribute(name, value);
  if (text !== undefined) found.textContent = text;
  return found;
}

function drawn(kind, attributes, text) {
  const found = document.createElementNS("http://www.w3.org/2000/svg", kind);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  if (text !== undefined) found.textContent = text;
  return found;
}

// Three to six round numbers from `low` to `high`.
function ticks(low, high) {
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((size) => size >= rough);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step)
    found.push(Number(value.toFixed(10)));
  return found;
}

const signed = (value, digits) => value.toFixed(digits).replace("-", "−");

// Buttons with data-view turn the scene.
function connectViews(scene) {
  for (const button of document.querySelectorAll("button[data-view]"))
    button.addEventListener("click", () => scene.view(button.dataset.view));
}

function fillJoints(choice, names, chosen, changed) {
  names.forEach((name, joint) => choice.append(make("option", { value: joint }, name)));
  choice.value = chosen;
  choice.addEventListener("change", () => changed(Number(choice.value)));
}
