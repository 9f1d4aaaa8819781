"""Controllers written from the makers' frame formats, without our codecs, move the drives of `hil plant`.

Their own codecs are checked against tests/data/drives: bytes produced by other people's code.
"""

from __future__ import annotations

import json
import math
import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
import pytest

from drivers.signals import DriveState
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from tests.plant_thread import serving

DATA = Path(__file__).parents[1] / "data/drives"
CHANNEL = f"sheets-{os.getpid()}"
ENABLE, DISABLE = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"
MOVED_m, TIME_s = 0.02, 0.8
TURN = 2.0 * math.pi


class Reply(NamedTuple):
    """State of a motor from an answer."""

    node: int
    turns: float
    turns_per_s: float


def code(x: float, most: float, bits: int) -> int:
    """Code of x over -most to most: 2^n - 1 steps, truncated."""
    return int((min(max(x, -most), most) + most) * ((1 << bits) - 1) / (2 * most))


def value(number: int, most: float, bits: int) -> float:
    return number * 2 * most / ((1 << bits) - 1) - most


class Mit:
    """A drive with MIT frames: ends of position, velocity and torque.

    `answers` is added to its identifier.
    """

    def __init__(self, ends: tuple[float, float, float], answers: int | None) -> None:
        self.ends, self.answers = ends, answers

    def opening(self, node: int) -> list[can.Message]:
        return [can.Message(arbitration_id=node, data=ENABLE, is_extended_id=False)]

    def torque(self, node: int, N_m: float) -> list[can.Message]:
        p, v, t = self.ends
        number = code(0.0, p, 16) << 48 | code(0.0, v, 12) << 36 | code(N_m, t, 12)
        return [can.Message(arbitration_id=node, data=number.to_bytes(8, "big"), is_extended_id=False)]

    def closing(self, node: int) -> list[can.Message]:
        return [can.Message(arbitration_id=node, data=DISABLE, is_extended_id=False)]

    def read(self, m: can.Message) -> Reply | None:
        node = m.data[0] & 0xF
        if m.arbitration_id != (0 if self.answers is None else node + self.answers):
            return None
        number = int.from_bytes(m.data[1:6], "big")
        p, v, _ = self.ends
        rad, rad_s = value(number >> 24, p, 16), value(number >> 12 & 0xFFF, v, 12)
        return Reply(node, rad / TURN, rad_s / TURN)


class ODrive:
    """A drive with ODrive's CAN Simple 0.6."""

    def opening(self, node: int) -> list[can.Message]:
        mode = self._frame(node, 0x0B, struct.pack("<II", 1, 1))  # torque, passed through
        return [mode, self._frame(node, 0x07, struct.pack("<I", 8))]  # closed loop

    def torque(self, node: int, N_m: float) -> list[can.Message]:
        ask = can.Message(arbitration_id=node << 5 | 0x09, is_remote_frame=True, dlc=8, is_extended_id=False)
        return [self._frame(node, 0x0E, struct.pack("<f4x", N_m)), ask]

    def closing(self, node: int) -> list[can.Message]:
        return [self._frame(node, 0x07, struct.pack("<I", 1))]  # idle

    def read(self, m: can.Message) -> Reply | None:
        if m.arbitration_id & 0x1F != 0x09 or m.is_remote_frame:
            return None
        return Reply(m.arbitration_id >> 5, *struct.unpack("<ff", m.data))

    @staticmethod
    def _frame(node: int, command: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=node << 5 | command, data=data, is_extended_id=False)


class RobStride:
    """RobStride's own protocol: type, 16 bits, target in a 29-bit identifier.

    16-bit codes (x / most + 1) 0x7FFF.
    """

    HOST, MIDDLE = 253, 0x7FFF
    ENDS = 4.0 * math.pi, 44.0, 17.0
    """Ends of position, velocity and torque of model rs-02."""

    def opening(self, node: int) -> list[can.Message]:
        operation = struct.pack("<HxxI", 0x7005, 0)
        return [self._frame(18, node, operation), self._frame(3, node)]

    def torque(self, node: int, N_m: float) -> list[can.Message]:
        most = self.ENDS[2]
        number = int((min(max(N_m, -most), most) / most + 1.0) * self.MIDDLE)
        return [self._frame(1, node, struct.pack(">HHHH", self.MIDDLE, self.MIDDLE, 0, 0), number)]

    def closing(self, node: int) -> list[can.Message]:
        return [self._frame(4, node)]

    def read(self, m: can.Message) -> Reply | None:
        if not m.is_extended_id or (m.arbitration_id >> 24, m.arbitration_id & 0xFF) != (2, self.HOST):
            return None
        p, v, _, _ = struct.unpack(">HHHH", m.data)
        rad, rad_s = ((n / self.MIDDLE - 1.0) * end for n, end in zip((p, v), self.ENDS, strict=False))
        return Reply(m.arbitration_id >> 8 & 0xFF, rad / TURN, rad_s / TURN)

    def _frame(self, kind: int, node: int, data: bytes = bytes(8), middle: int = HOST) -> can.Message:
        return can.Message(arbitration_id=kind << 24 | middle << 8 | node, data=data, is_extended_id=True)


MINI_CHEETAH, DAMIAO = Mit((12.5, 65.0, 18.0), None), Mit((12.5, 30.0, 10.0), 16)
CUBEMARS, ROBSTRIDE = Mit((12.5, 50.0, 18.0), None), RobStride()
Master = Mit | ODrive | RobStride
# the spring of a leg of configs/bench.yaml takes 100 N for 20 mm: a turn is 0.4 m, which carries its stroke
RACK = {"lead_m": 0.4, "offset_m": 1.475}
FAMILIES: dict[str, tuple[Master, dict[str, Any], dict[str, float]]] = {
    "odrive": (ODrive(), {"protocol": "odrive"}, {"lead_m": 0.02, "offset_m": 1.6}),
    "mini_cheetah": (MINI_CHEETAH, {"protocol": "mit", "options": {"variant": "mini_cheetah"}}, RACK),
    "cubemars": (CUBEMARS, {"protocol": "mit", "options": {"variant": "cubemars", "model": "AK80-9"}}, RACK),
    "robstride": (
        ROBSTRIDE,
        {"protocol": "mit", "options": {"variant": "robstride", "model": "rs-02"}},
        RACK,
    ),
    "damiao": (DAMIAO, {"protocol": "mit", "options": {"variant": "damiao", "model": "DM4310"}}, RACK),
}


def vectors(name: str, *words: str) -> Iterator[dict[str, Any]]:
    read = json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))["vectors"]
    found = [v for v in read if all(word in v["what"] for word in words)]
    assert found, words
    yield from found


def message(v: dict[str, Any]) -> can.Message:
    return can.Message(arbitration_id=v["id"], data=bytes.fromhex(v["data"]), is_extended_id=v["extended"])


def test_mit_and_odrive_frames_from_data_sheets_agree_with_independent_code():
    for v in vectors("mit", "command: torque only"):
        if v["inputs"]["range"] == "classic_V65":
            (sent,) = MINI_CHEETAH.torque(1, v["inputs"]["torque_Nm"])
            assert sent.data.hex() == v["data"], v
    for v in vectors("mit", "reply 7 bytes"):
        if v["inputs"]["range"] == "classic_V65":
            heard = MINI_CHEETAH.read(message(v))
            assert heard is not None
            assert heard.turns * TURN == pytest.approx(v["decoded"]["position_rad"], abs=1e-4)
            assert heard.turns_per_s * TURN == pytest.approx(v["decoded"]["velocity_rad_s"], abs=1e-4)
    for v in vectors("damiao", "feedback enabled"):
        if v["inputs"]["motor"] == "DM4310":
            heard = DAMIAO.read(message(v))
            assert heard is not None
            assert heard.node == v["decoded"]["id_low_nibble"]
            assert heard.turns * TURN == pytest.approx(v["decoded"]["position_rad"], abs=1e-4)
    for v in vectors("odrive", "0.6: Set_Input_Torque"):
        sent = ODrive().torque(v["inputs"]["node_id"], v["inputs"]["Input_Torque"])[0]
        assert (sent.arbitration_id, sent.data.hex()) == (v["id"], v["data"])
    for v in vectors("odrive", "0.6: Get_Encoder_Estimates"):
        heard = ODrive().read(message(v))
        assert heard == pytest.approx((1, v["inputs"]["Pos_Estimate"], v["inputs"]["Vel_Estimate"]), rel=1e-6)


def test_robstride_frames_from_data_sheets_agree_with_independent_code():
    for v in vectors("robstride", "type 1 operation control torque only"):
        (sent,) = ROBSTRIDE.torque(1, v["inputs"]["torque_Nm"])
        assert (sent.arbitration_id, sent.data.hex(), sent.is_extended_id) == (v["id"], v["data"], True)
    mode, enable = ROBSTRIDE.opening(1)
    (stop,) = ROBSTRIDE.closing(1)
    for sent, what in ((mode, "run_mode 0"), (enable, "type 3 enable"), (stop, "type 4 disable")):
        (v,) = vectors("robstride", what)
        assert (sent.arbitration_id, sent.data.hex()) == (v["id"], v["data"])
    for v in vectors("robstride", "type 2 feedback"):
        heard = ROBSTRIDE.read(message(v))
        assert heard is not None
        assert heard.node == v["inputs"]["motor_id"]
        assert heard.turns * TURN == pytest.approx(v["decoded"]["position_rad"], abs=1e-4)
        assert heard.turns_per_s * TURN == pytest.approx(v["decoded"]["velocity_rad_s"], abs=1e-4)
    assert ROBSTRIDE.read(ROBSTRIDE.opening(1)[1]) is None


def test_cubemars_frames_from_data_sheets_agree_with_independent_code():
    """Position and velocity are zero here; the torque of the independent code is in the last 12 bits."""
    commands = [v for v in vectors("mit", "command") if v["inputs"]["range"] == "AK80-9_V50"]
    assert len({v["inputs"]["torque_Nm"] for v in commands}) == 5
    for v in commands:
        (sent,) = CUBEMARS.torque(1, v["inputs"]["torque_Nm"])
        assert sent.arbitration_id == v["id"]
        assert sent.data.hex()[-3:] == v["data"][-3:]
        assert v["what"] != "command: all zero" or sent.data.hex() == v["data"]
    replies = [v for v in vectors("mit", "8 bytes", "AK80-9") if v["inputs"]["range"] == "AK80-9_V50"]
    assert {v["inputs"].get("motor_id", 1) for v in replies} == {1, 2, 10}
    for v in replies:
        heard = CUBEMARS.read(message(v))
        assert heard is not None
        assert heard.node == v["inputs"].get("motor_id", 1)
        assert heard.turns * TURN == pytest.approx(v["decoded"]["position_rad"], abs=1e-4)
        assert heard.turns_per_s * TURN == pytest.approx(v["decoded"]["velocity_rad_s"], abs=1e-3)


def asked(bus: can.BusABC, drive: Master, node: int, N_m: float) -> Reply:
    """Send a torque and return the answer of that drive."""
    for each in drive.torque(node, N_m):
        bus.send(each)
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        heard = bus.recv(0.1)
        reply = None if heard is None or heard.arbitration_id == node else drive.read(heard)
        if reply is not None and reply.node == node:
            return reply
    raise AssertionError(f"drive {node} has not answered")


def lifted(drive: Master, lead_m: float) -> dict[int, float]:
    """Lift all legs by a spring and damper law, then switch them off; return their travel, m."""
    nodes = range(1, 7)
    with can.Bus(CHANNEL, "localcan", ignore_config=True) as bus:
        start = {node: lead_m * asked(bus, drive, node, 0.0).turns for node in nodes}
        length, rate = dict(start), dict.fromkeys(nodes, 0.0)
        for node in nodes:
            for each in drive.opening(node):
                bus.send(each)
                time.sleep(2e-3)  # frames that wait together go by their identifiers
        begun = time.monotonic()
        while (share := (time.monotonic() - begun) / TIME_s) < 1.5:
            for node in nodes:
                goal = start[node] + MOVED_m * min(1.0, share)
                force = 2e4 * (goal - length[node]) - 2e3 * rate[node]
                heard = asked(bus, drive, node, min(max(force, -150.0), 150.0) * lead_m / TURN)
                length[node], rate[node] = lead_m * heard.turns, lead_m * heard.turns_per_s
            time.sleep(0.005)
        for node in nodes:
            for each in drive.closing(node):
                bus.send(each)
        time.sleep(0.2)
    return {node: length[node] - start[node] for node in nodes}


@pytest.mark.long
@pytest.mark.realtime(patient=True)
@pytest.mark.parametrize("name", FAMILIES)
def test_controller_written_from_data_sheets_lifts_all_legs_of_the_emulated_drives(name, tmp_path):
    drive, drives, transmission = FAMILIES[name]
    changes = {
        "bus": {"channel": CHANNEL, "layout": "classic"},
        "drives": drives | {"transmission": transmission, "watchdog_ms": 200, "force_limit_N": 150},
        "limits": {"force_N": 150, "force_step_N": 100, "force_window_N": 150},
        "reactions": {"silence": "brake"},
        "reference": {"components": [{"axis": "z_m", "amplitude": 0.01, "frequency_Hz": 0.1}]},
        "loop": {"rate_Hz": 100},
        "recording": {"folder": f"{tmp_path}/runs"},
    }
    with serving(loads(with_changes(load("bench").text, changes), f"{name}.yaml")) as nodes:
        before = nodes.snapshot().length
        moved = lifted(drive, transmission["lead_m"])
        after = nodes.snapshot()
    way = after.length - before
    np.testing.assert_allclose(way, list(moved.values()), rtol=0, atol=2e-3)
    assert (way > 0.5 * MOVED_m).all()
    assert (way < 1.2 * MOVED_m).all()
    assert after.state.tolist() == [DriveState.OFF] * 6
    assert after.rejected == 0
