"""Rules between sections of a configuration: each at both sides of its bound, and at each leg it may be."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.config import BusSettings, DriveSettings, SensorSettings
from hil.app.configuration.configuration import load
from hil.app.configuration.consistency import (
    bench_rest,
    bit_rates,
    brake_times,
    fusion_sources,
    node_numbers,
    sensor_rates,
    standstill,
)
from hil.app.configuration.drive_rules import homing, reported_stroke
from hil.app.configuration.reference_rules import frequencies
from hil.config.reference import MultisineAxis, MultisineReference
from hil.config.running import EngageSettings
from plant_fmu.config import BenchPlant, DriveEmulation, PlantSettings

DESKTOP = load("desktop")
VIRTUAL = load("virtual")
LEGS = range(6)


def plant(rest_m: float = 1.6, **drives: float) -> PlantSettings:
    bench = BenchPlant(type="bench", rest_length_m=rest_m)
    return PlantSettings(model=bench, drives=DriveEmulation(**drives))


@pytest.mark.parametrize(
    ("engage", "refused"),
    [
        (EngageSettings(brake_release_s=0.05, brake_close_s=0.03), []),
        (EngageSettings(brake_release_s=0.049, brake_close_s=0.03), ["brake_open_ms"]),
        (EngageSettings(brake_release_s=0.05, brake_close_s=0.029), ["brake_close_ms"]),
        (EngageSettings(brake_release_s=0.05), []),
        (EngageSettings(brake_release_s=0.05, brake_close_s=0.0), ["brake_close_ms"]),
        (EngageSettings(brake_release_s=0.029), ["brake_open_ms", "brake_close_ms"]),
        (EngageSettings(brake_release_s=0.04), ["brake_open_ms"]),
    ],
)
def test_emulated_brakes_that_outlast_the_time_they_are_given_are_refused_each_by_its_own(engage, refused):
    found = list(brake_times(plant(brake_open_ms=50.0, brake_close_ms=30.0), engage, None))
    assert [path for path, _ in found] == [("plant", "drives", key) for key in refused]
    assert list(brake_times(None, engage, None)) == []


@pytest.mark.parametrize(("share", "fine"), [(1.001, True), (0.999, False)])
def test_a_tolerance_of_standstill_below_four_steps_of_an_encoder_is_refused(share, fine):
    limits = VIRTUAL.limits.model_copy(update={"standstill_m": share * 4 * 3e-4})
    found = list(standstill(plant(encoder_resolution_m=3e-4), limits, None))
    assert [path for path, _ in found] == ([] if fine else [("limits", "standstill_m")])
    assert fine or "allowed: at least 0.0012 (4 x" in found[0][1]
    assert list(standstill(None, limits, None)) == []


@pytest.mark.parametrize(("rate_Hz", "oldest_ms"), [(1000.0, 126.0), (500.0, 252.0), (2000.0, 63.0)])
def test_a_tracker_may_be_as_late_as_126_ticks_and_no_later(rate_Hz, oldest_ms):
    """A stamp tells up to 127 ticks back, and one of them is spare."""
    loop = VIRTUAL.loop.model_copy(update={"rate_Hz": rate_Hz})
    found = []
    for latency_ms in (oldest_ms - 0.1, oldest_ms + 0.1, 2.0 * oldest_ms):
        tracker = {"rate_Hz": 100.0, "latency_max_ms": latency_ms}
        sensors = SensorSettings.model_validate({"tracker": tracker})
        found.append([path for path, _ in sensor_rates(sensors, loop, None)])
    late = [("sensors", "tracker", "latency_max_ms")]
    assert found == [[], late, late]


@pytest.mark.parametrize(
    ("rest_m", "fine"),
    [(0.76, True), (2.19, True), (0.75, False), (0.74, False), (2.2, False), (2.21, False)],
)
def test_bench_legs_rest_within_the_stroke(rest_m, fine):
    found = list(bench_rest(plant(rest_m), VIRTUAL.platform, None))
    assert [path for path, _ in found] == ([] if fine else [("plant", "model", "rest_length_m")])


@pytest.mark.parametrize("finest", LEGS)
@pytest.mark.parametrize(("limit_m", "fine"), [(0.00249, True), (0.00251, False)])
def test_a_limit_of_homing_is_below_a_quarter_of_what_the_finest_leg_forgets(finest, limit_m, fine):
    """A turn is 40 mm of leg, of the finest one 10 mm; each motor turns as its gear says."""
    gears = [4.0 if leg == finest else 1.0 for leg in LEGS]
    signs = [1 if leg % 2 else -1 for leg in LEGS]
    drives = DriveSettings.model_validate(
        {
            "protocol": "mit", "options": {"variant": "damiao", "model": "DM4310"},
            "transmission": {"lead_m": 0.04, "gear_ratio": gears, "sign": signs},
            "homing": {"file": "a.yaml", "limit_m": limit_m},
        }
    )  # fmt: skip
    found = list(homing(drives, None))
    assert [path for path, _ in found] == ([] if fine else [("drives", "homing", "limit_m")])
    assert fine or "less than 0.0025," in found[0][1]


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_position_field_that_ends_before_either_end_of_a_stroke_is_refused(leg, way):
    """12.5 rad of 20 mm are 0.25 m about the offset; the stroke goes 0.075 m either way from 0.325 m."""
    assert DESKTOP.drives.transmission is not None
    for beyond_m, fine in ((-1e-3, True), (1e-3, False)):
        offsets = np.full(6, 0.325)
        offsets[leg] += way * (0.175 + beyond_m)
        gear = DESKTOP.drives.transmission.model_copy(update={"offset_m": offsets.tolist()})
        drives = DESKTOP.drives.model_copy(update={"transmission": gear})
        found = list(reported_stroke(DESKTOP.bus, drives, DESKTOP.platform, None))
        assert [path for path, _ in found] == ([] if fine else [("drives", "transmission")])
        assert fine or f"drive {leg} reports ends at" in found[0][1]


@pytest.mark.parametrize("second", [0, 1, 2])
def test_a_bit_rate_is_refused_at_the_bus_that_has_it(second):
    channels = [{"channel": f"can{k}", "legs": [2 * k, 2 * k + 1]} for k in range(3)]
    channels[second] |= {"bitrate_bit_s": 2_000_000}
    found = bit_rates(BusSettings.model_validate({"channels": channels}), None)
    assert [path for path, _ in found] == [("bus", "channels", second, "bitrate_bit_s")]


def test_a_sensor_has_no_number_of_a_drive_and_none_of_another_sensor():
    tracker, imu, wrench = ({"rate_Hz": 100.0, "node_id": number} for number in (20, 3, 20))
    tracker |= {"latency_max_ms": 10.0}
    sensors = SensorSettings.model_validate({"tracker": tracker, "imu": imu, "wrench": wrench})
    found = {path[1]: message for path, message in node_numbers(DESKTOP.drives, sensors, None)}
    assert "one that drives.node_ids does not have, given: 3" in found.pop("imu")
    (message,) = found.values()
    assert ".node_id does not have, given: 20" in message


@pytest.mark.parametrize(
    ("pose", "seen"), [("fused", True), ("fused", False), ("legs", True), ("legs", False)]
)
def test_legs_are_lost_only_where_a_fused_pose_is_seen_from_outside(pose, seen):
    fusion = VIRTUAL.estimation.fusion.model_copy(update={"may_lose_legs": "one"})
    estimation = VIRTUAL.estimation.model_copy(update={"pose": pose, "fusion": fusion})
    tracker = {"tracker": {"rate_Hz": 100.0, "latency_max_ms": 10.0}} if seen else {}
    found = fusion_sources(estimation, SensorSettings.model_validate(tracker), VIRTUAL.bus, None)
    refused = ("estimation", "fusion", "may_lose_legs") in [path for path, _ in found]
    assert refused == (not seen or pose != "fused")


@pytest.mark.parametrize("band_Hz", [(1.0, 500.0), (500.0, 1.0)])
@pytest.mark.parametrize("place", [0, 1])
def test_no_line_of_a_multisine_is_above_half_the_rate_whichever_way_its_band_goes(place, band_Hz):
    axis = MultisineAxis(axis="z_m", band_Hz=(1.0, 50.0), lines=5, amplitude=1e-3)
    rest = axis.model_copy(update={"axis": "x_m"})
    for rate_Hz, fine in ((1000.0, True), (999.0, False)):
        axes = [rest, rest]
        axes[place] = axis.model_copy(update={"band_Hz": band_Hz})
        reference = MultisineReference(type="multisine", axes=axes, period_s=10.0)
        found = list(frequencies(reference, VIRTUAL.loop.model_copy(update={"rate_Hz": rate_Hz}), None))
        assert [path for path, _ in found] == ([] if fine else [("reference", "axes", place, "band_Hz")])
        assert fine or "allowed: up to 499.5 (loop.rate_Hz 999), given: 500" in found[0][1]
