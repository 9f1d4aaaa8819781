"""Rules of six emulated drives in kernels: states, faults, watchdog, brake. n: a record of NODES."""

from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.drives.codec import COMMAND

BOOT, OFF, READY, RUN, FAULT = map(int, DriveState)
BRAKE, DAMP, HOLD, ZERO = map(int, Reaction)
NEVER_NS = 1 << 62
_LONGEST_NS = float(1 << 60)
"""Limit of a watchdog's time; also the time of a watchdog that never ends."""
WORKS = -1
"""Value of `stuck` for a brake that works."""

TRANSITIONS: dict[DriveMode, dict[int, int]] = {
    DriveMode.OFF: {READY: OFF, RUN: OFF},
    DriveMode.READY: {OFF: READY, RUN: READY},
    DriveMode.RUN: {READY: RUN},
    DriveMode.RESET: {READY: OFF, RUN: OFF, FAULT: OFF},
}
"""Transition of a drive's state by each commanded mode; a state that is not listed stays."""
_STAYS = -1
_NEXT = np.array(
    [[TRANSITIONS[mode].get(state, _STAYS) for state in map(int, DriveState)] for mode in DriveMode]
)
_MODE_OFF = int(DriveMode.OFF)
_NO_FAULT, _ESTOP = int(DriveFault.NONE), int(DriveFault.ESTOP)


@helper
def enter(n: Any, leg: int, state: int, reason: int) -> None:
    """Put one drive into a state (DriveState), with the fault `reason`."""
    n.state[leg], n.fault[leg] = state, reason
    if state not in (READY, RUN):
        n.command[leg], n.deadline_ns[leg] = 0.0, NEVER_NS


@helper
def configure(n: Any, leg: int, message: Any) -> bool:
    """Set up a drive from a CONFIGURE message; False, without effect, if the drive is powered."""
    state = n.state[leg]
    if state in (READY, RUN):
        return False
    n.watchdog_ns[leg], n.reaction[leg] = message.counter, message.mode
    n.configured[leg] = 1
    if state == BOOT:
        enter(n, leg, OFF, _NO_FAULT)
    return True


@helper
def encoder(n: Any, leg: int) -> tuple[float, float]:
    """Length, m, and rate, m/s, that an encoder reads before quantisation; 0 if its signal is lost."""
    if n.lost[leg]:
        return 0.0, 0.0
    if np.isnan(n.frozen[leg]):
        scale = n.scale[leg]
        moved = scale * n.length[leg] + n.shift[leg]
        return moved + n.offset[leg], scale * n.rate[leg] + n.drift[leg]
    return n.frozen[leg], 0.0


@helper
def _move_brake(at: Array, due_ns: Ints, leg: int, wanted: float, takes_ns: int, t_ns: int) -> None:
    """Start, cancel or finish a brake's movement; a cancelled movement leaves the brake as it was."""
    if at[leg] == wanted:
        due_ns[leg] = NEVER_NS
        return
    if due_ns[leg] == NEVER_NS:
        due_ns[leg] = t_ns + takes_ns
    if due_ns[leg] <= t_ns:
        at[leg], due_ns[leg] = wanted, NEVER_NS


@helper
def actuate(n: Any, lag: bool, t_ns: int) -> None:
    """Set force and brake of the plant from the drives' states at `t_ns`.

    A drive whose brake closes keeps its last force until the brake has closed. Sets `controls` if a drive
    controls its force from its encoder (DAMP or HOLD). lag: True to filter the forces over the next time
    step.
    """
    controls = False
    for leg in range(LEGS):
        f = n.command[leg]
        state = n.state[leg]
        acting = n.acting[leg] if state == FAULT else BRAKE
        opens = state == RUN or acting != BRAKE
        wanted, takes_ns = (0.0, n.opening_ns) if opens else (1.0, n.closing_ns)
        _move_brake(n.shut, n.moved_ns, leg, wanted, takes_ns, t_ns)
        _move_brake(n.truly_shut, n.followed_ns, leg, n.shut[leg], n.slow_ns[leg], t_ns)
        if not opens and state != READY and n.shut[leg] == 0.0:
            f = n.kept[leg]
        if acting in (DAMP, HOLD):
            controls = True
            l, dl = encoder(n, leg)
            f = -n.damping * dl
            if acting == HOLD:
                f -= n.stiffness * (l - n.held_m[leg])
        if not -n.limit_N <= f <= n.limit_N:
            f = n.limit_N if f > 0.0 else -n.limit_N
        n.kept[leg] = f
        f = min(max(f, -n.most[leg]), n.most[leg])
        if lag:
            gap = n.lagged[leg] - f
            n.lagged[leg] = f + gap * n.lag_end
            f += gap * n.lag_mean
        elif n.lags:
            f = n.lagged[leg]
        n.force[leg] = f * n.gain[leg]
        stuck = n.stuck[leg]
        n.brake[leg] = n.share[leg] * (n.truly_shut[leg] if stuck == WORKS else float(stuck))
    n.controls = controls


@helper
def next_move_ns(n: Any) -> int:
    """Earliest instant at which a brake will have opened or closed, ns."""
    return int(min(n.moved_ns.min(), n.followed_ns.min()))


@helper
def fail(n: Any, leg: int, fault: int, t_ns: int) -> bool:
    """Latch a drive's fault at `t_ns`, when the plant has reached it; True if it is to be reported.

    A latched fault stays, except that an emergency stop replaces it.
    """
    state, stops = n.state[leg], fault == _ESTOP
    if state == FAULT:
        reports = stops and n.fault[leg] != fault
        n.acting[leg], n.deadline_ns[leg] = BRAKE, NEVER_NS
        if stops:
            n.fault[leg] = fault
    else:
        reports = True
        n.acting[leg] = BRAKE if stops or state != RUN or n.lost[leg] else n.reaction[leg]
        n.held_m[leg] = encoder(n, leg)[0]
        enter(n, leg, FAULT, fault)
        if n.acting[leg] in (DAMP, HOLD):
            n.deadline_ns[leg] = t_ns + n.brake_after_ns
    actuate(n, False, t_ns)
    n.calm_ns = min(n.calm_ns, next_move_ns(n))
    return bool(reports)


@helper
def feed(n: Any, leg: int, t_ns: int) -> None:
    """Feed the watchdog of a drive if it is powered."""
    if n.state[leg] in (READY, RUN):
        waits: Any = np.rint(min(n.waits[leg] * n.watchdog_ns[leg], _LONGEST_NS))
        n.deadline_ns[leg] = t_ns + np.int64(waits)


@helper
def tripped(n: Any, t_ns: int) -> Ints:
    """Legs of the drives whose watchdog trips by `t_ns` as it was not fed, or whose reaction ends then."""
    return np.flatnonzero(n.deadline_ns <= t_ns)


@helper
def obey(n: Any, command: Any, t_ns: int) -> int:
    """Execute a command, a MESSAGE, at `t_ns`, when the plant has reached it.

    Returns the legs whose drives entered a state, as a bit mask (bit i: leg i). Forces change if at least one
    drive has not had the counter before. An UNWATCHED command feeds the watchdogs only of drives that were
    not powered before.
    """
    fresh, entered = False, 0
    for k in range(command.count):
        leg = command.legs[k]
        if n.counter[leg] == command.counter:
            continue
        fresh = True
        n.counter[leg] = command.counter
        before = state = n.state[leg]
        following = _NEXT[command.mode, state]
        if following != _STAYS:
            state = following if n.configured[leg] else BOOT
            enter(n, leg, state, _NO_FAULT)
            entered |= 1 << leg
        elif state == FAULT and command.mode == _MODE_OFF:
            n.acting[leg] = BRAKE
        if state in (READY, RUN):
            n.command[leg] = command.force[k]
            if command.kind == COMMAND or before not in (READY, RUN):
                feed(n, leg, t_ns)
    if fresh:
        actuate(n, False, t_ns)
        n.calm_ns = min(n.calm_ns, n.deadline_ns.min(), next_move_ns(n))
        n.commands += 1
    else:
        n.repeated += 1
    return entered


@helper
def encoders(n: Any, dt_s: float, l: Array, dl: Array, state: Ints) -> None:
    """Fill in encoder readings `dt_s` after the plant's last step.

    l, dl, state (6,): lengths in whole quanta, m; rates, m/s; DriveState, or INVALID for a lost encoder.
    """
    for leg in range(LEGS):
        state[leg] = n.state[leg] | n.lost[leg]
        at, dl[leg] = encoder(n, leg)
        at += dl[leg] * dt_s
        l[leg] = np.rint(at / n.quantum_m) * n.quantum_m if n.quantum_m > 0.0 else at
