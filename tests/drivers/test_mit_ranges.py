"""The ranges of MIT framing: those of each model as it is delivered, and those that a configuration sets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.mit.fields import VARIANTS, Ranges
from drivers.registry import loaded
from drivers.transmission import Transmission
from tests.drivers.motor_families import MitProtocol

DATA = Path(__file__).parents[1] / "data" / "drives"
LIBRARIES: dict[str, list[float]] = json.loads((DATA / "mit.json").read_text("utf-8"))["ranges"]
ROBSTRIDE: dict[str, list[float]] = json.loads((DATA / "robstride.json").read_text("utf-8"))["ranges"]
FAMILIES = [
    ("mini_cheetah", "mini_cheetah"),
    ("cubemars", "AK80-64"),
    ("damiao", "DM4310"),
    ("robstride", "rs-02"),
]


@pytest.mark.parametrize(
    ("variant", "model", "name"),
    [
        ("mini_cheetah", "mini_cheetah", "classic_V65"),
        ("cubemars", "AK80-9", "AK80-9_V50"),
        ("cubemars", "AK10-9", "AK10-9_V50"),
        ("cubemars", "AK80-6", "AK80-6_V76"),
        ("cubemars", "AK80-64", "AK80-64_V8"),
    ],
)
def test_the_ranges_of_a_model_are_those_of_its_libraries(variant, model, name):
    position, velocity, _kp, _kd, torque = LIBRARIES[name]
    assert list(VARIANTS[variant].models[model]) == [position, velocity, torque]


@pytest.mark.parametrize("model", list(VARIANTS["robstride"].models))
def test_the_ranges_of_a_robstride_are_those_of_its_library(model):
    delivered = VARIANTS["robstride"].models[model]
    assert delivered == pytest.approx(Ranges(*ROBSTRIDE[model][:3]), rel=1e-8)


@pytest.mark.parametrize(("variant", "model"), FAMILIES)
@pytest.mark.parametrize(
    ("key", "field"), [("position_rad", "position"), ("velocity_rad_s", "velocity"), ("torque_N_m", "torque")]
)
def test_a_range_that_is_configured_takes_the_place_of_its_own_and_of_no_other(variant, model, key, field):
    values: dict[str, Any] = {
        "protocol": "mit",
        "transmission": {"lead_m": 0.02},
        "options": {"variant": variant, "model": model, key: 33.5},
        "force_limit_N": 500.0,
    }
    protocol: Any = loaded("hil.protocols", "mit")(
        BusSettings(layout="classic"), DriveSettings.model_validate(values)
    )
    delivered = VARIANTS[variant].models[model]._asdict()
    assert 33.5 not in delivered.values()
    assert protocol.ranges._asdict() == delivered | {field: 33.5}


@pytest.mark.parametrize(("variant", "host"), [("mini_cheetah", 0), ("cubemars", 0), ("damiao", 16)])
def test_the_lengths_that_a_drive_can_report_end_with_the_range_of_its_position(variant, host):
    """12.5 rad on a pulley of 20 mm are 0.25 m, either way from where the motor reads zero."""
    gear = Transmission(TransmissionSettings(pulley_radius_m=0.02, offset_m=[1.0, 1.1, 1.2, 1.3, 1.4, 1.5]))
    ranges = Ranges(12.5, 30.0, 10.0)
    found = MitProtocol(variant, ranges, (1, 2, 3, 4, 5, 6), host, gear).traits.reported_lengths
    assert found is not None
    shortest, longest = found
    assert shortest == pytest.approx([0.75, 0.85, 0.95, 1.05, 1.15, 1.25])
    assert longest == pytest.approx([1.25, 1.35, 1.45, 1.55, 1.65, 1.75])
