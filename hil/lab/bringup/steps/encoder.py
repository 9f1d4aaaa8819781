"""Sign, scale and zero of each encoder, and the stroke: tape at both ends of the stroke and at its middle."""

from collections.abc import Iterator
from math import sqrt
from typing import Any

from drivers.signals import LEGS
from hil.lab.bringup.context import SETTLED_S, TAPE_M, Context, Finding, Request, Step
from hil.lab.bringup.steps.ids import drive_of

ENDS_M = 2e-3
"""A leg that ends this far before its configured length does not reach it."""
ZERO_M = 1.5e-3
"""Largest accepted difference between reading and tape."""
FAR = 4.0
"""A tape reading more than this factor off the configured lengths is taken for a wrong unit."""
SIGMAS = 4.0
"""Differences beyond this many standard deviations of the tape are significant."""


def find(c: Context) -> None:
    """Have the operator move each leg to both ends and the middle and measure it by tape, all drives off."""
    drives = drive_of(c)
    for leg in c.missing("encoder"):
        c.take_down()
        tape, reads = [], []
        for share, word in ((0.0, "shortest"), (1.0, "longest"), (0.5, "middle")):
            mm = 1e3 * (c.machine.length_min + share * c.machine.stroke)
            text = f"Move leg {leg} by hand to its {word}, {mm:.0f} mm, or as far as it goes"
            c.ask(Request("place", leg, share, text))
            tape.append(measured(c, leg))
            c.rest(SETTLED_S)
            reads.append(c.lengths().tolist())
        drive, spread = drives.get(leg), tape[1] - tape[0]
        scale = offset = bent = 0.0
        if drive is not None and abs(spread) > 0.05 * c.machine.stroke:
            scale = (reads[1][drive] - reads[0][drive]) / spread
            middle = 0.5 * (tape[0] + tape[1])
            offset = 0.5 * (reads[0][drive] + reads[1][drive]) - middle
            bent = reads[2][drive] - (middle + offset + scale * (tape[2] - middle))
            offset -= c.machine.turns_m(drive, offset)
        fact = {"drive": drive, "tape_m": tape[:2], "scale": scale, "offset_m": offset, "bent_m": bent}
        c.keep("encoder", leg, fact)


def measured(c: Context, leg: int) -> float:
    """Length of a leg by tape, m, as the operator measures it."""
    within = c.machine.length_min / FAR, c.machine.length_max * FAR
    text = f"Measure leg {leg}, joint centre to joint centre, m"
    return c.ask(Request("measure", leg, 0.0, text, within=within))


def tolerance(spread: float) -> float:
    """Tolerance of an encoder scale, a ratio, from two tape lengths `spread` m apart; at least 0.003."""
    return tolerance_m(spread) / spread


def tolerance_m(spread: float) -> float:
    """Tolerance of a change of length, m, between two tape lengths `spread` m apart, which may be 0."""
    return max(SIGMAS * sqrt(2.0) * TAPE_M, 3e-3 * spread)


def judge(c: Context) -> Iterator[Finding]:
    """Findings: strokes shorter than configured, and encoders that disagree with the tape."""
    m, ends = c.machine, {}
    for leg, fact in c.table("encoder").items():
        low, high = fact["tape_m"]
        if low > m.length_min + ENDS_M or high < m.length_max - ENDS_M:
            ends[leg] = low, high
        if fact["drive"] is not None and high - low >= 0.05 * m.stroke:
            yield from _encoder(fact["drive"], fact, high - low)
    configured = f"configured: {m.length_min:g} and {m.length_max:g} m"
    if len(ends) == LEGS:
        lows, highs = zip(*ends.values(), strict=True)
        text = f"all end at {max(lows):.4f} and {min(highs):.4f} m, {configured}"
        remedy = "Write the stroke into platform.length_min_m and platform.length_max_m."
        yield Finding("stroke", tuple(range(LEGS)), text, remedy)
        return
    for leg, (low, high) in ends.items():
        text = f"it ends at {low:.4f} and {high:.4f} m, {configured}"
        remedy = "Take the end stop out of the way, or shorten the configured stroke."
        yield Finding("end_stop", (leg,), text, remedy)


def _encoder(drive: int, fact: dict[str, Any], spread: float) -> list[Finding]:
    scale, offset, bent = fact["scale"], fact["offset_m"], fact["bent_m"]
    found, within = [], tolerance(spread)
    if abs(scale) < 0.05:
        text = "its reading does not change while its leg moves"
        return [Finding("encoder_frozen", (drive,), text, "Check encoder, coupling and cable.")]
    if abs(bent) > max(1.0, abs(scale)) * max(ZERO_M, SIGMAS * sqrt(1.5) * TAPE_M):
        text = f"at mid-stroke it reads {1e3 * bent:+.2f} mm off the straight line between its ends"
        remedy = "Check coupling, belt, backlash and signal: the reading jumps, stops half way, or slips."
        return [Finding("encoder_jumps", (drive,), text, remedy)]
    if scale < 0.0:
        text = f"its reading falls as the leg extends: {scale:.3f} m per m by tape"
        found.append(Finding("encoder_sign", (drive,), text, "Invert the sign of the encoder in the drive."))
    if abs(abs(scale) - 1.0) > within:
        text = f"it reads {abs(scale):.4f} m per m by tape, +- {within:.4f}"
        remedy = f"Multiply counts per m in the drive by {abs(scale):.4f}; check lead and gear, too."
        found.append(Finding("encoder_scale", (drive,), text, remedy))
    if not found and abs(offset) > max(ZERO_M, SIGMAS * TAPE_M):
        text = f"it reads {1e3 * offset:+.2f} mm off the tape"
        remedy = f"Home the drive again, or move its zero by {-1e3 * offset:+.2f} mm."
        found.append(Finding("offset", (drive,), text, remedy))
    return found


STEP = Step(
    "encoder",
    "encoders and strokes, by tape",
    "reads the encoders with all drives off while you move each leg to both ends and measure it",
    "Ctrl-C; no drive is powered",
    find,
    judge,
    gate=False,
)
