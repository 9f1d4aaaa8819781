"""Sign, scale and zero of each encoder, by tape at both ends of the stroke and between, and the stroke."""

from collections.abc import Iterator
from math import sqrt
from typing import Any

from drivers.signals import LEGS
from hil.lab.bringup.context import TAPE_M, Context, Finding, Request, Step
from hil.lab.bringup.steps.ids import drive_of

ENDS_M = 2e-3
"""A leg that ends so far before its configured length does not reach it."""
ZERO_M = 1.5e-3
"""Largest accepted difference of reading and tape."""
FAR = 4.0
"""A leg that is measured so many times longer than configured, or shorter, was measured in another unit."""
SIGMAS = 4.0
"""Differences of so many standard deviations of the tape are real."""


def find(c: Context) -> None:
    """Have each leg moved to its ends by hand and measured, with all drives off."""
    drives = drive_of(c)
    for leg in c.missing("encoder"):
        c.take_down()
        tape, reads = [], []
        within = c.machine.length_min / FAR, c.machine.length_max * FAR
        for share, word in ((0.0, "shortest"), (1.0, "longest"), (0.5, "middle")):
            mm = 1e3 * (c.machine.length_min + share * c.machine.stroke)
            text = f"Move leg {leg} by hand to its {word}, {mm:.0f} mm, or as far as it goes"
            c.ask(Request("place", leg, share, text))
            text = f"Measure leg {leg}, joint centre to joint centre, m"
            tape.append(c.ask(Request("measure", leg, 0.0, text, within=within)))
            c.rest(0.02)
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


def tolerance(spread: float) -> float:
    """Return the error of a scale that two lengths by tape allow, at least 0.3 %."""
    return max(SIGMAS * sqrt(2.0) * TAPE_M / spread, 3e-3)


def judge(c: Context) -> Iterator[Finding]:
    """Name strokes that are not reached, and encoders that count otherwise than the tape."""
    m, ends = c.machine, {}
    for leg, fact in c.table("encoder").items():
        low, high = fact["tape_m"]
        if low > m.length_min + ENDS_M or high < m.length_max - ENDS_M:
            ends[leg] = low, high
        if fact["drive"] is not None and high - low >= 0.05 * m.stroke:
            yield from _encoder(fact["drive"], fact, high - low)
    configured = f"configured are {m.length_min:g} and {m.length_max:g}"
    if len(ends) == LEGS:
        lows, highs = zip(*ends.values(), strict=True)
        text = f"all end at {max(lows):.4f} and {min(highs):.4f} m, {configured}"
        mend = "Write the stroke into platform.length_min_m and platform.length_max_m."
        yield Finding("stroke", tuple(range(LEGS)), text, mend)
        return
    for leg, (low, high) in ends.items():
        text = f"it ends at {low:.4f} and {high:.4f} m, {configured}"
        mend = "Take the end stop out of the way, or shorten the configured stroke."
        yield Finding("end_stop", (leg,), text, mend)


def _encoder(drive: int, fact: dict[str, Any], spread: float) -> list[Finding]:
    scale, offset, bent = fact["scale"], fact["offset_m"], fact["bent_m"]
    found, within = [], tolerance(spread)
    if abs(scale) < 0.05:
        text = "its encoder stands still while its leg moves"
        return [Finding("encoder_frozen", (drive,), text, "Look at encoder, coupling and cable.")]
    if abs(bent) > max(1.0, abs(scale)) * max(ZERO_M, SIGMAS * sqrt(1.5) * TAPE_M):
        text = f"at mid-stroke it reads {1e3 * bent:+.2f} mm off the straight line between its ends"
        mend = "Look at coupling, belt, play and signal: it jumps, stops half way, or slips."
        return [Finding("encoder_jumps", (drive,), text, mend)]
    if scale < 0.0:
        text = f"its reading falls as the leg grows: {scale:.3f} m a m by tape"
        found.append(Finding("encoder_sign", (drive,), text, "Turn the sign of the encoder in the drive."))
    if abs(abs(scale) - 1.0) > within:
        text = f"it reads {abs(scale):.4f} m a m by tape, +- {within:.4f}"
        mend = f"Multiply counts per m in the drive by {abs(scale):.4f}; look at lead and gear, too."
        found.append(Finding("encoder_scale", (drive,), text, mend))
    if not found and abs(offset) > max(ZERO_M, SIGMAS * TAPE_M):
        text = f"it reads {1e3 * offset:+.2f} mm off the tape"
        mend = f"Home the drive again, or move its zero by {-1e3 * offset:+.2f} mm."
        found.append(Finding("offset", (drive,), text, mend))
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
