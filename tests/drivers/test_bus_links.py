"""Bus over fake links: refusals, losses, bus-off, error frames and waiting, by a test clock."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.can.bus import DEAD_AFTER_NS, Bus
from drivers.can.link import collect
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import BUS, ERROR, Frame, Received
from drivers.signals import BusState
from tests.drivers.fake_links import FakeLink, ManualClock, links
from tests.drivers.received_frames import got

PAIR = (Frame(1, b"a"), Frame(2, b"b"))
WRONG = Received(5, Frame(0x80, b"", ERROR))
GOOD = Received(6, Frame(0x80, b"x"))


def one(*looks: list[Received]) -> tuple[Bus, FakeLink, ManualClock]:
    clock = ManualClock()
    link = FakeLink(clock, *looks)
    return Bus([link]), link, clock


def several(count: int) -> tuple[Bus, list[FakeLink], Any]:
    made = links(count)
    return Bus(made), made, made[0].clock


def sends(bus: Bus, *frames: Frame) -> int:
    return bus.send(sent_array(frames))


def test_bus_that_refuses_frames_for_50_ms_counts_as_off_until_it_accepts_a_frame():
    bus, link, clock = one()
    link.takes = 0
    sends(bus, *PAIR)
    for later_ns, off in ((30_000_000, 0), (19_999_999, 0), (1, 1), (1, 1)):
        clock.t_ns += later_ns
        sends(bus, *PAIR)
        assert bus.events().off == off
    link.takes = 1
    sends(bus, *PAIR)
    assert bus.events().off == 0
    link.takes = 0
    clock.t_ns += 50_000_000
    sends(bus, *PAIR)
    assert bus.events().off == 0, "the refusal has just begun"


def test_error_frames_and_losses_are_counted_and_not_returned_as_received_frames():
    bus, link, _ = one([WRONG, GOOD, WRONG], [WRONG], [])
    link.overflow = 4
    assert got(bus.drain_now()) == [GOOD]
    assert bus.events() == (2, 0, 4, BusState.UNKNOWN)
    assert got(bus.drain_now()) == []
    link.overflow = 7
    assert bus.events() == (1, 0, 3, BusState.UNKNOWN)
    assert bus.events() == (0, 0, 0, BusState.UNKNOWN)


def test_wait_for_given_identifiers_ends_when_all_have_arrived_or_at_the_deadline():
    bus, link, clock = one([], [WRONG], [GOOD], [Received(9, Frame(0x81, b""))])
    deadline = clock.t_ns + 10_000_000
    assert got(bus.drain(deadline, {0x80, 0x81})) == [GOOD, Received(9, Frame(0x81, b""))]
    assert link.blocked == [(deadline, {0x80, 0x81})] * 2 + [(deadline, {0x81})]
    link.blocked.clear()
    assert (got(bus.drain(deadline, set())), link.blocked) == ([], [])
    assert (got(bus.drain(deadline, {0x80})), clock.t_ns) == ([], deadline)
    link.looks = [[GOOD]]
    assert got(bus.drain(clock.t_ns, {0x99})) == [GOOD], "frames received by the deadline"


def test_wait_for_any_frame_is_ended_by_every_frame_except_an_error_frame():
    bus, link, clock = one([], [WRONG], [], [GOOD], [GOOD])
    deadline = clock.t_ns + 10_000_000
    assert got(bus.wait(deadline)) == [GOOD]
    assert (link.blocked, link.looks) == ([(deadline, set())] * 2, [[GOOD]])
    link.looks, clock.t_ns = [[WRONG], [GOOD]], deadline
    assert (got(bus.wait(deadline)), link.looks) == ([], [[GOOD]]), "the deadline is over"
    link.looks = [[WRONG, GOOD]]
    assert got(collect(link, deadline)) == [WRONG, GOOD]


@pytest.mark.parametrize("bad", [None, 0, 1, 2])
def test_closing_several_buses_closes_all_and_releases_the_role_although_one_close_fails(bad):
    made, closed = links(3), list[str]()
    role: Any = SimpleNamespace(close=lambda: closed.append("role"))
    if bad is None:
        Bus(made, role).close()
    else:
        made[bad].fails = OSError("gone")
        with pytest.raises(OSError, match="gone"), Bus(made, role):
            pass
    assert ([link.calls for link in made], closed) == ([["close"]] * 3, ["role"])


# several


def test_each_of_several_buses_counts_as_off_only_after_it_refused_frames_itself():
    bus, made, clock = several(3)
    made[1].takes = 0
    frames = [Frame(1, b"", BUS * k) for k in range(3)]
    assert sends(bus, *frames) == 1
    clock.t_ns += 20_000_000
    made[2].takes = 0
    assert sends(bus, *frames) == 2
    for later_ns, bits in ((29_999_999, 0b000), (1, 0b010), (19_999_999, 0b010), (1, 0b110)):
        clock.t_ns += later_ns
        sends(bus, *frames)
        assert bus.events().off == bits
    made[1].takes = 1
    sends(bus, *frames)
    assert bus.events().off == 0b100
    sends(bus, frames[0])
    assert bus.events().off == 0b100, "a bus without frames keeps its state"


def test_bus_that_accepts_some_of_its_frames_does_not_count_as_off():
    bus, made, clock = several(2)
    made[0].takes = 1
    for _ in range(3):
        assert sends(bus, *PAIR, Frame(1, b"", BUS)) == 1
        assert bus.events().off == 0
        clock.t_ns += DEAD_AFTER_NS


def test_frames_queued_for_sending_are_dropped_once_on_each_bus_that_goes_off():
    bus, made, _ = several(3)
    for k, dropped in ((0, (1, 0, 0)), (2, (1, 0, 1)), (1, (1, 1, 1))):
        made[k].off = True
        bus.events()
        assert tuple(link.calls.count("died") for link in made) == dropped
    made[2].off = False
    bus.events()
    made[2].off = True
    assert bus.events().off == 0b111
    assert [link.calls.count("died") for link in made] == [1, 1, 2]


def test_several_buses_report_the_worst_of_their_controller_states():
    bus, made, _ = several(3)
    for link, state in zip(made, (BusState.ACTIVE, BusState.PASSIVE, BusState.WARNING), strict=True):
        link.state, link.overflow = state, 3
    assert bus.events() == (0, 0, 9, BusState.PASSIVE)
    made[2].state = BusState.OFF
    assert (bus.events().off, [link.calls for link in made]) == (0b100, [[], [], ["died"]])
    made[0].knows_ends = made[1].virtual = made[2].virtual = False
    assert (Bus(made).knows_ends, Bus(made).virtual, Bus(made[1:]).virtual) == (False, True, False)


@pytest.mark.parametrize("refusing", [(0,), (1,), (2,), (0, 2)])
def test_frame_that_one_bus_cannot_carry_does_not_stop_frames_on_the_other_buses(refusing):
    bus, made, _ = several(3)
    for k in refusing:
        made[k].fails = BusError(f"bus {k}")
    with pytest.raises(BusError, match=f"bus {refusing[0]}"):
        sends(bus, *[Frame(1, b"stop", BUS * k) for k in range(3)])
    assert [len(link.sent) for link in made] == [int(k not in refusing) for k in range(3)]
    with pytest.raises(BusError, match=f"bus {refusing[0]}"):
        bus.flush_tx()
    assert [link.calls.count("flush") for link in made] == [1, 1, 1]


def test_frame_is_awaited_on_the_bus_where_its_identifier_was_last_received():
    bus, made, _ = several(3)
    made[1].looks = [[Received(3, Frame(7, b"")), Received(9, Frame(8, b""))]]
    made[2].looks = [[Received(5, Frame(9, b"")), Received(6, Frame(7, b""))]]
    found = [(each.t_ns, each.frame.id, each.frame.bus) for each in got(bus.receive())]
    assert found == [(3, 7, 1), (5, 9, 2), (6, 7, 2), (9, 8, 1)]
    bus.block(99, {7, 8, 9})
    bus.block(99, {7, 9})
    assert [link.blocked for link in made] == [[], [(99, {8})], [(99, {7, 9})]]


@pytest.mark.parametrize(
    ("one", "other", "deadline_ns", "until_ns"),
    [
        ({"end_ns": 400_000}, {"end_ns": 700_000}, 900_000_000, 400_000),
        ({"end_ns": 700_000}, {"end_ns": 400_000}, 900_000_000, 400_000),
        ({"end_ns": 700_000}, {"end_ns": 400_000}, 100_000, 100_000),
        ({"file": 9}, {}, 900_000_000, 201_000),  # without a descriptor it is polled again after 0.2 ms
        ({"file": 9}, {}, 50_000, 50_000),
    ],
)
def test_wait_on_two_buses_ends_at_the_first_end_of_a_frame_or_the_deadline(
    one, other, deadline_ns, until_ns
):
    bus, made, clock = several(2)
    for link, fields in zip(made, (one, other), strict=True):
        vars(link).update(fields)
    bus.block(deadline_ns, frozenset())
    assert clock.slept == [until_ns]
