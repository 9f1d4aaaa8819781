"""The bring-up's line on a real bus: one tick a period, answers within a window of it."""

from collections.abc import Sequence

from drivers.can.bus import Bus
from drivers.errors import BusError
from drivers.frame_array import joined, received_frames, sent_array
from drivers.protocol import Frame
from hil.lab.bringup.line import Heard
from hil.loop.clock import Deadlines
from hil.loop.report import NO_WATCHDOG


class BusLine:
    """Ticks on an open bus.

    Mutable state: the deadlines, the bus, and for how long its time has stood still.
    """

    def __init__(self, bus: Bus, rate_Hz: float, window_s: float, *, watched: bool) -> None:
        """Take the open bus, the tick rate in Hz, and whether the drives have a watchdog of their own.

        window_s: for so long answers are waited for in a tick; later ones say nothing of a drive's state.
        """
        self.rate_Hz = rate_Hz
        self._bus = bus
        shut = "the drives' watchdogs shut their brakes"
        self._left = shut if watched else f"the drives {NO_WATCHDOG}"
        self._deadlines = Deadlines(rate_Hz, 0.0, clock=bus.clock)
        self._window_ns = round(1e9 * window_s)
        self._rest_ns = self._deadlines.period_ns - self._window_ns
        self._stood_ns = bus.clock.stretched()
        bus.flush_tx()
        bus.drain_now()

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Wait for the next tick, send, and collect what comes within the window.

        Raises BusError where the bus is down.
        """
        _, t_ns, lateness_ns, _ = self._deadlines.wait()
        began = t_ns + lateness_ns
        before_ns, self._stood_ns = self._stood_ns, self._bus.clock.stretched()
        frames = [self._bus.drain_now()]
        self._bus.send(sent_array(opening))
        end = began + self._window_ns
        while self._bus.clock.now() < end:
            heard = self._bus.wait(end)
            if not len(heard):
                break
            frames.append(heard)
        self._bus.clock.working(self._rest_ns)
        if self._bus.events().off:
            raise BusError(f"the bus is down: {self._left}; look at cable and power")
        return Heard(began, received_frames(joined(frames)), self._stood_ns - before_ns)

    def send(self, frames: Sequence[Frame]) -> None:
        """Send the frames that end a tick."""
        self._bus.send(sent_array(frames))
