"""Rules of a configuration: each accepts its last valid value, and refuses the next one with its place."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.errors import ConfigurationError
from drivers.signals import Fault
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.yaml_positions import path_text
from hil.config.limits import ReactionSettings
from hil.config.number import plain_number
from hil.config.running import EngageSettings
from tests.broad import broad


def changed(name: str, changes: dict[str, Any]) -> Configuration:
    c = load(name)
    return loads(with_changes(c.text, changes), "my.yaml", c.folder)


def reference(kind: str, **keys: Any) -> dict[str, Any]:
    return {"reference": {"type": kind} | keys}


def multisine(**changes: Any) -> dict[str, Any]:
    axis = {"axis": "z_m", "band_Hz": [1, 50], "lines": 10, "amplitude": 1e-3} | changes
    return reference("multisine", period_s=axis.pop("period_s", 5), axes=[axis])


def sinusoid(frequency_Hz: float) -> dict[str, Any]:
    wave = {"axis": "z_m", "amplitude": 1e-3, "frequency_Hz": frequency_Hz}
    return reference("sinusoids", duration_s=5, components=[wave])


def payload(**keys: Any) -> dict[str, Any]:
    body = {"mass_kg": 40, "com_m": [0.05, 0, 0.2], "shape": {"type": "point"}} | keys
    return {"platform": {"platform": {"payload": [body]}}}


def pairs(spacing_m: float) -> dict[str, Any]:
    circle = {"radius_m": 2, "pair_centres_deg": [0, 120, 240], "pair_spacing_m": spacing_m}
    return {"platform": {"base_joints_m": circle, "length_max_m": 5}}


def brakes(**engage: float) -> dict[str, Any]:
    return {"engage": {"brake_release_s": 0.05, "brake_close_s": 0.03} | engage}


def homed(limit_m: float) -> dict[str, Any]:
    """A turn moves a leg by 80 mm, leg 3 by 40 mm."""
    gear = {"lead_m": 0.08, "pulley_radius_m": None, "gear_ratio": [1, 1, 1, 2, 1, 1]}
    return {
        "drives": {
            "force_limit_N": 300,
            "transmission": gear,
            "homing": {"file": "a.yaml", "limit_m": limit_m},
        }
    }


def tracked(latency_ms: float, **estimation: Any) -> dict[str, Any]:
    return {
        "sensors": {"tracker": {"rate_Hz": 100, "latency_max_ms": latency_ms}},
        "estimation": {"pose": "fused"} | estimation,
    }


LIVE = reference(
    "live", limits={
        "velocity_m_s": 0.2, "velocity_deg_s": 10, "acceleration_m_s2": 1, "acceleration_deg_s2": 50,
        "jerk_m_s3": 10, "jerk_deg_s3": 500,
    },
)  # fmt: skip
PD = {"law": "pd", "kp_N_m": 2e6, "kv_N_s_m": 5e4}
AHEAD = {"controller": {"delay_compensation": {"bus_ms": 0.5}}}
FROZEN = {"controller": {"model": {"variant": "constant", "frozen_at": {"position_m": [0, 0, 1]}}}}
LOST = {"fusion": {"may_lose_legs": [0]}}
SENSORS_DBC = str(Path(__file__).parents[3] / "docs/examples/sensors")


def by_dbc(latency_ms: float) -> dict[str, Any]:
    """A tracker by signals that stand for its pose, with a stated latency."""
    signals = dict(zip(("x", "y", "z"), ("accX", "accY", "accZ"), strict=True))
    signals |= dict(zip(("rx", "ry", "rz"), ("roll", "pitch", "yaw"), strict=True))
    device = {
        "protocol": "dbc",
        "file": f"{SENSORS_DBC}/xsens_mti.dbc",
        "signals": signals,
        "latency_ms": latency_ms,
    }
    device["units"] = dict.fromkeys("xyz", "m")
    sensors = {"tracker": {"rate_Hz": 100, "latency_max_ms": 10, "device": device}}
    return {"sensors": sensors, "bus": {"max_load_percent": 90}}


def imu_by_dbc(pose: str) -> dict[str, Any]:
    """An IMU that gives specific forces only."""
    signals = dict(zip(("fx", "fy", "fz"), ("accX", "accY", "accZ"), strict=True))
    device = {"protocol": "dbc", "file": f"{SENSORS_DBC}/xsens_mti.dbc", "signals": signals}
    return {"sensors": {"imu": {"rate_Hz": 100, "device": device}}, "estimation": {"pose": pose}}


RULES: dict[str, tuple[str, dict[str, Any], dict[str, Any], str]] = {
    # ranges
    "plant.model.internal_step_us": ("virtual", {"plant": {"model": {"internal_step_us": 0.1}}}, {"plant": {"model": {"internal_step_us": 0.05}}}, "at least 0.1"),
    "loop.rate_Hz": ("ideal", {}, {"loop": {"rate_Hz": 1e9}}, "at most 100000"),
    "reference.axes[0].band_Hz": ("virtual", multisine(), multisine(period_s=1000, band_Hz=[1, 400]), "up to 200 Hz"),
    "reference.components[0].frequency_Hz": ("virtual", sinusoid(500), sinusoid(501), "above half the rate"),
    "reference.path": ("virtual", {}, reference("sampled", path="gone.csv"), "gone.csv"),
    "platform.home.rotation_vector_deg": ("virtual", {}, {"platform": {"home": {"rotation_vector_deg": [0, 0, 181]}}}, "181"),
    # rules within a section
    "limits": ("virtual", {"limits": {"stale_warn_ticks": 5}}, {"limits": {"stale_warn_ticks": 6}}, "stale_warn_ticks is above"),
    "controller.delay_compensation": ("virtual", AHEAD, {"controller": {"delay_compensation": {"bus_ms": 0}}}, "hil identify --delay"),
    "controller.model": ("virtual", FROZEN, {"controller": {"model": {"variant": "constant"}}}, "frozen_at"),
    "platform.base_joints_m": ("virtual", pairs(3.9), pairs(4), "does not fit on the circle"),
    "platform.platform.payload[0]": ("virtual", payload(mass_range_kg=[40, 80]), payload(mass_range_kg=[41, 80]), "mass_kg lies outside"),
    "estimation.fusion.may_lose_legs ": ("virtual", tracked(10, fusion={"may_lose_legs": [0, 5]}), tracked(10, fusion={"may_lose_legs": [3, 3]}), "a leg twice"),
    # rules between sections
    "plant.drives.brake_open_ms": ("virtual", brakes(), brakes(brake_release_s=0.049), ""),
    "plant.drives.brake_close_ms": ("virtual", brakes(), brakes(brake_close_s=0.029), ""),
    "limits.standstill_m": ("virtual", {"plant": {"drives": {"encoder_resolution_m": 1.24e-4}}}, {"plant": {"drives": {"encoder_resolution_m": 1.26e-4}}}, "at least"),
    "sensors.tracker.latency_max_ms": ("virtual", tracked(125.9), tracked(126.1), ""),
    "sensors.tracker.latency_max_ms ": ("virtual", by_dbc(9.0), by_dbc(11.0), "sensors.tracker.device.latency_ms"),
    "sensors.imu": ("virtual", imu_by_dbc("legs"), imu_by_dbc("fused"), "angular rate and specific force"),
    "bus.channels[1]": ("virtual", {}, {"bus": {"channels": [{"channel": "hil0", "legs": [0, 1, 2, 3, 4, 5]}, {"channel": "b"}]}}, "legs or a sensor"),
    "sensors.tracker.node_id": ("virtual", tracked(10), tracked(10) | {"drives": {"node_ids": [20, 2, 3, 4, 5, 6]}, "sensors": {"tracker": {"rate_Hz": 100, "latency_max_ms": 10, "node_id": 20}}}, "is also in drives.node_ids"),
    "estimation.fusion.may_lose_legs": ("virtual", tracked(10, **LOST), {"estimation": {"pose": "fused"} | LOST}, "given: [0]"),
    "drives.homing.limit_m": ("desktop", homed(0.00999), homed(0.01001), "less than 0.01"),
    "drives.transmission": ("desktop", {}, {"drives": {"transmission": {"offset_m": [0.325, 0.325, 0.501, 0.325, 0.325, 0.325]}}}, "drive 2 reports ends"),
    "monitor.action": ("virtual", {"controller": PD}, {"controller": PD, "monitor": {"action": "fault"}}, "no certificate"),
    "estimation.wrench.source": ("virtual", {"estimation": {"wrench": {"source": "sensor"}}, "sensors": {"wrench": {}}}, {"estimation": {"wrench": {"source": "sensor"}}}, "no sensors.wrench"),
    "controller.delay_compensation ": ("virtual", AHEAD, AHEAD | LIVE, "looks ahead"),
    "platform.home": ("virtual", {}, {"platform": {"length_max_m": 1.6}}, "out of reach"),
    "plant.model.rest_length_m": ("bench", {}, {"plant": {"model": {"rest_length_m": 0.1}}}, "given: 0.1"),
    "bus.data_bitrate_bit_s": ("virtual", {}, {"bus": {"data_bitrate_bit_s": 500000}}, "slower than arbitration"),
    "bus.bitrate_bit_s": ("virtual", {}, {"bus": {"bitrate_bit_s": 2000000}}, "too fast for arbitration"),
    "plant.faults[0].kind": ("virtual", {"plant": {"faults": [{"kind": "wrench_step", "force_N": [0, 0, -9]}]}}, {"plant": {"model": {"type": "bench"}, "faults": [{"kind": "wrench_step", "force_N": [0, 0, -9]}]}}, "needs a platform"),
}  # fmt: skip


@pytest.mark.parametrize(("key", "row"), RULES.items(), ids=list(RULES))
def test_first_value_beyond_each_rule_is_refused_within_2_s_with_its_file_position(key, row):
    name, fine, refused, words = row
    changed(name, fine)
    begun = time.process_time()
    with pytest.raises(ConfigurationError) as caught:
        changed(name, refused)
    assert time.process_time() - begun < 2.0
    found = [each for each in caught.value.problems if f": {key.strip()}: " in each and words in each]
    assert found, caught.value.problems
    assert found[0].startswith("my.yaml:")


@pytest.mark.parametrize(("heartbeat_ms", "frames"), [(100, 0), (6.1, 0), (6, 1), (3.1, 1)])
def test_bus_load_per_tick_includes_all_heartbeat_frames(heartbeat_ms, frames):
    """A status frame is classic, 5 bytes: 44 + 40 + 3 + floor(73 / 4) = 105 bits, 105 us of 1 ms."""
    c = changed("virtual", {"drives": {"heartbeat_ms": heartbeat_ms}})
    (found,) = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    assert found.load_percent == pytest.approx(56.82 + 10.5 * frames, abs=1e-9)


def test_heartbeats_that_overload_the_bus_are_refused_with_the_calculation():
    with pytest.raises(ConfigurationError, match=r"6 x classic  5 byte: 105 bit = 105\.0 us each, 630\.0 us"):
        changed("virtual", {"drives": {"heartbeat_ms": 1}})


@pytest.mark.parametrize(("closes", "expected"), [(None, 0.1), (0.0, 0.0), (0.05, 0.05), (0.3, 0.3)])
def test_brake_closing_time_defaults_to_the_release_time(closes, expected):
    assert EngageSettings(brake_release_s=0.1, brake_close_s=closes).closing_s == expected


@pytest.mark.parametrize("reaction", ["ss1", "sbc", "sto"])
def test_each_reaction_is_caused_by_exactly_the_expected_faults(reaction):
    settings = ReactionSettings(stroke="ss1", speed="ss1", drive="sto", stale="sto", law="sto")
    expected = {
        "ss1": {"STROKE", "SPEED", "CERTIFICATE", "REFUSED_FRAMES", "SET_UP"},
        "sto": {"DRIVE", "STALE", "LAW"},
        "sbc": {
            "FOLLOWING", "KINEMATICS", "ASSEMBLY", "CONDITION", "NOT_FINITE", "ENCODER", "UNCERTAIN",
            "DUPLICATE_NODE",
        },
    }  # fmt: skip
    found = settings.led_to(reaction)
    assert {fault.name for fault in Fault if fault and fault in found} == expected[reaction]


NUMBERS = {"1": 1.0, "-.5": -0.5, " 3e-2 ": 0.03, "1E3": 1000.0}
NO_NUMBERS = dict.fromkeys(
    ["", ".", "1_0", "nan", "inf", "0x10", "٣", "1 2", "1e", "--1", "1,5"], float("nan")
)


@pytest.mark.parametrize(("word", "number"), (NUMBERS | NO_NUMBERS).items())
def test_only_plain_decimal_text_is_parsed_as_a_number(word, number):
    assert plain_number(word) == pytest.approx(number, rel=0, nan_ok=True)


CONFIGS = Path(load("virtual").source).parent


def numbers(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value[:1]):
            yield from numbers(each, (*path, key))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


def with_number(text: str, path: tuple[str | int, ...], number: float) -> str:
    value = place = yaml.load(text, yaml.CSafeLoader)
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = number
    return str(yaml.dump(value, Dumper=yaml.CSafeDumper))


TEXTS = {name: load(name).text for name in ("virtual", "lab")}
PLACES = [(name, path) for name, text in TEXTS.items() for path in numbers(yaml.safe_load(text))]


@pytest.mark.parametrize("number", broad([-1.1e30, 2 * 10**30, 10**300], quick=1), ids="{:.2g}".format)
def test_absurdly_large_number_is_refused_in_every_numeric_key(number):
    assert len(PLACES) > 50
    for name, path in PLACES:
        with pytest.raises(ConfigurationError) as refused:
            loads(with_number(TEXTS[name], path, number), "a.yaml", CONFIGS)
        assert f": {path_text(path)}: " in str(refused.value), (name, path)


def test_condition_limit_of_1e30_is_accepted():
    text = with_number(load("virtual").text, ("limits", "condition"), 1e30)
    assert loads(text, "a.yaml", CONFIGS).limits.condition == 1e30
