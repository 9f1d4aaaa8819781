"""CANopen sensors whose frames the package canopen makes: set-up by our frames, and PDOs of its LocalNode.

Their objects are those of CiA 406 (0x6004, 0x6020), CiA 404 (0x6130) and CiA 410 (0x6010, 0x6020). canopen has
no knowledge of our tables, so it shows a mistake that both our ends share.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from drivers.config import BusSettings
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.sensing.layout import Reception, unheard
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from hil.contracts.sensor import hear_frames

canopen: Any = import_module("canopen")
datatypes: Any = import_module("canopen.objectdictionary.datatypes")
CHANNELS = (f"sensors{n}" for n in itertools.count())
EXAMPLES = Path(__file__).parents[2] / "docs/examples/sensors"
ON = "OPERATIONAL"
NODE = 11


def variable(index: int, sub: int, kind: int, name: str) -> Any:
    made = canopen.objectdictionary.ODVariable(name, index, sub)
    made.data_type, made.access_type, made.default, made.pdo_mappable = kind, "rw", 0, True
    return made


def dictionary(pdo: int, values: dict[tuple[int, int], int]) -> Any:
    """Object dictionary with a TPDO that maps `values`: (index, subindex) -> data type."""
    od = canopen.ObjectDictionary()
    sizes = {datatypes.INTEGER16: 16, datatypes.UNSIGNED16: 16}
    for (index, sub), kind in values.items():
        if sub == 0:
            od.add_object(variable(index, 0, kind, f"value {index:X}"))
            continue
        record = canopen.objectdictionary.ODRecord(f"values {index:X}", index)
        record.add_member(variable(index, 0, datatypes.UNSIGNED8, "number"))
        record.add_member(variable(index, sub, kind, "value"))
        od.add_object(record)
    communication = canopen.objectdictionary.ODRecord("communication", 0x1800 + pdo - 1)
    kinds = {0: datatypes.UNSIGNED8, 1: datatypes.UNSIGNED32, 2: datatypes.UNSIGNED8}
    kinds |= {3: datatypes.UNSIGNED16, 5: datatypes.UNSIGNED16}
    for sub, kind in kinds.items():
        communication.add_member(variable(0x1800 + pdo - 1, sub, kind, f"sub {sub}"))
    mapping = canopen.objectdictionary.ODRecord("mapping", 0x1A00 + pdo - 1)
    mapping.add_member(variable(0x1A00 + pdo - 1, 0, datatypes.UNSIGNED8, "number"))
    for k, ((index, sub), kind) in enumerate(values.items(), 1):
        entry = variable(0x1A00 + pdo - 1, k, datatypes.UNSIGNED32, f"entry {k}")
        entry.default = index << 16 | sub << 8 | sizes.get(kind, 32)
        mapping.add_member(entry)
    od.add_object(communication)
    od.add_object(mapping)
    return od


class Bus:
    """A LocalNode on a virtual bus, and our end of it."""

    def __init__(self, node: int, od: Any) -> None:
        channel = next(CHANNELS)
        self.ours = can.Bus(interface="virtual", channel=channel)
        self.network = canopen.Network(bus=can.Bus(interface="virtual", channel=channel))
        self.network.connect()
        self.node = self.network.add_node(canopen.LocalNode(node, od))

    def send(self, frame: Frame) -> list[Frame]:
        """Send a frame of ours; return what the node sends within 50 ms."""
        self.ours.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))
        return self.sent()

    def sent(self) -> list[Frame]:
        found = []
        while message := self.ours.recv(0.05):
            found.append(Frame(message.arbitration_id, bytes(message.data)))
        return found

    def close(self) -> None:
        self.network.disconnect()
        self.ours.shutdown()


@pytest.fixture
def buses() -> Iterator[list[Bus]]:
    made: list[Bus] = []
    yield made
    for each in made:
        each.close()


def protocol_of(role: str, settings: dict[str, Any]) -> SensorProtocol:
    return SensorProtocol(BusSettings(), SensorSettings.model_validate({role: settings}), EXAMPLES)


def transmit(bus: Bus, pdo: int, values: dict[tuple[int, int], Any]) -> list[Frame]:
    """Have the node send its TPDO with raw values of mapped objects."""
    tpdo = bus.node.tpdo[pdo]
    tpdo.cob_id = 0x080 + 0x100 * pdo + bus.node.id
    tpdo.clear()
    for index, sub in values:
        tpdo.add_variable(index, sub)
    for variable_, value in zip(tpdo, values.values(), strict=True):
        variable_.raw = value
    tpdo.transmit()
    return bus.sent()


def heard(protocol: SensorProtocol, frames: list[Frame]) -> Reception:
    reception = unheard(protocol.tables)
    hear_frames(reception, received_array([Received(1000, frame) for frame in frames]), 5, 0)
    assert int(reception.record["rejected"]) == 0
    return reception


LEGS: dict[str, tuple[str, dict[str, Any], int, dict[tuple[int, int], int], Any, float]] = {
    "draw-wire encoder": (
        "lengths", {"protocol": "cia406", "step_m": 1e-5, "zero_m": 0.2},
        1, {(0x6004, 0): datatypes.UNSIGNED32}, 123_456, 0.2 + 1.23456,
    ),
    "linear sensor, cyclic": (
        "lengths", {"protocol": "cia406", "trigger": "cyclic", "format": "int32", "step_m": -1e-6, "zero_m": 1.5},
        2, {(0x6020, 1): datatypes.INTEGER32}, -250_000, 1.75,
    ),
    "load cell, on change": (
        "forces", {"protocol": "cia404", "trigger": "change", "scale_N": 2.0, "zero_N": 3.0},
        2, {(0x6130, 1): datatypes.REAL32}, -12.5, -22.0,
    ),
}  # fmt: skip
"""Device: role, section `device`, TPDO, objects that it maps, raw value, value in SI."""
TYPES = {"sync": 1, "cyclic": 254, "change": 255}


@pytest.mark.parametrize("name", LEGS)
def test_encoder_of_the_python_package_canopen_is_set_up_and_its_pdo_gives_the_leg_length(name, buses):
    role, device, pdo, objects, raw, expected = LEGS[name]
    protocol = protocol_of(role, {"rate_Hz": 100, "device": device | {"pdo": pdo}})
    bus = Bus(NODE, dictionary(pdo, objects))
    buses.append(bus)
    states = []
    silent = unheard(protocol.tables)
    for tick in range(100):
        for frame in sent_frames(protocol.set_up(tick, 100.0, silent)):
            if protocol.starts(tick) and (frame.id == 0x600 + NODE or frame.data[1:] == bytes([NODE])):
                answers = bus.send(frame)
                states.append(bus.node.nmt.state)
                confirmed = [answer.data[0] for answer in answers if answer.id == 0x580 + NODE]
                assert confirmed == [0x60] * (frame.id == 0x600 + NODE), frame
    assert (states[0], states[-1]) == ("PRE-OPERATIONAL", ON)
    trigger = device.get("trigger", "sync")
    assert bus.node.sdo[0x1800 + pdo - 1][2].raw == TYPES[trigger]
    if trigger == "cyclic":
        assert bus.node.sdo[0x1800 + pdo - 1][5].raw == 10, "ms"
    reception = heard(protocol, transmit(bus, pdo, dict.fromkeys(objects, raw)))
    slot = next(iter(protocol.sensors))
    assert reception.slots["last"][slot][0] == pytest.approx(expected, abs=1e-6)


def test_pdo_of_an_inclinometer_of_the_python_package_canopen_gives_roll_and_pitch(buses):
    device: dict[str, Any] = {"protocol": "dbc", "file": "cia410.dbc"}
    device |= {"signals": {"roll": "SlopeLong", "pitch": "SlopeLateral"}, "latency_ms": 5}
    protocol = protocol_of("inclination", {"rate_Hz": 100, "device": device})
    objects = {(0x6010, 0): datatypes.INTEGER16, (0x6020, 0): datatypes.INTEGER16}
    bus = Bus(10, dictionary(1, objects))
    buses.append(bus)
    frames = transmit(bus, 1, {(0x6010, 0): 1234, (0x6020, 0): -567})
    assert [(frame.id, frame.data.hex()) for frame in frames] == [(394, "d204c9fd")], "the vector"
    reception = heard(protocol, frames)
    (slot,) = protocol.sensors
    assert np.rad2deg(reception.slots["last"][slot][:2]) == pytest.approx([12.34, -5.67])
