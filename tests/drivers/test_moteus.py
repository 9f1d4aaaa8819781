"""moteus: the contract, 10^4 commands byte for byte as the vendor's package makes them, replies read alike."""

from __future__ import annotations

import json
import struct
from importlib.metadata import version
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.moteus import QUERY, STOP, pad, torque_command
from drivers.protocol import BRS, EXTENDED, FD, DriveSetup, Frame, Said
from drivers.registry import loaded
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission
from hil.contracts.ends import PERIOD_NS, Ends, at_tick
from hil.contracts.messages import Configure, DeviceCommand, Rejected, Sync
from hil.contracts.protocol import ProtocolContract
from hil.contracts.trouble import TroubleContract
from tests.drivers import moteus_foreign as foreign
from tests.drivers.moteus_ends import registers
from tests.drivers.motor_families import Heard, MoteusProtocol
from tests.plant_fmu.by_hand import enter

DATA = Path(__file__).parents[1] / "data/drives"
VECTORS = json.loads((DATA / "moteus.json").read_text("utf-8"))["vectors"]
RANDOM = json.loads(foreign.FILE.read_text("utf-8"))
GEAR = Transmission(TransmissionSettings(lead_m=0.1, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75))
UNIT = Transmission(TransmissionSettings(lead_m=1.0))
NODES = (1, 2, 3, 4, 5, 126)
SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)


class TestMoteus(TroubleContract):
    RESOLUTION = (1e-7, 1e-6, 1e-3, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = ENDS = LATCHES = False
    LENGTHS, SPEED, RELATIVE = (-100.0, 100.0), 100.0, 1e-7
    RESTART = "obeys"

    @pytest.fixture
    def family(self):
        return MoteusProtocol(NODES, 0, Reaction.DAMP, 1000.0, GEAR)


class TestMoteusStopped(ProtocolContract):
    RESOLUTION = (1e-7, 1e-6, 1e-3, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = False

    @pytest.fixture
    def family(self):
        return MoteusProtocol(NODES, 10, Reaction.BRAKE, 1000.0, GEAR)


def read(data: bytes) -> str:
    said = registers(data, 0x20)
    assert said is not None
    return foreign.line(said[0], said[1], said[2], said[3], said[0xF])


def test_ten_thousand_commands_are_those_of_the_vendors_package():
    ours = foreign.digest(torque_command(t, most, wait) for _, t, most, wait in foreign.commands())
    assert (ours, RANDOM["count"]) == (RANDOM["commands"], 10_000)
    assert RANDOM["package"] == "moteus 1.1.1 from PyPI (Apache-2.0)"


def test_ten_thousand_replies_are_read_as_by_the_vendors_package():
    assert foreign.digest(read(each).encode() for each in foreign.replies()) == RANDOM["replies"]


def test_the_package_itself_where_it_is_installed_says_the_same():
    package = pytest.importorskip("moteus")
    assert version("moteus") == "1.1.1"
    for each in foreign.commands():
        assert bytes(foreign.foreign_command(package, *each).data) == torque_command(*each[1:]), each
    for data in foreign.replies():
        assert foreign.foreign_line(package, data) == read(data), data.hex()


@pytest.mark.parametrize(("sent_s", "kept_s"), [(0.03, 0.03), (float("nan"), 0.1), (0.0, 0.1)])
def test_a_command_without_a_time_leaves_the_drive_the_one_that_it_was_delivered_with(sent_s, kept_s):
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    frame = protocol.traits.cyclic_frames[3]._replace(data=pad(torque_command(0.5, 2.0, sent_s)))
    _, messages = protocol.parse(protocol.power_up(), frame)
    (kept,) = [each for each in messages if isinstance(each, Configure)]
    assert kept.leg == 3
    assert kept.watchdog_s == pytest.approx(kept_s, rel=1e-6)


def test_commands_and_stops_are_the_vectors_with_their_identifiers():
    found = {
        each["what"]: each for each in VECTORS if each["inputs"].get("query") and each["inputs"]["id"] == 1
    }
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    stop = protocol.poll(protocol.start(SETUP), 0)
    assert stop == Frame(found["stop"]["id"], pad(bytes.fromhex(found["stop"]["data"])), EXTENDED | FD | BRS)
    assert found["stop"]["extended"]
    assert STOP[-3:] == b"PPP"
    assert QUERY.hex() == next(each["data"] for each in VECTORS if each["what"] == "query default")
    limited = next(
        each for each in VECTORS if each["what"].startswith("position mode, float: torque only with limit")
    )
    data = torque_command(-1.25, 2.0, 0.1)
    assert data == bytes.fromhex(limited["data"]) + QUERY
    dialogue = protocol.start(SETUP._replace(watchdog_s=0.1))._replace(
        mode=DriveMode.RUN, torque=(-1.25,) * 6
    )
    assert protocol.poll(dialogue, 5) == Frame(0x8000 | 126, pad(data), EXTENDED | FD | BRS)
    assert len(pad(data)) == 48


@pytest.mark.parametrize(
    "vector", [v for v in VECTORS if v["what"].startswith("reply")], ids=lambda v: v["what"]
)
def test_replies_are_those_of_the_vectors(vector):
    said = registers(bytes.fromhex(vector["data"]), 0x20)
    assert said is not None
    names = {"MODE": 0, "POSITION": 1, "VELOCITY": 2, "TORQUE": 3, "Q_CURRENT": 4, "FAULT": 15}
    for name, register in names.items():
        if name in vector["decoded"] and name != "Q_CURRENT":
            value = vector["decoded"][name]
            assert said[register] == pytest.approx(float(value), rel=1e-5, nan_ok=True)
    heard = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT).hear(
        Frame(vector["id"], bytes.fromhex(vector["data"]), FD | BRS)
    )
    assert heard is not None
    fault = vector["decoded"].get("FAULT")
    if fault is None:
        assert heard.broken, "an error in place of what was asked for"
    elif fault:
        assert (heard.power, heard.fault) == (DriveState.FAULT, 0x100 + fault)


@pytest.mark.parametrize("unknown", ["position", "velocity"])
def test_a_drive_that_does_not_know_its_position_or_its_velocity_is_blind(unknown):
    figures = [nan if unknown == name else 0.5 for name in ("position", "velocity", "torque")]
    # int8 of the mode, 10; three floats from register 1; int8 of voltage, temperature and fault
    data = b"\x21\x00\x0a\x2f\x01" + struct.pack("<3f", *figures) + b"\x23\x0d\x18\x1e\x00"
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    heard = protocol.hear(Frame(NODES[2] << 8, pad(data), FD | BRS))
    assert heard is not None
    assert (heard.leg, heard.motion, heard.torque, heard.power) == (2, None, 0.5, DriveState.RUN)


@given(st.floats(-1e3, 1e3), st.integers(0, 5))
def test_a_torque_comes_out_as_the_single_that_went_in_and_saturates_at_the_limit_sent_with_it(torque, leg):
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 100.0, UNIT)
    dialogue = protocol.start(SETUP)._replace(mode=DriveMode.RUN, torque=(torque,) * 6)
    memory = protocol.power_up()._replace(enabled=(True,) * 6)
    _, (command, _) = protocol.parse(memory, protocol.poll(dialogue, leg))
    assert isinstance(command, DeviceCommand)
    expected = 2 * np.pi * float(np.float32(min(max(torque, -100.0), 100.0)))
    assert command.force[0] == pytest.approx(expected, rel=1e-12)


def test_a_drive_that_is_left_enabled_damps_when_the_time_of_its_last_command_is_over_until_a_stop():
    ends = Ends(MoteusProtocol(NODES, 0, Reaction.DAMP, 1000.0, GEAR))
    ends.running()
    waits_ns = ends.nodes._drives.seen.watchdog_ns
    np.testing.assert_allclose(waits_ns, 50e6, rtol=1e-7, err_msg="of the command, not the drive's own 0.1 s")
    for _ in range(20):
        ends.tick += 1
        ends._to_drives(ends.tick * PERIOD_NS, ())
    snapshot = ends.nodes.snapshot()
    assert snapshot.state.tolist() == [DriveState.FAULT] * 6
    assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert not snapshot.brake.any(), "it damps"
    run = Command(DriveMode.RUN, np.zeros(6))
    ends.dialogue, _ = ends.protocol.command(ends.dialogue, run, ends.tick)
    ends.step(run)
    assert ends.measurement["drive_fault"].tolist() == [DriveFault.WATCHDOG] * 6
    for _ in range(3):
        ends.step()
    assert ends.measurement["drive_state"].tolist() == [DriveState.OFF] * 6


def test_a_drive_that_restarts_in_motion_obeys_again_from_the_next_command_on():
    ends = Ends(MoteusProtocol(NODES, 0, Reaction.DAMP, 1000.0, GEAR))
    ends.running()
    ends.nodes._drives.seen.state[3], ends.nodes._drives.seen.configured[3] = DriveState.BOOT, False
    end: Any = ends.nodes._end
    end.record["enabled"] = (1, 1, 1, 0, 1, 1)
    states = []
    for _ in range(10):
        ends.step(Command(DriveMode.RUN, np.zeros(6)))
        states.append(int(ends.measurement["drive_state"][3]))
    assert states == [DriveState.RUN] * 10
    assert ends.nodes.snapshot().state[3] == DriveState.RUN


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_has_reported_a_stop_in_motion_is_not_enabled_again_until_run_is_asked_for_anew(leg):
    ends = Ends(MoteusProtocol(NODES, 0, Reaction.DAMP, 1000.0, GEAR))
    ends.running()
    enter(ends.nodes._drives, leg, DriveState.OFF, DriveFault.NONE)
    for _ in range(2):
        ends.step(Command(DriveMode.RUN, np.zeros(6)))
        assert ends.measurement["drive_state"][leg] == DriveState.BOOT
        polls = ends.protocol.begin(ends.dialogue, ends.tick + 1)
        assert [frame.data == STOP for frame in polls] == [each == leg for each in range(6)]
    for mode, states in ((DriveMode.READY, [DriveState.READY] * 6), (DriveMode.RUN, [DriveState.RUN] * 6)):
        for _ in range(3):
            ends.step(Command(mode, np.zeros(6)))
        assert ends.measurement["drive_state"].tolist() == states


def asked_by_the_package(package: Any, width: str) -> tuple[Frame, dict[int, float]]:
    """Return a query of controller 5 to drive 3, and the steps of what it asks for at that width."""
    resolution = package.QueryResolution()
    for name in ("position", "velocity", "torque", "q_current", "abs_position", "voltage", "temperature"):
        setattr(resolution, name, getattr(package, width))
    resolution._extra = {0x102: package.INT32}
    command = package.Controller(id=3, source_can_id=5, query_resolution=resolution).make_query()
    r = package.Register
    steps = {
        "INT8": {r.POSITION: 0.01, r.VELOCITY: 0.1, r.TORQUE: 0.5, r.VOLTAGE: 0.5, r.TEMPERATURE: 1.0},
        "INT16": {r.POSITION: 1e-4, r.VELOCITY: 2.5e-4, r.TORQUE: 0.01, r.VOLTAGE: 0.1, r.TEMPERATURE: 0.1},
        "INT32": {r.POSITION: 1e-5, r.VELOCITY: 1e-5, r.TORQUE: 1e-3, r.VOLTAGE: 1e-3, r.TEMPERATURE: 1e-3},
        "F32": {r.POSITION: 1e-6, r.VELOCITY: 1e-6, r.TORQUE: 1e-6, r.VOLTAGE: 1e-6, r.TEMPERATURE: 1e-6},
    }[width]
    return Frame(0x8000 | 5 << 8 | 3, pad(bytes(command.data)), EXTENDED | FD | BRS), steps


@pytest.mark.parametrize("width", ["INT8", "INT16", "INT32", "F32"])
def test_the_package_reads_what_an_emulated_drive_answers_to_its_query_at_any_width(width):
    package: Any = pytest.importorskip("moteus")
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    query, steps = asked_by_the_package(package, width)
    memory, messages = protocol.parse(protocol.power_up(), query)
    assert messages == (Sync(0, (2,)),)
    six = np.ones(6)
    states = np.full(6, DriveState.RUN, np.int64)
    force = -0.75 * six * UNIT.N_per_Nm
    _, ((leg, reply),) = protocol.answer(memory, Sync(0, (2,)), 0.123 * six, -1.5 * six, force, states)
    assert (leg, reply.id) == (2, 3 << 8 | 5)
    said, r = package.moteus.parse_reply(reply.data), package.Register
    truth = {r.POSITION: 0.123, r.VELOCITY: -1.5, r.TORQUE: -0.75, r.VOLTAGE: 24.0, r.TEMPERATURE: 30.0}
    for register, value in truth.items():
        assert said[register] == pytest.approx(value, abs=steps[register]), register
    assert (said[r.MODE], said[r.FAULT]) == (10, 0)
    assert np.isnan(said[r.Q_CURRENT])
    assert np.isnan(said[r.ABS_POSITION])
    assert 0x102 not in said, "nothing that it says: an error"


def test_who_a_drive_is_is_asked_and_answered_as_the_package_does():
    package: Any = pytest.importorskip("moteus")
    r, protocol = package.Register, MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    serial = (r.SERIAL_NUMBER1, r.SERIAL_NUMBER2, r.SERIAL_NUMBER3)
    for requests, asked in zip(
        protocol.traits.identity_requests, (serial, (r.FIRMWARE_VERSION,)), strict=True
    ):
        theirs = package.Controller(id=3).make_custom_query(dict.fromkeys(asked, package.INT32))
        assert requests[2] == Frame(0x8003, pad(bytes(theirs.data)), EXTENDED | FD | BRS)
        memory, _ = protocol.parse(protocol.power_up(), requests[2])
        states = np.full(6, DriveState.OFF, np.int64)
        _, ((_, reply),) = protocol.answer(
            memory, Sync(0, (2,)), np.ones(6), np.zeros(6), np.zeros(6), states
        )
        said = package.moteus.parse_reply(reply.data)
        assert said == dict(zip(asked, (3, 0, 0) if asked is serial else (0x010000,), strict=True))
        assert protocol.hear(reply) == Heard(2), "no feedback, and not broken"


def test_a_serial_number_has_96_bits_the_lowest_first_and_half_of_one_is_none():
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    words = struct.pack("<III", 0x80000001, 2, 0xFFFFFFFF)
    whole = Frame(0x300, pad(bytes.fromhex("2ba002") + words), FD | BRS)
    assert protocol.identity(whole) == Said(2, "serial number", 0xFFFFFFFF_00000002_80000001)
    assert protocol.identity(whole._replace(flags=0)) is None
    half = Frame(0x300, pad(bytes.fromhex("2aa002") + words[:8]), FD | BRS)
    assert protocol.identity(half) is None
    assert protocol.hear(half) == Heard(2, broken=True)


def test_a_command_to_all_drives_is_obeyed_by_all_and_one_that_wants_no_reply_gets_none():
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    torque = pad(torque_command(0.5, 2.0, 0.1))
    memory, messages = protocol.parse(protocol.power_up(), Frame(0x7F, torque, FD | BRS))
    assert memory.enabled == (True,) * 6
    legs = [each.legs for each in messages if isinstance(each, DeviceCommand) and each.mode == DriveMode.RUN]
    assert legs == [(leg,) for leg in range(6)]
    assert not [each for each in messages if isinstance(each, Sync)]
    _, messages = protocol.parse(memory, Frame(0x807F, torque, EXTENDED | FD | BRS))
    assert [each.legs for each in messages if isinstance(each, Sync)] == [(leg,) for leg in range(6)]


@pytest.mark.parametrize(
    ("what", "written"),
    [
        ("gains", "01000a0c06200000c07f000000000000003f0000803f0000803f00000040"),
        ("no gains given: the drive's own", "01000a0d220000003f"),
        ("torque without the scale of kd", "01000a0e220000003f00000000"),
        ("torque without the scale of kp", "01000a0d220000003f0d2400000000"),
        ("position", "01000a0e200000803ecdccccbd"),
        ("brake", "01000f"),
    ],
)
def test_a_command_that_an_emulated_drive_does_not_have_is_counted_and_answered(what, written):
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    frame = Frame(0x8001, pad(bytes.fromhex(written) + QUERY), EXTENDED | FD | BRS)
    _, messages = protocol.parse(protocol.power_up(), frame)
    assert isinstance(messages[0], Rejected), what
    assert messages[1:] == (Sync(0, (0,)),)


@pytest.mark.parametrize("identifier", [0x8002, 0x0002, 0x8502, 0x0502, 0x7F, 0x857F])
def test_commands_of_any_other_controller_are_foreign_with_or_without_a_reply(identifier):
    protocol = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT)
    heard = protocol.hear(Frame(identifier, STOP, FD | BRS | EXTENDED * (identifier > 0x7FF)))
    assert heard is not None
    assert heard.foreign
    assert protocol.hear(Frame(2 << 8 | 9, STOP, FD | BRS)) is None, "what a drive tells somebody else"


@pytest.mark.parametrize("data", ["21", "2100", "2f01000000", "ff", "210001", "2c", "2c7f7f", "7f01"])
def test_a_reply_that_is_not_whole_is_refused(data):
    heard = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT).hear(
        Frame(0x100, bytes.fromhex(data), FD | BRS)
    )
    assert heard is not None
    assert heard.broken
    assert at_tick(0)["rejected"] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transmission": None}, "drives.transmission: protocol moteus"),
        (
            {"node_ids": [1, 2, 3, 4, 5, 127]},
            "drives.node_ids[5]: out of range, allowed with moteus: 1 to 126",
        ),
        ({"options": {}}, "timeout_mode of protocol moteus: allowed: one of stopped, zero_velocity"),
        ({"options": {"timeout_mode": "stopped", "host_id": 3}}, "drives.node_ids[2]: out of range"),
        # 127 addresses all drives
        (
            {"options": {"timeout_mode": "stopped", "host_id": 127}},
            "drives.options: host_id of protocol moteus: allowed: a whole number of 0 to 126, given: 127",
        ),
        # 300 N x 20 mm / 2 pi = 0.955 N m
        ({"options": {"timeout_mode": "stopped", "torque_N_m": 0.9}}, "300 N need 0.9549 N m of the motor"),
        (
            {"options": {"timeout_mode": "stopped", "torque_N_m": 0.9}},
            "moteus, by drives.options: torque_N_m 0.9, carries up to 0.9 N m",
        ),
    ],
)
def test_a_row_names_what_it_does_not_have(change, message):
    values: dict[str, Any] = {
        "protocol": "moteus",
        "transmission": {"lead_m": 0.02},
        "options": {"timeout_mode": "stopped"},
        "force_limit_N": 300,
    }
    drives = DriveSettings.model_validate(values | change)
    with pytest.raises(ConfigurationError) as caught:
        loaded("hil.protocols", "moteus")(BusSettings(layout="fd"), drives)
    assert message in str(caught.value)


def test_no_pin_of_a_drive_is_used_for_its_brake_and_check_says_what_the_bench_needs():
    said = MoteusProtocol(NODES, 0, Reaction.DAMP, 2.0, UNIT).traits.dangers[0]
    assert "aux pins keep their level" in said
    assert "brakes of your own" in said
