"""The clock of a bus and of all processes on it: CLOCK_MONOTONIC."""

import time


class Clock:
    """CLOCK_MONOTONIC, ns; base class of clocks whose time can stand still."""

    def now(self) -> int:
        """Present time of this clock, ns."""
        return time.monotonic_ns()

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        """Sleep until t_ns or later; the last `spin_ns` are busy-waiting."""
        rest = t_ns - time.monotonic_ns() - spin_ns
        if rest > 0:
            time.sleep(rest * 1e-9)
        while time.monotonic_ns() < t_ns:
            pass

    def working(self, allowed_ns: int = 0) -> None:
        """For clocks that can stop: promise to wait again within `allowed_ns`, ns. No effect here."""

    def waiting(self, until_ns: int) -> None:
        """For clocks that can stop: promise to sleep until `until_ns`, ns. No effect here."""

    def stands(self) -> bool:
        """True while this clock's time stands still; always False for CLOCK_MONOTONIC."""
        return False

    def leave(self) -> None:
        """For clocks that can stop: withdraw from holding time back. No effect here."""

    def stretched(self) -> int:
        """Total time for which this clock stood still, ns."""
        return 0


MONOTONIC = Clock()
