"""Numbers that `hil new` derives: by hand, and rounded to the side that the rules of a configuration leave open."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.app.configuration.consistency import standstill
from hil.app.configuration.platform import build_platform
from hil.app.configuration.yaml_positions import parse
from hil.app.new import derive
from hil.app.new.answers import QUESTIONS
from hil.app.new.robot import platform_section, robot_at_home
from hil.app.new.text import yaml_text
from hil.app.reachability import Walk
from hil.config.limits import LimitSettings
from hil.config.platform import PlatformSettings
from plant_fmu.config import PlantSettings

TABLE = {
    "base_radius_m": "0.35", "platform_radius_m": "0.25", "length_min_m": "0.5", "stroke_m": "0.2",
    "mass_kg": "42", "leg_mass_kg": "4", "drive_force_N": "800", "drive_speed_m_s": "0.3",
}  # fmt: skip


def answered(**typed: str) -> dict[str, Any]:
    """Return all answers for a table of 42 kg, those not typed by default; none of them cannot work."""
    answers: dict[str, Any] = {}
    for question in QUESTIONS:
        if not question.needed(answers):
            continue
        text = (TABLE | typed).get(question.key)
        if text is None:
            assert question.default is not None, question.key
            answers[question.key] = question.default(answers)
        else:
            answers[question.key] = question.parse(text)
        assert question.trouble(answers) is None, question.key
    return answers


@pytest.fixture(scope="module")
def table():
    """Return answers, the robot at home, and a walk at rest, where every leg bears 100 N."""
    answers = answered()
    nothing = np.zeros((2, 6))
    t = np.zeros(2)
    w = Walk(t, nothing + 0.6, nothing, nothing, nothing + 100.0, nothing + 100.0, t + 2.0, t, True, False)
    return answers, robot_at_home(answers), w


@settings(max_examples=25)
@given(resolution_m=st.floats(1e-5, 2e-4), stroke_m=st.floats(0.005, 0.4))
@example(resolution_m=1.3333e-4, stroke_m=0.2)
@example(resolution_m=1.32500004e-4, stroke_m=0.2)
@example(resolution_m=1e-6, stroke_m=0.012344)
def test_the_tolerance_of_standstill_is_never_below_four_steps_of_an_encoder(table, resolution_m, stroke_m):
    asked, home, w = table
    a = asked | {"encoder_resolution_m": resolution_m, "stroke_m": stroke_m}
    limits = derive.limits_section(a, home, w, 0.01, a["rate_Hz"])
    plant = derive.plant_section(a, home)
    text = yaml_text([], {"limits": limits, "plant": plant}, {})
    read: Any = parse(text).value
    found = standstill(PlantSettings(**read["plant"]), LimitSettings(**read["limits"]), None)
    assert list(found) == []
    needed = max(min(5e-4, 0.01 * stroke_m), 4 * resolution_m)
    assert limits["standstill_m"] == pytest.approx(needed, rel=0.011), "and hardly above"


@settings(max_examples=25)
@given(mass_kg=st.floats(1e-3, 1e6), radius_m=st.floats(0.1, 0.34))
@example(mass_kg=2.36, radius_m=0.1862699)
def test_the_disc_that_is_estimated_is_a_body_with_the_digits_that_are_written(table, mass_kg, radius_m):
    """Of a thin disc the moment about its axis is the sum of the others: no body has more."""
    a = table[0] | {"mass_kg": mass_kg, "platform_radius_m": radius_m}
    read: Any = parse(yaml_text([], {"platform": platform_section(a)}, {})).value
    platform = PlatformSettings.model_validate(read["platform"])
    body = build_platform(platform).platform
    disc = mass_kg * radius_m**2 * np.diag([0.25, 0.25, 0.5])
    np.testing.assert_allclose(body.inertia, disc, rtol=1e-5)


def test_a_brake_gets_the_time_to_act_and_to_stop_the_fastest_leg_and_a_fifth_of_it_more(table):
    """60 kg at 1 m/s: 50 ms, then 1000 N less the 400 N of weight take 100 ms; 0.18 s are written."""
    answers, home, _ = table
    a = answers | {"brake_ms": 50.0, "brake_force_N": 1000.0}
    for held in ([400.0, 0, 0, 0, 0, 0], [100.0, 0, 0, 0, -400.0, 0]):
        bearing = home._replace(static_N=np.array(held), leg_mass_kg=60.0)
        assert derive.closing_s(a, bearing, 1.0) == pytest.approx(0.18)
        assert derive.closing_s(a, bearing, 2.0) == pytest.approx(0.3)
        # weight that leaves a brake less than a twentieth of its force: 50 N
        weak = derive.closing_s(a | {"brake_force_N": 401.0}, bearing, 1.0)
        assert weak == pytest.approx(1.2 * (0.05 + 60.0 / 20.05), rel=0.04)


def test_a_leg_is_braked_by_half_of_the_force_that_its_weight_leaves(table):
    """2.5 times 400 N are 1000 N, less 400 N: 600 N on 60 kg are 10 m/s^2; drives of 450 N leave a tenth of it."""
    answers, home, w = table
    for held in ([400.0, 0, 0, 0, 0, 0], [0, 0, 0, -400.0, 0, 0]):
        bearing = home._replace(static_N=np.array(held), leg_mass_kg=60.0)
        path = w._replace(tau=np.full((2, 6), 400.0))
        a = answers | {"drive_force_N": 2000.0}
        assert derive.limits_section(a, bearing, path, 0.01, 1000.0)["deceleration_m_s2"] == 5.0
        a = answers | {"drive_force_N": 420.0}
        assert derive.limits_section(a, bearing, path, 0.01, 1000.0)["deceleration_m_s2"] == 0.35
