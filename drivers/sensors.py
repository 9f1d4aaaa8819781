"""Codec of the sensors next to the drives: pose tracker, IMU and wrench sensor, for both ends of the bus.

A sample is stamped in the controller's own time: Offset after the end of the SYNC that carried Cycle. No
clock has to be set, and a sample may be up to 127 ticks late.
"""

from collections.abc import Sequence
from math import ceil

import numpy as np

from drivers.compiled.pointed import FAILED
from drivers.config import BusSettings, SensorSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_array import FRAME, sent_frames
from drivers.legs.messages import layouts, read_dbc
from drivers.protocol import Frame
from drivers.sensor_kernels import FIELDS, QUANTITIES, encode, no_sensors

_MESSAGES = {"tracker": ("TRACKER_7", 7), "imu": ("IMU_8", 8), "wrench": ("WRENCH_9", 9)}
"""Kind -> message of sensors.dbc, and the node number in its identifier."""
KINDS = tuple(_MESSAGES)
_TABLES = ("id", "flags", "bus", "length", "start", "bits", "scale", "low", "high")
"""Fields of SENSORS that are known before any frame."""


class SensorProtocol:
    """Codec of the configured sensors. Has constant tables only.

    Raises ConfigurationError if the frame layout has no room for them.
    """

    def __init__(self, bus: BusSettings, sensors: SensorSettings) -> None:
        self.rates_Hz = {k: s.rate_Hz for k in KINDS if (s := getattr(sensors, k)) is not None}
        if self.rates_Hz and bus.layout == "classic":
            given = ", ".join(f"sensors.{kind}" for kind in self.rates_Hz)
            raise ConfigurationError(
                f"bus.layout: classic carries 8 bytes per frame, but a sample takes up to 32, given: "
                f"{given}; use layout fd, or remove the sensors"
            )
        self.database = "sensors.dbc", read_dbc("drivers", "sensors.dbc")
        messages = layouts(self.database[1])
        self.sync_id: int = messages["SYNC"].id
        self.tables = no_sensors()
        """Layout of the configured sensors' frames."""
        for kind in self.rates_Hz:
            name, node = _MESSAGES[kind]
            form = messages[name]
            identifier = form.id - node + getattr(sensors, kind).node_id
            try:
                bus_index = bus.index_of(getattr(sensors, kind).channel)
            except ConfigurationError as error:
                raise ConfigurationError(f"sensors.{kind}.channel: {error}") from error
            start, bits = zip(*form.places[:FIELDS], strict=True)
            tables = (
                identifier, form.flags, bus_index, form.length, start, bits,
                form.scale[: QUANTITIES + 1], form.low[:QUANTITIES], form.high[:QUANTITIES],
            )  # fmt: skip
            for column, table in zip(_TABLES, tables, strict=True):
                self.tables[column][KINDS.index(kind)] = table

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of sensor that are configured: some of `tracker`, `imu`, `wrench`."""
        return tuple(self.rates_Hz)

    def encode(self, kind: str, values: Sequence[float], cycle: int, offset_s: float, counter: int) -> Frame:
        """Frame of one sample; a value beyond its field saturates and makes the sample invalid.

        values: six, as in `SAMPLE`; its time is offset_s after the SYNC that carried cycle.
        Raises ProtocolError for NaN, and for an offset outside 0 .. 65.535 ms.
        """
        given, frame = np.array(values, float), np.zeros(1, FRAME)
        when = (cycle, offset_s, counter)
        if encode(self.tables, KINDS.index(kind), given, *when, frame.reshape(())) == FAILED:
            if np.isnan(given).any():
                raise ProtocolError(f"sample of {kind} is not a number: {given.tolist()}")
            raise ProtocolError(f"sample of {kind}: offset of {offset_s} s, allowed: 0 to 0.065535")
        return sent_frames(frame)[0]

    def cyclic_frames(self, rate_Hz: float) -> tuple[Frame, ...]:
        """One example of every frame that can fall into one tick at a loop of `rate_Hz`."""
        found: list[Frame] = []
        for kind, rate in self.rates_Hz.items():
            found += [self.encode(kind, (0.0,) * 6, 0, 0.0, 0)] * ceil(rate / rate_Hz * (1 - 1e-9))
        return tuple(found)
