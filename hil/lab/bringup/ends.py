"""The other end of a bring-up: a machine, a bench that another process serves, or one in this process."""

import contextlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

from drivers.bus_address import BusAddress
from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.family import Family
from hil.app.compose import drive_setup
from hil.app.configuration.configuration import Configuration
from hil.app.run.stretching import STRANGER, begin, bench_clock
from hil.lab.bringup.bus_line import BusLine
from hil.lab.bringup.context import Operator
from hil.lab.bringup.hands import RemoteHands
from hil.lab.bringup.line import Line
from hil.lab.bringup.machine import WINDOW, bringup_rate, known_poses
from hil.lab.bringup.rehearsal import BenchHands, BenchLine
from hil.loop.clock import real_time
from plant_fmu.rehearsal.bench import RehearsalBench

Agree = Callable[[str, str, str], bool]
"""Called with a step's title, what it will do and how to stop it."""
Say = Callable[[str], None]


class End(NamedTuple):
    """A line to six drives, and who works beside them."""

    line: Line
    operator: Operator


def rehearsed_end(c: Configuration, bench: RehearsalBench, agree: Agree, say: Say) -> End:
    """Return the ends of a bench in this process."""
    return End(BenchLine(bench.nodes, bringup_rate(c)), BenchHands(bench, known_poses(c), agree, say))


@contextlib.contextmanager
def served_end(
    c: Configuration, bus: Bus, protocol: Family, beside: Operator, agree: Agree, say: Say
) -> Iterator[End]:
    """Yield the ends of a bench that another process serves on a bus; its time stands still where it may."""
    say("a rehearsal bench is served on this bus: its hands do what you are asked")
    clock, rate = bench_clock(c, bus), bringup_rate(c)
    if clock is not None:
        agree = _unheld(clock, agree)
    hands = RemoteHands(BusAddress(c.bus.interface, c.bus.channel), beside, agree)
    with contextlib.closing(hands), real_time(c.loop.priority, c.loop.cpu):
        if clock is not None:
            opening = protocol.controller_end(drive_setup(c, rate)).begin(0)
            begin(clock, c, protocol, opening, round(1e9 * WINDOW / rate))
        try:
            yield End(_line(c, bus, protocol), hands)
        finally:
            bus.clock.leave()
            if clock is not None and clock.interrupted:
                say(STRANGER)


@contextlib.contextmanager
def machine_end(c: Configuration, bus: Bus, protocol: Family, operator: Operator) -> Iterator[End]:
    """Yield the ends of a machine on a bus."""
    with real_time(c.loop.priority, c.loop.cpu):
        yield End(_line(c, bus, protocol), operator)


def _line(c: Configuration, bus: Bus, protocol: Family) -> BusLine:
    rate = bringup_rate(c)
    return BusLine(bus, rate, WINDOW / rate, watched=protocol.traits.has_watchdog)


def _unheld(clock: BenchClock, agree: Agree) -> Agree:
    """Return `agree` with nobody's time held up meanwhile: a person may think."""

    def freely(title: str, will: str, stop: str) -> bool:
        clock.leave()
        try:
            return agree(title, will, stop)
        finally:
            clock.holds = True

    return freely
