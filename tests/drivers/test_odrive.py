"""ODrive CAN Simple 0.6: the contract, and bytes of the vendor's own headers."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array
from drivers.protocol import REMOTE, DriveSetup, Frame, Received
from drivers.registry import loaded
from drivers.signals import INVALID, Command, DriveFault, DriveMode, DriveState, Foreign, Reaction
from drivers.transmission import Transmission
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import answers, reports
from hil.contracts.ends import PERIOD_NS, Ends, at_tick
from hil.contracts.messages import Configure, DeviceCommand, Rejected, Status, Sync
from hil.contracts.trouble import TroubleContract
from tests.drivers.motor_families import ODriveProtocol

VECTORS = json.loads((Path(__file__).parents[1] / "data/drives/odrive.json").read_text("utf-8"))["vectors"]
GEAR = Transmission(TransmissionSettings(lead_m=0.1, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75))
UNIT = Transmission(TransmissionSettings(lead_m=1.0))
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
NODES = (0, 1, 2, 3, 5, 62)


class TestODrive(TroubleContract):
    RESOLUTION = (1e-7, 1e-6, None, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = ENDS = False
    LENGTHS, SPEED, RELATIVE = (-100.0, 100.0), 100.0, 1e-7
    BEATS, OTHER = "state", 0x200

    def beat_ids(self, protocol):
        return {node << 5 | 1 for node in NODES}

    @pytest.fixture
    def family(self):
        return ODriveProtocol(NODES, 0.05, GEAR)


def vectors(name: str) -> list[dict[str, Any]]:
    found = [each for each in VECTORS if each["what"] == f"0.6: {name}"]
    assert found
    return found


def leg_of(vector: dict[str, Any]) -> int:
    return NODES.index(vector["inputs"]["node_id"])


def unit() -> ODriveProtocol:
    return ODriveProtocol(NODES, 0.05, UNIT)


def frame(vector: dict[str, Any]) -> Frame:
    return Frame(vector["id"], bytes.fromhex(vector["data"]))


def told(dialogue: Remembered, mode: DriveMode, tick: int = 0) -> list[list[Frame]]:
    """Return the frames of a tick's command to each axis."""
    _, frames = unit().command(dialogue, Command(mode, np.zeros(6)), tick)
    return [[frame for frame in frames if frame.id >> 5 == node] for node in NODES]


@pytest.mark.parametrize("vector", vectors("Set_Input_Torque"), ids=lambda v: v["data"])
def test_a_torque_is_sent_as_the_vendors_header_packs_it(vector):
    leg = leg_of(vector)
    dialogue = (
        unit()
        .start(SETUP)
        ._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(vector["inputs"]["Input_Torque"],) * 6)
    )
    assert unit().poll(dialogue, leg) == frame(vector)


def test_states_modes_errors_and_stops_are_the_vendors_frames():
    start = unit().start(SETUP)
    closed = told(start, DriveMode.RUN)[3][0]
    ready = told(start._replace(power=(DriveState.OFF,) * 6), DriveMode.READY)[0][0]
    clear = told(start, DriveMode.RESET)[1][1]
    for sent, vector in (
        (closed, vectors("Set_Axis_State")[0]),
        (ready, vectors("Set_Controller_Mode")[0]),
        (clear, vectors("Clear_Errors")[0]),
        (unit().traits.emergency_stop[1], vectors("Estop")[0]),
    ):
        assert sent == frame(vector)
    assert unit().begin(start, 0)[1] == Frame(vectors("Get_Encoder_Estimates")[0]["id"], b"", REMOTE)


@pytest.mark.parametrize("vector", vectors("Get_Encoder_Estimates"), ids=lambda v: v["data"])
def test_estimates_are_read_and_sent_as_the_vendors_header_has_them(vector):
    leg, said = leg_of(vector), vector["inputs"]
    heard = unit().hear(frame(vector))
    assert heard is not None
    assert (heard.leg, heard.feedback) == (leg, True)
    assert heard.motion is not None
    np.testing.assert_allclose(heard.motion, (said["Pos_Estimate"], said["Vel_Estimate"]), rtol=1e-7)
    length, rate = (np.full(6, said[key]) for key in ("Pos_Estimate", "Vel_Estimate"))
    sent = answers(unit(), Sync(0, (leg,)), length, rate, np.zeros(6), np.ones(6, np.int64))
    assert sent == [(leg, frame(vector))]


@pytest.mark.parametrize("vector", vectors("Heartbeat"), ids=lambda v: v["data"])
def test_heartbeats_are_read_with_state_and_error(vector):
    heard, said = unit().hear(frame(vector)), vector["inputs"]
    if said["node_id"] not in NODES:
        assert heard is None
        return
    assert heard is not None
    assert not heard.feedback
    error = said["Axis_Error"]
    state = DriveState.RUN if said["Axis_State"] == 8 else DriveState.OFF
    assert heard.power == (DriveState.FAULT if error else state)
    assert heard.fault == (0x100 + error if error else 0)


def test_the_emulated_heartbeat_of_an_idle_axis_is_the_vendors():
    (sent,) = reports(unit(), Status(0, DriveState.OFF, DriveFault.NONE))
    assert sent == frame(vectors("Heartbeat")[0])


def test_errors_have_words_and_watchdog_and_stop_are_known_by_name():
    heard = unit().hear(Frame(0x21, struct.pack("<IBBBx", 0x2000 | 0x8, 1, 0, 0)))
    assert heard is not None
    assert unit().fault_text(heard.fault) == "missing estimate, motor over temperature"
    for fault in (DriveFault.WATCHDOG, DriveFault.ESTOP):
        (beat,) = reports(unit(), Status(1, DriveState.FAULT, fault))
        again = unit().hear(beat)
        assert again is not None
        assert again.fault == fault


@given(st.floats(-1e4, 1e4), st.integers(0, 5))
def test_a_torque_comes_out_as_the_single_that_went_in(torque, leg):
    protocol = unit()
    dialogue = protocol.start(SETUP)._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(torque,) * 6)
    memory = protocol.power_up()._replace(enabled=(True,) * 6)
    _, (command,) = protocol.parse(memory, protocol.poll(dialogue, leg))
    assert isinstance(command, DeviceCommand)
    assert command.force[0] == pytest.approx(2 * np.pi * float(np.float32(torque)), rel=1e-12)


def test_an_axis_whose_control_mode_was_never_set_does_not_close_its_loop():
    protocol = unit()
    closed = told(protocol.start(SETUP), DriveMode.RUN)[1][0]
    memory, messages = protocol.parse(protocol.power_up(), closed)
    assert messages == (Rejected(),)
    assert memory.enabled == (False,) * 6


def test_a_lost_encoder_is_a_blind_leg_and_another_controller_is_heard():
    ends = Ends(ODriveProtocol(NODES, 0.05, GEAR))
    ends.until_set_up()
    begun = ends.tick * PERIOD_NS
    state = np.array([DriveState.OFF, DriveState.OFF | INVALID, *[DriveState.OFF] * 4])
    zeros = np.zeros(6)
    frames = [f for _, f in answers(ends.protocol, Sync(0), zeros + 1.7, zeros, zeros, state)]
    m = at_tick(ends.tick + 1)
    received = [Received(begun, each) for each in (*frames, Frame(0x2E, bytes(8)))]
    ends.protocol.decode(ends.dialogue, received_array(received), ends.measurement, m, begun)
    assert m["blind"].tolist() == [0, 1, 0, 0, 0, 0]
    assert m["foreign"] == Foreign.COMMAND


def test_each_axis_is_told_by_its_own_state():
    protocol = ODriveProtocol(NODES, 0.05, GEAR)
    power = (
        DriveState.RUN,
        DriveState.OFF,
        DriveState.FAULT,
        DriveState.OFF,
        DriveState.RUN,
        DriveState.BOOT,
    )
    dialogue = protocol.start(SETUP)._replace(power=tuple(map(int, power)))
    state, modes, clear, torque = 0x07, 0x0B, 0x18, 0x0E
    for mode, kinds in (
        (DriveMode.OFF, [[state]] * 6),
        (DriveMode.READY, [[state], [modes], [state], [modes], [state], [state]]),
        (DriveMode.RUN, [[state, torque]] * 6),
        (DriveMode.RESET, [[state, clear]] * 6),
    ):
        assert [[frame.id & 0x1F for frame in frames] for frames in told(dialogue, mode)] == kinds


def test_an_axis_is_enabled_by_a_controller_that_never_sent_it_idle():
    nodes = Ends(unit()).nodes
    mode, closed = Frame(0x2B, struct.pack("<II", 1, 1)), Frame(0x27, struct.pack("<Ixxxx", 8))
    nodes.step(0, [Received(0, each) for each in (mode, closed, Frame(0x2E, struct.pack("<fxxxx", 0.5)))])
    assert nodes.snapshot().state.tolist() == [0, DriveState.RUN, 0, 0, 0, 0]
    assert nodes.snapshot().command[1] == pytest.approx(0.5 * 2 * np.pi)
    assert nodes.snapshot().rejected == 0


@pytest.mark.parametrize("kind", [0x02, 0x07, 0x0C, 0x0D, 0x0E, 0x0F, 0x16])
def test_a_set_point_of_another_controller_is_foreign_whatever_it_sets(kind):
    heard = unit().hear(Frame(5 << 5 | kind, bytes(8)))
    assert heard is not None
    assert heard.foreign
    assert heard.leg == 4


def test_silence_trips_the_watchdog_that_the_axis_has_and_the_heartbeat_says_so():
    ends = Ends(ODriveProtocol(NODES, 0.05, GEAR))
    ends.running()
    for _ in range(20):
        ends.tick += 1
        ends._to_drives(ends.tick * PERIOD_NS, ())
    for _ in range(ends.told_ticks):
        ends.step(Command(DriveMode.OFF, np.zeros(6)))
    assert ends.measurement["drive_state"].tolist() == [DriveState.FAULT] * 6
    assert ends.measurement["drive_fault"].tolist() == [DriveFault.WATCHDOG] * 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transmission": None}, "drives.transmission: protocol odrive"),
        ({"node_ids": [1, 2, 3, 4, 5, 63]}, "drives.node_ids[5]: out of range, allowed with odrive: 0 to 62"),
        ({"options": {"gain": 1}}, "drives.options: protocol odrive has encoder_msg_rate_ms, given: gain"),
        ({"options": {"encoder_msg_rate_ms": -1}}, "allowed: a whole number of 0 to 10000, given: -1"),
        ({"options": {"encoder_msg_rate_ms": 10_001}}, "allowed: a whole number of 0 to 10000, given: 10001"),
        ({"options": {"encoder_msg_rate_ms": 2.5}}, "allowed: a whole number of 0 to 10000, given: 2.5"),
        ({"heartbeat_ms": 251}, "drives.heartbeat_ms: allowed with odrive: up to 250"),
    ],
)
def test_a_row_names_what_it_does_not_have(change, message):
    values: dict[str, Any] = {"protocol": "odrive", "transmission": {"lead_m": 0.02}}
    drives = DriveSettings.model_validate(values | change)
    with pytest.raises(ConfigurationError) as caught:
        loaded("hil.protocols", "odrive")(BusSettings(layout="classic"), drives)
    assert message in str(caught.value)


def test_the_watchdog_and_the_heartbeats_of_an_axis_are_those_of_the_configuration():
    values = {"protocol": "odrive", "transmission": {"lead_m": 0.02}, "watchdog_ms": 40, "heartbeat_ms": 125}
    made = loaded("hil.protocols", "odrive")(
        BusSettings(layout="classic"), DriveSettings.model_validate(values)
    )
    protocol = ByValue(made)
    dialogue: Any = protocol.start(DriveSetup(0.04, Reaction.BRAKE, 250.0))
    assert dialogue.patience_ticks == 94, "three heartbeats of 0.125 s, whole ticks"
    idle = Frame(3 << 5 | 0x07, struct.pack("<Ixxxx", 1))
    _, messages = protocol.parse(protocol.power_up(), idle)
    (delivered,) = [each for each in messages if isinstance(each, Configure)]
    assert delivered.leg == 2
    assert delivered.watchdog_s == pytest.approx(0.04)


def test_a_brake_is_the_axis_own_and_check_says_by_which_setting():
    assert "mechanical_brake.config.gpio_num" in unit().traits.dangers[0]
