"""MIT framing, Damiao and RobStride: bytes and ranges of other people's code (tests/data/drives has the sources)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mit.fields import TURN, VARIANTS, Ranges
from drivers.protocol import EXTENDED, Frame
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.ends import SETUP
from plant_fmu.drives.mit import device_motion
from tests.drivers.motor_families import (
    ALL_NODES,
    GEAR,
    RANGES,
    ROBSTRIDE_NODES,
    Heard,
    MitProtocol,
    RobStrideProtocol,
    mit,
    pack_command,
    read_reply,
    unpack_command,
)

DATA: dict[str, Any] = {
    name: json.loads((Path(__file__).parents[1] / f"data/drives/{name}.json").read_text(encoding="utf-8"))
    for name in ("mit", "damiao", "robstride")
}
BRAKES = SETUP._replace(reaction=Reaction.BRAKE)


def vectors(name: str, begins: str) -> list[Any]:
    found = [v for v in DATA[name]["vectors"] if v["what"].startswith(begins)]
    assert found, begins
    return found


def each(name: str, begins: str) -> Any:
    return pytest.mark.parametrize("v", vectors(name, begins), ids=lambda v: v["what"])


def ranges(name: str, model: str) -> Ranges:
    """Return them from position, velocity, kp, kd, torque, or without gains."""
    p, v, *gains = DATA[name]["ranges"][model]
    return Ranges(p, v, gains[0] if name == "robstride" else gains[-1])


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]), EXTENDED * v["extended"])


def packed(v: Any, r: Ranges) -> str:
    names = "position_rad", "velocity_rad_s", "kp", "kd", "torque_Nm"
    return pack_command(*(v["inputs"][name] for name in names), r).hex()


@each("mit", "command: ")
def test_commands_are_those_of_two_libraries_and_decode_as_in_the_firmware(v):
    r = ranges("mit", v["inputs"]["range"])
    assert packed(v, r) == v["data"]
    if "katz" in v:  # float32
        np.testing.assert_allclose(unpack_command(frame(v).data, r), v["katz"], rtol=2e-5, atol=1e-5)


@each("damiao", "MIT command")
def test_damiao_commands_are_those_of_its_libraries(v):
    assert packed(v, ranges("damiao", v["inputs"]["motor"])) == v["data"]


@each("mit", "reply")
def test_replies_are_read_as_two_libraries_read_them_and_packed_as_by_the_firmware(v):
    r, said, data = ranges("mit", v["inputs"]["range"]), v["decoded"], frame(v).data
    names = "position_rad", "velocity_rad_s", "torque_or_current"
    np.testing.assert_allclose(read_reply(data[1:6], r), [said[name] for name in names], rtol=3e-5, atol=1e-8)
    if v.get("made_by") == "KATZ":
        given = (v["inputs"][name] for name in ("position_rad", "velocity_rad_s", "torque_Nm"))
        assert bytes(device_motion(*given, r, clamps=False)) == data[1:6], "past its range too"


@pytest.mark.parametrize(
    ("variant", "model", "name"),
    [
        ("mini_cheetah", "mini_cheetah", "classic_V65"),
        ("cubemars", "AK80-9", "AK80-9_V50"),
        ("cubemars", "AK10-9", "AK10-9_V50"),
        ("cubemars", "AK80-6", "AK80-6_V76"),
        ("cubemars", "AK80-64", "AK80-64_V8"),
        *(("damiao", m, m) for m in ("DM4310", "DM8009", "DM4340", "DM6006", "DM4310_48V", "DM3507")),
        *(("robstride", m, m) for m in VARIANTS["robstride"].models),
    ],
)
def test_ranges_of_a_model_are_those_of_its_libraries(variant, model, name):
    file = variant if variant in DATA else "mit"
    assert VARIANTS[variant].models[model] == pytest.approx(ranges(file, name), rel=1e-8)


def damiao(motor: str = "DM4310") -> MitProtocol:
    return MitProtocol("damiao", ranges("damiao", motor), ALL_NODES, 16, GEAR)


def robstride(model: str = "rs-02") -> RobStrideProtocol:
    return RobStrideProtocol(ranges("robstride", model), ROBSTRIDE_NODES, 253, GEAR)


def test_damiao_special_frames_and_registers_are_those_of_its_libraries():
    protocol = damiao()
    start = protocol.start(BRAKES)
    # 0.1 s are 2000 steps of 50 us
    found = protocol.exchanges(BRAKES._replace(watchdog_s=0.1))[4]
    asked = {exchange.name.split()[0]: exchange.frames[0] for exchange in found}
    faulted = start._replace(mode=DriveMode.RESET, power=(DriveState.FAULT,) * 6)
    for sent, what in (
        (protocol.poll(start, 4), "disable"),
        (protocol.poll(start._replace(mode=DriveMode.RUN), 4), "enable"),
        (protocol.poll(faulted, 4), "clear error"),
        (asked["CTRL_MODE"], "write parameter CTRL_MODE"),
        (asked["PMAX"], "read parameter PMAX"),
        (asked["TMAX"], "read parameter TMAX"),
        (asked["TIMEOUT"], "write parameter TIMEOUT"),
    ):
        assert sent == frame(vectors("damiao", what)[0]), what


@each("damiao", "feedback ")
def test_damiao_feedback_is_read_with_its_status(v):
    protocol, said = damiao(v["inputs"]["motor"]), v["decoded"]
    heard, code = protocol.hear(frame(v)), v["decoded"]["status_code"]
    assert heard.leg == 4
    assert heard.power == {0: DriveState.OFF, 1: DriveState.RUN}.get(code, DriveState.FAULT)
    assert heard.torque == pytest.approx(said["torque_Nm"], rel=3e-5)
    if abs(said["position_rad"]) == 12.5:
        assert heard.motion is None, "at its end a position may have gone past it"
    else:
        motion = said["position_rad"] / TURN, said["velocity_rad_s"] / TURN
        assert heard.motion == pytest.approx(motion, rel=3e-5)
    if code > 1:
        assert heard.fault == DriveFault.WATCHDOG if code == 13 else protocol.fault_text(heard.fault)


@each("damiao", "parameter reply")
def test_damiao_registers_are_read(v):
    heard = damiao().hear(frame(v))
    register = v["inputs"]["rid"]
    # 5: a register that nobody here asks for, and no feedback
    assert heard == (Heard(4) if register == 5 else Heard(4, answer=(register, v["decoded"]["value"])))


@each("robstride", "type 1 operation control torque only")
def test_robstride_commands_are_its_librarys_within_its_rounding(v):
    protocol = robstride(v["inputs"]["model"])
    torque = {"mode": DriveMode.RUN, "ran": (True,) * 6, "torque": (v["inputs"]["torque_Nm"],) * 6}
    sent, theirs = protocol.poll(protocol.start(BRAKES)._replace(**torque), 0), frame(v)
    assert (sent.flags, sent.data) == (theirs.flags, theirs.data)
    assert sent.id & 0xFF0000FF == theirs.id & 0xFF0000FF
    assert 0 <= (sent.id >> 8 & 0xFFFF) - (theirs.id >> 8 & 0xFFFF) <= 1


def test_robstride_special_frames_are_those_of_its_libraries():
    protocol = robstride()
    start = protocol.start(BRAKES)
    written, read = protocol.exchanges(BRAKES)[0][0].frames
    for sent, what in (
        (protocol.poll(start._replace(mode=DriveMode.RUN), 0), "type 3 enable"),
        (protocol.poll(start, 0), "type 4 disable"),
        (written, "type 18 write parameter run_mode 0"),
        (read, "type 17 read parameter run_mode"),
    ):
        assert [sent] == [frame(v) for v in vectors("robstride", what)]
    heard = protocol.hear(frame(vectors("robstride", "type 17 reply run_mode")[0]))
    assert heard.answer == (0x7005, 2.0)


@each("robstride", "type 2 feedback")
def test_robstride_feedback_is_read_as_by_the_library_with_the_makers_scale(v):
    heard = robstride().hear(frame(v))
    said = v["others"]["RS"] if "others" in v else v["decoded"]
    faults, mode = v["inputs"]["fault_bits"], v["inputs"]["mode_bits"]
    assert heard.leg == 0
    assert heard.power == (DriveState.FAULT if faults else DriveState.RUN if mode == 2 else DriveState.OFF)
    assert heard.fault == (0x100 + faults if faults else 0)
    assert heard.torque == pytest.approx(said["torque_Nm"], rel=1e-5)
    if heard.motion is not None:
        motion = said["position_rad"] / TURN, said["velocity_rad_s"] / TURN
        assert heard.motion == pytest.approx(motion, rel=1e-5)
    else:
        assert abs(said["position_rad"]) == pytest.approx(4 * np.pi, rel=1e-6)


# every value of a field


@given(torque=st.floats(-20.0, 20.0), position=st.floats(-15.0, 15.0))
def test_command_saturates_and_no_torque_makes_it_a_special_frame(torque, position):
    r = VARIANTS["damiao"].models["DM4310"]
    p, v, kp, kd, t = unpack_command(pack_command(position, 0.0, 0.0, 0.0, torque, r), r)
    assert 0.0 <= min(max(torque, -10.0), 10.0) - t < 20.0 / 4095 * (1 + 1e-9)
    assert 0.0 <= min(max(position, -12.5), 12.5) - p < 25.0 / 65535 * (1 + 1e-9)
    assert abs(v) <= 60.0 / 4095
    assert (kp, kd) == (0.0, 0.0)
    dialogue = damiao().start(BRAKES)._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(torque,) * 6)
    assert damiao().poll(dialogue, 0).data[:7] != b"\xff" * 7


@given(st.integers(0, 2**32 - 1))
def test_fields_are_off_by_no_more_than_the_resolution_and_some_by_most_of_it(seed):
    chance, stated = np.random.default_rng(seed), mit("cubemars").traits.resolution.at(250.0)
    off = []
    for _ in range(30):
        p, v, t = chance.uniform(-0.99, 0.99, 3) * (RANGES.position, RANGES.velocity, RANGES.torque)
        p1, v1, _ = read_reply(bytes(device_motion(p, v, t, RANGES, clamps=True)), RANGES)
        t1 = unpack_command(pack_command(0.0, 0.0, 0.0, 0.0, t, RANGES), RANGES)[4]
        off.append(((p - p1) * 0.1 / TURN, (v - v1) * 0.1 / TURN, (t - t1) * TURN / 0.1))
    largest = np.abs(off).max(axis=0)
    steps = np.array([each[0] for each in (stated.length, stated.rate, stated.force)])
    assert (largest <= steps * (1.0 + 1e-9)).all()
    assert (largest > 0.6 * steps).all()
