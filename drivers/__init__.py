"""Frames <-> SI: protocols, codecs and the bus. No control, no clock, no files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:  # the processes that only log need no sections
    from collections.abc import Callable

    from drivers.config import BusSettings, DriveSettings
    from drivers.protocol import DriveProtocol


def _row(module: str, name: str) -> Callable[[BusSettings, DriveSettings], DriveProtocol]:
    """Return a row that imports its family when it is used: processes that only log need no compiled code."""

    def made(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
        return cast("DriveProtocol", getattr(import_module(f"drivers.{module}"), name)(bus, drives))

    return made


def _mit(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    is_robstride = drives.options.get("variant") == "robstride"
    of = ("mit.robstride", "RobStrideProtocol") if is_robstride else ("mit.protocol", "MitProtocol")
    return _row(*of)(bus, drives)


PROTOCOLS: dict[str, Callable[[BusSettings, DriveSettings], DriveProtocol]] = {
    "legs": _row("legs.protocol", "legs"),
    "cia402": _row("cia402.protocol", "Cia402Protocol"),
    "mit": _mit,
    "moteus": _row("moteus", "MoteusProtocol"),
    "odrive": _row("odrive", "ODriveProtocol"),
}
"""`drives.protocol` -> the codec made from the sections `bus` and `drives`.

A row checks `bus.layout` and, of `drives`, `node_ids`, `options` and `transmission`; its ConfigurationError
begins with the key.
"""


def build_protocol(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    """Return the codec of `drives.protocol`, its drives on one bus or several.

    Raises ConfigurationError for settings that the protocol does not have.
    """
    return PROTOCOLS[drives.protocol](bus, drives)
