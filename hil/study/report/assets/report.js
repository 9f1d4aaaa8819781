"use strict";
/* Draws the curves of the page with uPlot and lets time play. All texts go in as text, never as HTML. */
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const COLOURS = ["#1f5fae", "#d1600a", "#2e7d32", "#b3261e", "#6a3fa0", "#7a5230"];
  const plots = [];

  function unpack(text) {
    const raw = atob(text), bytes = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
    const view = new DataView(bytes.buffer), numbers = new Float32Array(bytes.length / 4);
    for (let i = 0; i < numbers.length; i++) numbers[i] = view.getFloat32(4 * i, true);
    return numbers;
  }
  const gaps = (numbers) => Array.from(numbers, (y) => (Number.isNaN(y) ? null : y));
  const short = (y) => (y === null || y === undefined ? "–" : Math.abs(y) >= 1e5 || (y && Math.abs(y) < 1e-3) ?
    y.toExponential(2) : String(Number(y.toPrecision(5))));

  function levelLines(levels) {
    return { hooks: { draw: (u) => {
      const pen = u.ctx, { left, top, width, height } = u.bbox;
      pen.save();
      pen.beginPath(); pen.rect(left, top, width, height); pen.clip();
      pen.strokeStyle = "#b3261e"; pen.setLineDash([8, 6]); pen.lineWidth = 1.5;
      levels.forEach((level) => {
        const y = u.valToPos(level, "y", true);
        pen.beginPath(); pen.moveTo(left, y); pen.lineTo(left + width, y); pen.stroke();
      });
      pen.restore();
    } } };
  }

  function seriesOf(curve, i, names) {
    const colour = COLOURS[i % COLOURS.length];
    const base = { label: curve.label, stroke: colour, width: 1.25, points: { show: false },
      value: (u, y) => (names.length ? named(names, y, curve.kind) : short(y)) };
    if (curve.kind === "dotted") return { ...base, dash: [4, 4], width: 1.5 };
    if (curve.kind === "steps") return { ...base, paths: uPlot.paths.stepped({ align: 1 }), width: 2 };
    if (curve.kind === "area") {
      return { ...base, paths: uPlot.paths.stepped({ align: 1 }), fill: colour + "66", fillTo: () => i };
    }
    return base;
  }
  function named(names, y, kind) {
    if (y === null || y === undefined) return "–";
    if (kind === "area") return y % 1 > 0.1 ? "on" : "off";
    const found = names.find(([value]) => value === Math.round(y));
    return found ? found[1] : short(y);
  }

  function optionsOf(chart, place) {
    const names = chart.names, lanes = chart.curves.some((c) => c.kind === "area");
    const height = lanes ? 60 + 26 * names.length : names.length ? 200 : 260;
    const wide = Math.min(0.4 * place.clientWidth, names.length ?
      20 + 7 * Math.max(...names.map(([, name]) => name.length)) : 64);
    const least = names.length ? { range: lanes ? [-0.1, names.length] : [-0.5, names.length - 0.5] } : {};
    return {
      width: place.clientWidth, height,
      scales: { x: { time: false }, y: least },
      axes: [{ label: "s", labelSize: 18, size: 32 }, names.length ?
        { size: wide, splits: () => names.map(([at]) => at), values: (u, at) => at.map((v) =>
          (names.find(([value]) => value === v) || ["", ""])[1]), grid: { show: !lanes }, font: "11px system-ui, sans-serif" } :
        { size: wide, values: (u, at) => at.map(short) }],
      series: [{ label: "s", value: (u, x) => (x === null || x === undefined ? "–" : x.toFixed(3)) },
        ...chart.curves.map((curve, i) => seriesOf(curve, i, names))],
      cursor: { y: false, sync: { key: "time", scales: ["x", null] }, drag: { x: true, y: false } },
      legend: { live: true, show: !lanes },
      plugins: chart.levels.length ? [levelLines(chart.levels)] : [],
    };
  }

  function zoom(low, high) {
    const least = Math.max(low, 0), most = Math.min(high, data.end);
    if (most - least > 1e-4) plots.forEach((u) => u.setScale("x", { min: least, max: most }));
  }
  function showAt(u, time) {
    u.setCursor({ left: u.valToPos(time, "x"), top: u.over.clientHeight / 2 }, true, true);
  }

  function keys(u, place) {
    let at = null;
    place.addEventListener("keydown", (e) => {
      const { min, max } = u.scales.x, span = max - min;
      const step = { ArrowLeft: -0.01, ArrowRight: 0.01, PageUp: -0.1, PageDown: 0.1 }[e.key];
      if (e.target !== place || e.ctrlKey || e.metaKey || e.altKey) return;
      if (step && e.shiftKey) zoom(min + 10 * step * span, max + 10 * step * span);
      else if (step) {
        at = Math.min(max, Math.max(min, (at === null ? min + span / 2 : at) + step * span));
        showAt(u, at);
      } else if (e.key === "+" || e.key === "=") zoom(min + span / 4, max - span / 4);
      else if (e.key === "-") zoom(min - span / 2, max + span / 2);
      else if (e.key === "0" || e.key === "Home") zoom(0, data.end);
      else return;
      e.preventDefault();
    });
    place.querySelectorAll(".u-legend .u-series th").forEach((label, i) => {
      if (!i) return;
      label.tabIndex = 0;
      label.setAttribute("role", "button");
      const toggle = () => label.setAttribute("aria-pressed", String(u.series[i].show));
      toggle();
      label.addEventListener("keydown", (e) => {
        if (e.key !== "Enter" && e.key !== " ") return;
        u.setSeries(i, { show: !u.series[i].show });
        toggle();
        e.preventDefault();
      });
    });
  }

  data.charts.forEach((chart) => {
    const place = Array.from(document.querySelectorAll(".chart")).find((each) => each.dataset.key === chart.key);
    const columns = [Array.from(unpack(chart.t)), ...chart.curves.map((curve) => gaps(unpack(curve.values)))];
    const u = new uPlot(optionsOf(chart, place), columns, place);
    keys(u, place);
    plots.push(u);
    place.plot = u;
  });
  document.querySelectorAll(".chart").forEach((place) =>
    place.addEventListener("dblclick", () => zoom(0, data.end)));
  window.addEventListener("resize", () => plots.forEach((u) => {
    const width = u.root.parentElement.clientWidth;
    if (width !== u.width) u.setSize({ width, height: u.height });
  }));

  if (data.scene) play();

  function play() {
    const canvas = document.getElementById("scene"), view = makeScene(canvas, data.scene, unpack);
    const button = document.getElementById("play"), slider = document.getElementById("time");
    const now = document.getElementById("now"), speed = document.getElementById("speed");
    let time = 0, last = null;
    slider.max = String(data.end);
    slider.step = String(Math.max(data.end / 2000, 1e-3));
    function show(to) {
      time = Math.min(Math.max(to, 0), data.end);
      view.show(time);
      slider.value = String(time);
      now.textContent = time.toFixed(3) + " s";
      if (plots.length && last !== null) showAt(plots[0], time);
    }
    function frame(stamp) {
      if (last === null) return;
      show(time + (stamp - last) * 1e-3 * Number(speed.value));
      last = stamp;
      if (time >= data.end) stop(); else requestAnimationFrame(frame);
    }
    function stop() { last = null; button.textContent = "Play"; }
    button.addEventListener("click", () => {
      if (last !== null) return stop();
      if (time >= data.end) time = 0;
      button.textContent = "Pause";
      last = performance.now();
      requestAnimationFrame(frame);
    });
    slider.addEventListener("input", () => show(Number(slider.value)));
    window.addEventListener("resize", view.draw);
    show(0);
  }
})();
