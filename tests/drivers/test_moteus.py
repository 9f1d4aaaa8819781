"""moteus: the contract, and 10^4 commands and replies that agree with the vendor's package."""

from __future__ import annotations

import json
import struct
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.moteus import QUERY, STOP, pad, torque_command
from drivers.protocol import BRS, EXTENDED, FD, Frame, Said
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.loopback import PERIOD_NS, SETUP, Ends
from hil.contracts.messages import Sync
from hil.contracts.protocol import ProtocolContract
from hil.contracts.trouble import TroubleContract
from plant_fmu.drives.drive_rules import enter
from tests.drivers import moteus_foreign as foreign
from tests.drivers.motor_families import GEAR, MOTEUS_NODES, UNIT, Heard, MoteusProtocol, moteus, registers

VECTORS = json.loads((Path(__file__).parents[1] / "data/drives/moteus.json").read_text("utf-8"))["vectors"]
RANDOM = json.loads(foreign.FILE.read_text("utf-8"))
P = moteus(UNIT, 2.0)


class TestMoteus(TroubleContract):
    RESOLUTION = (1e-7, 1e-6, 1e-3, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = ENDS = LATCHES = False
    LENGTHS, SPEED, RELATIVE = (-100.0, 100.0), 100.0, 1e-7
    RESTART = "obeys"

    @pytest.fixture
    def family(self):
        return moteus()


class TestMoteusStopped(ProtocolContract):
    RESOLUTION = (1e-7, 1e-6, 1e-3, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = False

    @pytest.fixture
    def family(self):
        return MoteusProtocol(MOTEUS_NODES, 10, Reaction.BRAKE, 1000.0, GEAR, brs=False)

    def test_moteus_frames_are_can_fd_without_bit_rate_switch(self, family):
        ends = Ends(family)
        ends.until_set_up()
        found = family.traits
        for frame in (*found.cyclic_frames, *found.emergency_stop, *found.identity_requests[0]):
            assert frame.flags & (FD | BRS) == FD


def read(data: bytes) -> str:
    said = registers(data, 0x20)
    assert said is not None
    return foreign.line(said[0], said[1], said[2], said[3], said[0xF])


def test_ten_thousand_moteus_commands_equal_those_of_the_vendors_package():
    ours = foreign.digest(torque_command(t, most, wait) for _, t, most, wait in foreign.commands())
    assert (ours, RANDOM["count"]) == (RANDOM["commands"], 10_000)
    assert RANDOM["package"] == "moteus 1.1.1 from PyPI (Apache-2.0)"


def test_ten_thousand_moteus_replies_are_decoded_as_by_the_vendors_package():
    assert foreign.digest(read(each).encode() for each in foreign.replies()) == RANDOM["replies"]


def test_moteus_commands_and_replies_agree_with_the_installed_vendor_package():
    package = pytest.importorskip("moteus")
    assert version("moteus") == "1.1.1"
    for each in foreign.commands():
        assert bytes(foreign.foreign_command(package, *each).data) == torque_command(*each[1:]), each
    for data in foreign.replies():
        assert foreign.foreign_line(package, data) == read(data), data.hex()


def test_moteus_command_and_stop_frames_have_the_recorded_bytes_and_identifiers():
    stop = next(
        v for v in VECTORS if v["what"] == "stop" and v["inputs"].get("query") and v["inputs"]["id"] == 1
    )
    sent = Frame(stop["id"], pad(bytes.fromhex(stop["data"])), EXTENDED | FD | BRS)
    assert P.poll(P.start(SETUP), 0) == sent
    assert stop["extended"]
    assert QUERY.hex() == next(v["data"] for v in VECTORS if v["what"] == "query default")
    limited = next(v for v in VECTORS if v["what"].startswith("position mode, float: torque only with limit"))
    data = torque_command(-1.25, 2.0, 0.1)
    assert data == bytes.fromhex(limited["data"]) + QUERY
    start = P.start(SETUP._replace(watchdog_s=0.1))._replace(mode=DriveMode.RUN, torque=(-1.25,) * 6)
    assert P.poll(start, 5) == Frame(0x8000 | 126, pad(data), EXTENDED | FD | BRS)
    assert len(pad(data)) == 48


# the drive without a controller


def test_enabled_drive_damps_after_its_command_times_out_until_a_stop():
    ends = Ends(moteus())
    ends.running()
    np.testing.assert_allclose(ends.nodes._drives.seen.watchdog_ns, 50e6, rtol=1e-7, err_msg="of the command")
    for _ in range(20):
        ends.tick += 1
        ends._to_drives(ends.tick * PERIOD_NS, ())
    snapshot = ends.nodes.snapshot()
    assert snapshot.state.tolist() == [DriveState.FAULT] * 6
    assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert not snapshot.brake.any(), "the watchdog reaction is to damp, with the brake open"
    run = Command(DriveMode.RUN, np.zeros(6))
    ends.dialogue, _ = ends.protocol.command(ends.dialogue, run, ends.tick)
    ends.step(run)
    assert ends.measurement["drive_fault"].tolist() == [DriveFault.WATCHDOG] * 6
    for _ in range(3):
        ends.step()
    assert ends.measurement["drive_state"].tolist() == [DriveState.OFF] * 6


@pytest.mark.parametrize("leg", range(6))
def test_drive_that_switched_off_in_motion_is_enabled_only_after_another_mode_and_a_new_run(leg):
    ends = Ends(moteus())
    ends.running()
    enter(ends.nodes._drives.seen, leg, DriveState.OFF, DriveFault.NONE)
    for _ in range(2):
        ends.step(Command(DriveMode.RUN, np.zeros(6)))
        assert ends.measurement["drive_state"][leg] == DriveState.BOOT
        polls = ends.protocol.begin(ends.dialogue, ends.tick + 1)
        assert [frame.data == STOP for frame in polls] == [each == leg for each in range(6)]
    for mode, states in ((DriveMode.READY, [DriveState.READY] * 6), (DriveMode.RUN, [DriveState.RUN] * 6)):
        for _ in range(3):
            ends.step(Command(mode, np.zeros(6)))
        assert ends.measurement["drive_state"].tolist() == states


# the vendor's package and an emulated drive


STEPS = {
    "INT8": (0.01, 0.1, 0.5, 0.5, 1.0),
    "INT16": (1e-4, 2.5e-4, 0.01, 0.1, 0.1),
    "INT32": (1e-5, 1e-5, 1e-3, 1e-3, 1e-3),
    "F32": (1e-6,) * 5,
}


@pytest.mark.parametrize("width", STEPS)
def test_vendors_package_reads_emulated_moteus_answers_of_every_register_width(width):
    package: Any = pytest.importorskip("moteus")
    resolution = package.QueryResolution()
    for name in ("position", "velocity", "torque", "q_current", "abs_position", "voltage", "temperature"):
        setattr(resolution, name, getattr(package, width))
    resolution._extra = {0x102: package.INT32}
    command = package.Controller(id=3, source_can_id=5, query_resolution=resolution).make_query()
    query = Frame(0x8000 | 5 << 8 | 3, pad(bytes(command.data)), EXTENDED | FD | BRS)
    memory, messages = P.parse(P.power_up(), query)
    assert messages == (Sync(0, (2,)),)
    six, states = np.ones(6), np.full(6, DriveState.RUN, np.int64)
    reading = 0.123 * six, -1.5 * six, -0.75 * six * UNIT.N_per_Nm, states
    _, ((leg, reply),) = P.answer(memory, Sync(0, (2,)), *reading)
    assert (leg, reply.id) == (2, 3 << 8 | 5)
    said, r = package.moteus.parse_reply(reply.data), package.Register
    names = r.POSITION, r.VELOCITY, r.TORQUE, r.VOLTAGE, r.TEMPERATURE
    for name, value, step in zip(names, (0.123, -1.5, -0.75, 24.0, 30.0), STEPS[width], strict=True):
        assert said[name] == pytest.approx(value, abs=step), name
    assert (said[r.MODE], said[r.FAULT]) == (10, 0)
    assert np.isnan([said[r.Q_CURRENT], said[r.ABS_POSITION]]).all()
    assert 0x102 not in said, "unknown register: an error"


def test_moteus_identity_request_and_answer_agree_with_the_vendors_package():
    package: Any = pytest.importorskip("moteus")
    r = package.Register
    serial = (r.SERIAL_NUMBER1, r.SERIAL_NUMBER2, r.SERIAL_NUMBER3)
    for requests, asked in zip(P.traits.identity_requests, (serial, (r.FIRMWARE_VERSION,)), strict=True):
        theirs = package.Controller(id=3).make_custom_query(dict.fromkeys(asked, package.INT32))
        assert requests[2] == Frame(0x8003, pad(bytes(theirs.data)), EXTENDED | FD | BRS)
        memory, _ = P.parse(P.power_up(), requests[2])
        off = np.full(6, DriveState.OFF, np.int64)
        _, ((_, reply),) = P.answer(memory, Sync(0, (2,)), np.ones(6), np.zeros(6), np.zeros(6), off)
        said = package.moteus.parse_reply(reply.data)
        assert said == dict(zip(asked, (3, 0, 0) if asked is serial else (0x010000,), strict=True))
        assert P.hear(reply) == Heard(2), "no feedback, and not broken"


def test_moteus_identity_has_a_96_bit_serial_number_lowest_word_first_and_a_32_bit_version():
    words = struct.pack("<III", 0x80000001, 2, 0xFFFFFFFF)
    whole = Frame(0x300, pad(bytes.fromhex("2ba002") + words), FD | BRS)
    assert P.identity(whole) == Said(2, "serial number", 0xFFFFFFFF_00000002_80000001)
    assert P.identity(whole._replace(flags=0)) is None
    half = Frame(0x300, pad(bytes.fromhex("2aa002") + words[:8]), FD | BRS)
    assert P.identity(half) is None
    assert P.hear(half) == Heard(2, broken=True)
    version = Frame(0x300, pad(bytes.fromhex("298102") + struct.pack("<i", -2)), FD | BRS)
    assert P.identity(version) == Said(2, "revision", 0xFFFFFFFE)


# settings


def made(layout: Any = "fd", **changes: Any) -> Any:
    values = {"protocol": "moteus", "transmission": {"lead_m": 0.02}, "force_limit_N": 300}
    values |= {"options": {"timeout_mode": "stopped"}, "node_ids": [7, 2, 3, 4, 5, 6]}
    return build_protocol(BusSettings(layout=layout), DriveSettings.model_validate(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transmission": None}, r"drives\.transmission: protocol moteus"),
        ({"layout": "classic"}, r"bus\.layout: .*given: classic"),
        ({"options": {}}, "timeout_mode of protocol moteus"),
        *(
            ({"node_ids": [1, 2, 3, 4, 5, n], "options": {"timeout_mode": "stopped", "host_id": 9}}, rf"\[5\]: .*given: {n}")
            for n in (0, 9, 127)
        ),
        # 127 addresses all drives
        *(({"options": {"timeout_mode": "stopped", "host_id": n}}, f"host_id of .*given: {n}") for n in (-1, 127)),
        # 300 N x 20 mm / 2 pi = 0.955 N m
        ({"options": {"timeout_mode": "stopped", "torque_N_m": 0.9}}, r"300 N need 0\.9549 N m .* up to 0\.9 N m"),
    ],
)  # fmt: skip
def test_invalid_setting_of_moteus_drives_is_refused_with_its_key(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        made(**changes)


@pytest.mark.parametrize(
    ("mode", "reaction", "number"), [("stopped", Reaction.BRAKE, 0), ("zero_velocity", Reaction.DAMP, 12)]
)
def test_configured_settings_reach_the_moteus_codec(mode, reaction, number):
    protocol = made(options={"timeout_mode": mode, "host_id": 9, "torque_N_m": 1.5})
    assert protocol.traits.feedback_ids == {node << 8 | 9 for node in (7, 2, 3, 4, 5, 6)}
    assert (protocol.traits.reactions, protocol.torque_limit) == ((reaction,), 1.5)
    assert f"set it to {number}," in protocol.traits.dangers[1]
    plain = made(options={"timeout_mode": mode})
    assert (plain.torque_limit, plain.traits.emergency_stop[0].id) == (1e4, 0x8007)
    for host in (0, 126):
        found = made(options={"timeout_mode": mode, "host_id": host}).traits.feedback_ids
        assert found == {node << 8 | host for node in (7, 2, 3, 4, 5, 6)}
