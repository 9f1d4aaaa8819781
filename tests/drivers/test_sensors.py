"""Sensor frames: refused, late and lost samples, and round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import received_array
from drivers.legs.crc import check
from drivers.protocol import Received
from drivers.sensing.kernels import OLDEST
from drivers.sensing.settings import ImuSettings, SensorSettings, TrackerSettings, WrenchSensorSettings
from drivers.sensors import SensorProtocol
from tests import sensor_samples
from tests.sensor_samples import Readings, encode

ALL = SensorSettings(tracker=TrackerSettings(), imu=ImuSettings(), wrench=WrenchSensorSettings())
P = SensorProtocol(BusSettings(), ALL)
VALUES = (0.25, -0.5, 1.0, 0.1, -0.2, 3.0)
STEP = {"tracker": [1e-7] * 3 + [2e-9] * 3, "imu": [2e-4] * 3 + [2e-3] * 3, "wrench": [1e-3] * 6}
KINDS = ("tracker", "imu", "wrench")
every_kind = pytest.mark.parametrize("kind", KINDS)


def sample(kind, tick, counter, offset_s=0.0004):
    return encode(P, kind, VALUES, tick, offset_s, counter)


def decode(tick, *frames, before=None):
    given = received_array([Received(n, frame) for n, frame in enumerate(frames)])
    return sensor_samples.decode(P, given, tick, Readings() if before is None else before)


def damaged(frame, bit):
    data = bytearray(frame.data)
    data[bit // 8] ^= 1 << bit % 8
    return frame._replace(data=bytes(data))


@every_kind
@given(
    data=st.data(), tick=st.integers(300, 1 << 40), behind=st.integers(0, OLDEST), counter=st.integers(0, 99)
)
def test_sensor_sample_has_its_values_and_the_period_of_its_sync(kind, data, tick, behind, counter):
    ends = {"tracker": (214.0, 1.8), "imu": (6.5, 65.5), "wrench": (2e6, 2e6)}[kind]
    values = tuple(data.draw(st.floats(-end, end)) for end in np.repeat(ends, 3))
    offset = data.draw(st.floats(0, 0.0655))
    readings = decode(tick, encode(P, kind, values, tick - behind, offset, counter))
    (got,) = getattr(readings, kind)
    assert (got.tick, readings.rejected, readings.lost) == (tick - behind, 0, 0)
    assert not any(getattr(readings, other) for other in KINDS if other != kind)
    assert abs(got.offset_s - offset) <= 0.5e-6 * (1 + 1e-6)
    for back, value, step in zip(got.values, values, STEP[kind], strict=True):
        assert abs(back - value) <= step / 2 * (1 + 1e-6)


@every_kind
def test_sensor_frame_with_a_flipped_bit_or_wrong_length_is_refused(kind):
    frame = sample(kind, 5, 1)
    for bit in range(8 * len(frame.data)):
        assert decode(5, damaged(frame, bit)) == Readings(rejected=1)
    for data in (frame.data[:-1], frame.data + b"\0", b""):
        assert decode(5, frame._replace(data=data)) == Readings(rejected=1)


@pytest.mark.parametrize(
    ("tick", "stamp", "counts"),
    [(300, 301, 0), (300, 300, 1), (300, 173, 1), (300, 172, 0), (3, 255, 0), (3, 0, 1)],
)
def test_sensor_sample_with_a_time_stamp_in_the_future_or_too_old_is_refused(tick, stamp, counts):
    readings = decode(tick, sample("tracker", stamp, 1))
    assert (len(readings.tracker), readings.rejected) == (counts, 1 - counts)


@every_kind
def test_gap_in_the_sample_counter_counts_as_lost_samples_and_a_repetition_is_ignored(kind):
    others = [sample(each, 9, counter) for each, counter in zip(KINDS, (1, 14, 1), strict=True)]
    first = decode(
        10, sample(kind, 9, 14), *(f for f, each in zip(others, KINDS, strict=True) if each != kind)
    )
    assert first.lost == 0
    second = decode(15, sample(kind, 14, 1), before=first)
    assert (second.lost, len(getattr(second, kind))) == (2, 1)
    again = decode(16, sample(kind, 14, 1), before=second)
    assert (again.lost, getattr(again, kind), again.rejected) == (0, (), 0)


def test_sensor_samples_of_a_period_are_in_order_of_time():
    readings = decode(20, sample("tracker", 18, 2), sample("tracker", 15, 1))
    assert [s.tick for s in readings.tracker] == [15, 18]


@pytest.mark.parametrize(
    ("r", "rejected"),
    [
        ((2.0, 2.0, 1.36), 0),
        ((2.0, 2.0, 1.4), 1),
        ((np.pi * (1 + 0.5e-6), 0.0, 0.0), 0),
        ((np.pi * (1 + 1.5e-6), 0.0, 0.0), 1),
        ((0.0, 3.14159, 0.0), 0),
        ((0.0, -3.15, 0.0), 1),
        ((0.0, 0.0, -3.15), 1),
    ],
)
def test_tracker_sample_with_a_rotation_vector_longer_than_half_a_turn_is_refused(r, rejected):
    assert decode(5, encode(P, "tracker", (0, 0, 0, *r), 5, 0.0, 1)).rejected == rejected


def test_sample_of_nan_or_with_a_time_offset_beyond_its_field_has_no_frame():
    assert encode(P, "imu", (float("nan"), *VALUES[1:]), 5, 0.0, 3) is None
    assert encode(P, "imu", VALUES, 5, 0.065535, 3).data[12:14] == b"\xff\xff"
    for offset in (-1e-3, 0.065536, float("nan"), float("inf")):
        assert encode(P, "imu", VALUES, 5, offset, 3) is None


@every_kind
def test_sensor_frame_with_an_unknown_validity_code_is_refused(kind):
    frame, at = sample(kind, 5, 3), 15 if kind == "imu" else 27
    for validity, there, rejected in ((0, 1, 0), (1, 0, 0), (2, 0, 1), (3, 0, 1), (15, 0, 1)):
        data = frame.data[:at] + bytes([validity << 4 | 3]) + frame.data[at + 1 : -1]
        readings = decode(5, frame._replace(data=data + bytes([check(frame.id, data, 1)])))
        assert (len(getattr(readings, kind)), readings.rejected) == (there, rejected), validity


def test_sensors_are_refused_on_the_bus_layout_classic():
    with pytest.raises(ConfigurationError, match=r"sensors\.tracker"):
        SensorProtocol(BusSettings(layout="classic"), ALL)
    assert not SensorProtocol(BusSettings(layout="classic"), SensorSettings()).sensors


def test_bus_budget_counts_all_sensor_samples_that_can_fall_into_a_period():
    assert [len(f.data) for f in P.cyclic_frames(1000.0)] == [32, 20, 32]
    assert len(P.cyclic_frames(500.0)) == 1 + 1 + 2
    assert len(P.cyclic_frames(1000.0 * (1 - 0.5e-9))) == 3, "rounding adds no frame"
    assert len(P.cyclic_frames(1000.0 * (1 - 1.5e-9))) == 4
    assert len(P.cyclic_frames(200.0)) == 1 + 3 + 5


@pytest.mark.parametrize(
    ("place", "end", "step"), [(0, 6.5534, 2e-4), (2, -6.5536, -2e-4), (5, 65.534, 2e-3)]
)
def test_sensor_value_beyond_the_range_of_its_field_is_sent_as_invalid(place, end, step):
    for beyond, samples in ((0.0, 1), (0.4, 0), (1e6, 0)):
        values = [0.0] * 6
        values[place] = end + beyond * step
        readings = decode(9, encode(P, "imu", values, 9, 0.0, 3))
        assert (len(readings.imu), readings.rejected) == (samples, 0)
        assert readings.counters[KINDS.index("imu")] == 3, "its node has sent a frame"
