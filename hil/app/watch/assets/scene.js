"use strict";
/* The robot as shaded bodies on a canvas, seen by a camera that turns about the middle; the far ones are painted first. */
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
  const base = given.base, joints = given.platform, stroke = [given.length_min_m, given.length_max_m];
  const baseOrder = around(base), topOrder = around(joints);
  const sum = (a, b, s) => a.map((y, i) => y + s * b[i]), dot = (a, b) => a.reduce((s, y, i) => s + y * b[i], 0);
  const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((y) => y / n); };
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const mean = (points) => [0, 1, 2].map((i) => points.reduce((s, q) => s + q[i], 0) / points.length);
  const placed = (points, p, R, k) => points.map((b) => [0, 1, 2].map((i) =>
    p[3 * k + i] + R[9 * k + 3 * i] * b[0] + R[9 * k + 3 * i + 1] * b[1] + R[9 * k + 3 * i + 2] * b[2]));
  const inPlatform = (v, R, k) => [0, 1, 2].map((j) => [0, 1, 2].reduce((s, i) => s + R[9 * k + 3 * i + j] * v[i], 0));
  /* Bounding box of all poses so far. It only grows, so that the scale stays steady. */
  const low = [0, 1, 2].map((i) => Math.min(...base.map((q) => q[i])));
  const high = [0, 1, 2].map((i) => Math.max(...base.map((q) => q[i])));
  const MARGIN = { left: 16, right: 50, top: 16, bottom: 28 };  // px, of bodies and labels
  const NEAR = 0.1;  // share of a stroke or of a joint's cone from which on its end is written beside the leg
  const LIGHT = unit([0.35, -0.5, 0.8]), STEEL = [122, 134, 147], PLATE = [52, 116, 196], RED = [200, 45, 38];
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

  const index = (time) => Math.max(0, t.findLastIndex((at) => at <= time));

  const rgb = (colour, factor, alpha) => "rgba(" + colour.map((c) => Math.round(Math.min(255, c * factor))).join() + "," + (alpha || 1) + ")";
  function forceColour(share) {
    const s = Math.min(Math.sqrt(Math.abs(share || 0)), 1), to = share > 0 ? [235, 110, 20] : [40, 120, 240];
    return to.map((c) => 175 + (c - 175) * s);
  }

  /* Angles of a leg from the axes of its joints, as shares of what they allow; without limits empty. */
  function joined(along, i, k) {
    if (!given.home_R) return [];
    const home = unit(sum(placed(joints, given.home_p, given.home_R, 0)[i], base[i], -1));
    return [["base", along, home], ["platform", inPlatform(along, R, k), inPlatform(home, given.home_R, 0)]].map(([name, way, standard]) => {
      const most = given[name + "_joint_angle_max_deg"], axes = given[name + "_joint_axes"];
      const angle = Math.acos(Math.max(-1, Math.min(1, dot(way, axes ? unit(axes[i]) : standard)))) * 180 / Math.PI;
      return most ? { share: angle / most, text: name + " joint " + angle.toFixed(0) + "° of " + most + "°" } : { share: 0, text: "" };
    });
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    canvas.width = w * ratio;
    canvas.height = h * ratio;
    const pen = canvas.getContext("2d"), ink = charts.css("--ink"), soft = charts.css("--soft");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.lineCap = pen.lineJoin = "round";
    const cy = Math.cos(yaw), sy = Math.sin(yaw), ct = Math.cos(tilt), st = Math.sin(tilt);
    const middle = low.map((y, i) => (y + high[i]) / 2);
    const size = Math.hypot(...high.map((y, i) => y - middle[i])) || 1;
    const depthOf = (q) => ct * (-sy * (q[0] - middle[0]) + cy * (q[1] - middle[1])) - st * (q[2] - middle[2]);
    const flat = (q) => {
      const x = q[0] - middle[0], y = q[1] - middle[1], z = q[2] - middle[2];
      const far = 1 / (1 + 0.12 * depthOf(q) / size);
      return [far * (cy * x + sy * y), -far * (ct * z + st * (-sy * x + cy * y))];
    };
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => flat([0, 1, 2].map((i) => (k >> i & 1 ? high : low)[i])));
    const least = [0, 1].map((i) => Math.min(...corners.map((c) => c[i])));
    const most = [0, 1].map((i) => Math.max(...corners.map((c) => c[i])));
    const room = [w - MARGIN.left - MARGIN.right, h - MARGIN.top - MARGIN.bottom];
    const scale = Math.max(0, Math.min(...room.map((r, i) => r / (most[i] - least[i] || size))));
    const at = [MARGIN.left + room[0] / 2, MARGIN.top + room[1] / 2].map((c, i) => c - scale * (least[i] + most[i]) / 2);
    const seen = (q) => flat(q).map((y, i) => at[i] + scale * y);
    const trace = (points, closed) => {
      pen.beginPath();
      points.map(seen).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (closed) pen.closePath();
    };
    const line = (points, colour, width, dash) => {
      trace(points, false);
      pen.setLineDash(dash || []);
      pen.strokeStyle = colour;
      pen.lineWidth = width;
      pen.stroke();
    };
    const bodies = [];  // [depth, paint]
    const face = (points, colour, alpha) => bodies.push([depthOf(mean(points)), () => {
      const normal = unit(cross(sum(points[1], points[0], -1), sum(points[2], points[0], -1)));
      trace(points, true);
      pen.setLineDash(alpha < 1 ? [5, 4] : []);
      pen.fillStyle = rgb(colour, 0.6 + 0.5 * Math.abs(dot(normal, LIGHT)), alpha);
      pen.fill();
      pen.strokeStyle = alpha < 1 ? soft : rgb(colour, 0.55);
      pen.lineWidth = 1;
      pen.stroke();
    }]);
    /* A plate through these points, which grows away from the other one. */
    const plate = (points, from, colour, alpha) => {
      const centre = mean(points), normal = unit(points.reduce((n, q, i) =>
        sum(n, cross(sum(q, centre, -1), sum(points[(i + 1) % points.length], centre, -1)), 1), [0, 0, 0]));
      const thick = 0.06 * size * (dot(normal, sum(centre, from, -1)) < 0 ? -1 : 1), back = points.map((q) => sum(q, normal, thick));
      face(points, colour, alpha);
      points.forEach((q, i) => { const j = (i + 1) % points.length; face([q, points[j], back[j], back[i]], colour, alpha); });
      face(back, colour, alpha);
    };
    const rod = (a, b, colour, width) => bodies.push([depthOf(mean([a, b])), () => {
      [[1, 0.5], [0.68, 0.85], [0.3, 1.15]].forEach(([part, bright]) => line([a, b], rgb(colour, bright), part * width));
    }]);

    const k = index(now), tops = placed(joints, p, R, k), middles = [mean(base), mean(tops)], labels = [];
    plate(baseOrder.map((i) => base[i]), middles[1], STEEL, 1);
    plate(topOrder.map((i) => tops[i]), middles[0], PLATE, 1);
    if (posed(RRef, k)) plate(topOrder.map((i) => placed(joints, pRef, RRef, k)[i]), middles[0], [150, 160, 170], 0.3);
    const width = Math.max(6, Math.min(16, 0.07 * scale * size));
    base.forEach((a, i) => {
      const way = sum(tops[i], a, -1), length = Math.hypot(...way), along = unit(way);
      const sleeve = sum(a, along, stroke[0] ? Math.min(0.9 * stroke[0], 0.95 * length) : length / 2), red = marks[i];
      const share = (length - stroke[0]) / (stroke[1] - stroke[0]), left = Math.min(length - stroke[0], stroke[1] - length);
      const near = joined(along, i, k).filter((each) => each.share > 1 - NEAR), ends = share < NEAR || share > 1 - NEAR;
      rod(sleeve, tops[i], red ? RED : forceColour(load[6 * k + i]), 0.6 * width);
      rod(a, sleeve, red ? RED : STEEL, width);
      if (red) bodies.push([-Infinity, () => line([a, tops[i]], charts.css("--bg"), 2, [4, 9])]);
      if (stroke[0]) bodies.push([depthOf(mean([a, sleeve])) - 1e-3 * size, () => {
        const [from, to] = [0.15, 0.9].map((s) => sum(a, sum(sleeve, a, -1), s));
        line([from, to], "rgba(255,255,255,.75)", 1.5);
        pen.beginPath(); pen.arc(...seen(sum(from, sum(to, from, -1), Math.max(0, Math.min(1, share)))), 0.3 * width, 0, 7);
        pen.fillStyle = ends || near.length ? "#ff5a4d" : "#fff";
        pen.fill();
      }]);
      labels.push([a, [i + (red ? " ✕" : ""), ends ? (1e3 * left).toFixed(0) + " mm to the stroke's end" : "", ...near.map((each) => each.text)].filter(Boolean).join(", "), ends || near.length || red]);
    });
    bodies.sort((one, other) => other[0] - one[0]).forEach(([, paint]) => paint());
    pen.setLineDash([]);
    pen.font = "13px system-ui, sans-serif";
    labels.forEach(([a, text, alarm]) => {
      const [x, y] = seen(a), [dx, dy] = unit([x - seen(middles[0])[0], y - seen(middles[0])[1]]);
      pen.fillStyle = alarm ? charts.css("--bad") : ink;
      pen.fillText(text, Math.max(4, Math.min(x + 18 * dx - 4, w - 7 * text.length)), y + 18 * dy + 5);
    });
    ["x", "y", "z"].forEach((name, i) => {
      const end = [0, 1, 2].map((j) => middle[j] + (i === j ? size : 0)), e = flat(end);
      const tip = [34 + 26 * e[0] / size, h - 34 + 26 * e[1] / size];
      pen.beginPath(); pen.moveTo(34, h - 34); pen.lineTo(tip[0], tip[1]);
      pen.lineWidth = 1.5; pen.strokeStyle = pen.fillStyle = soft; pen.stroke();
      pen.fillText(name, tip[0] + 3, tip[1]);
    });
  }

  function turn(right, up) {
    yaw += right;
    tilt = Math.max(-1.5, Math.min(1.5, tilt + up));
    draw();
  }

  new ResizeObserver(() => draw()).observe(canvas);
  window.addEventListener("theme", draw);
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
