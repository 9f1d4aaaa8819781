"""Drives with MIT framing by themselves: what they obey and answer, and what their replies are heard as."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.errors import ProtocolError
from drivers.mit.fields import Ranges
from drivers.mit.protocol import CLEAR, DISABLE, ENABLE, ZERO
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command, plain
from hil.contracts.messages import Answer, Configure, Rejected, Sync
from tests.drivers.motor_families import MitProtocol
from tests.drivers.spoken_drives import UNLIKE

NODES = (1, 2, 3, 4, 5, 15)
RANGES = Ranges(95.5, 400.0, 144.0)
VARIANTS = {
    name: MitProtocol(name, RANGES, NODES, 16 if name == "damiao" else 0, UNLIKE)
    for name in ("mini_cheetah", "cubemars", "damiao")
}
DAMIAO = VARIANTS["damiao"]
STEP_Nm = 288.0 / 4095
OFF, RUN, FAULT = DriveState.OFF, DriveState.RUN, DriveState.FAULT
BRAKES_NEVER = Configure(3, 1e6, Reaction.BRAKE)


def told(name: str, *frames: Frame, memory: Remembered | None = None) -> tuple[Remembered, list[Any]]:
    memory, found = memory or VARIANTS[name].power_up(), []
    for frame in frames:
        memory, messages = VARIANTS[name].parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def torque(code: int) -> Frame:
    """Return a torque to leg 3 by its code."""
    return Frame(4, (0x7FFF7FF0000 << 20 & ~0xFFF | code).to_bytes(8, "big"))


@pytest.mark.parametrize("name", VARIANTS)
def test_a_drive_obeys_torques_from_its_enabling_to_its_disabling_and_answers_every_frame(name):
    def force(code: int) -> float:
        return float((code * STEP_Nm - 144.0) * UNLIKE.N_per_Nm[3])

    memory, found = told(
        name,
        torque(3000),
        Frame(4, ENABLE),
        torque(3000),
        Frame(4, ENABLE),
        torque(1000),
        Frame(4, DISABLE),
        torque(1000),
        Frame(4, ENABLE),
    )
    damiao, sync = name == "damiao", (Sync(0, (3,)),)
    enabled = [
        (BRAKES_NEVER, command(3, DriveMode.READY, k), command(3, DriveMode.RUN, k + 1), *sync)
        for k in (1, 6)
    ]
    disabled = (command(3, DriveMode.OFF, 5), *((BRAKES_NEVER,) * (not damiao)), *sync)
    assert found == [
        sync,
        enabled[0],
        (command(3, DriveMode.RUN, 3, force(3000)), *sync),
        sync,
        (command(3, DriveMode.RUN, 4, force(1000)), *sync),
        disabled,
        sync,
        enabled[1],
    ]
    assert memory.heard == (0, 0, 0, 7, 0, 0)
    assert memory.enabled == (False, False, False, True, False, False)


def test_a_clear_resets_a_damiao_and_is_a_torque_to_others():
    for name, protocol in VARIANTS.items():
        running = protocol.power_up()._replace(enabled=(True,) * 6)
        memory, ((first, *_),) = told(name, Frame(4, CLEAR), memory=running)
        assert first.mode == (DriveMode.RESET if name == "damiao" else DriveMode.RUN)
        assert memory.enabled[3] == (name != "damiao")


@pytest.mark.parametrize("name", VARIANTS)
def test_a_new_zero_and_a_command_that_is_cut_are_refused_and_strangers_are_ignored(name):
    memory, found = told(name, Frame(4, ZERO), Frame(4, ENABLE[:7]), Frame(4, b""))
    assert found == [
        (Rejected(), Sync(0, (3,))),
        (Rejected(),),
        (Rejected(),),
    ]
    assert not any(memory.enabled)
    for flags in (EXTENDED, FD, REMOTE, ERROR, BUS):
        assert told(name, Frame(4, ENABLE, flags))[1] == [()]
        assert VARIANTS[name].hear(Frame(4, ENABLE, flags)) is None
    assert told(name, Frame(6, ENABLE), Frame(0x7FE, ENABLE))[1] == [(), ()]


# Damiao's registers


def request(kind: int, register: int, value: bytes = bytes(4), node: int = 4) -> Frame:
    return Frame(0x7FF, bytes((node, 0, kind, register)) + value)


@pytest.mark.parametrize(
    ("register", "value"),
    [
        (9, struct.pack("<I", 0)),
        (10, struct.pack("<I", 0)),
        (14, struct.pack("<I", 1)),
        (15, struct.pack("<I", 4)),
        (21, struct.pack("<f", 95.5)),
        (22, struct.pack("<f", 400.0)),
        (23, struct.pack("<f", 144.0)),
    ],
)
def test_a_register_that_nobody_wrote_reads_as_delivered_on_the_drives_own_identifier(register, value):
    _, (messages,) = told("damiao", request(0x33, register))
    assert messages == (Answer(3, Frame(20, bytes((4, 0, 0x33, register)) + value)),)


def test_a_register_keeps_what_is_written_and_a_limit_of_silence_holds_at_once_and_from_the_enabling_on():
    ticks = struct.pack("<I", 1000)
    memory, found = told(
        "damiao",
        request(0x55, 9, ticks),
        request(0x55, 10, struct.pack("<I", 1)),
        request(0x33, 9),
        Frame(4, ENABLE),
        request(0x55, 9, bytes(4)),
        request(0x55, 21, struct.pack("<f", 7.5)),
        request(0x33, 21),
    )
    limit = Configure(3, 0.05, Reaction.BRAKE)

    def reply(kind: int, register: int, value: bytes) -> Answer:
        return Answer(3, Frame(20, bytes((4, 0, kind, register)) + value))

    assert found == [
        (limit, reply(0x55, 9, ticks)),
        (reply(0x55, 10, struct.pack("<I", 1)),),
        (reply(0x33, 9, ticks),),
        (limit, command(3, DriveMode.READY, 1), command(3, DriveMode.RUN, 2), Sync(0, (3,))),
        (reply(0x55, 9, bytes(4)),),
        (reply(0x55, 21, struct.pack("<f", 7.5)),),
        (reply(0x33, 21, struct.pack("<f", 7.5)),),
    ]
    assert memory.registers[3][:3] == [1.0, 0.0, 7.5]
    assert [each[0] for each in memory.registers] == [leg == 3 for leg in range(6)]


def test_a_request_for_feedback_is_answered_by_it_and_one_that_is_none_is_refused():
    refused = (Rejected(),)
    assert told("damiao", request(0xCC, 0))[1] == [(Sync(0, (3,)),)]
    assert told("damiao", request(0xCC, 0, b"\0\0\0"))[1] == [refused]
    assert told("damiao", request(0xCC, 0, node=9))[1] == [refused]
    for kind, register in ((0x33, 8), (0x33, 0), (0x55, 14), (0x55, 15), (0xAA, 9), (0x34, 9)):
        assert told("damiao", request(kind, register))[1] == [refused]
    assert told("damiao", Frame(0x7FF, b""), Frame(0x7FF, b"\4"))[1] == [refused] * 2
    assert told("damiao", request(0x33, 9, node=9), request(0x55, 9, node=9))[1] == [(), ()]


# what drives send


def sent(name: str, **changes: Any) -> list[tuple[int, Frame]]:
    """Return what all drives answer, each with numbers of its own, from inside their ranges."""
    turns = np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])
    given: dict[str, Any] = {"state": np.full(6, int(OFF)), "fault": None, "legs": tuple(range(6))} | changes
    rate = UNLIKE.rate(turns / 4)
    force = UNLIKE.force(turns * 2, rate)
    sync = Sync(0, given["legs"])
    length = UNLIKE.length(turns)
    protocol = VARIANTS[name]
    return protocol.answer(protocol.power_up(), sync, length, rate, force, given["state"], given["fault"])[1]


@pytest.mark.parametrize("name", VARIANTS)
def test_each_drive_answers_with_its_own_numbers(name):
    turns = (0.5, -0.5, 1.5, 2.5, -3.0, 4.0)
    found = sent(name, legs=(5, 0, 2))
    assert [leg for leg, _ in found] == [5, 0, 2]
    tau = 2 * np.pi
    for leg, frame in found:
        heard = VARIANTS[name].hear(frame)
        assert heard is not None
        assert heard.leg == leg
        assert heard.motion is not None
        assert heard.motion[0] == pytest.approx(turns[leg], abs=191.0 / 65535 / tau)
        assert heard.motion[1] == pytest.approx(turns[leg] / 4, abs=800.0 / 4095 / tau)
        assert heard.torque == pytest.approx(turns[leg] * 2, abs=STEP_Nm)
        assert frame.id == (NODES[leg] + 16 if name == "damiao" else 0)
        assert len(frame.data) == (7 if name == "mini_cheetah" else 8)
        if name != "damiao":
            assert frame.data[0] == NODES[leg]


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
def test_state_and_fault_stand_where_each_variant_has_them(fault, cubemars, damiao):
    faults = np.zeros(6, np.int64)
    faults[2] = fault
    for state in DriveState:
        states = np.full(6, int(OFF))
        states[2] = state
        _, frame = sent("cubemars", state=states, fault=faults)[2]
        assert frame.data[6:] == bytes((30, cubemars if state == FAULT else 0))
        _, frame = sent("mini_cheetah", state=states, fault=faults)[2]
        assert frame.data[6:] == b"\x99"
        _, frame = sent("damiao", state=states, fault=faults)[2]
        status = damiao if state == FAULT else int(state == RUN)
        assert (frame.data[0], frame.data[6:]) == (status << 4 | 3, bytes((30, 30)))


@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_is_no_number_is_no_feedback(which):
    given: Any = [np.ones(6), np.ones(6), np.ones(6)]
    given[which][3] = np.nan
    with pytest.raises(ProtocolError, match="not a number"):
        DAMIAO.answer(DAMIAO.power_up(), Sync(0), given[0], given[1], given[2], np.ones(6, np.int64))


def test_a_drive_that_has_lost_its_encoder_still_says_speed_torque_and_state():
    lost = sent("damiao", state=np.array([1, 1, 3 | INVALID, 1, 1, 1]))[2][1]
    there = sent("damiao", state=np.array([1, 1, 3, 1, 1, 1]))[2][1]
    assert lost.data[1:3] == b"\0\0"
    assert lost.data[3:] == there.data[3:]
    assert lost.data[0] == there.data[0] == 0x13
