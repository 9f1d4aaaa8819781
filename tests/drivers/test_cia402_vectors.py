"""CiA 402 frames, byte for byte as the package canopen 2.4.1 writes and reads them (tests/data)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.controller_end import plan
from drivers.cia402.states import STATE_OF, State, controlword
from drivers.frame_array import received_array
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, NEVER, Command, DriveFault, DriveMode, DriveState
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.loopback import SETUP
from hil.contracts.messages import Status
from tests.drivers.cia402_drives import COUNTS, NODES, PERMILLE_N, SCREW_m, changed, drives, holding

DATA = json.loads((Path(__file__).parents[1] / "data/cia402_vectors.json").read_text(encoding="utf-8"))
LEG = 4
"""Leg of node 5."""
P = ByValue(drives(NODES))
RUNNING = holding(P.protocol, [DriveState.RUN] * 6)
"""Memory of configured drives."""


def vectors(what: str) -> list[Any]:
    found = [v for v in DATA["vectors"] if v["what"].startswith(what)]
    assert found, what
    return found


def each(what: str) -> Any:
    return pytest.mark.parametrize("v", vectors(what), ids=lambda v: f"{v['what']} {v['data']}")


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]))


def place_of(v: Any) -> tuple[int, int]:
    return int(v["inputs"]["index"], 16), v["inputs"]["sub"]


def decoded(frames, protocol=P):
    m = new_record()
    m["tick"] = 0
    heard = received_array([Received(1, f) for f in frames])
    protocol.decode(protocol.start(SETUP), heard, new_record(), m, 0)
    return m


def test_set_up_sync_and_heartbeat_frames_equal_those_of_the_python_package_canopen():
    steps = plan(5, SETUP, P)
    sent = [Frame(0x605, step.request(5)) for step in steps if step.kind == "write"]
    for pdo in ("remap RPDO1", "remap TPDO1"):
        expected = [frame(v) for v in vectors(pdo)]
        at = sent.index(expected[0])
        assert sent[at : at + len(expected)] == expected
    nmt = [Frame(0x000, step.request(5)) for step in steps if step.kind == "nmt"]
    assert nmt == [frame(vectors(f"NMT to node 5: {s}")[0]) for s in ("PRE-OPERATIONAL", "OPERATIONAL")]
    assert P.begin(P.start(SETUP), 7) == (frame(vectors("SYNC without counter")[0]),)
    _, commanded = P.command(P.start(SETUP), Command(DriveMode.OFF, np.zeros(LEGS)), 0)
    assert commanded[-1] == Frame(0x700 + 127, frame(vectors("heartbeat OPERATIONAL")[0]).data)


def test_sdo_frames_agree_with_the_python_package_canopen():
    for v in vectors("SDO request: download"):
        size = {"u16": 2, "i16": 2, "i8": 1, "i32": 4}[v["inputs"]["type"]]
        assert o.download(place_of(v), v["inputs"]["value"], size) == frame(v).data, v["what"]
    for v in vectors("SDO request: upload"):
        assert o.upload(place_of(v)) == frame(v).data, v["what"]
    for v in vectors("SDO reply: upload"):
        bits = {0x4B: 16, 0x43: 32}[frame(v).data[0]]
        assert o.read_value(frame(v).data) == (place_of(v), v["decoded"]["value"] % (1 << bits)), v["what"]
    for v in vectors("SDO abort"):
        code = int.from_bytes(frame(v).data[4:], "little")
        assert o.abort(place_of(v), code) == frame(v).data, v["what"]
        assert code in o.ABORTS


@each("statusword decoded")
def test_statusword_is_decoded_to_the_same_state_as_by_the_python_package_canopen(v):
    name = v["decoded"]["state"].replace("OPERATION ENABLED", "ENABLED").replace(" ", "_")
    name = name.removesuffix("_ACTIVE")
    assert STATE_OF[v["inputs"]["statusword"] & 0x7F] == (-1 if name == "UNKNOWN" else State[name])


@pytest.mark.parametrize(
    ("state", "mode", "word"),
    [
        ("SWITCH ON DISABLED", "READY", "shutdown"), ("READY TO SWITCH ON", "READY", "switch_on"),
        ("OPERATION ENABLED", "READY", "switch_on"), ("SWITCHED ON", "RUN", "enable_operation"),
        ("OPERATION ENABLED", "RUN", "enable_operation"), ("SWITCH ON DISABLED", "RUN", "disable_voltage"),
        ("OPERATION ENABLED", "OFF", "shutdown"), ("SWITCHED ON", "OFF", "shutdown"),
        ("QUICK STOP ACTIVE", "OFF", "shutdown"), ("SWITCH ON DISABLED", "OFF", "disable_voltage"),
        ("FAULT", "RUN", "disable_voltage"), ("FAULT", "RESET", "fault_reset"),
    ],
)  # fmt: skip
def test_controlword_agrees_with_the_table_of_the_python_package_canopen(state, mode, word):
    known = STATE_OF[int(DATA["tables"]["statusword_masks"][state]["value"], 16)]
    assert (
        controlword(DriveMode[mode], known, edge=True, stopped=False) == DATA["tables"]["controlwords"][word]
    )


@each("TPDO1 statusword")
def test_tpdos_of_node_5_are_decoded_to_length_force_and_state_of_its_leg(v):
    m, said = decoded([frame(v)], ByValue(drives(NODES, velocity=False))), v["inputs"]
    assert m["age"].tolist() == [NEVER] * 4 + [0, NEVER]
    assert m["length"][LEG] == pytest.approx(0.75 + SCREW_m * said["position_counts"] / COUNTS, abs=1e-9)
    assert m["drive_force"][LEG] == pytest.approx(PERMILLE_N * said["torque_permille"])
    states = {561: DriveState.OFF, 567: DriveState.RUN, 536: DriveState.FAULT}
    assert m["drive_state"][LEG] == states[said["statusword"]]


def test_emcy_and_boot_up_frames_equal_those_of_the_python_package_canopen():
    _, booted = P.report(P.power_up(), Status(LEG, DriveState.BOOT, 0))
    assert booted == (frame(vectors("heartbeat INITIALISING")[0]),)
    memory = changed(RUNNING, LEG, {o.PRODUCER_HEARTBEAT: 0})
    lost = Status(LEG, DriveState.FAULT, DriveFault.WATCHDOG)
    for status, what in ((lost, "EMCY 0x8130"), (Status(LEG, DriveState.OFF, 0), "EMCY error reset")):
        memory, sent = P.report(memory, status)
        assert sent == (frame(vectors(what)[0]),)


@each("EMCY")
def test_emcy_error_code_becomes_the_fault_code_of_its_drive(v):
    assert decoded([frame(v)])["drive_fault"].tolist() == [0] * 4 + [v["inputs"]["error_code"], 0]
