"""A family on several buses says of itself what it says on one: nothing is left out, changed or made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.protocol import BUS
from drivers.several_buses import SeveralBuses
from drivers.signals import Command, DriveMode
from tests.drivers.protocol_contract import PERIOD_NS, Ends, shapes
from tests.drivers.test_several_buses import FORCE, ODD, family

TRAITS = [
    "database",
    "feedback_ids",
    "shares_identifiers",
    "command_delay_ticks",
    "set_up_frames",
    "reset_ticks",
    "reactions",
    "dangers",
    "answers_name_sync",
    "latches_together",
    "unasked_s",
    "force_on_brakes",
    "has_watchdog",
    "power_told",
    "stop_latches",
]
ASKED = {
    "resolution": ("rate",),
    "reported_lengths": (),
    "carried": ("dialogue", "force"),
    "fault_text": ("code",),
    "legs_set_up": ("dialogue",),
    "set_up_lacks": ("dialogue",),
    "start": ("set-up",),
}
HALVES = ((0, 1, 2), (3, 4, 5))
HEARTBEAT = 0x700 + 127
"""Of a controller of CiA 402: no tick needs it."""


def several(**family: Any) -> Any:
    made: Any = SimpleNamespace(**family)
    return SeveralBuses(made, HALVES)


@pytest.mark.parametrize("name", TRAITS)
def test_a_trait_is_that_of_the_family(name):
    own = object()
    assert getattr(several(**{name: own}), name) is own


@pytest.mark.parametrize("name", ASKED)
def test_what_it_is_asked_the_family_is_asked_with_the_same_words(name):
    asked: list[tuple[Any, ...]] = []
    answer = object()

    def answered(*given: Any) -> object:
        asked.append(given)
        return answer

    assert getattr(several(**{name: answered}), name)(*ASKED[name]) is answer
    assert asked == [ASKED[name]]


@pytest.mark.parametrize("name", ["legs", "cia402", "moteus"])
def test_the_frames_of_a_tick_are_those_that_the_time_of_each_bus_counts(name):
    ends = Ends(family(name, ODD))
    run = Command(DriveMode.RUN, FORCE)
    ends.running(FORCE)
    ends.step(run, set_up=False)
    protocol = ends.protocol
    answers = [each.frame for each in ends.received if protocol.fresh(each, ends.tick, ends.tick * PERIOD_NS)]
    sent = [frame for frame in ends.sent if frame.id != HEARTBEAT]
    named = not protocol.shares_identifiers
    found = shapes((*ends.opening, *sent, *answers), named=named)
    assert found == shapes(protocol.cyclic_frames(), named=named)
    assert {flags // BUS for _, _, flags in found} == {0, 1}


def test_the_example_of_a_tick_begins_with_its_sync_on_every_bus():
    for name in ("legs", "cia402"):
        frames = family(name, ODD).cyclic_frames()
        assert [(frame.id, frame.bus) for frame in frames if frame.id == 0x080] == [(0x080, 0), (0x080, 1)]
        assert {frame.id for frame in frames[:2]} == {0x080}
