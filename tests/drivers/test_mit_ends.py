"""MIT framing frame by frame: commands and answers of emulated drives, decoded replies, frames to drives."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.errors import ProtocolError
from drivers.mit.protocol import CLEAR, DISABLE, ENABLE, ZERO
from drivers.protocol import BUS, EXTENDED, FD, REMOTE, DriveSetup, Frame
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command
from hil.contracts.messages import Answer, Configure, Rejected, Sync
from tests.drivers.motor_families import MIT_NODES, ROBSTRIDE_NODES, UNLIKE, Heard, mit, robstride, sent_to

VARIANTS: dict[str, Any] = {name: mit(name, UNLIKE) for name in ("mini_cheetah", "cubemars", "damiao")}
DAMIAO = VARIANTS["damiao"]
FOUR = VARIANTS | {"robstride": robstride(UNLIKE)}
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
STEP_Nm = 288.0 / 4095
OFF, RUN, FAULT = DriveState.OFF, DriveState.RUN, DriveState.FAULT
SYNC, REFUSED = (Sync(0, (3,)),), (Rejected(),)
HALF = struct.pack(">HHHH", 0x7FFF, 0x7FFF, 0, 0)
"""Position and velocity in the middle of their ranges, no gains."""

every_variant = pytest.mark.parametrize("name", VARIANTS)
every_one = pytest.mark.parametrize("name", FOUR)


def to(name: str, what: str, leg: int = 3, torque_Nm: float = 0.0) -> Frame:
    """Request to a drive: idle, enable, clear, or drive with a torque."""
    kinds = {"idle": DISABLE, "enable": ENABLE, "clear": CLEAR if name == "damiao" else DISABLE}
    if name != "robstride":
        code = int((torque_Nm + 144.0) / STEP_Nm)
        drive = (0x7FFF7FF0000 << 20 & ~0xFFF | code).to_bytes(8, "big")
        return Frame(MIT_NODES[leg], kinds.get(what, drive))
    kind, middle, data = (
        {"idle": 4, "enable": 3, "clear": 4}.get(what, 1),
        253,
        bytes((what == "clear", *bytes(7))),
    )
    if what == "drive":
        middle, data = int((torque_Nm + 144.0) * 65535 / 288.0), HALF
    return Frame(kind << 24 | middle << 8 | ROBSTRIDE_NODES[leg], data, EXTENDED)


# what drives obey


def parsed(name: str, *frames: Frame, memory: Remembered | None = None) -> tuple[Remembered, list[Any]]:
    return sent_to(FOUR[name], *frames, memory=memory)


@every_one
def test_drive_obeys_torques_only_while_it_is_enabled(name):
    protocol, torques = FOUR[name], (66.5, -73.2)
    drive, other = (to(name, "drive", torque_Nm=torque) for torque in torques)
    enable, disable = to(name, "enable"), to(name, "idle")
    memory, found = parsed(name, drive, enable, drive, enable, other, disable, other, enable)
    taken = [float((protocol.coded(np.full(6, torque)) * UNLIKE.N_per_Nm)[3]) for torque in torques]
    delivered = (Configure(3, 1e6, Reaction.BRAKE),)
    enabled = [
        (*delivered, command(3, DriveMode.READY, k), command(3, DriveMode.RUN, k + 1), *SYNC) for k in (1, 6)
    ]
    assert found == [
        SYNC,
        enabled[0],
        (command(3, DriveMode.RUN, 3, taken[0]), *SYNC),
        SYNC,
        (command(3, DriveMode.RUN, 4, taken[1]), *SYNC),
        (command(3, DriveMode.OFF, 5), *delivered * (name in {"mini_cheetah", "cubemars"}), *SYNC),
        SYNC,
        enabled[1],
    ]
    assert memory.heard == (0, 0, 0, 7, 0, 0)
    assert memory.enabled == (False, False, False, True, False, False)
    steps = 65535 if name == "robstride" else 4095
    for torque in (66.5, -73.2, 0.0, 143.0, -144.0):
        code = np.floor((torque + 144.0) * steps / 288.0)
        assert protocol.coded(np.full(6, torque)) == pytest.approx(code * 288.0 / steps - 144.0, abs=1e-9)
    most = 144.0 if name == "robstride" else 0xFFB * STEP_Nm - 144.0
    assert protocol.torque_limit == pytest.approx(most, rel=1e-12)


@every_one
def test_clear_frame_resets_drives_that_support_it_and_drives_ignore_an_invalid_frame(name):
    running = FOUR[name].power_up()._replace(enabled=(True,) * 6)
    clear = to(name, "clear") if name == "robstride" else Frame(4, CLEAR)
    memory, ((first, *_),) = parsed(name, clear, memory=running)
    resets = name in {"damiao", "robstride"}
    assert first.mode == (DriveMode.RESET if resets else DriveMode.RUN)
    assert memory.enabled[3] != resets
    enable = to(name, "enable")
    cut, stray = enable._replace(data=enable.data[:7]), enable._replace(id=enable.id ^ 2)
    memory, found = parsed(
        name, cut, stray, *(enable._replace(flags=enable.flags ^ f) for f in (EXTENDED, FD, REMOTE, BUS))
    )
    assert found == [REFUSED, *[()] * 5]
    assert not any(memory.enabled)
    if name != "robstride":
        assert parsed(name, Frame(4, ZERO))[1] == [REFUSED + SYNC]


@every_one
def test_frame_to_each_drive_depends_on_commanded_mode_drive_state_and_whether_it_was_enabled(name):
    protocol, torques = FOUR[name], (10.0, -20.0, 30.0, 40.0, 50.0, -144.0)
    six: dict[str, Any] = {"power": (1, 3, 4, 1, 0, 4), "ran": (False, False, False, True, False, True)}
    start = protocol.start(SETUP)._replace(torque=torques, **six)
    for mode in DriveMode:
        asks = ["idle"] * 6
        if mode == DriveMode.RUN:
            asks = ["enable", "drive"] * 3
        if mode == DriveMode.RESET:
            asks[2] = asks[5] = "clear"
        expected = tuple(to(name, what, leg, torques[leg]) for leg, what in enumerate(asks))
        assert protocol.begin(start._replace(mode=int(mode)), 0) == expected
    assert protocol.traits.emergency_stop == tuple(to(name, "idle", leg) for leg in range(6))
    assert protocol.traits.cyclic_frames[:6] == tuple(to(name, "drive", leg, -144.0) for leg in range(6))


# Damiao's registers


READ, WRITE = 0x33, 0x55


def request(kind: int, register: int, value: bytes = bytes(4), node: int = 4) -> Frame:
    return Frame(0x7FF, struct.pack("<HBB", node, kind, register) + value)


def reply(kind: int, register: int, value: bytes) -> Answer:
    return Answer(3, Frame(20, bytes((4, 0, kind, register)) + value))


def test_damiao_register_keeps_its_written_value_and_a_written_watchdog_acts_at_once():
    ticks, one, other = struct.pack("<I", 1000), struct.pack("<I", 1), struct.pack("<f", 7.5)
    limit = Configure(3, 0.05, Reaction.BRAKE)
    memory, found = parsed(
        "damiao",
        request(WRITE, 9, ticks),
        request(WRITE, 10, one),
        request(READ, 9),
        Frame(4, ENABLE),
        request(WRITE, 9, bytes(4)),
        request(WRITE, 21, other),
        request(READ, 21),
    )
    assert found == [
        (limit, reply(WRITE, 9, ticks)),
        (reply(WRITE, 10, one),),
        (reply(READ, 9, ticks),),
        (limit, command(3, DriveMode.READY, 1), command(3, DriveMode.RUN, 2), *SYNC),
        (reply(WRITE, 9, bytes(4)),),
        (reply(WRITE, 21, other),),
        (reply(READ, 21, other),),
    ]
    assert memory.registers[3][:3] == [1.0, 0.0, 7.5]
    assert [each[0] for each in memory.registers] == [leg == 3 for leg in range(6)]


def test_damiao_drive_obeys_register_requests_to_its_node_and_refuses_invalid_ones():
    memory = DAMIAO.power_up()
    for leg, node in enumerate(MIT_NODES):
        for kind in (READ, WRITE):
            own, other = (request(kind, 10, node=each) for each in (node, 1 << 8 | node))
            assert (DAMIAO.addressed(own), DAMIAO.addressed(other)) == ((leg,), ())
            assert DAMIAO.parse(memory, own)[1]
            assert DAMIAO.parse(memory, other) == (memory, ())
    assert [DAMIAO.addressed(Frame(0x7FF, data)) for data in (b"\4", b"")] == [(), ()]
    assert VARIANTS["cubemars"].addressed(request(READ, 9)) == ()
    assert parsed("damiao", request(0xCC, 0))[1] == [SYNC], "a request for feedback"
    # short; unknown node; no node; unknown register; identity registers, which are read-only
    unknown = request(0xCC, 0, b"\0\0\0"), request(0xCC, 0, node=9), Frame(0x7FF, b"\4"), request(READ, 8)
    assert parsed("damiao", *unknown, request(WRITE, 14), request(WRITE, 15))[1] == [REFUSED] * 6


# what drives send


@pytest.mark.parametrize(
    ("fault", "cubemars", "damiao"),
    [
        (DriveFault.NONE, 0, 0),
        (DriveFault.WATCHDOG, 0, 13),
        (DriveFault.ESTOP, 0, 0),
        (DriveFault.OVERFORCE, 2, 10),
        (DriveFault.SENSOR, 5, 8),
        (DriveFault.STROKE, 0, 14),
    ],
)
def test_each_mit_variant_reports_state_and_fault_in_its_own_field_of_the_reply(fault, cubemars, damiao):
    faults = np.array([0, 0, fault, 0, 0, 0])
    for state in DriveState:
        states = np.array([1, 1, state, 1, 1, 1])
        frames = {}
        for name, protocol in VARIANTS.items():
            six = np.ones(6)
            frames[name] = protocol.answer(protocol.power_up(), Sync(0), six, six, six, states, faults)[1][2][
                1
            ]
            assert frames[name].id == (19 if name == "damiao" else 0)
            assert name == "damiao" or frames[name].data[0] == 3
        assert frames["cubemars"].data[6:] == bytes((30, cubemars if state == FAULT else 0))
        assert frames["mini_cheetah"].data[6:] == b"\x99"
        status = damiao if state == FAULT else int(state == RUN)
        assert frames["damiao"].data[0] == status << 4 | 3
        assert frames["damiao"].data[6:] == bytes((30, 30))


# what replies are heard as


REST = bytes((0x80, 0, 0x80, 8, 0, 30, 30))


@pytest.mark.parametrize("status", range(16))
def test_status_code_of_a_damiao_reply_is_a_state_a_fault_or_invalid(status):
    heard = DAMIAO.hear(Frame(19, bytes((status << 4 | 3,)) + REST))
    if status in (2, 3, 4, 5, 6, 7, 15):
        assert heard == Heard(2, broken=True)
        return
    known = {0: (OFF, 0), 1: (RUN, 0), 13: (FAULT, DriveFault.WATCHDOG)}
    power, fault = known.get(status, (FAULT, 0x100 + status))
    assert (heard.leg, heard.power, heard.fault, heard.feedback) == (2, power, fault, True)


@pytest.mark.parametrize(
    ("name", "sizes"), [("mini_cheetah", (6, 7)), ("cubemars", (6, 7, 8)), ("damiao", (8,))]
)
def test_reply_of_wrong_length_or_unknown_node_counts_as_invalid(name, sizes):
    protocol, identifier = VARIANTS[name], 19 if name == "damiao" else 0
    for size in range(9):
        heard = protocol.hear(Frame(identifier, bytes((3, 0x80, 0, 0x80, 8, 0, 0, 0))[:size]))
        assert heard.broken == (size not in sizes), size
        assert (heard.power, heard.fault) == (None if name != "damiao" or heard.broken else OFF, 0)
        assert heard.leg == (0 if name != "damiao" and heard.broken else 2)
    other = protocol.hear(Frame(identifier, bytes((6, *bytes(sizes[-1] - 1)))))
    assert other == Heard(2 if name == "damiao" else 0, broken=True)
    assert protocol.hear(Frame(16, bytes(8))) is None


@pytest.mark.parametrize("code", [0, 1, 0x8000, 0xFFFE, 0xFFFF])
@every_variant
def test_position_at_the_end_of_its_range_is_not_a_measurement_if_replies_saturate(name, code):
    tail = {"mini_cheetah": b"", "cubemars": bytes((30, 0)), "damiao": bytes((30, 30))}[name]
    first, identifier = (0x13, 19) if name == "damiao" else (3, 0)
    data = bytes((first, code >> 8, code & 0xFF, 0x80, 0x08, 0)) + tail
    heard = VARIANTS[name].hear(Frame(identifier, data))
    assert (heard.leg, heard.broken, heard.feedback) == (2, False, True)
    assert (heard.motion is None) == (name != "mini_cheetah" and code in (0, 0xFFFF))


def test_damiao_register_reply_is_a_set_up_answer_except_for_the_identity_registers():
    for data, expected in (
        (b"\4\0\x33\x15" + struct.pack("<f", 95.5), Heard(3, answer=(21, 95.5))),
        (b"\4\0\x55\x09" + struct.pack("<I", 1000), Heard(3, answer=(9, 1000.0))),
        *((bytes((4, 0, 0x33, register, 1, 0, 0, 0)), Heard(3)) for register in (14, 15, 8)),
        (b"\3\0\x33\x15" + bytes(4), Heard(3, broken=True)),
    ):
        assert DAMIAO.hear(Frame(20, data)) == expected
    for data in (b"\4\1\x33\x15", b"\4\0\x34\x15"):
        assert DAMIAO.hear(Frame(20, data + bytes(4))).feedback


@pytest.mark.parametrize("leg", range(6))
def test_serial_number_and_revision_of_a_damiao_drive_are_read_from_two_registers(leg):
    node = MIT_NODES[leg]
    for register, what in ((15, "serial number"), (14, "revision")):
        data = bytes((node, 0, 0x33, register, 1, 2, 3, 4))
        frame = Frame(node + 16, data)
        said = DAMIAO.identity(frame)
        assert said is not None
        assert tuple(said) == (leg, what, 0x04030201)
        strange = [frame._replace(flags=FD), frame._replace(id=node + 15), frame._replace(data=data[:7])]
        strange += [frame._replace(data=bytes((*data[:k], data[k] + 1, *data[k + 1 :]))) for k in range(3)]
        strange.append(frame._replace(data=bytes((node, 0, 0x33, 9, 1, 2, 3, 4))))
        assert [DAMIAO.identity(each) for each in strange] == [None] * 7
    requests = tuple(tuple(request(READ, register, node=n) for n in MIT_NODES) for register in (15, 14))
    assert DAMIAO.traits.identity_requests == requests
    assert VARIANTS["cubemars"].traits.identity_requests == ()
    assert VARIANTS["cubemars"].identity(Frame(0, data)) is None


def test_set_up_of_a_damiao_drive_has_mode_watchdog_and_three_ranges():
    (exchanges, *_, last) = DAMIAO.exchanges(SETUP)
    assert {each.register: each.value for each in exchanges} == {10: 1, 9: 1000, 21: 95.5, 22: 400, 23: 144}
    assert [each.frames for each in last] == [
        (Frame(0x7FF, bytes.fromhex("0f00550a01000000")),),
        (Frame(0x7FF, bytes.fromhex("0f005509e8030000")),),
        *((request(READ, register, node=15),) for register in (21, 22, 23)),
    ]
    assert VARIANTS["cubemars"].exchanges(SETUP) == ((),) * 6
    for watchdog_s, ticks in ((0.000026, 1), (0.01, 200)):
        assert DAMIAO.exchanges(SETUP._replace(watchdog_s=watchdog_s))[0][1].value == ticks
    with pytest.raises(ProtocolError, match=r"drives\.watchdog_ms: 0\.024 ms"):
        DAMIAO.exchanges(SETUP._replace(watchdog_s=0.000024))
