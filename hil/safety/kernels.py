"""The rules of one tick fused into two kernels: what faults, and how far the forces may go.

Rule of the room: fixed order, bits of `hil.signals.Fault` and `Warn`; the rules themselves are in the files
beside this one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compile_cache import INTEGER, MATRIX, OUT_MATRIX, REAL, VECTOR, kernel
from hil.safety.effort import limit_force, limit_step, limit_window, window_extremes
from hil.safety.finite import all_finite
from hil.safety.following import lagging
from hil.safety.kinematics import hopped, ill_conditioned, inconsistent
from hil.safety.legs import all_running, drive_lost, stale
from hil.safety.stroke import beyond_hard_end, overspeed, too_fast_for_end
from hil.signals import Fault, Mode, Warn

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

INTEGERS = VECTOR.copy(dtype=INTEGER)

_IDLE, _LOADING, _UNLOADING = int(Mode.IDLE), int(Mode.LOADING), int(Mode.UNLOADING)
_RELEASING, _STOPPING = int(Mode.RELEASING), int(Mode.STOPPING)
_STALE, _DRIVE, _NOT_FINITE = int(Fault.STALE), int(Fault.DRIVE), int(Fault.NOT_FINITE)
_KINEMATICS, _ASSEMBLY, _CONDITION = int(Fault.KINEMATICS), int(Fault.ASSEMBLY), int(Fault.CONDITION)
_LAW, _STROKE, _SPEED, _FOLLOWING = int(Fault.LAW), int(Fault.STROKE), int(Fault.SPEED), int(Fault.FOLLOWING)
_WARN_STALE = int(Warn.STALE)
_FORCE_LIMIT, _FORCE_STEP, _FORCE_WINDOW = int(Warn.FORCE_LIMIT), int(Warn.FORCE_STEP), int(Warn.FORCE_WINDOW)


@kernel(
    INTEGER, INTEGER, INTEGERS, INTEGERS, VECTOR, VECTOR, VECTOR,
    VECTOR, VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, REAL, REAL, REAL,
    VECTOR, VECTOR, VECTOR, VECTOR, VECTOR,
    INTEGER, INTEGER, REAL, REAL, REAL, REAL, REAL, REAL, REAL, REAL, REAL,
)  # fmt: skip
def judge_state(
    mode: int, running: int, age: Ints, drive_state: Ints, length: Array, rate: Array, force: Array,
    q: Array, dq: Array, p: Array, R: Array, twist: Array, J: Array,
    residual: float, condition: float, hop: float,
    q_d: Array, dq_d: Array, ddq_d: Array, twist_d: Array, dtwist_d: Array,
    stale_warn: int, stale_fault: int, consistency: float, condition_max: float,
    length_min: float, length_max: float, margin: float, deceleration: float, speed: float,
    at_rest: float, per_speed: float,
) -> tuple[int, int, int]:  # fmt: skip
    """Return fault bits, warning bits, and whether all drives have been in RUN since the brakes opened.

    Measurement, State, the estimate's quality, Reference and limits as in hil.signals and hil.config; the
    reference is followed from RELEASING to STOPPING. Faults from LOADING to UNLOADING only.
    """
    faults = warnings = 0
    if mode > _IDLE and stale(age, stale_warn):
        warnings |= _WARN_STALE
    if mode < _LOADING or mode > _UNLOADING:
        return faults, warnings, 0
    moving = _RELEASING <= mode <= _STOPPING

    finite = all_finite(length) and all_finite(rate) and all_finite(force)
    finite = finite and all_finite(q) and all_finite(dq) and all_finite(p) and all_finite(R)
    finite = finite and all_finite(twist) and all_finite(J)
    finite = finite and all_finite(q_d) and all_finite(dq_d) and all_finite(ddq_d)
    finite = finite and all_finite(twist_d) and all_finite(dtwist_d)
    if not finite:
        faults |= _NOT_FINITE

    if stale(age, stale_fault):
        faults |= _STALE
    run = all_running(drive_state)
    if drive_lost(drive_state) or (moving and running != 0 and not run):
        faults |= _DRIVE
    now_running = int(moving and (run or running != 0))

    if inconsistent(residual, consistency):
        faults |= _KINEMATICS
    if hopped(hop):
        faults |= _ASSEMBLY
    if ill_conditioned(condition, condition_max):
        faults |= _CONDITION

    if beyond_hard_end(q, length_min, length_max):
        faults |= _STROKE
    if too_fast_for_end(q, dq, length_min + margin, length_max - margin, deceleration):
        faults |= _STROKE
    if overspeed(dq, speed):
        faults |= _SPEED
    if moving and lagging(q, q_d, dq_d, at_rest, per_speed):
        faults |= _FOLLOWING
    return faults, warnings, now_running


@kernel(VECTOR, OUT_MATRIX, INTEGER, INTEGER, INTEGER, REAL, REAL, REAL)
def limit_effort(
    tau: Array,
    history: Array,
    newest: int,
    count: int,
    skipped: int,
    force: float,
    step: float,
    window: float,
) -> tuple[Array, int, int, int, int]:
    """Return the limited forces (6,) N, fault bits, warning bits, and the new `newest` and `count`.

    history (n, 6) N is a ring of the forces sent, its newest row `newest`, `count` >= 1 rows filled; the
    forces held during `skipped` periods and the new ones are written into it. tau (6,) N; asked for
    anything that is not finite, the answer is LAW and no force.
    """
    faults = warnings = 0
    limited = tau.copy()
    if not all_finite(tau):
        faults = _LAW
        limited[:] = 0.0
    rows = history.shape[0]
    last = history[newest].copy()
    for _ in range(min(skipped, rows)):
        newest = (newest + 1) % rows
        history[newest] = last
        count = min(count + 1, rows)
    low, high = window_extremes(history, count)
    if limit_force(limited, force):
        warnings |= _FORCE_LIMIT
    if limit_step(limited, last, step):
        warnings |= _FORCE_STEP
    if limit_window(limited, low, high, window):
        warnings |= _FORCE_WINDOW
    newest = (newest + 1) % rows
    history[newest] = limited
    return limited, faults, warnings, newest, min(count + 1, rows)
