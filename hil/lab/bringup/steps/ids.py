"""Bring-up step that assigns drives to legs: each leg is moved by hand while all encoders are read."""

import numpy as np

from drivers.signals import LEGS
from hil.lab.bringup.context import SETTLED_S, Context, Finding, Request, Step

MOVE_SHARE = 0.1
"""Distance of the move by hand, as a share of the stroke."""
COUNTS = 5e-3
"""A reading counts far too little if it changes by this share of the move, but less than RESPONDS."""
RESPONDS = 0.1
"""A reading that changes by more than this share of the move responds to it."""


def find(c: Context) -> None:
    """Have the operator move each leg by hand, all drives off; store which encoders respond."""
    by_m = MOVE_SHARE * c.machine.stroke
    for leg in c.missing("ids"):
        c.take_down()
        c.rest(SETTLED_S)
        before = c.lengths()
        text = f"Move leg {leg} alone, with the lever on its brake, longer by about {1e3 * by_m:.0f} mm"
        c.ask(Request("move", leg, by_m, text))
        c.rest(SETTLED_S)
        changes = c.lengths() - before
        responds = np.flatnonzero(np.abs(changes) > RESPONDS * by_m)
        c.keep("ids", leg, {"drives": responds.tolist(), "changes_m": changes.tolist()})


def drive_of(c: Context) -> dict[int, int]:
    """{leg: drive whose encoder reads it}; the leg's own drive if several do."""
    drives = {leg: fact["drives"] for leg, fact in c.table("ids").items()}
    return {leg: leg if leg in counted else counted[0] for leg, counted in drives.items() if counted}


def judge(c: Context) -> list[Finding]:
    """Findings: encoders that stand still or read a second leg; exchanged drives show at the brakes."""
    found, remedy = [], "Check encoder, coupling and cable."
    drives = {leg: fact["drives"] for leg, fact in c.table("ids").items()}
    for leg, counted in drives.items():
        text = f"the encoder of its drive also reads leg {leg}"
        others = [drive for drive in counted if drive != leg and len(counted) > 1]
        found += [Finding("encoder_counts_another", (drive, leg), text, remedy) for drive in others]
    found += [_unmoved(c, k) for k in range(LEGS) if not any(k in counted for counted in drives.values())]
    blind = {leg for leg, counted in drives.items() if not counted} - {f.legs[0] for f in found}
    return found + [
        Finding("encoder_unseen", (k,), "no encoder reads its length", remedy) for k in sorted(blind)
    ]


def _unmoved(c: Context, drive: int) -> Finding:
    """Finding for an encoder that reads no leg: it stands still, or changes far too little."""
    changes = [fact["changes_m"][drive] for fact in c.table("ids").values()]
    most, by_m = max(changes, key=abs), MOVE_SHARE * c.machine.stroke
    if abs(most) > COUNTS * by_m:
        text = f"its reading changes by {1e3 * most:.2f} mm as a leg is moved by about {1e3 * by_m:.0f} mm"
        remedy = "Check counts per m in the drive, lead and gear; and that the leg was moved so far."
        return Finding("encoder_scale", (drive,), text, remedy)
    text, remedy = "its reading does not change while its leg moves", "Check encoder, coupling, cable, leg."
    return Finding("encoder_frozen", (drive,), text, remedy)


STEP = Step(
    "ids",
    "which drive is which leg",
    "watches the encoders with all drives off while you move one leg after the other by hand",
    "Ctrl-C; no drive is powered",
    find,
    judge,
)
