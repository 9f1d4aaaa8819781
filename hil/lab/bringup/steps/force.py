"""Sign of each force and friction of each leg: a slow ramp both ways with one brake open.

The ramp ends as soon as a leg has moved by MOVED_M, at FORCE_SHARE of the rated force at the latest, and a
leg that has gone TRAVEL_M is a runaway. A coarse field of torque may have no code of zero, and half a code
may move a leg of little friction: the ramp begins where a force has its sign, START_STEPS steps of the field,
and what a leg moves by itself before it is taken off.
"""

from collections.abc import Iterator
from typing import Any

from drivers.arrays import Array
from drivers.signals import LEGS
from hil.lab.bringup.context import FORCE_SHARE, MOVED_M, TRAVEL_M, Context, Finding, Step, StoppedError

RAMP_S = 0.8
SETTLE_S = 0.02
"""For how long a leg may coast, still watched, before its brake shuts."""
WATCH_S = 0.02
"""For how long a leg is watched without command before each ramp."""
START_STEPS = 1.5
"""Steps of the commanded force: rounded or truncated, it is not zero and has its sign."""
MOVES = 0.75
"""A leg that gives way to a hand at this share of the most force of a step must move by its drive."""


def find(c: Context) -> None:
    """Drive each leg a tenth of a millimetre both ways."""
    if any(fact["moved"] for fact in c.table("held").values()):
        return
    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    for drive in c.missing("force"):
        own = c.known("opens", drive)["legs"] == [counts.get(drive)]
        if own and len(counts) == LEGS:
            c.keep("force", drive, {"plus": _ramp(c, drive, 1.0), "minus": _ramp(c, drive, -1.0)})


def _ramp(c: Context, drive: int, sign: float) -> dict[str, Any]:
    """Let the force of a drive grow until a leg moves; return the force, the leg, and the way it went.

    The brake opens for one ramp alone: a leg that a code of zero moves is at rest again before the next.
    """
    found: dict[str, Any] = {"force_N": None, "leg": None, "way": 0}
    ticks, watched = c.drives.ticks(RAMP_S), c.drives.ticks(WATCH_S)
    high = c.machine.force_N
    low = min(START_STEPS * step_of(c, drive), high)
    with c.opened(drive):
        origin = c.lengths()
        _watch(c, drive, origin, watched)
        drift, before = c.travelled(origin), c.lengths()
        for n in range(1, ticks + 1):
            force = sign * (low + (high - low) * n / ticks)
            c.drive(drive, force)
            guard(c, drive, origin)
            moves = {leg: by_m - n * drift[leg] / watched for leg, by_m in c.travelled(before).items()}
            leg = max(moves, key=lambda k: abs(moves[k]))
            if abs(moves[leg]) > MOVED_M:
                found = {"force_N": abs(force), "leg": leg, "way": 1 if moves[leg] > 0.0 else -1}
                break
        _watch(c, drive, origin, c.drives.ticks(SETTLE_S))
    return found


def _watch(c: Context, drive: int, origin: Array, ticks: int) -> None:
    for _ in range(ticks):
        c.drive(drive)
        guard(c, drive, origin)


def step_of(c: Context, drive: int) -> float:
    """Return the step of the force that a drive is commanded, N at the leg."""
    return float(c.drives.protocol.traits.resolution.force[drive])


def guard(c: Context, drive: int, origin: Array) -> None:
    """Raise StoppedError, with all drives off, where a leg is further than TRAVEL_M from `origin`."""
    away = c.travelled(origin)
    leg = max(away, key=lambda k: abs(away[k]))
    if abs(away[leg]) > TRAVEL_M:
        c.drives.off()
        text = f"leg {leg} went {1e3 * away[leg]:+.2f} mm under drive {drive}, allowed: {1e3 * TRAVEL_M:g} mm"
        mend, own = "Look at force scale, brake and load of it.", c.reads()[drive][0]
        if leg != own:
            mend = f"Look at the encoder of leg {leg}, whose brake was shut, and at what drive {drive} moves."
        raise StoppedError(Finding("runaway", (drive,) if leg == own else (drive, leg), text, mend))


def breakaway(fact: dict[str, Any]) -> float | None:
    """Return the commanded force at which a leg begins to move, mean of both ways; None where it did not."""
    forces = fact["plus"]["force_N"], fact["minus"]["force_N"]
    return None if None in forces else 0.5 * (forces[0] + forces[1])


def judge(c: Context) -> Iterator[Finding]:
    """Name forces of the wrong sign, and legs that do not move by their drives."""
    still = []
    limit = f"{100 * FORCE_SHARE:g} % of the rated force, {c.machine.force_N:g} N"
    for drive, fact in c.table("force").items():
        plus, minus = fact["plus"]["way"], fact["minus"]["way"]
        if plus < 0 < minus:
            text = "a force that should extend it shortens it"
            mend = "Exchange two phases of the motor, or turn the sign of the torque in the drive."
            yield Finding("force_sign", (drive,), text, mend)
        elif plus < 0 or minus > 0:
            text = f"it moves {'shorter' if plus < 0 else 'longer'}, one way under either sign of force"
            mend = (
                "Lay the leg level on its trestle, look for play, and try again; one code of torque, "
                f"{step_of(c, drive):.3g} N, may be more than its friction."
            )
            yield Finding("one_way", (drive,), text, mend)
        elif plus and minus:
            continue
        else:
            does = "extends it alone" if plus else "shortens it alone" if minus else "does not move it"
            opens, text = c.known("opens", drive), f"its drive {does}, with {limit}"
            if opens["hand_N"] > MOVES * c.machine.force_N:
                text += f"; a hand needs {opens['hand_N']:.4g} N"
                mend = "Look at guide, nut, seals, a brake that drags."
                yield Finding("friction", (opens["legs"][0],), text, mend)
            elif plus or minus:
                mend = "Lay the leg level on its trestle; look at motor phases, supply, limits and end stops."
                yield Finding("force_one_way", (drive,), text, mend)
            else:
                still.append(drive)
    if still:
        name = "no_force" if len(still) == 1 else "motor_crossed"
        mend = "Look at motor cables, whether any are exchanged, and at the scale of the drive's torque."
        yield Finding(name, tuple(still), f"moved by hand, and not by its drive with {limit}", mend)


STEP = Step(
    "force",
    "forces and friction, one leg at a time",
    f"opens one brake, the five others shut, and lets that drive's force grow to {100 * FORCE_SHARE:g} % of "
    f"the rated one until the leg has moved {1e3 * MOVED_M:g} mm, each way; {1e3 * TRAVEL_M:g} mm end it",
    "Ctrl-C, or the emergency stop; keep hands off",
    find,
    judge,
    gate=False,
    by_drive=True,
)
