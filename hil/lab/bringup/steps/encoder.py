"""Sign, scale and zero of each encoder, by tape at both ends of the stroke and between, and the stroke."""

from math import sqrt
from typing import Any

from drivers.signals import LEGS
from hil.lab.bringup.context import Context, Finding, Request, Step
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
            where = f"its {word}, {1e3 * (c.machine.length_min + share * c.machine.stroke):.0f} mm"
            c.ask(Request("place", leg, share, f"Move leg {leg} by hand to {where}, or as far as it goes"))
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
        fact = {"drive": drive, "tape_m": tape[:2], "scale": scale, "offset_m": offset}
        c.keep("encoder", leg, fact | {"bent_m": bent})


def tolerance(c: Context, spread: float) -> float:
    """Return the error of a scale that two lengths by tape allow, at least 0.3 %."""
    return max(SIGMAS * sqrt(2.0) * c.machine.tape_m / spread, 3e-3)


def judge(c: Context) -> list[Finding]:
    """Name strokes that are not reached, and encoders that count otherwise than the tape."""
    m, found = c.machine, []
    short: list[tuple[int, float]] = []
    for leg in range(LEGS):
        fact = c.known("encoder", leg)
        low, high = fact["tape_m"]
        if low > m.length_min + ENDS_M or high < m.length_max - ENDS_M:
            short.append((leg, high - low))
        drive, spread = fact["drive"], high - low
        if drive is None or spread < 0.05 * m.stroke:
            continue
        found += _encoder(c, drive, fact, spread)
    return found + _stroke(c, short)


def _encoder(c: Context, drive: int, fact: dict[str, Any], spread: float) -> list[Finding]:
    scale, offset, bent = fact["scale"], fact["offset_m"], fact["bent_m"]
    found, within = [], tolerance(c, spread)
    if abs(scale) < 0.05:
        text = "its encoder stands still while its leg moves"
        return [Finding("encoder_frozen", (drive,), text, "Look at encoder, coupling and cable.")]
    if abs(bent) > max(1.0, abs(scale)) * max(ZERO_M, SIGMAS * sqrt(1.5) * c.machine.tape_m):
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
    if not found and abs(offset) > max(ZERO_M, SIGMAS * c.machine.tape_m):
        way, mend = ("more", "take {} off its zero") if offset > 0.0 else ("less", "add {} to its zero")
        off = f"{1e3 * abs(offset):.2f} mm"
        text = f"it reads {off} {way} than the tape"
        mend = f"Home the drive again, or {mend.format(off)}."
        found.append(Finding("offset", (drive,), text, mend))
    return found


def _stroke(c: Context, short: list[tuple[int, float]]) -> list[Finding]:
    m = c.machine
    if len(short) == LEGS:
        low = max(c.known("encoder", leg)["tape_m"][0] for leg in range(LEGS))
        high = min(c.known("encoder", leg)["tape_m"][1] for leg in range(LEGS))
        text = f"all end at {low:.4f} and {high:.4f} m, configured are {m.length_min:g} and {m.length_max:g}"
        mend = "Write the stroke into platform.length_min_m and platform.length_max_m."
        return [Finding("stroke", tuple(range(LEGS)), text, mend)]
    found = []
    for leg, _ in short:
        low, high = c.known("encoder", leg)["tape_m"]
        text = f"it ends at {low:.4f} and {high:.4f} m, configured are {m.length_min:g} and {m.length_max:g}"
        mend = "Take the end stop out of the way, or shorten the configured stroke."
        found.append(Finding("end_stop", (leg,), text, mend))
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
