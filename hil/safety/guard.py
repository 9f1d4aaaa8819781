"""Safety: all rules of one tick in a fixed order, between the law and the bus.

Rule of the room: pure but for the state named in the class; no clock, no bus, no file.
"""

from __future__ import annotations

from math import inf
from typing import Literal

import numpy as np

from drivers.signals import LEGS, Measurement
from hil.config import LimitSettings
from hil.safety import bus, recorder, timing
from hil.safety.kernels import judge_state, limit_effort
from hil.signals import Effort, Estimate, Fault, Mode, Reference, TickInput, Verdict, Warn

WINDOW_S = 0.25
"""Length of the force window."""

_ZEROS = np.zeros(LEGS)
_ZEROS.flags.writeable = False

_LATE, _DEGRADED, _REJECTED, _RECORDER = map(int, (Warn.LATE, Warn.DEGRADED, Warn.REJECTED, Warn.RECORDER))
_NOISY = int(Warn.BUS)
_BUS = int(Fault.BUS)
_LOADING, _UNLOADING = int(Mode.LOADING), int(Mode.UNLOADING)


class Safety:
    """The rules of `hil.safety` with the limits of one robot.

    Faults and stops are asked for only while the drives are powered (LOADING to UNLOADING), warnings always.
    In the other modes the drives are off: no force, and the force limits start anew from zero.

    Mutable state: the forces sent within the last 250 ms, the last of them being the last tau; which of the
    last 32 ticks were late; periods missed in a row; which of the last 32 ticks had refused frames; the
    recorder's losses so far; whether all drives have been in RUN since the brakes opened.
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
    ) -> None:
        """Take the hard ends of the legs (m), the loop's rate and the drives' rated force (N)."""
        self._period_ns = round(1e9 / rate_Hz)
        self._on_recorder_loss = on_recorder_loss
        self._state_limits = (
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
        )
        self._force_limits = (
            min(limits.force_N, drive_force_limit),
            limits.force_step_N,
            limits.force_window_N,
        )
        self._history = np.zeros((max(1, round(WINDOW_S * rate_Hz)), LEGS))
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick: no force, no late tick, no failure."""
        self._forget_forces()
        self._late = 0
        self._missed = 0
        self._refused = 0
        self._dropped = inf  # what was lost before the first look is no news
        self._running = 0

    def _forget_forces(self) -> None:
        self._history[0] = 0.0
        self._newest = 0
        self._count = 1

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
        state = estimate.state
        powered = _LOADING <= mode <= _UNLOADING
        losing = self._watch_recorder(inp)
        warnings = self._watch_time(inp) | (_RECORDER if losing else 0)
        if measurement.rejected > 0:
            warnings |= _REJECTED
        self._refused = bus.refusals(self._refused, inp.sends_failed)
        if bus.bus_noisy(inp.bus_errors, inp.bus_overflow, inp.sends_failed):
            warnings |= _NOISY

        faults, more, self._running = judge_state(
            int(mode), self._running, measurement.age, measurement.state,
            measurement.length, measurement.rate, measurement.force,
            state.q, state.dq, state.p, state.R, state.twist, state.J, state.residual,
            estimate.condition, estimate.hop,
            reference.q, reference.dq, reference.ddq, reference.twist, reference.dtwist,
            *self._state_limits,
        )  # fmt: skip
        warnings |= more
        if not powered:
            self._forget_forces()
            return Verdict(_ZEROS, _warn(warnings), _fault(faults), stop=False)
        if bus.bus_down(inp.bus_off, self._refused):
            faults |= _BUS
        tau, law, more, self._newest, self._count = limit_effort(
            effort.tau, self._history, self._newest, self._count, inp.skipped, *self._force_limits
        )
        stop = timing.too_many_missed(self._missed) or recorder.recorder_stop(losing, self._on_recorder_loss)
        return Verdict(tau, _warn(warnings | more), _fault(faults | law), stop)

    def _watch_time(self, inp: TickInput) -> int:
        late = timing.is_late(inp.lateness_ns, self._period_ns)
        self._late = timing.late_history(self._late, late, inp.skipped)
        self._missed = timing.missed_run(self._missed, inp.skipped)
        return (_LATE if late else 0) | (_DEGRADED if timing.is_degraded(self._late) else 0)

    def _watch_recorder(self, inp: TickInput) -> bool:
        losing = recorder.recorder_losing(inp.recorder_alive, inp.recorder_dropped, self._dropped)
        self._dropped = inp.recorder_dropped
        return losing


def _warn(bits: int) -> Warn:
    return Warn(bits) if bits else Warn.NONE


def _fault(bits: int) -> Fault:
    return Fault(bits) if bits else Fault.NONE
