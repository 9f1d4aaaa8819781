"""The protocol `legs`: its DBC files, frames that either end refuses, and round trips against cantools."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drivers
from drivers.config import BusSettings
from drivers.legs.messages import COMMANDS
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.sensing.settings import SensorSettings, TrackerSettings
from drivers.sensors import SensorProtocol
from drivers.signals import NEVER, Command, DriveMode, DriveState, Reaction
from hil.contracts.messages import DeviceCommand, Rejected
from tests.drivers.legs_frames import bitwise_crc, command_frames, decode, one_feedback, parse, resealed

HERE = Path(drivers.__file__).parent
DATABASES: list[Any] = [cantools.database.load_file(HERE / name) for name in ("legs/legs.dbc", "sensors.dbc")]
DATABASE = DATABASES[0]
ALL_MESSAGES = [message for database in DATABASES for message in database.messages]
P = {layout: LegsProtocol(layout, (1, 2, 3, 4, 5, 6)) for layout in COMMANDS}
SENSORS = SensorProtocol(BusSettings(), SensorSettings(tracker=TrackerSettings()))
all_layouts = pytest.mark.parametrize("layout", COMMANDS)


def received(*frames: Frame) -> list[Received]:
    return [Received(i, frame) for i, frame in enumerate(frames)]


def feedback(
    layout: str, counter: int, *, leg: int = 0, length: float = 1.5, state: int = DriveState.RUN
) -> Frame:
    return one_feedback(P[layout], leg, length, 0.25, 1500.0, state, counter)


def damaged(frame: Frame, bit: int) -> Frame:
    data = bytearray(frame.data)
    data[bit // 8] ^= 1 << bit % 8
    return frame._replace(data=bytes(data))


# the DBC


@pytest.mark.parametrize(
    ("of", "name", "messages"), [(P["fd"].database, "legs.dbc", 37), (SENSORS.databases[0], "sensors.dbc", 4)]
)
def test_dbc_loads_in_strict_cantools_without_a_warning(caplog, of, name, messages):
    file, text = of
    with warnings.catch_warnings(), caplog.at_level(logging.WARNING):
        warnings.simplefilter("error")
        database: Any = cantools.database.load_string(text, "dbc", strict=True)
    assert not caplog.records
    assert (file, len(database.messages)) == (name, messages)


def test_sync_frame_is_equal_in_the_dbc_files_of_sensors_and_drives():
    ours, theirs = (database.get_message_by_name("SYNC") for database in DATABASES)
    assert (ours.frame_id, ours.length) == (theirs.frame_id, theirs.length)
    values = {"Cycle": 0xA7, "CRC": 0xC3}
    assert ours.encode(values) == theirs.encode(values)


def test_dbc_identifiers_give_urgent_messages_higher_bus_priority():
    order = ("ESTOP", "SYNC", "COMMAND", "FEEDBACK", "TRACKER", "IMU", "WRENCH", "CONFIG", "STATUS")
    kinds = [m.name.split("_")[0] for m in sorted(ALL_MESSAGES, key=lambda m: m.frame_id)]
    assert list(dict.fromkeys(kinds)) == list(order)


def test_every_physical_signal_of_the_dbc_has_a_unit_and_a_range():
    units = {"Force": "N", "Length": "m", "Rate": "m/s", "Watchdog": "s", "Offset": "s"}
    units |= {f"TRACKER{axis}": "m" for axis in "XYZ"} | {f"TRACKERR{axis}": "rad" for axis in "XYZ"}
    units |= {f"IMUW{axis}": "rad/s" for axis in "XYZ"} | {f"IMUF{axis}": "m/s^2" for axis in "XYZ"}
    units |= {f"WRENCHF{axis}": "N" for axis in "XYZ"} | {f"WRENCHM{axis}": "N m" for axis in "XYZ"}
    for message in ALL_MESSAGES:
        short = message.name.startswith(("COMMAND_CLASSIC", "FEEDBACK_FD"))
        for signal in message.signals:
            assert signal.minimum < signal.maximum, signal
            name = signal.name.rstrip("123456")
            unit = units.get(name) or units.get(message.name.split("_")[0] + name)
            assert signal.unit == ("%" if short and name == "Force" else unit), signal


def test_drive_enumerations_have_the_names_of_the_dbc():
    def names(message: str, signal: str) -> dict[int, str]:
        choices = DATABASE.get_message_by_name(message).get_signal_by_name(signal).choices
        return {int(value): str(name).upper() for value, name in choices.items()}

    assert names("COMMAND_FD", "Mode") == {int(m): m.name for m in DriveMode}
    assert names("FEEDBACK_FD_1", "State") == {int(s): s.name for s in DriveState}
    assert names("CONFIG_1", "Reaction") == {int(r): r.name for r in Reaction}


def test_dbc_messages_have_can_fd_attributes_and_cycle_times():
    sensors = {"TRACKER_7": 5, "IMU_8": 2, "WRENCH_9": 1}
    for message in ALL_MESSAGES:
        fd = message.name.startswith(("COMMAND_FD", "COMMAND_IDEAL", "FEEDBACK_FD", "FEEDBACK_IDEAL"))
        assert message.is_fd == (fd or message.name in sensors)
        assert ("CANFD_BRS" in message.dbc.attributes) == message.is_fd
        cyclic = message.name.startswith(("SYNC", "COMMAND", "FEEDBACK"))
        status = message.name.startswith("STATUS")
        assert message.cycle_time == sensors.get(message.name, 1 if cyclic else 100 if status else None)


# decode: what is refused


@all_layouts
def test_feedback_with_any_single_flipped_bit_is_refused(layout):
    frame = feedback(layout, 5)
    for bit in range(8 * len(frame.data)):
        measurement = decode(P[layout], received(damaged(frame, bit)), 5)
        assert measurement["rejected"] == 1
        assert measurement["age"][0] == NEVER


@all_layouts
def test_feedback_frame_of_wrong_length_node_or_state_is_refused(layout):
    good, at = feedback(layout, 5), {"classic": 6, "fd": 10, "ideal": 24}[layout]
    wrong = [good._replace(data=data) for data in (good.data[:-1], good.data + b"\0", b"")]
    wrong += [good._replace(id=good.id + 1)]
    wrong += [resealed(good, at, bytes([state << 4 | 5])) for state in (5, 6, 7, 13, 14, 15)]
    for frame in wrong:
        measurement = decode(P[layout], received(frame), 5)
        assert (measurement["rejected"], measurement["age"].tolist()) == (1, [NEVER] * 6), frame


@pytest.mark.parametrize("at", [0, 8, 16])
@pytest.mark.parametrize(
    "word", ["000000000000F07F", "000000000000F8FF", "000000000000F0FF", "9C7500883CE4377E"]
)
def test_feedback_value_that_is_not_finite_or_out_of_range_is_refused(at, word):
    measurement = decode(P["ideal"], received(resealed(feedback("ideal", 5), at, bytes.fromhex(word))), 5)
    assert (measurement["rejected"], measurement["age"][0]) == (1, NEVER)


@pytest.mark.parametrize("data", [b"", b"\1", b"\1\0\0", b"\1\0\0\0", b"\5\0\0\0", b"\1\6\0\0"])
def test_status_frame_that_is_short_damaged_or_of_unknown_state_is_refused(data):
    seals = [0x5A, bitwise_crc(b"\x01\x07" + data, 8)]
    for seal in seals[:1] if data == b"\1\0\0\0" else seals:  # with a correct CRC this one is valid
        measurement = decode(P["fd"], received(Frame(0x701, data + bytes([seal]))), 5)
        assert measurement["rejected"] == 1
        assert measurement["drive_fault"].tolist() == [0] * 6


# device side


@all_layouts
def test_drives_refuse_a_command_with_any_single_flipped_bit(layout):
    for frame in command_frames(P[layout], Command(DriveMode.RUN, np.arange(6.0) * 100), 5):
        for bit in range(8 * len(frame.data)):
            assert isinstance(parse(P[layout], damaged(frame, bit)), Rejected)
        assert isinstance(parse(P[layout], frame._replace(data=frame.data[:-1])), Rejected)


@all_layouts
def test_drives_refuse_a_command_with_an_unknown_mode(layout):
    at, unknown, known = {"classic": (5, 0x80, 0x60), "fd": (25, 4, 3), "ideal": (48, 0x45, 0x35)}[layout]
    for frame in command_frames(P[layout], Command(DriveMode.RUN, np.zeros(6)), 5):
        assert isinstance(parse(P[layout], resealed(frame, at, bytes([unknown]))), Rejected)
        assert isinstance(parse(P[layout], resealed(frame, at, bytes([known]))), DeviceCommand)


def test_drives_refuse_a_command_that_is_not_finite():
    (frame,) = command_frames(P["ideal"], Command(DriveMode.RUN, np.zeros(6)), 5)
    assert isinstance(parse(P["ideal"], resealed(frame, 14, b"\xf0\x7f")), Rejected)


@pytest.mark.parametrize(("at", "byte"), [(4, 4), (5, 1), (5, 7), (0, 0), (6, 1), (6, 3)])
def test_drives_refuse_an_invalid_config_frame(at, byte):
    frame = P["fd"].configure(0.000_255, Reaction.HOLD)[3]  # 255 us: only byte 0 of the watchdog is used
    assert isinstance(parse(P["fd"], resealed(frame, at, bytes([byte]))), Rejected)
    assert isinstance(parse(P["fd"], damaged(frame, 3)), Rejected)


# round trips

RESOLUTION = {"classic": (1e-7, 1e-4, None), "fd": (1e-7, 1e-7, 3.75), "ideal": (0.0, 0.0, 0.0)}
FORCE_RESOLUTION = {"classic": 3.75, "fd": 1e-3, "ideal": 0.0}
IN_NEWTONS: Any = cantools.database.load_string(P["fd"].database[1], "dbc")
COUNTS = {"classic": 255, "fd": 255, "ideal": 15}


@all_layouts
@given(
    length=st.floats(-200, 200),
    rate=st.floats(-3.2, 3.2),
    force=st.floats(-65_000, 65_000),
    state=st.sampled_from(DriveState),
    tick=st.integers(0, 1 << 40),
    leg=st.integers(0, 5),
)
def test_encoded_feedback_is_decoded_equally_by_the_controller_and_by_cantools(
    layout, length, rate, force, state, tick, leg
):
    frame = one_feedback(P[layout], leg, length, rate, force, state, tick & 15)
    measurement = decode(P[layout], received(frame), tick)
    assert measurement["age"][leg] == 0
    assert measurement["drive_state"][leg] == state
    sent = (length, rate, force)
    got = (measurement["length"][leg], measurement["rate"][leg], measurement["drive_force"][leg])
    for value, back, resolution in zip(sent, got, RESOLUTION[layout], strict=True):
        if resolution is not None:
            assert abs(value - back) <= resolution / 2 * (1 + 1e-6)

    message = IN_NEWTONS.get_message_by_name(f"FEEDBACK_{layout.upper()}_{leg + 1}")
    values = message.decode(frame.data, decode_choices=False)
    assert (values["Length"], values["Rate"]) == got[:2]
    assert (values["State"], values["Counter"]) == (state, tick & 15)
    exact = {"Length": length, "Rate": rate, "Counter": tick & 15, "State": int(state), "Invalid": 0}
    exact["CRC"] = values["CRC"]
    if "Force" in values:
        assert values["Force"] == got[2]
        exact["Force"] = force
    assert message.encode(exact) == frame.data


@all_layouts
@given(
    force=st.lists(st.floats(-60_000, 60_000), min_size=6, max_size=6),
    mode=st.sampled_from(DriveMode),
    tick=st.integers(0, 1 << 40),
)
def test_encoded_command_is_decoded_equally_by_the_drives_and_by_cantools(layout, force, mode, tick):
    frames = command_frames(P[layout], Command(mode, np.array(force)), tick)
    back: dict[int, float] = {}
    for frame in frames:
        parsed = parse(P[layout], frame)
        assert isinstance(parsed, DeviceCommand)
        assert (parsed.mode, parsed.counter) == (mode, tick & COUNTS[layout])
        back.update(zip(parsed.legs, parsed.force, strict=True))
        message = IN_NEWTONS.get_message_by_frame_id(frame.id)
        values = message.decode(frame.data, decode_choices=False)
        assert [values[f"Force{leg + 1}"] for leg in parsed.legs] == list(parsed.force)
        exact = {f"Force{leg + 1}": force[leg] for leg in parsed.legs}
        exact |= {"Counter": tick & COUNTS[layout], "Mode": int(mode), "CRC": values["CRC"]}
        assert message.encode(exact) == frame.data
    assert sorted(back) == [0, 1, 2, 3, 4, 5]
    for leg in range(6):
        assert abs(back[leg] - force[leg]) <= FORCE_RESOLUTION[layout] / 2 * (1 + 1e-6)
