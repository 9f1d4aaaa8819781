"""What the six drives say of themselves in a tick, and how a run reports it in words.

`cycle` is a `hil.loop.cycle.Cycle`, which imports this module.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from drivers.protocol import DriveSetup
from drivers.signals import LEGS, NEVER, DriveFault, DriveState, Mode
from drivers.tick_columns import Record
from hil.loop.parts import Parts
from hil.safety.motion import REST_m_s

_POWERED = (DriveState.READY, DriveState.RUN)


def any_powered(tick: Record) -> bool:
    """Tell whether a drive is powered."""
    return any(state in _POWERED for state in tick["drive_state"].tolist())


def unconfirmed(tick: Record, latches: bool) -> tuple[int, ...]:
    """Return the legs whose drive is not in FAULT or does not report the emergency stop as its reason.

    A fault code of the drives' own is taken for it: what it means only their maker knows. Of drives that do
    not latch a stop, those that are still powered.
    """
    if not latches:
        return tuple(leg for leg, state in enumerate(tick["drive_state"].tolist()) if state == DriveState.RUN)
    faults, states = tick["drive_fault"].tolist(), tick["drive_state"].tolist()
    return tuple(
        leg
        for leg, (fault, state) in enumerate(zip(faults, states, strict=True))
        if state != DriveState.FAULT or not (fault == DriveFault.ESTOP or fault >= len(DriveFault))
    )


def confirmed(tick: Record, latches: bool) -> bool:
    """Tell whether all drives are in FAULT and report the emergency stop as their reason; or are off."""
    return not unconfirmed(tick, latches)


def ready(tick: Record, mode: Mode, set_up: Iterable[bool], *, located: bool) -> bool:
    """Tell whether the drives are as an arming needs them: heard and the pose found, and all six set up.

    Once they were, in IDLE, they stay so until one is to be set up again; one that was altered is a fault.
    """
    if mode is Mode.IDLE:
        return all(set_up) or bool(tick["altered"])
    return located and max(tick["age"].tolist()) <= 1 and all(set_up)


def measured_at_rest(tick: Record) -> bool:
    """Tell whether all six legs are heard in this tick, believed and at rest."""
    measured = max(tick["age"].tolist()) == 0 and not tick["legs_slipped"]
    return bool(measured and max(abs(tick["rate"]).tolist()) < REST_m_s)


def because(fault: int, meaning: str = "") -> str:
    """Return a drive's reason in brackets; its number where the drive says something of its own.

    meaning: what that number means, as the protocol says.
    """
    known = {int(f): f.name for f in DriveFault}
    own = f"{int(fault)}: {meaning}" if meaning else str(int(fault))
    return f" ({known.get(int(fault), own)})" if fault else ""


def moving_text(cycle: Any) -> str:
    """Say which legs are not at rest."""
    rates, ages = cycle.tick["rate"].tolist(), cycle.tick["age"].tolist()
    legs = [
        f"leg {leg} at {rate:+.3f} m/s"
        for leg, (rate, age) in enumerate(zip(rates, ages, strict=True))
        if age == 0 and abs(rate) >= REST_m_s
    ]
    return "; ".join(legs)


def waiting_text(cycle: Any) -> str:
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


def _unlocated(cycle: Any) -> str:
    """Say why no pose has been found though all drives answer."""
    last, sight = cycle.tick, cycle.sight
    if sight.located:
        return "nothing is lacking by now, but it was until after the end; give the run more time"
    if sight.sought:
        lengths = ", ".join(f"{q:.4f}" for q in last["length"])
        return f"no pose near platform.home has the measured leg lengths {lengths} m"
    late = ", ".join(f"drive {leg}" for leg in last["age"].nonzero()[0].tolist())
    if not late and not sight.due:
        return "the pose is being looked for"
    return (
        "not all six drives have answered within one tick, as the first pose needs it"
        f"{f' (late in the last one: {late})' if late else ''}: look at the load of this machine and of the "
        "bus, loop.feedback_window_us, or take a lower loop.rate_Hz"
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
