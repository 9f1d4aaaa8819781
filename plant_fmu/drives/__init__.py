"""Six emulated drives in front of a plant: states, encoders, brakes, sensors, faults."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from drivers.protocol import DriveProtocol
    from plant_fmu.drives.ends import DrivesEnd


def _row(module: str, name: str) -> Callable[[DriveProtocol], DrivesEnd]:
    """Return a row that imports its family when it is used."""

    def made(protocol: DriveProtocol) -> DrivesEnd:
        return cast("DrivesEnd", getattr(import_module(f"plant_fmu.drives.{module}"), name)(protocol))

    return made


FAMILIES: dict[str, Callable[[DriveProtocol], DrivesEnd]] = {
    "legs": _row("legs", "LegsDrives"),
    "cia402": _row("cia402", "Cia402Drives"),
    "mit": _row("mit", "MitDrives"),
    "robstride": _row("robstride", "RobStrideDrives"),
    "moteus": _row("moteus", "MoteusDrives"),
    "odrive": _row("odrive", "ODriveDrives"),
}
"""`Traits.family` -> the drives' end."""


def drives_end(protocol: DriveProtocol) -> DrivesEnd:
    """Return the drives' end of a protocol, powered up: its own `drives_end()` if it has one."""
    own = getattr(protocol, "drives_end", None)
    return cast("DrivesEnd", own()) if own is not None else FAMILIES[protocol.traits.family](protocol)
