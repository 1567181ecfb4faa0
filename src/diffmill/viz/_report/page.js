"use strict";
// Turning view of arm, part and path, and the history below it; one moment and one
// case link both. Lengths in mm, errors in um; the depth of a pixel grows to the eye.
(() => {
  const root = document.documentElement;
  const data = JSON.parse(document.getElementById("run-data").textContent);
  const scene = document.getElementById("scene");
  const history = document.getElementById("history");
  const slider = document.getElementById("moment");
  const readout = document.getElementById("readout");
  const legend = document.getElementById("legend");

  const unpack = (text, Type) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new Type(bytes.buffer);
  };
  const floats = (text) => unpack(text, Float32Array);
  const time = floats(data.time);
  const desired = floats(data.desired);
  const cutting = unpack(data.cutting, Uint8Array);
  const cases = data.cases.map((one) => ({
    ...one,
    deviation: floats(one.deviation),
    error: floats(one.error),
    force: floats(one.force),
    cloud: one.cloud && {
      points: unpack(one.cloud.points, Int16Array),
      error: unpack(one.cloud.error, Int8Array),
      normal: unpack(one.cloud.normal, Int8Array),
    },
  }));
  const arm = data.arm && { ...data.arm, points: floats(data.arm.points) };
  const count = time.length;

  // Blue, white, red, as in the maps: too deep, right, material left.
  const stops = [[33, 102, 172], [103, 169, 207], [247, 247, 247], [239, 138, 98],
    [178, 24, 43]];
  const shade = (level) => {
    const at = (Math.max(-1, Math.min(1, level)) + 1) * 2;
    const low = Math.min(3, Math.floor(at));
    return stops[low].map((c, k) => c + (at - low) * (stops[low + 1][k] - c));
  };

  const state = { azimuth: -1.05, elevation: 0.65, target: [0, 0, 0], span: [1, 1, 1],
    zoom: 1, scale: 1, view: "part", chosen: data.chosen, row: data.worst };
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  // From axes of the work into those of the robot's base, whose z is up.
  const turned = (p) => data.turn.map((line) => dot(line, p));

  function fit(canvas) {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const { clientWidth: width, clientHeight: height } = canvas;
    canvas.width = Math.max(1, Math.round(width * ratio));
    canvas.height = Math.max(1, Math.round(height * ratio));
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    return { pen, width, height, ratio };
  }

  function camera() {
    const { azimuth: a, elevation: e } = state;
    return {
      right: [-Math.sin(a), Math.cos(a), 0],
      up: [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)],
      eye: [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)],
    };
  }

  function projector(width, height) {
    const { right, up, eye } = camera();
    return (p) => {
      const q = turned(p).map((value, k) => value - state.target[k]);
      return [width / 2 + state.scale * dot(q, right),
        height / 2 - state.scale * dot(q, up), dot(q, eye)];
    };
  }

  function armAt(row) {
    if (!arm) return [];
    const at = (row / Math.max(1, count - 1)) * (arm.frames - 1);
    const low = Math.floor(at), high = Math.min(low + 1, arm.frames - 1);
    const size = arm.lines * 9, share = at - low;
    return Array.from({ length: arm.lines }, (_, line) =>
      [0, 1, 2].map((point) => [0, 1, 2].map((axis) => {
        const k = line * 9 + point * 3 + axis;
        const from = arm.points[low * size + k];
        return from + share * (arm.points[high * size + k] - from);
      })));
  }

  function corners() {
    const found = [];
    for (let k = 0; k < 8; k++) {
      found.push([0, 1, 2].map((a) => (k >> a & 1 ? data.upper : data.lower)[a]));
    }
    return found;
  }

  function look(view) {
    const points = corners();
    if (view === "arm") points.push(...armAt(state.row).flat());
    state.view = view;
    state.elevation = view === "arm" ? 0.3 : 0.65;
    // The middle of what is seen from here goes to the middle of the window.
    const { right, up, eye } = camera();
    const all = points.map(turned);
    const range = [right, up, eye].map((axis) => {
      const along = all.map((p) => dot(p, axis));
      return [Math.min(...along), Math.max(...along)];
    });
    state.target = [0, 1, 2].map((k) => [right, up, eye].reduce((sum, axis, n) =>
      sum + axis[k] * (range[n][0] + range[n][1]) / 2, 0));
    state.span = range.map(([low, high]) => high - low || 1);
    state.zoom = 1;
    for (const button of document.querySelectorAll("[data-view]")) {
      button.setAttribute("aria-pressed", String(button.dataset.view === view));
    }
  }

  // Squares into a buffer of depths: what is nearer hides what is farther.
  function drawCloud(pen, width, height, ratio, cloud) {
    const w = Math.round(width * ratio), h = Math.round(height * ratio);
    const image = pen.createImageData(w, h);
    const pixels = new Uint32Array(image.data.buffer);
    const depth = new Float32Array(w * h).fill(-Infinity);
    const project = projector(width, height), { eye } = camera();
    const half = 0.7 * Math.max(1, data.square * state.scale * ratio);
    const { points, error, normal } = cloud, place = [0, 0, 0], facing = [0, 0, 0];
    for (let k = 0; k < error.length; k++) {
      for (let a = 0; a < 3; a++) {
        place[a] = points[3 * k + a] * data.grain;
        facing[a] = normal[3 * k + a] / 127;
      }
      const [x, y, near] = project(place);
      const light = 0.82 + 0.18 * Math.abs(dot(turned(facing), eye));
      const [r, g, b] = shade(error[k] / 127);
      const ink = (255 << 24 | b * light << 16 | g * light << 8 | r * light) >>> 0;
      const left = Math.max(0, Math.round(x * ratio - half));
      const right = Math.min(w, Math.round(x * ratio + half));
      const top = Math.max(0, Math.round(y * ratio - half));
      const bottom = Math.min(h, Math.round(y * ratio + half));
      for (let v = top; v < bottom; v++) {
        for (let u = left; u < right; u++) {
          if (near > depth[v * w + u]) {
            depth[v * w + u] = near;
            pixels[v * w + u] = ink;
          }
        }
      }
    }
    // Printing keeps pictures that are drawn, but not pixels that are put.
    const sheet = document.createElement("canvas");
    sheet.width = w;
    sheet.height = h;
    sheet.getContext("2d").putImageData(image, 0, 0);
    pen.drawImage(sheet, 0, 0, width, height);
  }

  function stroke(pen, points, style) {
    pen.strokeStyle = style.ink;
    pen.lineWidth = style.width;
    pen.setLineDash(style.dash || []);
    pen.lineCap = pen.lineJoin = "round";
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
    pen.setLineDash([]);
  }

  const tip = (one, row, factor) => [0, 1, 2].map((a) =>
    desired[3 * row + a] + factor * 1e-3 * one.deviation[3 * row + a]);
  // Moves in the air are not drawn: the path is cut there.
  function stretches() {
    const found = [];
    for (let row = 0; row < count; row++) {
      if (!cutting[row]) continue;
      if (row && cutting[row - 1] && found.length) found.at(-1).push(row);
      else found.push([row]);
    }
    return found;
  }

  function drawScene() {
    const { pen, width, height, ratio } = fit(scene);
    state.scale = 0.84 * state.zoom * Math.min(width / state.span[0],
      height / state.span[1]);
    const one = cases[state.chosen], project = projector(width, height);
    const ink = colour("--ink"), soft = colour("--soft");
    if (one.cloud) drawCloud(pen, width, height, ratio, one.cloud);
    const box = corners();
    drawSides(pen, project, box);
    for (let k = 0; k < 8; k++) {
      for (const bit of [1, 2, 4]) {
        if (!(k & bit)) {
          stroke(pen, [project(box[k]), project(box[k | bit])],
            { ink: soft, width: 0.7 });
        }
      }
    }
    if (state.view === "part") {
      for (const rows of stretches()) {
        stroke(pen, rows.map((row) => project(tip(one, row, 0))),
          { ink, width: 1, dash: [4, 3] });
        stroke(pen, rows.map((row) => project(tip(one, row, data.factor))),
          { ink: one.colour, width: 2 });
      }
    }
    const lines = armAt(state.row), thick = state.view === "arm" ? 8 : 3;
    pen.globalAlpha = state.view === "arm" ? 1 : 0.6;
    for (const line of lines) {
      stroke(pen, line.map(project), { ink: colour("--arm"), width: thick });
    }
    pen.globalAlpha = 1;
    if (state.view === "arm") {
      for (const line of lines.slice(0, -1)) disc(pen, project(line[2]), 4, ink);
    }
    drawTool(pen, project, tip(one, state.row, data.factor), ink);
    drawAxes(pen, height, ink);
    pen.fillStyle = soft;
    pen.font = "12px system-ui, sans-serif";
    const said = state.view === "part"
      ? `deviation magnified ${data.factor} times` : "";
    pen.fillText(said, 12, 20);
  }

  // The raw sides that the eye sees, thin enough to look through where they were cut.
  function drawSides(pen, project, box) {
    const { eye } = camera();
    pen.fillStyle = colour("--soft");
    pen.globalAlpha = 0.13;
    for (let axis = 0; axis < 3; axis++) {
      for (const side of [0, 1]) {
        const normal = turned([0, 1, 2].map((a) => (a === axis ? 2 * side - 1 : 0)));
        const isTop = axis === 2 && side;
        if (isTop || dot(normal, eye) <= 0) continue;
        const [b, c] = [0, 1, 2].filter((a) => a !== axis).map((a) => 1 << a);
        const start = side << axis;
        pen.beginPath();
        for (const k of [start, start | b, start | b | c, start | c]) {
          pen.lineTo(...project(box[k]).slice(0, 2));
        }
        pen.fill();
      }
    }
    pen.globalAlpha = 1;
  }

  function disc(pen, [x, y], radius, ink) {
    pen.fillStyle = colour("--paper");
    pen.strokeStyle = ink;
    pen.lineWidth = 1.5;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fill();
    pen.stroke();
  }

  function drawTool(pen, project, place, ink) {
    for (const height of data.radius ? [0, 2 * data.radius] : []) {
      const ring = Array.from({ length: 37 }, (_, k) => project([
        place[0] + data.radius * Math.cos(k * Math.PI / 18),
        place[1] + data.radius * Math.sin(k * Math.PI / 18), place[2] + height]));
      stroke(pen, ring, { ink, width: 1.2 });
    }
    disc(pen, project(place), 4, ink);
  }

  function drawAxes(pen, height, ink) {
    const { right, up } = camera();
    pen.font = "12px system-ui, sans-serif";
    ["x", "y", "z"].forEach((name, k) => {
      const axis = turned([0, 1, 2].map((a) => Number(a === k)));
      const end = [40 + 26 * dot(axis, right), height - 40 - 26 * dot(axis, up)];
      stroke(pen, [[40, height - 40], end], { ink, width: 1.2 });
      pen.fillStyle = ink;
      pen.fillText(name, 37 + 34 * dot(axis, right), height - 36 - 34 * dot(axis, up));
    });
  }

  const MARGIN = { left: 52, right: 10, top: 20, bottom: 24 };
  const across = (row, width) => MARGIN.left + (width - MARGIN.left - MARGIN.right)
    * (time[row] - time[0]) / (time[count - 1] - time[0] || 1);

  function ticks(most) {
    const raw = most / 3, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find((k) => k * power >= raw) * power;
    const found = [];
    for (let value = 0; value <= most * 1.001; value += step) found.push(value);
    return found;
  }

  const short = (value) => (Math.abs(value) >= 100 ? value.toFixed(0)
    : Number(value.toPrecision(3)).toString());

  function drawPanel(pen, width, top, bottom, title, curves, most) {
    const y = (value) => bottom - (bottom - top) * value / most;
    const soft = colour("--soft"), line = colour("--line");
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = soft;
    pen.textAlign = "left";
    pen.fillText(title, MARGIN.left, top - 6);
    pen.textAlign = "right";
    for (const value of ticks(most)) {
      stroke(pen, [[MARGIN.left, y(value)], [width - MARGIN.right, y(value)]],
        { ink: line, width: 1 });
      pen.fillText(short(value), MARGIN.left - 6, y(value) + 4);
    }
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN.left, top, width - MARGIN.left - MARGIN.right, bottom - top);
    pen.clip();
    for (const curve of curves) {
      for (const rows of stretches()) {
        stroke(pen, rows.map((row) => [across(row, width), y(curve.values(row))]),
          curve);
      }
    }
    pen.restore();
  }

  function most(values) {
    let found = 0;
    for (let row = 0; row < count; row++) {
      if (cutting[row]) found = Math.max(found, values(row));
    }
    return 1.08 * found || 1;
  }

  function drawHistory() {
    const { pen, width, height } = fit(history);
    const one = cases[state.chosen], middle = 0.56 * height;
    const error = (item) => (row) => Math.abs(item.error[row]);
    const force = (row) => one.force[row];
    const curves = [state.chosen, data.reference].filter((k, at) => !at || k
      !== state.chosen).reverse().map((k) => ({ values: error(cases[k]),
      ink: cases[k].colour, width: k === state.chosen ? 1.8 : 0.6 }));
    if (data.band) {
      curves.push({ values: () => data.band, ink: colour("--ink"), width: 1,
        dash: [6, 4] });
    }
    const thin = state.chosen === data.reference ? ""
      : `; thin: ${cases[data.reference].label}`;
    drawPanel(pen, width, MARGIN.top, middle - 16, `contour error [\u00b5m]${thin}`,
      curves, most(error(one)));
    drawPanel(pen, width, middle + 14, height - MARGIN.bottom,
      `force [N], ${one.label}`, [{ values: force, ink: one.colour, width: 1.4 }],
      most(force));
    pen.textAlign = "center";
    pen.fillStyle = colour("--soft");
    const last = time[count - 1];
    for (const value of ticks(last - time[0])) {
      const x = MARGIN.left + (width - MARGIN.left - MARGIN.right)
        * value / (last - time[0] || 1);
      pen.fillText(`${short(time[0] + value)} s`, x, height - 8);
    }
    const x = across(state.row, width);
    stroke(pen, [[x, MARGIN.top], [x, height - MARGIN.bottom]],
      { ink: colour("--ink"), width: 1.2 });
  }

  function tell() {
    const one = cases[state.chosen], row = state.row;
    const place = [0, 1, 2].map((a) => (desired[3 * row + a] + data.origin[a])
      .toFixed(1)).join(", ");
    const off = [0, 1, 2].map((a) => short(one.deviation[3 * row + a])).join(", ");
    readout.textContent = `${time[row].toFixed(3)} s at x, y, z = ${place} mm; `
      + `${one.label}: `
      + (cutting[row] ? `contour error ${short(one.error[row])} \u00b5m, ` : "in the air, ")
      + `deviation ${off} \u00b5m, force ${short(one.force[row])} N`;
    slider.value = row;
    slider.setAttribute("aria-valuetext", readout.textContent);
    legend.hidden = !one.cloud;
    const [deep, left] = legend.querySelectorAll("span");
    deep.textContent = `too deep ${short(one.limit)} \u00b5m`;
    left.textContent = `${short(one.limit)} \u00b5m left standing`;
    for (const button of document.querySelectorAll("[data-case]")) {
      const isChosen = Number(button.dataset.case) === state.chosen;
      button.setAttribute("aria-pressed", String(isChosen));
    }
  }

  let isWaiting = false;
  function drawNow() {
    isWaiting = false;
    drawScene();
    drawHistory();
    tell();
  }
  function draw() {
    if (!isWaiting) requestAnimationFrame(drawNow);
    isWaiting = true;
  }
  function goTo(row) {
    state.row = Math.max(0, Math.min(count - 1, row));
    draw();
  }

  function nearestInScene(event) {
    const bounds = scene.getBoundingClientRect();
    const project = projector(scene.clientWidth, scene.clientHeight);
    let best = -1, least = 20;
    for (let row = 0; row < count; row++) {
      if (!cutting[row]) continue;
      const [x, y] = project(tip(cases[state.chosen], row, data.factor));
      const far = Math.hypot(x - event.clientX + bounds.left,
        y - event.clientY + bounds.top);
      if (far < least) [best, least] = [row, far];
    }
    return best;
  }
  function nearestInTime(event) {
    const bounds = history.getBoundingClientRect(), width = history.clientWidth;
    let low = 0, high = count - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (across(middle, width) < event.clientX - bounds.left) low = middle + 1;
      else high = middle;
    }
    return low;
  }
  function turn(across, along) {
    state.azimuth -= across;
    state.elevation = Math.max(-1.5, Math.min(1.5, state.elevation + along));
    draw();
  }
  function zoom(factor) {
    state.zoom *= factor;
    draw();
  }

  let held = null;
  scene.addEventListener("pointerdown", (event) => {
    held = [event.clientX, event.clientY];
    scene.setPointerCapture(event.pointerId);
  });
  scene.addEventListener("pointermove", (event) => {
    if (held) {
      turn((event.clientX - held[0]) / 150, (event.clientY - held[1]) / 150);
      held = [event.clientX, event.clientY];
    } else if (state.view === "part") {
      const row = nearestInScene(event);
      if (row >= 0) goTo(row);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    scene.addEventListener(name, () => { held = null; });
  }
  // Without Ctrl or a click before, the wheel moves the page.
  scene.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== scene) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 500));
  }, { passive: false });
  const KEYS = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1],
    ArrowDown: [0, -0.1] };
  scene.addEventListener("keydown", (event) => {
    if (event.key in KEYS) turn(...KEYS[event.key]);
    else if (event.key === "+") zoom(1.2);
    else if (event.key === "-") zoom(1 / 1.2);
    else return;
    event.preventDefault();
  });
  for (const name of ["pointerdown", "pointermove"]) {
    history.addEventListener(name, (event) => goTo(nearestInTime(event)));
  }
  slider.addEventListener("input", () => goTo(Number(slider.value)));
  for (const button of document.querySelectorAll("[data-case]")) {
    button.addEventListener("click", () => {
      state.chosen = Number(button.dataset.case);
      draw();
    });
  }
  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => {
      look(button.dataset.view);
      draw();
    });
  }
  window.addEventListener("resize", draw);
  for (const what of ["(prefers-color-scheme: dark)", "print"]) {
    window.matchMedia(what).addEventListener("change", drawNow);
  }
  window.addEventListener("beforeprint", () => {
    root.classList.add("printing");
    drawNow();
  });
  window.addEventListener("afterprint", () => {
    root.classList.remove("printing");
    drawNow();
  });

  look("part");
  drawNow();
})();
