"""The package canopen 2.4.1 brings up our emulated drives; our controller sets up drives of canopen.

Others wrote canopen from the same documents, so it shows a mistake that both our ends share.
"""

from __future__ import annotations

import itertools
import threading
import time
from importlib import import_module, metadata
from typing import Any

import can
import numpy as np
import pytest

from drivers.cia402.objects import ABORTS
from drivers.config import DriveSettings
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.loopback import Placed
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from tests.drivers.cia402_drives import COUNTS, PERMILLE_N, RATED_Nm, SCREW_m, drives
from tests.drivers.cia402_sheet import sheet

canopen: Any = import_module("canopen")
BaseNode402: Any = import_module("canopen.profiles.p402").BaseNode402
CHANNELS = (f"cia402_{n}" for n in itertools.count())
MASS_kg = 50.0
NODE = 5
LEG = 4


def to_message(frame: Frame) -> can.Message:
    return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)


def from_message(message: can.Message) -> Frame:
    return Frame(message.arbitration_id, bytes(message.data))


@pytest.fixture(autouse=True)
def _version():
    assert metadata.version("canopen") == "2.4.1", "the version of the vectors"


@pytest.fixture
def od(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(sheet(), encoding="ascii")
    return lambda node: canopen.import_od(str(path), node)


@pytest.fixture
def network():
    channel = next(CHANNELS)
    network = canopen.Network(bus=can.Bus(interface="virtual", channel=channel))
    network.connect()
    yield network, channel
    network.sync.stop()
    network.disconnect()


class Carts(Placed):
    """Six masses on the legs, held by closed brakes."""

    internal_step_s = 1e-3

    def reset(self):
        self.x, self.v = np.full(LEGS, 1.0), np.zeros(LEGS)
        return self.x.copy(), self.v.copy()

    def step(self, force, brake, _wrench, dt_s):
        self.v = np.where(brake > 0.5, 0.0, self.v + force / MASS_kg * dt_s)
        self.x = self.x + self.v * dt_s
        return self.x.copy(), self.v.copy()


class Emulated:
    """Our six drives on a python-can bus, in their own thread."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.carts = Carts(np.zeros(LEGS))
        settings = DriveSettings(heartbeat_ms=60.0)
        self.nodes = Nodes(self.carts, drives(), DriveEmulation(encoder_resolution_m=0.0), settings)
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._live)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()
        self.bus.shutdown()

    def _live(self) -> None:
        begin = time.monotonic_ns()
        while not self.over.is_set():
            message = self.bus.recv(0.001)
            t = time.monotonic_ns() - begin
            received = [] if message is None else [Received(t, from_message(message))]
            for _, frame in self.nodes.step(t, received):
                self.bus.send(to_message(frame))


def map_cyclic(node) -> None:
    node.rpdo.read()
    node.tpdo.read()
    for pdo, indices, kind in (
        (node.rpdo[1], (0x6040, 0x6071), 255),
        (node.tpdo[1], (0x6041, 0x6064, 0x6077), 1),
    ):
        pdo.clear()
        for index in indices:
            pdo.add_variable(index)
        pdo.trans_type, pdo.enabled = kind, True
        pdo.save()


def test_python_package_canopen_enables_and_moves_an_emulated_drive(network, od):
    network, channel = network
    node = network.add_node(BaseNode402(NODE, od(NODE)))
    with Emulated(channel) as emulated:
        node.nmt.wait_for_bootup(5)
        assert node.sdo[0x1000].raw & 0xFFFF == 402
        map_cyclic(node)
        node.setup_402_state_machine()
        node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
        node.nmt.state = "OPERATIONAL"
        network.sync.start(0.01)
        time.sleep(0.1)
        visited = []
        node.tpdo[1].add_callback(lambda _: visited.append(node.state))
        node.state = "OPERATION ENABLED"
        brakes = emulated.nodes.snapshot().brake
        assert brakes.tolist() == [float(leg != LEG) for leg in range(LEGS)]
        node.rpdo[1]["Target torque"].raw = 50
        node.rpdo[1].transmit()
        pushed = time.monotonic()
        time.sleep(0.5)
        x, pushed_s = emulated.carts.x.copy(), time.monotonic() - pushed
        counts = node.tpdo_values[0x6064]
        assert node.tpdo_values[0x6077] == 50
        assert emulated.carts.v[LEG] == pytest.approx(50 * PERMILLE_N / MASS_kg * pushed_s, rel=0.25)
        assert counts * SCREW_m / COUNTS + 0.75 == pytest.approx(x[LEG], abs=0.1)
        assert [x[k] for k in range(LEGS) if k != LEG] == [1.0] * 5
        states = [state for state, _ in itertools.groupby(visited)]
        assert states[-3:] == ["READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"]
        node.controlword = 0x02
        time.sleep(0.03)
        assert node.state in ("QUICK STOP ACTIVE", "SWITCH ON DISABLED")
        time.sleep(0.2)
        assert node.state == "SWITCH ON DISABLED"
        assert emulated.nodes.snapshot().brake[LEG] == 1.0


def test_python_package_canopen_reads_abort_codes_and_emcy_of_an_emulated_drive(network, od):
    network, channel = network
    node = network.add_node(BaseNode402(NODE, od(NODE)))
    with Emulated(channel):
        node.nmt.wait_for_bootup(5)
        for index, sub, data, code in (
            (0x2000, 0, None, 0x06020000),
            (0x1600, 9, None, 0x06090011),
            (0x6041, 0, bytes(2), 0x06010002),
            (0x6040, 0, bytes(4), 0x06070012),
            (0x6040, 0, bytes(1), 0x06070013),
            (0x6060, 0, b"\x08", 0x06090030),
            (0x1600, 1, bytes(4), 0x08000022),
        ):
            with pytest.raises(canopen.SdoAbortedError) as refused:
                node.sdo.upload(index, sub) if data is None else node.sdo.download(index, sub, data)
            assert refused.value.code == code, hex(index)
        map_cyclic(node)
        node.sdo[0x1016][1].raw = 0x7F << 16 | 100
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        network.sync.start(0.01)
        time.sleep(0.05)
        beat = network.send_periodic(0x77F, b"\x05", 0.02)
        node.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
        node.state = "OPERATION ENABLED"
        time.sleep(0.3)
        assert node.state == "OPERATION ENABLED"
        beat.stop()
        emergency = node.emcy.wait(timeout=2)
        assert (emergency.code, emergency.register) == (0x8130, 0x11)
        time.sleep(0.05)
        assert node.sdo[0x6041].raw & 0x4F == 0x08
        assert node.sdo[0x603F].raw == 0x8130


class Local:
    """Six drives made of canopen's LocalNode: its SDO server, its NMT, its PDO packing."""

    def __init__(self, network, od) -> None:
        self.nodes = []
        for number in range(1, LEGS + 1):
            node = canopen.LocalNode(number, od(number))
            network.add_node(node)
            node.sdo[0x6076].raw = round(1e3 * RATED_Nm)
            node.sdo[0x608F][1].raw = COUNTS
            node.sdo[0x6041].raw = 0x250
            node.add_write_callback(self._mode(node))
            self.nodes.append(node)
        network.subscribe(0x080, self._on_sync)

    @staticmethod
    def _mode(node):
        def follow(index, data, **_):
            if index == 0x6060:
                node.sdo[0x6061].raw = int.from_bytes(data, "little", signed=True)

        return follow

    def _on_sync(self, *_):
        for k, node in enumerate(self.nodes):
            if node.nmt.state == "OPERATIONAL":
                node.tpdo.read(from_od=False)
                for pdo in (node.tpdo[1], node.tpdo[2]):
                    if pdo.enabled:
                        shown = {0x6041: 0x250, 0x6064: 1000 * (k + 1), 0x6077: -k, 0x606C: 10 * k}
                        for variable in pdo:
                            variable.raw = shown[variable.index]
                        pdo.transmit()


def test_controller_sets_up_six_drives_implemented_with_the_python_package_canopen(network, od):
    network, channel = network
    local = Local(network, od)
    protocol = ByValue(drives())
    bus = can.Bus(interface="virtual", channel=channel)
    dialogue = protocol.start(DriveSetup(0.05, Reaction.BRAKE, 100.0))
    tick, begin = new_record(), time.monotonic_ns()
    try:
        for number in range(400):
            since = time.monotonic_ns() - begin
            for frame in protocol.begin(dialogue, number):
                bus.send(to_message(frame))
            received = []
            while time.monotonic_ns() - begin < since + 8_000_000:
                message = bus.recv(0.001)
                if message is not None:
                    received.append(Received(time.monotonic_ns() - begin, from_message(message)))
            last, tick = tick, new_record()
            tick["tick"] = number
            dialogue = protocol.decode(dialogue, received_array(received), last, tick, since)
            dialogue, sent = protocol.command(dialogue, Command(DriveMode.OFF, np.zeros(LEGS)), number)
            dialogue, asked = protocol.set_up(dialogue, tick)
            for frame in (*sent, *asked):
                bus.send(to_message(frame))
            if all(protocol.legs_set_up(dialogue)) and tick["age"].tolist() == [0] * LEGS:
                break
    finally:
        bus.shutdown()
    assert protocol.set_up_lacks(dialogue) == ("",) * LEGS
    for node in local.nodes:
        node.rpdo.read()
        assert (node.rpdo[1].cob_id, node.rpdo[1].trans_type) == (0x200 + node.id, 255)
        assert [v.index for v in node.rpdo[1]] == [0x6040, 0x6071]
        assert (node.tpdo[1].cob_id, node.tpdo[1].trans_type) == (0x180 + node.id, 1)
        assert [v.index for v in node.tpdo[1]] == [0x6041, 0x6064, 0x6077]
        assert [v.index for v in node.tpdo[2]] == [0x606C]
        assert node.sdo[0x1016][1].raw == 127 << 16 | 50
        assert (node.sdo[0x6060].raw, node.sdo[0x605E].raw, node.sdo[0x605A].raw) == (10, 0, 2)
    assert tick["drive_state"].tolist() == [DriveState.OFF] * LEGS
    turns = 1000 * np.arange(1, 7) / COUNTS
    expected = np.array([0.75] * 5 + [0.5]) + np.array([1, -1, 1, -1, 1, 1]) * SCREW_m * turns
    np.testing.assert_allclose(tick["length"], expected, rtol=0, atol=1e-12)


def test_every_abort_code_with_a_text_is_known_to_the_python_package_canopen():
    known = import_module("canopen.sdo.exceptions").SdoAbortedError.CODES
    assert len(set(ABORTS.values())) == len(ABORTS) > 20
    assert set(ABORTS) <= set(known)
