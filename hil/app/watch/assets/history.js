"use strict";
/* The earlier runs of the folder: a table, links to their reports, and two of them side by side. */
(() => {
  const at = (id) => document.getElementById(id), element = charts.element;
  const HEAD = ["run", "verdict", "configuration", "law", "duration", "peak error", "written", "compare"];
  at("runs").tHead.rows[0].append(...HEAD.map((name) => Object.assign(element("th", name), { scope: "col" })));
  const ticked = () => Array.from(document.querySelectorAll("#runs input:checked"), (box) => box.value);

  function line(run) {
    const going = run.file === watching.running(), row = element("tr"), link = element("a", run.file), box = element("input");
    link.href = "/report?run=" + encodeURIComponent(run.file);
    link.target = "_blank";
    Object.assign(box, { type: "checkbox", value: run.file });
    box.setAttribute("aria-label", "compare " + run.file);
    row.append(Object.assign(element("th"), { scope: "row" }));
    row.cells[0].append(run.trouble ? run.file : link);
    const texts = run.trouble ? [run.trouble, "", "", "", "", ""] :
      [going ? "running" : run.verdict, run.configuration, run.law, run.duration_s === null ? "–" : run.duration_s.toFixed(1) + " s",
        run.peak_error_mm === null ? "–" : run.peak_error_mm.toPrecision(3) + " mm", run.written];
    texts.forEach((text, i) => {
      const cell = element("td", text, i === 0 && !run.good && !going ? "mark" : "");
      cell.dataset.label = HEAD[i + 1];
      row.append(cell);
    });
    row.append(element("td"));
    row.lastChild.dataset.label = "compare";
    if (!run.trouble) row.lastChild.append(box);
    return row;
  }

  async function list() {
    at("history-note").textContent = "reading";
    at("history").hidden = false;
    const answer = await fetch("/runs");
    at("history").hidden = answer.status === 404;
    if (!answer.ok) return void (at("history-note").textContent = (await answer.text()).trim());
    const { folder, runs, more } = await answer.json();
    at("runs").tBodies[0].replaceChildren(...runs.map(line));
    at("history-note").textContent = runs.length + " logs in " + folder + (more ? ", the newest of " + more : "") +
      (runs.some((run) => run.duration_s === null) ? "; –: not in the summary of the log, but in its report" : "");
  }
  at("refresh").addEventListener("click", list);
  at("compare").addEventListener("click", () => {
    const [one, other, third] = ticked();
    if (!other || third) at("history-note").textContent = "tick exactly two runs";
    else open("/report?run=" + encodeURIComponent(one) + "&other=" + encodeURIComponent(other), "_blank");
  });
  watching.on("may", list);
  watching.on("began", list);
  watching.on("ended", () => setTimeout(list, 2000));  // the recorder closes the log
})();
