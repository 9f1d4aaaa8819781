"""Frames of sensors against other people's manuals, codecs and recordings (tests/data/sensor_vectors.json)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array
from drivers.protocol import EXTENDED, Frame, Received
from drivers.sensing.canopen import written
from drivers.sensing.dbc import FACTORS
from drivers.sensing.layout import FORCE, IMU, INCLINATION, LENGTH, WRENCH, Reception, unheard
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from tests.drivers.cia402_drives import drives
from tests.sensor_samples import hear_frames

ROOT = Path(__file__).parents[2]
VECTORS = {v["key"]: v for v in json.loads((ROOT / "tests/data/sensor_vectors.json").read_text())}
EXAMPLES, DATA = "docs/examples/sensors", "tests/data/sensor_messages.dbc"
DEG = np.pi / 180
LEGS = [f"leg_{leg}" for leg in range(6)]


def of(family: str, *words: str) -> list[dict[str, Any]]:
    found = [v for v in VECTORS.values() if v["family"].startswith(family)]
    return [v for v in found if any(word in v["what"] for word in words)] if words else found


def frame(vector: dict[str, Any]) -> Frame:
    return Frame(vector["id"], bytes.fromhex(vector["data"]), EXTENDED * vector["extended"])


def heard(role: str, settings: dict[str, Any], *frames: Frame) -> Reception:
    sensors = SensorSettings.model_validate({role: settings})
    found = unheard(SensorProtocol(BusSettings(), sensors, ROOT).tables)
    hear_frames(found.record, received_array([Received(n, each) for n, each in enumerate(frames)]), 5, 0, 0)
    return found


def last(role: str, settings: dict[str, Any], slot: int, *frames: Frame) -> list[float]:
    found = heard(role, settings, *frames)
    assert found.record["rejected"] == 0
    assert found.slots["count"][slot] == 1, "one sample"
    return found.slots["last"][slot].tolist()  # type: ignore[no-any-return]


def by_dbc(file: str, signals: dict[str, str], **keys: Any) -> dict[str, Any]:
    return {"device": {"protocol": "dbc", "file": file, "signals": signals, **keys}}


def canopen(protocol: str, node: int, **keys: Any) -> dict[str, Any]:
    others = [each for each in range(60, 70) if each != node][:5]
    return {"node_ids": [node, *others], "device": {"protocol": protocol, **keys}}


@pytest.mark.parametrize(
    "v", of("CiA 406", "TPDO1: position value", "TPDO2: position value"), ids=lambda v: v["what"]
)
def test_cia406_encoder_positions_written_by_the_python_package_canopen_are_decoded(v):
    value, pdo = v["decoded"]["values"][0], 2 if "TPDO2" in v["what"] else 1
    step, zero = 2.5e-6, 0.4
    settings = canopen("cia406", v["decoded"]["node"], pdo=pdo, step_m=step, zero_m=zero)
    assert last("lengths", settings, LENGTH, frame(v))[0] == pytest.approx(zero + step * value, rel=1e-12)


@pytest.mark.parametrize("v", of("CiA 406", "Temposonics E default"), ids=lambda v: v["what"])
def test_position_of_a_magnetostrictive_sensor_is_signed_and_its_pdo_may_be_longer(v):
    settings = canopen("cia406", 127, step_m=1e-9, format="int32")
    expected = 1e-9 * v["decoded"]["position_steps"]
    assert last("lengths", settings, LENGTH, frame(v))[0] == pytest.approx(expected, abs=1e-15)


WRITTEN = {
    "operating parameters": (0x6000, 2), "total range": (0x6002, 4), "preset 1000": (0x6003, 4),
    "linear step": (0x6005, 4), "TPDO1 on every SYNC": (0x1800, 1), "TPDO2 event timer": (0x1801, 2),
    "heartbeat": (0x1017, 2), "TPDO1 off": (0x1800, 4), "SDO: resolution": (0x6000, 2),
}  # fmt: skip


@pytest.mark.parametrize("what", WRITTEN)
def test_set_up_frames_of_canopen_sensors_equal_those_of_the_python_package_canopen(what):
    for v in of("CiA 406", what) + of("CiA 410", what):
        inputs, (index, size) = v["inputs"], WRITTEN[what]
        assert int(inputs["index"], 16) == index
        assert written(inputs["node"], index, inputs["sub"], inputs["value"], size) == frame(v)


@pytest.mark.parametrize(
    ("trigger", "objects"), [("sync", {2: 1}), ("cyclic", {2: 254, 5: 4}), ("change", {2: 255, 3: 40})]
)
def test_canopen_sensor_is_configured_in_pre_operational_and_then_started(trigger, objects):
    settings = canopen("cia406", 3, step_m=1e-6, trigger=trigger) | {"rate_Hz": 250}
    protocol = SensorProtocol(BusSettings(), SensorSettings.model_validate({"lengths": settings}))
    first, *writes, start = protocol.sensors[LENGTH].device.start
    assert (first, start) == (Frame(0, b"\x80\x03"), Frame(0, b"\x01\x03"))
    found = {each.data[3]: int.from_bytes(each.data[4:], "little") for each in writes}
    assert found == objects
    assert {each.data[1] | each.data[2] << 8 for each in writes} == {0x1800}


@pytest.mark.parametrize("v", of("CiA 404"), ids=lambda v: v["what"])
def test_load_cell_frame_is_decoded_according_to_its_manual(v):
    settings = canopen("cia404", 5, pdo=2, scale_N=-9.80665)
    assert last("forces", settings, FORCE, frame(v))[0] == pytest.approx(-9.80665 * v["decoded"]["measure"])


INCLINED = {"roll": "SlopeLong", "pitch": "SlopeLateral"}


@pytest.mark.parametrize("v", of("CiA 410", "resolution 10"), ids=lambda v: v["what"])
def test_cia410_inclinometer_is_decoded_by_the_dbc_file_of_the_guide(v):
    if v["decoded"]["resolution_0x6000"] == 10:
        found = last("inclination", by_dbc(f"{EXAMPLES}/cia410.dbc", INCLINED), INCLINATION, frame(v))
        expected = [v["decoded"]["long_deg"], v["decoded"]["lateral_deg"]]
        assert found[:2] == pytest.approx(np.multiply(expected, DEG), abs=1e-12)


GYRO, ACCEL = ("gyrX", "gyrY", "gyrZ"), ("accX", "accY", "accZ")


@pytest.mark.parametrize("high_rate", [False, True])
def test_xsens_rate_and_acceleration_frames_are_combined_into_one_imu_sample(high_rate):
    word = "HR" if high_rate else ""
    names = [f"Hr{n[0].upper()}{n[1:]}" if high_rate else n for n in (*GYRO, *ACCEL)]
    (rate,) = of("Xsens", f"RateOfTurn{word} rad/s")
    (force,) = of("Xsens", f"Acceleration{word} m/s^2")
    settings = by_dbc(
        f"{EXAMPLES}/xsens_mti.dbc", dict(zip(("wx", "wy", "wz", "fx", "fy", "fz"), names, strict=True))
    )
    expected = [(v["decoded"])[name] for v, own in ((rate, names[:3]), (force, names[3:])) for name in own]
    assert last("imu", settings, IMU, frame(rate), frame(force)) == pytest.approx(expected)
    assert heard("imu", settings, frame(rate)).slots["count"][IMU] == 0, "half a sample does not count"
    early, late = Received(0, frame(rate)), Received(2_000_000, frame(force))
    found = unheard(
        SensorProtocol(BusSettings(), SensorSettings.model_validate({"imu": settings}), ROOT).tables
    )
    hear_frames(found.record, received_array([early, late]), 5, 0, 0)
    assert found.slots["count"][IMU] == 0, "parts of two samples, 2 ms apart at 500 Hz"


@pytest.mark.parametrize("what", ["RateOfTurn ends", "Euler angles"])
def test_xsens_values_at_the_ends_of_their_range_and_angles_are_decoded(what):
    (v,) = of("Xsens", what)
    if "Euler" in what:
        settings = by_dbc(f"{EXAMPLES}/xsens_mti.dbc", {"roll": "roll", "pitch": "pitch"})
        expected = [v["decoded"]["roll"] * DEG, v["decoded"]["pitch"] * DEG]
        assert last("inclination", settings, INCLINATION, frame(v))[:2] == pytest.approx(expected)
    else:
        settings = by_dbc(f"{EXAMPLES}/xsens_mti.dbc", dict(zip(("wx", "wy", "wz"), GYRO, strict=True)))
        assert last("imu", settings, IMU, frame(v))[:3] == pytest.approx([v["decoded"][n] for n in GYRO])


@pytest.mark.parametrize("v", of("IMU on J1939"), ids=lambda v: v["what"])
def test_j1939_imu_frame_is_decoded_by_its_extended_identifier(v):
    file, decoded = f"{EXAMPLES}/j1939_imu.dbc", v["decoded"]
    if v["what"].startswith("ACCS"):
        names = dict(zip(("fx", "fy", "fz"), ("AccX", "AccY", "AccZ"), strict=True))
        expected = [round(decoded[f"{axis}_m_s2"], 2) for axis in "xyz"]
        assert last("imu", by_dbc(file, names), IMU, frame(v))[3:] == pytest.approx(expected, abs=1e-9)
        assert np.isnan(last("imu", by_dbc(file, names), IMU, frame(v))[:3]).all(), "no signal, no value"
    else:
        pitch, roll = ("Pitch", "Roll") if "SSI2" in v["what"] else ("PitchAngle", "RollAngle")
        settings = by_dbc(file, {"pitch": pitch, "roll": roll})
        expected = [decoded["roll_deg"] * DEG, decoded["pitch_deg"] * DEG]
        step = DEG / 32768 if "SSI2" in v["what"] else 0.002 * DEG
        assert last("inclination", settings, INCLINATION, frame(v))[:2] == pytest.approx(
            expected, abs=1.01 * step
        ), "the device truncates"
        other = frame(v)._replace(id=frame(v).id & ~0xFF | 0x21)
        assert heard("inclination", settings, other).slots["count"][INCLINATION] == 0
        settings["device"]["source_address"] = 0x21
        assert last("inclination", settings, INCLINATION, other)


@pytest.mark.parametrize("v", of("IMU by DBC"), ids=lambda v: v["what"])
def test_big_endian_fields_across_byte_limits_are_decoded_with_their_validity_bit(v):
    n, inputs = (1, v["inputs"]) if v["id"] == 308 else (2, v["inputs"])
    names = {
        f"w{axis}": f"Inertial{n}{q}Rte" for axis, q in zip("xyz", ("Roll", "Pitch", "Yaw"), strict=True)
    }
    expected = [inputs[name] * DEG for name in names.values()]
    assert last("imu", by_dbc(DATA, names), IMU, frame(v))[:3] == pytest.approx(expected)
    valid = by_dbc(DATA, names, valid={f"Inertial{n}PitchRteV": 0})
    assert heard("imu", valid, frame(v)).slots["count"][IMU] == (inputs[f"Inertial{n}PitchRteV"] == 0)


@pytest.mark.parametrize("what", ["acceleration m/s^2", "rates", "Euler rad"])
def test_sbg_imu_values_are_decoded_in_the_units_of_the_dbc(what):
    for v in of("SBG", what):
        decoded = list(v["decoded"].values())
        if "Euler" in what:
            found = last(
                "inclination", by_dbc(DATA, {"roll": "ROLL", "pitch": "PITCH"}), INCLINATION, frame(v)
            )
            assert found[:2] == pytest.approx(decoded[:2])
            continue
        first, unit, at = ("fx", "m/s^2", 3) if "acc" in what else ("wx", "rad/s", 0)
        names = {first[0] + axis: f"{'ACCEL' if at else 'GYRO'}_{axis.upper()}" for axis in "xyz"}
        settings = by_dbc(DATA, names, units=dict.fromkeys(names, unit))
        assert last("imu", settings, IMU, frame(v))[at : at + 3] == pytest.approx(decoded)


def test_jr3_force_and_moment_frames_are_combined_into_one_wrench_sample():
    forces, moments = of("JR3", "force data"), of("JR3", "moment data")
    assert len(forces) == len(moments) == 4
    for force, moment in zip(forces, moments, strict=True):
        expected = [*list(force["decoded"].values())[:3], *list(moment["decoded"].values())[:3]]
        names = dict(
            zip(("fx", "fy", "fz", "mx", "my", "mz"), ("Fx", "Fy", "Fz", "Mx", "My", "Mz"), strict=True)
        )
        assert last("wrench", by_dbc(DATA, names), WRENCH, frame(force), frame(moment)) == pytest.approx(
            expected, abs=1e-8
        )


def ati_matrix() -> np.ndarray[Any, Any]:
    """Rows of the recorded calibration; nan where the row is not among the vectors."""
    matrix = np.full((6, 6), np.nan)
    for v in of("ATI", "matrix row"):
        if "decoded" in v:
            row = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz").index(v["decoded"]["row"])
            for name, value in v["decoded"].items():
                if name != "row":
                    matrix[row, int(name[2:])] = value
    return matrix


def test_recorded_ati_wrench_samples_are_decoded_although_status_bit_14_is_set():
    matrix = ati_matrix()
    known = ~np.isnan(matrix).any(axis=1)
    assert known.tolist() == [False, False, True, False, False, False]
    device = {"protocol": "ati", "base": 127, "matrix": np.nan_to_num(matrix).tolist()}
    firsts, seconds = of("ATI", "first packet"), of("ATI", "second packet")
    pairs = [(a, b) for a in firsts for b in seconds if a["what"].split("(")[-1] == b["what"].split("(")[-1]]
    assert len(pairs) >= 4
    for first, second in pairs:
        assert first["decoded"]["status"] == 0x4000
        found = last("wrench", {"device": device}, WRENCH, frame(first), frame(second))
        assert found[2] == pytest.approx(second["decoded"]["wrench_without_bias"]["Fz_N"], abs=1e-6)
    bias = [first["decoded"].get(f"sg{k}", second["decoded"].get(f"sg{k}")) for k in range(6)]
    biased = last("wrench", {"device": device | {"bias": bias}}, WRENCH, frame(first), frame(second))
    assert biased == pytest.approx([0.0] * 6, abs=1e-12)


def test_ati_sample_with_status_bit_15_or_only_one_of_its_frames_gives_no_wrench():
    device = {"protocol": "ati", "matrix": np.eye(6).tolist(), "calibration": 0}
    first, second = frame(of("ATI", "first packet")[1]), frame(of("ATI", "second packet")[0])
    spoiled = first._replace(data=b"\xc0\x00" + first.data[2:])
    for frames, count in (((first, second), 1), ((spoiled, second), 0), ((second,), 0), ((first,), 0)):
        found = heard("wrench", {"device": device}, *frames)
        assert int(found.slots["count"][WRENCH]) == count
        assert found.record["rejected"] == 0
    requests = {v["what"].split(" (")[0]: frame(v) for v in of("ATI") if v["direction"] == "to_device"}
    sensors = SensorSettings.model_validate({"wrench": {"device": device}})
    own = SensorProtocol(BusSettings(), sensors).sensors[WRENCH].device
    assert own.poll == requests["read strain gages"]
    assert own.start == (requests["set active calibration 0"],)


@pytest.mark.parametrize(
    "file", [f"{EXAMPLES}/{name}.dbc" for name in ("cia410", "xsens_mti", "j1939_imu")] + [DATA]
)
def test_every_signal_of_a_dbc_is_decoded_as_cantools_does(file):

    database: Any = cantools.database.load_file(ROOT / file)
    chance, factors = np.random.default_rng(3), FACTORS["m"]
    for message in database.messages:
        for signal in message.signals:
            if signal.is_multiplexer or signal.multiplexer_ids or signal.minimum is None:
                continue
            name = f"{message.name}.{signal.name}"
            names = dict.fromkeys(LEGS, name)
            settings = by_dbc(file, names, units=dict.fromkeys(LEGS, "mm"))
            for _ in range(5):
                data = chance.bytes(message.length)
                value = float(message.decode(data, decode_choices=False)[signal.name])
                flags = EXTENDED * message.is_extended_frame
                found = heard("lengths", settings, Frame(message.frame_id, data, flags))
                if signal.minimum <= value <= signal.maximum:
                    assert found.slots["last"][LENGTH][0] == pytest.approx(value * factors["mm"]), name
                else:
                    assert found.record["rejected"] == 6, name


def test_multiplexed_dbc_signal_is_decoded_only_with_its_selector_value():
    settings = by_dbc(DATA, dict.fromkeys(LEGS, "Position"), offsets={"leg_0": 0.5}, negative=["leg_1"])
    data = b"\x02" + (-1500).to_bytes(4, "little", signed=True) + bytes(3)
    found = heard("lengths", settings, Frame(600, data), Frame(600, b"\x01" + data[1:]))
    assert found.slots["count"][LENGTH : LENGTH + 6].tolist() == [1] * 6
    assert found.slots["last"][LENGTH : LENGTH + 2, 0] == pytest.approx([0.5 - 1.5e-3, 1.5e-3])
    assert found.record["rejected"] == 0


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ({"signals": {"roll": "SlopeLong", "yaw": "SlopeLateral"}}, "unknown quantity.*given: yaw"),
        ({"signals": {"roll": "SlopeLong", "pitch": "SlopeLateral"}, "negative": ["rol"]}, "given: rol$"),
        ({"signals": {}}, "incomplete, missing: roll, pitch"),
        ({"signals": {"roll": "Slope"}}, "Slope of cia410.dbc: unknown"),
        ({"signals": {"roll": "SlopeLong"}, "units": {"roll": "N"}}, "roll: .*'N'.*allowed: rad"),
        ({"file": DATA, "signals": {"roll": "NoUnit"}}, "the DBC states no unit for signal NoUnit"),
        ({"file": "tests/data/README.md", "signals": {"roll": "x"}}, "README.md is not a DBC"),
    ],
)
def test_incomplete_mapping_of_dbc_signals_to_a_sensor_is_refused_in_one_line(device, message):
    settings = by_dbc(f"{EXAMPLES}/cia410.dbc", {})["device"] | device
    sensors = SensorSettings.model_validate({"inclination": {"device": settings}})
    with pytest.raises(ConfigurationError, match=rf"sensors\.inclination\.device\..*{message}") as raised:
        SensorProtocol(BusSettings(), sensors, ROOT)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("quality", [0, 3])
def test_sensor_status_in_a_separate_message_marks_the_sample_as_invalid(quality):
    signals = {leg: f"L{n}" for n, leg in enumerate(LEGS)}
    settings = by_dbc(DATA, signals, valid={"Fault": 0})
    data, status = Frame(700, b"\x20\x4e" * 4), Frame(702, bytes([quality]))
    found = heard("lengths", settings, data, status)
    assert found.slots["count"][LENGTH] == (quality == 0)
    assert heard("lengths", settings, data).slots["count"][LENGTH] == 0, "no status, no sample"


@pytest.mark.parametrize(
    ("trigger", "rate_Hz"), [("cyclic", 2000), ("cyclic", 0.01), ("change", 0.1), ("cyclic", 300)]
)
def test_sensor_rate_beyond_the_range_of_the_pdo_event_timer_is_refused(trigger, rate_Hz):
    settings = canopen("cia406", 3, step_m=1e-6, trigger=trigger) | {"rate_Hz": rate_Hz}
    with pytest.raises(ConfigurationError, match=r"sensors\.lengths\.device\.trigger: .*allowed") as raised:
        SensorProtocol(BusSettings(), SensorSettings.model_validate({"lengths": settings}))
    assert "\n" not in str(raised.value)


def test_set_up_frames_of_a_sensor_are_never_addressed_to_a_drive():
    settings = canopen("cia406", 3, step_m=1e-6, pdo=4, trigger="cyclic")
    sensors = SensorProtocol(BusSettings(), SensorSettings.model_validate({"lengths": settings}))
    with pytest.raises(ConfigurationError, match=r"identifier 0x603 is also that of a drive"):
        sensors.refuse_clashes(drives((1, 2, 3, 4, 5, 6)))
