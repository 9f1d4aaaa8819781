"""ATI NETCANOEM, a six-axis force-torque sensor: polled, two frames without a counter.

Status bit 14 (CAN bus error) stays set after any disturbance of the bus, with good data: in a recording all
of 785 samples have it. Bit 15, any error that spoils the data, marks a sample as invalid.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Key

from drivers.errors import ConfigurationError
from drivers.protocol import Frame
from drivers.sensing.family import Condition, Device, Field, Message, Timed, Wanted

Row = tuple[float, float, float, float, float, float]
_ANY_ERROR = 0x8000
_SELECT = 6
"""Opcode that selects a calibration."""


class AtiSensor(Timed):
    """ATI NETCANOEM: its strain gauges and the matrix of its calibration."""

    protocol: Literal["ati"]
    has_node = False
    base: Annotated[int, Key(ge=0, le=127)] = 127
    """Base of its identifiers, which are base * 16 + opcode."""
    matrix: tuple[Row, Row, Row, Row, Row, Row]
    """Rows Fx to Tz of the calibration, in counts per count of gauges 0 to 5."""
    counts_per_N: Annotated[float, Key(gt=0)] = 1e6
    counts_per_N_m: Annotated[float, Key(gt=0)] = 1e6
    bias: Row = (0.0,) * 6
    """Counts of the gauges without load."""
    calibration: Annotated[int, Key(ge=0, le=15)] | None = None
    """Calibration to select at the start; the sensor forgets it at power-off."""

    def device(self, wanted: Wanted) -> Device:
        """Messages of the sensor."""
        if wanted.role != "wrench":
            raise ConfigurationError(f"protocol: measures wrench, given: {wanted.role}")
        if np.linalg.matrix_rank(np.array(self.matrix)) < len(self.matrix):
            raise ConfigurationError(
                "matrix: singular, allowed: six independent rows of the calibration sheet"
            )
        first = self.base * 16
        even, odd = (
            tuple(
                Field(gauge, 8 * (2 * k + skip) + 7, 16, offset=-self.bias[gauge], big=True)
                for k, gauge in enumerate(gauges)
            )
            for gauges, skip in (((0, 2, 4), 2), ((1, 3, 5), 0))
        )
        status = Condition(7, 16, 0, _ANY_ERROR, big=True)
        counts = (self.counts_per_N,) * 3 + (self.counts_per_N_m,) * 3
        select = () if self.calibration is None else (Frame(first + _SELECT, bytes([self.calibration])),)
        return self.timed(
            "sync",
            messages=(Message(first, 8, even, 0, (status,)), Message(first + 1, 6, odd)),
            poll=Frame(first, b""),
            start=select,
            mix=tuple(tuple(a / n for a in row) for row, n in zip(self.matrix, counts, strict=True)),
        )
