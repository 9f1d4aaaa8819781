"""Brakes and drives once more, each alone, while a hoist carries the mounted platform.

Cables, plugs and brakes may change at mounting. With five brakes shut the platform has one way to move, that
of the leg whose brake is open; without its weight the force on that leg is the drive's, or the hand's.
"""

from collections.abc import Iterator
from dataclasses import replace

from drivers.signals import LEGS
from hil.lab.bringup.context import Context, Finding, Request, Step
from hil.lab.bringup.steps import brakes, force
from hil.lab.bringup.steps.mounted import AFTER

LOADED_M = 5e-4
"""A leg that goes farther than this as a brake opens without force carries weight."""
MOST_M = 2e-2
"""Largest travel of a leg, m, while its brake is open and a hand or its drive pushes."""
WATCH_S = 0.1
HOISTED = "hoisted"


def find(c: Context) -> None:
    """Have a hoist carry the platform; open each brake alone, then repeat `brakes` and `force`.

    What is stored of an earlier hoist does not count. A finding on brakes ends it before drives push.
    """
    text = "Let a hoist carry the whole platform, jigs and levers taken away, nobody under it"
    c.ask(Request("carry", text=text, word="carried"))
    c.facts.pop(HOISTED, None)
    h = _on_hoist(c)
    brakes.hold(h)
    if not brakes.judge(h):
        tight = replace(h, most_m=LOADED_M)
        for drive in range(LEGS):
            with tight.opened(drive):
                for _ in range(h.drives.ticks(WATCH_S)):
                    tight.drive(drive)
            h.keep("unloaded", drive, fact=True)
        brakes.find(h)
    if not brakes.judge(h):
        away = "Hands off, everybody away from the platform: the drives push now"
        c.ask(Request("clear", text=away, word="clear"))
        force.find(h)


def _on_hoist(c: Context) -> Context:
    """Context of the same machine whose facts are those on the hoist; the platform is not taken off."""
    facts = c.facts.setdefault(HOISTED, {})
    facts["encoder"] = c.facts.get("encoder", {})
    return replace(c, facts=facts, most_m=MOST_M)


def judge(c: Context) -> Iterator[Finding]:
    """Findings of `brakes` and `force`, measured on the hoist."""
    h = _on_hoist(c)
    found = brakes.judge(h)
    for finding in found or force.judge(h):
        yield finding._replace(text=f"{finding.text} (on the hoist)", remedy=f"{finding.remedy} {AFTER}")


STEP = Step(
    HOISTED,
    "brakes and drives, mounted, a hoist carries the platform",
    "opens one brake after the other, the five others shut: without force, then while you push, then while "
    "its drive pushes by 0.1 mm",
    "Ctrl-C, or the emergency stop; keep hands off while drives push; brakes shut by themselves when this "
    "program stops sending",
    find,
    judge,
)
