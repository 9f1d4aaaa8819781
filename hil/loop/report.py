"""What a run reports of its cycle: latched faults and the legs that show them, drives that are not ready."""

from drivers.signals import LEGS, NEVER, DriveFault, DriveState, Fault, Foreign
from hil.loop.cycle import Cycle
from hil.loop.parts import Parts
from hil.safety.frames import OFTEN
from hil.safety.history import HISTORY
from hil.safety.standstill import REST_m_s


def fault_text(cycle: Cycle) -> str:
    """Say which faults are latched, and which drives show them."""
    last = cycle.tick
    names = ", ".join(str(fault.name) for fault in cycle.faults)
    legs: list[str] = []
    if cycle.faults & Fault.STALE:
        legs += _silent(last["age"].tolist(), cycle.parts)
    if cycle.faults & Fault.FOLLOWING:
        legs += _lagging(cycle)
    if cycle.faults & Fault.BRAKE:
        legs += _moved(cycle)
    if cycle.faults & Fault.ENCODER:
        slipped = cycle.parts.fusion.slipped if cycle.parts.fusion else ()
        legs += [f"the encoder of leg {leg} contradicts the pose of the others" for leg in slipped]
    legs += _heard(cycle)
    if cycle.faults & Fault.DRIVE:
        for leg, (state, fault) in enumerate(zip(last["drive_state"], last["drive_fault"], strict=True)):
            if state in (DriveState.FAULT, DriveState.BOOT):
                legs.append(f"drive {leg} in {DriveState(state).name}{_because(fault)}")
    return f"latched fault {names}" + (f" ({'; '.join(legs)})" if legs else "")


def _lagging(cycle: Cycle) -> list[str]:
    """Say which leg is farthest from its reference."""
    last = cycle.tick
    errors = [abs(q_d - q) for q_d, q in zip(last["q_d"].tolist(), last["q"].tolist(), strict=True)]
    worst = max(errors)
    return [f"leg {errors.index(worst)} is {1e3 * worst:.1f} mm from its reference"]


def _moved(cycle: Cycle) -> list[str]:
    """Say which legs have moved on their closed brakes, and by how much."""
    safety = cycle.parts.safety
    limit, moved = safety.limits["standstill_m"], safety.moved_m(cycle.tick)
    return [
        f"leg {leg} moved {1e3 * m:.2f} mm on its closed brake, limits.standstill_m is {1e3 * limit:g} mm"
        for leg, m in enumerate(moved.tolist())
        if m > limit
    ]


def moving_text(cycle: Cycle) -> str:
    """Say which legs are not at rest."""
    rates, ages = cycle.tick["rate"].tolist(), cycle.tick["age"].tolist()
    legs = [
        f"leg {leg} at {rate:+.3f} m/s"
        for leg, (rate, age) in enumerate(zip(rates, ages, strict=True))
        if age == 0 and abs(rate) >= REST_m_s
    ]
    return "; ".join(legs)


def _heard(cycle: Cycle) -> list[str]:
    """Say what the frames of this tick show of the faults that the bus is the place of."""
    last, faults = cycle.tick, cycle.faults
    found: list[str] = []
    if faults & Fault.SECOND_CONTROLLER:
        kinds = ", ".join(str(kind.name) for kind in Foreign(int(last["foreign"])))
        found.append(f"another controller is on the bus, heard: {kinds}; one bus has one controller")
    if faults & Fault.DUPLICATE_NODE:
        legs = _legs_of(int(last["doubled"]))
        found.append(f"two different answers to one SYNC from the node of leg {legs}: one number a node")
    if faults & Fault.SET_UP:
        found.append(f"drive {_legs_of(int(last['altered']))} reports another set-up than the one sent to it")
    if faults & Fault.REFUSED_FRAMES:
        share = f"{OFTEN} of the last {HISTORY} ticks"
        found.append(f"frames of the drives were refused in {share}: check wiring, termination, bit rates")
    return found


def _legs_of(bits: int) -> str:
    return ", ".join(str(leg) for leg in range(LEGS) if bits >> leg & 1)


def _silent(ages: list[int], parts: Parts) -> list[str]:
    """Say which legs have not been heard for how many ticks, and where to look if it is all of them."""
    limit = parts.safety.limits["stale_fault_ticks"]
    if min(ages) < limit:
        return [f"leg {leg} not heard for {age} ticks" for leg, age in enumerate(ages) if age >= limit]
    stall_ms = 1e3 * min(ages) / parts.rate_Hz
    why = f"the drives, the bus or this machine stalled for {stall_ms:.0f} ms"
    mend = "if it was this machine, lower loop.rate_Hz and lengthen drives.watchdog_ms"
    return [f"no leg heard for {min(ages)} ticks: {why}; {mend}"]


def waiting_text(cycle: Cycle) -> str:
    """Say what the drives still lack to be engaged."""
    last = cycle.tick
    lacking = []
    set_up = cycle.parts.protocol.legs_set_up(cycle.dialogue)
    for leg in range(LEGS):
        state = DriveState(int(last["drive_state"][leg]))
        if last["age"][leg] >= NEVER:
            lacking.append(f"drive {leg} never answered")
        elif last["age"][leg] > 1:
            lacking.append(f"drive {leg} is silent")
        elif state is not DriveState.OFF:
            lacking.append(f"drive {leg} stays in {state.name}{_because(last['drive_fault'][leg])}")
        elif not set_up[leg]:
            lacking.append(f"drive {leg} does not complete its set-up{_because(last['drive_fault'][leg])}")
    if not lacking:
        lengths = ", ".join(f"{q:.4f}" for q in last["length"])
        lacking.append(f"no pose near platform.home has the measured leg lengths {lengths} m")
    latched = (last["drive_state"] == DriveState.FAULT).any()
    mend = "; find out why, then start with --reset to clear latched faults" if latched else ""
    return f"the drives are not ready: {'; '.join(lacking)}{mend}"


def _because(fault: int) -> str:
    """Return a drive's reason in brackets; its number where the drive says something of its own."""
    known = {int(f): f.name for f in DriveFault}
    return f" ({known.get(int(fault), int(fault))})" if fault else ""
