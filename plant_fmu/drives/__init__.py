"""Six emulated drives in front of a plant: states, encoders, brakes, sensors, faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from drivers import row

if TYPE_CHECKING:
    from drivers.family import Family
    from plant_fmu.drives.ends import DrivesEnd


FAMILIES: dict[str, Callable[[Family], DrivesEnd]] = {
    "legs": row("plant_fmu.drives.legs", "LegsDrives"),
    "cia402": row("plant_fmu.drives.cia402", "Cia402Drives"),
    "mit": row("plant_fmu.drives.mit", "MitDrives"),
    "robstride": row("plant_fmu.drives.robstride", "RobStrideDrives"),
    "moteus": row("plant_fmu.drives.moteus", "MoteusDrives"),
    "odrive": row("plant_fmu.drives.odrive", "ODriveDrives"),
}
"""`Traits.family` -> the drives' end."""


def drives_end(protocol: Family) -> DrivesEnd:
    """Return the drives' end of a protocol, powered up: its own `drives_end()` if it has one."""
    own = getattr(protocol, "drives_end", None)
    return cast("DrivesEnd", own()) if own is not None else FAMILIES[protocol.traits.family](protocol)
