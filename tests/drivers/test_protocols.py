"""The protocol `legs` fulfils the contract, and a loop waits for, switches off and refuses any protocol."""

from __future__ import annotations

import re
from importlib import resources
from typing import cast

import numpy as np
import pytest

from drivers import build_protocol
from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import of_python
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array, received_frames, sent_frames
from drivers.legs.protocol import LegsProtocol
from drivers.mit.protocol import DISABLE
from drivers.protocol import EXTENDED, FD, Frame, Received
from drivers.sensing.settings import ImuSettings, SensorSettings
from drivers.sensors import SensorProtocol
from drivers.signals import Command, DriveMode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.sim.lockstep import Lockstep
from hil.contracts.trouble import TroubleContract
from hil.loop.clock import Deadlines
from hil.loop.daemon import switch_off

NODES = "node_ids: [1, 2, 3, 4, 5, 6]"


class LegsInTrouble(TroubleContract):
    LENGTHS = (-214.0, 214.0)
    BEATS = "set-up"
    NODES: tuple[int, ...] = (1, 2, 3, 4, 5, 6)

    def beat_ids(self, protocol):
        return {0x700 + node for node in self.NODES}


class TestLegsClassic(LegsInTrouble):
    RESOLUTION = (1e-7, 1e-4, None, 3.75)
    SPEED = 3.27

    @pytest.fixture
    def family(self):
        return LegsProtocol("classic", (1, 2, 3, 4, 5, 6))


class TestLegsFd(LegsInTrouble):
    RESOLUTION = (1e-7, 1e-7, 3.75, 1e-3)
    SPEED = 214.0
    NODES = (127, 20, 30, 40, 50, 1)

    @pytest.fixture
    def family(self):
        return LegsProtocol("fd", (127, 20, 30, 40, 50, 1))


class TestLegsIdeal(LegsInTrouble):
    RESOLUTION = (0.0, 0.0, 0.0, 0.0)
    SPEED = 1e3

    @pytest.fixture
    def family(self):
        return LegsProtocol("ideal", (1, 2, 3, 4, 5, 6))


class Wire:
    def __init__(self) -> None:
        self.sent: list[Frame] = []

    def flush_tx(self) -> None:
        """No frames wait."""

    def skew_ns(self) -> int:
        return 0

    def send(self, frames: Rows) -> int:
        self.sent += sent_frames(frames)
        return 0


def configuration(*changes: tuple[str, str], name: str = "vcan50") -> Configuration:
    text = resources.files("configs").joinpath(f"{name}.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, name)


def test_exception_in_the_control_loop_switches_off_drives_that_are_polled_by_their_command():
    cycle = build_cycle(configuration(name="desktop"), 400.0, 0.24)
    cycle.end.give(Command(DriveMode.RUN, np.full(6, 10.0)), 0)
    bus = Wire()
    switch_off(cycle, cast("Bus", bus), Deadlines(1000.0, 0.0))
    assert [frame.data for frame in bus.sent] == [DISABLE] * 5 * 6


def test_simulated_run_waits_for_fresh_drive_feedback_until_its_deadline():
    c = configuration()
    nodes, plant = build_nodes(c)
    lockstep = Lockstep(build_cycle(c, 50.0, 0.24), nodes, (BitTiming.of(c.bus),), 0.01)
    try:
        wanted, wires = lockstep.cycle.parts.protocol.traits.feedback_ids, lockstep.wires
        assert set(lockstep.step()[0].frames["id"]) >= wanted
        assert wires.record["step_ns"] < 4_000_000
        wires.record["fresh"], _keeps = of_python(lambda *_: 0, *[INTEGER] * 4)
        assert set(lockstep.step()[0].frames["id"]) >= wanted
        assert wires.record["step_ns"] == 30_000_000
    finally:
        plant.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([(NODES, f"protocol: hart\n  {NODES}")], "drives.protocol: .*odrive, given: hart"),
        ([(NODES, "node_ids: [1, 2, 3, 4, 5, 128]")], r"node_ids\[5\]: .* legs: 1 to 127, given: 128"),
        ([(NODES, f"{NODES}\n  options: {{gain: 2}}")], "protocol legs has no options, given: gain"),
        ([(NODES, f"{NODES}\n  transmission: {{lead_m: 0.005}}")], r"drives\.transmission: protocol legs"),
    ],
)
def test_invalid_settings_of_each_protocol_are_refused(changes, message):
    with pytest.raises(ConfigurationError) as caught:
        configuration(*changes)
    assert any(re.search(message, problem) for problem in caught.value.problems), caught.value.problems


def test_sync_for_sensor_time_stamps_is_sent_if_the_drive_protocol_has_none():
    bus, gear = BusSettings(layout="fd"), TransmissionSettings(lead_m=0.005)
    own = SensorProtocol(bus, SensorSettings(imu=ImuSettings(rate_Hz=50)))
    moteus = DriveSettings(protocol="moteus", transmission=gear, options={"timeout_mode": "stopped"})
    for drives, sent in ((DriveSettings(), ()), (moteus, (Frame(0x080, bytes(2)),))):
        assert own.syncs(build_protocol(bus, drives)) == sent


def test_frame_flags_contain_the_bus_index_and_are_unchanged_for_bus_0():
    frame = Frame(0x181, b"\1\2", FD)
    assert (frame.bus, Frame(0x181, b"", FD | 3 << 8).bus) == (0, 3)
    content = received_array([Received(5, frame)]).tobytes()
    assert content == bytes.fromhex("050000000000000081010000000202000102").ljust(80, b"\0")
    frames = [Received(5, frame), Received(-7, Frame(0x0A01_1000, b"", EXTENDED | 3 << 8))]
    assert list(received_frames(received_array(frames))) == frames
