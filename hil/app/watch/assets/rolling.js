"use strict";
/* Curves over the last seconds: samples are added one at a time, the oldest are dropped. */
function makeRolling(place, labels, levels) {
  const SPAN_S = 20, MOST = 1100;
  const COLOURS = ["#1f5fae", "#d1600a", "#2e7d32", "#b3261e", "#6a3fa0", "#7a5230"];
  const DASHES = [[], [10, 4], [2, 3], [12, 3, 2, 3], [6, 6], [2, 8]];
  let columns = [[], ...labels.map(() => [])], limits = levels, changed = false;
  const short = (y) => (Math.abs(y) >= 1e6 || (y && Math.abs(y) < 1e-3) ? y.toExponential(1) : String(Number(y.toPrecision(4))));
  const lines = { hooks: { draw: (u) => {
    const pen = u.ctx, { left, top, width, height } = u.bbox;
    pen.save();
    pen.beginPath(); pen.rect(left, top, width, height); pen.clip();
    pen.strokeStyle = "#b3261e"; pen.setLineDash([8, 6]); pen.lineWidth = 1.5;
    limits.forEach((level) => {
      const y = u.valToPos(level, "y", true);
      pen.beginPath(); pen.moveTo(left, y); pen.lineTo(left + width, y); pen.stroke();
    });
    pen.restore();
  } } };
  const plot = new uPlot({
    width: place.clientWidth, height: 190,
    scales: { x: { time: false, range: (u, low, high) => [(high || 0) - SPAN_S, high || 0] } },
    axes: [{ size: 30, label: "s", labelSize: 14 }, { size: 52, values: (u, at) => at.map(short) }],
    series: [{}, ...labels.map((label, i) => ({ label, stroke: COLOURS[i % 6], dash: DASHES[i % 6], width: 1.4, points: { show: false } }))],
    cursor: { show: false }, legend: { live: false }, plugins: [lines],
  }, columns, place);
  place.plot = plot;
  window.addEventListener("resize", () => {
    if (place.clientWidth !== plot.width) plot.setSize({ width: place.clientWidth, height: 190 });
  });
  return {
    clear(levels) { columns = columns.map(() => []); limits = levels; changed = true; },
    push(t, values) {
      const x = columns[0];
      if (x.length && t <= x[x.length - 1]) {
        if (t === x[x.length - 1]) return;
        columns = columns.map(() => []);
      }
      columns[0].push(t);
      values.forEach((y, i) => columns[i + 1].push(y));
      if (columns[0].length > MOST) columns.forEach((each) => each.splice(0, 100));
      changed = true;
    },
    draw() { if (changed) plot.setData(columns); changed = false; },
  };
}
