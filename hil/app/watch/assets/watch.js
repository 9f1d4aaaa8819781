"use strict";
/* Shows the state of a run from the server. Texts are inserted as text, never as HTML. */
const watching = (() => {
  const STALE_S = 0.5, PLOT_MS = 100;
  const at = (id) => document.getElementById(id);
  const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };
  const show = (y, digits) => (y === null || y === undefined ? "–" : y.toFixed(digits));
  const listeners = { lost: [], said: [], may: [] };
  const tell = (name, what) => listeners[name].forEach((each) => each(what));
  let about = {}, last = null, dirty = false, heardAt = -Infinity, connected = false, view = null, plotted = 0;
  const counts = { states: 0, drawn: 0 };
  if (location.search) history.replaceState(null, "", "/");  // keeps the token out of history and screenshots

  const curves = {
    tau: makeRolling(at("plot-tau"), [0, 1, 2, 3, 4, 5].map((i) => "leg " + i), []),
    e: makeRolling(at("plot-e"), [0, 1, 2, 3, 4, 5].map((i) => "leg " + i), []),
    late: makeRolling(at("plot-late"), ["late", "worst of 1 s", "step"], []),
  };

  const legCells = [0, 1, 2, 3, 4, 5].map((leg) => {
    const line = document.createElement("tr"), head = document.createElement("th");
    head.scope = "row";
    head.textContent = String(leg);
    line.append(head);
    const cells = {};
    ["q", "margin", "tau", "share", "e", "drive", "age"].forEach((name) => {
      cells[name] = document.createElement("td");
      if (name === "drive") cells[name].className = "word";
      line.append(cells[name]);
    });
    cells.meter = document.createElement("meter");
    Object.assign(cells.meter, { min: 0, max: 1, high: 0.9, low: 0.7, optimum: 0 });
    cells.meter.setAttribute("aria-label", "share of the force limit of leg " + leg);
    ["percent", "state", "marked"].forEach((name) => { cells[name] = document.createElement("span"); });
    cells.marked.className = "mark";
    cells.drive.append(cells.state, cells.marked);
    cells.share.append(cells.meter, " ", cells.percent);
    at("legs").tBodies[0].append(line);
    return cells;
  });
  const poseCells = Array.from(at("pose").tBodies[0].rows, (line) =>
    [0, 1, 2, 3, 4, 5].map(() => line.appendChild(document.createElement("td"))));
  const figureCells = {};
  [["wake", "wake-up late, now and worst of the last second"], ["step", "computing time, now and worst"], ["stale", "ticks with stale feedback"],
    ["skipped", "periods skipped"], ["V", "share of the certificate's limit"], ["tick", "tick, at the rate"],
    ["dropped", "ticks lost by the recorder"], ["waiting", "ticks waiting in the ring"], ["log", "log"], ["file", "file"]]
    .forEach(([name, label]) => {
      const term = document.createElement("dt"), value = document.createElement("dd");
      term.textContent = label;
      value.textContent = "–";
      at("figures").append(term, value);
      figureCells[name] = value;
    });

  const source = new EventSource("/stream");
  source.addEventListener("open", () => { connected = true; });
  source.addEventListener("error", () => { connected = false; tell("lost"); });
  source.addEventListener("hello", (e) => tell("may", JSON.parse(e.data)));
  source.addEventListener("about", (e) => begin(JSON.parse(e.data)));
  source.addEventListener("events", (e) => showEvents(JSON.parse(e.data)));
  source.addEventListener("state", (e) => {
    last = JSON.parse(e.data);
    heardAt = performance.now() - 1e3 * last.age;
    counts.states += 1;
    dirty = true;
    if (!about.name && about.name !== "") return;
    const t = last.tick / about.rate_Hz;
    curves.tau.push(t, last.legs.tau);
    curves.e.push(t, last.legs.e);
    curves.late.push(t, [last.late[0], last.late[1], last.compute[0]]);
    tell("said", last.said);
  });

  function begin(given) {
    about = given;
    last = null;
    heardAt = -Infinity;
    const known = "base" in given;
    put(at("name"), known ? given.name : "hil watch");
    put(at("run"), known ? [given.law, given.rate_Hz + " Hz", given.bus].join(" · ") : given.trouble || "");
    document.title = (known ? given.name + " – " : "") + "hil watch";
    if (!known) return;
    const limit = given.force_limit_N;
    curves.tau.clear([-limit, limit]);
    curves.e.clear([]);
    curves.late.clear([]);
    put(figureCells.file, given.log.split("/").pop());
    const canvas = at("scene").cloneNode();  // without the listeners of the earlier run
    at("scene").replaceWith(canvas);
    const none = (n) => new Array(n).fill(0);
    view = makeScene(canvas, { t: [0], base: given.base, platform: given.platform, p: given.home_p, R: given.home_R,
      p_d: none(3), R_d: none(9), load: none(6) }, (x) => Float64Array.from(x));
    view.draw();
  }

  function showEvents(events) {
    at("events").replaceChildren(...events.slice().reverse().map((each) => {
      const line = document.createElement("li");
      line.textContent = each.t.toFixed(3) + " s, " + each.level + ": " + each.text;
      if (each.level === "error") line.className = "alarm";
      return line;
    }));
  }

  function words(node, texts) {
    if (node.dataset.shown === texts.join("|")) return;
    node.dataset.shown = texts.join("|");
    node.replaceChildren(...texts.map((text) => {
      const line = document.createElement("li");
      line.textContent = text;
      line.className = text === "no fault" ? "" : "alarm";
      return line;
    }));
  }

  function draw() {
    const s = last;
    put(at("mode-name"), s.mode);
    put(at("waits"), (s.said && s.said.waits_for) || s.waits);
    const along = s.mode === "TRACKING" && about.reference_s;
    at("progress").hidden = !along;
    if (along) {
      at("path").value = Math.min(1, s.path / about.reference_s);
      put(at("path-text"), s.path.toFixed(1) + " of " + about.reference_s + " s");
    }
    words(at("faults"), s.faults.length ? s.faults : ["no fault"]);
    put(at("warnings"), s.warnings.length ? "warnings: " + s.warnings.join(", ") : "no warning");
    legCells.forEach((cells, i) => {
      const legs = s.legs;
      put(cells.q, show(legs.q[i], 4));
      put(cells.margin, show(legs.margin[i], 1));
      put(cells.tau, show(legs.tau[i], 1));
      const share = Math.abs(legs.share[i] || 0);
      cells.meter.value = Math.min(1, share);
      put(cells.percent, (100 * share).toFixed(0).padStart(3, "\u2007") + " %");
      put(cells.e, show(legs.e[i], 3));
      put(cells.state, legs.state[i] + (legs.fault[i] ? ": " + legs.fault[i] : ""));
      put(cells.age, legs.age[i] === null ? "never" : String(legs.age[i]));
      put(cells.marked, legs.marked[i] ? "✕ " + legs.marked[i] : "");
    });
    [[s.p, s.r, 4, 3], [s.p_d, s.r_d, 4, 3], [s.e_p, s.e_r, 3, 3]].forEach(([p, r, a, b], k) => {
      const known = k === 0 ? s.posed : k === 1 ? s.led : s.posed && s.led;
      [...p, ...r].forEach((y, i) => put(poseCells[k][i], known ? show(y, i < 3 ? a : b) : "–"));
    });
    const us = ([now, worst]) => now.toFixed(0) + ", " + worst.toFixed(0) + " µs";
    put(figureCells.wake, us(s.late));
    put(figureCells.step, us(s.compute));
    put(figureCells.stale, String(s.stale));
    put(figureCells.skipped, String(s.skipped));
    put(figureCells.V, show(s.V, 3));
    put(figureCells.tick, s.tick + ", " + about.rate_Hz + " Hz");
    put(figureCells.dropped, String(s.dropped));
    put(figureCells.waiting, s.waiting + " of " + s.capacity);
    put(figureCells.log, (s.log_bytes / 1e6).toFixed(1) + " MB");
    if (view && s.posed) {
      const none = (n) => new Array(n).fill(0);
      view.place({ p: s.p, R: s.R, p_d: s.led ? s.p_d : none(3), R_d: s.led ? s.R_d : none(9),
        load: s.legs.share, marks: s.legs.marked });
    }
    counts.drawn += 1;
  }

  function age(now) {
    const seconds = (now - heardAt) * 1e-3, stale = !last || seconds > STALE_S || !connected;
    document.body.classList.toggle("stale", stale);
    const ended = last && last.ended;
    const text = !connected ? "no connection to hil watch" : !last ? about.trouble || "" : ended ? "the run has ended; this is its last tick" :
      stale ? "no data for " + seconds.toFixed(seconds < 10 ? 1 : 0) + " s" : "";
    at("banner").hidden = !text;
    put(at("banner"), text);
    put(at("link"), stale ? (connected ? "○ waiting" : "✕ not connected") : "● live");
    at("link").className = "pill " + (stale ? "lost" : "live");
    if (stale && last) tell("lost");
  }

  function frame(now) {
    if (dirty && about.base) { dirty = false; draw(); }
    if (now - plotted > PLOT_MS) {
      plotted = now;
      Object.values(curves).forEach((each) => each.draw());
      age(now);
    }
    requestAnimationFrame(frame);
  }
  requestAnimationFrame(frame);
  return { counts, on: (name, call) => listeners[name].push(call) };
})();
