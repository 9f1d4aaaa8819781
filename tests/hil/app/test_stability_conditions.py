"""`hil stability`: every assumption is among the conditions of its verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.app.check.command import inspect
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.stability.assessment import Assessment
from hil.app.stability.command import judge
from hil.app.stability.subject import SURVEYED, Stated, Subject
from hil.config.model import ModelSettings
from tests.hil.app.test_stability_command import LEGS, POSE, bench

FUSED = {"sensors": {"tracker": {}}, "estimation": {"pose": "fused"}}
LINEAR = "  law: inverse_dynamics\n  wn_rad_s: 20\n"
DESIGNED = "  law: state_space\n  controller_file: {file}\n"
SPRINGS = {
    "pd": f"  law: pd\n{LEGS}",
    "pd_gravity": f"  law: pd_gravity\n{LEGS}",
    "feedforward_pd": f"  law: feedforward_pd\n{LEGS}",
    "cartesian_pd": f"  law: cartesian_pd\n{POSE}",
    "pid": f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: 1e4\n",
}
GAINS = (
    "kind: linear-controller\nmethod: hinf\naxes: joint\nrate_Hz: 1000\ninputs: [error, rate_error]\n"
    "A: []\nB: []\nC: [[]]\nD: [[400, 40]]\nanti_windup: []\ndesign: {}\n"
)
LIVE = {
    "type": "live",
    "limits": {
        "velocity_m_s": 0.5, "velocity_deg_s": 30, "acceleration_m_s2": 5, "acceleration_deg_s2": 300,
        "jerk_m_s3": 100, "jerk_deg_s3": 3000,
    },
}  # fmt: skip
REAL = {"plant": None, "bus": {"interface": "socketcan"}}
FMU = {
    "plant": {
        "model": {"type": "fmu", "path": __file__, "force": ["f"], "length": ["l"], "rate": ["v"]},
        "drives": {"encoder_resolution_m": 0},
    }
}
FINE = {"plant": {"drives": {"encoder_resolution_m": 0}}}
"""Encoders without quantisation."""


def held(law: str, *changes: dict[str, Any]) -> Configuration:
    """A robot at rest under a law, with changes."""
    text = bench(law, rest=True).text
    for each in changes:
        text = with_changes(text, each)
    return loads(text, "my.yaml", Path())


def among(found: Assessment, words: str) -> bool:
    """True if a condition contains these words."""
    return any(words in condition for condition in found.conditions)


@pytest.fixture
def linearising(tmp_path: Path) -> list[str]:
    """The same gains as inverse dynamics and as a designed controller."""
    file = tmp_path / "gains.yaml"
    file.write_text(GAINS)
    return [LINEAR, DESIGNED.format(file=file)]


def test_stability_lists_a_correct_wrench_sensor_as_condition(linearising):
    sensed = {"sensors": {"wrench": {}}, "estimation": {"wrench": {"source": "sensor"}}}
    for law in linearising:
        found = judge(held(law, FINE, sensed))
        assert among(found, "the wrench sensor is right"), law
        assert found.status == "conditional"


OBSERVER = {"source": "observer", "bandwidth_Hz": 100, "bus_ms": 1, "drive_lag_ms": 0.796}


def test_wrench_observer_with_exact_delay_and_lag_adds_only_its_own_pole_to_the_loop(linearising):
    """The observer sees only the disturbance: the slowest pole is its own, exp(-K T) = 0.9937 for 1 Hz."""
    slow = OBSERVER | {"bandwidth_Hz": 1, "drive_lag_ms": 1000 / (2 * np.pi * 200)}
    for law in linearising:
        found = judge(held(law, FINE, {"estimation": {"wrench": slow}}))
        assert found.figures["sampled"]["largest_pole"] == pytest.approx(np.exp(-2e-3 * np.pi), abs=1e-6)


def test_wrench_observer_reduces_delay_margin_and_phase_margin():
    """An observer of 100 Hz reduces the delay margin at wn 60 from 8.5 ms to 2.4."""
    fast = LINEAR.replace("20", "60")
    for law, bare_ms, left_ms in ((fast, 8.54, 2.37), (SPRINGS["feedforward_pd"], 5.16, 1.58)):
        for change, expected in (({}, bare_ms), ({"estimation": {"wrench": OBSERVER}}, left_ms)):
            c = held(law, change)
            assert judge(c).figures["sampled"]["delay_margin_ms"] == pytest.approx(expected, abs=0.01)
    fast_c, watched = held(fast), held(fast, {"estimation": {"wrench": OBSERVER}})
    before, after = (inspect(c).figures["controller"]["phase_margin_deg"] for c in (fast_c, watched))
    assert after < before - 10.0


def test_wrench_observer_with_another_model_than_the_law_adds_a_condition_and_a_warning():
    other = {"estimation": {"wrench": OBSERVER | {"model": {"inertia_scale": 0.9}}}}
    assert among(judge(held(LINEAR, other)), "the observer's model is the law's")
    assert "estimation.wrench.model" in inspect(held(LINEAR, other)).codes
    follows = held(LINEAR, {"estimation": {"wrench": OBSERVER}})
    assert "estimation.wrench.model" not in inspect(follows).codes


@pytest.mark.parametrize(
    ("changes", "to_spare_ms"),
    [
        ({}, 0.372),  # 75 + 6 x 64.6 + 60 + 105.6 of 1000 us
        ({"bus": {"layout": "ideal"}}, 4.0),  # feedback five ticks old faults
        ({"bus": {"layout": "ideal"}, "drives": {"watchdog_ms": 3}}, 2.0),
    ],
)
def test_printed_delay_reserve_is_the_smallest_of_its_limits(changes, to_spare_ms):
    found = judge(held(LINEAR, changes))
    assert found.figures["delay_to_spare_ms"] == pytest.approx(to_spare_ms, abs=1e-3)
    assert any(line.startswith("delay to spare") for line in found.lines)


@pytest.mark.parametrize("law", [LINEAR, *SPRINGS.values()])
def test_stability_result_of_every_law_lists_its_timing_assumptions(law):
    premises = " ".join(judge(held(law)).premises)
    for words in ("feedback arrives in its tick", "before the next SYNC", "no force is limited"):
        assert words in premises


def test_stability_bound_includes_feedback_older_than_a_tick_but_below_the_warning():
    """The error T ddq of a rate one tick old costs K_D T ddq / K_P = 0.43 mm at 4.3 m/s^2 and wn 20."""
    c = bench(LINEAR)
    old = loads(with_changes(c.text, {"limits": {"stale_warn_ticks": 2}}), "my.yaml", Path())
    now, then = (1e3 * max(judge(each).figures["ultimate_bound"]) for each in (c, old))
    assert now + 0.43 < then < now + 2 * 0.48
    assert "less than 2 ticks old" in judge(old).premises[0]


def test_law_without_wrench_compensation_has_no_condition_on_the_wrench():
    law = "  law: partial_linearisation\n  wn_rad_s: 20\n"
    for source in ("none", "observer"):
        found = judge(held(law, FINE, {"estimation": {"wrench": {"source": source}}}))
        assert (found.status, found.conditions) == ("proven", []), source


@pytest.mark.parametrize("evaluation", ["online", "offline"])
def test_online_feed_forward_has_the_condition_on_the_wrench(evaluation):
    law = f"{SPRINGS['feedforward_pd']}  evaluation: {evaluation}\n"
    sensed = {"sensors": {"wrench": {}}, "estimation": {"wrench": {"source": "sensor"}}}
    found = judge(held(law, sensed))
    assert among(found, "wrench") == (evaluation == "online")
    assert not among(judge(held(law)), "wrench")


def test_stability_lists_an_accurate_fused_pose_as_condition(linearising):
    for law in [*linearising, SPRINGS["pid"], SPRINGS["pd_gravity"]]:
        found = judge(held(law, FINE, FUSED))
        assert among(found, "the fused pose is as good as measured lengths"), law
        assert not among(found, "lost"), law
        assert found.status == "conditional", law
    assert judge(held(LINEAR, FINE)).conditions == []


@pytest.mark.parametrize("name", list(SPRINGS))
def test_stability_of_pd_with_a_live_reference_is_proven_at_rest_only(name):
    moves = "the reference rests; while it moves nothing is proven"
    found = judge(held(SPRINGS[name], {"reference": LIVE}))
    assert found.conditions.count(moves) == 1
    assert not among(found, "the bound"), "PD without a model has no bound"


def test_stability_bound_with_a_live_reference_is_stated_for_rest_only():
    found = judge(held(LINEAR, FINE, {"reference": LIVE}))
    assert found.status == "conditional"
    assert among(found, "the reference rests at home")


@pytest.mark.parametrize("plant", [REAL, FMU])
def test_unknown_plant_is_assumed_to_have_the_reflected_masses_of_the_laws_model(plant):
    """Half a tonne in each leg triples the inertia: without it the model would not be exact."""
    geared = {"controller": {"model": {"reflected_mass_kg": [500, 480, 460, 440, 420, 400]}}}
    bare, found = judge(held(LINEAR, plant)), judge(held(LINEAR, plant, geared))
    for one in (bare, found):
        assert one.status == "conditional"
        assert "small errors die out" in one.claim
        assert one.figures["gamma_eigenvalues"] == pytest.approx([1.0, 1.0], abs=1e-9)
    assert among(bare, "without friction and reflected mass")
    assert among(found, "with the friction and the reflected masses of the law's model")


def test_compensated_dry_friction_counts_twice_as_disturbance_on_an_unknown_plant():
    """The robot may have friction of equal size and opposite sign, leg by leg."""
    believed = [0.0, 100.0, 200.0, 300.0, 400.0, 500.0]
    model = ModelSettings(coulomb_friction_N=believed, viscous_friction_N_s_m=1e3)
    found = Subject(held(LINEAR, REAL), Stated()).friction(model)
    assert found.coulomb_N == pytest.approx([2.0 * one for one in believed])
    assert found.viscous_N_s_m == pytest.approx([0.0] * 6)
    rubs = {"controller": {"model": {"coulomb_friction_N": 250}}}
    assert judge(held(LINEAR, REAL, rubs)).figures["ultimate_bound"][0] > 3.5e-3


@pytest.mark.parametrize(
    ("step_m", "status", "says"),
    [
        (0.0, "proven", "small errors die out, the slowest as exp(-16.7 t)"),
        (5e-5, "conditional", "errors stay below 0.1 mm"),
        (1e-6, "conditional", "errors stay below 0.00212 mm"),
    ],
)
def test_errors_from_encoder_resolution_are_not_reported_as_decaying(linearising, step_m, status, says):
    """wn 20: 1 um makes the law request 4e-4 m/s^2, four times the negligible disturbance."""
    for law in linearising:
        found = judge(held(law, {"plant": {"drives": {"encoder_resolution_m": step_m}}}))
        assert found.status == status, law
        assert says in found.claim
        assert (SURVEYED in found.conditions) == (status == "conditional")
