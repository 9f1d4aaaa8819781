"""Vectors of other libraries: each goes to its end of the codec, and the result is that of the table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mit.fields import TURN, Ranges
from drivers.moteus import COMMAND, MODE, TIMEOUT, WRITE
from drivers.protocol import BRS, EXTENDED, FD, REMOTE, Frame
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState
from hil.contracts.drives_end import answers
from hil.contracts.messages import Answer, Configure, DeviceCommand, EmergencyStop, Rejected, Sync
from plant_fmu.drives.mit import device_motion
from tests.drivers.motor_families import (
    ALL_NODES,
    ROBSTRIDE_NODES,
    UNIT,
    Heard,
    MitProtocol,
    Motors,
    ODriveProtocol,
    RobStrideProtocol,
    asked,
    begun,
    moteus,
    pack_command,
    read_reply,
    registers,
    unpack_command,
)

DATA: dict[str, Any] = {
    name: json.loads((Path(__file__).parents[1] / f"data/drives/{name}.json").read_text(encoding="utf-8"))
    for name in ("mit", "damiao", "robstride", "odrive", "moteus")
}
Vector = dict[str, Any]
MOTEUS, ODRIVE = moteus(UNIT, 1e4), ODriveProtocol((0, 1, 2, 3, 5, 7), 0.05, UNIT)


def family(name: str, v: Vector) -> Motors:
    """Family of a vector, with the ranges of the vector."""
    if name in {"odrive", "moteus"}:
        return ODRIVE if name == "odrive" else MOTEUS
    key = {"mit": "range", "damiao": "motor", "robstride": "model"}[name]
    default = {"mit": "classic_V65", "damiao": "DM4310", "robstride": "rs-02"}[name]
    held = DATA[name]["ranges"][v["inputs"].get(key, default)]
    if name == "robstride":
        return RobStrideProtocol(Ranges(*held[:3]), ROBSTRIDE_NODES, 253, UNIT)
    if name == "damiao":
        return MitProtocol("damiao", Ranges(*held), ALL_NODES, 16, UNIT)
    variant = "cubemars" if v["what"].startswith("reply parsed (8 bytes") else "mini_cheetah"
    return MitProtocol(variant, Ranges(held[0], held[1], held[4]), (1, 2, 10, 127, 5, 6), 0, UNIT)


def frame(v: Vector) -> Frame:
    flags = EXTENDED * v["extended"] | FD * v["fd"] | BRS * v["brs"] | REMOTE * bool(v.get("rtr"))
    return Frame(v["id"], bytes.fromhex(v["data"]), flags)


KINDS: dict[type, str] = {Rejected: "refused", EmergencyStop: "stopped", Answer: "register", Sync: "answers"}


def obeyed(name: str, v: Vector, *, enabled: bool = True) -> str:
    """Reaction of the emulated drives to a frame, in words."""
    protocol = family(name, v)
    memory = protocol.power_up()._replace(enabled=(enabled,) * LEGS)
    if name == "odrive":
        memory = memory._replace(registers=[0.0, 1.0, *[0.0] * 6])
    words = []
    for message in protocol.parse(memory, frame(v))[1]:
        match message:
            case DeviceCommand(mode=mode):
                words.append(DriveMode(mode).name.lower())
            case Configure():
                continue
            case _:
                words.append(KINDS[type(message)])
    return " ".join(words)


def heard(name: str, v: Vector) -> str:
    """Meaning of a frame for the controller, in words."""
    found = family(name, v).hear(frame(v))
    if found is None:
        return "nobody's"
    if found.broken or found.foreign:
        return "broken" if found.broken else "foreign"
    return "register" if found.answer is not None else "feedback" if found.feedback else "state"


def fits(name: str, v: Vector, expected: Any) -> bool:
    """True if a vector has the expected result: `> x` enabled drives, `| x` disabled, `< x` controller.

    A function is called with the vector; a tuple has several expectations.
    """
    if isinstance(expected, tuple):
        return all(fits(name, v, each) for each in expected)
    if not isinstance(expected, str):
        return bool(expected(v))
    end, _, words = expected.partition(" ")
    return (heard(name, v) if end == "<" else obeyed(name, v, enabled=end == ">")) == words


# by their figures


FIVE = ("position_rad", "velocity_rad_s", "kp", "kd", "torque_Nm")


def near(found: Any, expected: Any, rtol: float = 3e-5) -> bool:
    return bool(np.allclose(found, expected, rtol=rtol, atol=1e-8))


def ranges(name: str, v: Vector) -> Ranges:
    found: Ranges = family(name, v).ranges
    return found


def packed_five(v: Vector, r: Ranges) -> bytes:
    p, velocity, kp, kd, torque = (v["inputs"][key] for key in FIVE)
    return pack_command(p, velocity, kp, kd, torque, r)


def packed(name: str) -> Any:
    """Compare a command with a library's, and its decoding with a firmware's, in float32."""

    def same(v: Vector) -> bool:
        r = ranges(name, v)
        data = packed_five(v, r)
        decoded = "katz" not in v or np.allclose(unpack_command(data, r), v["katz"], rtol=2e-5, atol=1e-5)
        return data.hex() == v["data"] and bool(decoded)

    return same


def mit_reply(v: Vector) -> bool:
    """Compare the decoding of a reply, and an emulated drive's packing past its range with the firmware's."""
    r, data = ranges("mit", v), frame(v).data
    names = "position_rad", "velocity_rad_s", "torque_or_current"
    made = data[1:6]
    if v.get("made_by") == "KATZ":
        place, speed, torque = (v["inputs"][name] for name in ("position_rad", "velocity_rad_s", "torque_Nm"))
        made = bytes(device_motion(place, speed, torque, r, clamps=False))
    return near(read_reply(data[1:6], r), [v["decoded"][name] for name in names]) and made == data[1:6]


def damiao_feedback(v: Vector) -> bool:
    found, said = family("damiao", v).hear(frame(v)), v["decoded"]
    code, at_end = said["status_code"], abs(said["position_rad"]) == 12.5
    power = {0: DriveState.OFF, 1: DriveState.RUN}.get(code, DriveState.FAULT)
    fault = {0: 0, 1: 0, 13: DriveFault.WATCHDOG}.get(code, 0x100 + code)
    # a position at its end may be beyond it
    motion = None if at_end else (said["position_rad"] / TURN, said["velocity_rad_s"] / TURN)
    same = found.motion is None if motion is None else near(found.motion, motion)
    return (
        (found.leg, found.power, found.fault) == (4, power, fault)
        and same
        and near(found.torque, said["torque_Nm"])
    )


def damiao_register(v: Vector) -> bool:
    found = family("damiao", v).hear(frame(v))
    return bool(found == Heard(4, answer=(v["inputs"]["rid"], v["decoded"]["value"])))


def robstride_torque(v: Vector) -> bool:
    """Compare our command with the library's, which rounds the torque: at most one step off."""
    protocol = family("robstride", v)
    torque = {"mode": DriveMode.RUN, "ran": (True,) * 6, "torque": (v["inputs"]["torque_Nm"],) * 6}
    sent, theirs = protocol.poll(begun(protocol, **torque), 0), frame(v)
    same = (sent.flags, sent.data) == (
        theirs.flags,
        theirs.data,
    ) and sent.id & 0xFF0000FF == theirs.id & 0xFF0000FF
    return same and 0 <= (sent.id >> 8 & 0xFFFF) - (theirs.id >> 8 & 0xFFFF) <= 1


def robstride_feedback(v: Vector) -> bool:
    """Compare with the library that uses the maker's scale."""
    found, i = family("robstride", v).hear(frame(v)), v["inputs"]
    said = v["others"]["RS"] if "others" in v else v["decoded"]
    faults = i["fault_bits"]
    power = DriveState.FAULT if faults else DriveState.RUN if i["mode_bits"] == 2 else DriveState.OFF
    place, speed = said["position_rad"] / TURN, said["velocity_rad_s"] / TURN
    same = near(abs(place), 2.0) if found.motion is None else near(found.motion, (place, speed))
    state = found.leg, found.power, found.fault
    return state == (0, power, faults and 0x100 + faults) and same and near(found.torque, said["torque_Nm"])


def packed_with_the_sign(v: Vector) -> bool:
    """Compare with the library that reverses an axis: here the transmission has the sign."""
    i, sign = v["inputs"], v["inputs"]["axis_direction"]
    p, velocity, kp, kd, torque = (i[key] for key in FIVE)
    r = Ranges(i["P_max"], i["V_max"], i["T_max"])
    return bool(pack_command(sign * p, sign * velocity, kp, kd, sign * torque, r).hex() == v["data"])


def o2(v: Vector) -> Ranges:
    return Ranges(*DATA["robstride"]["ranges"][v["inputs"]["model"]])


def packed_as_o2(v: Vector) -> bool:
    return bool(packed_five(v, o2(v)).hex() == v["data"])


def read_as_o2(v: Vector) -> bool:
    said = [v["decoded"][key] for key in ("position_rad", "velocity_rad_s", "torque_Nm")]
    return near(read_reply(frame(v).data[1:6], o2(v)), said)


def moteus_reply(v: Vector) -> bool:
    said, decoded = registers(bytes.fromhex(v["data"]), 0x20), v["decoded"]
    names = {"MODE": 0, "POSITION": 1, "VELOCITY": 2, "TORQUE": 3, "FAULT": 15}
    read = {name: (said or {})[register] for name, register in names.items() if name in decoded}
    expected = [float(decoded[name]) for name in read]
    same = np.allclose(list(read.values()), expected, rtol=1e-5, equal_nan=True)
    fault, found = decoded.get("FAULT"), MOTEUS.hear(frame(v))
    return bool(same) and (not fault or (found.power, found.fault) == (DriveState.FAULT, 0x100 + fault))


def axis_torque(v: Vector) -> bool:
    running = {"mode": DriveMode.RUN, "ran": (True,) * 6, "torque": (v["inputs"]["Input_Torque"],) * 6}
    return bool(ODRIVE.poll(begun(ODRIVE, **running), ODRIVE.nodes.index(v["inputs"]["node_id"])) == frame(v))


def axis_estimates(v: Vector) -> bool:
    leg = ODRIVE.nodes.index(v["inputs"]["node_id"])
    figures = v["inputs"]["Pos_Estimate"], v["inputs"]["Vel_Estimate"]
    found, (length, rate) = ODRIVE.hear(frame(v)), (np.full(6, each) for each in figures)
    sent = answers(ODRIVE, Sync(0, (leg,)), length, rate, np.zeros(6), np.ones(6, np.int64))
    return bool(found.leg == leg and near(found.motion, figures, 1e-7) and sent == [(leg, frame(v))])


def moteus_command(v: Vector) -> bool:
    """Compare the values that the drive reads with those given to the package."""
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
    width = v["what"].split(",")[1].split(":")[0].strip()
    step = {"float": 1e-6, "int32": 2e-3, "int16": 1.01e-2, "int8": 0.51}[width]
    for name in names.keys() & v["inputs"].keys():
        register, given = names[name], float(v["inputs"][name])
        if "saturation" in v["what"] and register in written:
            if not 0.0 < written[register] / given < 1.0 + 1e-9:
                return False
        elif not np.isclose(written[register], given, rtol=0, atol=step, equal_nan=True):
            return False
    return True


def moteus_query(*expected: tuple[int, int]) -> Any:
    return lambda v: asked(bytes.fromhex(v["data"])) == expected and obeyed("moteus", v) == "answers"


def moteus_mode(mode: int) -> Any:
    def refused(v: Vector) -> bool:
        written = registers(bytes.fromhex(v["data"]), WRITE)
        return written is not None and written[MODE] == mode and obeyed("moteus", v) == "refused"

    return refused


def axis_state(v: Vector) -> bool:
    words = {1: "off", 8: "ready run", 3: "refused"}[v["inputs"]["Axis_Requested_State"]]
    return obeyed("odrive", v, enabled=False) == (words if v["inputs"]["node_id"] != 63 else "")


def axis_heartbeat(v: Vector) -> bool:
    found, error, state = ODRIVE.hear(frame(v)), v["inputs"]["Axis_Error"], v["inputs"]["Axis_State"]
    if v["inputs"]["node_id"] == 63:
        return found is None
    power = DriveState.FAULT if error else DriveState.RUN if state == 8 else DriveState.OFF
    return (found.feedback, found.power, found.fault) == (False, power, error and 0x100 + error)


HEAD, TAIL = ((0, 0), (1, 3), (2, 3), (3, 3)), ((0xD, 0), (0xE, 0), (0xF, 0))
COLLISION = "COLLISION: a saturated command is byte for byte the special frame "
REFUSED = ("Set_Input_Pos", "Set_Input_Vel", "Set_Limits", "Set_Axis_Node_ID", "Reboot")
SPECIAL = {"enable": "| ready run answers", "disable": "> off answers", "zero position": "> refused answers"}
EXPECTED: dict[str, dict[str, Any]] = {
    "mit": {
        "command: ": ("> run answers", packed("mit")),
        "command: all upper ends": ("> run answers", packed("mit"), lambda v: v["data"] == "f" * 16),
        "command with the library's sign flip": packed_with_the_sign,
        **{COLLISION + name: words for name, words in SPECIAL.items()},
        **{f"special frame: {name}": words for name, words in SPECIAL.items()},
        "reply WRAP": ("< feedback", mit_reply),
        "reply 7 bytes": ("< feedback", mit_reply),
        "reply parsed (8 bytes": ("< feedback", mit_reply),
    },
    "damiao": {
        "MIT command": ("> run answers", packed("damiao")),
        "enable": "| ready run answers",
        "disable": "> off answers",
        "set zero position": "> refused answers",
        "clear error": "> reset answers",
        "refresh / request feedback on 0x7FF": "> answers",
        "refresh / request feedback on 0x7FF with an id over 8 bits": "> refused",
        "read parameter ": "> register",
        **{f"read parameter {name}": "> refused" for name in ("MST_ID", "xout")},
        "write parameter ": "> register",
        **{f"write parameter {name}": "> refused" for name in ("MST_ID", "ESC_ID", "DEC")},
        "save parameters to flash": "> refused",
        **{f"{name} mode": "> " for name in ("position-velocity", "velocity", "position-force")},
        "parameter reply": ("< register", damiao_register),
        "feedback ": ("< feedback", damiao_feedback),
        "parameter reply: DEC": "< state",  # this codec does not request it
        "AMBIGUITY": "< register",  # at one of two positions: no reading is better than a wrong one
    },
    "robstride": {
        "type 1 operation control": "> run answers",
        "type 1 operation control torque only": ("> run answers", robstride_torque),
        "type 3 enable": "| ready run answers",
        "type 4 disable": "> off answers",
        "type 18 write parameter ": "> refused",
        "type 18 write parameter run_mode": "> answers",
        "type 17 read parameter ": "> refused",
        "type 17 read parameter run_mode": "> register",
        "type 17 reply": "< register",
        "type 2 feedback": ("< feedback", robstride_feedback),
        "type 0 get device id": "> register",
        "type 6 set zero position": "> ",
        "type 7 set motor id": "> ",
        "MIT-protocol mode (11 bit)": packed_as_o2,
        "MIT-protocol mode: ": "> ",
        "MIT-protocol mode: feedback O2": read_as_o2,
    },
    "odrive": {
        "0.6: Heartbeat": axis_heartbeat,
        "0.6: Estop": "> stopped",
        "0.6: Get_Error": "< nobody's",
        "0.6: Clear_Errors": "> reset",
        "0.6: Set_Axis_State": axis_state,
        "0.6: Set_Axis_State 8 (4 bytes)": "| ready run",
        "0.6: Set_Controller_Mode": "> ",
        "0.6: Set_Input_Torque": ("> run", axis_torque),
        "0.6: Set_Input_Pos": "> refused",
        "0.6: Get_Encoder_Estimates": ("< feedback", axis_estimates),
        "0.6: Get_Torques": "< nobody's",
        "0.6: Reboot": "> refused",
        "0.6: Address": "> ",
        "0.5: Set_Axis_State": axis_state,
        "0.5: Set_Controller_Mode": "> ",
        "0.5: Set_Input_Torque": "> run",
        **{f"0.5: {name}": "> refused" for name in REFUSED},
        "0.5: Clear_Errors": "> reset",
        "0.5: Estop": "> stopped",
        "0.5: Heartbeat": "< state",
        "0.5.1: Heartbeat": "< state",
        "0.5: request ": "> ",
        "0.5: request Get_Encoder_Estimates": "> answers",
        "0.5: reply ": "< nobody's",
        "0.5: reply Get_Encoder_Estimates": "< feedback",
        "0.5: reply Get_Encoder_Estimates, extended node id": "< nobody's",
    },
    "moteus": {
        "position mode": moteus_command,
        "stop": lambda v: obeyed("moteus", v).startswith("reset"),
        "brake": moteus_mode(15),
        "current mode": moteus_mode(9),
        "zero velocity": moteus_mode(12),
        "query default": moteus_query(*HEAD, *TAIL),
        "query all float": moteus_query(*HEAD, (0xD, 3), (0xE, 3), (0xF, 0)),
        "query int16": moteus_query((0, 0), (1, 1), (2, 1), (3, 1), *TAIL),
        "query int32 with currents": moteus_query((0, 0), *((k, 2) for k in range(1, 6)), *TAIL),
        "query position only": moteus_query((1, 3)),
        "query with power and motor temperature": moteus_query(*HEAD, (6, 3), (7, 1), (0xA, 1), *TAIL),
        "reply: ": ("< feedback", moteus_reply),
        "reply: write error reply": "< broken",
        "reply: q and d current float": ("< feedback", moteus_reply),
    },
}
"""Expected result of each vector; the longest matching start of its name decides."""


def row_of(name: str, v: Vector) -> str:
    fitting = [row for row in EXPECTED[name] if v["what"].startswith(row)]
    assert fitting, f"{name}: no row for {v['what']}"
    return max(fitting, key=len)


@pytest.mark.parametrize("name", EXPECTED)
def test_each_frame_vector_of_other_libraries_is_coded_as_its_table_row_states_and_no_row_is_unused(name):
    rows = [(row_of(name, v), v) for v in DATA[name]["vectors"]]
    assert {row for row, _ in rows} == set(EXPECTED[name])
    wrong = [f"{row}: {v['what']} {v['inputs']}" for row, v in rows if not fits(name, v, EXPECTED[name][row])]
    assert not wrong, "\n".join(wrong)
