"""Safety: all rules of one tick in a fixed order, between the law and the bus."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from drivers.signals import LEGS, Measurement
from hil.config import LimitSettings
from hil.safety.certificate import ASKED, LAST_V, NO_WATCH, PAST, Watch
from hil.safety.effort import BLOCK
from hil.safety.kernels import DROPPED, MEMORY, judge_tick
from hil.safety.recorder import recorder_stop
from hil.signals import Effort, Estimate, Fault, Mode, Reference, Stop, TickInput, Verdict, Warn

WINDOW_S = 0.25
"""Length of the force window."""

_ALL_LEGS = (1 << LEGS) - 1
_ZEROS = np.zeros(LEGS)
_ZEROS.flags.writeable = False
_LOADING, _UNLOADING = int(Mode.LOADING), int(Mode.UNLOADING)


class Safety:
    """The rules of `hil.safety` with the limits of one robot.

    Faults and stops are asked for only while the drives are powered (LOADING to UNLOADING), warnings always.
    In the other modes the drives are off: no force, and the force limits start anew from zero.

    Mutable state: the forces sent within the last 250 ms, the last of them being the last tau; which of the
    last 32 ticks were late; periods missed in a row; which of the last 32 ticks had refused frames; the
    recorder's losses so far; whether all drives have been in RUN since the brakes opened; what the watch of
    the certificate remembers.
    `reset` forgets all of it.
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
    ) -> None:
        """Take the hard ends of the legs (m), the loop's rate and the drives' rated force (N)."""
        rows = len(watch.constants)
        self._watched = np.zeros((rows + (ASKED + watch.ticks if rows else 0), LEGS))
        self._watched[:rows] = watch.constants
        self._watch_memory = self._watched[rows:]
        self._period_ns = round(1e9 / rate_Hz)
        self._stop_on_loss = recorder_stop(losing=True, on_loss=on_recorder_loss)
        self._limits = np.array(
            [
                limits.stale_warn_ticks,
                limits.stale_fault_ticks,
                limits.consistency_m,
                limits.condition,
                length_min,
                length_max,
                limits.stroke_margin_m,
                limits.deceleration_m_s2,
                limits.speed_m_s,
                limits.following_error_m,
                limits.following_error_s,
                min(limits.force_N, drive_force_limit),
                limits.force_step_N,
                limits.force_window_N,
                limits.missed_stop_ticks,
            ],
            float,
        )
        self._memory = np.zeros(MEMORY, np.int64)
        self._history = np.zeros((max(1, round(WINDOW_S * rate_Hz)), LEGS))
        self._lows = np.zeros((math.ceil(len(self._history) / BLOCK), LEGS))
        self._highs = np.zeros_like(self._lows)
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick: no force, no late tick, no failure."""
        for array in (self._memory, self._history, self._lows, self._highs, self._watch_memory):
            array.fill(0)
        self._watch_memory[PAST:, LAST_V] = math.nan  # as good as forgotten, and no row without a watch
        self._memory[DROPPED] = np.iinfo(np.int64).max  # what was lost before the first look is no news

    def judge(
        self,
        inp: TickInput,
        measurement: Measurement,
        estimate: Estimate,
        reference: Reference,
        effort: Effort,
        mode: Mode,
    ) -> Verdict:
        """Return the limited forces, and what of this tick warns, faults or asks for a controlled stop.

        effort: what the law asks for, not finite where it failed; mode: that of this tick. Mutates the state
        named in the class, once per tick.
        """
        fusion, unseen = estimate.fusion, False
        if fusion.ages is not None:
            unseen = fusion.used != _ALL_LEGS
            measurement = measurement._replace(age=fusion.ages)
        powered = _LOADING <= mode <= _UNLOADING
        tau = np.empty(LEGS)
        values = (*measurement, *estimate.state, estimate.condition, estimate.hop, *reference, effort.tau)
        faults, warnings, stop, *figures = judge_tick(
            int(mode), inp.lateness_ns, inp.skipped,
            inp.sends_failed, inp.bus_errors, inp.bus_off, inp.bus_overflow,
            inp.recorder_alive, inp.recorder_dropped, unseen,
            *values,
            self._limits, self._period_ns, self._stop_on_loss,
            self._memory, self._history, self._lows, self._highs,
            self._watched, tau,
        )  # fmt: skip
        if fusion.warnings:
            warnings |= fusion.warnings
        if fusion.faults and powered:
            faults |= fusion.faults
        return Verdict(
            tau if powered else _ZEROS,
            Warn(warnings) if warnings else Warn.NONE,
            Fault(faults) if faults else Fault.NONE,
            Stop(stop) if stop else Stop.NONE,
            figures,
        )
