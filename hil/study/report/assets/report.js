"use strict";
/* Draws the curves of the page and lets time play. */
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);

  /* Little-endian float32, as all browsers have it. */
  const unpack = (text) => new Float32Array(Uint8Array.from(atob(text), (each) => each.charCodeAt(0)).buffer);
  const gaps = (numbers) => Array.from(numbers, (y) => (Number.isNaN(y) ? null : y));

  const places = Array.from(document.querySelectorAll(".chart"));
  data.charts.forEach((chart) => charts.make(places.find((each) => each.dataset.key === chart.key), chart,
    [Array.from(unpack(chart.t)), ...chart.curves.map((curve) => gaps(unpack(curve.values)))]));
  if (data.scene) play();

  function play() {
    const canvas = document.getElementById("scene"), view = makeScene(canvas, data.scene, unpack);
    const button = document.getElementById("play"), slider = document.getElementById("time");
    const now = document.getElementById("now"), speed = document.getElementById("replay-speed");
    let time = 0, last = null;
    slider.max = String(data.end);
    slider.step = String(Math.max(data.end / 2000, 1e-3));
    function show(to) {
      time = Math.min(Math.max(to, 0), data.end);
      view.show(time);
      slider.value = String(time);
      now.textContent = time.toFixed(3) + " s";
      if (charts.all.length && last !== null) charts.showAt(charts.all[0], time);
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
    show(data.start || 0);
  }
})();
