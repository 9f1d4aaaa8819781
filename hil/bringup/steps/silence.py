"""Each drive's own watchdog, proven by silence before any brake opens."""

from drivers.signals import LEGS, DriveMode, DriveState
from hil.bringup.context import Context, Finding
from hil.bringup.step import Step

POWER_S = 0.1
WAIT, WAIT_S = 6.0, 0.4
"""Silence ends after so many times the configured watchdog, and not before this."""
EARLY, LATE = 0.5, 1.5
"""A watchdog that takes less or more than so many times the configured one is wrong."""
_POWERED = (DriveState.READY, DriveState.RUN)


def find(c: Context) -> None:
    """Power the drives, stop commanding them, and take the time until each is no longer powered."""
    if all(c.known("watchdog", leg) is not None for leg in range(LEGS)):
        return
    if c.drives.protocol.command_delay_ticks:
        _find_polled(c)
    else:
        _find_synced(c)


def _find_synced(c: Context) -> None:
    drives, period = c.drives, 1.0 / c.drives.line.rate_Hz
    drives.prepare(None)
    for _ in range(drives.ticks(POWER_S)):
        drives.step(DriveMode.READY)
        powered = [int(s) in _POWERED for s in drives.record["drive_state"]]
        if all(powered):
            break
    silent: list[float | None] = [None] * LEGS
    try:
        for tick in range(1, drives.ticks(_wait_s(c)) + 1):
            record = drives.step(DriveMode.READY, silent=True)
            for leg in range(LEGS):
                if silent[leg] is None and int(record["drive_state"][leg]) not in _POWERED:
                    silent[leg] = tick * period
    finally:
        drives.off()
    for leg in range(LEGS):
        fact = {"powered": powered[leg], "until_s": silent[leg], "since_s": _before(silent[leg], period)}
        c.keep("watchdog", leg, fact)


def _wait_s(c: Context) -> float:
    return max(WAIT * c.machine.watchdog_s, WAIT_S)


def _before(until_s: float | None, period: float) -> float | None:
    """Return the least time that it can have been: a command goes late in its tick."""
    return None if until_s is None else max(0.0, until_s - 2.0 * period)


def _find_polled(c: Context) -> None:
    """Ask each drive alone once before and once after its time: polls feed the watchdog, and tell of it.

    These drives have no state between off and enabled, so the brake of a leg on its trestle opens meanwhile.
    """
    wait = c.machine.watchdog_s
    for leg in range(LEGS):
        if c.known("watchdog", leg) is not None:
            continue
        bounds: list[float | None] = [None, None]
        with c.opened(leg):
            powered = int(c.drives.record["drive_state"][leg]) in _POWERED
            for n, silence in enumerate((EARLY * wait, LATE * wait, _wait_s(c))):
                ticks = c.drives.ticks(silence) + n
                for _ in range(ticks):
                    c.drives.step(DriveMode.RUN, leg, silent=True)
                c.drives.step(DriveMode.RUN, leg)
                gone = int(c.drives.record["drive_state"][leg]) not in _POWERED
                seconds = (ticks + 1) / c.drives.line.rate_Hz
                if gone:
                    bounds[1] = seconds
                    break
                bounds[0] = seconds
        c.keep("watchdog", leg, {"powered": powered, "until_s": bounds[1], "since_s": bounds[0]})


def judge(c: Context) -> list[Finding]:
    """Name drives whose watchdog is missing, too slow or too fast."""
    found = []
    wait, period = c.machine.watchdog_s, 1.0 / c.drives.line.rate_Hz
    polled = c.drives.protocol.command_delay_ticks > 0
    for leg in range(LEGS):
        fact = c.known("watchdog", leg)
        until = fact["until_s"]
        if not fact["powered"]:
            text = "the drive does not take power, or does not keep it"
            mend = "Look at the drive's fault, its enable, and a watchdog shorter than the one that was set."
            found.append(Finding("not_powered", (leg,), text, mend))
        elif until is None:
            text = f"it is still powered after {1e3 * _wait_s(c):g} ms of silence, set were {1e3 * wait:g} ms"
            mend = "Switch its watchdog on: nothing stops this leg when the controller dies."
            found.append(Finding("watchdog_missing", (leg,), text, mend))
        elif until > LATE * wait + 3.0 * period:
            text = f"it reacts {1e3 * until:g} ms after the last command, set were {1e3 * wait:g} ms"
            found.append(Finding("watchdog_long", (leg,), text, "Set the drive's watchdog, or its unit."))
        elif until < EARLY * wait or (polled and not fact["since_s"]):
            text = f"it reacts within {1e3 * until:g} ms of silence, set were {1e3 * wait:g} ms"
            found.append(Finding("watchdog_short", (leg,), text, "Set the drive's watchdog, or its unit."))
    return found


STEP = Step(
    "watchdog",
    "watchdogs, by silence",
    "powers the drives without force on shut brakes and falls silent; drives that know no such state are "
    "enabled one at a time, on trestles",
    "Ctrl-C, or the emergency stop",
    find,
    judge,
)
