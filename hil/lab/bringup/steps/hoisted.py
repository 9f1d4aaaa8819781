"""Brakes and drives once more, each alone, while a hoist carries the mounted platform.

Cables, plugs and brakes may change at mounting. With five brakes shut the platform has one way to move, that
of the leg whose brake is open; without its weight the force on that leg is the drive's, or the hand's.
"""

from collections.abc import Iterator
from dataclasses import replace

from hil.lab.bringup.context import Context, Finding, Request, Step, StoppedError
from hil.lab.bringup.steps import brakes, force
from hil.lab.bringup.steps.mounted import AFTER

LOADED_M = 5e-4
"""A leg that goes farther than this as a brake opens without force carries weight."""
WATCH_S = 0.1
HOISTED = "hoisted"


def find(c: Context) -> None:
    """Have a hoist carry the platform; open each brake alone, then repeat `brakes` and `force`."""
    text = "Let a hoist carry the whole platform, jigs and levers taken away, nobody under it"
    c.ask(Request("carry", text=text, word="carried"))
    h = _on_hoist(c)
    for drive in h.missing("unloaded"):
        h.keep("unloaded", drive, _stays(h, drive))
    brakes.find(h)
    force.find(h)


def _on_hoist(c: Context) -> Context:
    """Context of the same machine whose facts are those on the hoist; the platform is not taken off."""
    facts = c.facts.setdefault(HOISTED, {})
    facts["encoder"] = c.facts.get("encoder", {})
    return replace(c, facts=facts)


def _stays(h: Context, drive: int) -> bool:
    """Open a brake without force and watch all legs; True. Raises StoppedError: a leg moved."""
    before = h.lengths()

    def watch() -> None:
        moved = {leg: by_m for leg, by_m in h.travelled(before).items() if abs(by_m) > LOADED_M}
        if moved:
            legs = ", ".join(f"leg {leg} {1e3 * by_m:+.2f} mm" for leg, by_m in moved.items())
            text = (
                f"as drive {drive} opened a brake without force, {legs} moved: the hoist does not carry all"
            )
            remedy = (
                "Tighten the hoist. If another leg moved, see brake_crossed: exchange the brakes' cables."
            )
            raise StoppedError(Finding("loaded", tuple(moved), text, f"{remedy} {AFTER}"))

    with h.opened(drive, watch=watch):
        for _ in range(h.drives.ticks(WATCH_S)):
            h.drive(drive)
            watch()
    return True


def judge(c: Context) -> Iterator[Finding]:
    """Findings of `brakes` and `force`, measured on the hoist."""
    h = _on_hoist(c)
    for finding in (*brakes.judge(h), *force.judge(h)):
        yield finding._replace(text=f"{finding.text} (on the hoist)", remedy=f"{finding.remedy} {AFTER}")


STEP = Step(
    HOISTED,
    "brakes and drives, mounted, a hoist carries the platform",
    "opens one brake after the other, the five others shut: without force, then while you push, then while "
    "its drive pushes by 0.1 mm",
    "Ctrl-C, or the emergency stop; brakes shut by themselves when this program stops sending",
    find,
    judge,
)
