"use strict";
/* The controls. A held control sends its command only while it is held. */
(() => {
  const HELD_MS = 50, MOST = 8;
  const at = (id) => document.getElementById(id);
  const held = new Set();

  /* Commands are sent in order, one at a time. An emergency stop is sent at once, and waiting commands are dropped. */
  let before = Promise.resolve(), waiting = 0, stops = 0;
  async function say(line) {
    if (line === "estop") {
      stops += 1;
      const answer = post(line);
      before = Promise.all([before, answer]);
      return answer;
    }
    if (waiting >= MOST) return show(line, false, MOST + " commands still wait for their answers");
    waiting += 1;
    const since = stops;
    const answer = before.then(() => since === stops ? post(line) : show(line, false, "the emergency stop came first"));
    before = answer;
    try { return await answer; } finally { waiting -= 1; }
  }
  async function post(line) {
    try {
      const answer = await fetch("/operate", { method: "POST", headers: { "Content-Type": "application/json" },
        body: JSON.stringify({ line }), keepalive: line === "estop" });
      if (!answer.ok) return show(line, false, (await answer.text()).trim());
      const { taken, why } = await answer.json();
      return show(line, taken, why);
    } catch (error) {
      return show(line, false, "no connection to hil watch");
    }
  }
  function show(line, taken, why) {
    const word = line.split(" ")[0];
    if (!taken || (word !== "key" && word !== "jog")) at("answer").textContent = taken ? line + ": taken" : line + ": refused: " + why;
    at("answer").classList.toggle("bad", !taken);
    return taken;
  }

  document.querySelectorAll("[data-line]").forEach((button) => button.addEventListener("click", () => say(button.dataset.line)));
  at("estop").addEventListener("click", () => say("estop"));

  let wanted = null, saying = false;
  at("speed").addEventListener("input", async () => {
    wanted = at("speed").value;
    if (saying) return;
    saying = true;
    while (wanted !== null) {
      const line = "speed " + wanted;
      wanted = null;
      await say(line);
    }
    saying = false;
  });

  function hold(button, lines) {
    let down = false, speaking = false;
    const release = () => { down = false; held.delete(release); button.classList.remove("down"); };
    async function press() {
      if (down) return;
      down = true;
      held.add(release);
      button.classList.add("down");
      if (speaking) return;  // the earlier press still waits for its answer, and continues
      speaking = true;
      while (down) {  // one command at a time: none is queued when the button is released
        const begun = performance.now();
        for (const line of lines()) if (down && !(await say(line))) release();
        await new Promise((done) => setTimeout(done, Math.max(0, HELD_MS - (performance.now() - begun))));
      }
      speaking = false;
    }
    button.addEventListener("pointerdown", (e) => { if (e.button === 0) { button.setPointerCapture(e.pointerId); press(); } });
    ["pointerup", "pointercancel", "lostpointercapture", "blur"].forEach((name) => button.addEventListener(name, release));
    button.addEventListener("contextmenu", (e) => e.preventDefault());
    button.addEventListener("keydown", (e) => {
      if (e.key !== " " && e.key !== "Enter") return;
      e.preventDefault();
      if (!e.repeat) press();
    });
    button.addEventListener("keyup", (e) => { if (e.key === " " || e.key === "Enter") release(); });
  }
  const releaseAll = () => Array.from(held).forEach((each) => each());
  window.addEventListener("blur", releaseAll);
  window.addEventListener("pagehide", releaseAll);
  document.addEventListener("visibilitychange", () => { if (document.hidden) releaseAll(); });
  watching.on("lost", releaseAll);

  hold(at("key"), () => ["key"]);
  ["x", "y", "z", "rx", "ry", "rz", "leg0", "leg1", "leg2", "leg3", "leg4", "leg5"].forEach((axis) => {
    const box = charts.element("div"), buttons = [["−", -1], ["+", 1]].map(([sign, factor]) => {
      const button = Object.assign(charts.element("button", sign, "held"), { type: "button", ariaLabel: "jog " + axis + " " + sign });
      hold(button, () => ["key", "jog " + axis + " " + factor * Number(at("fraction").value)]);
      return button;
    });
    box.append(buttons[0], charts.element("span", axis), buttons[1]);
    at("jogs").append(box);
  });

  /* Commands that do nothing in the present mode are greyed. They are sent all the same, as the controller decides. */
  const moves = (s) => s.mode === "TRACKING" || s.mode === "APPROACH", onHold = (s) => Boolean(s.said && s.said.held);
  const keyed = (s) => !s.said || s.said.key !== "missing";
  const DOES = {
    arm: (s) => s.mode === "IDLE",
    start: (s) => onHold(s) && keyed(s),
    hold: (s) => (moves(s) || s.mode === "STOPPING") && !onHold(s),
    park: (s) => (moves(s) || onHold(s)) && keyed(s),
    stop: (s) => !["STOPPING", "PARKING", "UNLOADING", "PARKED", "FAULT", "HELD"].includes(s.mode),
    reset: (s) => ["FAULT", "WAITING", "PARKED"].includes(s.mode),
    key: (s) => !s.said || s.said.key !== "not needed",
    jog: (s) => s.mode === "TRACKING" && onHold(s),
  };
  const grey = (s) => document.querySelectorAll("[data-line], #key, #jogs button").forEach((button) => {
    const idle = String(!s || s.ended || !DOES[button.dataset.line || (button.id === "key" ? "key" : "jog")](s));
    if (button.getAttribute("aria-disabled") !== idle) button.setAttribute("aria-disabled", idle);
  });
  ["state", "began"].forEach((name) => watching.on(name, grey));
  watching.on("may", ({ operate, allowed }) => {
    document.querySelectorAll(".operate").forEach((each) => { each.hidden = !operate; });
    at("read-only").hidden = operate || !allowed;
    at("read-only").textContent = "Read only: to operate, open the link with the token that hil watch has printed.";
    if (!operate) releaseAll();
  });
  watching.on("said", (said) => {
    if (!said) return;
    at("speed-now").textContent = said.speed_now_percent.toFixed(0) + " % now, " + said.speed_percent.toFixed(0) + " % requested";
    if (document.activeElement !== at("speed")) at("speed").value = String(said.speed_percent);
    at("key-state").textContent = "key: " + said.key;
  });
})();
