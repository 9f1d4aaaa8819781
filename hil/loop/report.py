"""State reports of the six drives in a tick, and their text for the messages of a run.

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
    """True if a drive reports READY or RUN."""
    return any(state in _POWERED for state in tick["drive_state"].tolist())


def unconfirmed(tick: Record, latches: bool) -> tuple[int, ...]:
    """Legs whose drive has not confirmed the emergency stop: it is not in FAULT, or for another reason.

    A fault code of the manufacturer counts as a confirmation, as its meaning is unknown here. If a stop does
    not put the drives into FAULT (`latches` False): the legs whose drive is in RUN.
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
    """True if all drives have confirmed the emergency stop; latches: a stop puts them into FAULT."""
    return not unconfirmed(tick, latches)


def ready(tick: Record, mode: Mode, set_up: Iterable[bool], *, located: bool) -> bool:
    """True if the drives are ready for arming: all report, the pose is found, and all six are set up.

    In IDLE only the set-up can end this. A drive with an altered set-up stays ready here, as it is a fault.
    """
    if mode is Mode.IDLE:
        return all(set_up) or bool(tick["altered"])
    return located and max(tick["age"].tolist()) <= 1 and all(set_up)


def measured_at_rest(tick: Record) -> bool:
    """True if all six legs report valid readings in this tick and are at rest."""
    measured = max(tick["age"].tolist()) == 0 and not tick["legs_slipped"]
    return bool(measured and max(abs(tick["rate"]).tolist()) < REST_m_s)


def because(fault: int, meaning: str = "") -> str:
    """Reason of a drive's fault in brackets, as text; a number if it is a manufacturer's code.

    meaning: of that number, as the protocol gives it.
    """
    known = {int(f): f.name for f in DriveFault}
    own = f"{int(fault)}: {meaning}" if meaning else str(int(fault))
    return f" ({known.get(int(fault), own)})" if fault else ""


def moving_text(cycle: Any) -> str:
    """List of the legs that are not at rest, as text; empty if none moves."""
    rates, ages = cycle.tick["rate"].tolist(), cycle.tick["age"].tolist()
    legs = [
        f"leg {leg} at {rate:+.3f} m/s"
        for leg, (rate, age) in enumerate(zip(rates, ages, strict=True))
        if age == 0 and abs(rate) >= REST_m_s
    ]
    return "; ".join(legs)


def waiting_text(cycle: Any) -> str:
    """Reasons why the drives are not ready, as text."""
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
    advice = "; find out why, then start with --reset to clear latched faults" if latched else ""
    return f"the drives are not ready: {'; '.join(lacking)}{advice}"


def _unlocated(cycle: Any) -> str:
    """Reason why no pose has been found although all drives answer."""
    last, sight = cycle.tick, cycle.sight
    if sight.located:
        return "they became ready only after the end of the run; lengthen the run"
    if sight.sought:
        lengths = ", ".join(f"{q:.4f}" for q in last["length"])
        return f"no pose near platform.home has the measured leg lengths {lengths} m"
    late = ", ".join(f"drive {leg}" for leg in last["age"].nonzero()[0].tolist())
    if not late and not sight.due:
        return "the search for the pose is still running"
    return (
        "the first pose needs answers of all six drives within one tick"
        f"{f' (late in the last tick: {late})' if late else ''}: check the load of this machine and of the "
        "bus and loop.feedback_window_us, or lower loop.rate_Hz"
    )


KEPT = "they keep the last torque; cut their power now"
NO_WATCHDOG = f"have no watchdog that this program sets: {KEPT}"
"""For families whose `has_watchdog` is False."""
_NOT_SENT = "the command to switch off could not be sent to the drives, as the bus takes no frames: "


def off_not_sent(parts: Parts, reaction: str = "") -> str:
    """Text: what drives do whose bus takes no frames; `reaction`: of their watchdog, if known."""
    if not parts.protocol.traits.has_watchdog:
        return f"{_NOT_SENT}they {NO_WATCHDOG}"
    return f"{_NOT_SENT}the watchdog of each acts {_acts(parts.setup, reaction)}"


def not_confirmed(parts: Parts, reaction: str) -> str:
    """Text: what a drive does that may have received no command; `reaction`: of its watchdog."""
    if not parts.protocol.traits.has_watchdog:
        return f"drives that receive nothing {NO_WATCHDOG}"
    return f"the watchdog of a drive that receives nothing acts {_acts(parts.setup, reaction)}"


def _acts(setup: DriveSetup, reaction: str) -> str:
    after = f"{1e3 * setup.watchdog_s:g} ms after the last command that it received"
    return f"{after}, with reaction `{reaction}`" if reaction else after
