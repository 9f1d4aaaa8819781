"""Frames <-> SI: protocols, codecs and the bus. No control, no clock, no files."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, cast

from drivers.errors import ConfigurationError

if TYPE_CHECKING:  # the processes that only log need no sections
    from collections.abc import Callable

    from drivers.config import BusSettings, DriveSettings
    from drivers.protocol import DriveProtocol


def _legs(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    if drives.options:
        raise ConfigurationError(
            f"drives.options: protocol legs has none, given: {', '.join(drives.options)}"
        )
    if drives.transmission is not None:
        raise ConfigurationError(
            "drives.transmission: protocol legs speaks of leg lengths and forces and has none; leave it out"
        )
    return _our_own(bus.layout, tuple(drives.node_ids), drives.force_limit_N, bus.legs)


@cache
def _our_own(
    layout: str, node_ids: tuple[int, ...], force_limit_N: float, legs: tuple[tuple[int, ...], ...]
) -> DriveProtocol:
    """Return the codec of these drives: one is as good as another."""
    from drivers.legs.protocol import LegsProtocol  # noqa: PLC0415 - compiled code: not for the processes that only log

    return cast("DriveProtocol", LegsProtocol(layout, node_ids, force_limit_N, legs))


def _cia402(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    from drivers.cia402.protocol import cia402  # noqa: PLC0415 - as above

    return cast("DriveProtocol", cia402(bus, drives))


def _mit(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    from drivers.mit.row import mit  # noqa: PLC0415 - as above

    return mit(bus, drives)


def _odrive(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    from drivers.odrive import odrive  # noqa: PLC0415 - as above

    return odrive(bus, drives)


def _moteus(bus: BusSettings, drives: DriveSettings) -> DriveProtocol:
    from drivers.moteus import moteus  # noqa: PLC0415 - as above

    return moteus(bus, drives)


PROTOCOLS: dict[str, Callable[[BusSettings, DriveSettings], DriveProtocol]] = {
    "legs": _legs,
    "cia402": _cia402,
    "mit": _mit,
    "moteus": _moteus,
    "odrive": _odrive,
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
