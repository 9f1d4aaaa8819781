"use strict";
/* Shows the state of a run from the server. Texts are inserted as text, never as HTML. */
const watching = (() => {
  const STALE_S = 0.5, PLOT_MS = 100, SPAN_S = 60;
  const at = (id) => document.getElementById(id);
  const put = (node, text) => { if (node.textContent !== text) node.textContent = text; };
  const show = (y, digits) => (y === null || y === undefined ? "–" : y.toFixed(digits));
  const listeners = { lost: [], said: [], may: [], state: [], began: [], ended: [] };
  const none = (n) => new Array(n).fill(0);
  const tell = (name, what) => listeners[name].forEach((each) => each(what));
  let about = {}, last = null, dirty = false, heardAt = -Infinity, connected = false, view = null, plotted = 0, walked = null, ended = false;
  const counts = { states: 0, drawn: 0 };
  if (location.search) history.replaceState(null, "", "/");  // keeps the token out of history and screenshots

  const SIX = [0, 1, 2, 3, 4, 5], legNames = SIX.map((i) => "leg " + i);
  /* Curve: title, unit, names. */
  const CURVES = { tau: ["leg force sent", "N", legNames], e: ["leg error", "mm", legNames], given: ["force reported by the drive", "N", legNames],
    late: ["wake-up and computing time", "µs", ["late", "worst of 1 s", "computing"]] };
  const curves = {};
  Object.entries(CURVES).forEach(([name, curve]) => { curves[name] = charts.rolling(at("plots"), "plot-" + name, ...curve, SPAN_S); });

  /* Column of the legs: its title, and its text from the state of the legs. */
  const LEGS = { q: ["length [m]", (s, i) => show(s.q[i], 4)], margin: ["to stroke end [mm]", (s, i) => show(s.margin[i], 1)],
    tau: ["force sent [N]", (s, i) => show(s.tau[i], 1)], given: ["drive reports [N]", (s, i) => show(s.given[i], 1)],
    share: ["of limit", (s, i) => (100 * Math.abs(s.share[i])).toFixed(0).padStart(3, "\u2007") + " %"], e: ["error [mm]", (s, i) => show(s.e[i], 3)],
    drive: ["drive", (s, i) => s.state[i] + (s.fault[i] ? ": " + s.fault[i] : "")],
    age: ["age [ticks]", (s, i) => (s.age[i] === null ? "never" : String(s.age[i]))] };
  const wordly = (name) => (name === "drive" ? "word" : "");
  Object.entries(LEGS).forEach(([name, [title]]) => at("legs").tHead.rows[0].append(
    Object.assign(charts.element("th", title.replace(" [", "\n["), wordly(name)), { scope: "col" })));
  const legCells = SIX.map((leg) => {
    const line = charts.element("tr"), cells = { meter: charts.element("meter"), marked: charts.element("span", "", "mark") };
    line.append(Object.assign(charts.element("th", String(leg)), { scope: "row" }));
    Object.entries(LEGS).forEach(([name, [title]]) => {
      const cell = charts.element("td", "", wordly(name));
      cell.dataset.label = title;
      cell.append(cells[name] = charts.element("span"));
      line.append(cell);
    });
    Object.assign(cells.meter, { min: 0, max: 1, high: 0.9, low: 0.7, optimum: 0, ariaLabel: "share of the force limit of leg " + leg });
    cells.share.before(cells.meter, " ");
    cells.drive.after(cells.marked);
    at("legs").tBodies[0].append(line);
    return cells;
  });
  const poseCells = Array.from(at("pose").tBodies[0].rows, (line) => ["x", "y", "z", "rx", "ry", "rz"].map((name) => {
    const cell = line.appendChild(charts.element("td"));
    cell.dataset.label = name;
    return cell;
  }));
  const us = ([now, worst]) => now.toFixed(0) + ", " + worst.toFixed(0) + " µs";
  const FIGURES = [["wake-up late, now and worst of the last second", (s) => us(s.late)], ["computing time, now and worst", (s) => us(s.compute)],
    ["ticks with stale feedback", (s) => String(s.stale)], ["periods skipped", (s) => String(s.skipped)],
    ["buses", (s) => about.buses.join("; ") + (s.off.length ? ": OFF: " + s.off.join("; ") : s.bus === "UNKNOWN" ? "" : ": " + s.bus.toLowerCase())],
    ["tracking error, share of its certified limit", (s) => show(s.V, 3)], ["tick, at the rate", (s) => s.tick + ", " + about.rate_Hz + " Hz"],
    ["ticks lost by the recorder", (s) => String(s.dropped)], ["ticks waiting in the ring", (s) => s.waiting + " of " + s.capacity],
    ["log", (s) => about.log.split("/").pop() + ", " + (s.log_bytes / 1e6).toFixed(1) + " MB"]];
  const figureCells = FIGURES.map(([label]) => {
    at("figures").append(charts.element("dt", label), charts.element("dd", "–"));
    return at("figures").lastChild;
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
    if (last.ended && !ended) tell("ended");
    ended = last.ended;
  });

  function begin(given) {
    about = given;
    last = walked = null;
    ended = false;
    tell("began");
    heardAt = -Infinity;
    const known = "base" in given;
    put(at("name"), known ? given.name : "hil watch");
    document.body.classList.toggle("idle", !known);
    put(at("run"), known ? [given.law, given.rate_Hz + " Hz", given.buses.join(" and ")].join(" · ") : "");
    document.title = (known ? given.name + " – " : "") + "hil watch";
    if (!known) return;
    const limit = given.force_limit_N;
    Object.values(curves).forEach((each) => each.clear([]));
    curves.tau.clear([-limit, limit]);
    const canvas = at("scene").cloneNode();  // without the listeners of the earlier run
    at("scene").replaceWith(canvas);
    view = makeScene(canvas, { ...given, t: [0], p: given.home_p, R: given.home_R,
      p_d: none(3), R_d: none(9), load: none(6) }, (x) => Float64Array.from(x));
    view.draw();
  }

  function showEvents(events) {
    at("events").replaceChildren(...events.reverse().map((each) =>
      charts.element("li", each.t.toFixed(3) + " s, " + each.level + ": " + each.text, each.level === "error" ? "alarm" : "")));
  }

  function words(node, texts) {
    if (node.dataset.shown === texts.join("|")) return;
    node.dataset.shown = texts.join("|");
    node.replaceChildren(...texts.map((text) => charts.element("li", text, text === "no fault" ? "" : "alarm")));
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
      const given = s.legs.given[i];
      Object.entries(LEGS).forEach(([name, [, text]]) => put(cells[name], text(s.legs, i)));
      put(cells.marked, s.legs.marked[i] ? "✕ " + s.legs.marked[i] : "");
      cells.tau.classList.toggle("soft", given !== null && Math.abs(given) < 0.1 * Math.abs(s.legs.tau[i]));
      cells.meter.value = Math.min(1, Math.abs(s.legs.share[i]));
    });
    [[s.p, s.r, 4], [s.p_d, s.r_d, 4], [s.e_p, s.e_r, 3]].forEach(([p, r, digits], k) => {
      const known = (s.posed || k === 1) && (s.led || k === 0);
      [...p, ...r].forEach((y, i) => put(poseCells[k][i], known ? show(y, i < 3 ? digits : 3) : "–"));
    });
    FIGURES.forEach(([, text], k) => put(figureCells[k], text(s)));
    if (view && s.posed) {
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
    at("banner").className = connected && !last ? "remark" : "bad";
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
  return { counts, running: () => (about.log && !ended ? about.log.split("/").pop() : ""), on: (name, call) => listeners[name].push(call) };
})();
