"""Charts of the report page: the plots of the log viewers, and curves computed from several columns."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Rows
from drivers.signals import Mode
from drivers.tick_columns import COLUMNS, RECORDED
from hil.app.configuration.configuration import Configuration
from hil.record.metrics import rotation_errors
from hil.study.log_columns import TIMES, Plot, has_pose, plots
from hil.study.log_columns import Curve as LogCurve
from hil.study.report.story import mode_name
from hil.study.report.timing import Traffic

FLAGS = ("faults", "warnings", "foreign", "setpoint_refusal")
"""Columns of flags; each bit that is ever set has its own line."""
MODES = "Modes, faults and warnings"
DOTTED = ("p_d", "q_d", "dq_d", "drive_force", "lyapunov_bound")
WORDS = {
    "tau": "sent",
    "drive_force": "reported by the drive",
    **dict.fromkeys(("q_d", "dq_d", "p_d"), "reference"),
    **dict.fromkeys(("q", "dq", "p"), "measured"),
    "lyapunov": "V, energy of the tracking error",
    "lyapunov_bound": "largest V that the certificate allows",
    "lyapunov_share": "error, of its certified limit",
    "encoder_share": "length against rate",
    "sensor_share": "sensor",
    "lateness_ns": "wake-up late by",
    "compute_ns": "computing time",
}
"""Column -> its name in the legend of a chart."""


class Curve(NamedTuple):
    """One line of a chart on the report page."""

    label: str
    values: Array
    """(n,) in the chart's unit; NaN: a gap."""
    kind: str = "line"
    """`line`, `dotted`, `steps`, or `area`: steps filled down to the next lower integer."""
    hue: int | None = None
    """Number of the colour, the same for all curves of a leg or axis; default: the place in the chart."""


class Chart(NamedTuple):
    """One chart on the report page: curves with one unit over time."""

    key: str
    section: str
    title: str
    unit: str
    curves: tuple[Curve, ...]
    levels: Sequence[float] = ()
    """Limits, as horizontal lines."""
    names: tuple[tuple[float, str], ...] = ()
    """Names of values on the axis."""
    columns: str = ""
    """Columns of the log that are drawn."""


def charts(rows: Rows, c: Configuration | None, traffic: Traffic, rate_Hz: float) -> list[Chart]:
    """Charts of a run for the report page, without those that have no data. rows (n,) has dtype ROW."""
    return [*columns_over_time(rows, c, rate_Hz), *_bus(traffic, rate_Hz), *_modes(rows)]


def columns_over_time(rows: Rows, c: Configuration | None, rate_Hz: float) -> list[Chart]:
    """Charts of the columns and of the rotation error, without those that have no data."""
    follows = followed(rows)
    return [*_columns(rows, follows, _levels(c, rate_Hz)), *_rotation(rows, follows)]


def followed(rows: Rows) -> Flags:
    """Mask (n,) of the ticks in which the platform follows a reference."""
    return (rows["mode"] >= Mode.RELEASING) & (rows["mode"] <= Mode.PARKING)


def _levels(c: Configuration | None, rate_Hz: float) -> dict[str, Sequence[float]]:
    """{plot title: limits}, drawn as horizontal lines."""
    levels: dict[str, Sequence[float]] = {"Share": (1.0,), TIMES: (1e6 / rate_Hz,)}
    if c is not None:
        force, speed = min(c.limits.force_N, c.drives.force_limit_N), c.limits.speed_m_s
        levels["Leg length"] = (c.platform.length_min_m, c.platform.length_max_m)
        levels |= {"Leg rate": (-speed, speed), "Leg force": (-force, force)}
    return levels


def _columns(rows: Rows, follows: Flags, levels: dict[str, Sequence[float]]) -> Iterator[Chart]:
    """Yield the plots of the log viewers, one chart per unit; references only while they are followed."""
    shown = {
        "p": has_pose(rows, "p", "R"),
        "p_d": follows & has_pose(rows, "p_d", "R_d"),
        "q": (rows["q"] != 0.0).any(axis=1),
        "q_d": follows,
        "dq_d": follows,
    }
    for plot in plots(RECORDED):
        by_unit: dict[str, list[Curve]] = {}
        for curve in plot.curves:
            name = curve.part.column.name
            where = follows if curve.less else shown.get(name, np.ones(len(rows), np.bool_))
            unit, factor = curve.unit, 1.0
            if unit == COLUMNS["t_ns"].unit:
                unit, factor = f"µ{unit[1:]}", 1e-3
            elif plot.tab == "Errors":
                unit, factor = f"m{unit}", 1e3
            kind = "dotted" if name in DOTTED and not curve.less else "line"
            values = np.where(where, factor * curve.of(rows), np.nan)
            if not np.isfinite(values).any() or (name == "drive_force" and not values.any()):
                continue  # not measured
            hue = curve.part.element if curve.part.column.size > 1 else None
            made = Curve(_label(curve, plot), values, kind, hue)
            by_unit.setdefault(unit, []).append(made)
        for unit, curves in by_unit.items():
            if any(np.any(np.isfinite(each.values) & (each.values != 0.0)) for each in curves):
                key, level = f"{plot.title} [{unit}]", levels.get(plot.title, ())
                columns = ", ".join(dict.fromkeys(each.columns for each in plot.curves))
                yield Chart(key, plot.tab, plot.title, unit, tuple(curves), level, columns=columns)


def _label(curve: LogCurve, plot: Plot) -> str:
    """Name of a curve in the legend: `leg 3`, or `leg 3, sent` in a plot of several columns."""
    part = curve.part
    element = part.label.partition(".")[2].replace("_", " ")
    alone = len({each.part.column.name for each in plot.curves}) == 1
    word = WORDS.get(part.column.name, part.column.name)
    return ", ".join(filter(None, (element, "" if alone and element else word)))


def _rotation(rows: Rows, follows: Flags) -> Iterator[Chart]:
    good = follows & has_pose(rows, "p", "R") & has_pose(rows, "p_d", "R_d")
    if good.any():
        e = np.full((len(rows), 3), np.nan)
        e[good] = 1e3 * rotation_errors(rows["R_d"][good], rows["R"][good])
        curves = tuple(Curve(name, e[:, k]) for k, name in enumerate(("rx", "ry", "rz")))
        yield Chart("rotation", "Errors", "Rotation error, rotation vector", "mrad", curves)


def _bus(traffic: Traffic, rate_Hz: float) -> Iterator[Chart]:
    if np.isfinite(traffic.answered_ns).any():
        curve = Curve("last feedback", 1e-3 * traffic.answered_ns)
        title = "Last feedback after the tick's start"
        yield Chart("answered", "Timing", title, "µs", (curve,), (1e6 / rate_Hz,))
    if traffic.busy_ns:
        busy = tuple(Curve(name, 1e-7 * rate_Hz * busy) for name, busy in sorted(traffic.busy_ns.items()))
        title = "Bus load: worst-case wire time of a tick's frames, share of the period"
        yield Chart("bus", "Timing", title, "%", busy, (100.0,))


def _modes(rows: Rows) -> Iterator[Chart]:
    there, values = np.unique(rows["mode"], return_inverse=True)
    names = tuple((float(k), mode_name(mode)) for k, mode in enumerate(there.tolist()))
    steps = Curve("mode", values.astype(np.float64), "steps")
    yield Chart("mode", MODES, COLUMNS["mode"].meaning, "", (steps,), (), names)
    found = lanes(rows)
    if found:
        curves = tuple(
            Curve(label, np.asarray(k + 0.8 * there, float), "area") for k, (label, there) in enumerate(found)
        )
        names = tuple((k + 0.4, label) for k, (label, _) in enumerate(found))
        title = "faults, warnings and other bits, one line each"
        yield Chart("flags", MODES, title, "", curves, (), names)


def lanes(rows: Rows) -> list[tuple[str, Flags]]:
    """Bits of FLAGS that are ever set: label with column and bit, and mask (n,) of the ticks with the bit."""
    bits = [(name, text, bit) for name in FLAGS for text, bit in COLUMNS[name].names.items()]
    found = [(f"{name} {text}", (rows[name] & bit) != 0) for name, text, bit in bits]
    return [(label, there) for label, there in found if there.any()]
