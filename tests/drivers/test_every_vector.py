"""No vector of other people's code is left out: each goes to the end that it is for, which has to make of it what stands here.

The figures of commands and replies are compared in the tests of their family.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mit.fields import Ranges
from drivers.moteus import COMMAND, MODE, TIMEOUT, WRITE
from drivers.protocol import BRS, EXTENDED, FD, REMOTE, Frame
from drivers.signals import LEGS, DriveMode, Reaction
from hil.contracts.messages import Answer, Configure, DeviceCommand, EmergencyStop, Rejected, Sync
from tests.drivers.moteus_ends import asked, registers
from tests.drivers.motor_families import (
    MitProtocol,
    MoteusProtocol,
    Motors,
    ODriveProtocol,
    RobStrideProtocol,
    pack_command,
    read_reply,
)
from tests.drivers.test_odrive import UNIT

DATA = Path(__file__).parents[1] / "data" / "drives"
Vector = dict[str, Any]


def read(name: str) -> Any:
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def frame(v: Vector) -> Frame:
    flags = EXTENDED * v["extended"] | FD * v["fd"] | BRS * v["brs"] | REMOTE * bool(v.get("rtr"))
    return Frame(v["id"], bytes.fromhex(v["data"]), flags)


def obeyed(protocol: Any, v: Vector, *, enabled: bool = True) -> str:
    """Return what the emulated drives make of a frame, in words."""
    memory = protocol.power_up()._replace(enabled=(enabled,) * LEGS)
    if isinstance(protocol, ODriveProtocol):
        memory = memory._replace(registers=[0.0, 1.0, *[0.0] * 6])
    words = []
    for message in protocol.parse(memory, frame(v))[1]:
        match message:
            case DeviceCommand(mode=mode):
                words.append(DriveMode(mode).name.lower())
            case Rejected():
                words.append("refused")
            case EmergencyStop():
                words.append("stopped")
            case Answer():
                words.append("register")
            case Sync():
                words.append("answers")
            case Configure():
                continue
    return " ".join(words)


def heard(protocol: Motors, v: Vector) -> str:
    """Return what the controller makes of a frame, in words."""
    found = protocol.hear(frame(v))
    if found is None:
        return "nobody's"
    if found.broken or found.foreign:
        return "broken" if found.broken else "foreign"
    return "register" if found.answer is not None else "feedback" if found.feedback else "state"


def without_gains(held: list[float]) -> Ranges:
    p, velocity, _, _, torque = held
    return Ranges(p, velocity, torque)


def mini_cheetah(v: Vector) -> MitProtocol:
    held = read("mit")["ranges"].get(v["inputs"].get("range"), [12.5, 65.0, 500.0, 5.0, 18.0])
    return MitProtocol("mini_cheetah", without_gains(held), (1, 2, 10, 127, 5, 6), 0, UNIT)


def cubemars(v: Vector) -> MitProtocol:
    held = read("mit")["ranges"][v["inputs"]["range"]]
    return MitProtocol("cubemars", without_gains(held), (1, 2, 10, 127, 5, 6), 0, UNIT)


def damiao(v: Vector) -> MitProtocol:
    p, velocity, torque = read("damiao")["ranges"][v["inputs"].get("motor", "DM4310")]
    nodes = (1, 2, 3, 4, 5, 6)
    return MitProtocol("damiao", Ranges(p, velocity, torque), nodes, 16, UNIT)


def robstride(v: Vector) -> RobStrideProtocol:
    held = read("robstride")["ranges"][v["inputs"].get("model", "rs-02")]
    return RobStrideProtocol(Ranges(*held[:3]), (1, 2, 3, 4, 5, 127), 253, UNIT)


def odrive(_v: Vector) -> ODriveProtocol:
    return ODriveProtocol((0, 1, 2, 3, 5, 7), 0.05, UNIT)


def moteus(_v: Vector) -> MoteusProtocol:
    return MoteusProtocol((1, 2, 3, 4, 5, 6), 0, Reaction.DAMP, 1e4, UNIT)


def to_drive(make: Callable[[Vector], Motors], words: str, *, enabled: bool = True) -> Any:
    return lambda v: obeyed(make(v), v, enabled=enabled) == words


def to_controller(make: Callable[[Vector], Motors], words: str) -> Any:
    return lambda v: heard(make(v), v) == words


def packed_with_the_sign(v: Vector) -> bool:
    """Compare with the library that turns the axis round: its signs are the transmission's here."""
    i, sign = v["inputs"], v["inputs"]["axis_direction"]
    r = Ranges(i["P_max"], i["V_max"], i["T_max"])
    p, velocity, torque = (sign * i[key] for key in ("position_rad", "velocity_rad_s", "torque_Nm"))
    return bool(pack_command(p, velocity, i["kp"], i["kd"], torque, r).hex() == v["data"])


def o2(v: Vector) -> Ranges:
    p, velocity, torque = read("robstride")["ranges"][v["inputs"]["model"]]
    return Ranges(p, velocity, torque)


def packed_as_o2(v: Vector) -> bool:
    names = ("position_rad", "velocity_rad_s", "kp", "kd", "torque_Nm")
    p, velocity, kp, kd, torque = (v["inputs"][name] for name in names)
    return bool(pack_command(p, velocity, kp, kd, torque, o2(v)).hex() == v["data"])


def read_as_o2(v: Vector) -> bool:
    p, velocity, torque = read_reply(bytes.fromhex(v["data"])[1:6], o2(v))
    said = [v["decoded"][key] for key in ("position_rad", "velocity_rad_s", "torque_Nm")]
    return bool(np.allclose((p, velocity, torque), said, rtol=3e-5, atol=1e-8))


def moteus_command(v: Vector) -> bool:
    """Compare the figures that the drive reads with those that the package was given."""
    written = registers(bytes.fromhex(v["data"]), WRITE)
    names = {
        "position_rev": COMMAND,
        "velocity_rev_s": COMMAND + 1,
        "feedforward_torque_Nm": COMMAND + 2,
        "maximum_torque_Nm": COMMAND + 5,
        "watchdog_timeout_s": TIMEOUT,
    }
    if written is None or written[MODE] != 10:
        return False
    step = {"float": 1e-6, "int32": 2e-3, "int16": 1.01e-2, "int8": 0.51}[
        v["what"].split(",")[1].split(":")[0].strip()
    ]
    for name, register in names.items():
        if name not in v["inputs"]:
            continue
        given = float(v["inputs"][name])
        if "saturation" in v["what"] and register in written:
            if not 0.0 < written[register] / given < 1.0 + 1e-9:
                return False
        elif not np.isclose(written[register], given, rtol=0, atol=step, equal_nan=True):
            return False
    return True


def moteus_query(*expected: tuple[int, int]) -> Any:
    return lambda v: asked(bytes.fromhex(v["data"])) == expected and obeyed(moteus(v), v) == "answers"


def moteus_mode(mode: int, words: str) -> Any:
    def fits(v: Vector) -> bool:
        written = registers(bytes.fromhex(v["data"]), WRITE)
        return written is not None and written[MODE] == mode and obeyed(moteus(v), v) == words

    return fits


def axis_state(v: Vector) -> bool:
    """Idle, closed loop and calibration, and an axis that is not ours."""
    words = {1: "off", 8: "ready run", 3: "refused"}[v["inputs"]["Axis_Requested_State"]]
    return obeyed(odrive(v), v, enabled=False) == (words if v["inputs"]["node_id"] != 63 else "")


TAIL = ((0xD, 0), (0xE, 0), (0xF, 0))
EXPECTED: dict[str, dict[str, Any]] = {
    "mit": {
        "command: ": to_drive(mini_cheetah, "run answers"),
        "command: all upper ends": lambda v: (
            obeyed(mini_cheetah(v), v) == "run answers" and v["data"] == "f" * 16
        ),
        "command with the library's sign flip": packed_with_the_sign,
        "COLLISION: a saturated command is byte for byte the special frame enable": to_drive(
            mini_cheetah, "ready run answers", enabled=False
        ),
        "COLLISION: a saturated command is byte for byte the special frame disable": to_drive(
            mini_cheetah, "off answers"
        ),
        "COLLISION: a saturated command is byte for byte the special frame zero position": to_drive(
            mini_cheetah, "refused answers"
        ),
        "special frame: enable": to_drive(mini_cheetah, "ready run answers", enabled=False),
        "special frame: disable": to_drive(mini_cheetah, "off answers"),
        "special frame: zero position": to_drive(mini_cheetah, "refused answers"),
        "reply WRAP": to_controller(mini_cheetah, "feedback"),
        "reply 7 bytes": to_controller(mini_cheetah, "feedback"),
        "reply parsed (8 bytes": to_controller(cubemars, "feedback"),
    },
    "damiao": {
        "MIT command": to_drive(damiao, "run answers"),
        "enable": to_drive(damiao, "ready run answers", enabled=False),
        "disable": to_drive(damiao, "off answers"),
        "set zero position": to_drive(damiao, "refused answers"),
        "clear error": to_drive(damiao, "reset answers"),
        "refresh / request feedback on 0x7FF": to_drive(damiao, "answers"),
        "refresh / request feedback on 0x7FF with an id over 8 bits": to_drive(damiao, "refused"),
        "read parameter ": to_drive(damiao, "register"),
        "read parameter MST_ID": to_drive(damiao, "refused"),
        "read parameter xout": to_drive(damiao, "refused"),
        "write parameter ": to_drive(damiao, "register"),
        "write parameter MST_ID": to_drive(damiao, "refused"),
        "write parameter ESC_ID": to_drive(damiao, "refused"),
        "write parameter DEC": to_drive(damiao, "refused"),
        "save parameters to flash": to_drive(damiao, "refused"),
        "position-velocity mode": to_drive(damiao, ""),
        "velocity mode": to_drive(damiao, ""),
        "position-force mode": to_drive(damiao, ""),
        "parameter reply": to_controller(damiao, "register"),
        "feedback ": to_controller(damiao, "feedback"),
        "parameter reply: DEC": to_controller(damiao, "state"),  # nobody here asks for it
        "AMBIGUITY": to_controller(
            damiao, "register"
        ),  # at one of two positions: none is better than a wrong one
    },
    "robstride": {
        "type 1 operation control": to_drive(robstride, "run answers"),
        "type 3 enable": to_drive(robstride, "ready run answers", enabled=False),
        "type 4 disable": to_drive(robstride, "off answers"),
        "type 18 write parameter ": to_drive(robstride, "refused"),
        "type 18 write parameter run_mode": to_drive(robstride, "answers"),
        "type 17 read parameter ": to_drive(robstride, "refused"),
        "type 17 read parameter run_mode": to_drive(robstride, "register"),
        "type 17 reply": to_controller(robstride, "register"),
        "type 2 feedback": to_controller(robstride, "feedback"),
        "type 0 get device id": to_drive(robstride, "register"),
        "type 6 set zero position": to_drive(robstride, ""),
        "type 7 set motor id": to_drive(robstride, ""),
        "MIT-protocol mode (11 bit)": packed_as_o2,
        "MIT-protocol mode: ": to_drive(robstride, ""),
        "MIT-protocol mode: feedback O2": read_as_o2,
    },
    "odrive": {
        "0.6: Heartbeat": lambda v: (
            heard(odrive(v), v) == ("nobody's" if v["inputs"]["node_id"] == 63 else "state")
        ),
        "0.6: Estop": to_drive(odrive, "stopped"),
        "0.6: Get_Error": to_controller(odrive, "nobody's"),
        "0.6: Clear_Errors": to_drive(odrive, "reset"),
        "0.6: Set_Axis_State": axis_state,
        "0.6: Set_Axis_State 8 (4 bytes)": to_drive(odrive, "ready run", enabled=False),
        "0.6: Set_Controller_Mode": to_drive(odrive, ""),
        "0.6: Set_Input_Torque": to_drive(odrive, "run"),
        "0.6: Set_Input_Pos": to_drive(odrive, "refused"),
        "0.6: Get_Encoder_Estimates": to_controller(odrive, "feedback"),
        "0.6: Get_Torques": to_controller(odrive, "nobody's"),
        "0.6: Reboot": to_drive(odrive, "refused"),
        "0.6: Address": to_drive(odrive, ""),
        "0.5: Set_Axis_State": axis_state,
        "0.5: Set_Controller_Mode": to_drive(odrive, ""),
        "0.5: Set_Input_Torque": to_drive(odrive, "run"),
        "0.5: Set_Input_Pos": to_drive(odrive, "refused"),
        "0.5: Set_Input_Vel": to_drive(odrive, "refused"),
        "0.5: Set_Limits": to_drive(odrive, "refused"),
        "0.5: Set_Axis_Node_ID": to_drive(odrive, "refused"),
        "0.5: Clear_Errors": to_drive(odrive, "reset"),
        "0.5: Reboot": to_drive(odrive, "refused"),
        "0.5: Estop": to_drive(odrive, "stopped"),
        "0.5: Heartbeat": to_controller(odrive, "state"),
        "0.5.1: Heartbeat": to_controller(odrive, "state"),
        "0.5: request ": to_drive(odrive, ""),
        "0.5: request Get_Encoder_Estimates": to_drive(odrive, "answers"),
        "0.5: reply ": to_controller(odrive, "nobody's"),
        "0.5: reply Get_Encoder_Estimates": to_controller(odrive, "feedback"),
        "0.5: reply Get_Encoder_Estimates, extended node id": to_controller(odrive, "nobody's"),
    },
    "moteus": {
        "position mode": moteus_command,
        "stop": lambda v: obeyed(moteus(v), v).startswith("reset"),
        "brake": moteus_mode(15, "refused"),
        "current mode": moteus_mode(9, "refused"),
        "zero velocity": moteus_mode(12, "refused"),
        "query default": moteus_query((0, 0), (1, 3), (2, 3), (3, 3), *TAIL),
        "query all float": moteus_query((0, 0), (1, 3), (2, 3), (3, 3), (0xD, 3), (0xE, 3), (0xF, 0)),
        "query int16": moteus_query((0, 0), (1, 1), (2, 1), (3, 1), *TAIL),
        "query int32 with currents": moteus_query((0, 0), *((k, 2) for k in range(1, 6)), *TAIL),
        "query position only": moteus_query((1, 3)),
        "query with power and motor temperature": moteus_query(
            (0, 0), (1, 3), (2, 3), (3, 3), (6, 3), (7, 1), (0xA, 1), *TAIL
        ),
        "reply: ": to_controller(moteus, "feedback"),
        "reply: write error reply": to_controller(moteus, "broken"),
        "reply: q and d current float": to_controller(moteus, "feedback"),
    },
}
"""What each vector has to become; the longest beginning of its name counts."""


def test_every_vector_is_used_and_every_row_has_one():
    for name, rows in EXPECTED.items():
        found = {row_of(name, v) for v in read(name)["vectors"]}
        assert found == set(rows), name


def row_of(name: str, v: Vector) -> str:
    fitting = [row for row in EXPECTED[name] if v["what"].startswith(row)]
    assert fitting, f"{name}: nothing is said of {v['what']}"
    return max(fitting, key=len)


@pytest.mark.parametrize("name", EXPECTED)
def test_each_vector_becomes_what_stands_here(name):
    wrong = [
        f"{row_of(name, v)}: {v['what']} {v['inputs']} {v['data']}"
        for v in read(name)["vectors"]
        if not EXPECTED[name][row_of(name, v)](v)
    ]
    assert not wrong, "\n".join(wrong)
