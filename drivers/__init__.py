"""CAN frames <-> SI values: protocols, codecs and the bus. No control."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:  # processes that only log need no sections
    from drivers.config import BusSettings, DriveSettings
    from drivers.family import Family

BEGAN_NS = time.time_ns()
"""Unix time, ns, at which this process began to import this package."""


def build_protocol(bus: BusSettings, drives: DriveSettings) -> Family:
    """Codec of `drives.protocol`, its drives on one bus or several: an entry point of `hil.protocols`.

    It checks `bus.layout` and, of `drives`, `node_ids`, `options` and `transmission`. Raises
    ConfigurationError for settings that the protocol does not have; the message begins with the key.
    """
    from drivers.registry import loaded  # noqa: PLC0415 - see above

    return cast("Family", loaded("hil.protocols", drives.protocol)(bus, drives))
