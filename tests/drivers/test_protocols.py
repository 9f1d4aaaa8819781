"""The protocol `legs` fulfils the contract, and an unrelated protocol runs and replays."""

from __future__ import annotations

import re
from importlib import resources
from importlib.metadata import EntryPoint
from typing import Any, cast

import numpy as np
import pytest

from drivers import build_protocol
from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import of_python
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array, received_frames, sent_frames
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import EXTENDED, FD, Frame, Received
from drivers.registry import registered
from drivers.sensors import SensorProtocol
from drivers.signals import Command, DriveMode, DriveState, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import Configuration, json_schema, loads
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.contracts.loopback import Ends
from hil.contracts.messages import DeviceCommand, hear
from hil.contracts.protocol import ProtocolContract
from hil.contracts.trouble import TroubleContract
from hil.loop.clock import Deadlines
from hil.loop.daemon import switch_off
from hil.loop.report import waiting_text
from hil.record.log import Log
from plant_fmu.drives import drives_end
from tests.drivers.stub_protocol import MOST_SET_UP, StubProtocol

NODES = "node_ids: [1, 2, 3, 4, 5, 6]"
STUB = EntryPoint("stub", "tests.drivers.stub_protocol:stub", "hil.protocols")
STUB_NODES = "protocol: stub\n  node_ids: [4096, 513, 770, 1027, 1284, 65535]"


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


class TestStub(ProtocolContract):
    RESOLUTION = (1e-7, 1e-7, 5e-4, 5e-4)

    @pytest.fixture
    def family(self):
        return StubProtocol([4096, 513, 770, 1027, 1284, 65535])

    def test_protocol_of_another_package_may_have_own_fault_codes_and_polls_in_place_of_sync(self, protocol):
        ends = Ends(protocol)
        ends.until_set_up()
        for _ in range(3):
            ends.step(first=protocol.traits.emergency_stop)
            assert len(ends.opening) == 6
        assert ends.measurement["drive_fault"].tolist() == [0x7302] * 6


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


@pytest.fixture
def row(monkeypatch):
    """One more entry point, which no other test sees in the schema."""
    monkeypatch.setitem(registered("hil.protocols"), "stub", STUB)
    json_schema.cache_clear()
    yield
    json_schema.cache_clear()


def configuration(*changes: tuple[str, str], name: str = "vcan50") -> Configuration:
    text = resources.files("configs").joinpath(f"{name}.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, name)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("stub") / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registered("hil.protocols"), "stub", STUB)
        summary = simulate(configuration((NODES, STUB_NODES)), log=path, duration_s=3.0)
    return summary, Log.open(path)


def test_run_with_a_protocol_of_another_package_replays_to_the_bit(recorded):
    summary, log = recorded
    assert summary["success"], summary
    rows = log.rows()
    assert rows["mode"][-1] == Mode.PARKED
    assert {Mode.LOADING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING} <= set(rows["mode"].tolist())
    assert summary["rejected_frames"] == 0
    assert (rows["age"][3:] == 0).all()
    assert summary["replay"]["exact"], summary["replay"]
    assert summary["replay"]["ticks"] == len(rows)


def test_frames_and_dbc_database_of_the_drive_protocol_are_in_the_log(recorded):
    _, log = recorded
    assert log.attachments["stub.dbc"] == b'VERSION ""\n'
    assert "legs.dbc" not in log.attachments
    ticks = list(log.ticks())
    sent = [frame for tick in ticks for frame in tick.sent]
    assert {frame.flags for frame in sent} == {EXTENDED}
    assert min(frame.id for frame in sent) > 0x7FF
    sizes = [len(tick.sent) for tick in ticks]
    assert max(sizes) == 6 + MOST_SET_UP, "six polls and the dialogue"
    assert sizes[-1] == 6


def test_exception_in_the_control_loop_switches_off_drives_that_are_polled_by_their_command(row):
    cycle = build_cycle(configuration((NODES, STUB_NODES)), 50.0, 0.24)
    run = Command(DriveMode.RUN, np.full(6, 100.0))
    cycle.end.give(run, 0)
    bus = Wire()
    switch_off(cycle, cast("Bus", bus), Deadlines(1000.0, 0.0))
    assert len(bus.sent) == 5 * 6
    heard = [hear(drives_end(cycle.parts.protocol), frame)[0] for frame in bus.sent]
    assert {each.mode for each in heard if isinstance(each, DeviceCommand)} == {DriveMode.OFF}


@pytest.mark.parametrize("change", [(NODES, STUB_NODES), (NODES, NODES)])
def test_simulated_run_waits_for_fresh_drive_feedback_until_its_deadline(row, change):
    c = configuration(change)
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


def test_drive_with_incomplete_set_up_is_reported_and_a_reset_restarts_its_set_up(row):
    cycle = build_cycle(configuration((NODES, STUB_NODES)), 50.0, 0.24)
    cycle.tick["drive_state"], cycle.tick["age"] = DriveState.OFF, 0
    end: Any = cycle.end
    before = end.remembered()
    end.remember(before._replace(done=(3, 3, 3, 3, 1, 3)))
    assert "drive 4 does not complete its set-up: exchange 1 of 3" in waiting_text(cycle)
    cycle.reset()
    assert end.remembered() == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([(NODES, f"protocol: hart\n  {NODES}")], "drives.protocol: .*stub, given: hart"),
        ([(NODES, "node_ids: [1, 2, 3, 4, 5, 128]")], r"node_ids\[5\]: .* legs: 1 to 127, given: 128"),
        ([(NODES, STUB_NODES.replace("513", "65536"))], r"node_ids\[1\]: .* 0 to 65535, given: 65536"),
        ([(NODES, f"{NODES}\n  options: {{gain: 2}}")], "protocol legs has no options, given: gain"),
        ([(NODES, f"{NODES}\n  transmission: {{lead_m: 0.005}}")], r"drives\.transmission: protocol legs"),
        (
            [("layout: classic  ", "layout: ideal  "), (NODES, STUB_NODES)],
            "bus.layout: .* classic, fd, given: ideal",
        ),
    ],
)
def test_invalid_settings_of_each_protocol_are_refused(row, changes, message):
    with pytest.raises(ConfigurationError) as caught:
        configuration(*changes)
    assert any(re.search(message, problem) for problem in caught.value.problems), caught.value.problems


def test_sync_for_sensor_time_stamps_is_sent_if_the_drive_protocol_has_none(row):
    sensors = (
        ("layout: classic  ", "layout: fd  "),
        ("recording:\n", "sensors:\n  imu: {rate_Hz: 50}\n\nrecording:\n"),
    )
    for drives, sent in (((), ()), (((NODES, STUB_NODES),), (Frame(0x080, bytes(2)),))):
        c = configuration(*drives, *sensors)
        own = SensorProtocol(c.bus, c.sensors)
        assert own.syncs(build_protocol(c.bus, c.drives)) == sent


def test_frame_flags_contain_the_bus_index_and_are_unchanged_for_bus_0():
    frame = Frame(0x181, b"\1\2", FD)
    assert (frame.bus, Frame(0x181, b"", FD | 3 << 8).bus) == (0, 3)
    content = received_array([Received(5, frame)]).tobytes()
    assert content == bytes.fromhex("050000000000000081010000000202000102").ljust(80, b"\0")
    frames = [Received(5, frame), Received(-7, Frame(0x0A01_1000, b"", EXTENDED | 3 << 8))]
    assert list(received_frames(received_array(frames))) == frames
