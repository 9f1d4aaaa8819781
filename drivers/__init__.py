"""Frames <-> SI: protocols, codecs and the bus. No control, no clock, no files."""

from __future__ import annotations

import time
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:  # the processes that only log need no sections
    from collections.abc import Callable

    from drivers.config import BusSettings, DriveSettings
    from drivers.family import Family

BEGAN_NS = time.time_ns()
"""When this process began to import this package, and so what uses it."""


def row(module: str, name: str) -> Callable[..., Any]:
    """Return a row that imports its family when it is used: processes that only log need no compiled code."""

    def made(*given: Any) -> Any:
        return getattr(import_module(module), name)(*given)

    return made


def _mit(bus: BusSettings, drives: DriveSettings) -> Family:
    is_robstride = drives.options.get("variant") == "robstride"
    of = ("robstride", "RobStrideProtocol") if is_robstride else ("protocol", "MitProtocol")
    return cast("Family", row(f"drivers.mit.{of[0]}", of[1])(bus, drives))


PROTOCOLS: dict[str, Callable[[BusSettings, DriveSettings], Family]] = {
    "legs": row("drivers.legs.protocol", "legs"),
    "cia402": row("drivers.cia402.protocol", "Cia402Protocol"),
    "mit": _mit,
    "moteus": row("drivers.moteus", "MoteusProtocol"),
    "odrive": row("drivers.odrive", "ODriveProtocol"),
}
"""`drives.protocol` -> the codec made from the sections `bus` and `drives`.

A row checks `bus.layout` and, of `drives`, `node_ids`, `options` and `transmission`; its ConfigurationError
begins with the key.
"""


def build_protocol(bus: BusSettings, drives: DriveSettings) -> Family:
    """Return the codec of `drives.protocol`, its drives on one bus or several.

    Raises ConfigurationError for settings that the protocol does not have.
    """
    return PROTOCOLS[drives.protocol](bus, drives)
