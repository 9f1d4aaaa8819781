"""Waiting on several buses, no longer than needed."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.can.bus import Bus
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
