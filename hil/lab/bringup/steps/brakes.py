"""Each brake holds when shut, and opens for its own drive: by hand, with all encoders watched.

The hand has a force gauge: what it reads as a leg gives way is the leg's friction, whatever its drive does.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from math import nan
from statistics import median
from typing import Any

from drivers.signals import LEGS
from hil.lab.bringup.context import FORCE_SHARE, TRAVEL_M, Context, Finding, Request, Step, gap_of

PUSH_S = 0.15
RATE_WITHIN = 0.6, 1.6
"""A rate is so many times what its reading changes by: beyond that it has another sign or unit."""
RATE_STEPS, RATE_STEP_M, RATE_STEP_S = 3, 2e-4, 0.2
"""So many steps of a reading, each by so much within such a time, tell its rate."""
HIGH = 1.7
"""Friction of so many times the median of the legs is high,"""
HIGH_SHARE = 0.003
"""and by this share of the rated force above it."""
FEWEST = 3
"""Legs of which a median says something."""


def find(c: Context) -> None:
    """Have each leg pushed with all brakes shut, then each with its drive's brake open."""
    for leg in c.missing("held"):
        c.take_down()
        c.keep("held", leg, holds(c, leg))
    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    for drive in c.missing("opens"):
        firm = [leg for leg, held in c.table("held").items() if not held["moved"]]
        fact: dict[str, Any] = {"legs": [], "hand_N": None, "rate_share": None}
        with c.opened(drive):
            for leg in dict.fromkeys([drive, counts.get(drive, drive), *firm]):
                by = next((d for d, counted in counts.items() if counted == leg), drive)
                steps = Steps(c, by, partial(c.drive, drive))
                moved, hand_N = gives_way(c, leg, steps.keep)
                if moved:
                    others = give_way_too(c, drive, leg, [other for other in firm if other != leg])
                    share = steps.share() if by == drive else None
                    fact = {"legs": [leg, *others], "hand_N": hand_N, "rate_share": share}
                    break
        c.keep("opens", drive, fact)


class Steps:
    """The steps of a reading, and what its rates make of them. Mutable state: all."""

    def __init__(self, c: Context, drive: int, keep: Callable[[], object]) -> None:
        self._c, self._drive, self._keep = c, drive, keep
        self._begun = self._last = (0, nan, nan)
        self._by_rates_m = 0.0
        self._steps: list[tuple[float, float]] = []

    def keep(self) -> None:
        """Do a tick, and take what the drive reads in it."""
        self._keep()
        record, drive = self._c.drives.record, self._drive
        if record["age"][drive] != 0:
            return
        here = int(record["t_ns"]), float(record["length"][drive]), float(record["rate"][drive])
        last, self._last = self._last, here
        self._by_rates_m += 0.5e-9 * (here[2] + last[2]) * (here[0] - last[0])
        by_m, took_s = here[1] - self._begun[1], 1e-9 * (here[0] - self._begun[0])
        if abs(by_m) > RATE_STEP_M and took_s <= RATE_STEP_S:
            self._steps.append((by_m, self._by_rates_m))
        elif abs(by_m) <= RATE_STEP_M and took_s <= RATE_STEP_S:
            return
        self._begun, self._by_rates_m = here, 0.0

    def share(self) -> float | None:
        """Return how many times its change the rates make of a reading; None where it moved too little."""
        if len(self._steps) < RATE_STEPS:
            return None
        return sum(by_m * rate_m for by_m, rate_m in self._steps) / sum(by_m**2 for by_m, _ in self._steps)


def gives_way(c: Context, leg: int, keep: Callable[[], object]) -> tuple[bool, float]:
    """Have a leg pushed with a brake open; tell whether it has moved, and with how many N."""
    before = c.lengths()
    c.ask(Request("push", leg, 0.0, f"Push leg {leg} along its axis and keep pushing; brake: open"), keep)
    for _ in range(c.drives.ticks(PUSH_S)):
        keep()
    moved = abs(c.travelled(before).get(leg, 0.0)) > TRAVEL_M
    force = 0.0
    if moved:
        text = f"Read the force at which leg {leg} gave way, N"
        force = c.ask(Request("read_push", leg, 0.0, text, within=(0.0, c.machine.rated_N)), keep)
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"), keep)
    return moved, force


def holds(c: Context, leg: int) -> dict[str, Any]:
    """Have a leg pushed on its shut brake by FORCE_SHARE of the rated force or more, and the force read."""
    m, before = c.machine, c.lengths()
    c.ask(Request("push", leg, 0.0, f"Push leg {leg} along its axis and keep pushing; brake: shut"))
    c.rest(PUSH_S)
    moved, hand_N = abs(c.travelled(before).get(leg, 0.0)) > TRAVEL_M, None
    if not moved:
        least = FORCE_SHARE * m.rated_N
        text = f"Push with at least {least:.4g} N, and read the force that leg {leg} holds, N"
        hand_N = c.ask(Request("read_held", leg, 0.0, text, within=(least, m.rated_N)))
        moved = abs(c.travelled(before).get(leg, 0.0)) > TRAVEL_M
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"))
    return {"moved": moved, "hand_N": hand_N}


def give_way_too(c: Context, drive: int, leg: int, others: list[int]) -> list[int]:
    """Have all legs but one pushed with a drive's brake open; return which of `others` move."""
    before, moved = c.lengths(), set[int]()

    def keep() -> None:
        c.drive(drive)
        moved.update(other for other, by_m in c.travelled(before).items() if abs(by_m) > TRAVEL_M)

    text = f"Push each leg but leg {leg} along its axis, one after the other or at once; brake: shut"
    c.ask(Request("push_others", leg, 0.0, text), keep)
    for _ in range(c.drives.ticks(PUSH_S)):
        keep()
    c.ask(Request("let_go_all", leg, 0.0, "Let go of all legs"), keep)
    return [other for other in others if other in moved]


def judge(c: Context) -> list[Finding]:
    """Name brakes that do not hold, do not open or belong to another drive, and exchanged drives."""
    found: list[Finding] = []

    def name(finding: str, legs: Iterable[int], text: str, mend: str) -> None:
        found.append(Finding(finding, tuple(sorted(legs)), text, mend))

    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    opens = {drive: fact["legs"] for drive, fact in c.table("opens").items()}
    loose = [leg for leg, fact in c.table("held").items() if fact["moved"]]
    inverted = {counts.get(d, d): d for d in range(LEGS) if not opens[d] and counts.get(d, d) in loose}
    for leg, drive in inverted.items():
        text = f"leg {leg}, behind drive {drive}, gives way to a hand on a shut brake, holds on an open one"
        mend = "Turn the output or the brake's relay round: without power this leg falls; do not load it."
        name("brake_inverted", {leg, drive}, text, mend)
    for leg in set(loose) - inverted.keys():
        mend = "Look at brake, its supply and its air gap; do not load this leg."
        name("brake_stuck_open", [leg], "it gives way to a hand with its brake commanded shut", mend)
    crossed = {d: j for d, j in counts.items() if j != d and has_crossed_encoder(d, counts, opens)}
    exchanged = {d: j for d, j in counts.items() if j != d and d not in crossed}
    if exchanged:
        nodes = c.machine.node_ids
        order = list(nodes)
        for drive, leg in exchanged.items():
            order[leg] = nodes[drive]
        text = "; ".join(f"node {nodes[d]} is the drive of leg {j}, not {d}" for d, j in exchanged.items())
        mend = f"Write drives.node_ids: {order}, or give the drives the numbers of their legs."
        if len(set(order)) < LEGS:
            mend = "Mend the rest first: which number is whose will be seen then."
        name("ids", exchanged, text, mend)
    if crossed:
        text = "; ".join(f"drive {d} counts leg {j}" for d, j in crossed.items())
        name("encoder_crossed", crossed, text, "Exchange these drives' encoder cables.")
    for drive, legs in opens.items():
        if not legs and drive not in inverted.values():
            mend = "Look at the brake, its cable, its supply. More friction than the push looks the same."
            name("brake_stuck_shut", [drive], "its brake does not open: no leg gives way", mend)
        elif len(legs) > 1:
            text = f"drive {drive} opens the brakes of legs {', '.join(map(str, sorted(legs)))} at once"
            mend = "Give each brake an output of its own; do not load these legs."
            name("brake_crossed", {drive, *legs}, text, mend)
    wrong = {d: legs[0] for d, legs in opens.items() if len(legs) == 1 and legs != [d] and d not in exchanged}
    if wrong:
        text = "; ".join(f"drive {d} opens the brake of leg {j}" for d, j in wrong.items())
        name("brake_crossed", wrong, text, "Exchange the brakes' cables.")
    for drive, fact in c.table("opens").items():
        share = fact["rate_share"]
        if share is not None and not RATE_WITHIN[0] <= share <= RATE_WITHIN[1]:
            finding = "rate_sign" if share < -RATE_WITHIN[0] else "rate_scale"
            text = f"as it moves its rate is {share:.3g} times what its reading changes by"
            name(finding, [drive], text, "Look at sign and unit of the speed in the drive.")
    return found + friction(c)


def has_crossed_encoder(drive: int, counts: Mapping[int, int], opens: Mapping[int, list[int]]) -> bool:
    """Tell whether a drive that counts another leg has its own brake, or may have, and is among such.

    A brake that opens no leg says nothing of whose drive it is; those whose readings go round with it do.
    """
    if drive in opens[drive] or counts[drive] in opens[drive]:
        return drive in opens[drive]
    round_with_it = [drive]
    while (following := counts.get(round_with_it[-1])) is not None and following not in round_with_it:
        round_with_it.append(following)
    return any(each in opens[each] for each in round_with_it)


def friction(c: Context) -> list[Finding]:
    """Name legs that need more force than the others to give way to a hand."""
    facts = [fact for fact in c.table("opens").values() if fact["legs"]]
    if len(facts) < FEWEST:
        return []
    usual = median(fact["hand_N"] for fact in facts)
    mend = "Look at guide, nut, seals, and a brake that drags."
    return [
        Finding("friction", (legs[0],), f"it gives way at {N:.4g} N, the median is {usual:.4g} N", mend)
        for legs, N in ((fact["legs"], fact["hand_N"]) for fact in facts)
        if max(HIGH * usual, usual + HIGH_SHARE * c.machine.rated_N) < N
    ]


def gap(c: Context) -> Finding | None:
    """Say whose rate was not seen: a leg that gave way too slowly, or too little."""
    unseen = [drive for drive, fact in c.table("opens").items() if fact["rate_share"] is None]
    if not unseen:
        return None
    legs = ", ".join(map(str, unseen))
    return gap_of(
        f"drives {legs} moved too little, or too slowly, for their rate to be compared with what they read",
        f"Push again after `--again`, by {1e3 * RATE_STEPS * RATE_STEP_M:g} mm or more at "
        f"{1e3 * RATE_STEP_M / RATE_STEP_S:g} mm/s or more; or compare sign and unit of their speed by hand",
    )


STEP = Step(
    "brakes",
    "brakes, by hand",
    "has you push each leg on its shut brake; then opens one brake after the other, without force, the five "
    "others shut, while you push its leg and then the others",
    "Ctrl-C, or the emergency stop; brakes shut by themselves when this program falls silent",
    find,
    judge,
    gate=False,
    gap=gap,
    tables=("held", "opens"),
)
