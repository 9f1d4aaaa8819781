"""MIT framing, Damiao and RobStride: bytes and ranges of other people's code (tests/data/drives has the sources)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mit.fields import VARIANTS, Ranges
from drivers.protocol import EXTENDED, Frame
from drivers.signals import DriveMode, DriveState, Reaction
from hil.contracts.ends import SETUP
from tests.drivers.motor_families import (
    ALL_NODES,
    GEAR,
    ROBSTRIDE_NODES,
    MitProtocol,
    RobStrideProtocol,
    pack_command,
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


def ranges(name: str, model: str) -> Ranges:
    """Return them from position, velocity, kp, kd, torque, or without gains."""
    p, v, *gains = DATA[name]["ranges"][model]
    return Ranges(p, v, gains[0] if name == "robstride" else gains[-1])


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]), EXTENDED * v["extended"])


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
