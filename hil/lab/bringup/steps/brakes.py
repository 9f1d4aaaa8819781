"""Brake test by hand, with all encoders watched: each brake holds, and opens in time for its own drive.

The operator pushes with a force gauge. Its reading as a leg gives way is the leg's friction, whatever the
drive does.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from math import nan
from statistics import median
from typing import Any

from drivers.arrays import Array
from drivers.signals import LEGS
from hil.lab.bringup.context import (
    FORCE_SHARE,
    MOVED_M,
    TRAVEL_M,
    UNTIMED_S,
    Context,
    Finding,
    Request,
    Step,
    StoppedError,
    gap_of,
)

PUSH_S = 0.15
RATE_WITHIN = 0.6, 1.6
"""Allowed ratio of integrated rate to change of length; outside, the rate has a wrong sign or unit."""
RATE_STEPS, RATE_STEP_M, RATE_STEP_S = 3, 2e-4, 0.2
"""Steps of a reading needed to judge its rate; least size and longest duration of each."""
HIGH = 1.7
"""Friction of a leg is reported as high above this multiple of the median leg,"""
HIGH_SHARE = 0.003
"""and if it exceeds the median by this share of the rated force."""
LATE_TICKS = 3
"""Accepted motion after the closing time of the brake: the last command is still on its way."""
MOVES_S = 0.02
"""Time for a pushed leg to move by MOVED_M once its brake is open, and for its drive to report that."""
STILL_S = 0.1
"""A pushed leg that moves less than MOVED_M in this time is at rest."""
_OR_LATE = "A late encoder reading looks the same: see late_or_lags (encoder_late)."
FEWEST = 3
"""Least number of legs for a meaningful median."""


def find(c: Context) -> None:
    """Have the operator push each leg with all brakes shut, then with its drive's brake open."""
    hold(c)
    firm = [leg for leg, held in c.table("held").items() if not held["moved"]]
    for drive in range(LEGS):
        if c.known("opens", drive) is None:
            c.keep("opens", drive, opened_by(c, drive, firm))
        legs = c.known("opens", drive)["legs"]
        if c.known("shuts", drive) is None and len(legs) == 1 and legs[0] in firm:
            c.keep("shuts", drive, shuts(c, drive, legs[0]))


def hold(c: Context) -> None:
    """Have the operator push each leg with all brakes shut."""
    for leg in c.missing("held"):
        c.take_down()
        c.keep("held", leg, holds(c, leg))


def opened_by(c: Context, drive: int, firm: list[int]) -> dict[str, Any]:
    """Have legs pushed while a drive's brake is open: legs that yield, push force N, ratio of the rate."""
    counts = {each: leg for each, (leg, _) in c.reads().items()}
    with c.opened(drive):
        for leg in dict.fromkeys([drive, counts.get(drive, drive), *firm]):
            by = next((d for d, counted in counts.items() if counted == leg), drive)
            steps = Steps(c, by, partial(c.drive, drive))
            moved, hand_N = gives_way(c, leg, steps.keep)
            if moved:
                others = give_way_too(c, drive, leg, [other for other in firm if other != leg])
                share = steps.share() if by == drive else None
                return {"legs": [leg, *others], "hand_N": hand_N, "rate_share": share}
    return {"legs": [], "hand_N": None, "rate_share": None}


class Steps:
    """Compares the rate that a drive reports with the change of its length. Mutable state: all attributes."""

    def __init__(self, c: Context, drive: int, keep: Callable[[], object]) -> None:
        self._c, self._drive, self._keep = c, drive, keep
        self._begun = self._last = (0, nan, nan)
        self._by_rates_m = 0.0
        self._steps: list[tuple[float, float]] = []

    def keep(self) -> None:
        """Do a tick and take the drive's reading, if fresh."""
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
        """Least-squares ratio of integrated rate to change of length; None after too few steps."""
        if len(self._steps) < RATE_STEPS:
            return None
        return sum(by_m * rate_m for by_m, rate_m in self._steps) / sum(by_m**2 for by_m, _ in self._steps)


def gives_way(c: Context, leg: int, keep: Callable[[], object]) -> tuple[bool, float]:
    """Have the operator push a leg with a brake open; return (it moved, breakaway force N)."""
    before, force = c.lengths(), 0.0
    c.ask(Request("push", leg, 0.0, f"Push leg {leg} along its axis and keep pushing; brake: open"), keep)
    for _ in range(c.drives.ticks(PUSH_S)):
        keep()
    if moved := has_moved(c, leg, before):
        text = f"Read the force at which leg {leg} gave way, N"
        force = c.ask(Request("read_push", leg, 0.0, text, within=(0.0, c.machine.rated_N)), keep)
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"), keep)
    return moved, force


def has_moved(c: Context, leg: int, before: Array, by_m: float = TRAVEL_M) -> bool:
    """True if a leg has travelled farther than `by_m` since the readings `before` (6,) m."""
    return abs(c.travelled(before).get(leg, 0.0)) > by_m


def holds(c: Context, leg: int) -> dict[str, Any]:
    """Have a leg pushed on its shut brake, with FORCE_SHARE of the rated force or more: moved, force N."""
    m, before = c.machine, c.lengths()
    c.ask(Request("push", leg, 0.0, f"Push leg {leg} along its axis and keep pushing; brake: shut"))
    c.rest(PUSH_S)
    moved, hand_N = has_moved(c, leg, before), None
    if not moved:
        least = FORCE_SHARE * m.rated_N
        text = f"Push with at least {least:.4g} N, and read the force that leg {leg} holds, N"
        hand_N = c.ask(Request("read_held", leg, 0.0, text, within=(least, m.rated_N)))
        moved = has_moved(c, leg, before)
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"))
    return {"moved": moved, "hand_N": hand_N}


def shuts(c: Context, drive: int, leg: int) -> dict[str, Any]:
    """Have a leg pushed while its brake opens and closes; result: opened in time, lateness of closing, s.

    Raises StoppedError if the leg does not come to rest.
    """
    text = f"Push leg {leg} against its shut brake, and keep pushing while it moves, until it stops again"
    c.ask(Request("push_on", leg, 0.0, text))
    before = c.lengths()
    with c.opened(drive, timed=True):
        for _ in range(c.drives.ticks(MOVES_S)):
            c.drive(drive)
        in_time = has_moved(c, leg, before, MOVED_M)
    before, late, rests = c.lengths(), 0, c.drives.ticks(STILL_S)
    for n in range(1, c.drives.ticks(UNTIMED_S) + 1):
        c.drives.step()
        if has_moved(c, leg, before, MOVED_M):
            before, late = c.lengths(), n
        elif n - late >= rests:
            break
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"))
    late_s = late / c.drives.line.rate_Hz
    if n - late < rests:
        text = f"leg {leg} still moves {c.machine.brake_shut_s + late_s:.2g} s after its brake was closed"
        remedy = "Check brake, relay and supply; do not load this leg."
        raise StoppedError(Finding("brake_not_shut", (drive,), text, remedy))
    return {"opens": in_time, "late_s": late_s if late > LATE_TICKS else 0.0}


def give_way_too(c: Context, drive: int, leg: int, others: list[int]) -> list[int]:
    """Have all legs but `leg` pushed while a drive's brake is open; return those of `others` that move."""
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
    """Findings about brakes that do not hold, do not open, act late or are crossed, and exchanged drives."""
    found: list[Finding] = []

    def name(finding: str, legs: Iterable[int], text: str, remedy: str) -> None:
        found.append(Finding(finding, tuple(sorted(legs)), text, remedy))

    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    opens = {drive: fact["legs"] for drive, fact in c.table("opens").items()}
    loose = [leg for leg, fact in c.table("held").items() if fact["moved"]]
    inverted = {counts.get(d, d): d for d in opens if not opens[d] and counts.get(d, d) in loose}
    for leg, drive in inverted.items():
        text = f"leg {leg} of drive {drive} moves when pushed with its brake shut, and holds with it open"
        remedy = "Invert the output or the brake's relay. Without power this leg falls; do not load it."
        name("brake_inverted", {leg, drive}, text, remedy)
    for leg in set(loose) - inverted.keys():
        remedy = "Check the brake, its supply and its air gap; do not load this leg."
        name("brake_stuck_open", [leg], "it moves when pushed, with its brake commanded shut", remedy)
    misread = {d: j for d, j in counts.items() if j != d}
    crossed = {d: j for d, j in misread.items() if d in opens and has_crossed_encoder(d, counts, opens)}
    exchanged = {d: j for d, j in misread.items() if d not in crossed}
    if exchanged:
        nodes, order = c.machine.node_ids, [*c.machine.node_ids]
        for drive, leg in exchanged.items():
            order[leg] = nodes[drive]
        text = "; ".join(f"node {nodes[d]} is the drive of leg {j}, not {d}" for d, j in exchanged.items())
        remedy = f"Write drives.node_ids: {order}, or give the drives the numbers of their legs."
        if len(set(order)) < LEGS:
            remedy = "Fix the other findings first, then test again: the node numbers are not clear yet."
        name("ids", exchanged, text, remedy)
    if crossed:
        text = "; ".join(f"the encoder of drive {d} reads leg {j}" for d, j in crossed.items())
        name("encoder_crossed", crossed, text, "Exchange these drives' encoder cables.")
    for drive, legs in opens.items():
        if not legs and drive not in inverted.values():
            remedy = "Check brake, cable and supply. Friction above the push has the same effect."
            name("brake_stuck_shut", [drive], "its brake does not open: no leg moves when pushed", remedy)
        elif len(legs) > 1:
            text = f"drive {drive} opens the brakes of legs {', '.join(map(str, sorted(legs)))} at once"
            remedy = "Give each brake an output of its own; do not load these legs."
            name("brake_crossed", {drive, *legs}, text, remedy)
    wrong = {d: legs[0] for d, legs in opens.items() if len(legs) == 1 and legs != [d] and d not in exchanged}
    if wrong:
        text = "; ".join(f"drive {d} opens the brake of leg {j}" for d, j in wrong.items())
        name("brake_crossed", wrong, text, "Exchange the brakes' cables.")
    for drive, fact in c.table("shuts").items():
        shut_s, open_s = c.machine.brake_shut_s, c.machine.brake_open_s
        if fact["late_s"]:
            late_ms, allowed = 1e3 * (shut_s + fact["late_s"]), f"{1e3 * shut_s:g} ms, engage.brake_close_s"
            text = f"pushed, it stops {late_ms:.0f} ms after its brake was closed, allowed: {allowed}"
            remedy = f"Check its relay, diode and air gap; or configure its true time. {_OR_LATE}"
            name("brake_late", opens[drive], text, remedy)
        elif not fact["opens"]:
            text = f"pushed, it does not move within {1e3 * open_s:g} ms of opening, engage.brake_release_s"
            remedy = f"Check its supply and air gap; or configure its true time. {_OR_LATE}"
            name("brake_opens_late", opens[drive], text, remedy)
    for drive, fact in c.table("opens").items():
        share = fact["rate_share"]
        if share is not None and not RATE_WITHIN[0] <= share <= RATE_WITHIN[1]:
            finding = "rate_sign" if share < -RATE_WITHIN[0] else "rate_scale"
            text = f"while its leg moves, the rate that it reports is {share:.3g} times the change of length"
            name(finding, [drive], text, "Check sign and unit of the speed in the drive.")
    return found + friction(c)


def has_crossed_encoder(drive: int, counts: Mapping[int, int], opens: Mapping[int, list[int]]) -> bool:
    """True if a drive that reads another leg's length has a crossed encoder, not an exchanged node number.

    A drive with a crossed encoder opens its own brake. If its output opens neither its own leg nor the one it
    reads, the cycle of drives that read each other's legs decides: one that opens its own leg is enough.
    """
    if drive in opens[drive] or counts[drive] in opens[drive]:
        return drive in opens[drive]
    round_with_it = [drive]
    while (following := counts.get(round_with_it[-1])) is not None and following not in round_with_it:
        round_with_it.append(following)
    return any(each in opens[each] for each in round_with_it)


def friction(c: Context) -> list[Finding]:
    """Findings: legs that need a much larger hand force to move than the median leg."""
    facts = [fact for fact in c.table("opens").values() if fact["legs"]]
    if len(facts) < FEWEST:
        return []
    usual = median(fact["hand_N"] for fact in facts)
    remedy = "Check guide, nut and seals, and whether the brake drags."
    return [
        Finding("friction", (legs[0],), f"it moves at {N:.4g} N by hand, the median is {usual:.4g} N", remedy)
        for legs, N in ((fact["legs"], fact["hand_N"]) for fact in facts)
        if max(HIGH * usual, usual + HIGH_SHARE * c.machine.rated_N) < N
    ]


def gap(c: Context) -> Finding | None:
    """Finding that lists drives whose rate is unproven because their legs moved too slowly or too little."""
    unseen = [drive for drive, fact in c.table("opens").items() if fact["rate_share"] is None]
    if not unseen:
        return None
    text = f"drives {unseen} moved too little or too slowly to compare their rate with their reading"
    by_mm, mm_s = 1e3 * RATE_STEPS * RATE_STEP_M, 1e3 * RATE_STEP_M / RATE_STEP_S
    again = f"Push again after `--again`, by {by_mm:g} mm or more at {mm_s:g} mm/s or more"
    return gap_of(text, f"{again}; or compare sign and unit of their speed by hand")


STEP = Step(
    "brakes",
    "brakes, by hand",
    "has you push each leg on its shut brake; then opens one brake after the other, without force, the five "
    "others shut, while you push its leg and then the others; then times the brake while you push",
    "Ctrl-C, or the emergency stop; brakes shut by themselves when this program stops sending",
    find,
    judge,
    gate=False,
    gap=gap,
    tables=("held", "opens", "shuts"),
)
