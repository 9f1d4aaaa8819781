"""What all drives have in common that took MIT framing over: numbers are codes over ranges."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from drivers.mit.fields import TURN, Ranges
from drivers.motors import MotorProtocol
from drivers.protocol import Resolution
from drivers.signals import LEGS
from drivers.transmission import Transmission


class MitFamily(MotorProtocol):
    """The tables of six drives with the same ranges."""

    def __init__(
        self,
        ranges: Ranges,
        nodes: Sequence[int],
        torque_field: tuple[int, int],
        transmission: Transmission,
        legs: Sequence[Sequence[int]],
    ) -> None:
        """Take ranges, six numbers, first byte and bits of a command's torque, and the legs of each bus."""
        super().__init__(transmission, nodes, (*torque_field, ranges.torque), legs)
        self.ranges, self.torque_limit = ranges, ranges.torque
        for name in ("position", "velocity", "torque"):
            self.tables[name] = getattr(ranges, name)

    def resolution(self, _rate_Hz: float) -> Resolution:
        """Return a step of position, of velocity and torque, at the leg: all are truncated."""
        r, (_, bits, _), t = self.ranges, self.torque_field, self.transmission
        fields = (r.position, 16), (r.velocity, bits), (r.torque, bits)
        position, velocity, torque = (2.0 * end / ((1 << n) - 1) for end, n in fields)
        length, rate = (t.rate(np.full(LEGS, step / TURN)) for step in (position, velocity))
        return Resolution.of(length, rate, t.N_per_Nm * torque)

    def reported_lengths(self) -> tuple[Array, Array]:
        """Return the leg lengths at the ends of the position's range."""
        return self.transmission.lengths_within(self.ranges.position / TURN)
