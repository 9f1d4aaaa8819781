"""Each drive's own watchdog, proven by silence.

Drives that are powered on shut brakes are proven all at once. The others know no state between off and
enabled: the brake of a leg on its trestle opens meanwhile, one at a time. What a drive sends unasked, at a
SYNC that does not feed its watchdog, is watched; other drives are asked before and after their time.
"""

from math import ceil, floor

from drivers.signals import LEGS, DriveMode, DriveState
from hil.bringup.context import Context, Finding, Gap
from hil.bringup.step import Step

POWER_S = 0.1
WAIT, WAIT_S = 6.0, 0.4
"""Silence ends after so many times the configured watchdog, and not before this."""
EARLY, LATE = 0.5, 1.5
"""A watchdog that takes less or more than so many times the configured one is wrong."""
ASKS = 3
"""So many ticks a drive is asked whether it is still powered: an answer may be late, or lost."""
SEEN_EARLY = 0.7
"""One that is watched is seen a period late, and takes less than EARLY if it is seen before this share."""
_POWERED = (DriveState.READY, DriveState.RUN)


def find(c: Context) -> None:
    """Power the drives, stop commanding them, and take the time until each is no longer powered."""
    protocol = c.drives.protocol
    if not _observable(c) or all(c.known("watchdog", leg) is not None for leg in range(LEGS)):
        return
    if protocol.force_on_brakes:
        _find_shut(c)
    elif protocol.command_delay_ticks or protocol.power_told == "heartbeat":
        _find_asked(c)
    else:
        _find_watched(c)


def _observable(c: Context) -> bool:
    return c.drives.protocol.power_told != "never"


def _find_shut(c: Context) -> None:
    """Power all drives on shut brakes, fall silent, and watch what they answer to SYNC."""
    drives, period = c.drives, 1.0 / c.drives.line.rate_Hz
    drives.prepare(None)
    for _ in range(drives.ticks(POWER_S)):
        drives.step(DriveMode.READY)
        powered = [_powered(c, leg) for leg in range(LEGS)]
        if all(powered):
            break
    silent: list[float | None] = [None] * LEGS
    try:
        for tick in range(1, drives.ticks(_wait_s(c)) + 1):
            drives.step(DriveMode.READY, silent=True)
            for leg in range(LEGS):
                if silent[leg] is None and not _powered(c, leg):
                    silent[leg] = tick * period
    finally:
        drives.off()
    for leg in range(LEGS):
        fact = {"powered": powered[leg], "until_s": silent[leg], "since_s": _before(silent[leg], period)}
        c.keep("watchdog", leg, fact)


def _powered(c: Context, leg: int) -> bool:
    return int(c.drives.record["drive_state"][leg]) in _POWERED


def _wait_s(c: Context) -> float:
    return max(WAIT * c.machine.watchdog_s, WAIT_S)


def _before(until_s: float | None, period: float) -> float | None:
    """Return the least time that it can have been: a command goes late in its tick."""
    return None if until_s is None else max(0.0, until_s - 2.0 * period)


def _find_watched(c: Context) -> None:
    """Enable each drive alone, fall silent, and watch what it answers to SYNC."""
    period = 1.0 / c.drives.line.rate_Hz
    for leg in range(LEGS):
        if c.known("watchdog", leg) is not None:
            continue
        until = None
        with c.opened(leg):
            powered = _powered(c, leg)
            for tick in range(1, c.drives.ticks(_wait_s(c)) + 1):
                c.drives.step(DriveMode.RUN, leg, silent=True)
                if not _powered(c, leg):
                    until = tick * period
                    break
        fact = {"powered": powered, "until_s": until, "since_s": _before(until, period)}
        c.keep("watchdog", leg, fact)


def _find_asked(c: Context) -> None:
    """Ask each drive alone before and after its time: commands feed the watchdog, and bring no power back.

    Where the heartbeat tells, commands go on until the next one.
    """
    rate, wait = c.drives.line.rate_Hz, c.machine.watchdog_s
    late_s = c.machine.heartbeat_s if c.drives.protocol.power_told == "heartbeat" else 0.0
    early = max(1, floor(EARLY * wait * rate) - 1)
    silences = early, ceil(LATE * wait * rate), c.drives.ticks(_wait_s(c))
    for leg in range(LEGS):
        if c.known("watchdog", leg) is not None:
            continue
        bounds: list[float | None] = [None, None]
        with c.opened(leg):
            powered = _powered(c, leg)
            for ticks in silences:
                for _ in range(ticks):
                    c.drives.step(DriveMode.RUN, leg, silent=True)
                for _ in range(ASKS + ceil(late_s * rate)):
                    c.drives.step(DriveMode.RUN, leg)
                gone = not _powered(c, leg)
                bounds[gone] = (ticks + 1) / rate
                if gone:
                    break
        c.keep("watchdog", leg, {"powered": powered, "until_s": bounds[1], "since_s": bounds[0]})


def judge(c: Context) -> list[Finding]:
    """Name drives whose watchdog is missing, too slow or too fast."""
    if not _observable(c):
        return []
    found = []
    wait, period = c.machine.watchdog_s, 1.0 / c.drives.line.rate_Hz
    protocol = c.drives.protocol
    asked = protocol.command_delay_ticks > 0 or protocol.power_told == "heartbeat"
    for leg in range(LEGS):
        fact = c.known("watchdog", leg)
        until = fact["until_s"]
        if not fact["powered"]:
            text = "the drive does not take power, or does not keep it"
            mend = "Look at the drive's fault, its enable, and a watchdog shorter than the one that was set."
            found.append(Finding("not_powered", (leg,), text, mend))
        elif until is None:
            if not protocol.has_watchdog:
                continue
            text = f"it is still powered after {1e3 * _wait_s(c):g} ms of silence, set were {1e3 * wait:g} ms"
            mend = "Switch its watchdog on: nothing stops this leg when the controller dies."
            found.append(Finding("watchdog_missing", (leg,), text, mend))
        elif until > LATE * wait + 3.0 * period:
            text = f"it reacts {1e3 * until:g} ms after the last command, set were {1e3 * wait:g} ms"
            found.append(Finding("watchdog_long", (leg,), text, "Set the drive's watchdog, or its unit."))
        elif until < SEEN_EARLY * wait or (asked and not fact["since_s"]):
            text = f"it reacts within {1e3 * until:g} ms of silence, set were {1e3 * wait:g} ms"
            found.append(Finding("watchdog_short", (leg,), text, "Set the drive's watchdog, or its unit."))
    return found


def gap(c: Context) -> Gap | None:
    """Say which drives have no watchdog that can be proven, if they are of a family without one."""
    if c.drives.protocol.has_watchdog:
        return None
    legs = [leg for leg in range(LEGS) if not _observable(c) or c.known("watchdog", leg)["until_s"] is None]
    if not legs:
        return None
    which = ", ".join(map(str, legs))
    shown = (
        f"those of legs {which} stay enabled in silence"
        if _observable(c)
        else "their answers do not tell whether they are enabled"
    )
    return Gap(
        f"they have no watchdog that is set from here, and {shown}",
        "When the program dies a drive keeps its last torque. See that something independent of program and "
        "bus cuts the drives' power and shuts the brakes, try it now, and keep it in reach",
    )


STEP = Step(
    "watchdog",
    "watchdogs, by silence",
    "powers the drives without force on shut brakes and falls silent; drives that know no such state are "
    "enabled one at a time, on trestles",
    "Ctrl-C, or the emergency stop",
    find,
    judge,
    gap=gap,
)
