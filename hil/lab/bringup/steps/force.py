"""Sign and delay of each force, friction of each leg: a slow ramp both ways and a step with one brake open.

The ramp ends when a leg has moved by MOVED_M, at the latest at FORCE_SHARE of the rated force. A leg that
travels TRAVEL_M is a runaway. A coarse torque field may have no code for zero, and half a code may move a
leg with little friction. So the ramp begins at START_STEPS steps of the field, where the force has its sign;
the leg's own drift before the ramp is subtracted.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from hil.lab.bringup.context import (
    FORCE_SHARE,
    MOVED_M,
    TRAVEL_M,
    Context,
    Finding,
    Step,
    StoppedError,
    gap_of,
)

RAMP_S = 0.8
SETTLE_S = 0.02
"""Time for a leg to coast, still watched, before its brake shuts."""
WATCH_S = 0.02
"""Time for which a leg is watched without force before each ramp."""
START_STEPS = 1.5
"""First force of a ramp in steps of the command: rounded or truncated, it is not zero and has its sign."""
STEP_SHARE = 1.5
"""First force of the timed step, as a multiple of the hand's force that moves the leg."""
ANSWER_S, BRISK_S = 0.6, 0.15
"""Longest wait for the response to that step; longest response that is evaluated without a larger step."""
FROM_SHARE = 0.1
"""Share of MOVED_M from which on the response is evaluated."""
LATE_S = 8e-3
"""Accepted delay from force to reading; two ticks of the bring-up are added."""
MOVES = 0.75
"""A leg that yields to a hand at this share of the largest step force must also move by its drive."""
LEAST_SHARE = 0.01
"""Smallest step, as a share of the drive's force: a leg may give way to no force at all."""


def find(c: Context) -> None:
    """Drive each leg with one brake open by a tenth of a millimetre both ways, and store forces and delay."""
    if any(fact["moved"] for fact in c.table("held").values()):
        return
    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    for drive in c.missing("force"):
        own = c.known("opens", drive)["legs"] == [counts.get(drive)]
        if own and len(counts) == LEGS:
            fact: dict[str, Any] = {"plus": _ramp(c, drive, 1.0), "minus": _ramp(c, drive, -1.0)}
            c.keep("force", drive, fact | {"late_s": _late_s(c, drive, fact)})


def _ramp(c: Context, drive: int, sign: float) -> dict[str, Any]:
    """Increase a drive's force until a leg moves; return the force, N, the leg, and its direction."""
    high = c.machine.force_N
    low = min(START_STEPS * step_of(c, drive), high)
    forces = np.linspace(low, high, c.drives.ticks(RAMP_S) + 1)[1:].tolist()
    t, moves = _pushed(c, drive, [sign * force for force in forces])
    leg = max(moves, key=lambda k: abs(moves[k][-1]))
    if abs(moves[leg][-1]) <= MOVED_M:
        return {"force_N": None, "leg": None, "way": 0}
    return {"force_N": forces[len(t) - 1], "leg": leg, "way": 1 if moves[leg][-1] > 0.0 else -1}


def _late_s(c: Context, drive: int, fact: dict[str, Any]) -> float | None:
    """Delay, s, from a step of a drive's force to its reading; None if the leg does not move.

    From rest, under a constant force, x = a (t - T)^2 / 2. The line t over sqrt(x) begins at the delay T, the
    sum of the force's lag and the reading's age, whatever mass and friction are. The force doubles until the
    response takes BRISK_S at most: a slower one is due to a force that friction nearly balances.
    """
    leg, way = fact["plus"]["leg"], fact["plus"]["way"]
    if breakaway(fact) is None or leg != fact["minus"]["leg"]:
        return None
    aim = STEP_SHARE * c.known("opens", drive)["hand_N"] + START_STEPS * step_of(c, drive)
    aim = max(aim, LEAST_SHARE * c.machine.force_N)
    while True:
        t, moved = _pushed(c, drive, [min(aim, c.machine.force_N)] * c.drives.ticks(ANSWER_S), leg)
        x = moved[leg]
        if (abs(x[-1]) > MOVED_M and t[-1] < BRISK_S) or aim >= c.machine.force_N:
            break
        aim *= 2.0
    if abs(x[-1]) <= MOVED_M:
        return None
    moves = way * x > FROM_SHARE * MOVED_M
    if moves.sum() < 2:  # from one tick to the next
        return float(t[-2]) if len(t) > 1 else 0.0
    return max(0.0, float(np.polyfit(np.sqrt(way * x[moves]), t[moves], 1)[1]))


def _pushed(
    c: Context, drive: int, forces: list[float], timed: int | None = None
) -> tuple[Array, dict[int, Array]]:
    """Times, s, and travel less drift of each leg, m, under forces, N, a tick each, until a leg has moved.

    timed: the leg that has to move; None: any. The brake opens for these forces only: a leg that the code for
    zero moves rests before the next ones.
    """
    t, moves = list[float](), list[dict[int, float]]()
    watched = c.drives.ticks(WATCH_S)
    with c.opened(drive):
        origin = c.lengths()
        _watch(c, drive, origin, watched)
        drift, before, began_ns = c.travelled(origin), c.lengths(), int(c.drives.record["t_ns"])
        for n, force in enumerate(forces, 1):
            c.drive(drive, force)
            guard(c, drive, origin)
            t.append(1e-9 * (int(c.drives.record["t_ns"]) - began_ns))
            moves.append({leg: x - n * drift[leg] / watched for leg, x in c.travelled(before).items()})
            if max(abs(x) for leg, x in moves[-1].items() if timed in (None, leg)) > MOVED_M:
                break
        _watch(c, drive, origin, c.drives.ticks(SETTLE_S))
    return np.array(t), {leg: np.array([each[leg] for each in moves]) for leg in drift}


def _watch(c: Context, drive: int, origin: Array, ticks: int) -> None:
    for _ in range(ticks):
        c.drive(drive)
        guard(c, drive, origin)


def step_of(c: Context, drive: int) -> float:
    """Largest rounding error of a drive's force command, N at the leg."""
    return float(c.drives.protocol.traits.resolution.force[drive])


def guard(c: Context, drive: int, origin: Array) -> None:
    """Switch all drives off and raise StoppedError if a leg is further than TRAVEL_M from `origin`."""
    away = c.travelled(origin)
    leg = max(away, key=lambda k: abs(away[k]))
    if abs(away[leg]) > TRAVEL_M:
        c.drives.off()
        text = f"leg {leg} moved {1e3 * away[leg]:+.2f} mm by drive {drive}, allowed: {1e3 * TRAVEL_M:g} mm"
        if leg == c.reads()[drive][0]:
            raise StoppedError(Finding("runaway", (drive,), text, "Check its force scale, brake and load."))
        remedy = f"Check the encoder of leg {leg}, whose brake was shut, and which leg drive {drive} moves."
        raise StoppedError(Finding("runaway", (drive, leg), text, remedy))


def breakaway(fact: dict[str, Any]) -> float | None:
    """Commanded force, N, at which a leg begins to move, mean of both directions; None if it stayed."""
    forces = fact["plus"]["force_N"], fact["minus"]["force_N"]
    return None if None in forces else 0.5 * (forces[0] + forces[1])


def judge(c: Context) -> Iterator[Finding]:
    """Findings: forces of the wrong sign, late responses, and legs that their drives do not move."""
    still = []
    limit = f"{100 * FORCE_SHARE:g} % of the rated force, {c.machine.force_N:g} N"
    for drive, fact in c.table("force").items():
        plus, minus = fact["plus"]["way"], fact["minus"]["way"]
        if plus < 0 < minus:
            text = "a force that should extend the leg shortens it"
            remedy = "Exchange two phases of the motor, or invert the sign of the torque in the drive."
            yield Finding("force_sign", (drive,), text, remedy)
        elif plus < 0 or minus > 0:
            text = f"its leg {'shortens' if plus < 0 else 'extends'} under either sign of force; a step of "
            text += f"torque, {step_of(c, drive):.3g} N, may exceed its friction"
            remedy = "Lay the leg level on its trestle, check backlash, and try again."
            yield Finding("one_way", (drive,), text, remedy)
        elif plus and minus:
            late_s, allowed_s = fact["late_s"], LATE_S + 2.0 / c.drives.line.rate_Hz
            if drive not in _coarse(c) and (late_s is None or late_s > allowed_s):
                after = "does not follow" if late_s is None else f"follows {1e3 * late_s:.0f} ms after"
                text = f"its reading {after} a step of its force, allowed: {1e3 * allowed_s:.0f} ms: "
                text += "either the reading is late (encoder_late) or the force (force_lags)"
                remedy = "Check the drive's filters of encoder and torque, gateways, and backlash."
                yield Finding("late_or_lags", (drive,), text, remedy)
        else:
            does = "can only extend it" if plus else "can only shorten it" if minus else "does not move it"
            opens, text = c.known("opens", drive), f"its drive {does}, with {limit}"
            if opens["hand_N"] > MOVES * c.machine.force_N:
                text += f"; by hand it moves at {opens['hand_N']:.4g} N"
                remedy = "Check guide, nut and seals, and whether the brake drags."
                yield Finding("friction", (opens["legs"][0],), text, remedy)
            elif plus or minus:
                remedy = "Lay the leg level on its trestle; check motor phases, supply, limits and end stops."
                yield Finding("force_one_way", (drive,), text, remedy)
            else:
                still.append(drive)
    if still:
        name = "no_force" if len(still) == 1 else "motor_crossed"
        remedy = "Check whether motor cables are exchanged; check the scale of the drive's torque."
        yield Finding(name, tuple(still), f"it moves by hand, but not by its drive with {limit}", remedy)


def gap(c: Context) -> Finding | None:
    """Finding that the delay is unproven, as the position has coarser steps than the travel that is timed."""
    if not (coarse := _coarse(c)):
        return None
    error_mm = 1e3 * max(c.drives.protocol.traits.resolution.length[coarse])
    text = f"the position of drives {', '.join(map(str, coarse))} is rounded by up to {error_mm:.2g} mm, too "
    text += "coarse to time the response to a force"
    return gap_of(text, "Check the drive's filters of encoder and torque; a late reading costs damping")


def _coarse(c: Context) -> list[int]:
    """Drives whose position has coarser steps than the travel that is timed."""
    return [k for k, step_m in enumerate(c.drives.protocol.traits.resolution.length) if step_m > MOVED_M]


STEP = Step(
    "force",
    "forces and friction, one leg at a time",
    f"opens one brake, the five others shut, and lets that drive's force grow to {100 * FORCE_SHARE:g} % of "
    f"the rated one until the leg has moved {1e3 * MOVED_M:g} mm, each way; then steps once; "
    f"{1e3 * TRAVEL_M:g} mm end it",
    "Ctrl-C, or the emergency stop; keep hands off",
    find,
    judge,
    gate=False,
    by_drive=True,
    gap=gap,
)
