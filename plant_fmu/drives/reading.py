"""What faulty encoders send in place of what they read: noise, and readings that are late."""

from collections import deque

from drivers.arrays import Array
from plant_fmu.faults.fault import Present


class Reading:
    """Spoils the readings of six encoders on their way into the feedback.

    Mutable state: the readings since the first late encoder, as long as they are needed.
    """

    def __init__(self) -> None:
        self._read: deque[tuple[int, Array, Array]] = deque()

    def begin(self, present: Present) -> None:
        """Begin with other faults: where no encoder is late any more, no reading is needed."""
        if not any(present.late_ns):
            self._read.clear()

    def spoil(self, present: Present, t_ns: int, length: Array, rate: Array) -> None:
        """Change lengths (6,) m and rates (6,) m/s that were read at `t_ns`."""
        longest = max(present.late_ns)
        if longest:
            self._read.append((t_ns, length.copy(), rate.copy()))
            while len(self._read) > 1 and self._read[1][0] <= t_ns - longest:
                self._read.popleft()
            for leg, late_ns in enumerate(present.late_ns):
                if late_ns:
                    length[leg], rate[leg] = self._at(t_ns - late_ns, leg)
        for leg, sigma_m, generator in present.noise:
            length[leg] += sigma_m * generator.standard_normal()

    def _at(self, t_ns: int, leg: int) -> tuple[float, float]:
        """Return length and rate at an instant, carried on from the reading before it; else the first."""
        before = [read for read in self._read if read[0] <= t_ns]
        at_ns, length, rate = before[-1] if before else self._read[0]
        dt = max(0, t_ns - at_ns) * 1e-9
        return float(length[leg] + rate[leg] * dt), float(rate[leg])
