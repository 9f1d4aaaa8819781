"""Bring-up step that measures each drive's force scale by a force gauge, and compares it with lengths."""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.lab.bringup.context import Context, Finding, Request, Step, StoppedError
from hil.lab.bringup.steps.brakes import friction
from hil.lab.bringup.steps.encoder import tolerance
from hil.lab.bringup.steps.force import breakaway, guard

LEVELS = (0.4, 0.6, 0.8, 1.0)
"""Gauge levels as shares of the largest step force."""
RAMP_S, HOLD_S = 0.12, 0.06
BEYOND = 1.15
"""Only levels above this multiple of the breakaway force count."""
FLAT = 0.35
"""A force saturates if its slope at the upper levels is below this share of the slope at the lower ones."""
WITHIN = 0.06
"""Accepted error of a force scale, in addition to the losses of a transmission."""
STRONG = 3.0
"""A drive gives too much force if a hand needs this multiple of the command that moves its leg."""
SAME = 0.08
"""Wrong scales of encoder and force that differ by less have one cause: lead or gear. A wrong lead is off by
more than this.
"""


def find(c: Context) -> None:
    """Have each leg that moves clamped to the gauge; store pairs of commanded and read force, N."""
    for drive, (leg, _) in sorted(c.reads().items()):
        fact = c.known("force", drive)
        if fact is None or breakaway(fact) is None or c.known("gauge", drive) is not None:
            continue
        c.ask(Request("clamp", leg, 0.0, f"Clamp the end of leg {leg} to the force gauge, without force"))
        pairs = []
        with c.opened(drive):
            hold, force = partial(_hold, c, drive, c.lengths()), 0.0
            for level in LEVELS:
                aim, ticks = level * c.machine.force_N, c.drives.ticks(RAMP_S)
                ramp = np.linspace(force, aim, ticks + 1)[1:].tolist()
                for force in [*ramp, *[aim] * c.drives.ticks(HOLD_S)]:
                    hold(force)
                within = -c.machine.rated_N, c.machine.rated_N
                text = f"Read the gauge at leg {leg}, N, > 0 pushing"
                read = c.ask(Request("read_gauge", leg, 0.0, text, within=within), partial(hold, force))
                pairs.append([c.drives.carried(drive, force), read])
        c.ask(Request("free", leg, 0.0, f"Take leg {leg} off the gauge"))
        c.keep("gauge", drive, {"pairs_N": pairs})


def _hold(c: Context, drive: int, origin: Array, force: float) -> None:
    """Command a force, N, for a tick. Raises StoppedError: a reading runs away although the leg is clamped.

    The force scale is wrong if the drive moves its leg with a far smaller command than a hand's force.
    """
    c.drive(drive, force)
    try:
        guard(c, drive, origin)
    except StoppedError as stop:
        by_hand, by_drive = c.known("opens", drive)["hand_N"], breakaway(c.known("force", drive))
        _, legs, text, remedy = stop.finding
        text += f"; at {force:.4g} N commanded, with its end clamped to the gauge"
        if by_drive and by_hand > STRONG * by_drive:
            text += ": force_scale, too much force"
            raise StoppedError(Finding("runaway", legs, text, remedy)) from None
        text += ": coupling_slips (coupling, belt or nut), or its end has left the gauge"
        remedy = "If its end has not moved, check coupling, belt and encoder; else clamp it again."
        raise StoppedError(Finding("coupling_or_clamp", legs, text, remedy)) from None


class Gain(NamedTuple):
    """Force scale of a drive: N at the leg per N commanded."""

    value: float
    error: float
    """Error from coarse command steps: a leg overshoots by one step, and friction holds it there."""


def gains(c: Context) -> dict[int, Gain]:
    """Force scale of each drive that had at least two force levels above its friction."""
    found = {}
    for drive, fact in c.table("gauge").items():
        least = BEYOND * (breakaway(c.known("force", drive)) or 0.0)
        beyond = [pair for pair in fact["pairs_N"] if pair[0] > least]
        if len({commanded for commanded, _ in beyond}) >= 2:
            commanded, read = np.array(beyond).T
            error = c.drives.force_step(drive, c.machine.force_N) / float(np.ptp(commanded))
            found[drive] = Gain(float(np.polyfit(commanded, read, 1)[0]), error)
    return found


def judge(c: Context) -> Iterator[Finding]:
    """Findings: wrong force scales, saturated forces, and a wrong screw lead or gear ratio."""
    gain, read = gains(c), c.reads()
    set_scale = "Set torque constant, current scale or rated force of the drive"
    stiff = {leg for finding in friction(c) for leg in finding.legs}
    for drive in c.table("gauge").keys() - gain.keys():
        if c.known("opens", drive)["legs"][0] not in stiff:
            text = "its forces are too close to its friction, or to each other, to determine their scale"
            remedy = f"{set_scale}; check friction, and the resolution of its torque."
            yield Finding("force_scale", (drive,), text, remedy)
    for drive, (g, error) in gain.items():
        leg, scale = read.get(drive, (drive, 0.0))
        most = _limited(c, drive)
        if most is not None:
            text = f"its force does not exceed {most:.4g} N, with {c.machine.force_N:.4g} N commanded"
            remedy = "Check current limit, supply and rated torque of the drive."
            yield Finding("force_saturates", (drive,), text, remedy)
            continue
        if scale <= 0.0:
            continue  # the drive corrects its losses with the wrong sign, or no encoder measures its leg
        low, high = c.known("encoder", leg)["tape_m"]
        off = abs(abs(scale) - 1.0) > tolerance(high - low)
        right, same = _fits(abs(g), abs(scale) if off else None, error, c.machine.losses)
        if right and same and as_lead(abs(scale)):
            yield scale_or_lead(drive, abs(scale), Gain(abs(g), error + c.machine.losses))
        elif right:
            continue
        elif same:
            text = f"both its lengths and its forces are {abs(scale):.4f} times the true ones"
            remedy = f"Divide lead, or multiply gear ratio, by {abs(scale):.4f}, in drive or configuration."
            yield Finding("wrong_lead", (drive,), text, remedy)
        else:
            text = f"it gives {abs(g):.3f} N for each N commanded"
            yield Finding("force_scale", (drive,), text, f"{set_scale}.")


def _limited(c: Context, drive: int) -> float | None:
    """Force, N, at which a drive saturates; None if it follows all commands."""
    levels = sorted(dict(c.known("gauge", drive)["pairs_N"]).items())
    if len(levels) < 3:
        return None
    (low, at_low), (middle, at_middle), (high, at_high) = levels[0], levels[1], levels[-1]
    begins = at_low / low, (at_middle - at_low) / (middle - low)
    ends = (at_high - at_middle) / (high - middle)
    return float(at_high) if ends < FLAT * max(begins) and 0.0 < at_high < high else None


def _fits(gain: float, scale: float | None, error: float, losses: float) -> tuple[bool, bool]:
    """(gain is 1, gain equals the encoder's scale) within errors; scale None: encoder scale is right."""
    for slack in (error, error + losses):
        right = abs(gain - 1.0) <= WITHIN + slack
        same = scale is not None and abs(gain - scale) < (SAME + slack) * scale
        if right or same:
            break
    return right, same


def as_lead(scale: float) -> bool:
    """True if an encoder scale, > 0, is wrong enough that a wrong lead or gear may be the cause."""
    return bool(abs(scale - 1.0) > SAME)


def scale_or_lead(drive: int, scale: float, gain: Gain | None) -> Finding:
    """Finding for an encoder scale with two possible causes; gain: force scale, None if not measured."""
    forces = "which were not measured" if gain is None else f"{gain.value:.2f} +- {gain.error:.2f} times"
    text = f"lengths are {scale:.4f} times the tape's; forces, {forces}, fit encoder_scale or wrong_lead"
    remedy = "Turn its shaft by one turn, by hand, and measure by tape how far the leg moves: if that is as "
    remedy += f"configured, multiply counts per turn in the drive by {scale:.4f}; else correct lead or gear."
    return Finding("scale_or_lead", (drive,), text, remedy)


STEP = Step(
    "gauge",
    "force scales, by force gauge",
    "pushes one leg after the other against your force gauge with at most 2 % of the rated force",
    "Ctrl-C, or the emergency stop",
    find,
    judge,
    gate=False,
    by_drive=True,
)
