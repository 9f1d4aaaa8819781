"use strict";
/* Wire frame of the pose on a canvas, seen by a camera that turns about the middle. */
/* Order of joints by their angle about their centre, in any plane: hil.robot.joints.around. */
function around(points) {
  const n = points.length;
  const middle = [0, 1, 2].map((i) => points.reduce((s, q) => s + q[i], 0) / n);
  const x = points.map((q) => q.map((y, i) => y - middle[i]));
  const moment = (i, j) => x.reduce((s, q) => s + q[i] * q[j], 0);
  const planes = [[0, 1], [1, 2], [2, 0]];
  const areas = planes.map(([i, j]) => moment(i, i) * moment(j, j) - moment(i, j) ** 2);
  const [i, j] = planes[areas.indexOf(Math.max(...areas))];
  return x.map((_, k) => k).sort((k, m) => Math.atan2(x[k][j], x[k][i]) - Math.atan2(x[m][j], x[m][i]));
}
function makeScene(canvas, given, unpack) {
  const t = unpack(given.t), p = unpack(given.p), R = unpack(given.R);
  const pRef = unpack(given.p_d), RRef = unpack(given.R_d), load = unpack(given.load);
  const base = given.base, joints = given.platform;
  const baseOrder = around(base), topOrder = around(joints);
  const placed = (points, p, R, k) => points.map((b) => [0, 1, 2].map((i) =>
    p[3 * k + i] + R[9 * k + 3 * i] * b[0] + R[9 * k + 3 * i + 1] * b[1] + R[9 * k + 3 * i + 2] * b[2]));
  /* Bounding box of all poses so far. It only grows, so that the scale stays steady. */
  const low = [0, 1, 2].map((i) => Math.min(...base.map((q) => q[i])));
  const high = [0, 1, 2].map((i) => Math.max(...base.map((q) => q[i])));
  const MARGIN = { left: 16, right: 34, top: 12, bottom: 24 };  // px, of joints, lines and labels
  let yaw = -0.6, tilt = 0.35, now = t[0], marks = [];

  const reach = 20 * Math.max(...base.map((q) => Math.hypot(...q.map((y, i) => y - (low[i] + high[i]) / 2))));

  function hold(points) {
    if (!points.every((q) => q.every((y) => Math.abs(y) < reach))) return;  // an implausible pose
    points.forEach((q) => q.forEach((y, i) => {
      if (y < low[i]) low[i] = y;
      if (y > high[i]) high[i] = y;
    }));
  }
  const posed = (R, k) => [0, 1, 2, 3, 4, 5, 6, 7, 8].some((i) => R[9 * k + i]);
  for (let k = 0; k < t.length; k += 1) {
    if (posed(R, k)) hold(placed(joints, p, R, k));
    if (posed(RRef, k)) hold(placed(joints, pRef, RRef, k));
  }

  function index(time) {
    let low = 0, high = t.length - 1;
    while (low < high) {
      const half = (low + high + 1) >> 1;
      if (t[half] <= time) low = half; else high = half - 1;
    }
    return low;
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    canvas.width = w * ratio;
    canvas.height = h * ratio;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.lineCap = pen.lineJoin = "round";
    const cy = Math.cos(yaw), sy = Math.sin(yaw), ct = Math.cos(tilt), st = Math.sin(tilt);
    const middle = low.map((y, i) => (y + high[i]) / 2);
    const size = Math.hypot(...high.map((y, i) => y - middle[i])) || 1;
    const flat = (q) => {
      const x = q[0] - middle[0], y = q[1] - middle[1], z = q[2] - middle[2];
      const depth = -sy * x + cy * y, far = 1 / (1 + 0.12 * (ct * depth - st * z) / size);
      return [far * (cy * x + sy * y), -far * (ct * z + st * depth)];
    };
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => flat([0, 1, 2].map((i) => (k >> i & 1 ? high : low)[i])));
    const least = [0, 1].map((i) => Math.min(...corners.map((c) => c[i])));
    const most = [0, 1].map((i) => Math.max(...corners.map((c) => c[i])));
    const room = [w - MARGIN.left - MARGIN.right, h - MARGIN.top - MARGIN.bottom];
    const scale = Math.max(0, Math.min(...room.map((r, i) => r / (most[i] - least[i] || size))));
    const at = [MARGIN.left + room[0] / 2, MARGIN.top + room[1] / 2].map((c, i) => c - scale * (least[i] + most[i]) / 2);
    const seen = (q) => flat(q).map((y, i) => at[i] + scale * y);
    const line = (points, colour, width, closed, dash) => {
      pen.beginPath();
      points.map(seen).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (closed) pen.closePath();
      pen.setLineDash(dash || []);
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
    };
    const k = index(now), tops = placed(joints, p, R, k);
    line(baseOrder.map((i) => base[i]), "#6b7680", 3, true);
    if (posed(RRef, k)) {
      const there = placed(joints, pRef, RRef, k);
      line(topOrder.map((i) => there[i]), "#8a94a0", 1.5, true, [5, 5]);
    }
    base.forEach((a, i) => (marks[i] ? line([a, tops[i]], "#b3261e", 7, false, [4, 9]) :
      line([a, tops[i]], forceColour(load[6 * k + i]), 5)));
    line(topOrder.map((i) => tops[i]), "#1f5fae", 4, true);
    pen.setLineDash([]);
    pen.fillStyle = "#1c2733";
    pen.font = "13px system-ui, sans-serif";
    base.forEach((a, i) => { const [x, y] = seen(a); pen.fillText(marks[i] ? i + " ✕" : String(i), x + 6, y + 12); });
    ["x", "y", "z"].forEach((name, i) => {
      const end = [0, 1, 2].map((j) => middle[j] + (i === j ? size : 0)), e = flat(end);
      const tip = [34 + 26 * e[0] / size, h - 34 + 26 * e[1] / size];
      pen.beginPath(); pen.moveTo(34, h - 34); pen.lineTo(tip[0], tip[1]);
      pen.lineWidth = 1.5; pen.strokeStyle = "#55626f"; pen.stroke();
      pen.fillText(name, tip[0] + 3, tip[1]);
    });
  }

  function forceColour(share) {
    const s = Math.min(Math.sqrt(Math.abs(share || 0)), 1), to = share > 0 ? [214, 96, 10] : [20, 90, 200];
    return "rgb(" + to.map((c) => Math.round(160 + (c - 160) * s)).join(",") + ")";
  }

  function turn(right, up) {
    yaw += right;
    tilt = Math.max(-1.5, Math.min(1.5, tilt + up));
    draw();
  }

  new ResizeObserver(() => draw()).observe(canvas);
  canvas.addEventListener("pointermove", (e) => {
    if (e.buttons) turn(0.008 * e.movementX, 0.008 * e.movementY);
  });
  canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener("keydown", (e) => {
    const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
    if (by) { turn(by[0], by[1]); e.preventDefault(); }
  });
  /* Shows a new pose; frame.marks: the problems of each leg, or nothing. */
  function place(frame) {
    p.set(frame.p); R.set(frame.R); pRef.set(frame.p_d); RRef.set(frame.R_d); load.set(frame.load);
    marks = frame.marks;
    hold(placed(joints, p, R, 0));
    if (posed(RRef, 0)) hold(placed(joints, pRef, RRef, 0));
    draw();
  }
  return { draw, place, show(time) { now = time; draw(); } };
}
