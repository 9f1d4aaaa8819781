"""When an emergency stop has reached all drives."""

from drivers.signals import DriveFault, DriveState
from drivers.tick_columns import Record


def confirmed(tick: Record) -> bool:
    """Tell whether all drives are in FAULT and report the emergency stop as their reason.

    A fault code of the drives' own is taken for it: what it means only their maker knows.
    """
    faults, states = tick["drive_fault"].tolist(), tick["drive_state"].tolist()
    told = all(fault == DriveFault.ESTOP or fault >= len(DriveFault) for fault in faults)
    return told and all(state == DriveState.FAULT for state in states)
