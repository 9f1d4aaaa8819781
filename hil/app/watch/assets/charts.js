"use strict";
/* Curves of the report and of the live page: theme, named legend, zoom, keys, download. Texts go in as text, never as HTML. */
const charts = (() => {
  const DASHES = [[], [14, 3], [7, 3], [14, 3, 3, 3], [4, 2], [10, 2, 2, 2]];
  const all = [], theme = new Map();
  const css = (name) => {
    if (!theme.has(name)) theme.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
    return theme.get(name);
  };
  const short = (y) => (y === null || y === undefined ? "–" : Math.abs(y) >= 1e6 || (y && Math.abs(y) < 1e-3) ?
    y.toExponential(2) : String(Number(y.toPrecision(5))));
  const element = (name, text, className) => Object.assign(document.createElement(name), { textContent: text || "", className: className || "" });
  const colourOf = (curve, i) => "c" + ((curve.hue ?? i) % 6);

  function levelLines(chart) {
    return { hooks: { draw: (u) => {
      const pen = u.ctx, { left, top, width, height } = u.bbox;
      pen.save();
      pen.beginPath(); pen.rect(left, top, width, height); pen.clip();
      pen.strokeStyle = css("--limit"); pen.setLineDash([8, 6]); pen.lineWidth = 1.5;
      chart.levels.forEach((level) => {
        const y = u.valToPos(level, "y", true);
        pen.beginPath(); pen.moveTo(left, y); pen.lineTo(left + width, y); pen.stroke();
      });
      pen.restore();
    } } };
  }

  function named(names, y, kind) {
    if (y === null || y === undefined) return "–";
    if (kind === "area") return y % 1 > 0.1 ? "on" : "off";
    const found = names.find(([value]) => value === Math.round(y));
    return found ? found[1] : short(y);
  }

  function seriesOf(curve, i, dashed) {
    const stroke = () => css("--" + colourOf(curve, i));
    const base = { label: curve.label, stroke, width: 1.4, points: { show: false }, dash: dashed ? DASHES[i % 6] : [] };
    if (curve.kind === "dotted") return { ...base, dash: [4, 4] };
    if (curve.kind === "steps") return { ...base, paths: uPlot.paths.stepped({ align: 1 }), width: 2 };
    if (curve.kind === "area") {
      return { ...base, paths: uPlot.paths.stepped({ align: 1 }), fill: () => stroke() + "66", fillTo: () => i };
    }
    return base;
  }

  function optionsOf(chart, place, span) {
    const names = chart.names || [], lanes = chart.curves.some((c) => c.kind === "area");
    const wide = Math.min(0.4 * place.clientWidth, names.length ? 20 + 7 * Math.max(...names.map(([, name]) => name.length)) : 64);
    const axis = { stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { stroke: () => css("--line") } };
    return {
      width: place.clientWidth, height: lanes ? 60 + 26 * names.length : span || names.length ? 190 : 260,
      scales: { x: { time: false, ...(span && { range: (u, low, high) => [Math.max(0, (high || 0) - span), Math.max(5, high || 0)] }) },
        y: names.length ? { range: lanes ? [-0.1, names.length] : [-0.5, names.length - 0.5] } : {} },
      axes: [{ ...axis, label: "s", labelSize: 18, size: 32 }, names.length ?
        { ...axis, size: wide, splits: () => names.map(([at]) => at), values: (u, at) => at.map((v) =>
          (names.find(([value]) => value === v) || ["", ""])[1]), grid: { ...axis.grid, show: !lanes } } :
        { ...axis, size: wide, values: (u, at) => at.map(short) }],
      series: [{}, ...chart.curves.map((curve, i) => seriesOf(curve, i, span))],
      cursor: { y: false, drag: { x: !span, y: false }, ...(!span && { sync: { key: "time", scales: ["x", null] } }) },
      focus: { alpha: 0.25 }, legend: { show: false },
      plugins: [levelLines(chart)],
    };
  }

  /* One button a curve with its value at the cursor; it shows or hides the curve, and hovering stresses it. */
  function legend(u, chart) {
    const box = element("div", "", "legend"), time = element("span", "", "soft");
    const values = chart.curves.map((curve, i) => {
      const button = element("button", "", colourOf(curve, i)), line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      line.append(document.createElementNS(line.namespaceURI, "path"));
      line.firstChild.setAttribute("d", "M0 3H28");
      line.firstChild.setAttribute("stroke-dasharray", (u.series[i + 1].dash || []).join(" "));
      const value = element("b");
      button.type = "button";
      button.append(line, curve.label, " ", value);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        u.setSeries(i + 1, { show: !u.series[i + 1].show });
        button.setAttribute("aria-pressed", String(u.series[i + 1].show));
      });
      ["mouseenter", "focus"].forEach((name) => button.addEventListener(name, () => u.setSeries(i + 1, { focus: true })));
      ["mouseleave", "blur"].forEach((name) => button.addEventListener(name, () => u.setSeries(null, { focus: false })));
      box.append(button);
      return value;
    });
    box.append(time);
    u.hooks.setCursor = [() => {
      const k = u.cursor.idx, there = k !== null && k !== undefined;
      values.forEach((value, i) => {
        const y = there ? u.data[i + 1][k] : null;
        value.textContent = there ? (chart.names || []).length ? named(chart.names, y, chart.curves[i].kind) : short(y) : "";
      });
      time.textContent = there ? "at " + u.data[0][k].toFixed(3) + " s" : "";
    }];
    return box;
  }

  function save(blob, name) {
    const link = element("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  }
  const fileOf = (chart, ending) => (chart.title || chart.key).replace(/[^A-Za-z0-9]+/g, "-") + ending;
  function table(u, chart) {
    const { min, max } = u.scales.x, quoted = (text) => '"' + text.replace(/"/g, '""') + '"';
    const head = ["t [s]", ...chart.curves.map((c) => c.label + (chart.unit ? " [" + chart.unit + "]" : ""))];
    const lines = [head.map(quoted).join()];
    u.data[0].forEach((t, k) => {
      if (t >= min && t <= max) lines.push([t, ...u.data.slice(1).map((y) => (y[k] === null || y[k] === undefined ? "" : y[k]))].join());
    });
    return lines.join("\n") + "\n";
  }
  function picture(u, chart) {
    const from = u.ctx.canvas, scale = from.width / u.width, canvas = element("canvas"), pen = canvas.getContext("2d");
    const shown = chart.curves.map((curve, i) => [curve, i]).filter(([, i]) => u.series[i + 1].show), across = Math.max(1, Math.floor(u.width / 190));
    const below = chart.curves.some((c) => c.kind === "area") ? 0 : Math.ceil(shown.length / across);
    canvas.width = from.width;
    canvas.height = from.height + scale * (30 + 18 * below);
    pen.fillStyle = css("--bg");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.drawImage(from, 0, 26 * scale);
    pen.scale(scale, scale);
    pen.font = "13px system-ui, sans-serif";
    pen.fillStyle = css("--ink");
    pen.fillText(chart.title + (chart.unit ? " [" + chart.unit + "]" : ""), 8, 17);
    if (below) shown.forEach(([curve, i], k) => {
      const x = 10 + 190 * (k % across), y = 40 + u.height + 18 * Math.floor(k / across);
      pen.strokeStyle = css("--" + colourOf(curve, i));
      pen.lineWidth = 2;
      pen.setLineDash(u.series[i + 1].dash || []);
      pen.beginPath(); pen.moveTo(x, y - 4); pen.lineTo(x + 24, y - 4); pen.stroke();
      pen.fillText(curve.label, x + 30, y);
    });
    return canvas;
  }

  let begin = 0, end = 0;
  const still = () => all.filter((u) => !u.span);
  function zoom(low, high) {
    const least = Math.max(low, begin), most = Math.min(high, end);
    if (most - least > 1e-4) still().forEach((u) => u.setScale("x", { min: least, max: most }));
  }
  const zoomBy = (u, factor) => {
    const { min, max } = u.scales.x, half = factor * (max - min) / 2;
    zoom((min + max) / 2 - half, (min + max) / 2 + half);
  };
  function showAt(u, time) {
    u.setCursor({ left: u.valToPos(time, "x"), top: u.over.clientHeight / 2 }, true, true);
  }

  /* Button of a chart: text, what it does, act. Those that zoom have keys, too. */
  const ACTIONS = [["+", "zoom in", (u) => zoomBy(u, 0.5)], ["−", "zoom out", (u) => zoomBy(u, 2)], ["All", "show the whole time", () => zoom(begin, end)],
    ["CSV", "download the numbers in view", (u, chart) => save(new Blob([table(u, chart)], { type: "text/csv" }), fileOf(chart, ".csv"))],
    ["PNG", "download the picture", (u, chart) => picture(u, chart).toBlob((blob) => save(blob, fileOf(chart, ".png")))]];
  const KEYS = { "+": 0, "=": 0, "-": 1, 0: 2, Home: 2 };
  function tools(u, chart) {
    const box = element("span", "", "tools");
    ACTIONS.slice(u.span ? 3 : 0).forEach(([text, label, act]) => {
      const button = box.appendChild(element("button", text));
      Object.assign(button, { type: "button", title: label, ariaLabel: text + ": " + label + ", " + chart.title });
      button.addEventListener("click", () => act(u, chart));
    });
    return box;
  }

  function keys(u, place) {
    let at = null;
    place.addEventListener("keydown", (e) => {
      const { min, max } = u.scales.x, span = max - min;
      const step = span * { ArrowLeft: -0.01, ArrowRight: 0.01, PageUp: -0.1, PageDown: 0.1 }[e.key];
      if (e.target !== place || e.ctrlKey || e.metaKey || e.altKey || !(step || e.key in KEYS)) return;
      e.preventDefault();
      if (!step) ACTIONS[KEYS[e.key]][2](u);
      else if (e.shiftKey) zoom(min + 10 * step, max + 10 * step);
      else showAt(u, at = Math.min(max, Math.max(min, (at === null ? min + span / 2 : at) + step)));
    });
    place.addEventListener("dblclick", () => zoom(begin, end));
  }

  /* Draws a chart in its place; span: seconds of a chart that moves with time, or nothing. */
  function make(place, chart, columns, span) {
    const u = new uPlot(optionsOf(chart, place, span), columns, place);
    u.span = span;
    if (!chart.curves.some((c) => c.kind === "area")) place.after(legend(u, chart));
    const caption = place.parentElement.querySelector("figcaption");
    if (caption) caption.append(tools(u, chart));
    if (!span) {
      keys(u, place);
      begin = Math.min(begin, columns[0][0]);
      end = Math.max(end, columns[0][columns[0].length - 1]);
    }
    all.push(u);
    new ResizeObserver(() => place.clientWidth && u.setSize({ width: place.clientWidth, height: u.height })).observe(place);
    place.plot = u;
    return u;
  }

  /* Curves over the last seconds: samples are added one at a time, the oldest are dropped. */
  function rolling(parent, id, title, unit, labels, span) {
    const place = Object.assign(element("div", "", "chart"), { id, role: "img", ariaLabel: title + " over time" });
    const box = parent.appendChild(element("figure")), caption = box.appendChild(element("figcaption"));
    caption.append(element("span", title + " [" + unit + "]"));
    box.append(place);
    const chart = { title, unit, levels: [], curves: labels.map((label) => ({ label })) }, most = 55 * span;
    let columns = [[], ...labels.map(() => [])], changed = false;
    const u = make(place, chart, columns, span);
    return {
      clear(levels) { columns = columns.map(() => []); chart.levels = levels; changed = true; },
      push(t, values) {
        const x = columns[0];
        if (x.length && t <= x[x.length - 1]) {
          if (t === x[x.length - 1]) return;
          columns = columns.map(() => []);
        }
        columns[0].push(t);
        values.forEach((y, i) => columns[i + 1].push(y));
        if (columns[0].length > most) columns.forEach((each) => each.splice(0, 100));
        changed = true;
      },
      draw() { if (changed) u.setData(columns); changed = false; },
    };
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    theme.clear();
    all.forEach((u) => u.redraw(false, true));
    window.dispatchEvent(new Event("theme"));
  });
  return { all, css, element, make, rolling, showAt, zoom };
})();
