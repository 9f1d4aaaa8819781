"""Motion capture by UDP: poses in datagrams of 64 bytes, see docs/guides/sensors.md.

Each carries the instant of its sample by the sender's clock. The sender need not share a clock with the
controller: the fastest datagrams show how the two clocks differ, and so how much later each other one came.
"""

from typing import Annotated, Literal

from pydantic import Field as Key

from drivers.config import DATAGRAM_BYTES, POSE_ID
from drivers.errors import ConfigurationError
from drivers.protocol import FD
from drivers.sensing.family import Device, Field, Message, Timed, Wanted
from drivers.sensing.layout import COUNTER, FLOAT, OFFSET, QUALITY, UNSIGNED, VALIDITY

_REAL, _SINGLE = 64, 32
"""Bits of a float64 and a float32."""


class MotionCapture(Timed):
    """A tracker whose poses come by UDP."""

    protocol: Literal["mocap"]
    has_node = False
    stamps: bool = True
    """True if samples carry the time of the sender's clock; False: their arrival counts."""
    residual_max_m: Annotated[float, Key(gt=0)] = 1e-3
    """Largest residual of the fit of a body to its markers; a sample with more is refused."""

    def device(self, wanted: Wanted) -> Device:
        """Message of the datagram."""
        if wanted.role != "tracker":
            raise ConfigurationError(f"protocol: measures tracker, given: {wanted.role}")
        fields = [
            Field(COUNTER, 0, 16, kind=UNSIGNED),
            Field(VALIDITY, 16, 8, kind=UNSIGNED),
            Field(QUALITY, 32, _SINGLE, kind=FLOAT, low=0.0, high=self.residual_max_m),
            *(Field(k, 128 + _REAL * k, _REAL, kind=FLOAT) for k in range(3)),
            *(Field(3 + k, 320 + _SINGLE * k, _SINGLE, kind=FLOAT) for k in range(3)),
        ]
        if self.stamps:
            fields.append(Field(OFFSET, 64, 63, 1e-9, kind=UNSIGNED))
        message = Message(POSE_ID, DATAGRAM_BYTES, tuple(fields), FD, exact=True, checked=True)
        return self.timed("free", messages=(message,))
