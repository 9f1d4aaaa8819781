"""The door to one bus: what is refused, lost, off or an error, each counted once, with a clock that stands."""

from __future__ import annotations

import os
from typing import Any

import pytest

from drivers.arrays import Rows
from drivers.can import bus as door
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.can.can_interface import read_error
from drivers.can.link import Link, collect
from drivers.can.netlink import attributes
from drivers.can.runtime_folder import role_holder
from drivers.clock import Clock
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import received_array, sent_array
from drivers.protocol import BUS, ERROR, Frame, Received
from drivers.signals import BusState
from tests.drivers.frames_heard import got

PAIR = (Frame(1, b"a"), Frame(2, b"b"))
WRONG = Received(5, Frame(0x80, b"", ERROR))
GOOD = Received(6, Frame(0x80, b"x"))


class Standing(Clock):
    """Time that a test sets."""

    t_ns = 1_000

    def now(self) -> int:
        return self.t_ns


class Scripted(Link):
    """A link that takes so many frames and has these ones, a list a look; a wait takes a millisecond."""

    facts, knows_ends, virtual, off, overflow = "facts", True, True, False, 0

    clock: Standing

    def __init__(self, clock: Standing, *looks: list[Received]) -> None:
        self.clock, self.takes, self.looks, self.blocked = clock, 2, list(looks), list[Any]()
        self.calls: list[str] = []
        self.state = BusState.UNKNOWN

    def send(self, frames: Any) -> int:
        self.calls.append("send")
        return min(self.takes, len(frames))

    def receive(self) -> Rows:
        return received_array(self.looks.pop(0) if self.looks else [])

    def block(self, deadline_ns: int, missing: Any) -> None:
        self.blocked.append((deadline_ns, set(missing)))
        self.clock.t_ns += 1_000_000

    def worst_state(self) -> BusState:
        return self.state

    def died(self) -> None:
        self.calls.append("died")

    def flush_tx(self) -> None:
        self.calls.append("flush")

    def sent_ns(self) -> list[int]:
        return [7, 8]

    def close(self) -> None:
        self.calls.append("close")


def one(*looks: list[Received]) -> tuple[Bus, Any, Standing]:
    clock = Standing()
    link: Any = Scripted(clock, *looks)
    return Bus([link]), link, clock


def test_what_the_bus_does_not_take_is_counted_and_nothing_is_not_sent():
    bus, link, clock = one()
    for takes, refused in ((2, 0), (1, 1), (0, 2)):
        link.takes = takes
        assert bus.send(sent_array(PAIR)) == refused
    link.calls.clear()
    clock.t_ns += 50_000_000
    assert bus.send(sent_array(())) == 0
    assert link.calls == []
    assert bus.events().off == 0


def test_a_bus_that_takes_nothing_for_50_ms_is_off_until_it_takes_a_frame():
    bus, link, clock = one()
    link.takes = 0
    bus.send(sent_array(PAIR))
    for later_ns, off in ((30_000_000, 0), (19_999_999, 0), (1, 1), (1, 1)):
        clock.t_ns += later_ns
        bus.send(sent_array(PAIR))
        assert bus.events().off == off
    link.takes = 1
    bus.send(sent_array(PAIR))
    assert bus.events().off == 0
    link.takes = 0
    clock.t_ns += 50_000_000
    bus.send(sent_array(PAIR))
    assert bus.events().off == 0, "refused for no time"


def test_a_bus_that_goes_off_drops_what_waits_once_each_time():
    bus, link, _ = one()
    for off, state, seen, dropped in (
        (False, BusState.PASSIVE, 0, 0),
        (True, BusState.PASSIVE, 1, 1),
        (True, BusState.ACTIVE, 1, 1),
        (False, BusState.ACTIVE, 0, 1),
        (False, BusState.OFF, 1, 2),
    ):
        link.off, link.state = off, state
        events = bus.events()
        assert (events.off, events.state) == (seen, state)
        assert link.calls.count("died") == dropped


def test_error_frames_and_losses_are_counted_since_the_last_look_and_error_frames_are_not_returned():
    bus, link, _ = one([WRONG, GOOD, WRONG], [WRONG], [])
    link.overflow = 4
    assert got(bus.drain_now()) == [GOOD]
    assert bus.events() == (2, 0, 4, BusState.UNKNOWN)
    assert got(bus.drain_now()) == []
    link.overflow = 7
    assert bus.events() == (1, 0, 3, BusState.UNKNOWN)
    assert bus.events() == (0, 0, 0, BusState.UNKNOWN)


def test_what_is_awaited_ends_the_wait_and_else_the_deadline():
    bus, link, clock = one([], [WRONG], [GOOD], [Received(9, Frame(0x81, b""))])
    deadline = clock.t_ns + 10_000_000
    assert got(bus.drain(deadline, {0x80, 0x81})) == [GOOD, Received(9, Frame(0x81, b""))]
    assert link.blocked == [(deadline, {0x80, 0x81})] * 2 + [(deadline, {0x81})]
    link.blocked.clear()
    assert got(bus.drain(deadline, set())) == []
    assert link.blocked == []
    assert got(bus.drain(deadline, {0x80})) == []
    assert clock.t_ns == deadline
    link.looks = [[GOOD]]
    assert got(bus.drain(clock.t_ns, {0x99})) == [GOOD], "what is there at the deadline"


def test_what_came_before_the_deadline_is_returned_though_a_look_lasts_beyond_it(monkeypatch):
    bus, link, clock = one([GOOD])
    deadline, looks = clock.t_ns + 1, [[], [GOOD]]

    def slow() -> Rows:
        clock.t_ns = deadline + 1
        return received_array(looks.pop(0))

    monkeypatch.setattr(link, "receive", slow)
    assert got(bus.drain(deadline, {0x80})) == [GOOD]
    assert link.blocked == [(deadline, {0x80})]


def test_anything_ends_a_wait_for_anything_but_an_error_frame_alone():
    bus, link, clock = one([], [WRONG], [], [GOOD], [GOOD])
    deadline = clock.t_ns + 10_000_000
    assert got(bus.wait(deadline)) == [GOOD]
    assert link.blocked == [(deadline, set())] * 2
    assert link.looks == [[GOOD]]
    link.looks, clock.t_ns = [[WRONG], [GOOD]], deadline
    assert got(bus.wait(deadline)) == []
    assert link.looks == [[GOOD]], "the deadline is over"
    link.looks = []
    assert got(bus.wait(deadline)) == []
    link.looks = [[WRONG, GOOD]]
    assert got(collect(link, deadline)) == [WRONG, GOOD]


def test_what_the_link_says_of_itself_is_handed_on():
    bus, link, clock = one()
    assert (bus.facts, bus.knows_ends, bus.virtual, bus.clock) == ("facts", True, True, clock)
    bus.send(sent_array(PAIR))
    assert (list(bus.sent_ns()), bus.skew_ns()) == ([7, 8], 0)
    bus.flush_tx()
    assert link.calls == ["send", "flush"]


@pytest.mark.parametrize("fails", [False, True])
def test_the_role_is_given_back_when_the_link_is_left_whatever_becomes_of_it(fails):
    class Role:
        def close(self) -> None:
            link.calls.append("role")

    clock = Standing()
    link: Any = Scripted(clock)

    def fail() -> None:
        raise OSError("gone")

    if fails:
        link.close = fail
        with pytest.raises(OSError, match="gone"), Bus([link], Role()):  # type: ignore[arg-type]
            pass
    else:
        with Bus([link], Role()):  # type: ignore[arg-type]
            pass
    assert link.calls == (["role"] if fails else ["close", "role"])


# several


def several(count: int) -> tuple[Bus, list[Any], Standing]:
    clock = Standing()
    links: list[Any] = [Scripted(clock) for _ in range(count)]
    return Bus(links), links, clock


def test_each_bus_is_off_by_its_own_refusals_for_50_ms_and_by_no_others():
    group, links, clock = several(3)
    links[1].takes = 0
    frames = [Frame(1, b"", BUS * bus) for bus in range(3)]
    assert group.send(sent_array(frames)) == 1
    clock.t_ns += 20_000_000
    links[2].takes = 0
    assert group.send(sent_array(frames)) == 2
    for later_ns, bits in ((29_999_999, 0b000), (1, 0b010), (19_999_999, 0b010), (1, 0b110)):
        clock.t_ns += later_ns
        group.send(sent_array(frames))
        assert group.events().off == bits
    links[1].takes = 1
    group.send(sent_array(frames))
    assert group.events().off == 0b100
    group.send(sent_array(frames[:1]))
    assert group.events().off == 0b100, "a bus that is sent nothing is as it was"


def test_buses_that_all_take_nothing_are_all_off():
    group, links, clock = several(2)
    for link in links:
        link.takes = 0
    frames = [Frame(1, b""), Frame(1, b"", BUS)]
    group.send(sent_array(frames))
    clock.t_ns += 50_000_000
    group.send(sent_array(frames))
    assert group.events().off == 0b11
    assert [link.calls.count("died") for link in links] == [1, 1]


def test_facts_of_several_buses_are_those_that_are_known():
    group, links, _ = several(3)
    links[0].facts, links[1].facts, links[2].facts = "a", "", "c"
    assert group.facts == "a; c"


def test_what_is_missing_is_awaited_on_the_first_bus_where_some_of_it_was_heard_last():
    group, links, _ = several(3)
    links[1].looks = [[Received(3, Frame(7, b"")), Received(9, Frame(8, b""))]]
    links[2].looks = [[Received(5, Frame(9, b"")), Received(6, Frame(7, b""))]]
    found = [(each.t_ns, each.frame.id, each.frame.bus) for each in got(group.receive())]
    assert found == [(3, 7, 1), (5, 9, 2), (6, 7, 2), (9, 8, 1)]
    group.block(99, {7, 8, 9})
    group.block(99, {7, 9})
    assert [link.blocked for link in links] == [[], [(99, {8})], [(99, {7, 9})]]


# options


@pytest.mark.parametrize(
    ("value", "taken"),
    [(0, True), (10_000, True), (2.5, True)] + [(v, False) for v in (-1, 10_001, "9", True, None)],
)
def test_bus_option_outside_0_to_10000_is_refused(runtime, value, taken):
    settings = BusSettings(interface="localcan", channel="t").model_copy(
        update={"options": {"spin_us": value}}
    )
    if taken:
        Bus.open(settings, "listener").close()
        return
    with pytest.raises(
        BusError, match=rf"bus.options.spin_us: a number from 0 to 10000 is allowed, not {value!r}"
    ):
        Bus.open(settings, "listener")


def test_options_that_an_interface_does_not_have_are_named_with_those_that_it_has():
    settings = BusSettings(interface="localcan", channel="t", options={"spin": 1, "b": 2, "tx_limit": 3})
    with pytest.raises(
        BusError, match=r"bus.options: b, spin unknown for localcan; allowed: spin_us, tx_limit$"
    ):
        Bus.open(settings, "listener")


def test_a_bus_of_this_machine_is_opened_with_what_is_set(monkeypatch):
    opened: list[Any] = []

    class Opened(Scripted):
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(Standing())
            opened.append((given, named))

    monkeypatch.setattr(door, "Participant", Opened)
    settings = BusSettings(interface="localcan", channel="t", layout="classic")
    for options in ({}, {"spin_us": 7, "tx_limit": 3}):
        Bus.open(settings.model_copy(update={"options": options}), "plant").close()
        timing = BitTiming(settings.bitrate_bit_s, settings.data_bitrate_bit_s)
        assert opened.pop() == (("t", timing), {"fd": False, "clock": None, **options})


def test_a_bus_of_the_kernel_has_one_option():
    settings = BusSettings(interface="socketcan", channel="can0", options={"spin_us": 1})
    with pytest.raises(BusError, match=r"bus.options: spin_us unknown for socketcan; allowed: restart_ms$"):
        Bus.open(settings, "listener")


def test_a_role_is_locked_by_interface_channel_and_role(runtime):
    with Bus.open(BusSettings(interface="localcan", channel="t"), "plant"):
        assert role_holder("localcan", "t", "plant") == os.getpid()


def test_an_attribute_without_content_is_there_and_a_cut_one_ends_them():
    assert attributes(bytes.fromhex("04000500")) == {5: b""}
    assert attributes(bytes.fromhex("05000500 aa000000 04000680")) == {5: b"\xaa", 6: b""}
    for cut in ("0400", "040005", "0600050001", "03000500"):
        assert attributes(bytes.fromhex(cut)) == {}


# error frames


@pytest.mark.parametrize(
    ("identifier", "data", "state", "overflow"),
    [
        (0x040, "", BusState.OFF, False),
        (0x044, "0040", BusState.OFF, False),
        (0x004, "0010", BusState.PASSIVE, False),
        (0x004, "0020", BusState.PASSIVE, False),
        (0x004, "002c", BusState.PASSIVE, False),
        (0x004, "0004", BusState.WARNING, False),
        (0x004, "0008", BusState.WARNING, False),
        (0x004, "0040", BusState.ACTIVE, False),
        (0x100, "", BusState.ACTIVE, False),
        (0x104, "0010", BusState.PASSIVE, False),
        (0x004, "0001", BusState.UNKNOWN, True),
        (0x004, "0002", BusState.UNKNOWN, False),
        (0x008, "0031", BusState.UNKNOWN, False),
        (0x204, "0000000000007f80", BusState.UNKNOWN, False),
        (0x200, "00", BusState.UNKNOWN, False),
        (0x080, "", BusState.UNKNOWN, False),
    ],
)
def test_an_error_frame_reports_state_and_overflow(identifier, data, state, overflow):
    assert read_error(identifier | 0x400, bytes.fromhex(data)) == (state, overflow)
