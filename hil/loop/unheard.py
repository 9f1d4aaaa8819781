"""What drives do by themselves that hear no command any more, in words: their watchdog, or nothing."""

from drivers.protocol import DriveSetup
from hil.loop.parts import Parts

KEPT = "they keep the last torque; cut their power now"
NO_WATCHDOG = f"have no watchdog that is set from here: {KEPT}"
"""Of families whose `has_watchdog` is False."""
_NOT_TOLD = "the drives could not be told to switch off, since the bus takes no frames: "


def not_told(parts: Parts, reaction: str = "") -> str:
    """Return what becomes of drives whose bus takes no frames; `reaction` where it is known."""
    if not parts.protocol.has_watchdog:
        return f"{_NOT_TOLD}they {NO_WATCHDOG}"
    return f"{_NOT_TOLD}the watchdog of each acts {_acts(parts.setup, reaction)}"


def not_confirmed(parts: Parts, reaction: str) -> str:
    """Return what becomes of a drive that may have heard nothing."""
    if not parts.protocol.has_watchdog:
        return f"those that hear nothing {NO_WATCHDOG}"
    return f"the watchdog of one that hears nothing acts {_acts(parts.setup, reaction)}"


def _acts(setup: DriveSetup, reaction: str) -> str:
    after = f"{1e3 * setup.watchdog_s:g} ms after the last command it heard"
    return f"{after}, with reaction `{reaction}`" if reaction else after
