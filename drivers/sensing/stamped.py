"""Tracker, IMU and wrench sensor of sensors.dbc, whose samples carry their time in the controller's ticks.

A sample is stamped Offset after the end of the SYNC that carried Cycle. No clock has to be set, and a sample
may be up to 127 ticks late.
"""

from typing import Literal

from drivers.errors import ConfigurationError
from drivers.sensing.family import Device, Field, Message, SensorFamily, Wanted
from drivers.sensing.layout import QUALITY, QUANTITIES, SIGNED, STAMPED, UNSIGNED

_MESSAGES = {"tracker": ("TRACKER_7", 7), "imu": ("IMU_8", 8), "wrench": ("WRENCH_9", 9)}
"""Role -> message of sensors.dbc, and the node number in its identifier."""


class StampedSensors(SensorFamily):
    """Sensors of sensors.dbc: frames of 20 and 32 bytes, by CAN FD, on a bus with its SYNC."""

    protocol: Literal["stamped"] = "stamped"

    def device(self, wanted: Wanted) -> Device:
        """Messages of one measurement."""
        from drivers.legs.messages import layouts, read_dbc  # noqa: PLC0415 - compiled code, not for settings

        if wanted.role not in _MESSAGES:
            raise ConfigurationError(f"protocol: measures {', '.join(_MESSAGES)}, given: {wanted.role}")
        database = read_dbc("drivers", "sensors.dbc")
        name, own = _MESSAGES[wanted.role]
        form = layouts(database)[name]
        fields = [
            Field(
                to, start, bits, form.scale[to], 0.0, SIGNED if to < QUANTITIES else UNSIGNED,
                low=form.low[to], high=form.high[to],
            )
            for to, (start, bits) in enumerate(form.places[:QUALITY])
        ]  # fmt: skip
        message = Message(
            form.id - own + wanted.node, form.length, tuple(fields), form.flags, exact=True, checked=True
        )
        return Device((message,), STAMPED, database=database)
