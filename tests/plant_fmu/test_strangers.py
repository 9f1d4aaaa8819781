"""Two kinds of strangers on the bus make drives of every family run with their force, and are heard."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import ChannelSettings
from drivers.family import Family
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import DriveSetup, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Foreign, Reaction
from hil.contracts.ends import PERIOD_NS, Ends, at_tick
from plant_fmu.drives import drives_end
from plant_fmu.drives.gateway import Gateway
from plant_fmu.faults import stranger
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import BusSecondController, FramesForgedCommand
from plant_fmu.faults.plan import FaultPlan, Schedule
from tests.hil.lab.bringup.families import FAMILIES, family

FORCE_N = 30.0
BEGINS = 150
"""Tick before which all families run."""
KINDS: dict[str, Fault] = {
    "forger": FramesForgedCommand(force_N=FORCE_N, at_s=1e-9 * BEGINS * PERIOD_NS),
    "second": BusSecondController(force_N=FORCE_N, at_s=1e-9 * BEGINS * PERIOD_NS, rate_Hz=1e9 / PERIOD_NS),
}
ENABLED_BY_THEIR_OWN_FRAME = {"damiao", "cubemars", "mini_cheetah", "robstride"}
BUSES = ((0, 1, 4), (2, 3, 5))
EACH = pytest.mark.parametrize("name", sorted(FAMILIES))
BOTH = pytest.mark.parametrize("kind", KINDS)


@cache
def codec(name: str, buses: tuple[tuple[int, ...], ...] = ()) -> Family:
    """Return the family's codec, on pulleys with which all of them can say how long the legs are."""
    c = family(name)
    changes: dict[str, Any] = {"force_limit_N": 2.0 * FORCE_N}
    if c.drives.transmission is not None:
        pulleys = {"pulley_radius_m": 0.06, "offset_m": 1.75}
        changes["transmission"] = c.drives.transmission.model_copy(update=pulleys)
    channels = [ChannelSettings(channel=f"can{n}", legs=list(legs)) for n, legs in enumerate(buses)]
    bus = c.bus.model_copy(update={"channels": channels})
    return build_protocol(bus, c.drives.model_copy(update=changes))


def struck(name: str, kind: str, mode: DriveMode) -> tuple[Ends, list[Received]]:
    """Return both ends after the stranger's first frames to drives in a mode, and what is on the bus."""
    protocol = codec(name)
    ends = Ends(protocol, KINDS[kind], setup=DriveSetup(0.05, protocol.traits.reactions[0], 1e9 / PERIOD_NS))
    ends.running(np.zeros(LEGS))
    while ends.tick < BEGINS - 1:
        ends.step(Command(mode, np.zeros(LEGS)), set_up=False)
        assert ends.measurement["foreign"] == 0
    t_ns = BEGINS * PERIOD_NS + 1000
    polls = ends.protocol.begin(ends.dialogue, BEGINS) if kind == "forger" else ()
    heard = ends.nodes.step(t_ns, [Received(t_ns, frame) for frame in polls])
    return ends, [Received(*each) for each in heard]


@EACH
@BOTH
def test_drives_that_run_obey_his_force_and_the_controller_hears_him(name, kind):
    ends, heard = struck(name, kind, DriveMode.RUN)
    snapshot = ends.nodes.snapshot()
    assert snapshot.state.tolist() == [DriveState.RUN] * LEGS
    assert (snapshot.command > 0.8 * FORCE_N).all(), snapshot.command
    assert (snapshot.command < 1.3 * FORCE_N).all(), snapshot.command
    tick = at_tick(BEGINS)
    ends.protocol.decode(ends.dialogue, received_array(heard), ends.measurement, tick, BEGINS * PERIOD_NS)
    assert tick["foreign"] & Foreign.COMMAND


@EACH
@BOTH
def test_drives_that_are_ready_run_with_his_force_but_those_that_wait_for_a_frame_of_its_own(name, kind):
    ends, _ = struck(name, kind, DriveMode.READY)
    snapshot = ends.nodes.snapshot()
    if name in ENABLED_BY_THEIR_OWN_FRAME:
        assert DriveState.RUN not in snapshot.state
        assert snapshot.command.tolist() == [0.0] * LEGS
    else:
        assert snapshot.state.tolist() == [DriveState.RUN] * LEGS
        assert (snapshot.command > 0.8 * FORCE_N).all(), snapshot.command


@EACH
def test_a_forger_answers_a_poll_to_its_drive_alone_and_a_sync_to_all_on_its_bus(name):
    protocol = codec(name, BUSES)
    gateway = Gateway(
        Schedule(FaultPlan([FramesForgedCommand(force_N=FORCE_N)]), 0), protocol, drives_end(protocol), 0
    )
    end = protocol.controller_end(DriveSetup(0.05, protocol.traits.reactions[0], 250.0))
    polls = sent_frames(end.begin(0))
    assert {frame.bus for frame in polls} == {0, 1}
    for poll in polls:
        gateway.hear([Received(0, poll)], 0)
        added = [frame for _, frame in gateway.send([])]
        to = {leg for frame in added for leg in protocol.addressed(frame)}
        assert to == set(protocol.addressed(poll))
        assert {frame.bus for frame in added} == {poll.bus}


def test_a_stranger_would_set_drives_up_with_10_ms_and_their_first_reaction_at_1000_hz():
    family: Any = SimpleNamespace(
        controller_end=lambda setup: setup, traits=SimpleNamespace(reactions=(Reaction.HOLD, Reaction.BRAKE))
    )
    assert stranger._unheard(family) == DriveSetup(0.01, Reaction.HOLD, 1000.0)  # type: ignore[comparison-overlap]
