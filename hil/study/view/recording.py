"""Writes a log as a Rerun recording: scalars and states by name, events, the moving robot, and views.

The log is never in memory as a whole: columns are written some thousand rows at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import ConfigurationError, LogError, ModelError
from drivers.tick_columns import Column
from hil.app.configuration.configuration import loads
from hil.app.configuration.platform import platform_dict
from hil.record.log import Log
from hil.record.scene import around, quaternion
from hil.record.schema import CONFIGURATION
from hil.record.selection import Component, components, name_of
from hil.study.log_columns import Curve, Plot, differences, has_pose, plots, row_groups, states

APPLICATION = "hexapod-hil"
SCENE = "/robot"
"""Entity of the robot, in the base frame."""
EVENTS = "/events"
DIFFERENCES = "/differences"
"""Entity of differences between columns."""
TIME = "log_time"
"""Time line that is shown: UTC."""

FIRST = ("mode", "command_mode", "faults", "warnings")
"""States next to the robot; all of them have a tab."""
TICK = "tick"
"""Time line of tick numbers; the other one is UTC."""
GROUP = 8192
"""Rows written at a time."""
POSES_PER_S = 100
"""Largest rate of the moving parts."""
THICKNESS = 0.03
"""Line width of the robot, as a share of the base's radius."""
_GREY, _BLUE, _ORANGE, _PALE = (115, 122, 133), (31, 107, 181), (237, 140, 36), (31, 107, 181, 90)


def write_rrd(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components of a log (no names: all) as a Rerun recording; return the number of rows.

    Every component is an entity, `/tick/tau/leg_3`. Enumerations and flags are states, written when they
    change. The robot moves under `/robot`; the file contains the blueprint of the views.

    Raises LogError: rerun-sdk is not installed, unknown column, or damaged log.
    """
    try:
        import rerun as rr  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise LogError(
            f"{path.name}: a Rerun recording needs rerun-sdk, which is not installed ({error}): "
            'pip install "hexapod-hil[viewers]", or export .csv'
        ) from error
    parts = components(log.columns, names, str(log.path))
    return _Writer(rr, log, path, parts).write()


class _Writer:
    """Writes one Rerun recording. Mutable state: the stream, the last states and pose, pending events."""

    def __init__(self, rr: Any, log: Log, path: Path, parts: Sequence[Component]) -> None:
        self._rr, self._log = rr, log
        chosen = {part.label for part in parts}
        self._curves = [Curve(part.label, part.unit, part) for part in parts if not part.column.names]
        self._curves += [
            curve
            for curve in differences(log.columns)
            if curve.less and {curve.part.label, curve.less.label} <= chosen
        ]
        self._named = [part for part in parts if part.column.names]
        poses = [c.name for c in log.columns if c.name in ("p", "R", "p_d", "R_d")]
        self._poses = components(log.columns, poses, "") if poses else []
        self._last: dict[str, int] = {}
        self._events = sorted(log.events())
        self._joints = _joints(log)
        self._slot = -(2**62)
        self._stream = rr.RecordingStream(APPLICATION)
        self._stream.save(path, blueprint(log.columns, log.topic, scene=self._joints is not None))

    def write(self) -> int:
        """Write the whole log; return the number of rows."""
        try:
            self._fixed()
            wanted = [*(curve.part for curve in self._curves), *self._named, *self._poses]
            count = 0
            for rows in row_groups(self._log, wanted, GROUP):
                self._rows(rows)
                count += len(rows)
                self._stream.flush()
            return count
        finally:
            self._stream.disconnect()

    def _fixed(self) -> None:
        """Write the data that do not change: names with units, meanings, and rigid shapes."""
        rr, stream = self._rr, self._stream
        stream.send_recording_name(self._log.path.name)
        for curve in self._curves:
            path = curve_path(self._log.topic, curve)
            stream.log(path, rr.SeriesLines(names=curve.title), static=True)
            if curve.less is None:
                stream.log(path, rr.AnyValues(meaning=curve.part.column.meaning), static=True)
        if self._joints is not None:
            self._robot(*self._joints)

    def _robot(self, a: Array, b: Array) -> None:
        """Write the robot's rigid shapes; a, b (n, 3) m: joints in base and platform frame."""
        rr, thin = self._rr, THICKNESS * float(np.linalg.norm(a, axis=1).max()) / 2.0
        self._stream.log(SCENE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for name, joints, radius, colour in (
            ("base", a, thin, _GREY), ("platform", b, thin, _BLUE), ("reference", b, thin / 2.0, _PALE),
        ):  # fmt: skip
            ring = rr.LineStrips3D([outline(joints)], radii=radius, colors=[colour])
            self._stream.log(f"{SCENE}/{name}", ring, static=True)
        # of moving legs only the ends are written again
        legs = rr.LineStrips3D.from_fields(radii=[thin] * len(a), colors=[_ORANGE] * len(a))
        self._stream.log(f"{SCENE}/legs", legs, static=True)

    def _rows(self, rows: Rows) -> None:
        for curve in self._curves:
            scalars = self._rr.Scalars.columns(scalars=curve.of(rows))
            self._send(curve_path(self._log.topic, curve), rows, scalars)
        for part in self._named:
            self._states(part, rows)
        self._happened(rows)
        if self._joints is not None:
            self._moved(rows, *self._joints)

    def _states(self, part: Component, rows: Rows) -> None:
        """Write an enumeration or flags at the ticks in which the value changes."""
        values = part.of(rows).astype(np.int64)
        changed = np.flatnonzero(np.diff(values, prepend=self._last.get(part.label, ~values[0])))
        self._last[part.label] = int(values[-1])
        if len(changed):
            names = [name_of(part.column, number) for number in values[changed].tolist()]
            columns = self._rr.StateChange.columns(state=names)
            self._send(path_of(self._log.topic, part.label), rows[changed], columns)

    def _happened(self, rows: Rows) -> None:
        """Write the events up to the last row, each with its own time and the tick at that time."""
        end = int(rows["t_ns"][-1])
        events = [event for event in self._events if event.t_ns <= end]
        self._events = self._events[len(events) :]
        if events:
            t_ns = np.array([event.t_ns for event in events], np.int64)
            place = np.minimum(np.searchsorted(rows["t_ns"], t_ns), len(rows) - 1)
            then = rows[["tick", "t_ns"]][place]
            then["t_ns"] = t_ns
            levels = [{"warning": "WARN"}.get(event.level, event.level.upper()) for event in events]
            texts = [event.text for event in events]
            self._send(EVENTS, then, self._rr.TextLog.columns(text=texts, level=levels))

    def _moved(self, rows: Rows, a: Array, b: Array) -> None:
        """Write poses and legs, at most POSES_PER_S per second."""
        slots = rows["t_ns"] // (1_000_000_000 // POSES_PER_S)
        rows = rows[np.diff(slots, prepend=self._slot) != 0]
        self._slot = int(slots[-1])
        for name, p, R in (("platform", "p", "R"), ("reference", "p_d", "R_d")):
            there = rows[has_pose(rows, p, R)] if p in (rows.dtype.names or ()) else rows[:0]
            if len(there):
                turned = [quaternion(rotation.reshape(3, 3)) for rotation in there[R]]
                columns = self._rr.Transform3D.columns(translation=there[p], quaternion=turned)
                self._send(f"{SCENE}/{name}", there, columns)
        there = rows[has_pose(rows, "p", "R")]
        if len(there):
            tops = there["p"][:, None, :] + np.einsum("nij,kj->nki", there["R"].reshape(-1, 3, 3), b)
            strips = np.stack((np.broadcast_to(a, tops.shape), tops), axis=2)
            columns = self._rr.LineStrips3D.columns(strips=list(strips.reshape(-1, 2, 3)))
            self._send(f"{SCENE}/legs", there, columns.partition([len(a)] * len(there)))

    def _send(self, entity: str, rows: Rows, columns: Any) -> None:
        """Write columns at the ticks and UTC times of rows."""
        times = (rows["t_ns"] + self._log.epoch_ns).astype("datetime64[ns]")
        tick = self._rr.TimeColumn(TICK, sequence=rows["tick"])
        index = [tick, self._rr.TimeColumn(TIME, timestamp=times)]
        self._rr.send_columns(entity, index, columns, recording=self._stream, strict=True)


def _joints(log: Log) -> tuple[Array, Array] | None:
    """Joints (n, 3) m of base and platform; None if the log has no pose or no valid configuration."""
    if not {"p", "R"} <= {c.name for c in log.columns}:
        return None
    try:
        robot = platform_dict(loads(log.configuration, f"{log.path}:{CONFIGURATION}").platform)
    except (LogError, ConfigurationError, ModelError):
        return None
    return np.array(robot["base_joints"], float), np.array(robot["platform_joints"], float)


def outline(joints: Array) -> Array:
    """Closed line (n + 1, 3) m through joints (n, 3) m, ordered by angle about their centre."""
    ring = joints[around(joints)]
    return np.concatenate((ring, ring[:1]))


def blueprint(columns: Sequence[Column], topic: str, *, scene: bool) -> Any:
    """Rerun blueprint of the views for a log's columns; scene: with the 3D view. Needs rerun-sdk."""
    from rerun import blueprint as rrb  # noqa: PLC0415 - an extra

    named = [c.name for c in states(columns)]
    views: list[tuple[Any, int]] = [(rrb.Spatial3DView(origin=SCENE, name="Robot"), 4)] if scene else []
    first = [name for name in named if name in FIRST]
    if first:
        views.append((_states(rrb, topic, first, "State"), 2))
    views.append((rrb.TextLogView(origin=EVENTS, name="Events"), 1))
    tabs: dict[str, list[Plot]] = {}
    for plot in plots(columns):
        tabs.setdefault(plot.tab, []).append(plot)
    pages: list[Any] = [
        rrb.Vertical(*(_plot(rrb, plot, topic) for plot in members), name=tab)
        for tab, members in tabs.items()
    ]
    if named:
        pages.append(_states(rrb, topic, named, "States"))
    pages.append(rrb.DataframeView(origin=topic, name="All columns"))
    left, shares = zip(*views, strict=True)
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*left, row_shares=shares), rrb.Tabs(*pages)),
        rrb.TimePanel(timeline=TIME, state="collapsed"),
        collapse_panels=True,
    )


def _states(rrb: Any, topic: str, names: Sequence[str], title: str) -> Any:
    return rrb.StateTimelineView(origin="/", contents=[f"+ {topic}/{name}/**" for name in names], name=title)


def _plot(rrb: Any, plot: Plot, topic: str) -> Any:
    contents = [f"+ {curve_path(topic, curve)}" for curve in plot.curves]
    return rrb.TimeSeriesView(origin="/", contents=contents, name=plot.title)


def path_of(topic: str, label: str) -> str:
    """Rerun entity path of a log component, e.g. `/tick/tau/leg_3`."""
    return f"{topic}/{label.replace('.', '/')}"


def curve_path(topic: str, curve: Curve) -> str:
    """Rerun entity path of a curve; e.g. `/differences/q_d-q/leg_3` for a difference."""
    if curve.less is None:
        return path_of(topic, curve.label)
    element = curve.part.label.removeprefix(curve.part.column.name)
    return path_of(DIFFERENCES, f"{curve.part.column.name}-{curve.less.column.name}{element}")
