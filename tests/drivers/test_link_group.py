"""Waiting on several buses: as long as is needed and no longer; a bus that is busy is not dead; and what waits on one that died."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from drivers.can.bus import DEAD_AFTER_NS, Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import BUS, Frame
from drivers.signals import Command, DriveMode, DriveState
from hil.contracts.messages import Alive, EmergencyStop, Sync
from tests.drivers.cia402_drives import holding
from tests.drivers.test_several_buses import FAMILIES, FORCE, ODD, SETUP, FakeLink, Still, fakes, family

DEADLINE_NS = 900_000_000


class Sleeping(Still):
    """A clock that passes by the sleep it is told. State: until when it was to sleep."""

    def __init__(self) -> None:
        self.until: list[int] = []

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        self.until.append(t_ns)
        self.t_ns = max(self.t_ns, t_ns)


class Foreseeing(FakeLink):
    """A link that knows when the frame under way will have ended, or has a file that is never readable."""

    def __init__(self, clock: Any, end_ns: int | None = None, file: int = -1, *, quiet: bool = True) -> None:
        super().__init__(clock)
        self.foresees, self.file, self.quiet = end_ns, file, quiet

    def foresee(self) -> int | None:
        return self.foresees

    def fileno(self) -> int:
        return self.file

    def arm(self) -> bool:
        return self.quiet


def group(*links: Any) -> Bus:
    return Bus(links)


@pytest.mark.parametrize("first", [0, 1])
def test_the_frame_that_ends_first_on_some_bus_is_waited_for_and_none_behind_the_deadline(first):
    clock, ends = Sleeping(), [400_000, 700_000]
    links = [Foreseeing(clock, ends[first]), Foreseeing(clock, ends[1 - first])]
    group(*links).block(DEADLINE_NS, frozenset())
    assert clock.until == [400_000]
    clock.t_ns, clock.until = 0, []
    group(*links).block(100_000, frozenset())
    assert clock.until == [100_000]


def test_a_link_without_a_file_is_looked_at_again_after_a_fifth_of_a_millisecond():
    clock = Sleeping()
    both = group(Foreseeing(clock), Foreseeing(clock))
    both.block(DEADLINE_NS, frozenset())
    (until,) = clock.until
    assert until == 201_000, "the clock goes on by a microsecond a look"
    clock.t_ns, clock.until = 0, []
    both.block(50_000, frozenset())
    assert clock.until == [50_000]


@pytest.fixture
def files() -> Iterator[list[int]]:
    """Two descriptors on which nothing comes."""
    with ExitStack() as stack:
        pipes = [os.pipe() for _ in range(2)]
        for end in (end for pipe in pipes for end in pipe):
            stack.callback(os.close, end)
        yield [pipe[0] for pipe in pipes]


@pytest.mark.parametrize("came", [0, 1])
def test_what_came_on_one_bus_between_two_looks_ends_the_wait_however_quiet_the_other_is(files, came):
    clock = Sleeping()
    links = [Foreseeing(clock, file=files[k], quiet=k != came) for k in range(2)]
    begun = time.monotonic()
    group(*links).block(10 * DEADLINE_NS, frozenset())
    assert time.monotonic() - begun < 1.0, "it would have slept for nine seconds"


class Bench(BenchClock):
    """A bench clock that stands or goes on. State: what it was told, and its reading."""

    def __init__(self, *, stood: bool) -> None:
        self.stood, self.t_ns, self.told = stood, 1_000_000, list[Any]()

    def now(self) -> int:
        return self.t_ns

    def stands(self) -> bool:
        return self.stood

    def waiting(self, until_ns: int) -> None:
        self.told.append(until_ns)

    def working(self, allowed_ns: int = 0) -> None:
        self.told.append("works")


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The waits for files, none of which lasts."""
    found: list[Any] = []
    monkeypatch.setattr("select.select", lambda *given: found.append(given))
    return found


@pytest.mark.parametrize(
    ("stood", "off", "short"), [(False, False, False), (True, False, True), (False, True, True)]
)
def test_files_are_waited_for_to_the_deadline_and_for_a_millisecond_while_time_stands_or_a_bus_is_off(
    waits, stood, off, short
):
    clock = Bench(stood=stood)
    links = [Foreseeing(clock, file=file) for file in (0, 9)]
    links[1].off = off
    group(*links).block(81_000_000, frozenset())
    assert waits == [([0, 9], [], [], 1e-3 if short else 0.08)]
    assert clock.told == [81_000_000, "works"]
    group(*links).block(1_500_000, frozenset())
    assert waits[1:] == [([0, 9], [], [], 0.0005)]
    group(*links).block(1_000_000, frozenset())
    assert len(waits) == 2, "the deadline is over"


def test_files_are_waited_for_by_a_clock_of_one_s_own_and_only_where_each_link_has_one(waits):
    clock = Sleeping()
    clock.t_ns = 0
    group(Foreseeing(clock, file=0), Foreseeing(clock, file=9)).block(81_000, frozenset())
    assert waits == [([0, 9], [], [], pytest.approx(0.00008))]
    for files in ((-1, 9), (9, -1)):
        group(*(Foreseeing(clock, file=file) for file in files)).block(DEADLINE_NS, frozenset())
    assert len(waits) == 1
    assert len(clock.until) == 2


def test_a_bus_that_takes_a_part_of_its_frames_is_busy_however_long():
    clock = Still()
    links: list[Any] = [FakeLink(clock), FakeLink(clock)]
    bus = group(*links)
    links[0].send = lambda frames: 1
    for _ in range(3):
        assert bus.send(sent_array([Frame(1, b""), Frame(2, b""), Frame(1, b"", BUS)])) == 1
        assert bus.events().off == 0
        clock.t_ns += DEAD_AFTER_NS


@pytest.mark.parametrize("name", FAMILIES)
def test_sync_heartbeat_and_stop_of_one_bus_reach_the_drives_of_that_bus_alone(name):
    protocol = family(name, ODD)
    dialogue, sent = protocol.start(SETUP), list(protocol.traits.emergency_stop)
    for tick in range(60):
        sent += protocol.begin(dialogue, tick)
        dialogue, frames = protocol.command(dialogue, Command(DriveMode.OFF, 0.0 * FORCE), tick)
        sent += frames
    for bus, there in enumerate(ODD):
        memory, heard = protocol.power_up(), set()
        if name == "cia402":
            memory = holding(protocol.protocol, [DriveState.READY] * 6)
        for frame in sent:
            if frame.bus == bus:
                memory, messages = protocol.parse(memory, frame)
                for each in messages:
                    if isinstance(each, Sync | Alive | EmergencyStop):
                        assert set(each.legs) <= set(there)
                        heard.add(type(each))
        assert Sync in heard
        assert (EmergencyStop in heard) is (name in {"legs", "odrive"})
        assert (Alive in heard) is (name == "cia402")


def test_of_a_bus_that_goes_off_while_another_is_off_what_waits_is_dropped_too_each_time():
    links, dropped = fakes(3), list[int]()
    for k, link in enumerate(links):
        link.died = lambda k=k: dropped.append(k)
    bus = Bus(links)
    for k in (0, 2, 1):
        links[k].off = True
        bus.events()
    assert dropped == [0, 2, 1]
    links[2].off = False
    bus.events()
    links[2].off = True
    assert bus.events().off == 0b111
    assert dropped == [0, 2, 1, 2]


def test_of_several_buses_that_cannot_be_cleared_the_first_is_told_and_each_is_tried():
    links, tried = fakes(4), list[int]()

    def clearing(bus: int) -> None:
        tried.append(bus)
        if bus in (1, 2):
            raise BusError(f"bus {bus} cannot be cleared")

    for bus, link in enumerate(links):
        link.flush_tx = lambda bus=bus: clearing(bus)
    with pytest.raises(BusError, match="bus 1 cannot be cleared"):
        group(*links).flush_tx()
    assert tried == [0, 1, 2, 3]


@pytest.mark.parametrize("refusing", [(0,), (1,), (2,), (0, 2)])
def test_a_frame_one_bus_cannot_carry_does_not_stop_the_others(refusing):
    links = fakes(3)

    def refused(bus: int) -> int:
        raise BusError(f"bus {bus} cannot carry frame 0x1")

    for bus in refusing:
        links[bus].send = lambda _, bus=bus: refused(bus)
    with pytest.raises(BusError, match=f"bus {refusing[0]} cannot carry"):
        group(*links).send(sent_array([Frame(1, b"stop", BUS * bus) for bus in range(3)]))
    for bus in set(range(3)) - set(refusing):
        assert [frame.data for frame in links[bus].sent] == [b"stop"]
