"""A system of two states as a picture: V as a surface, its level sets, the sign of dV/dt, trajectories.

What is drawn is floating point and proves nothing; the title is the finding, which is proven.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

from drivers.arrays import Array
from drivers.errors import ModelError
from drivers.files import whole_file
from hil.proof.cancellation import lie_derivative
from hil.proof.door import read
from hil.proof.report import Report

POINTS = 161
"""Of the grid, on each side."""
STARTS = 16
"""Trajectories, from points on the edge of the box."""


def draw(
    f: Mapping[sp.Symbol, Any],
    V: Any,
    box: Mapping[sp.Symbol, tuple[Any, Any]],
    path: Path,
    *,
    parameters: Mapping[sp.Symbol, Any] | None = None,
    report: Report | None = None,
) -> Path:
    """Draw V, its level sets and trajectories of dx/dt = f(x) within a box.

    `parameters` are their values. With a report the findings, the level and a counterexample are drawn too.

    Raises ModelError where there are not two states, or a parameter has no value or a state no ends; OSError
    where the file cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    states = tuple(f)
    if len(states) != 2:
        raise ModelError(f"a picture needs two states; f has {len(states)}: {', '.join(map(str, states))}")
    values = {p: read(value, f"the value of {p}") for p, value in (parameters or {}).items()}
    field = {x: read(e, f"d{x}/dt").subs(values) for x, e in f.items()}
    surface = read(V, "V").subs(values)
    unknown = set().union(surface.free_symbols, *(e.free_symbols for e in field.values())) - set(states)
    if unknown:
        raise ModelError(f"no value of {', '.join(sorted(map(str, unknown)))}: name it in parameters")
    sides = tuple(tuple(map(float, box.get(x, ()))) for x in states)
    if any(len(side) != 2 or not np.isfinite(side).all() for side in sides):
        raise ModelError(f"a picture needs a box with two ends for each of {states[0]}, {states[1]}")
    X, Y = np.meshgrid(*(np.linspace(low, high, POINTS) for low, high in sides))
    real = {x: sp.Symbol(str(x), real=True) for x in states}
    rate = lie_derivative(surface.xreplace(real), {real[x]: e.xreplace(real) for x, e in field.items()})
    heights, rates = (
        _numeric(e, names)(X, Y) for e, names in ((surface, states), (rate, tuple(real.values())))
    )

    figure = Figure(figsize=(13, 6), layout="constrained")
    solid = figure.add_subplot(1, 2, 1, projection="3d")
    solid.plot_surface(X, Y, heights, cmap="viridis", rcount=60, ccount=60, linewidth=0)
    solid.set(xlabel=str(states[0]), ylabel=str(states[1]), zlabel="V")
    plane = figure.add_subplot(1, 2, 2)
    plane.contourf(X, Y, rates > 0, levels=[0.5, 1.5], colors=["mistyrose"])
    plane.clabel(plane.contour(X, Y, heights, levels=12, cmap="viridis", linewidths=0.8), fontsize=7)
    for track in _trajectories(tuple(_numeric(e, states) for e in field.values()), sides):
        plane.plot(*track, color="tab:blue", linewidth=0.8)
        plane.plot(*track[:, :1], marker="o", color="tab:blue", markersize=3)
    if report is not None:
        _findings(plane, report, states, (X, Y, heights))
        e = report.equilibrium
        figure.suptitle(f"{e.status.value}; certificate: {report.certificate.status.value}")
    plane.set(xlabel=str(states[0]), ylabel=str(states[1]), xlim=sides[0], ylim=sides[1])
    plane.set_title("level sets of V, trajectories; red: dV/dt > 0", fontsize=9)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=100)
    return path


def _findings(plane: Any, report: Report, states: tuple[sp.Symbol, ...], grid: tuple[Array, ...]) -> None:
    level, at = report.equilibrium.level, report.certificate.at
    if level is not None and grid[2].min() < float(level) < grid[2].max():
        plane.contour(*grid, levels=[float(level)], colors="black", linewidths=2)
    if at is not None:
        plane.plot(*(float(at[x]) for x in states), marker="x", color="red", markersize=10)


def _numeric(e: sp.Expr, names: tuple[sp.Symbol, ...]) -> Callable[[Array, Array], Array]:
    g = sp.lambdify(names, e, "numpy")
    return lambda x, y: np.asarray(g(x, y) + 0.0 * x, float)


def _trajectories(rates: tuple[Callable[[Array, Array], Array], ...], sides: Any) -> list[Array]:
    from scipy.integrate import solve_ivp  # noqa: PLC0415

    (left, right), (low, high) = sides
    middle, half = np.array([left + right, low + high]) / 2, np.array([right - left, high - low]) / 2

    def f(_t: float, x: Array) -> Array:
        return np.array([float(r(x[0], x[1])) for r in rates])

    def inside(_t: float, x: Array) -> float:
        return 1.2 - float((np.abs(x - middle) / half).max())

    inside.terminal = True  # type: ignore[attr-defined]
    angles = 2 * np.pi * (np.arange(STARTS) + 0.5) / STARTS
    starts = 0.9 * np.array([np.cos(angles), np.sin(angles)])
    tracks = []
    for start in (middle[:, None] + half[:, None] * starts).T:
        slowest = float(np.abs(f(0.0, start) / half).max())
        end = 20.0 / slowest if slowest > 0 else 1.0
        tracks.append(solve_ivp(f, (0.0, end), start, max_step=end / 200, events=inside).y)
    return tracks
