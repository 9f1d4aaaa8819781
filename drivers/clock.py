"""The clock that a bus and all who live by it go by: CLOCK_MONOTONIC."""

import time


class Clock:
    """CLOCK_MONOTONIC, in ns."""

    def now(self) -> int:
        """Return the time."""
        return time.monotonic_ns()

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        """Return at t_ns or later: sleep, then watch the clock for the last `spin_ns`."""
        rest = t_ns - time.monotonic_ns() - spin_ns
        if rest > 0:
            time.sleep(rest * 1e-9)
        while time.monotonic_ns() < t_ns:
            pass

    def working(self, allowed_ns: int = 0) -> None:
        """Say that whoever has this clock waits again within so long; it matters to a bench's alone."""

    def waiting(self, until_ns: int) -> None:
        """Say that whoever has this clock sleeps until then; it matters to a bench's alone."""

    def stands(self) -> bool:
        """Tell whether time stands still."""
        return False

    def leave(self) -> None:
        """Say that whoever has this clock looks no more."""

    def stretched(self) -> int:
        """Return by how many ns this clock has stood still in all."""
        return 0


MONOTONIC = Clock()
