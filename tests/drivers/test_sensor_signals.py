"""Sensors by their DBC: quaternion, status and packet frames, shared messages, and refused settings."""

from __future__ import annotations

from typing import Any

import cantools
import numpy as np
import pytest

from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.sensing.layout import IMU, INCLINATION, LENGTH, unheard
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from tests.drivers.cia402_drives import drives
from tests.drivers.test_sensor_vectors import (
    ACCEL,
    DATA,
    DEG,
    EXAMPLES,
    GYRO,
    LEGS,
    ROOT,
    by_dbc,
    frame,
    heard,
    of,
)
from tests.sensor_samples import hear_frames


def signals_of(v: dict[str, Any]) -> tuple[str, str, dict[str, float]]:
    """File, message and decoded signals of a vector."""
    file = f"{EXAMPLES}/xsens_mti.dbc" if v["family"].startswith("Xsens") else DATA
    database: Any = cantools.database.load_file(ROOT / file)
    message = database.get_message_by_frame_id(v["id"])
    decoded = v.get("decoded") or v.get("inputs") or {"ErrorCode": int(v["data"], 16)}
    decoded = decoded | {key.partition("_N")[0]: value for key, value in decoded.items()}  # Fx_N, Mx_Nm
    return file, message.name, {name: decoded[name] for name in message.signal_tree if name in decoded}


@pytest.mark.parametrize(
    "v",
    [
        v
        for v in of("Xsens") + of("SBG") + of("JR3", "force data", "moment data") + of("IMU by DBC")
        if v["direction"] == "from_device"
    ],
    ids=lambda v: v["key"],
)
def test_every_signal_of_quaternion_status_and_other_frames_is_decoded_to_its_value(v):
    file, message, values = signals_of(v)
    assert values
    for name, value in values.items():
        legs = dict.fromkeys(LEGS, f"{message}.{name}")
        settings = by_dbc(file, legs, units=dict.fromkeys(LEGS, "m"))
        found = heard("lengths", settings, frame(v)).slots["last"][LENGTH][0]
        assert found == pytest.approx(value, rel=1e-6, abs=1e-8), name


def test_sample_counts_only_while_the_status_word_of_the_device_reports_a_valid_filter():
    (rate,), (force,) = of("Xsens", "RateOfTurn rad/s"), of("Xsens", "Acceleration m/s^2")
    names = dict(zip(("wx", "wy", "wz", "fx", "fy", "fz"), (*GYRO, *ACCEL), strict=True))
    settings = by_dbc(f"{EXAMPLES}/xsens_mti.dbc", names, valid={"filter_valid": 1})
    for status in of("Xsens", "status word"):
        found = heard("imu", settings, frame(status), frame(rate), frame(force))
        assert found.slots["count"][IMU] == status["decoded"]["filter_valid"]
        assert found.record["rejected"] == 0


@pytest.mark.parametrize("v", of("Xsens", "velocity increment"), ids=lambda v: v["what"][:35])
def test_velocity_increment_with_another_exponent_than_that_of_the_dbc_is_no_sample(v):
    legs = dict.fromkeys(LEGS, "X")
    settings = by_dbc(
        f"{EXAMPLES}/xsens_mti.dbc", legs, units=dict.fromkeys(LEGS, "m"), valid={"Exponent": 17}
    )
    count = heard("lengths", settings, frame(v)).slots["count"][LENGTH]
    assert count == (v["decoded"]["Exponent"] == 17)


PACKET = 0xAA07080A
"""Header of the first of two frames under one identifier."""


@pytest.mark.parametrize("v", of("OptoForce", "data packet"), ids=lambda v: v["what"][-40:])
def test_packet_of_two_frames_under_one_identifier_is_decoded_with_its_status(v):
    whole = bytes.fromhex(v["decoded"]["whole_packet"])
    first, second = (frame(v)._replace(data=each) for each in (whole[:8], whole[8:]))
    assert frame(v) in (first, second)
    for k, name in enumerate(("fx", "fy", "fz")):
        legs = dict.fromkeys(LEGS, name)
        keys = {"units": dict.fromkeys(LEGS, "m"), "skip": {"Header": PACKET}}
        settings = by_dbc("tests/data/optoforce.dbc", legs, **keys)
        found = heard("lengths", settings, first, second)
        assert found.slots["count"][LENGTH] == 1
        assert found.record["rejected"] == 0, "no sum over two frames"
        counts = v["decoded"].get(
            f"{name}_counts", int.from_bytes(whole[8 + 2 * k :][:2], "big", signed=True)
        )
        assert found.slots["last"][LENGTH][0] == counts
        assert heard("lengths", settings, first).slots["count"][LENGTH] == 0
        settings = by_dbc("tests/data/optoforce.dbc", legs, **keys, valid={"Status": 0})
        assert heard("lengths", settings, first, second).slots["count"][LENGTH] == (whole[6:8] == b"\0\0")
        assert heard("lengths", settings, second).slots["count"][LENGTH] == 0, "no status, no sample"


MULTIPLEXED = """VERSION ""
BU_: CONTROLLER
BO_ 400 AXES: 4 CONTROLLER
 SG_ Axis M : 0|8@1+ (1,0) [0|0] "" CONTROLLER
 SG_ RollAngle m0 : 8|16@1- (0.01,0) [0|0] "deg" CONTROLLER
 SG_ PitchAngle m1 : 8|16@1- (0.01,0) [0|0] "deg" CONTROLLER
 SG_ Fault : 24|8@1+ (1,0) [0|0] "" CONTROLLER
"""


def test_two_values_of_one_multiplexer_make_one_sample_in_either_order(tmp_path):
    (tmp_path / "axes.dbc").write_text(MULTIPLEXED)
    settings = by_dbc(str(tmp_path / "axes.dbc"), {"roll": "RollAngle", "pitch": "PitchAngle"})
    roll, pitch = Frame(400, b"\x00\x64\x00\x00"), Frame(400, b"\x01\x9c\xff\x00")
    for frames in ((roll, pitch), (pitch, roll)):
        found = heard("inclination", settings, *frames)
        assert found.slots["last"][INCLINATION][:2] == pytest.approx([DEG, -DEG])
    assert heard("inclination", settings, roll, roll).slots["count"][INCLINATION] == 0
    settings["device"]["skip"] = {"Fault": 9}
    head = pitch._replace(data=b"\x01\x9c\xff\x09")
    assert heard("inclination", settings, roll, head).slots["count"][INCLINATION] == 0, "a head is skipped"
    settings["device"]["valid"] = {"Fault": 0}
    faulty = pitch._replace(data=b"\x01\x9c\xff\x07")
    for frames, count in (((roll, pitch), 1), ((roll, faulty), 0), ((faulty, roll), 0)):
        assert heard("inclination", settings, *frames).slots["count"][INCLINATION] == count
    protocol = SensorProtocol(BusSettings(), SensorSettings.model_validate({"inclination": settings}), ROOT)
    assert len(protocol.cyclic_frames(100)) == 2, "both in the bus budget"


def test_frames_that_start_a_sensor_of_six_legs_are_sent_once_and_never_to_a_drive():
    legs = by_dbc(DATA, {leg: f"L{n}" for n, leg in enumerate(LEGS)}, start=["600#01", "181#02"])
    protocol = SensorProtocol(BusSettings(), SensorSettings.model_validate({"lengths": legs}), ROOT)
    frames = [f for n in range(10) for f in sent_frames(protocol.set_up(n, 1000, unheard(protocol.tables)))]
    assert frames[:2] == [Frame(0x600, b"\1"), Frame(0x181, b"\2")]
    assert not protocol.starts(1)
    heard_all = unheard(protocol.tables)
    heard_all.slots["last_tick"], heard_all.slots["last_s"] = 1000, 0.0
    assert not len(protocol.set_up(1000, 1000, heard_all))
    heard_all.slots["last_tick"][LENGTH + 3] = 0
    assert len(protocol.set_up(1000, 1000, heard_all)), "one silent leg is enough"
    with pytest.raises(ConfigurationError, match=r"identifier 0x181 is also that of a drive"):
        protocol.refuse_clashes(drives((1, 2, 3, 4, 5, 6)))


def two_roles(rate_Hz: float = 100) -> SensorProtocol:
    """An inclinometer and a gyroscope in one message, SSI of a J1939 IMU."""
    file = f"{EXAMPLES}/j1939_imu.dbc"
    angles, rates = {"roll": "RollAngle", "pitch": "PitchAngle"}, {"wy": "PitchRate"}
    roles = {"inclination": by_dbc(file, angles) | {"rate_Hz": 100}, "imu": by_dbc(file, rates)}
    roles["imu"]["rate_Hz"] = rate_Hz
    return SensorProtocol(BusSettings(), SensorSettings.model_validate(roles), ROOT)


def test_two_sensors_read_one_dbc_message_that_the_bus_budget_counts_once():
    (v,) = of("IMU on J1939", "SSI:")
    protocol = two_roles()
    protocol.refuse_clashes(drives((1, 2, 3, 4, 5, 6)))
    assert len(protocol.cyclic_frames(100)) == 1
    found, decoded = unheard(protocol.tables), v["decoded"]
    hear_frames(found.record, received_array([Received(0, frame(v))]), 5, 0, 0)
    angles = [decoded["roll_deg"] * DEG, decoded["pitch_deg"] * DEG]
    assert found.slots["last"][INCLINATION][:2] == pytest.approx(angles, abs=0.0021 * DEG)
    assert found.slots["last"][IMU][1] == pytest.approx(decoded["pitch_rate_deg_s"] * DEG, abs=1e-9)


def test_two_sensors_of_unequal_rates_in_one_dbc_message_are_refused():
    with pytest.raises(ConfigurationError, match=r"sensors\.inclination.*same rate_Hz and trigger"):
        two_roles(50).refuse_clashes(drives((1, 2, 3, 4, 5, 6)))


def test_singular_matrix_of_a_force_torque_sensor_is_refused_in_one_line():
    matrix = np.eye(6)
    matrix[5] = matrix[4]
    sensors = SensorSettings.model_validate(
        {"wrench": {"device": {"protocol": "ati", "matrix": matrix.tolist()}}}
    )
    with pytest.raises(ConfigurationError, match=r"sensors\.wrench\.device\.matrix: singular") as raised:
        SensorProtocol(BusSettings(), sensors)
    assert "\n" not in str(raised.value)


def test_missing_dbc_of_a_sensor_is_refused_with_its_key(tmp_path):
    sensors = SensorSettings.model_validate({"inclination": by_dbc("none.dbc", {"roll": "SlopeLateral"})})
    with pytest.raises(ConfigurationError, match=r"sensors\.inclination\.device\.file: .*none\.dbc: No such"):
        SensorProtocol(BusSettings(), sensors, tmp_path)


def test_signal_beyond_the_bytes_of_its_message_is_refused(tmp_path):
    (tmp_path / "my.dbc").write_text((ROOT / EXAMPLES / "cia410.dbc").read_text().replace("_10: 4", "_10: 3"))
    device = by_dbc("my.dbc", {"roll": "SlopeLateral"})
    sensors = SensorSettings.model_validate({"inclination": device})
    with pytest.raises(ConfigurationError, match=r"SlopeLateral of my\.dbc: beyond the 3 bytes"):
        SensorProtocol(BusSettings(), sensors, tmp_path)


@pytest.mark.parametrize("quality", [0, 3])
def test_sensor_status_in_a_separate_message_marks_the_sample_as_invalid(quality):
    signals = {leg: f"L{n}" for n, leg in enumerate(LEGS)}
    settings = by_dbc(DATA, signals, valid={"Fault": 0})
    data, status = Frame(700, b"\x20\x4e" * 4), Frame(702, bytes([quality]))
    found = heard("lengths", settings, data, status)
    assert found.slots["count"][LENGTH] == (quality == 0)
    assert heard("lengths", settings, data).slots["count"][LENGTH] == 0, "no status, no sample"
