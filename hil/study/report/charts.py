"""Which curves the page shows. Names and units come from the table of columns."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from drivers.signals import Mode
from drivers.tick_columns import COLUMNS, Column
from hil.app.configuration.configuration import Configuration
from hil.record.metrics import rotation_errors
from hil.study.report.scene import has_pose
from hil.study.report.story import mode_name
from hil.study.report.timeline import lanes
from hil.study.report.timing import Traffic

PREFIXES = {"m": 1e-3, "µ": 1e-6}
"""SI, of lengths, turns and times; forces stand in N, of robots of any size."""


class Curve(NamedTuple):
    """One line of a chart."""

    label: str
    values: Array
    """(n,) in the chart's unit; nan: a gap."""
    kind: str = "line"
    """`line`, `dotted`, `steps`, or `area`: steps that are filled to the whole number below."""


class Chart(NamedTuple):
    """Curves of one unit over time."""

    key: str
    section: str
    title: str
    unit: str
    curves: tuple[Curve, ...]
    levels: tuple[float, ...] = ()
    """Limits, as horizontal lines."""
    names: tuple[tuple[float, str], ...] = ()
    """What values of the axis are called."""


def charts(rows: Rows, c: Configuration | None, traffic: Traffic, rate_Hz: float) -> list[Chart]:
    """Return the charts of a run in their order. rows has dtype ROW; what a run does not have is left out."""
    return [
        *_tracking(rows, c),
        *_forces(rows, c),
        *_certificate(rows),
        *_modes(rows),
        *_time(rows, traffic, rate_Hz),
    ]


def _scale(unit: str, prefix: str) -> tuple[str, float]:
    """Return a unit with a prefix, one of nano seconds too, and what its numbers are multiplied with."""
    base, size = (unit[1:], 1e-9) if unit == COLUMNS["t_ns"].unit else (unit, 1.0)
    return prefix + base, size / PREFIXES[prefix]


def _legs(column: Column, values: Array, factor: float = 1.0) -> tuple[Curve, ...]:
    return tuple(Curve(name, factor * values[:, k]) for k, name in enumerate(column.elements))


def _tracking(rows: Rows, c: Configuration | None) -> Iterator[Chart]:
    follows = (rows["mode"] >= Mode.RELEASING) & (rows["mode"] <= Mode.PARKING)
    p, q, dq = COLUMNS["p"], COLUMNS["q"], COLUMNS["dq"]
    section, following = "Tracking", "reference less measured, while a reference is followed"

    def only(values: Array, where: NDArray[np.bool_] = follows) -> Array:
        return np.where(where[:, None], values, np.nan)

    if follows.any():
        unit, factor = _scale(p.unit, "m")
        yield Chart(
            "e_p",
            section,
            f"position error: {following}",
            unit,
            _legs(p, only(rows["p_d"] - rows["p"]), factor),
        )
        pose = COLUMNS["pose_std"]
        unit, factor = _scale(pose.units[3], "m")
        e = np.full((len(rows), 3), np.nan)
        good = follows & has_pose(rows, "p", "R") & has_pose(rows, "p_d", "R_d")
        e[good] = rotation_errors(rows["R_d"][good], rows["R"][good])
        curves = tuple(Curve(name, factor * e[:, k]) for k, name in enumerate(pose.elements[3:]))
        yield Chart("e_R", section, f"rotation error, rotation vector: {following}", unit, curves)
        unit, factor = _scale(q.unit, "m")
        yield Chart(
            "e_q", section, f"leg error: {following}", unit, _legs(q, only(rows["q_d"] - rows["q"]), factor)
        )
    posed = only(rows["p"], has_pose(rows, "p", "R"))
    reference = only(rows["p_d"], follows & has_pose(rows, "p_d", "R_d"))
    curves = _legs(p, posed) + tuple(Curve(f"{x}, reference", y, "dotted") for x, y, _ in _legs(p, reference))
    yield Chart("p", section, p.meaning, p.unit, curves)
    heard = only(rows["q"], (rows["q"] != 0.0).any(axis=1))
    ends = () if c is None else (c.platform.length_min_m, c.platform.length_max_m)
    yield Chart("q", section, q.meaning, q.unit, _legs(q, heard), ends)
    ends = () if c is None else (-c.limits.speed_m_s, c.limits.speed_m_s)
    yield Chart("dq", section, dq.meaning, dq.unit, _legs(dq, rows["dq"]), ends)


def _forces(rows: Rows, c: Configuration | None) -> Iterator[Chart]:
    section = "Forces"
    for name in ("tau", "drive_force"):
        column = COLUMNS[name]
        limit = () if c is None else (min(c.limits.force_N, c.drives.force_limit_N),)
        yield Chart(
            name,
            section,
            column.meaning,
            column.unit,
            _legs(column, rows[name]),
            (*(-x for x in limit), *limit),
        )
    column = COLUMNS["wrench"]
    if np.any(rows["wrench"]):
        for first, what in ((0, "force"), (3, "moment")):
            title = f"{column.meaning}: {what}"
            curves = _legs(column, rows["wrench"])[first : first + 3]
            yield Chart(f"wrench_{what}", section, title, column.units[first], curves)


def _certificate(rows: Rows) -> Iterator[Chart]:
    V, bound, share = (COLUMNS[name] for name in ("lyapunov", "lyapunov_bound", "lyapunov_share"))
    section = "Stability certificate"
    if np.isfinite(rows[V.name]).any():
        curves = (Curve("V", rows[V.name]), Curve("bound", rows[bound.name], "dotted"))
        yield Chart("V", section, f"{V.meaning}, and {bound.meaning}", V.unit, curves)
    if np.isfinite(rows[share.name]).any():
        yield Chart("share", section, share.meaning, share.unit, (Curve("share", rows[share.name]),), (1.0,))


def _modes(rows: Rows) -> Iterator[Chart]:
    section, column = "Modes, faults and warnings", COLUMNS["mode"]
    there = sorted(set(rows["mode"].tolist()))
    place = {mode: float(k) for k, mode in enumerate(there)}
    values = np.array([place[mode] for mode in rows["mode"].tolist()], np.float64)
    names = tuple((float(k), mode_name(mode)) for k, mode in enumerate(there))
    yield Chart("mode", section, column.meaning, "", (Curve(column.name, values, "steps"),), (), names)
    found = lanes(rows)
    if found:
        curves = tuple(Curve(lane.label, k + 0.8 * lane.values, "area") for k, lane in enumerate(found))
        names = tuple((k + 0.4, lane.label) for k, lane in enumerate(found))
        yield Chart(
            "flags", section, "faults, warnings and what else was set, one line each", "", curves, (), names
        )


def _time(rows: Rows, traffic: Traffic, rate_Hz: float) -> Iterator[Chart]:
    section = "Time and bus"
    lateness, compute, stretched = (COLUMNS[name] for name in ("lateness_ns", "compute_ns", "stretched_ns"))
    unit, factor = _scale(lateness.unit, "µ")
    curves = [
        Curve(column.meaning, factor * rows[column.name].astype(np.float64))
        for column in (lateness, compute)
        if rows[column.name].any()
    ]
    if np.isfinite(traffic.answered_ns).any():
        curves.append(Curve("last feedback after the tick's start", factor * traffic.answered_ns))
    if curves:
        yield Chart("time", section, "wake-up, computing, feedback", unit, tuple(curves), (1e6 / rate_Hz,))
    if rows[stretched.name].any():
        unit, factor = _scale(stretched.unit, "m")
        curve = Curve(stretched.name, factor * rows[stretched.name].astype(np.float64))
        yield Chart("stretched", section, stretched.meaning, unit, (curve,))
    if traffic.busy_ns:
        busy = tuple(Curve(name, 1e-7 * rate_Hz * busy) for name, busy in sorted(traffic.busy_ns.items()))
        title = "bus load: worst-case wire time of a tick's frames, of its period"
        yield Chart("bus", section, title, "%", busy, (100.0,))
    columns = [COLUMNS[name] for name in ("rejected", "sends_failed", "bus_errors", "bus_overflow")]
    counted = tuple(
        Curve(column.meaning, rows[column.name].astype(np.float64))
        for column in columns
        if rows[column.name].any()
    )
    if counted:
        yield Chart("refused", section, "frames refused, not taken, in error or lost", "", counted)
