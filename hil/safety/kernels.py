"""The rules of one tick fused into one kernel: what faults, and how far the forces may go."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import OUT_MATRIX, entry, helper, kernel, record
from drivers.signals import LEGS, Fault, Mode, Stop, Warn
from drivers.tick_columns import TICK, part
from hil.control.error_axes import error_axes
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
from hil.safety.encoder_kernels import judge_encoders, push_legs, pushing
from hil.safety.encoder_limits import ENCODER_LIMITS, ENCODER_MEMORY
from hil.safety.force_limits import limit_force, limit_step, limit_window, remember, window_extremes
from hil.safety.motion import (
    REST_m_s,
    at_rest,
    beyond_hard_end,
    forget_place,
    hopped,
    ill_conditioned,
    inconsistent,
    lagging,
    moved_legs,
    overspeed,
    too_fast_for_end,
)
from hil.safety.signals import (
    HARMFUL_STRETCH_NS,
    all_finite,
    all_running,
    bus_down,
    bus_noisy,
    drive_lost,
    estop_heard,
    is_apart,
    is_degraded,
    is_late,
    late_history,
    missed_run,
    recorder_losing,
    refusals,
    second_controller,
    stale,
    too_many_missed,
    too_stretched,
    unreliable,
)

_IDLE, _LOADING, _UNLOADING = int(Mode.IDLE), int(Mode.LOADING), int(Mode.UNLOADING)
_RELEASING, _STOPPING, _PARKING = int(Mode.RELEASING), int(Mode.STOPPING), int(Mode.PARKING)
_PARKED, _FAULT, _HELD = int(Mode.PARKED), int(Mode.FAULT), int(Mode.HELD)
_STALE, _DRIVE, _NOT_FINITE = int(Fault.STALE), int(Fault.DRIVE), int(Fault.NOT_FINITE)
_KINEMATICS, _ASSEMBLY, _CONDITION = int(Fault.KINEMATICS), int(Fault.ASSEMBLY), int(Fault.CONDITION)
_LAW, _STROKE, _SPEED, _FOLLOWING = int(Fault.LAW), int(Fault.STROKE), int(Fault.SPEED), int(Fault.FOLLOWING)
_BUS, _CERTIFICATE, _WARN_CERTIFICATE = int(Fault.BUS), int(Fault.CERTIFICATE), int(Warn.CERTIFICATE)
_BRAKE = int(Fault.BRAKE)
_WARN_STALE, _WARN_LATE, _WARN_DEGRADED = int(Warn.STALE), int(Warn.LATE), int(Warn.DEGRADED)
_WARN_REJECTED, _WARN_RECORDER, _WARN_BUS = int(Warn.REJECTED), int(Warn.RECORDER), int(Warn.BUS)
_SECOND_CONTROLLER, _DUPLICATE_NODE = int(Fault.SECOND_CONTROLLER), int(Fault.DUPLICATE_NODE)
_REFUSED_FRAMES, _SET_UP, _ESTOP = int(Fault.REFUSED_FRAMES), int(Fault.SET_UP), int(Fault.ESTOP)
_NO_STOP, _STOP_MISSED, _STOP_RECORDER = int(Stop.NONE), int(Stop.MISSED), int(Stop.RECORDER)
_STOP_STRETCHED = int(Stop.STRETCHED)
_FORCE_LIMIT, _FORCE_STEP, _FORCE_WINDOW = int(Warn.FORCE_LIMIT), int(Warn.FORCE_STEP), int(Warn.FORCE_WINDOW)


LIMITS = np.dtype(
    [
        ("stale_warn_ticks", "<i8"),
        ("stale_fault_ticks", "<i8"),
        ("consistency_m", "<f8"),
        ("condition", "<f8"),
        ("length_min_m", "<f8"),
        ("length_max_m", "<f8"),
        ("stroke_margin_m", "<f8"),
        ("deceleration_m_s2", "<f8"),
        ("speed_m_s", "<f8"),
        ("following_error_m", "<f8"),
        ("following_error_s", "<f8"),
        ("standstill_m", "<f8"),
        ("settle_ticks", "<i8"),
        ("force_N", "<f8"),
        ("force_step_N", "<f8"),
        ("force_window_N", "<f8"),
        ("missed_stop_ticks", "<i8"),
        ("stretch_percent", "<f8"),
        ("period_ns", "<i8"),
        ("sync_skew_ns", "<i8"),
        ("stop_on_recorder_loss", "<i8"),
        *ENCODER_LIMITS,
    ]
)
"""Section `limits`, and what else the rules compare with."""
MEMORY = np.dtype(
    [
        ("late", "<i8"),  # the last ticks as bits, see `hil.safety.signals`
        ("missed", "<i8"),  # periods missed in a row
        ("refused", "<i8"),  # ticks with frames that the bus refused, as bits
        ("untrusted", "<i8"),  # ticks with frames of the drives that were refused, as bits
        ("dropped", "<i8"),  # the recorder's losses so far
        ("running", "<i8"),  # 1: all drives have been in RUN since the brakes opened
        ("stretched_ns", "<i8"),  # how long the bench's time stood still, in harmful stretches
        ("newest", "<i8"),  # row of the force window
        ("standing", "<i8"),  # 1: the legs have to stand where they are
        ("resting", "<i8"),  # ticks in a row at rest after a fault
        ("still", "<f8", (LEGS,)),  # m, where the legs have to stand; nan before they are heard
        *ENCODER_MEMORY,
    ]
)
"""What the rules remember."""
TICK_SEEN = record(
    TICK, "mode", *part("input", "measurement", "estimate", "fusion", "reference", "effort", "verdict")
)


@helper
def _finite(tick: Any) -> bool:
    """Tell whether measurement, state and reference are all finite."""
    measured = all_finite(tick.length) and all_finite(tick.rate) and all_finite(tick.drive_force)
    state = all_finite(tick.q) and all_finite(tick.dq) and all_finite(tick.p) and all_finite(tick.R)
    state = state and all_finite(tick.twist) and all_finite(tick.J)
    reference = all_finite(tick.q_d) and all_finite(tick.dq_d) and all_finite(tick.ddq_d)
    return measured and state and reference and all_finite(tick.twist_d) and all_finite(tick.dtwist_d)


@helper
def powered(mode: int) -> bool:
    """Tell whether the drives are powered: from LOADING to UNLOADING, and in HELD."""
    return _LOADING <= mode <= _UNLOADING or mode == _HELD


@helper
def judge_standstill(tick: Any, limits: Any, memory: Any) -> int:
    """Fill the legs that moved where they have to stand; return fault bits.

    They stand from the moment at which the brakes are closed to that at which they open, and after a fault
    from the moment at which they have been at rest for a while.
    """
    mode = tick.mode
    closed = mode in (_IDLE, _LOADING, _UNLOADING, _PARKED)
    slow = mode == _FAULT and at_rest(tick.rate, tick.age, REST_m_s)
    memory.resting = memory.resting + 1 if slow else 0
    stands = closed or memory.resting > limits.settle_ticks
    if stands and memory.standing == 0:
        forget_place(memory.still)
    memory.standing = int(stands)
    tick.legs_moved = moved_legs(tick.length, tick.age, memory.still, limits.standstill_m) if stands else 0
    return _BRAKE if tick.legs_moved != 0 else 0


@helper
def judge_state(tick: Any, limits: Any, memory: Any) -> tuple[int, int]:
    """Return fault bits and warning bits of legs, drives, estimate and reference.

    The reference is followed from RELEASING to PARKING. Faults only while the drives are powered.
    """
    faults = warnings = 0
    mode = tick.mode
    if mode > _IDLE and stale(tick.counted_age, limits.stale_warn_ticks):
        warnings |= _WARN_STALE
    if not powered(mode):
        memory.running = 0
        return faults, warnings
    moving = _RELEASING <= mode <= _STOPPING

    if not _finite(tick):
        faults |= _NOT_FINITE
    proves = mode in (_LOADING, _UNLOADING)  # no estimate proves a brake
    ages = tick.age if proves else tick.counted_age
    if stale(ages, limits.stale_fault_ticks) or (proves and tick.legs_slipped != 0):
        faults |= _STALE
    run = all_running(tick.drive_state)
    if drive_lost(tick.drive_state) or (moving and memory.running != 0 and not run):
        faults |= _DRIVE
    memory.running = int(moving and (run or memory.running != 0))

    if inconsistent(tick.fk_residual, limits.consistency_m):
        faults |= _KINEMATICS
    if hopped(tick.hop):
        faults |= _ASSEMBLY
    if ill_conditioned(tick.condition, limits.condition):
        faults |= _CONDITION

    low, high, margin = limits.length_min_m, limits.length_max_m, limits.stroke_margin_m
    if beyond_hard_end(tick.q, low, high):
        faults |= _STROKE
    if too_fast_for_end(tick.q, tick.dq, low + margin, high - margin, limits.deceleration_m_s2):
        faults |= _STROKE
    if overspeed(tick.dq, limits.speed_m_s):
        faults |= _SPEED
    follows = _RELEASING <= mode <= _PARKING
    if follows and lagging(tick.q, tick.q_d, tick.dq_d, limits.following_error_m, limits.following_error_s):
        faults |= _FOLLOWING
    return faults, warnings


@helper
def judge_frames(tick: Any, memory: Any) -> int:
    """Return fault bits of what was heard on the bus.

    Another controller and an emergency stop of another node fault in every mode; what the drives say of
    themselves counts once they have been set up, as long as they are needed.
    """
    memory.untrusted = refusals(memory.untrusted, tick.rejected - tick.sensors_rejected)
    faults = 0
    if second_controller(tick.foreign):
        faults |= _SECOND_CONTROLLER
    if estop_heard(tick.foreign):
        faults |= _ESTOP
    if tick.mode > _UNLOADING and tick.mode != _HELD:
        return faults
    if tick.mode >= _IDLE and tick.doubled != 0:
        faults |= _DUPLICATE_NODE
    if tick.mode >= _IDLE and tick.altered != 0:
        faults |= _SET_UP
    if tick.mode >= _LOADING and unreliable(memory.untrusted):
        faults |= _REFUSED_FRAMES
    return faults


@helper
def limit_effort(
    tick: Any, limits: Any, memory: Any, history: Array, lows: Array, highs: Array
) -> tuple[int, int]:
    """Fill tau with what the limits leave of tau_asked; return fault bits and warning bits.

    history (n, 6) N is a ring of the forces sent, its newest row `memory.newest`, lows and highs as in
    `hil.safety.force_limits`; the forces held during skipped periods and the new ones are written into it.
    Asked for anything that is not finite, the answer is LAW and no force.
    """
    faults = warnings = 0
    tau = tick.tau
    tau[:] = tick.tau_asked
    if not all_finite(tau):
        faults = _LAW
        tau[:] = 0.0
    push_legs(tau, limits, memory)
    rows = history.shape[0]
    newest = memory.newest
    last = history[newest].copy()
    for _ in range(min(tick.skipped, rows)):
        newest = (newest + 1) % rows
        remember(last, newest, history, lows, highs)
    low, high = window_extremes(lows, highs)
    if limit_force(tau, limits.force_N):
        warnings |= _FORCE_LIMIT
    if limit_step(tau, last, limits.force_step_N):
        warnings |= _FORCE_STEP
    if limit_window(tau, low, high, limits.force_window_N):
        warnings |= _FORCE_WINDOW
    memory.newest = (newest + 1) % rows
    remember(tau, memory.newest, history, lows, highs)
    return faults, warnings


@helper
def judge_certificate(tick: Any, running: int, late: bool, watched: Array) -> tuple[int, int]:
    """Fill the Lyapunov columns, see `hil.safety.certificate`; return fault bits and warning bits.

    running: not 0 while the brakes are open and the law moves the platform. Watched anew after a late,
    skipped or stale tick, one with an unseen leg, a jump of the reference, and a limit that acted.
    """
    if not watched.size:
        return 0, 0
    certificate, memory = watched[:CONSTANTS], watched[CONSTANTS:]
    if running == 0:
        forget(memory)
        return 0, 0
    measured = tick.unseen == 0 and not stale(tick.counted_age, 1)
    whole = measured and not late and tick.skipped == 0 and memory[PAST, UNREST] == 0.0
    whole = whole and not jumped(certificate, memory, tick.q_d, tick.dq_d, tick.ddq_d)
    e, de, rate, feed = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    error_axes(certificate[SCALARS, POSE] > 0.0, tick, e, de, rate, feed)
    figures = np.empty(FIGURES)
    late_s, periods = 1e-9 * abs(tick.lateness_ns), 1.0 + tick.skipped
    broken = watch(certificate, memory, e, de, rate, feed, whole, late_s, periods, figures)
    tick.lyapunov, tick.lyapunov_rate = figures[V], figures[DV]
    tick.lyapunov_bound, tick.lyapunov_share = figures[BOUND], figures[SHARE]
    remember_reference(memory, tick.q_d, tick.dq_d, tick.ddq_d)
    if not measured:
        unsettle(memory)
    action = certificate[SCALARS, ACTION]
    if not broken or action == 0.0:
        return 0, 0
    return _CERTIFICATE if action > 1.0 else 0, _WARN_CERTIFICATE


@helper
def judge_loop(tick: Any, memory: Any, late: bool, losing: bool) -> int:
    """Take note of this tick's time, bus and recorder; return warning bits."""
    warnings = 0
    memory.late = late_history(memory.late, late, tick.skipped)
    memory.missed = missed_run(memory.missed, tick.skipped)
    memory.refused = refusals(memory.refused, tick.sends_failed)
    if tick.stretched_ns >= HARMFUL_STRETCH_NS:
        memory.stretched_ns += tick.stretched_ns
    if late:
        warnings |= _WARN_LATE
    if is_degraded(memory.late):
        warnings |= _WARN_DEGRADED
    if losing:
        warnings |= _WARN_RECORDER
    if tick.rejected > 0:
        warnings |= _WARN_REJECTED
    if bus_noisy(tick.bus_errors, tick.bus_overflow, tick.sends_failed):
        warnings |= _WARN_BUS
    return warnings


@kernel(TICK_SEEN, record(LIMITS), record(MEMORY), OUT_MATRIX, OUT_MATRIX, OUT_MATRIX, OUT_MATRIX)
def judge(
    tick: Any, limits: Any, memory: Any, history: Array, lows: Array, highs: Array, watched: Array
) -> tuple[int, int, int]:
    """Fill tau, no force where the drives are off, and the Lyapunov columns.

    Returns fault bits, warning bits and why to stop. Takes the tick whole but for what is sent: the rules
    look at all of it. Changes memory, the force window and what is watched; see `Safety`.
    """
    late = is_late(tick.lateness_ns, limits.period_ns) or is_apart(tick.sync_skew_ns, limits.sync_skew_ns)
    losing = recorder_losing(tick.recorder_alive != 0, tick.recorder_dropped, memory.dropped)
    memory.dropped = tick.recorder_dropped
    warnings = judge_loop(tick, memory, late, losing) | tick.fusion_warnings
    faults, more = judge_state(tick, limits, memory)
    warnings |= more
    faults |= judge_encoders(tick, limits, memory, history, memory.running != 0)
    faults |= judge_standstill(tick, limits, memory)
    faults |= judge_frames(tick, memory)
    broken, more = judge_certificate(tick, memory.running, late, watched)
    faults |= broken
    warnings |= more
    if not powered(tick.mode):
        history[:] = 0.0
        lows[:] = 0.0
        highs[:] = 0.0
        tick.tau[:] = 0.0
        return faults, warnings, _NO_STOP
    faults |= tick.fusion_faults
    if bus_down(tick.bus_off != 0, memory.refused):
        faults |= _BUS
    law, more = limit_effort(tick, limits, memory, history, lows, highs)
    if watched.size:
        settle(watched[CONSTANTS:], more != 0 or pushing(memory))
    stop = _STOP_MISSED if too_many_missed(memory.missed, limits.missed_stop_ticks) else _NO_STOP
    if too_stretched(memory.stretched_ns, tick.tick * limits.period_ns, limits.stretch_percent):
        stop = _STOP_STRETCHED
    if losing and limits.stop_on_recorder_loss != 0:
        stop = _STOP_RECORDER
    return faults | law, warnings | more, stop


judge_tick = entry(judge)
"""`judge`, from the interpreter."""
