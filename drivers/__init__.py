"""Conversion between CAN frames and SI values: drive protocols, codecs and the bus. No control laws here."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:  # processes that only log need no sections
    from drivers.config import BusSettings, DriveSettings
    from drivers.family import Family

BEGAN_NS = time.time_ns()
"""Unix time, ns, at which this process began to import this package."""


def build_protocol(bus: BusSettings, drives: DriveSettings) -> Family:
    """Protocol codec for the key `drives.protocol`, found by the entry-point group `hil.protocols`.

    The codec checks `bus.layout` and, of `drives`, `node_ids`, `options` and `transmission`. Raises
    ConfigurationError for settings that the protocol does not support; the message begins with the YAML key.
    """
    from drivers.registry import loaded  # noqa: PLC0415 - see above

    return cast("Family", loaded("hil.protocols", drives.protocol)(bus, drives))
