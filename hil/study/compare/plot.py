"""A comparison as a picture: error and force over time, the step, the losses path by path."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.files import whole_file
from hil.app.files import printable
from hil.study.compare.measure import Outcome

LABELLED = 8
"""Groups of bars up to which each bar has its figure; more would overlap."""
BLUE = (0.1, 0.3, 0.6)
LINES = ("-", "--", ":")
"""Ten colours, then again with the next line."""


def draw(
    laws: Mapping[str, Outcome], paths: Mapping[str, Mapping[str, Outcome]], file: Path, title: str
) -> Path:
    """Draw a comparison into a PNG file. Raises OSError where it cannot be written."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    figure = Figure(figsize=(14, 10), layout="constrained")
    (errors, forces), (steps, losses) = figure.subplots(2, 2)
    styles = {name: {"color": f"C{k % 10}", "linestyle": LINES[k // 10 % 3]} for k, name in enumerate(laws)}
    named: list[tuple[Any, str]] = []
    for name, o in laws.items():
        if "t" in o.traces:
            t, error, force = o.traces["t"], o.traces["error_mm"], o.traces["force_N"]
            (line,) = errors.semilogy(t, np.maximum(error, FLOOR_MM), linewidth=1.3, **styles[name])
            named.append((line, printable(name if o.fault is None else f"{name}: {o.fault}")))
            forces.plot(t, force, linewidth=1.1, **styles[name])
            if o.fault_s is not None:
                end: dict[str, Any] = {"color": line.get_color(), "marker": "X", "markersize": 9}
                errors.plot(t[-1:], error[-1:], **end)
                forces.plot(t[-1:], force[-1:], **end)
        if "step" in o.traces:
            steps.plot(1e3 * o.traces["step_t"], o.traces["step"], linewidth=1.3, **styles[name])
    errors.set(title="largest leg error (X: fault)", xlabel="s along the reference", ylabel="mm")
    forces.set(title="largest leg force sent", xlabel="s along the reference", ylabel="N")
    steps.set(
        title="answer to a step of the set-point at home, no rates fed forward",
        xlabel="ms",
        ylabel="of the step",
    )
    steps.set_xlim(left=0.0)
    steps.axhline(1.0, color="grey", linewidth=0.8, linestyle=":")
    _losses(losses, paths)
    for axes in (errors, forces, steps, losses):
        axes.grid(alpha=0.3)
    if named:
        lines, labels = zip(*named, strict=True)
        legend = figure.legend(lines, labels, loc="outside lower center", ncols=min(5, len(named)))
        for text in legend.get_texts():
            text.set_parse_math(False)
    figure.suptitle(printable(title), parse_math=False)
    with whole_file(file) as temporary, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # of a name: boxes stand for it
        figure.savefig(temporary, dpi=100)
    return file


FLOOR_MM = 1e-4
"""Errors below are no longer told apart: a tenth of what encoders see."""


def _losses(axes: Any, paths: Mapping[str, Mapping[str, Outcome]]) -> None:
    from matplotlib.patches import Patch  # noqa: PLC0415

    axes.set(title="peak leg error as the path gets real (hatched: until its fault)", ylabel="mm")
    if not paths:
        axes.text(0.5, 0.5, "not measured: --paths", ha="center", transform=axes.transAxes)
        return
    stages = list(dict.fromkeys(stage for found in paths.values() for stage in found))
    width = 0.8 / len(stages)
    place = np.arange(len(paths))
    shades = np.linspace(0.25, 0.95, len(stages))
    for k, stage in enumerate(stages):
        rows = [found.get(stage) for found in paths.values()]
        heights = [0.0 if o is None else o.figures.get("peak_leg_error_mm", 0.0) for o in rows]
        bars = axes.bar(place + (k - (len(stages) - 1) / 2) * width, heights, width, color=(*BLUE, shades[k]))
        hatches = ["//" if o is not None and o.fault else "" for o in rows]
        for bar, hatch in zip(bars, hatches, strict=True):
            bar.set_hatch(hatch)
        if len(paths) <= LABELLED:
            texts = [f"{h:.3g}" if h else "" for h in heights]
            axes.bar_label(bars, texts, fontsize=8, padding=2, rotation=90 if len(paths) > 1 else 0)
    turned: dict[str, Any] = {"rotation": 25, "ha": "right"} if len(paths) > 2 else {}
    axes.set_xticks(place, [printable(name) for name in paths], parse_math=False, **turned)
    if len(paths) > 1:
        axes.set_yscale("log")
    keys = [Patch(color=(*BLUE, shade)) for shade in shades]
    names = [s if s in {stages[0], stages[-1]} else f"+ {s}" for s in stages]
    axes.legend(keys, names, loc="upper center", ncols=len(stages), fontsize=9)
    axes.margins(y=0.3)
