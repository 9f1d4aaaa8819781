"""Bring-up step that proves each drive's own watchdog: the controller stops sending.

Drives that can be powered on shut brakes are proven all at once. Drives without a state between off and
enabled open the brake of their leg, so they are proven one at a time, on trestles. A drive is watched
throughout if it reports at a SYNC that does not feed its watchdog. Other drives are polled before and after
the time of the watchdog.
"""

from collections.abc import Callable, Iterator, Sequence
from math import ceil, floor
from typing import Any

from drivers.signals import LEGS, DriveMode, DriveState
from drivers.tick_columns import Record
from hil.lab.bringup.context import Context, Finding, Step, gap_of

POWER_S = 0.1
WAIT, WAIT_S = 6.0, 0.4
"""The silence lasts this multiple of the configured watchdog, and at least WAIT_S."""
EARLY, LATE = 0.5, 1.5
"""Accepted range of a watchdog, as multiples of the configured one."""
POLLS = 3
"""Ticks in which a drive is polled for its power state, since an answer may be late or lost."""
SEEN_EARLY = 0.7
"""Limit in place of EARLY for a watched drive, whose reaction is seen a period late."""
TRIES = 5
"""Measurements at most, if a late tick leaves a result open."""
_POWERED = (DriveState.READY, DriveState.RUN)
Fact = dict[str, Any]
"""`powered` before the silence; the watchdog acts between `since_s` and `until_s`."""


def find(c: Context) -> None:
    """Power the drives, stop commanding them, and measure the time until each loses power.

    Times are measured by the clock at ticks, even late ones. A result that a late tick leaves open is
    measured again.
    """
    traits = c.drives.protocol.traits
    missing = list(c.missing("watchdog")) if _observable(c) else []
    polled = traits.command_delay_ticks > 0 or traits.power_told == "heartbeat"
    find_some = _find_polled if polled and not traits.force_on_brakes else _find_watched
    together = [list(range(LEGS))] if missing else []
    for legs in together if traits.force_on_brakes else [[leg] for leg in missing]:
        for _ in range(TRIES):
            facts = find_some(c, legs)
            if all(_is_conclusive(c, fact) for fact in facts):
                break
        for leg, fact in zip(legs, facts, strict=True):
            c.keep("watchdog", leg, fact)


def _is_conclusive(c: Context, fact: Fact) -> bool:
    """True if the measured bounds decide whether the watchdog's time is right."""
    until, since = fact["until_s"], fact["since_s"]
    if not fact["powered"] or until is None:
        return True
    if since is None:
        return bool(until < SEEN_EARLY * c.machine.watchdog_s)
    return bool(until <= _latest_s(c) or since > LATE * c.machine.watchdog_s)


def _latest_s(c: Context) -> float:
    return LATE * c.machine.watchdog_s + 3.0 / c.drives.line.rate_Hz


def _observable(c: Context) -> bool:
    return c.drives.protocol.traits.power_told != "never"


def _powered(c: Context, leg: int) -> bool:
    return int(c.drives.record["drive_state"][leg]) in _POWERED


def _wait_s(c: Context) -> float:
    return max(WAIT * c.machine.watchdog_s, WAIT_S)


def _find_watched(c: Context, legs: Sequence[int]) -> list[Fact]:
    """Power all drives on shut brakes, or enable one alone; stop commanding, watch the answers to SYNC."""
    drives = c.drives
    if len(legs) == 1:
        with c.opened(legs[0]):
            return _watched(c, legs, lambda: drives.step(DriveMode.RUN, legs[0], silent=True))
    drives.prepare(None)
    for _ in range(drives.ticks(POWER_S)):
        drives.step(DriveMode.READY)
        if all(_powered(c, leg) for leg in legs):
            break
    try:
        return _watched(c, legs, lambda: drives.step(DriveMode.READY, silent=True))
    finally:
        drives.off()


def _watched(c: Context, legs: Sequence[int], silent: Callable[[], Record]) -> list[Fact]:
    """Stop commanding, and measure the time to the first tick in which each drive is not powered."""
    facts: list[Fact] = [{"powered": _powered(c, k), "until_s": None, "since_s": None} for k in legs]
    period_ns = 1e9 / c.drives.line.rate_Hz
    last_ns = before_ns = int(c.drives.record["t_ns"])
    for _ in range(c.drives.ticks(_wait_s(c))):
        now_ns = int(silent()["t_ns"])
        for k, fact in zip(legs, facts, strict=True):
            if fact["until_s"] is None and not _powered(c, k):
                fact["until_s"] = 1e-9 * (now_ns - last_ns)
                fact["since_s"] = max(0.0, 1e-9 * (before_ns - last_ns - period_ns))
        before_ns = now_ns
        if all(fact["until_s"] is not None for fact in facts):
            break
    return facts


def _find_polled(c: Context, legs: Sequence[int]) -> list[Fact]:
    """Poll a drive before and after its watchdog time: commands feed the watchdog, not the lost power.

    If only the heartbeat reports the power state, commands go on until the next heartbeat. Result: longest
    times, s, between two commands that the watchdog outlasted (`since_s`) or not (`until_s`).
    """
    leg, rate, wait = legs[0], c.drives.line.rate_Hz, c.machine.watchdog_s
    late_s = c.machine.heartbeat_s if c.drives.protocol.traits.power_told == "heartbeat" else 0.0
    early = max(1, floor(EARLY * wait * rate) - 1)
    bounds: list[float | None] = [None, None]
    with c.opened(leg):
        powered = _powered(c, leg)
        for ticks in (early, ceil(LATE * wait * rate), c.drives.ticks(_wait_s(c))):
            last_ns, longest_ns = int(c.drives.record["t_ns"]), 0
            for _ in range(ticks):
                c.drives.step(DriveMode.RUN, leg, silent=True)
            for _ in range(POLLS + ceil(late_s * rate)):
                now_ns = int(c.drives.step(DriveMode.RUN, leg)["t_ns"])
                longest_ns, last_ns = max(longest_ns, now_ns - last_ns), now_ns
            lost = not _powered(c, leg)
            bounds[lost] = 1e-9 * longest_ns
            if lost:
                break
    return [{"powered": powered, "until_s": bounds[1], "since_s": bounds[0]}]


def judge(c: Context) -> Iterator[Finding]:
    """Findings: watchdogs that are missing, too slow or too fast."""
    wait = c.machine.watchdog_s
    for leg, fact in c.table("watchdog").items():
        until, since_ms = fact["until_s"], 1e3 * (fact["since_s"] or 0.0)
        remedy = "Set the drive's watchdog, or its unit."
        if not fact["powered"]:
            name, text = "not_powered", "the drive does not switch on, or does not stay on"
            remedy = "Check its fault, its enable, and for a watchdog shorter than the one set."
        elif until is None:
            name, text = "watchdog_missing", f"powered {1e3 * _wait_s(c):g} ms after the last command"
            remedy = "Switch its watchdog on: nothing stops this leg when the controller dies."
        else:
            text = f"reacts {since_ms:g} to {1e3 * until:g} ms after the last command"
            if not _is_conclusive(c, fact):
                name = "watchdog_unmeasured"
                remedy = f"Ticks were late {TRIES} times: close other programs, and repeat the command."
            elif until > _latest_s(c):
                name = "watchdog_long"
            elif until < SEEN_EARLY * wait:
                name = "watchdog_short"
            else:
                continue
        if until is not None or not fact["powered"] or c.drives.protocol.traits.has_watchdog:
            yield Finding(name, (leg,), f"{text}, configured: {1e3 * wait:g} ms", remedy)


def gap(c: Context) -> Finding | None:
    """Finding that lists drives without a provable watchdog; only if this program cannot set watchdogs."""
    legs = [leg for leg in range(LEGS) if not _observable(c) or c.known("watchdog", leg)["until_s"] is None]
    if c.drives.protocol.traits.has_watchdog or not legs:
        return None
    shown = f"the drives of legs {', '.join(map(str, legs))} stay enabled without commands"
    if not _observable(c):
        shown = "their answers do not show whether they are enabled"
    return gap_of(
        f"they have no watchdog that this program sets, and {shown}",
        "When the program dies a drive keeps its last torque. Make sure that a switch independent of program "
        "and bus cuts the drives' power and shuts the brakes, try it now, and keep it in reach",
    )


STEP = Step(
    "watchdog",
    "watchdogs, by silence",
    "powers the drives without force on shut brakes and stops sending; drives without such a state are "
    "enabled one at a time, on trestles",
    "Ctrl-C, or the emergency stop",
    find,
    judge,
    gap=gap,
)
