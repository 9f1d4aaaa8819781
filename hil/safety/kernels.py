"""All safety checks of one tick in kernels: faults, warnings, and force limits."""

from math import nan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import OUT_MATRIX, helper, kernel, record
from drivers.signals import LEGS, DriveState, Fault, Foreign, Mode, Stop, Warn
from drivers.tick_columns import TICK, part
from hil.config.limits import LimitSettings
from hil.safety import certificate
from hil.safety.encoder_limits import ENCODER_LIMITS, ENCODER_MEMORY
from hil.safety.encoder_rules import judge_encoders, probed
from hil.safety.error_axes import error_axes
from hil.safety.force_limits import limit_effort
from hil.safety.motion import HOP, REST_m_s, at_rest, lagging, moved_legs, overspeed, too_fast_for_end
from hil.safety.signals import (
    CONTROLLER,
    DEGRADED_AT,
    HARMFUL_STRETCH_NS,
    HISTORY,
    STRETCH_FREE_NS,
    UNRELIABLE,
    all_finite,
    bus_down,
    noted,
    ones,
    stale,
)

LIMITS = np.dtype(
    [
        *(
            (name, "<i8" if field.annotation is int else "<f8")
            for name, field in LimitSettings.model_fields.items()
            if field.annotation in {int, float}  # optional limits are not compared here
        ),
        ("length_min_m", "<f8"), ("length_max_m", "<f8"),
        ("settle_ticks", "<i8"), ("window_ticks", "<i8"),
        ("period_ns", "<i8"), ("sync_skew_ns", "<i8"),
        ("stop_on_recorder_loss", "<i8"),
        *ENCODER_LIMITS,
    ]
)  # fmt: skip
"""Record of the limits of all checks: section `limits` and computed ones."""
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
"""Record of what the checks remember from tick to tick."""
TICK_SEEN = record(
    TICK, "mode", *part("input", "measurement", "estimate", "fusion", "reference", "effort", "verdict")
)


@helper
def _finite(tick: Any) -> bool:
    measured = all_finite(tick.length) and all_finite(tick.rate) and all_finite(tick.drive_force)
    state = all_finite(tick.q) and all_finite(tick.dq) and all_finite(tick.p) and all_finite(tick.R)
    state = state and all_finite(tick.twist) and all_finite(tick.J)
    reference = all_finite(tick.q_d) and all_finite(tick.dq_d) and all_finite(tick.ddq_d)
    return measured and state and reference and all_finite(tick.twist_d) and all_finite(tick.dtwist_d)


@helper
def powered(mode: int) -> bool:
    """True if the drives are powered: from LOADING to UNLOADING, and in HELD."""
    return Mode.LOADING <= mode <= Mode.UNLOADING or mode == Mode.HELD


@helper
def judge_standstill(tick: Any, limits: Any, memory: Any) -> int:
    """Find the legs that moved where they must stand still; returns fault bits.

    They must stand still while the brakes are closed. After a fault they must as soon as they have been at
    rest for some time.
    """
    mode = tick.mode
    closed = mode in (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
    slow = mode == Mode.FAULT and at_rest(tick.rate, tick.age, REST_m_s)
    memory.resting = memory.resting + 1 if slow else 0
    stands = closed or memory.resting > limits.settle_ticks
    if stands and memory.standing == 0:
        memory.still[:] = nan
    memory.standing = int(stands)
    tick.legs_moved = moved_legs(tick.length, tick.age, memory.still, limits.standstill_m) if stands else 0
    return Fault.BRAKE.value if tick.legs_moved != 0 else 0


@helper
def judge_state(tick: Any, limits: Any, memory: Any) -> tuple[int, int]:
    """Check legs, drives, estimate and reference; returns fault bits and warning bits.

    The tracking error is checked from RELEASING to PARKING. Faults only while the drives are powered.
    """
    faults = warnings = 0
    mode = tick.mode
    if mode > Mode.IDLE and stale(tick.counted_age, limits.stale_warn_ticks):
        warnings |= Warn.STALE.value
    if not powered(mode):
        memory.running = 0
        return faults, warnings
    if not _finite(tick):
        faults |= Fault.NOT_FINITE.value

    proves = mode in (Mode.LOADING, Mode.UNLOADING)  # no estimate proves a brake
    ages = tick.age if proves else tick.counted_age
    if stale(ages, limits.stale_fault_ticks) or (proves and tick.legs_slipped != 0):
        faults |= Fault.STALE.value
    run, lost = True, False  # BOOT: it restarted under load
    for state in tick.drive_state:
        run = run and state == DriveState.RUN
        lost = lost or state in (DriveState.FAULT, DriveState.BOOT)
    moving = Mode.RELEASING <= mode <= Mode.STOPPING
    if lost or (moving and memory.running != 0 and not run):
        faults |= Fault.DRIVE.value
    memory.running = int(moving and (run or memory.running != 0))

    # written so that NaN faults
    if not tick.fk_residual <= limits.consistency_m:
        faults |= Fault.KINEMATICS.value
    if not tick.hop < HOP:
        faults |= Fault.ASSEMBLY.value
    if not tick.condition <= limits.condition:
        faults |= Fault.CONDITION.value

    low, high, margin = limits.length_min_m, limits.length_max_m, limits.stroke_margin_m
    for length in tick.q:
        if length < low or length > high:
            faults |= Fault.STROKE.value
    if too_fast_for_end(tick.q, tick.dq, low + margin, high - margin, limits.deceleration_m_s2):
        faults |= Fault.STROKE.value
    if overspeed(tick.dq, limits.speed_m_s):
        faults |= Fault.SPEED.value
    follows = Mode.RELEASING <= mode <= Mode.PARKING
    if follows and lagging(tick.q, tick.q_d, tick.dq_d, limits.following_error_m, limits.following_error_s):
        faults |= Fault.FOLLOWING.value
    return faults, warnings


@helper
def judge_frames(tick: Any, memory: Any) -> int:
    """Check the frames received on the bus; returns fault bits.

    Another controller, and an emergency stop of another node, are faults in every mode. The drives' own
    frames count after their set-up, as long as the drives are in use.
    """
    memory.untrusted = noted(memory.untrusted, tick.rejected > tick.sensors_rejected)
    faults = 0
    if tick.foreign & CONTROLLER:
        faults |= Fault.SECOND_CONTROLLER.value
    if tick.foreign & Foreign.ESTOP.value:
        faults |= Fault.ESTOP.value
    if tick.mode > Mode.UNLOADING and tick.mode != Mode.HELD:
        return faults
    if tick.mode >= Mode.IDLE and tick.doubled != 0:
        faults |= Fault.DUPLICATE_NODE.value
    if tick.mode >= Mode.IDLE and tick.altered != 0:
        faults |= Fault.SET_UP.value
    if tick.mode >= Mode.LOADING and ones(memory.untrusted) >= UNRELIABLE:
        faults |= Fault.REFUSED_FRAMES.value
    return faults


@helper
def judge_certificate(tick: Any, running: int, late: bool, watched: Array) -> tuple[int, int]:
    """Check the certificate (`hil.safety.certificate`) and fill in the Lyapunov columns of a tick.

    Returns fault bits and warning bits. running: not 0 while the brakes are open and the law moves the
    platform. The check restarts after a late, skipped or stale tick, after a tick with an unseen leg, a jump
    of the reference, or an active limit.
    """
    if not watched.size:
        return 0, 0
    constants, memory = watched[: certificate.CONSTANTS], watched[certificate.CONSTANTS :]
    if running == 0:
        certificate.forget(memory)
        return 0, 0
    measured = tick.unseen == 0 and not stale(tick.counted_age, 1)
    whole = (
        measured and not late and tick.skipped == 0 and memory[certificate.PAST, certificate.UNREST] == 0.0
    )
    whole = whole and not certificate.jumped(constants, memory, tick.q_d, tick.dq_d, tick.ddq_d)
    e, de, rate, feed = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    error_axes(constants[certificate.SCALARS, certificate.POSE] > 0.0, tick, e, de, rate, feed)
    late_s, periods = 1e-9 * abs(tick.lateness_ns), 1.0 + tick.skipped
    broken = certificate.watch(constants, memory, e, de, rate, feed, whole, late_s, periods, tick)
    certificate.remember_reference(memory, tick.q_d, tick.dq_d, tick.ddq_d)
    if not measured:
        certificate.unsettle(memory)
    action = constants[certificate.SCALARS, certificate.ACTION]
    if not broken or action == 0.0:
        return 0, 0
    return Fault.CERTIFICATE.value if action > 1.0 else 0, Warn.CERTIFICATE.value


@helper
def judge_loop(tick: Any, memory: Any, late: bool, losing: bool) -> int:
    """Record this tick's timing and the state of bus and recorder; returns warning bits.

    A skipped period counts as a late tick. Only a tick without a skipped period before it resets the count of
    missed periods, so a loop that runs only every third tick is still stopped.
    """
    warnings = 0
    for _ in range(min(tick.skipped, HISTORY)):
        memory.late = noted(memory.late, True)
    memory.late = noted(memory.late, late)
    memory.missed = memory.missed + tick.skipped if tick.skipped > 0 else 0
    memory.refused = noted(memory.refused, tick.sends_failed > 0)
    if tick.stretched_ns >= HARMFUL_STRETCH_NS:
        memory.stretched_ns += tick.stretched_ns
    if late:
        warnings |= Warn.LATE.value
    if ones(memory.late) >= DEGRADED_AT:
        warnings |= Warn.DEGRADED.value
    if losing:
        warnings |= Warn.RECORDER.value
    if tick.rejected > 0:
        warnings |= Warn.REJECTED.value
    if tick.bus_errors > 0 or tick.bus_overflow > 0 or tick.sends_failed > 0:
        warnings |= Warn.BUS.value
    return warnings


@kernel(TICK_SEEN, record(LIMITS), record(MEMORY), OUT_MATRIX, OUT_MATRIX)
def judge(tick: Any, limits: Any, memory: Any, window: Array, watched: Array) -> tuple[int, int, int]:
    """Run all safety checks of a tick; `limit`, which comes next, limits its forces tau.

    Returns fault bits, warning bits and the reason to stop. The checks read the whole tick except the sent
    columns. Changes memory and watched; see `Safety`. A tick is late if it woke up more than a fifth of a
    period too late, or if the SYNCs of the buses were too far apart.
    """
    late = 5 * tick.lateness_ns > limits.period_ns or tick.sync_skew_ns > limits.sync_skew_ns
    losing = tick.recorder_alive == 0 or tick.recorder_dropped > memory.dropped
    memory.dropped = tick.recorder_dropped
    warnings = judge_loop(tick, memory, late, losing) | tick.fusion_warnings
    faults, more = judge_state(tick, limits, memory)
    warnings |= more
    faults |= judge_encoders(tick, limits, memory, window, memory.running != 0)
    faults |= judge_standstill(tick, limits, memory)
    faults |= judge_frames(tick, memory)
    broken, more = judge_certificate(tick, memory.running, late, watched)
    faults |= broken
    warnings |= more
    if not powered(tick.mode):
        return faults, warnings, Stop.NONE.value
    faults |= tick.fusion_faults
    if bus_down(tick.bus_off != 0, memory.refused):
        faults |= Fault.BUS.value
    stop = Stop.MISSED.value if memory.missed >= limits.missed_stop_ticks else Stop.NONE.value
    may_stand_ns = STRETCH_FREE_NS + 0.01 * limits.stretch_percent * (tick.tick * limits.period_ns)
    if memory.stretched_ns > may_stand_ns:
        stop = Stop.STRETCHED.value
    if losing and limits.stop_on_recorder_loss != 0:
        stop = Stop.RECORDER.value
    return faults, warnings, stop


@kernel(TICK_SEEN, record(LIMITS), record(MEMORY), OUT_MATRIX, OUT_MATRIX)
def limit(tick: Any, limits: Any, memory: Any, window: Array, watched: Array) -> tuple[int, int]:
    """Fill tau (6,) N with the limited force, 0 while the drives are off; returns fault and warning bits.

    Changes the force window, and pauses the certificate check where a force is not the law's.
    """
    if not powered(tick.mode):
        window[:] = 0.0
        tick.tau[:] = 0.0
        return 0, 0
    faults, warnings = limit_effort(tick, limits, memory, window)
    if watched.size:
        certificate.settle(watched[certificate.CONSTANTS :], warnings != 0 or probed(tick, memory))
    return faults, warnings
