"""The rules of one tick fused into one kernel: what faults, and how far the forces may go."""

from __future__ import annotations

from math import nan

import numpy as np

from drivers.arrays import Array, Flags, Ints
from drivers.compiled.compiler import (
    INTEGER,
    OUT_INTEGERS,
    OUT_MATRIX,
    OUT_VECTOR,
    REAL,
    VECTOR,
    direct,
    helper,
)
from hil.control.error_axes import error_axes
from hil.safety.bus import bus_down, bus_noisy, refusals
from hil.safety.certificate import (
    ACTION,
    BOUND,
    CONSTANTS,
    DV,
    FIGURES,
    PAST,
    POSE,
    SCALARS,
    SHARE,
    UNREST,
    V,
    forget,
    jumped,
    remember_reference,
    settle,
    unsettle,
    watch,
)
from hil.safety.effort import limit_force, limit_step, limit_window, remember, window_extremes
from hil.safety.finite import all_finite
from hil.safety.following import lagging
from hil.safety.kinematics import hopped, ill_conditioned, inconsistent
from hil.safety.legs import all_running, drive_lost, stale
from hil.safety.recorder import recorder_losing
from hil.safety.stroke import beyond_hard_end, overspeed, too_fast_for_end
from hil.safety.timing import is_degraded, is_late, late_history, missed_run, too_many_missed
from hil.signal_types import MEASUREMENT, REFERENCE, STATE
from hil.signals import Fault, Mode, Stop, Warn

LATE, MISSED, REFUSED, DROPPED, RUNNING, NEWEST, MEMORY = range(7)
"""What is remembered: late ticks, periods missed in a row, ticks with refused frames (bits, see the rules),
the recorder's losses so far, whether all drives have been in RUN since the brakes opened, the newest row of
the force window. MEMORY is their number."""
_IDLE, _LOADING, _UNLOADING = int(Mode.IDLE), int(Mode.LOADING), int(Mode.UNLOADING)
_RELEASING, _STOPPING = int(Mode.RELEASING), int(Mode.STOPPING)
_STALE, _DRIVE, _NOT_FINITE = int(Fault.STALE), int(Fault.DRIVE), int(Fault.NOT_FINITE)
_KINEMATICS, _ASSEMBLY, _CONDITION = int(Fault.KINEMATICS), int(Fault.ASSEMBLY), int(Fault.CONDITION)
_LAW, _STROKE, _SPEED, _FOLLOWING = int(Fault.LAW), int(Fault.STROKE), int(Fault.SPEED), int(Fault.FOLLOWING)
_BUS, _CERTIFICATE, _WARN_CERTIFICATE = int(Fault.BUS), int(Fault.CERTIFICATE), int(Warn.CERTIFICATE)
_WARN_STALE, _WARN_LATE, _WARN_DEGRADED = int(Warn.STALE), int(Warn.LATE), int(Warn.DEGRADED)
_WARN_REJECTED, _WARN_RECORDER, _WARN_BUS = int(Warn.REJECTED), int(Warn.RECORDER), int(Warn.BUS)
_NO_STOP, _STOP_MISSED, _STOP_RECORDER = int(Stop.NONE), int(Stop.MISSED), int(Stop.RECORDER)
_FORCE_LIMIT, _FORCE_STEP, _FORCE_WINDOW = int(Warn.FORCE_LIMIT), int(Warn.FORCE_STEP), int(Warn.FORCE_WINDOW)


@helper
def judge_state(
    mode: int, running: int, age: Ints, drive_state: Ints, length: Array, rate: Array, force: Array,
    q: Array, dq: Array, p: Array, R: Array, twist: Array, J: Array,
    residual: float, condition: float, hop: float,
    q_d: Array, dq_d: Array, ddq_d: Array, twist_d: Array, dtwist_d: Array, limits: Array,
) -> tuple[int, int, int]:  # fmt: skip
    """Return fault bits, warning bits, and whether all drives have been in RUN since the brakes opened.

    Measurement, State, the estimate's quality, Reference and limits as in hil.signals and hil.config; the
    reference is followed from RELEASING to STOPPING. Faults from LOADING to UNLOADING only.
    """
    faults = warnings = 0
    stale_warn, stale_fault, consistency, condition_max = limits[0], limits[1], limits[2], limits[3]
    length_min, length_max, margin, deceleration = limits[4], limits[5], limits[6], limits[7]
    speed, at_rest, per_speed = limits[8], limits[9], limits[10]
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


@helper
def limit_effort(
    tau: Array, history: Array, lows: Array, highs: Array, newest: int, skipped: int,
    force: float, step: float, window: float, limited: Array,
) -> tuple[int, int, int]:  # fmt: skip
    """Fill the limited forces (6,) N; return fault bits, warning bits, and the new `newest`.

    history (n, 6) N is a ring of the forces sent, its newest row `newest`, lows and highs as in
    `hil.safety.effort`; the forces held during `skipped` periods and the new ones are written into it. tau
    (6,) N; asked for anything that is not finite, the answer is LAW and no force.
    """
    faults = warnings = 0
    limited[:] = tau
    if not all_finite(tau):
        faults = _LAW
        limited[:] = 0.0
    rows = history.shape[0]
    last = history[newest].copy()
    for _ in range(min(skipped, rows)):
        newest = (newest + 1) % rows
        remember(last, newest, history, lows, highs)
    low, high = window_extremes(lows, highs)
    if limit_force(limited, force):
        warnings |= _FORCE_LIMIT
    if limit_step(limited, last, step):
        warnings |= _FORCE_STEP
    if limit_window(limited, low, high, window):
        warnings |= _FORCE_WINDOW
    newest = (newest + 1) % rows
    remember(limited, newest, history, lows, highs)
    return faults, warnings, newest


@helper
def judge_certificate(
    running: int, late_ns: int, late: bool, skipped: int, unseen: int, age: Ints,
    q: Array, dq: Array, p: Array, R: Array, twist: Array,
    p_d: Array, R_d: Array, twist_d: Array, dtwist_d: Array, q_d: Array, dq_d: Array, ddq_d: Array,
    watched: Array, figures: Array,
) -> tuple[int, int]:  # fmt: skip
    """Fill the figures of `hil.safety.certificate`; return fault bits and warning bits.

    running: not 0 while the brakes are open and the law moves the platform; unseen: not 0 where a leg's
    encoder is not used and its length an estimate. Watched anew after a late, skipped, unseen or stale
    tick, a jump of the reference, and a limit that acted on the forces.
    """
    figures[:] = nan
    if not watched.size:
        return 0, 0
    certificate, memory = watched[:CONSTANTS], watched[CONSTANTS:]
    if running == 0:
        forget(memory)
        return 0, 0
    measured = unseen == 0 and not stale(age, 1)
    whole = measured and not late and skipped == 0 and memory[PAST, UNREST] == 0.0
    whole = whole and not jumped(certificate, memory, q_d, dq_d, ddq_d)
    e, de, rate, feed = np.empty_like(q), np.empty_like(q), np.empty_like(q), np.empty_like(q)
    error_axes(
        certificate[SCALARS, POSE] > 0.0, q, dq, p, R, twist,
        p_d, R_d, twist_d, dtwist_d, q_d, dq_d, ddq_d, e, de, rate, feed,
    )  # fmt: skip
    broken = watch(certificate, memory, e, de, rate, feed, whole, 1e-9 * abs(late_ns), 1.0 + skipped, figures)
    remember_reference(memory, q_d, dq_d, ddq_d)
    if not measured:
        unsettle(memory)
    action = certificate[SCALARS, ACTION]
    if not broken or action == 0.0:
        return 0, 0
    return _CERTIFICATE if action > 1.0 else 0, _WARN_CERTIFICATE


@direct(
    INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER,
    *MEASUREMENT, *STATE, REAL, REAL, *REFERENCE, VECTOR,
    VECTOR, INTEGER, INTEGER, OUT_INTEGERS, OUT_MATRIX, OUT_MATRIX, OUT_MATRIX,
    OUT_MATRIX, OUT_VECTOR,
)  # fmt: skip
def judge_tick(
    mode: int, lateness_ns: int, skipped: int,
    sends_failed: int, bus_errors: int, bus_off: int, bus_overflow: int, recorder_alive: int, dropped: int,
    unseen: int,
    length: Array, rate: Array, force: Array, drive_state: Ints, _fault: Ints, age: Ints,
    rejected: int, _tick: int, _blind: Flags,
    q: Array, dq: Array, p: Array, R: Array, twist: Array, J: Array, _iterations: int, residual: float,
    _wrench: Array, condition: float, hop: float,
    p_d: Array, R_d: Array, twist_d: Array, dtwist_d: Array, q_d: Array, dq_d: Array, ddq_d: Array,
    _t: float, tau: Array,
    limits: Array, period_ns: int, stop_on_loss: int,
    memory: Ints, history: Array, lows: Array, highs: Array,
    watched: Array, limited: Array,
) -> tuple[int, int, int, float, float, float, float]:  # fmt: skip
    """Fill the limited forces (6,) N; return fault bits, warning bits, why to stop, and four figures.

    The tick as in hil.signals, in the order of its values; limits, watched: see `Safety`; the figures are
    those of `hil.safety.certificate`. Changes memory, the force window and what is watched. Fills nothing
    where the drives are off.
    """
    warnings = 0
    late = is_late(lateness_ns, period_ns)
    memory[LATE] = late_history(memory[LATE], late, skipped)
    memory[MISSED] = missed_run(memory[MISSED], skipped)
    memory[REFUSED] = refusals(memory[REFUSED], sends_failed)
    losing = recorder_losing(recorder_alive != 0, dropped, memory[DROPPED])
    memory[DROPPED] = dropped
    if late:
        warnings |= _WARN_LATE
    if is_degraded(memory[LATE]):
        warnings |= _WARN_DEGRADED
    if losing:
        warnings |= _WARN_RECORDER
    if rejected > 0:
        warnings |= _WARN_REJECTED
    if bus_noisy(bus_errors, bus_overflow, sends_failed):
        warnings |= _WARN_BUS
    faults, more, memory[RUNNING] = judge_state(
        mode, memory[RUNNING], age, drive_state, length, rate, force,
        q, dq, p, R, twist, J, residual, condition, hop,
        q_d, dq_d, ddq_d, twist_d, dtwist_d, limits,
    )  # fmt: skip
    warnings |= more
    figures = np.empty(FIGURES)
    broken, more = judge_certificate(
        memory[RUNNING], lateness_ns, late, skipped, unseen, age, q, dq, p, R, twist,
        p_d, R_d, twist_d, dtwist_d, q_d, dq_d, ddq_d, watched, figures,
    )  # fmt: skip
    faults |= broken
    warnings |= more
    if mode < _LOADING or mode > _UNLOADING:
        history[:] = 0.0
        lows[:] = 0.0
        highs[:] = 0.0
        return faults, warnings, _NO_STOP, nan, nan, nan, nan
    if bus_down(bus_off != 0, memory[REFUSED]):
        faults |= _BUS
    law, more, memory[NEWEST] = limit_effort(
        tau, history, lows, highs, memory[NEWEST], skipped, limits[11], limits[12], limits[13], limited
    )
    if watched.size:
        settle(watched[CONSTANTS:], more != 0)
    stop = _STOP_MISSED if too_many_missed(memory[MISSED], limits[14]) else _NO_STOP
    if losing and stop_on_loss != 0:
        stop = _STOP_RECORDER
    return faults | law, warnings | more, stop, figures[V], figures[DV], figures[BOUND], figures[SHARE]
