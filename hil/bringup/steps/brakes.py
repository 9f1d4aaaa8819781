"""Each brake holds when shut, and opens for its own drive: by hand, with all encoders watched."""

from collections.abc import Callable

from drivers.signals import LEGS, DriveMode
from hil.bringup.context import TRAVEL_M, Context, Finding, Request
from hil.bringup.step import Step

PUSH_S = 0.15


def find(c: Context) -> None:
    """Have each leg pushed with all brakes shut, then each with its drive's brake open."""
    for leg in range(LEGS):
        if c.known("held", leg) is None:
            c.keep("held", leg, {"moved": gives_way(c, leg, c.drives.step, "shut")})
    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    for drive in range(LEGS):
        if c.known("opens", drive) is not None:
            continue
        likely = list(dict.fromkeys([drive, counts.get(drive, drive), *range(LEGS)]))
        gave: list[int] = []
        with c.opened(drive):
            for leg in likely:
                if gives_way(c, leg, lambda drive=drive: c.drives.step(DriveMode.RUN, drive), "open"):
                    gave = [leg]
                    break
        c.keep("opens", drive, {"legs": gave})


def gives_way(c: Context, leg: int, keep: Callable[[], object], state: str) -> bool:
    """Have a leg pushed by hand and tell whether it has moved."""
    before = c.lengths()
    c.ask(Request("push", leg, 0.0, f"Push leg {leg} along its axis and keep pushing; brake: {state}"), keep)
    for _ in range(c.drives.ticks(PUSH_S)):
        keep()
    moved = abs(c.travelled(before).get(leg, 0.0)) > TRAVEL_M
    c.ask(Request("let_go", leg, 0.0, f"Let go of leg {leg}"), keep)
    return moved


def judge(c: Context) -> list[Finding]:
    """Name brakes that do not hold, do not open or belong to another drive, and exchanged drives."""
    found = []
    for leg in range(LEGS):
        if c.known("held", leg)["moved"]:
            text = "it gives way to a hand with its brake commanded shut"
            mend = "Look at brake, its supply and its air gap; do not load this leg."
            found.append(Finding("brake_stuck_open", (leg,), text, mend))
    counts = {drive: leg for drive, (leg, _) in c.reads().items()}
    opens = {drive: c.known("opens", drive)["legs"] for drive in range(LEGS)}
    exchanged = {d: j for d, j in counts.items() if j != d and opens[d] != [d]}
    crossed = {d: j for d, j in counts.items() if j != d and opens[d] == [d]}
    if exchanged:
        nodes = c.machine.node_ids
        text = "; ".join(f"node {nodes[d]} is the drive of leg {j}, not {d}" for d, j in exchanged.items())
        order = list(nodes)
        for drive, leg in exchanged.items():
            order[leg] = nodes[drive]
        mend = f"Write drives.node_ids: {order}, or give the drives the numbers of their legs."
        found.append(Finding("ids", tuple(sorted(exchanged)), text, mend))
    if crossed:
        text = "; ".join(f"drive {d} counts leg {j}, its brake is that of leg {d}" for d, j in crossed.items())
        mend = "Exchange these drives' encoder cables."
        found.append(Finding("encoder_crossed", tuple(sorted(crossed)), text, mend))
    stuck = [d for d in range(LEGS) if not opens[d]]
    for drive in stuck:
        text = "its brake does not open: no leg gives way"
        found.append(Finding("brake_stuck_shut", (drive,), text, "Look at the brake, its cable, its supply."))
    others = {d: j for d, (j,) in opens.items() if opens[d]} if not stuck else {
        d: legs[0] for d, legs in opens.items() if legs
    }
    wrong = {d: j for d, j in others.items() if j != d and d not in exchanged}
    if wrong:
        text = "; ".join(f"drive {d} opens the brake of leg {j}" for d, j in wrong.items())
        found.append(Finding("brake_crossed", tuple(sorted(wrong)), text, "Exchange the brakes' cables."))
    return found


STEP = Step(
    "brakes",
    "brakes, by hand",
    "opens one brake after the other, without force, the five others shut, while you push the legs",
    "Ctrl-C, or the emergency stop; brakes shut by themselves when this program falls silent",
    find,
    judge,
    gate=False,
)
