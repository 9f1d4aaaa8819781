"""The compiled part of a tick: from received frames to the estimate, and from the reference to sent frames.

`observe` decodes and estimates. If its result is not 0, the cycle decides next, in Python. `act` then goes
from the reference through law and safety to the encoded command. Both work on one record, CONTROL, which the
cycle owns. Functions that differ between robots are called by address.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper, kernel, record, records
from drivers.compiled.pointed import address_of, call, integers_at, reals_at, record_at
from drivers.frame_array import FRAME
from drivers.signals import DriveMode, DriveState, Mode, Warn
from drivers.tick_columns import TICK, part
from hil.control.pointed_law import ask
from hil.estimation.pose import ESTIMATOR, estimate_pose
from hil.loop.modes import CONTROLLED as CONTROLLED_MODES
from hil.loop.motion import MOTION, advance, ahead, ended, place_reference
from hil.loop.probe import fill_probe, look
from hil.loop.reference import fill_sample, holding_share, smoothstep
from hil.loop.tick_input import crc32
from hil.robot.force_path import path_at
from hil.robot.force_path import send as send_force
from hil.safety.kernels import LIMITS, MEMORY, TICK_SEEN, judge, limit, powered
from hil.trajectory.override import OVERRIDE, is_full, time_at
from hil.trajectory.path import SAMPLE

CONTROL = np.dtype(
    [
        # functions, each with the address of what it works on; a stage that is not there is 0
        ("decode", "<i8"), ("decoder", "<i8"), ("command", "<i8"), ("codec", "<i8"),
        ("hear", "<i8"), ("sensors", "<i8"), ("compare", "<i8"), ("fuse", "<i8"), ("filter", "<i8"),
        ("load", "<i8"), ("loads", "<i8"), ("last_load", "<i8"),  # the last one: address of the wrench, (6,)
        ("steer", "<i8"), ("live", "<i8"), ("judge", "<i8"), ("admission", "<i8"),  # of a live reference
        ("learn", "<i8"), ("learner", "<i8"), ("predict", "<i8"), ("predictor", "<i8"),
        ("law", "<i8"), ("gains", "<i8"), ("constants", "<i8"), ("code", "<i8"),
        ("robot", "<i8"),  # the model's constants by which legs bear their load
        ("senses_wrench", "<i8"),  # 1: a sensor gives the external wrench
        # records of the parts
        ("estimator", "<i8"), ("motion", "<i8"), ("override", "<i8"), ("sample", "<i8"), ("ahead", "<i8"),
        ("limits", "<i8"), ("memory", "<i8"),
        ("window", "<i8"), ("window_rows", "<i8"), ("watched", "<i8"), ("watched_rows", "<i8"),
        # constants
        ("base_joints", "<f8", (6, 3)), ("platform_joints", "<f8", (6, 3)),
        ("period_s", "<f8"), ("load_s", "<f8"), ("blend_s", "<f8"), ("reach_N", "<f8"),
        ("horizon_s", "<f8"),  # of the predictor
        ("has_load", "<i8"),  # 1: something gives the external wrench
        ("paths", "<i8", (2,)),  # records of the force paths that follow what is sent
        # what the cycle has decided
        ("mode", "<i8"), ("mode_tick", "<i8"), ("faults", "<i8"), ("command_mode", "<i8"),
        ("located", "<i8"), ("fusing", "<i8"),  # 1: the pose has been found; the filter has begun
        ("rotation", "<i8"),  # address of how the platform is turned, (3, 3), as it was last seen
        ("along", "<i8"),  # 1: on the reference with learned forces, or on the way to its start
        ("watchful", "<i8"),  # 1: it decides in each tick
        ("attentive", "<i8"),  # 1: it looks at the verdict of this tick
        ("due", "<i8"), ("due_states", "<i8"),  # ticks in the mode; bits of the six states that end it then
        ("overdue", "<i8"),  # ticks in the mode after which the drives are late
        ("on_path", "<i8"),  # 1: on the path, and not on a jog from it
        ("ends", "<i8"),  # 1: the mode ends with the motion
        ("live_since", "<i8"),  # tick at which the live reference began; NEVER: it is not under way
        ("key_until", "<i8"),  # tick from which the operator's key counts as let go
        ("fixed", "<i8"),  # 1: the holding force as it is
        ("holding", "<f8", (6,)), ("offset", "<f8", (6,)),  # N
        ("entry_tick", "<i8"),  # when the offset began to fade; -1: it is whole
        ("setpoints", "<i8", (3,)), ("stops", "<i8"),
        # what the pass has found
        ("tick", "<i8"), ("last", "<i8"),
        ("learned", "<f8", (6,)), ("shortfall", "<f8", (6,)),
        ("sensor_late", "<i8"),  # Warn.SENSOR or 0
        ("verdict", "<i8", (3,)),  # faults, warnings, why to stop
        ("sent", "<i8"),  # frames of the command
    ]
)  # fmt: skip
"""The controller's state, shared by Python and compiled code. Addresses and flags are integers."""

DIALOGUE, UNLOCATED, MODE = 1, 2, 4
"""Bits that `observe` returns: news in the drives' dialogue; the pose is not yet found; the mode may end."""
EFFORT, JUDGE, COMMAND = 1, 2, 4
"""Parts of a tick that `act` can run, as bits."""
ALL = EFFORT | JUDGE | COMMAND
DONE, VERDICT, UNFIT, STOPPED = range(4)
"""Results of `act`: complete; stopped before the command, with a verdict to handle; a force does not fit its
field; stopped at the start, as the live reference stops on its way: its Refusal bits are the verdict."""
NEVER = 1 << 62
AGREED_m = 1e-4
"""Residual, m, below which a fused pose agrees with all six lengths, so that the legs alone can go on from
it."""
_ALL_LEGS = (1 << 6) - 1
WHOLE = -1
_WARN_SENSOR, _WARN_SETPOINT = int(Warn.SENSOR), int(Warn.SETPOINT)
_TRACKING, _HELD = int(Mode.TRACKING), int(Mode.HELD)
_LOADING, _UNLOADING = int(Mode.LOADING), int(Mode.UNLOADING)
_READY, _RUN, _FREE = int(DriveMode.READY), int(DriveMode.RUN), int(DriveState.RUN)
_CONTROLLED = sum(1 << mode for mode in CONTROLLED_MODES)
_WORDS = TICK.itemsize // 8
_TICK = record(TICK)
_CONTROL = record(CONTROL)
_tick_at = record_at(_TICK)
_seen_at = record_at(TICK_SEEN)
_estimated_at = record_at(record(TICK, *part("estimate")))
_estimator_at = record_at(record(ESTIMATOR))
_limits_at, _memory_at = record_at(record(LIMITS)), record_at(record(MEMORY))
_motion_at, _override_at = record_at(record(MOTION)), record_at(record(OVERRIDE))
_sample_at = record_at(record(SAMPLE))


@helper
def controlled(mode: int) -> bool:
    """True in a mode in which the control law computes the forces."""
    return bool(_CONTROLLED >> mode & 1)


@helper
def estimate(c: Any, tick: Any) -> None:
    """Fill in the tick's estimated pose and twist; a leg without fresh data is extrapolated at its rate."""
    for i in range(6):
        if tick.age[i]:
            for j in range(6):
                tick.q[j] += tick.dq[j] * (tick.age[j] * c.period_s)
            break
    estimate_pose(_estimator_at(c.estimator), _estimated_at(c.tick))


@helper
def fuse(c: Any, tick: Any, last: Any) -> None:
    """Fill in the tick's estimate by the fusion filter, once the filter has started."""
    tau = np.int64(last.tau.ctypes.data)
    call(c.fuse, (c.filter, c.sensors, tau, c.last_load, c.tick))
    if tick.legs_used == _ALL_LEGS and tick.fk_residual < AGREED_m:
        estimator = _estimator_at(c.estimator)
        estimator.p[:] = tick.p
        estimator.R[:] = tick.R


@helper
def load(c: Any) -> None:
    """Fill in the tick's external wrench, from sensor or observer, and compare the sensors with the legs."""
    if c.load:
        c.sensor_late = _WARN_SENSOR if call(c.load, (c.loads, c.fusing, c.tick)) > 0 else 0
    if c.compare:
        c.sensor_late |= call(c.compare, (c.loads, c.sensors, c.mode, c.fusing, c.tick))


@helper
def may_end(c: Any, tick: Any) -> bool:
    """True if the present mode may end in this tick, so that the cycle has to decide in Python."""
    elapsed = tick.tick - c.mode_tick
    if c.watchful or elapsed > c.overdue or tick.tick >= c.key_until or tick.altered:
        return True
    if c.ends and ended(_motion_at(c.motion), _override_at(c.override), tick.tick):
        return True
    if elapsed < c.due:
        return False
    for i in range(6):  # noqa: SIM110 - compiled
        if not c.due_states >> tick.drive_state[i] & 1:
            return False
    return True


@kernel(_CONTROL, _TICK, _TICK, records(FRAME))
def observe(c: Any, tick: Any, last: Any, frames: Any) -> int:
    """Fill in measurement, estimate and wrench of a tick from its input columns and the frames received.

    Returns bits of DIALOGUE (set-up of drives changed), UNLOCATED (no pose yet) and MODE (mode may end) for
    the cycle to handle in Python; 0: none.
    """
    c.tick, c.last = address_of(tick), address_of(last)
    tick.frames_received = frames.shape[0]
    tick.frames_crc32 = crc32(frames)
    began_ns = tick.t_ns + tick.lateness_ns
    at = np.int64(frames.ctypes.data)
    status = call(c.decode, (c.decoder, at, np.int64(frames.shape[0]), began_ns, c.last, c.tick))
    look = DIALOGUE if status > 0 else 0
    if c.hear:
        call(c.hear, (c.loads, c.sensors, at, np.int64(frames.shape[0]), c.rotation, c.tick))
    tick.q[:] = tick.length
    tick.dq[:] = tick.rate
    if not c.located:
        return look | UNLOCATED | MODE
    if c.fusing:
        fuse(c, tick, last)
    else:
        estimate(c, tick)
    load(c)
    advance(_motion_at(c.motion), _override_at(c.override), tick.tick)
    return look | MODE if may_end(c, tick) else look


@helper
def entry_share(c: Any, number: int) -> float:
    """Share, 1 .. 0, of the entry offset (holding force less the law's force) that is left in a tick."""
    if c.entry_tick == WHOLE:
        return 1.0
    if c.blend_s == 0.0:
        return 0.0
    return 1.0 - smoothstep((number - c.entry_tick) * c.period_s / c.blend_s)


@helper
def place(c: Any, tick: Any) -> None:
    """Fill in the tick's reference: the sample of the motion, or the present pose while no law acts."""
    sample, motion, override = _sample_at(c.sample), _motion_at(c.motion), _override_at(c.override)
    if controlled(c.mode) or c.mode == _UNLOADING:
        place_reference(override, motion.function, motion.context, tick.tick, sample)
    else:
        sample.p[:] = tick.p
        sample.R[:] = tick.R
        sample.twist[:] = 0.0
        sample.dtwist[:] = 0.0
    fill_sample(c.base_joints, c.platform_joints, sample, tick)
    tick.reference_time_s = time_at(override, tick.tick)
    if c.mode == _TRACKING and c.on_path and is_full(override):
        tick.t_d = tick.reference_time_s


@helper
def all_free(tick: Any) -> bool:
    """True if all drives report that their brakes are open."""
    for i in range(6):  # noqa: SIM110 - compiled
        if tick.drive_state[i] != _FREE:
            return False
    return True


@helper
def seen_by_law(c: Any, tick: Any) -> Any:
    """Address of the tick record for the law: the present one, or one predicted for when its force will act.

    Safety checks the present tick. The external wrench fades in as the entry offset fades out: both stand for
    the load that the law's own model does not contain.
    """
    if not (c.predict or c.has_load):
        return c.tick
    now, then = integers_at(c.tick, _WORDS), integers_at(c.ahead, _WORDS)
    then[:] = now
    seen = _tick_at(c.ahead)
    if c.predict:
        call(c.predict, (c.predictor, np.int64(all_free(tick)), c.ahead))
    if c.has_load:
        share = 1.0 - entry_share(c, tick.tick)
        for i in range(6):
            seen.wrench[i] *= share
    if c.predict and controlled(c.mode):
        sample, motion, override = _sample_at(c.sample), _motion_at(c.motion), _override_at(c.override)
        _, t = ahead(motion, override, tick.tick, c.horizon_s, sample)
        if np.isnan(t) and c.mode == _TRACKING and c.on_path and is_full(override):
            t = time_at(override, tick.tick) + c.horizon_s
        fill_sample(c.base_joints, c.platform_joints, sample, seen)
        seen.t_d = t
    return c.ahead


@helper
def fill_effort(c: Any, tick: Any) -> None:
    """Fill in the law's force, the learned force, and the requested total force, (6,) N each."""
    acts = 0
    if c.learn:
        given = (c.learner, c.motion, c.override, tick.tick, c.mode, c.mode_tick, c.along, c.faults)
        acts = call(c.learn, (*given, np.int64(c.learned.ctypes.data)))
    if c.fixed:
        tick.tau_asked[:] = c.holding
        return
    at = seen_by_law(c, tick)
    if controlled(c.mode):
        seen = _tick_at(at)
        seen.shortfall[:] = c.shortfall
        ask(c.law, c.gains, c.constants, c.code, at)
        tick.tau_law[:] = seen.tau_law
        left = entry_share(c, tick.tick)
        learns = acts > 0 and c.mode != _HELD
        for i in range(6):
            asked = tick.tau_law[i]
            if left > 0.0:
                asked += c.offset[i] * left
            if learns:
                tick.tau_learned[i] = c.learned[i]
                asked += c.learned[i]
            if c.mode == _HELD:
                asked = within(asked, c.holding[i] - c.reach_N, c.holding[i] + c.reach_N)
            tick.tau_asked[i] = asked
    elif c.load_s > 0.0 and c.mode in (_LOADING, _UNLOADING):
        elapsed_s = (tick.tick - c.mode_tick) * c.period_s
        share = holding_share(c.mode, elapsed_s, c.load_s)
        for i in range(6):
            tick.tau_asked[i] = c.holding[i] * share


@helper
def within(value: float, low: float, high: float) -> float:
    """The value clamped to low .. high; nan stays nan."""
    return low if value < low else min(value, high)


@helper
def judge_pass(c: Any, tick: Any) -> bool:
    """Run the safety checks and limits: fills in the probe force and tau, the limited sum of all forces, N.

    The verdict (faults, warnings, stop) goes into the record. True if Python has to handle it, or a probe
    starts.
    """
    tick.mode, begins = c.mode, False
    window, watched = reals_at(c.window, (c.window_rows, 6)), reals_at(c.watched, (c.watched_rows, 6))
    limits, memory = _limits_at(c.limits), _memory_at(c.memory)
    seen = _seen_at(c.tick)
    faults, warnings, c.verdict[2] = judge(seen, limits, memory, window, watched)
    if powered(c.mode):
        if memory.strays:
            look(tick, limits, memory, window, c.robot, c.senses_wrench)
        begins = fill_probe(tick, _tick_at(c.last), limits, memory)
    law, limited = limit(seen, limits, memory, window, watched)
    c.verdict[0], c.verdict[1] = faults | law, warnings | limited | c.sensor_late
    return bool(begins or c.attentive or c.verdict[0] or c.verdict[2])


@helper
def send(c: Any, tick: Any, into: Any) -> int:
    """Fill in the command's columns and its frames at address `into`; returns DONE, or UNFIT: no frames."""
    if c.command_mode not in (_READY, _RUN):
        tick.tau[:] = 0.0
    tick.command_mode = c.command_mode
    limited = c.verdict[1] != 0 and controlled(c.mode)
    for i in range(6):
        c.shortfall[i] = tick.tau[i] - tick.tau_asked[i] - tick.probe_force[i] if limited else 0.0
    for k in range(2):
        if c.paths[k]:
            send_force(path_at(c.paths[k]), tick.tau)
    tick.mode, tick.faults, tick.warnings = c.mode, c.faults, c.verdict[1]
    tick.setpoints_taken, tick.setpoints_refused = c.setpoints[0], c.setpoints[1]
    tick.setpoint_refusal = c.setpoints[2]
    if c.setpoints[2]:
        tick.warnings |= _WARN_SETPOINT
    tau = np.int64(tick.tau.ctypes.data)
    arguments = (c.codec, tick.tick, c.command_mode, c.stops, tau, np.int64(into))
    c.sent = call(c.command, arguments)
    return UNFIT if c.sent < 0 else DONE


@kernel(_CONTROL, _TICK, records(FRAME), INTEGER)
def act(c: Any, tick: Any, into: Any, parts: int) -> int:
    """Run the given parts of a tick, EFFORT, JUDGE, COMMAND; returns DONE, STOPPED, VERDICT or UNFIT.

    into: FRAME records for the command; the record's `sent` counts the filled ones.
    """
    if parts & EFFORT:
        if c.live_since != NEVER:
            against = call(c.steer, (c.live, c.judge, c.admission, tick.tick - c.live_since))
            if against:
                c.verdict[0] = against
                return STOPPED
        place(c, tick)
        fill_effort(c, tick)
    if parts & JUDGE and judge_pass(c, tick):
        return VERDICT
    return send(c, tick, np.int64(into.ctypes.data)) if parts & COMMAND else DONE
