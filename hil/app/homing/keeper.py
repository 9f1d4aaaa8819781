"""Keeps the homing file during a run: reads it first, marks it as outdated, writes it where the legs rest."""

from __future__ import annotations

import signal
from typing import Any

from drivers.errors import ConfigurationError
from drivers.signals import Mode
from drivers.transmission import Transmission
from hil.app.configuration.configuration import Configuration
from hil.app.homing.file import homing_file, homing_path, read_homing, refuse_moved, write_homing
from hil.app.homing.last_pose import home_lengths, last_pose_of
from hil.loop import modes
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose, unwrapped_turns
from hil.loop.report import any_powered
from hil.safety.motion import REST_m_s

_RESTING = frozenset({Mode.WAITING, Mode.IDLE, Mode.PARKED, Mode.FAULT})
_LATELY = 5
"""Largest age, ticks, of the reading of a leg that counts as measured."""


class Keeper:
    """Reads and writes the homing file of a run. Mutable state: the run's cycle, while the file is marked."""

    def __init__(self, c: Configuration, *, emulated: bool, on_bench: bool = False) -> None:
        """Read the homing file, if drives have one; a bench has none. Raises ConfigurationError."""
        self._c = c
        without = c.drives.homing is None or on_bench
        self._path = None if without else homing_path(c, emulated=emulated)
        self._file = None if self._path is None else refuse_moved(c, self._path, read_homing(c, self._path))
        self._cycle: Cycle | None = None
        self.trouble = ""
        """Error that kept the final leg lengths out of the file; empty without one."""
        self.last_pose: LastPose | None = last_pose_of(c, self._file, emulated=emulated or on_bench)
        if on_bench and self.last_pose is not None:
            self.last_pose = self.last_pose._replace(length=home_lengths(c))

    def begin(self, cycle: Cycle) -> None:
        """Mark the file as `moved`, which stays if the run dies. The caller calls `close` at the end."""
        if self._path is not None and self._file is not None:
            self._cycle = cycle
            marked = homing_file(self._c, "moved", self._file.lengths_m, self._file.turns)
            write_homing(self._c, self._path, marked)

    def close(self) -> None:
        """Write the final leg lengths into the homing file, once; after an error `trouble` has the reason."""
        cycle, self._cycle, file = self._cycle, None, self._file
        if cycle is None or self._path is None or file is None:
            return
        gear = self._c.drives.transmission
        if _at_rest(cycle) and gear is not None:
            turns = Transmission(gear).turns(cycle.homing.raw).tolist()
            file = homing_file(self._c, "parked", cycle.tick["length"].tolist(), turns)
        elif cycle.homing.opened:
            return
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C waits until written
        try:
            write_homing(self._c, self._path, file)
        except ConfigurationError as error:
            self.trouble = f"{error}; its state is still `moved`: set the leg lengths with `hil homing`"
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def summary(self, cycle: Cycle) -> dict[str, Any]:
        """Entry `homing` of a run's summary; empty for drives with absolute encoders."""
        if self.last_pose is None:
            return {}
        added = unwrapped_turns(cycle.homing, self.last_pose)
        kept = {} if self._path is None else {"file": str(self._path)}
        return {"homing": {"turns_added": ", ".join(f"{turns:g}" for turns in added), **kept}}


def _at_rest(cycle: Cycle) -> bool:
    """True if the drives are off, and all legs are measured, trusted and at rest."""
    tick = cycle.tick
    believed = cycle.homing.known and not cycle.faults & modes.NOT_MEASURED
    measured = int(tick["age"].max()) <= _LATELY and float(abs(tick["rate"]).max()) < REST_m_s
    return cycle.mode in _RESTING and believed and measured and not any_powered(tick)
