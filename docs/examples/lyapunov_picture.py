"""A system of two states as a picture: V as a surface, its level sets, the sign of dV/dt, trajectories.

Run: python docs/examples/lyapunov_picture.py pendulum.png

What is drawn is floating point and proves nothing; the title is the finding, which is proven.
"""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from drivers.arrays import Array
from hil.proof import Report, verify
from hil.proof.cancellation import lie_derivative

POINTS = 161
"""Of the grid, on each side."""
STARTS = 16
"""Trajectories, from points on the edge of the box."""


def draw(
    f: Mapping[sp.Symbol, sp.Expr],
    V: sp.Expr,
    box: Mapping[sp.Symbol, tuple[float, float]],
    path: Path,
    report: Report | None = None,
) -> Path:
    """Draw V, its level sets and trajectories of dx/dt = f(x), of two states within a box."""
    states = first, second = tuple(f)
    sides = (box[first], box[second])
    X, Y = np.meshgrid(*(np.linspace(low, high, POINTS) for low, high in sides))
    real = {x: sp.Symbol(str(x), real=True) for x in states}
    rate = lie_derivative(V.xreplace(real), {real[x]: e.xreplace(real) for x, e in f.items()})
    heights, rates = _numeric(V, states)(X, Y), _numeric(rate, tuple(real.values()))(X, Y)

    figure = Figure(figsize=(13, 6), layout="constrained")
    solid = figure.add_subplot(1, 2, 1, projection="3d")
    solid.plot_surface(X, Y, heights, cmap="viridis", rcount=60, ccount=60, linewidth=0)
    solid.set(xlabel=str(states[0]), ylabel=str(states[1]), zlabel="V")
    plane = figure.add_subplot(1, 2, 2)
    plane.contourf(X, Y, rates > 0, levels=[0.5, 1.5], colors=["mistyrose"])
    plane.clabel(plane.contour(X, Y, heights, levels=12, cmap="viridis", linewidths=0.8), fontsize=7)
    for track in _trajectories(tuple(_numeric(e, states) for e in f.values()), sides):
        plane.plot(*track, color="tab:blue", linewidth=0.8)
        plane.plot(*track[:, :1], marker="o", color="tab:blue", markersize=3)
    if report is not None:
        _findings(plane, report, states, (X, Y, heights))
        e = report.equilibrium
        figure.suptitle(f"{e.status.value}; certificate: {report.certificate.status.value}")
    plane.set(xlabel=str(states[0]), ylabel=str(states[1]), xlim=sides[0], ylim=sides[1])
    plane.set_title("level sets of V, trajectories; red: dV/dt > 0", fontsize=9)
    figure.savefig(path, dpi=100)
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


if __name__ == "__main__":
    theta, omega = sp.symbols("theta omega")
    f, V = {theta: omega, omega: -omega / 2 - sp.sin(theta)}, 1 - sp.cos(theta) + omega**2 / 2
    box = {theta: (-3.0, 3.0), omega: (-3.0, 3.0)}
    print(draw(f, V, box, Path(sys.argv[1]), verify(f, V, box=box)))
