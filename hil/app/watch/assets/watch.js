"use strict";
/* Shows the state of a run from the server. Texts are inserted as text, never as HTML. */
const watching = (() => {
  const STALE_S = 0.5, PLOT_MS = 100, SPAN_S = 60;
  const at = (id) => document.getElementById(id);
  const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };
  const show = (y, digits) => (y === null || y === undefined ? "–" : y.toFixed(digits));
  const listeners = { lost: [], said: [], may: [], state: [], began: [] };
  const tell = (name, what) => listeners[name].forEach((each) => each(what));
  let about = {}, last = null, dirty = false, heardAt = -Infinity, connected = false, view = null, plotted = 0, walked = null;
  const counts = { states: 0, drawn: 0 };
  if (location.search) history.replaceState(null, "", "/");  // keeps the token out of history and screenshots

  const legNames = [0, 1, 2, 3, 4, 5].map((i) => "leg " + i);
  const curves = {
    tau: charts.rolling(at("plot-tau"), "leg force sent", "N", legNames, SPAN_S),
    e: charts.rolling(at("plot-e"), "leg error", "mm", legNames, SPAN_S),
    given: charts.rolling(at("plot-given"), "force reported by the drive", "N", legNames, SPAN_S),
    late: charts.rolling(at("plot-late"), "wake-up", "µs", ["late", "worst of 1 s", "computing"], SPAN_S),
  };

  const COLUMNS = { q: "length [m]", margin: "to stroke end [mm]", tau: "force sent [N]", given: "drive reports [N]", share: "of limit",
    e: "error [mm]", drive: "drive", age: "age [ticks]" };
  Object.entries(COLUMNS).forEach(([name, text]) => at("legs").tHead.rows[0].append(
    Object.assign(charts.element("th", text.replace(" [", "\n["), name === "drive" ? "word" : ""), { scope: "col" })));
  const legCells = [0, 1, 2, 3, 4, 5].map((leg) => {
    const line = charts.element("tr"), cells = {};
    line.append(Object.assign(charts.element("th", String(leg)), { scope: "row" }));
    Object.entries(COLUMNS).forEach(([name, text]) => {
      cells[name] = charts.element("td", "", name === "drive" ? "word" : "");
      cells[name].dataset.label = text;
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
    ["x", "y", "z", "rx", "ry", "rz"].map((name) => {
      const cell = line.appendChild(document.createElement("td"));
      cell.dataset.label = name;
      return cell;
    }));
  const figureCells = {};
  [["wake", "wake-up late, now and worst of the last second"], ["step", "computing time, now and worst"], ["stale", "ticks with stale feedback"],
    ["skipped", "periods skipped"], ["bus", "buses"], ["V", "tracking error, share of its certified limit"], ["tick", "tick, at the rate"],
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
  source.addEventListener("past", (e) => {
    const past = JSON.parse(e.data);
    past.t.forEach((t, k) => Object.entries(curves).forEach(([name, each]) => each.push(t, past[name][k])));
  });
  source.addEventListener("events", (e) => showEvents(JSON.parse(e.data)));
  source.addEventListener("state", (e) => {
    last = JSON.parse(e.data);
    heardAt = performance.now() - 1e3 * last.age;
    counts.states += 1;
    dirty = true;
    if (!about.base) return;
    const t = last.tick / about.rate_Hz, late = [last.late[0], last.late[1], last.compute[0]];
    Object.entries({ tau: last.legs.tau, e: last.legs.e, given: last.legs.given, late }).forEach(([name, y]) => curves[name].push(t, y));
    if (!walked || last.path !== walked.path || last.mode !== walked.mode) walked = { path: last.path, mode: last.mode, t };
    last.stands = ["TRACKING", "APPROACH"].includes(last.mode) && t - walked.t > 0.25 && !(last.path >= about.reference_s);
    tell("said", last.said);
    tell("state", last);
  });

  function begin(given) {
    about = given;
    last = walked = null;
    tell("began");
    heardAt = -Infinity;
    const known = "base" in given;
    put(at("name"), known ? given.name : "hil watch");
    put(at("run"), known ? [given.law, given.rate_Hz + " Hz", given.buses.join(" and ")].join(" · ") : given.trouble || "");
    document.title = (known ? given.name + " – " : "") + "hil watch";
    if (!known) return;
    const limit = given.force_limit_N;
    Object.values(curves).forEach((each) => each.clear([]));
    curves.tau.clear([-limit, limit]);
    put(figureCells.file, given.log.split("/").pop());
    const canvas = at("scene").cloneNode();  // without the listeners of the earlier run
    at("scene").replaceWith(canvas);
    const none = (n) => new Array(n).fill(0);
    view = makeScene(canvas, { ...given, t: [0], p: given.home_p, R: given.home_R,
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
    const held = s.said ? s.said.held || (s.stands && s.said.speed_now_percent === 0) : s.stands;
    at("held").hidden = !held;
    put(at("held"), !held ? "" : s.said && s.said.key === "missing" ? "on hold: the enabling key is not held" :
      s.said || !about.key_needed ? "on hold" : "on hold, or the enabling key is not held");
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
      put(cells.given, show(legs.given[i], 1));
      cells.tau.classList.toggle("soft", legs.given[i] !== null && Math.abs(legs.given[i]) < 0.1 * Math.abs(legs.tau[i]));
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
    put(figureCells.bus, about.buses.join("; ") + ": " + (s.off.length ? "OFF: " + s.off.join("; ") : s.bus.toLowerCase()));
    put(figureCells.V, show(s.V, 3));
    put(figureCells.tick, s.tick + ", " + about.rate_Hz + " Hz");
    put(figureCells.dropped, String(s.dropped));
    put(figureCells.waiting, s.waiting + " of " + s.capacity);
    put(figureCells.log, (s.log_bytes / 1e6).toFixed(1) + " MB");
    if (view && s.posed) {
      const none = (n) => new Array(n).fill(0);
      view.place({ p: s.p, R: s.R, p_d: s.led ? s.p_d : none(3), R_d: s.led ? s.R_d : none(9),
        load: s.legs.given.map((force, i) => (force === null ? s.legs.share[i] : force / about.force_limit_N)), marks: s.legs.marked });
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
