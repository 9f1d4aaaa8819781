"""A log as a Rerun recording: scalars by name, states by name, events, and the robot that moves.

The whole log is never in memory: columns go out some thousand rows at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import ConfigurationError, LogError, ModelError
from hil.app.configuration.configuration import loads
from hil.app.configuration.platform import platform_dict
from hil.record.log import Log
from hil.record.scene import quaternion
from hil.record.schema import CONFIGURATION
from hil.record.selection import Component, components, name_of
from hil.robot.around import around
from hil.study.log_columns import titled
from hil.study.report.scene import has_pose
from hil.study.row_groups import row_groups
from hil.study.view.blueprint import EVENTS, SCENE, TIME, blueprint, difference_path, scalar_path
from hil.study.view.panels import differences

APPLICATION = "hexapod-hil"
TICK = "tick"
"""Time line: number of the tick; the other one is UTC."""
GROUP = 8192
"""Rows that are written together."""
POSES_PER_S = 100
"""Of the moving parts, at most."""
THICKNESS = 0.03
"""Of the lines of the robot, as a share of the base's radius."""
_GREY, _BLUE, _ORANGE, _PALE = (115, 122, 133), (31, 107, 181), (237, 140, 36), (31, 107, 181, 90)


def write_rrd(log: Log, path: Path, names: Sequence[str]) -> int:
    """Write columns or components by name (none: all) as a Rerun recording; return the number of rows.

    Every component is an entity, `/tick/tau/leg_3`; what has names is a state, written where it changes. The
    robot moves under `/robot`; the blueprint of the views is in the file.

    Raises LogError: rerun-sdk is not installed, no such column, or the log is damaged.
    """
    try:
        import rerun as rr  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise LogError(
            f"{path.name}: a Rerun recording needs rerun-sdk, which is not installed ({error}): "
            'pip install "hexapod-hil[viewers]"; .csv needs nothing'
        ) from error
    parts = components(log.columns, names, str(log.path))
    return _Writer(rr, log, path, parts).write()


class _Writer:
    """One recording being written. State: the stream, the last states, events not yet written."""

    def __init__(self, rr: Any, log: Log, path: Path, parts: Sequence[Component]) -> None:
        self._rr, self._log = rr, log
        self._numbers = [part for part in parts if not part.column.names]
        self._named = [part for part in parts if part.column.names]
        chosen = {part.label for part in parts}
        self._differences = [
            curve
            for curve in differences(log.columns)
            if curve.less and {curve.part.label, curve.less.label} <= chosen
        ]
        poses = [c.name for c in log.columns if c.name in ("p", "R", "p_d", "R_d")]
        self._poses = components(log.columns, poses, "") if poses else []
        self._last: dict[str, int] = {}
        self._events = sorted(log.events())
        self._joints = _joints(log)
        self._next_pose_ns = -(2**62)
        self._stream = rr.RecordingStream(APPLICATION)
        self._stream.save(path, blueprint(log.columns, log.topic, scene=self._joints is not None))

    def write(self) -> int:
        """Write all of the log; return the number of rows."""
        try:
            self._fixed()
            wanted = [*self._numbers, *self._named, *self._poses]
            count = 0
            for rows in row_groups(self._log, wanted, GROUP):
                self._rows(rows)
                count += len(rows)
                self._stream.flush()
            return count
        finally:
            self._stream.disconnect()

    def _fixed(self) -> None:
        """Write what holds at all times: names with units, meanings, and the parts that do not move."""
        rr, stream, topic = self._rr, self._stream, self._log.topic
        stream.send_recording_name(self._log.path.name)
        for part in self._numbers:
            title = titled(part.label, part.unit)
            stream.log(scalar_path(topic, part), rr.SeriesLines(names=title), static=True)
            if part.column.meaning:  # a log of 0.1.0 has none
                stream.log(scalar_path(topic, part), rr.AnyValues(meaning=part.column.meaning), static=True)
        for curve in self._differences:
            stream.log(difference_path(curve), rr.SeriesLines(names=curve.title), static=True)
        if self._joints is not None:
            self._robot(*self._joints)

    def _robot(self, a: Array, b: Array) -> None:
        """Write the parts that keep their shape; joints (n, 3) m in their own frames."""
        rr, stream = self._rr, self._stream
        thick = THICKNESS * float(np.linalg.norm(a, axis=1).max())
        stream.log(SCENE, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        base = rr.LineStrips3D([outline(a)], radii=thick / 2.0, colors=[_GREY])
        stream.log(f"{SCENE}/base", base, static=True)
        platform = rr.LineStrips3D([outline(b)], radii=thick / 2.0, colors=[_BLUE])
        stream.log(f"{SCENE}/platform", platform, static=True)
        # of the legs that move only the ends are written anew
        legs = rr.LineStrips3D.from_fields(radii=[thick / 2.0] * len(a), colors=[_ORANGE] * len(a))
        stream.log(f"{SCENE}/legs", legs, static=True)
        ghost = rr.LineStrips3D([outline(b)], radii=thick / 4.0, colors=[_PALE])
        stream.log(f"{SCENE}/reference", ghost, static=True)

    def _rows(self, rows: Rows) -> None:
        index, topic = self._index(rows["tick"], rows["t_ns"]), self._log.topic
        for part in self._numbers:
            self._send(scalar_path(topic, part), index, self._rr.Scalars.columns(scalars=part.of(rows)))
        for curve in self._differences:
            self._send(difference_path(curve), index, self._rr.Scalars.columns(scalars=curve.of(rows)))
        for part in self._named:
            self._states(part, rows)
        self._happened(rows)
        if self._joints is not None:
            self._moved(rows, *self._joints)

    def _states(self, part: Component, rows: Rows) -> None:
        """Write a state where it changes."""
        values = part.of(rows)
        before = self._last.get(part.label)
        changed = np.flatnonzero(np.diff(values, prepend=values[0]))
        if before is None or before != values[0]:
            changed = np.concatenate(([0], changed))
        self._last[part.label] = int(values[-1])
        if len(changed):
            names = [name_of(part.column, number) for number in values[changed].tolist()]
            index = self._index(rows["tick"][changed], rows["t_ns"][changed])
            self._send(scalar_path(self._log.topic, part), index, self._rr.StateChange.columns(state=names))

    def _happened(self, rows: Rows) -> None:
        """Write the events up to the last row, each at its own time and the tick then."""
        end = int(rows["t_ns"][-1])
        count = next((i for i, event in enumerate(self._events) if event.t_ns > end), len(self._events))
        events, self._events = self._events[:count], self._events[count:]
        if events:
            t_ns = np.array([event.t_ns for event in events], np.int64)
            place = np.minimum(np.searchsorted(rows["t_ns"], t_ns), len(rows) - 1)
            levels = [{"warning": "WARN"}.get(event.level, event.level.upper()) for event in events]
            columns = self._rr.TextLog.columns(text=[event.text for event in events], level=levels)
            self._send(EVENTS, self._index(rows["tick"][place], t_ns), columns)

    def _moved(self, rows: Rows, a: Array, b: Array) -> None:
        """Write poses and legs, at most POSES_PER_S."""
        rows = rows[self._at_pose_rate(rows["t_ns"].tolist())]
        for name, p, R in (("platform", "p", "R"), ("reference", "p_d", "R_d")):
            there = _posed(rows, p, R)
            if len(there):
                turned = [quaternion(rotation.reshape(3, 3)) for rotation in there[R]]
                columns = self._rr.Transform3D.columns(translation=there[p], quaternion=turned)
                self._send(f"{SCENE}/{name}", self._index(there["tick"], there["t_ns"]), columns)
        there = _posed(rows, "p", "R")
        if len(there):
            strips = _legs(there, a, b)
            n, count = strips.shape[:2]
            columns = self._rr.LineStrips3D.columns(strips=list(strips.reshape(n * count, 2, 3)))
            index = self._index(there["tick"], there["t_ns"])
            self._send(f"{SCENE}/legs", index, columns.partition([count] * n))

    def _at_pose_rate(self, times_ns: Sequence[int]) -> list[int]:
        kept = []
        for i, t_ns in enumerate(times_ns):
            if t_ns >= self._next_pose_ns:
                kept.append(i)
                self._next_pose_ns = t_ns + 1_000_000_000 // POSES_PER_S
        return kept

    def _index(self, tick: Any, t_ns: Any) -> list[Any]:
        times = (t_ns + self._log.epoch_ns).astype("datetime64[ns]")
        return [self._rr.TimeColumn(TICK, sequence=tick), self._rr.TimeColumn(TIME, timestamp=times)]

    def _send(self, entity: str, index: list[Any], columns: Any) -> None:
        self._rr.send_columns(entity, index, columns, recording=self._stream, strict=True)


def _joints(log: Log) -> tuple[Array, Array] | None:
    """Return the joints of base and platform (n, 3) m; None where the log has no pose or names no robot."""
    if not {"p", "R"} <= {c.name for c in log.columns}:
        return None
    try:
        robot = platform_dict(loads(log.configuration, f"{log.path}:{CONFIGURATION}").platform)
    except (LogError, ConfigurationError, ModelError):
        return None
    return np.array(robot["base_joints"], float), np.array(robot["platform_joints"], float)


def outline(joints: Array) -> Array:
    """Joints (n, 3) m by their angle about their centre, the first once more at the end."""
    ring = joints[around(joints)]
    return np.concatenate((ring, ring[:1]))


def _posed(rows: Rows, p: str, R: str) -> Rows:
    """Rows that hold a pose; none where the columns are missing."""
    there = {p, R} <= set(rows.dtype.names or ())
    found: Rows = rows[has_pose(rows, p, R)] if there else rows[:0]
    return found


def _legs(rows: Rows, a: Array, b: Array) -> Array:
    """Both ends of the legs (n, legs, 2, 3) m, base frame: a_i, and p + R b_i."""
    tops = rows["p"][:, None, :] + np.einsum("nij,kj->nki", rows["R"].reshape(-1, 3, 3), b)
    return np.stack((np.broadcast_to(a, tops.shape), tops), axis=2)
