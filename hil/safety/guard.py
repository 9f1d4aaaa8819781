"""Class Safety: all checks of one tick in a fixed order, between the law and the bus."""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from drivers.compiled.pointed import data_at
from drivers.signals import LEGS, Fault, Stop, Warn
from drivers.tick_columns import Record
from hil.config.limits import LimitSettings
from hil.safety.certificate import (
    ASKED,
    CONFIRM,
    COUNT,
    LAST_V,
    NO_WATCH,
    PAST,
    POSE,
    SCALARS,
    Watch,
)
from hil.safety.encoder_limits import NONE, EncoderLimits
from hil.safety.force_limits import BLOCK
from hil.safety.kernels import LIMITS, MEMORY, judge, limit

WINDOW_S = 0.25
"""Length of the force window, s."""
SETTLE_S = 0.2
"""After a fault, legs that have been at rest for this long, s, must stand still."""


class Verdict(NamedTuple):
    """Result of the safety checks of a tick: warnings, faults, and reason for a controlled stop."""

    warnings: Warn
    faults: Fault
    stop: Stop
    """Reason for a controlled stop, if any."""

    @classmethod
    def of(cls, faults: int, warnings: int, stop: int) -> Self:
        """Result from the bits and the number that `hil.safety.kernels.judge` returns."""
        return cls(Warn(warnings), Fault(faults), Stop(stop))


class Safety:
    """The checks of `hil.safety` with the limits of one robot.

    Faults and stops occur only while the drives are powered (LOADING to UNLOADING, HELD). Two faults also
    occur before: a leg that moves on closed brakes, and another controller on the bus. Warnings occur in all
    modes. In the other modes the drives are off: no force, and the force limits restart from zero.

    Mutable state: the forces sent within the last 250 ms, ending with the last tau; the late ticks among the
    last 32; periods missed in a row; of the last 32 ticks, those in which the bus refused frames, and those
    with refused frames of the drives; the recorder's losses so far; whether all drives have been in RUN since
    the brakes opened; where the legs have to stand; the last encoder readings, doubtful legs and pushed legs;
    the memory of the certificate check. `reset` clears all of it.
    """

    def __init__(
        self,
        limits: LimitSettings,
        length_min: float,
        length_max: float,
        rate_Hz: float,
        drive_force_limit: float,
        on_recorder_loss: Literal["continue", "stop"] = "continue",
        watch: Watch = NO_WATCH,
        encoders: EncoderLimits = NONE,
    ) -> None:
        """length_min, length_max: hard ends of the legs, m; drive_force_limit: drives' rated force, N."""
        rows = len(watch.constants)
        self._watched = np.zeros((rows + (ASKED + watch.ticks if rows else 0), LEGS))
        self._watched[:rows] = watch.constants
        self._watch_memory = self._watched[rows:]
        self.limits = np.zeros((), LIMITS)
        """A record of `hil.safety.kernels.LIMITS`."""
        for name in LimitSettings.model_fields:
            if name in (LIMITS.names or ()):
                self.limits[name] = getattr(limits, name)
        self.limits["length_min_m"], self.limits["length_max_m"] = length_min, length_max
        self.limits["force_N"] = min(limits.force_N, drive_force_limit)
        period_ns = round(1e9 / rate_Hz)
        self.limits["period_ns"] = period_ns
        apart_us = limits.sync_skew_us
        self.limits["sync_skew_ns"] = period_ns // 10 if apart_us is None else round(1e3 * apart_us)
        self.limits["settle_ticks"] = round(SETTLE_S * rate_Hz)
        self.limits["stop_on_recorder_loss"] = on_recorder_loss == "stop"
        ticks = max(1, round(WINDOW_S * rate_Hz))
        self.limits["window_ticks"] = ticks
        for name, value in encoders._asdict().items():
            self.limits[name] = value
        self.memory: Record = np.zeros((), MEMORY)
        """Memory of the rules, a record of `hil.safety.kernels.MEMORY`: read only."""
        self._window = np.zeros((ticks + 2 * math.ceil(ticks / BLOCK), LEGS))
        self.reset()

    @property
    def stops_unrecorded(self) -> bool:
        """True if the run has to end when the recorder is lost."""
        return bool(self.limits["stop_on_recorder_loss"])

    def reset(self) -> None:
        """Restore the state before the first tick: no force, no late tick, no failure."""
        for array in (self.memory, self._window, self._watch_memory):
            array.fill(0)
        self._watch_memory[PAST:, LAST_V] = math.nan  # as good as forgotten, and no row without a watch
        self.memory["dropped"] = np.iinfo(np.int64).max  # what was lost before the first look is no news

    def resume(self, tau: Array) -> None:
        """Allow a jump of the force to tau (6,) N: its changes are limited as if it had been on before.

        Limited to `limits.force_N`.
        """
        most = float(self.limits["force_N"])
        self._window[:] = np.clip(tau, -most, most)

    def places(self) -> dict[str, int]:
        """Addresses of the records and matrices that compiled code uses, and the matrices' row numbers."""
        return {
            "limits": data_at(self.limits),
            "memory": data_at(self.memory),
            "window": data_at(self._window),
            "window_rows": len(self._window),
            "watched": data_at(self._watched),
            "watched_rows": len(self._watched),
        }

    @property
    def watches_pose(self) -> bool:
        """True if the certificate check is about the pose; False if it is about the legs."""
        return bool(self._watched.size) and bool(self._watched[SCALARS, POSE])

    def broken_axes(self) -> tuple[int, ...]:
        """Axes (0..5) that have violated the certificate for the configured number of ticks."""
        if not self._watched.size:
            return ()
        counts, confirm = self._watch_memory[COUNT].tolist(), float(self._watched[SCALARS, CONFIRM])
        return tuple(axis for axis, count in enumerate(counts) if count >= confirm)

    def moved_m(self, tick: Record) -> Array:
        """Distance (6,) m of each leg from where it stood when it last had to stand still."""
        moved: Array = np.abs(tick["length"] - self.memory["still"])
        return moved

    def judge(self, tick: Record, probe: Callable[[], object] | None = None) -> Verdict:
        """Check a tick and limit its forces, once per tick. Returns warnings, faults and stop request.

        probe: fills probe_force by the checks' result for this tick, before the limits apply. Fills in the
        tick's safety columns and changes the state listed in the class.
        """
        given = (tick, self.limits, self.memory, self._window, self._watched)
        faults, warnings, stop = judge(*given)
        if probe is not None:
            probe()
        law, limited = limit(*given)
        return Verdict.of(faults | law, warnings | limited, stop)
