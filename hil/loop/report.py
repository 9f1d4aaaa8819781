"""What a run reports of its cycle: legs that move, drives that are not ready, or that hear nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.protocol import DriveSetup
from drivers.signals import LEGS, NEVER, DriveFault, DriveState
from hil.loop.parts import Parts
from hil.safety.motion import REST_m_s

if TYPE_CHECKING:
    from hil.loop.cycle import Cycle


def because(fault: int, meaning: str = "") -> str:
    """Return a drive's reason in brackets; its number where the drive says something of its own.

    meaning: what that number means, as the protocol says.
    """
    known = {int(f): f.name for f in DriveFault}
    own = f"{int(fault)}: {meaning}" if meaning else str(int(fault))
    return f" ({known.get(int(fault), own)})" if fault else ""


def moving_text(cycle: Cycle) -> str:
    """Say which legs are not at rest."""
    rates, ages = cycle.tick["rate"].tolist(), cycle.tick["age"].tolist()
    legs = [
        f"leg {leg} at {rate:+.3f} m/s"
        for leg, (rate, age) in enumerate(zip(rates, ages, strict=True))
        if age == 0 and abs(rate) >= REST_m_s
    ]
    return "; ".join(legs)


def waiting_text(cycle: Cycle) -> str:
    """Say what the drives still lack to be engaged."""
    last = cycle.tick
    lacking = []
    protocol = cycle.parts.protocol
    lacks = cycle.end.lacks()
    for leg in range(LEGS):
        state, fault = DriveState(int(last["drive_state"][leg])), int(last["drive_fault"][leg])
        why = because(fault, protocol.fault_text(fault))
        if last["age"][leg] >= NEVER:
            lacking.append(f"drive {leg} never answered")
        elif last["age"][leg] > 1:
            lacking.append(f"drive {leg} is silent")
        elif state is not DriveState.OFF:
            lacking.append(f"drive {leg} stays in {state.name}{why}")
        elif lacks[leg]:
            lacking.append(f"drive {leg} does not complete its set-up{why}: {lacks[leg]}")
    if cycle.homing.refusal:
        lacking.append(cycle.homing.refusal)
    if not lacking:
        lacking.append(_unlocated(cycle))
    latched = (last["drive_state"] == DriveState.FAULT).any()
    mend = "; find out why, then start with --reset to clear latched faults" if latched else ""
    return f"the drives are not ready: {'; '.join(lacking)}{mend}"


def _unlocated(cycle: Cycle) -> str:
    """Say why no pose has been found though all drives answer."""
    last, sight = cycle.tick, cycle.sight
    if sight.located:
        return "nothing is lacking by now, but it was until after the end; give the run more time"
    if sight.sought:
        lengths = ", ".join(f"{q:.4f}" for q in last["length"])
        return f"no pose near platform.home has the measured leg lengths {lengths} m"
    number, late = int(last["tick"]), []
    for leg, tick in enumerate(sight.in_time):
        if tick is None:
            late.append(f"drive {leg} in none yet")
        elif tick < number:
            late.append(f"drive {leg} {(number - tick) * cycle.period_s:.3g} s ago the last time")
    if not late:
        return "the pose is being looked for"
    return (
        "not all six drives have answered within one tick, as the first pose needs it: "
        f"{', '.join(late)}; their answers come late: look at the load of this machine and of the bus, "
        "loop.feedback_window_us, or take a lower loop.rate_Hz"
    )


KEPT = "they keep the last torque; cut their power now"
NO_WATCHDOG = f"have no watchdog that is set from here: {KEPT}"
"""Of families whose `has_watchdog` is False."""
_NOT_TOLD = "the drives could not be told to switch off, since the bus takes no frames: "


def not_told(parts: Parts, reaction: str = "") -> str:
    """Return what becomes of drives whose bus takes no frames; `reaction` where it is known."""
    if not parts.protocol.traits.has_watchdog:
        return f"{_NOT_TOLD}they {NO_WATCHDOG}"
    return f"{_NOT_TOLD}the watchdog of each acts {_acts(parts.setup, reaction)}"


def not_confirmed(parts: Parts, reaction: str) -> str:
    """Return what becomes of a drive that may have heard nothing."""
    if not parts.protocol.traits.has_watchdog:
        return f"those that hear nothing {NO_WATCHDOG}"
    return f"the watchdog of one that hears nothing acts {_acts(parts.setup, reaction)}"


def _acts(setup: DriveSetup, reaction: str) -> str:
    after = f"{1e3 * setup.watchdog_s:g} ms after the last command it heard"
    return f"{after}, with reaction `{reaction}`" if reaction else after
