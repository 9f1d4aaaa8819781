"""Frames of sensors against other people's manuals, codecs and recordings (tests/data/sensor_vectors.json)."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array
from drivers.protocol import EXTENDED, Frame, Received
from drivers.sensing.ati import AtiSensor
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


@pytest.mark.parametrize("v", of("CiA 406", "command 0x22"), ids=lambda v: v["what"])
def test_download_of_a_manual_without_its_size_has_the_same_object_and_value(v):
    inputs = v["inputs"]
    value = inputs.get("value", int.from_bytes(inputs.get("text", "").encode(), "little"))
    own = written(inputs["node"], int(inputs["index"], 16), inputs["sub"], value, 4)
    assert own == frame(v)._replace(data=b"\x23" + frame(v).data[1:])


NO_SAMPLES = of("CiA 406", "answer") + of("JR3", "boot-up") + of("ATI", "answer", "matrix row")


@pytest.mark.parametrize(
    "v", [v for v in NO_SAMPLES if v["direction"] == "from_device"], ids=lambda v: v["key"]
)
def test_other_answers_of_a_sensor_are_neither_samples_nor_refused(v):
    wrench = ("fx", "fy", "fz", "mx", "my", "mz")
    role, settings = {
        "CiA": ("lengths", canopen("cia406", v["id"] & 0x7F, step_m=1e-6)),
        "JR3": ("wrench", by_dbc(DATA, {name: name.capitalize() for name in wrench})),
        "ATI": ("wrench", {"device": {"protocol": "ati", "matrix": np.eye(6).tolist()}}),
    }[v["family"][:3]]
    found = heard(role, settings, frame(v))
    assert not found.slots["count"].any()
    assert found.record["rejected"] == 0


TO_DEVICE = (
    of("OptoForce", "configuration") + of("JR3", "start", "get full") + of("ATI") + of("CiA 406", "read")
)


@pytest.mark.parametrize("v", [v for v in TO_DEVICE if v["direction"] == "to_device"], ids=lambda v: v["key"])
def test_frames_that_start_a_sensor_are_sent_as_stated(v):
    given = [f"{v['id']:03x}#{v['data']}", f"{0x18FF0000 + v['id']:08X}#01"]
    settings = by_dbc(f"{EXAMPLES}/cia410.dbc", INCLINED, start=given)
    sensors = SensorSettings.model_validate({"inclination": settings})
    own = SensorProtocol(BusSettings(), sensors, ROOT).sensors[INCLINATION].device.start
    assert own == (frame(v), Frame(0x18FF0000 + v["id"], b"\x01", EXTENDED))


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
def test_cia410_inclinometer_is_decoded_by_the_dbc_file_of_the_guide(v, tmp_path):
    text, steps = (ROOT / EXAMPLES / "cia410.dbc").read_text(), 1e-3 * v["decoded"]["resolution_0x6000"]
    (tmp_path / "own.dbc").write_text(text.replace("(0.01,0)", f"({steps:g},0)"))
    found = last("inclination", by_dbc(str(tmp_path / "own.dbc"), INCLINED), INCLINATION, frame(v))
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
        if "merit" in decoded:
            settings = by_dbc(file, settings["device"]["signals"], valid={"PitchMerit": 0, "RollMerit": 0})
            count = heard("inclination", settings, frame(v)).slots["count"][INCLINATION]
            assert count == (decoded["merit"] == 0), "0 is fully functional"


def singles(v: dict[str, Any]) -> tuple[float, ...]:
    return struct.unpack(">2f", bytes.fromhex(v["data"]))


def ati_matrix() -> np.ndarray[Any, Any]:
    """Rows of the recorded calibration, from their bytes; nan where the row is not among the vectors."""
    matrix = np.full((6, 6), np.nan)
    for v in of("ATI", "matrix row"):
        if "decoded" in v:
            row, first = (
                ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz").index(v["decoded"]["row"]),
                2 * (v["id"] % 16) - 4,
            )
            matrix[row, first : first + 2] = singles(v)
            assert [v["decoded"][f"sg{first + k}"] for k in range(2)] == list(singles(v))
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


def test_recorded_counts_and_units_of_the_ati_sensor_are_the_defaults_and_gauges_are_decoded():
    ((counts,), (units,)) = of("ATI", "two big endian uint32"), of("ATI", "answer: force N")
    own = AtiSensor.model_validate({"protocol": "ati", "matrix": np.eye(6).tolist()})
    assert struct.unpack(">2I", frame(counts).data) == (own.counts_per_N, own.counts_per_N_m)
    assert (frame(units).data, units["decoded"]["force_unit"]) == (b"\x02\x03", "N")
    settings = {"device": own.model_dump() | {"counts_per_N": 1, "counts_per_N_m": 1}}
    packets = {word: of("ATI", f"{word} packet") for word in ("first", "second")}
    for first in packets["first"]:
        for second in packets["second"]:
            gauges = first["decoded"] | second["decoded"]
            found = last("wrench", settings, WRENCH, frame(first), frame(second))
            assert found == [gauges[f"sg{k}"] for k in range(6)]


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
        ({"file": f"{EXAMPLES}/xsens_mti.dbc", "signals": {"roll": "Q1"}}, "states no unit for signal Q1"),
        ({"signals": INCLINED, "start": ["1234#01"]}, r"start: .*ID#BYTES.*given: 1234#01"),
        ({"signals": INCLINED, "start": ["101#0"]}, r"start: .*ID#BYTES"),
        ({"signals": INCLINED, "start": ["901#00"]}, r"start: .*ID#BYTES"),
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
