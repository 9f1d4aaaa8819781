"""A forged command and a second controller act on drives of every family, and the controller detects them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.family import Family
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Foreign
from hil.contracts.loopback import PERIOD_NS, Ends, at_tick
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import BusSecondController, FramesForgedCommand
from tests.hil.lab.bringup.families import FAMILIES, family

FORCE_N = 30.0
BEGINS = 150
"""Tick by which the drives of all families run."""
KINDS: dict[str, Fault] = {
    "forger": FramesForgedCommand(force_N=FORCE_N, at_s=1e-9 * BEGINS * PERIOD_NS),
    "second": BusSecondController(force_N=FORCE_N, at_s=1e-9 * BEGINS * PERIOD_NS, rate_Hz=1e9 / PERIOD_NS),
}
ENABLED_BY_OWN_FRAME = {"damiao", "cubemars", "mini_cheetah", "robstride"}


@cache
def codec(name: str) -> Family:
    """Codec of a family, with pulleys so large that every family can encode the leg lengths."""
    c = family(name)
    changes: dict[str, Any] = {"force_limit_N": 2.0 * FORCE_N}
    if c.drives.transmission is not None:
        pulleys = {"pulley_radius_m": 0.06, "offset_m": 1.75}
        changes["transmission"] = c.drives.transmission.model_copy(update=pulleys)
    return build_protocol(c.bus, c.drives.model_copy(update=changes))


def struck(name: str, kind: str, mode: DriveMode) -> tuple[Ends, list[Received]]:
    """Send the first foreign frames to drives in a mode; return both ends and the frames on the bus."""
    protocol = codec(name)
    ends = Ends(protocol, KINDS[kind])
    ends.dialogue = ends.protocol.start(DriveSetup(0.05, protocol.traits.reactions[0], 1e9 / PERIOD_NS))
    ends.running(np.zeros(LEGS))
    while ends.tick < BEGINS - 1:
        ends.step(Command(mode, np.zeros(LEGS)), set_up=False)
        assert ends.measurement["foreign"] == 0
    t_ns = BEGINS * PERIOD_NS + 1000
    polls = ends.protocol.begin(ends.dialogue, BEGINS) if kind == "forger" else ()
    heard = ends.nodes.step(t_ns, [Received(t_ns, frame) for frame in polls])
    return ends, [Received(*each) for each in heard]


@pytest.mark.parametrize("name", sorted(FAMILIES))
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", [DriveMode.RUN, DriveMode.READY])
def test_drives_follow_a_command_of_a_second_controller_which_the_first_controller_detects(name, kind, mode):
    ends, heard = struck(name, kind, mode)
    snapshot = ends.nodes.snapshot()
    if mode == DriveMode.READY and name in ENABLED_BY_OWN_FRAME:
        assert DriveState.RUN not in snapshot.state
        assert snapshot.command.tolist() == [0.0] * LEGS
        return
    assert snapshot.state.tolist() == [DriveState.RUN] * LEGS
    assert (snapshot.command > 0.8 * FORCE_N).all(), snapshot.command
    assert (snapshot.command < 1.3 * FORCE_N).all(), snapshot.command
    tick = at_tick(BEGINS)
    ends.protocol.decode(ends.dialogue, received_array(heard), ends.measurement, tick, BEGINS * PERIOD_NS)
    assert tick["foreign"] & Foreign.COMMAND
