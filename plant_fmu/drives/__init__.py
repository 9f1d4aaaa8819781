"""Six emulated drives in front of a plant: states, encoders, brakes, sensors, faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from drivers.registry import loaded

if TYPE_CHECKING:
    from drivers.family import Family
    from plant_fmu.drives.codec import DrivesEnd


def drives_end(protocol: Family) -> DrivesEnd:
    """Emulated drives' end of a protocol, powered up, from the protocol or its family's entry point."""
    own = getattr(protocol, "drives_end", None)
    if own is None:
        return cast("DrivesEnd", loaded("hil.emulated_drives", protocol.traits.family)(protocol))
    return cast("DrivesEnd", own())
