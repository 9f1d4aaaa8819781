"""Picture of a comparison of laws: error and force over time, step response, errors by signal path."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.files import whole_file
from hil.app.files import printable
from hil.study.compare.measure import Outcome
from hil.study.compare.table import stage_title

LINES = ("-", "--", ":")
"""Line styles; each serves for ten colours."""
FLOOR_MM = 1e-4
"""Smallest error drawn, a tenth of an encoder's resolution."""


def draw(
    laws: Mapping[str, Outcome], paths: Mapping[str, Mapping[str, Outcome]], file: Path, title: str
) -> Path:
    """Draw a comparison of laws into a PNG file. Raises OSError if the file cannot be written."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    figure = Figure(figsize=(14, 10), layout="constrained")
    (errors, forces), (steps, losses) = figure.subplots(2, 2)
    named: list[tuple[Any, str]] = []
    for k, (name, o) in enumerate(laws.items()):
        style: dict[str, Any] = {"color": f"C{k % 10}", "linestyle": LINES[k // 10 % 3]}
        if "t" in o.traces:
            t, error, force = o.traces["t"], o.traces["error_mm"], o.traces["force_N"]
            (line,) = errors.semilogy(t, np.maximum(error, FLOOR_MM), linewidth=1.3, **style)
            named.append((line, printable(name if o.fault is None else f"{name}: {o.fault}")))
            forces.plot(t, force, linewidth=1.1, **style)
            if o.fault_s is not None:
                for axes, values in ((errors, error), (forces, force)):
                    axes.plot(t[-1:], values[-1:], color=style["color"], marker="X", markersize=9)
        if "step" in o.traces:
            steps.plot(1e3 * o.traces["step_t"], o.traces["step"], linewidth=1.3, **style)
    along = "s along the reference"
    errors.set(title="largest leg error (X: fault)", xlabel=along, ylabel="mm")
    forces.set(title="largest leg force sent", xlabel=along, ylabel="N")
    steps.set(title="response to a step at home, no rates fed forward", xlabel="ms", ylabel="of the step")
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
    with whole_file(file) as temporary:
        figure.savefig(temporary, dpi=100)
    return file


def _losses(axes: Any, paths: Mapping[str, Mapping[str, Outcome]]) -> None:
    """Draw the peak error of each law by signal path; a cross marks a fault."""
    axes.set(title="peak leg error with the losses of the path (X: fault)", ylabel="mm")
    if not paths:
        axes.text(0.5, 0.5, "not measured: --paths", ha="center", transform=axes.transAxes)
        return
    stages = list(dict.fromkeys(stage for found in paths.values() for stage in found))
    for k, (name, found) in enumerate(paths.items()):
        at = [n for n, stage in enumerate(stages) if stage in found]
        peaks = [found[stages[n]].figures.get("peak_leg_error_mm", np.nan) for n in at]
        (line,) = axes.semilogy(at, peaks, marker="o", color=f"C{k % 10}")
        line.set_label(printable(name))
        faulted = [n for n in range(len(at)) if found[stages[at[n]]].fault]
        axes.plot(
            [at[n] for n in faulted], [peaks[n] for n in faulted], "X", color=f"C{k % 10}", markersize=11
        )
    axes.set_xticks(range(len(stages)), [stage_title(stage, stages) for stage in stages])
    for text in axes.legend(fontsize=9).get_texts():
        text.set_parse_math(False)
