"""Picture of a workspace: three sections with the limits on their edges, tilt and torsion."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.files import whole_file
from hil.study.workspace.limits import FREE, KINDS
from hil.study.workspace.maps import Workspace
from hil.study.workspace.position import CrossSection

COLOURS = ("tab:red", "tab:purple", "tab:orange", "black", "tab:cyan")
"""Colours of KINDS, in their order."""


def draw(w: Workspace, path: Path, title: str) -> Path:
    """Draw a workspace into a PNG file. Raises OSError if the file cannot be written."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second
    from matplotlib.lines import Line2D  # noqa: PLC0415

    figure = Figure(figsize=(15, 9.5), layout="constrained")
    top = [figure.add_subplot(2, 3, k) for k in (1, 2, 3)]
    seen = np.concatenate([s.condition[np.isfinite(s.condition)] for s in w.sections])
    ends = (float(seen.min()), float(np.percentile(seen, 99)) * 1.0001)
    (colours, *_) = [_section(axes, w, s, ends) for axes, s in zip(top, w.sections, strict=True)]
    figure.colorbar(colours, ax=top, shrink=0.8, extend="max", label="condition number of J, lengths / r")
    _tilt(figure.add_subplot(2, 3, 4, projection="polar"), w)
    _torsion(figure.add_subplot(2, 3, (5, 6)), w)
    shares, used = w.positions.shares, {*w.positions.kinds.tolist(), *w.orientations.kinds.ravel().tolist()}
    keys: list[dict[str, Any]] = [
        {"marker": "o", "linestyle": "", "color": COLOURS[k], "label": f"{name} {100 * shares[name]:.0f} %"}
        for k, name in enumerate(KINDS)
        if k in used
    ]
    keys += [
        {"marker": "+", "linestyle": "", "color": "black", "label": "home"},
        {"color": "white", "label": "largest sphere"},
        {"color": "white", "linestyle": "--", "label": "largest cylinder"},
    ]
    handles = [Line2D([], [], **key) for key in keys]
    legend = figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    legend.get_frame().set_facecolor("lightgrey")
    figure.suptitle(title)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=100)
    return path


def _section(axes: Any, w: Workspace, section: CrossSection, ends: tuple[float, float]) -> Any:
    from matplotlib.patches import Circle, Rectangle  # noqa: PLC0415

    u, v = section.plane
    i, j = "xyz".index(u), "xyz".index(v)
    shade = np.ma.masked_invalid(section.condition.T)
    colours = axes.pcolormesh(
        section.u, section.v, shade, shading="nearest", vmin=ends[0], vmax=ends[1], cmap="viridis"
    )
    axes.scatter(*section.points.T, s=2.5, c=[COLOURS[k] for k in section.kinds])
    p, cylinder = w.surveyor.p, w.cylinder
    axes.plot(p[i], p[j], "k+", markersize=10)
    outline: dict[str, Any] = {"fill": False, "edgecolor": "white", "linewidth": 1.3}
    axes.add_patch(Circle((p[i], p[j]), w.sphere.radius, **outline))
    if v == "z":
        corner = (p[i] - cylinder.radius, p[j] + cylinder.low)
        size = (2 * cylinder.radius, cylinder.high - cylinder.low)
        axes.add_patch(Rectangle(corner, *size, linestyle="--", **outline))
    else:
        axes.add_patch(Circle((p[i], p[j]), cylinder.radius, linestyle="--", **outline))
    third = 3 - i - j
    axes.set(xlabel=f"{u} [m]", ylabel=f"{v} [m]", aspect="equal")
    axes.locator_params(nbins=6)
    axes.set_title(f"{u}-{v} through home ({'xyz'[third]} = {p[third]:g} m); edge: the limit met")
    axes.grid(alpha=0.3)
    return colours


def _tilt(axes: Any, w: Workspace) -> None:
    o = w.orientations
    closed = np.append(o.azimuth, o.azimuth[0] + 2 * np.pi)
    axes.plot(closed, np.rad2deg(np.append(o.level, o.level[0])), color="grey", linewidth=0.8)
    met = o.kinds[len(o.torsion) // 2] != FREE
    colours = [COLOURS[k] for k in o.kinds[len(o.torsion) // 2][met]]
    axes.scatter(o.azimuth[met], np.rad2deg(o.level[met]), s=12, c=colours)
    axes.fill(closed, np.full(len(closed), np.rad2deg(o.level.min())), alpha=0.2)
    at = ", ".join(f"{x:g}" for x in o.position)
    axes.set_title(f"tilt without torsion [deg], by azimuth\nat ({at}) m")
    axes.set_ylim(bottom=0)


def _torsion(axes: Any, w: Workspace) -> None:
    o = w.orientations
    torsion = np.rad2deg(o.torsion)
    axes.fill_between(torsion, np.rad2deg(o.guaranteed), alpha=0.4, label="tilt in every direction")
    axes.plot(torsion, np.rad2deg(o.tilt.max(axis=1)), label="tilt in the best direction")
    axes.set(xlabel="torsion [deg]", ylabel="tilt [deg]", title="tilt and torsion together")
    axes.set_ylim(bottom=0)
    axes.legend()
    axes.grid(alpha=0.3)
