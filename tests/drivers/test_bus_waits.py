"""Waiting on several buses, no longer than needed."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.clock import Clock
from tests.drivers.fake_links import FakeLink, ManualClock

DEADLINE_NS = 900_000_000


def waits_on(clock: Clock, deadline_ns: int, *made: dict[str, Any]) -> None:
    links = [FakeLink(clock) for _ in made]
    for link, fields in zip(links, made, strict=True):
        vars(link).update(fields)
    Bus(links).block(deadline_ns, frozenset())


@pytest.mark.parametrize(
    ("one", "other", "deadline_ns", "until_ns"),
    [
        ({"end_ns": 400_000}, {"end_ns": 700_000}, DEADLINE_NS, 400_000),
        ({"end_ns": 700_000}, {"end_ns": 400_000}, DEADLINE_NS, 400_000),
        ({"end_ns": 700_000}, {"end_ns": 400_000}, 100_000, 100_000),
        ({"file": 9}, {}, DEADLINE_NS, 201_000),  # without a descriptor it is polled again after 0.2 ms
        ({"file": 9}, {}, 50_000, 50_000),
    ],
)
def test_wait_on_two_buses_ends_at_the_first_end_of_a_frame_or_the_deadline(
    one, other, deadline_ns, until_ns
):
    clock = ManualClock()
    waits_on(clock, deadline_ns, one, other)
    assert clock.slept == [until_ns]


class Bench(BenchClock):
    """A bench clock that stands still or runs. State: promises received, and its reading."""

    def __init__(self, *, stood: bool = False) -> None:
        self.stood, self.t_ns, self.promises = stood, 1_000_000, list[Any]()

    def now(self) -> int:
        return self.t_ns

    def stands(self) -> bool:
        return self.stood

    def waiting(self, until_ns: int) -> None:
        self.promises.append(until_ns)

    def working(self, allowed_ns: int = 0) -> None:
        self.promises.append("works")


@pytest.mark.parametrize(
    ("stood", "link", "deadline_ns", "wait_s"),
    [
        (False, {}, 81_000_000, 0.08),
        (True, {}, 81_000_000, 1e-3),
        (False, {"off": True}, 81_000_000, 1e-3),
        (True, {}, 1_500_000, 0.0005),
        (False, {}, 1_000_000, None),  # the deadline is over
        (False, {"quiet": False}, 81_000_000, None),  # a frame arrived between two polls
    ],
)
def test_select_waits_to_the_deadline_or_1_ms_if_a_bus_is_off_or_simulated_time_pauses(
    monkeypatch, stood, link, deadline_ns, wait_s
):
    waits: list[Any] = []
    monkeypatch.setattr("select.select", lambda *given: waits.append(given))
    clock = Bench(stood=stood)
    waits_on(clock, deadline_ns, {"file": 0}, {"file": 9, **link})
    assert waits == ([([0, 9], [], [], wait_s)] if wait_s else [])
    assert clock.promises == [deadline_ns, "works"]
