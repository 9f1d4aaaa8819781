"""The frames of a tick on several buses are those that the time of each bus counts."""

from __future__ import annotations

import pytest

from drivers.protocol import BUS
from drivers.signals import Command, DriveMode
from hil.contracts.ends import PERIOD_NS, Ends, shapes
from tests.drivers.test_several_buses import FORCE, ODD, family

HEARTBEAT = 0x700 + 127
"""Of a controller of CiA 402: no tick needs it."""


@pytest.mark.parametrize("name", ["legs", "cia402", "moteus"])
def test_the_frames_of_a_tick_are_those_that_the_time_of_each_bus_counts(name):
    ends = Ends(family(name, ODD))
    run = Command(DriveMode.RUN, FORCE)
    ends.running(FORCE)
    ends.step(run, set_up=False)
    protocol = ends.protocol
    answers = [each.frame for each in ends.received if protocol.fresh(each, ends.tick, ends.tick * PERIOD_NS)]
    sent = [frame for frame in ends.sent if frame.id != HEARTBEAT]
    named = not protocol.traits.shares_identifiers
    found = shapes((*ends.opening, *sent, *answers), named=named)
    assert found == shapes(protocol.traits.cyclic_frames, named=named)
    assert {flags // BUS for _, _, flags in found} == {0, 1}


def test_the_example_of_a_tick_begins_with_its_sync_on_every_bus():
    for name in ("legs", "cia402"):
        frames = family(name, ODD).traits.cyclic_frames
        assert [(frame.id, frame.bus) for frame in frames if frame.id == 0x080] == [(0x080, 0), (0x080, 1)]
        assert {frame.id for frame in frames[:2]} == {0x080}
