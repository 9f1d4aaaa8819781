"""What happens to all six emulated drives in one tick, compiled.

A row of the two matrices is one quantity of six drives.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import (
    INTEGER,
    OUT_INTEGER_MATRIX,
    OUT_INTEGERS,
    OUT_MATRIX,
    OUT_VECTOR,
    REAL,
    VECTOR,
    direct,
    helper,
    kernel,
)
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Reaction

BOOT, OFF, READY, RUN, FAULT = map(int, DriveState)
BRAKE, DAMP, HOLD, ZERO = map(int, Reaction)
NEVER_NS = 1 << 62
WORKS = -1
"""A brake that is not stuck."""

(
    STATE,
    REASON,
    CONFIGURED,
    COUNTER,
    WATCHDOG,
    DEADLINE,
    REACTION,
    ACTING,
    STUCK,
    LOST,
    SLOW,
    MOVED,
    FOLLOWED,
) = range(13)
"""Rows of `integers`: DriveState, DriveFault, 1 if set up, counter of the last command, ns, ns, Reaction of a
fault in RUN, Reaction of the latched fault, where a stuck brake stays, INVALID for a lost encoder, ns that a
slow brake is later than its drive counts, ns when a brake that moves has moved, as its drive counts and in
truth."""
(
    COMMAND,
    HELD,
    LAGGED,
    FROZEN,
    OFFSET,
    SCALE,
    SHIFT,
    DRIFT,
    GAIN,
    MOST,
    FORCE,
    BRAKES,
    SHARE,
    KEPT,
    SHUT,
    TRUE,
) = range(16)
"""Rows of `reals`: N, last valid command, zero outside READY and RUN; m, where HOLD holds; N, state of the
lag; m, what a frozen encoder reads, NaN for one that works; m, slip of the encoder; how it scales length, and
m, what it adds then; m/s, its drift; gain of the wiring; N, most that the drive gives; what the plant has: N,
and 1 for an engaged brake; share of its force that a brake has; N, the drive's last force; 1 for a brake that
has closed, 0 for one that has opened, as its drive counts and in truth."""
LIMIT, DAMPING, STIFFNESS, LAGS, LAG_END, LAG_MEAN, OPENING, CLOSING = range(8)
"""Places of `stage`, what the drives have in common: rated force N, gains of the reactions N s/m and N/m, 1
if the force lags; end value and mean of that lag over one step of the plant; ns that a brake takes."""

TRANSITIONS: dict[DriveMode, dict[int, int]] = {
    DriveMode.OFF: {READY: OFF, RUN: OFF},
    DriveMode.READY: {OFF: READY, RUN: READY},
    DriveMode.RUN: {READY: RUN},
    DriveMode.RESET: {READY: OFF, RUN: OFF, FAULT: OFF},
}
"""What each commanded mode does to a drive; a state that is not listed stays as it is."""
_STAYS = -1
_NEXT = np.array(
    [[TRANSITIONS[mode].get(state, _STAYS) for state in map(int, DriveState)] for mode in DriveMode]
)
_MODE_OFF = int(DriveMode.OFF)
_NO_FAULT = int(DriveFault.NONE)


@kernel(OUT_INTEGER_MATRIX, OUT_MATRIX, INTEGER, INTEGER, INTEGER)
def enter(integers: Ints, reals: Array, leg: int, state: int, reason: int) -> None:
    """Move one drive to a state."""
    integers[STATE, leg] = state
    integers[REASON, leg] = reason
    if state not in (READY, RUN):
        reals[COMMAND, leg] = 0.0
        integers[DEADLINE, leg] = NEVER_NS


@helper
def configure(integers: Ints, reals: Array, message: Any) -> bool:
    """Set the drive of a message CONFIGURE up, unless it is powered; tell whether it was."""
    leg = message.legs[0]
    state = integers[STATE, leg]
    if state in (READY, RUN):
        return False
    integers[WATCHDOG, leg], integers[REACTION, leg] = message.counter, message.mode
    integers[CONFIGURED, leg] = 1
    if state == BOOT:
        enter(integers, reals, leg, OFF, _NO_FAULT)
    return True


@helper
def _encoder(integers: Ints, reals: Array, length: Array, rate: Array, leg: int) -> tuple[float, float]:
    """Return what an encoder reads before quantisation, m and m/s; 0 when lost."""
    if integers[LOST, leg]:
        return 0.0, 0.0
    if np.isnan(reals[FROZEN, leg]):
        scale = reals[SCALE, leg]
        moved = scale * length[leg] + reals[SHIFT, leg]
        return moved + reals[OFFSET, leg], scale * rate[leg] + reals[DRIFT, leg]
    return reals[FROZEN, leg], 0.0


@helper
def _move_brake(integers: Ints, reals: Array, stage: Array, leg: int, opens: bool, t_ns: int) -> None:
    """Begin or end the opening or closing of a brake; one that is called back has not moved."""
    wanted = 0.0 if opens else 1.0
    if reals[SHUT, leg] == wanted:
        integers[MOVED, leg] = NEVER_NS
        return
    if integers[MOVED, leg] == NEVER_NS:
        integers[MOVED, leg] = t_ns + np.int64(stage[OPENING] if opens else stage[CLOSING])
    if integers[MOVED, leg] <= t_ns:
        reals[SHUT, leg] = wanted
        integers[MOVED, leg] = NEVER_NS


@helper
def _follow(integers: Ints, reals: Array, leg: int, t_ns: int) -> None:
    """Let a brake do what its drive counts, later by what it is slow."""
    if reals[TRUE, leg] == reals[SHUT, leg]:
        integers[FOLLOWED, leg] = NEVER_NS
        return
    if integers[FOLLOWED, leg] == NEVER_NS:
        integers[FOLLOWED, leg] = t_ns + integers[SLOW, leg]
    if integers[FOLLOWED, leg] <= t_ns:
        reals[TRUE, leg] = reals[SHUT, leg]
        integers[FOLLOWED, leg] = NEVER_NS


@helper
def actuate(
    integers: Ints, reals: Array, stage: Array, length: Array, rate: Array, lag: bool, t_ns: int
) -> bool:
    """Set FORCE and BRAKES from the drives' states at `t_ns`; with `lag` over the next grid step.

    length m and rate m/s are the plant's. A drive that shuts its brake keeps its last force until that has
    closed. Returns whether a drive follows its encoder by itself.
    """
    controls = False
    for leg in range(LEGS):
        f = reals[COMMAND, leg]
        state = integers[STATE, leg]
        acting = integers[ACTING, leg] if state == FAULT else BRAKE
        opens = state == RUN or acting != BRAKE
        _move_brake(integers, reals, stage, leg, opens, t_ns)
        _follow(integers, reals, leg, t_ns)
        if not opens and state != READY and reals[SHUT, leg] == 0.0:
            f = reals[KEPT, leg]
        if acting in (DAMP, HOLD):
            controls = True
            l, dl = _encoder(integers, reals, length, rate, leg)
            f = -stage[DAMPING] * dl
            if acting == HOLD:
                f -= stage[STIFFNESS] * (l - reals[HELD, leg])
        if not -stage[LIMIT] <= f <= stage[LIMIT]:
            f = stage[LIMIT] if f > 0.0 else -stage[LIMIT]
        reals[KEPT, leg] = f
        f = min(max(f, -reals[MOST, leg]), reals[MOST, leg])
        if lag:
            gap = reals[LAGGED, leg] - f
            reals[LAGGED, leg] = f + gap * stage[LAG_END]
            f += gap * stage[LAG_MEAN]
        elif stage[LAGS] > 0.0:
            f = reals[LAGGED, leg]
        reals[FORCE, leg] = f * reals[GAIN, leg]
        stuck = integers[STUCK, leg]
        reals[BRAKES, leg] = reals[SHARE, leg] * (reals[TRUE, leg] if stuck == WORKS else float(stuck))
    return controls


@helper
def next_move_ns(integers: Ints) -> int:
    """Return when the next brake will have opened or closed, ns."""
    return int(min(integers[MOVED].min(), integers[FOLLOWED].min()))


@helper
def obey(
    integers: Ints,
    reals: Array,
    stage: Array,
    length: Array,
    rate: Array,
    legs: Ints,
    command: Array,
    mode: int,
    counter: int,
    feeds: bool,
    t_ns: int,
) -> tuple[bool, bool, int, int]:
    """Give the drives `legs` a command of so many N each at `t_ns`, the plant being there, and actuate.

    A command that does not feed the watchdogs feeds that of a drive alone that is powered just now. Returns
    whether the counter was new to one of them; if so, whether a drive follows its encoder by itself, see
    `actuate`; the legs that entered a state (bit i: leg i); and the earliest instant at which a watchdog ends
    or a brake has moved.
    """
    fresh, entered = False, 0
    for k in range(legs.shape[0]):
        leg = legs[k]
        if integers[COUNTER, leg] == counter:
            continue
        fresh = True
        integers[COUNTER, leg] = counter
        before = state = integers[STATE, leg]
        following = _NEXT[mode, state]
        if following != _STAYS:
            state = following if integers[CONFIGURED, leg] else BOOT
            enter(integers, reals, leg, state, _NO_FAULT)
            entered |= 1 << leg
        elif state == FAULT and mode == _MODE_OFF:
            integers[ACTING, leg] = BRAKE
        if state in (READY, RUN):
            reals[COMMAND, leg] = command[k]
            if feeds or before not in (READY, RUN):
                integers[DEADLINE, leg] = t_ns + integers[WATCHDOG, leg]
    controls = fresh and actuate(integers, reals, stage, length, rate, False, t_ns)
    return fresh, controls, entered, min(integers[DEADLINE].min(), next_move_ns(integers))


@helper
def feed(integers: Ints, legs: Ints, t_ns: int) -> None:
    """Feed the watchdogs of drives that are powered."""
    for k in range(legs.shape[0]):
        leg = legs[k]
        if integers[STATE, leg] in (READY, RUN):
            integers[DEADLINE, leg] = t_ns + integers[WATCHDOG, leg]


@helper
def encoders(
    integers: Ints,
    reals: Array,
    length: Array,
    rate: Array,
    dt_s: float,
    quantum_m: float,
    l: Array,
    dl: Array,
    state: Ints,
) -> None:
    """Fill in what is read `dt_s` after the plant was at `length`, `rate`, in steps of `quantum_m` if > 0.

    state: DriveState, with INVALID for a lost encoder.
    """
    for leg in range(LEGS):
        state[leg] = integers[STATE, leg] | integers[LOST, leg]
        at, dl[leg] = _encoder(integers, reals, length, rate, leg)
        at += dl[leg] * dt_s
        l[leg] = np.rint(at / quantum_m) * quantum_m if quantum_m > 0.0 else at


@direct(OUT_INTEGER_MATRIX, OUT_MATRIX, VECTOR, VECTOR, REAL, REAL, OUT_VECTOR, OUT_VECTOR, OUT_INTEGERS)
def read_encoders(
    integers: Ints,
    reals: Array,
    length: Array,
    rate: Array,
    dt_s: float,
    quantum_m: float,
    l: Array,
    dl: Array,
    state: Ints,
) -> None:
    """Fill in what is read; see `encoders`."""
    encoders(integers, reals, length, rate, dt_s, quantum_m, l, dl, state)
