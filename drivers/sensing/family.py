"""A sensor family: a section of the configuration that gives the messages of a device as data.

An entry point of the group `hil.sensors` is a subclass of `SensorFamily`. The codec at the controller's end
and the emulated device are the same for all families: they read the messages (`Device`).
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field as Key

from drivers.protocol import Frame
from drivers.section import Section
from drivers.sensing.layout import FREE, SELECTS, SIGNED, SKIPS, SYNCED

CHANNELS: dict[str, tuple[str, ...]] = {
    "tracker": ("x", "y", "z", "rx", "ry", "rz"),
    "imu": ("wx", "wy", "wz", "fx", "fy", "fz"),
    "wrench": ("fx", "fy", "fz", "mx", "my", "mz"),
    "inclination": ("roll", "pitch"),
    "lengths": tuple(f"leg_{leg}" for leg in range(6)),
    "forces": tuple(f"leg_{leg}" for leg in range(6)),
}
"""Role of a sensor in section `sensors` -> names of its quantities, in the order of their slot."""
UNITS = {
    "tracker": ("m",) * 3 + ("rad",) * 3,
    "imu": ("rad/s",) * 3 + ("m/s^2",) * 3,
    "wrench": ("N",) * 3 + ("N m",) * 3,
    "inclination": ("rad",) * 2,
    "lengths": ("m",) * 6,
    "forces": ("N",) * 6,
}
"""Role -> SI units of its quantities."""
SYNC_ID = 0x080
"""Identifier of CANopen's SYNC, and of that of sensors.dbc."""


class Field(NamedTuple):
    """One field of a message: value = raw * scale + offset."""

    to: int
    """Index of the quantity, or one of OFFSET, CYCLE, COUNTER, VALIDITY, QUALITY."""
    start: int
    """Number of its lowest bit; with `big` of its highest one, both as in a DBC."""
    bits: int
    scale: float = 1.0
    offset: float = 0.0
    kind: int = SIGNED
    """UNSIGNED, SIGNED, or FLOAT of 32 or 64 bits."""
    big: bool = False
    """True if its bytes begin with the highest one (Motorola)."""
    low: float | None = None
    """Smallest valid value; None: that of the bits."""
    high: float | None = None


class Condition(NamedTuple):
    """Bits that a message must have."""

    start: int
    bits: int
    equals: int
    mask: int = -1
    """Bits that count."""
    big: bool = False
    selects: bool = False
    """True if a frame with other bits is another message; False if its sample is invalid."""
    skips: bool = False
    """True if a frame with these bits is another message."""


def fill_field(row: Any, k: int, field: Field) -> None:
    """Fill in field `k` of an element of ROW."""
    for name in ("start", "bits", "big", "kind", "to", "scale", "offset", "low", "high"):
        row[name][k] = getattr(field, name)


def fill_condition(row: Any, k: int, one: Condition) -> None:
    """Fill in condition `k` of an element of ROW."""
    selects = SKIPS if one.skips else SELECTS * one.selects
    given = one.start, one.bits, one.big, one.mask, one.equals, selects
    for name, value in zip(("at", "wide", "from_top", "mask", "equals", "selects"), given, strict=True):
        row[name][k] = value


class Message(NamedTuple):
    """One frame of a device, with fields of one measurement."""

    id: int
    length: int
    fields: tuple[Field, ...]
    flags: int = 0
    conditions: tuple[Condition, ...] = ()
    exact: bool = False
    """True if a longer frame is refused."""
    checked: bool = False
    """True if it ends in the CRC-8 of sensors.dbc."""

    @property
    def key(self) -> tuple[int, ...]:
        """What makes it one frame on its bus: identifier, flags, and its multiplexers' values."""
        return (self.id, self.flags, *(each.equals for each in self.conditions if each.selects))


class Device(NamedTuple):
    """Messages and time of one measurement of a device."""

    messages: tuple[Message, ...]
    timing: int
    """STAMPED, SYNCED or FREE."""
    latency_s: float = 0.0
    """From the instant of a sample to its frame; with SYNCED from that instant to SYNC."""
    poll: Frame | None = None
    """Frame that the controller sends for each sample."""
    start: tuple[Frame, ...] = ()
    """Frames that start the device, in order; without them it sends no sample."""
    changes: bool = False
    """True if it sends a sample only if its frame changes."""
    mix: tuple[tuple[float, ...], ...] | None = None
    """Matrix from fields to quantities."""
    database: str | None = None
    """Text of a DBC with these messages."""


class Wanted(NamedTuple):
    """One measurement of a sensor."""

    role: str
    """Key of CHANNELS."""
    node: int
    """Number of the device."""
    leg: int
    """0 unless the role has one device for each leg."""
    rate_Hz: float
    folder: Path
    """Folder of the configuration, at which relative paths start."""


class SensorFamily(Section):
    """Section `device` of a sensor."""

    protocol: str
    """Sensor family: an entry point of the group `hil.sensors`."""
    has_node: ClassVar[bool] = True
    """True if a node number identifies its devices."""

    @abstractmethod
    def device(self, wanted: Wanted) -> Device:
        """Messages of one measurement.

        Raises ConfigurationError, with a key relative to this section, for what the family cannot measure.
        """


class Timed(SensorFamily):
    """Section `device` of sensors without a time stamp in their frames."""

    latency_ms: Annotated[float, Key(ge=0)] = 0.0
    """From the instant of a sample to the arrival of its frame. With trigger sync: from that instant to the
    SYNC, for devices that filter."""

    def timed(self, trigger: Literal["sync", "free"], **values: Any) -> Device:
        """Device with the stated times."""
        timing = SYNCED if trigger == "sync" else FREE
        return Device(timing=timing, latency_s=1e-3 * self.latency_ms, **values)
