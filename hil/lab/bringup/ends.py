"""The other end of a bring-up: a machine, a bench that another process serves, or one in this process."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from drivers.bus_address import BusAddress
from drivers.can.bus import Bus
from drivers.errors import BusError
from drivers.family import Family
from drivers.frame_array import joined, received_frames, sent_array
from drivers.protocol import Frame
from hil.app.compose import drive_setup
from hil.app.configuration.configuration import Configuration
from hil.app.run.stretching import STRANGER, begin, bench_clock
from hil.lab.bringup.context import Operator
from hil.lab.bringup.drives import Heard, Line
from hil.lab.bringup.hands import RemoteHands
from hil.lab.bringup.machine import WINDOW, bringup_rate
from hil.lab.bringup.rehearsal import Agree, Say
from hil.loop.clock import Deadlines, real_time
from hil.loop.report import NO_WATCHDOG


class BusLine:
    """Ticks on an open bus. Mutable state: the deadlines, the bus, for how long its time has stood still."""

    def __init__(self, bus: Bus, rate_Hz: float, window_s: float, *, watched: bool) -> None:
        """Take an open bus; window_s: how long answers are waited for; watched: drives have watchdogs."""
        self.rate_Hz, self._bus = rate_Hz, bus
        self._left = "the drives' watchdogs shut their brakes" if watched else f"the drives {NO_WATCHDOG}"
        self._deadlines = Deadlines(rate_Hz, 0.0, clock=bus.clock)
        self._window_ns = round(1e9 * window_s)
        self._rest_ns = self._deadlines.period_ns - self._window_ns
        self._stood_ns = bus.clock.stretched()
        bus.flush_tx()
        bus.drain_now()

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Wait for the next tick, send, and collect what comes within the window. Raises BusError."""
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


class End(NamedTuple):
    """A line to six drives, and who works beside them."""

    line: Line
    operator: Operator


@contextlib.contextmanager
def served_end(
    c: Configuration, bus: Bus, protocol: Family, beside: Operator, agree: Agree, say: Say
) -> Iterator[End]:
    """Yield the ends of a bench that another process serves on a bus; its time stands still where it may."""
    say("a rehearsal bench is served on this bus: its hands do what you are asked")
    clock, rate = bench_clock(c, bus), bringup_rate(c)

    def unheld(title: str, will: str, stop: str) -> bool:  # a person may think: nobody's time is held
        bus.clock.leave()
        try:
            return agree(title, will, stop)
        finally:
            if clock is not None:
                clock.holds = True

    hands = RemoteHands(BusAddress(c.bus.interface, c.bus.channel), unheld, beside.tell)
    with contextlib.closing(hands), real_time(c.loop.priority, c.loop.cpu):
        if clock is not None:
            opening = protocol.controller_end(drive_setup(c, rate)).begin(0)
            begin(clock, c, protocol, opening, round(1e9 * WINDOW / rate))
        try:
            yield End(bus_line(c, bus, protocol), hands)
        finally:
            bus.clock.leave()
            if clock is not None and clock.interrupted:
                say(STRANGER)


def bus_line(c: Configuration, bus: Bus, protocol: Family) -> BusLine:
    """Return the ticks of a bring-up on an open bus."""
    rate = bringup_rate(c)
    return BusLine(bus, rate, WINDOW / rate, watched=protocol.traits.has_watchdog)
