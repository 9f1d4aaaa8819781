"""The clock of a bus and of all its users: CLOCK_MONOTONIC."""

import time


class Clock:
    """CLOCK_MONOTONIC, in ns."""

    def now(self) -> int:
        """Time, ns."""
        return time.monotonic_ns()

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        """Sleep until t_ns or later; the last `spin_ns` are busy-waiting."""
        rest = t_ns - time.monotonic_ns() - spin_ns
        if rest > 0:
            time.sleep(rest * 1e-9)
        while time.monotonic_ns() < t_ns:
            pass

    def working(self, allowed_ns: int = 0) -> None:
        """Promise to wait again within `allowed_ns`; only a bench clock uses it."""

    def waiting(self, until_ns: int) -> None:
        """Promise to sleep until `until_ns`; only a bench clock uses it."""

    def stands(self) -> bool:
        """True while time stands still."""
        return False

    def leave(self) -> None:
        """Stop holding time; only a bench clock uses it."""

    def stretched(self) -> int:
        """Total standstill of this clock, ns."""
        return 0


MONOTONIC = Clock()
