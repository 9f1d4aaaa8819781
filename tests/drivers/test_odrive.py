"""ODrive CAN Simple 0.6: the contract, bytes of the vendor's headers, axes frame by frame, and settings."""

from __future__ import annotations

import json
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.protocol import REMOTE, Frame, Said
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import command, reports
from hil.contracts.loopback import SETUP
from hil.contracts.messages import Configure, EmergencyStop, Rejected, Status
from hil.contracts.trouble import TroubleContract
from tests.drivers import motor_families as families
from tests.drivers.motor_families import ODRIVE_NODES as NODES
from tests.drivers.motor_families import UNIT, UNLIKE, ODriveProtocol, odrive

VECTORS = json.loads((Path(__file__).parents[1] / "data/drives/odrive.json").read_text("utf-8"))["vectors"]
BRAKES = SETUP._replace(reaction=Reaction.BRAKE)
P = odrive(UNIT)


class TestODrive(TroubleContract):
    RESOLUTION = (1e-7, 1e-6, None, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = ENDS = False
    LENGTHS, SPEED, RELATIVE = (-100.0, 100.0), 100.0, 1e-7
    BEATS, OTHER = "state", 0x200

    def beat_ids(self, protocol):
        return {node << 5 | 1 for node in NODES}

    @pytest.fixture
    def family(self):
        return odrive()


def vectors(name: str) -> list[Any]:
    found = [each for each in VECTORS if each["what"] == f"0.6: {name}"]
    assert found
    return found


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]))


def commanded(dialogue: Remembered, mode: DriveMode, tick: int = 0) -> list[list[Frame]]:
    _, frames = P.command(dialogue, Command(mode, np.zeros(6)), tick)
    return [[frame for frame in frames if frame.id >> 5 == node] for node in NODES]


def test_odrive_states_modes_errors_and_stop_frames_agree_with_the_vendors_definitions():
    start = P.start(BRAKES)
    for sent, name in (
        (commanded(start, DriveMode.RUN)[3][0], "Set_Axis_State"),
        (
            commanded(start._replace(power=(DriveState.OFF,) * 6), DriveMode.READY)[0][0],
            "Set_Controller_Mode",
        ),
        (commanded(start, DriveMode.RESET)[1][1], "Clear_Errors"),
        (P.traits.emergency_stop[1], "Estop"),
        (reports(P, Status(0, DriveState.OFF, DriveFault.NONE))[0], "Heartbeat"),
    ):
        assert sent == frame(vectors(name)[0])
    assert P.begin(start, 0)[1] == Frame(vectors("Get_Encoder_Estimates")[0]["id"], b"", REMOTE)


def test_command_frame_to_each_odrive_axis_depends_on_the_state_of_that_axis():
    power = tuple(
        map(int, (DriveState.RUN, DriveState.OFF, DriveState.FAULT, DriveState.OFF, DriveState.RUN, 0))
    )
    state, modes, clear, torque = 0x07, 0x0B, 0x18, 0x0E
    for mode, kinds in (
        (DriveMode.OFF, [[state]] * 6),
        (DriveMode.READY, [[state], [modes], [state], [modes], [state], [state]]),
        (DriveMode.RUN, [[state, torque]] * 6),
        (DriveMode.RESET, [[state, clear]] * 6),
    ):
        found = commanded(P.start(BRAKES)._replace(power=power), mode)
        assert [[frame.id & 0x1F for frame in frames] for frames in found] == kinds


# an emulated axis


OTHERS = (7, 1, 2, 3, 5, 62)
AXES = ODriveProtocol(OTHERS, 0.07, UNLIKE)
TOOL = Configure(4, 0.07, Reaction.BRAKE)
"""Watchdog set by odrivetool in leg 4, whose node is 5."""
REFUSED = (Rejected(),)


def to(kind: int, data: bytes = b"", flags: int = 0, leg: int = 4) -> Frame:
    return Frame(OTHERS[leg] << 5 | kind, data, flags)


def state(number: int, size: int = 8) -> Frame:
    return to(0x07, struct.pack("<Ixxxx", number)[:size])


def torque(value: float, size: int = 8) -> Frame:
    return to(0x0E, struct.pack("<fxxxx", value)[:size])


TORQUE_CONTROL = to(0x0B, struct.pack("<II", 1, 1))


sent_to = partial(families.sent_to, AXES)


def test_unknown_frame_to_an_odrive_axis_is_refused_or_ignored():
    taken = {0x02, 0x06, 0x07, 0x0B, 0x0E, 0x18}
    ignored = {0x00, 0x01, 0x03, 0x05, 0x08, 0x09, 0x0A, 0x14, 0x15, 0x17, 0x1C, 0x1D, 0x1E}
    for kind in set(range(32)) - taken:
        assert sent_to(to(kind, bytes(8)))[1] == [() if kind in ignored else REFUSED], hex(kind)
    enabled = AXES.power_up()._replace(enabled=(True,) * 6)
    memory, messages = AXES.parse(enabled, to(0x02))
    assert messages == (EmergencyStop((4,)),)
    assert memory == enabled._replace(enabled=(True, True, True, True, False, True))
    for kind, sizes in ((0x07, (4, 8)), (0x0B, (8,)), (0x0E, (4, 8)), (0x18, (0, 1))):
        for size in range(9):
            (messages,) = sent_to(to(kind, b"\1\0\0\0\0\0\0\0"[:size]))[1]
            assert (messages == REFUSED) == (size not in sizes), (hex(kind), size)


def test_emulated_odrive_axis_enters_closed_loop_only_in_torque_control():
    frames = [
        state(8),
        to(0x0B, struct.pack("<II", 2, 1)),
        state(8),
        TORQUE_CONTROL,
        torque(0.5),
        state(8, 4),
    ]
    frames += state(8), torque(0.5), torque(-0.25, 4), torque(float("nan")), state(1), torque(0.5), state(8)
    memory, found = sent_to(*frames, to(0x18, b"\0"), torque(0.5))
    ready, run = DriveMode.READY, DriveMode.RUN
    per = float(UNLIKE.N_per_Nm[4])
    assert found == [
        REFUSED,
        (),
        REFUSED,
        (),
        (),
        (TOOL, command(4, ready, 1), command(4, run, 2)),
        (),
        (command(4, run, 3, 0.5 * per),),
        (command(4, run, 4, -0.25 * per),),
        REFUSED,
        (command(4, DriveMode.OFF, 5), TOOL),
        (),
        (command(4, ready, 6), command(4, run, 7)),
        (command(4, DriveMode.RESET, 8),),
        (),
    ]
    assert memory.heard == (0, 0, 0, 0, 8, 0)
    assert memory.enabled == (False,) * 6
    assert memory.registers[4][:2] == [1.0, 1.0]
    assert memory.registers[:4] == ([0.0] * 8,) * 4
    assert sent_to(to(0x18))[1] == [(command(4, DriveMode.RESET, 1),)], "errors are also cleared without data"
    for number in (0, 2, 3, 7, 9):
        memory, found = sent_to(TORQUE_CONTROL, state(8), state(number))
        assert (found[-1], memory.enabled[4]) == (REFUSED, True), "neither idle nor closed loop"


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (DriveFault.NONE, 0),
        (DriveFault.WATCHDOG, 0x1000000),
        (DriveFault.ESTOP, 0x2000000),
        (DriveFault.OVERFORCE, 0x1000),
        (DriveFault.SENSOR, 0x8),
        (DriveFault.STROKE, 0x10000),
    ],
)
def test_heartbeat_of_an_odrive_axis_has_the_error_code_and_closed_loop_only_in_run(fault, error):
    for now in DriveState:
        _, (beat,) = AXES.report(AXES.power_up(), Status(4, now, fault))
        closed = 8 if now == DriveState.RUN else 1
        assert beat == Frame(5 << 5 | 1, struct.pack("<IBBBB", error, closed, 0, 0, 0))
    assert AXES.report(AXES.power_up(), Status(4, DriveState.FAULT, fault, due=False))[1] == ()


@pytest.mark.parametrize(
    ("error", "axis", "power", "fault"),
    [
        (0, 8, DriveState.RUN, 0),
        (0, 9, DriveState.OFF, 0),
        (0x1000000, 1, DriveState.FAULT, DriveFault.WATCHDOG),
        (0x2000000, 8, DriveState.FAULT, DriveFault.ESTOP),
        (0x3000000, 8, DriveState.FAULT, 0x3000100),
        (0x80000000, 1, DriveState.FAULT, 0x80000100),
    ],
)
def test_error_in_an_odrive_heartbeat_becomes_a_drive_fault_or_keeps_the_axis_code(error, axis, power, fault):
    said: Any = AXES.hear(Frame(5 << 5 | 1, struct.pack("<IBBBB", error, axis, 9, 9, 9)))
    assert (said.leg, said.power, said.fault) == (4, power, fault)
    assert {said.feedback, said.broken, said.foreign} == {False}
    assert AXES.fault_text(0x2108) == "missing estimate, motor over temperature"


def test_odrive_address_answer_has_eight_bytes_and_its_own_node_number():
    data = bytes.fromhex("05010203040506ff")
    assert AXES.identity(to(0x06, data)) == Said(4, "serial number", 0x060504030201)
    for other in (to(0x06, data, REMOTE), to(0x06, data[:7]), to(0x05, data), to(0x06, b"\4" + data[1:])):
        assert AXES.identity(other) is None
    assert AXES.hear(to(0x06, data)) is None
    assert AXES.traits.identity_requests == (tuple(Frame(node << 5 | 6, b"", REMOTE) for node in OTHERS),)


# what the controller asks an axis for


def test_odrive_axis_gets_the_closed_loop_request_again_if_it_later_reports_an_open_loop():
    power = (DriveState.OFF, DriveState.OFF, DriveState.RUN, DriveState.OFF, DriveState.OFF, DriveState.OFF)
    known = AXES.start(BRAKES)._replace(
        mode=int(DriveMode.RUN),
        said=(30, 19, 30, 31, 30, 30),
        asked=(20, 10, 20, 20, 21, 20),
        power=tuple(map(int, power)),
        ran=(False,) * 5 + (True,),
    )
    dialogue, frames = AXES.command(known, Command(DriveMode.RUN, np.zeros(6)), 40)
    assert [frame.id >> 5 for frame in frames if frame.id & 0x1F == 0x07] == [OTHERS[0], OTHERS[3]]
    assert dialogue.asked == (40, 10, 20, 40, 21, 20)
    kinds = [frame.id & 0x1F for frame in frames]
    assert kinds == [0x07, 0x0E, 0x0E, 0x0E, 0x07, 0x0E, 0x0E, 0x0E]


def test_odrive_axis_counts_as_enabled_after_run_until_its_heartbeat_reports_otherwise():
    off, run, fault = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
    power = (off, run, fault, 0, off, off)
    for before in DriveMode:
        for after in DriveMode:
            known = AXES.start(BRAKES)._replace(mode=int(before), power=power)
            dialogue, _ = AXES.command(known, Command(after, np.zeros(6)), 40)
            left = before == DriveMode.RUN != after
            assert dialogue.power == ((run, run, fault, 0, run, run) if left else power)


# settings


def made(layout: Any = "classic", **changes: Any) -> Any:
    values = {"protocol": "odrive", "transmission": {"lead_m": 0.02}, "force_limit_N": 5}
    return build_protocol(BusSettings(layout=layout), DriveSettings.model_validate(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transmission": None}, r"drives\.transmission: protocol odrive"),
        ({"layout": "fd"}, r"bus\.layout: .*given: fd"),
        *(({"node_ids": [1, 2, 3, 4, 5, n]}, rf"node_ids\[5\]: .*0 to 62, given: {n}") for n in (-1, 63)),
        ({"options": {"gain": 1}}, "given: gain"),
        *(({"options": {"encoder_msg_rate_ms": n}}, f"0 to 10000, given: {n}") for n in (-1, 10_001, 2.5)),
        ({"heartbeat_ms": 250.5}, r"drives\.heartbeat_ms: .*up to 250"),
        ({"transmission": {"lead_m": 2000.0}, "force_limit_N": 60}, r"carries up to 10000 N m"),
    ],
)
def test_invalid_setting_of_odrive_drives_is_refused_with_its_key(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        made(**changes)


def test_configured_settings_reach_the_odrive_codec_and_estimates_default_to_10_ms():
    named = made(
        heartbeat_ms=125, watchdog_ms=40, options={"encoder_msg_rate_ms": 4}, node_ids=[7, 2, 0, 4, 5, 62]
    )
    assert named.traits.feedback_ids == {node << 5 | 9 for node in (7, 2, 0, 4, 5, 62)}
    unasked = [made(options=options).traits.unasked_s for options in ({}, {"encoder_msg_rate_ms": 0})]
    assert [named.traits.unasked_s, *unasked] == pytest.approx([0.004, 0.01, 0.0])
    assert made(heartbeat_ms=250, options={"encoder_msg_rate_ms": 10_000}).traits.unasked_s == 10.0
    protocol = ByValue(named)
    dialogue: Any = protocol.start(BRAKES._replace(watchdog_s=0.04))
    assert dialogue.patience_ticks == 94, "three heartbeats of 0.125 s, whole ticks"
    idle = Frame(2 << 5 | 0x07, struct.pack("<Ixxxx", 1))
    _, messages = protocol.parse(protocol.power_up(), idle)
    (delivered,) = [each for each in messages if isinstance(each, Configure)]
    assert delivered.leg == 1
    assert delivered.watchdog_s == pytest.approx(0.04)
    assert [made(heartbeat_ms=ms).patience_ticks(251.0) for ms in (100, 1, 4.1)] == [76, 2, 4]
    assert "mechanical_brake.config.gpio_num" in named.traits.dangers[0]
