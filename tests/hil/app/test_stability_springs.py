"""What `hil stability` says of springs that are asked too much, and which of several robots it judges by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.loop_delay import loop_delay
from hil.app.stability.command import judge
from hil.app.stability.imperfect_drives import Drives
from hil.app.stability.subject import Stated, Subject
from hil.config.model import ModelSettings
from hil.robot.kinematics import leg_lengths
from plant_fmu.config import BenchPlant
from tests.hil.app.test_stability_command import LEGS, bench


def changed(law, *changes):
    """Return the bench that holds a pose under a law, with parts of its text replaced."""
    text = bench(law, rest=True).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "my.yaml", Path())


"""Nearly twice the platform itself, and three times its inertia; or nothing."""


def test_what_a_law_compensates_too_much_of_the_friction_counts_as_what_it_compensates_too_little():
    """The drives of the lab lose 200 N s/m and 60 N; dry friction may meet that of the law with the other sign."""
    subject = Subject(load("lab"), Stated())
    assert subject.plant is not None
    assert (subject.plant.viscous_friction_N_s_m, subject.plant.coulomb_friction_N) == (200.0, 60.0)
    believed = [0.0, 100.0, 200.0, 300.0, 500.0, 1e4]
    found = subject.friction(
        ModelSettings(viscous_friction_N_s_m=believed, coulomb_friction_N=[0, 1, 2, 3, 4, 5])
    )
    assert found.viscous_N_s_m == pytest.approx([200.0, 100.0, 0.0, 100.0, 300.0, 9800.0])
    assert found.coulomb_N == pytest.approx([60.0, 61.0, 62.0, 63.0, 64.0, 65.0])


@pytest.mark.parametrize(
    ("law", "soft_end"),
    [
        ("  law: pd\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n", ("length_min_m: 0.75", "length_min_m: 1.52")),
        (
            "  law: pd_gravity\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n  model: {inertia_scale: 2}\n",
            ("length_max_m: 2.2", "length_max_m: 1.66"),
        ),
    ],
)
def test_a_platform_that_comes_to_rest_beyond_the_soft_end_of_a_leg_is_not_called_stable_there(law, soft_end):
    """Home is inside; the springs of 40 kN/m carry the weight, or what is held up too much, 0.09 m away from it."""
    inside = judge(changed(law), quick=True)
    assert inside.status == "conditional"
    assert inside.figures["energy"]["sag_mm"] > 60.0
    found = judge(changed(law, soft_end), quick=True)
    assert found.status == "not proven"
    assert "it comes to rest outside its limits: leg" in found.claim


@pytest.mark.parametrize("down", [-9.81, 9.81])
def test_an_integral_has_to_carry_the_weight_whether_the_legs_push_or_pull(down):
    """3.66 kN a leg: 102 % of the one limit and 99 % of the other; with gravity upwards the legs pull."""
    gravity = "gravity_m_s2: [0, 0, -9.81]", f"gravity_m_s2: [0, 0, {down}]"
    for limit, status in ((3500.0, "not proven"), (3800.0, "conditional")):
        law = f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: {limit}\n"
        assert judge(changed(law, gravity)).status == status


@pytest.mark.parametrize(("springs", "cubic"), [(1e8, 0.0), (1e6, 0.0), (0.0, 0.0), (0.0, 2e10), (5e3, 2e4)])
def test_what_late_damping_makes_of_the_benchs_own_springs_is_in_its_verdict(springs, cubic):
    """m p'' = -k p + u of a period before, by sine and cosine; k of a cubic spring is that of where it rests."""
    m, K_p, K_v, T = 20.0, 1e4, 1e3, 1e-3
    text = load("bench").text
    text = with_changes(
        text,
        {
            "plant": {
                "model": {"mass_kg": m, "stiffness_N_m": springs, "stiffness_N_m3": cubic},
                "drives": {"force_bandwidth_Hz": 0},
            },
            "controller": {"kp_N_m": K_p, "kv_N_s_m": K_v},
        },
    )
    c = loads(text, "bench.yaml", Path())
    assert (loop_delay(c).transport_s, loop_delay(c).lag_s) == (T, 0.0)
    assert c.plant is not None
    assert isinstance(c.plant.model, BenchPlant)
    subject = Subject(c, Stated())
    x_d = leg_lengths(subject.platform, subject.path[0].p, subject.path[0].R) - c.plant.model.rest_length_m
    largest = 0.0
    for x in x_d:
        rest = np.roots([cubic, 0.0, springs + K_p, -K_p * x])
        (at,) = rest[np.abs(rest.imag) < 1e-9].real
        k = springs + 3.0 * cubic * at**2
        w = np.sqrt(max(k, 1e-9) / m)
        A = np.array(
            [
                [
                    np.cos(w * T),
                    np.sin(w * T) / w,
                    T * T / (2.0 * m) if k < 1.0 else (1.0 - np.cos(w * T)) / k,
                ],
                [-w * np.sin(w * T), np.cos(w * T), np.sin(w * T) / (m * w)],
                [-K_p, -K_v, 0.0],
            ]
        )
        largest = max(largest, float(np.abs(np.linalg.eigvals(A)).max()))
    found = judge(c)
    assert found.figures["sampled"]["largest_pole"] == pytest.approx(largest, abs=1e-6)
    assert found.status == ("unstable" if largest >= 1.0 else "conditional")
    assert (springs == 1e8) <= (found.status == "unstable")


T = 1e-3

IDEAL = {"plant": {"model": {"force_bandwidth_Hz": 0}, "drives": {"encoder_resolution_m": 0}}}

LAWS = ("inverse_dynamics", "partial_linearisation", "pose_inverse_dynamics")


def held(law: str, wn: list[float], *changes: dict[str, Any]) -> Configuration:
    """Return a robot that rests under a law with these gains, with changes."""
    text = bench(f"  law: {law}\n  wn_rad_s: {wn}\n", rest=True).text
    for each in (IDEAL, *changes):
        text = with_changes(text, each)
    return loads(text, "my.yaml", Path())


def largest_pole(wn: float, gain: float = 1.0) -> float:
    """Return the largest |z| of p'' = u, held for 1 ms and 1 ms late, under u = -gain (wn^2 p + 2 wn v)."""
    K_P, K_D = gain * wn**2, gain * 2.0 * wn
    A = np.array([[1.0, T, T * T / 2.0], [0.0, 1.0, T], [-K_P, -K_D, 0.0]])
    return float(np.abs(np.linalg.eigvals(A)).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("leg", [0, 5])
def test_small_errors_die_out_as_slowly_as_those_of_the_slowest_axis(law, leg, monkeypatch):
    """Whichever that is: wn 2 beside 20 leaves more than half of its error after 0.3 s."""
    wn = [20.0] * 6
    wn[leg] = 2.0
    c = held(law, wn)
    assert (loop_delay(c).transport_s, loop_delay(c).lag_s) == (T, 0.0)
    exact = Drives.of(c)._replace(length=np.zeros(6), rate=np.zeros(6))
    monkeypatch.setattr(Drives, "of", lambda _: exact)
    found = judge(c)
    pole = largest_pole(2.0)
    rate = -np.log(pole) / T
    assert 1.8 < rate < 2.0
    assert found.status == "proven"
    assert found.claim.endswith(f"small errors die out, the slowest as exp(-{rate:.3g} t)")
    assert found.figures["sampled"]["largest_pole"] == pytest.approx(pole, abs=1e-9)
    assert found.figures["sampled"]["decay_rate_1_s"] == pytest.approx(rate, rel=1e-6)
    (line,) = (one for one in found.lines if one.startswith("sampled loop"))
    assert f"slowest mode exp(-{rate:.3g} t)" in line


@pytest.mark.parametrize("leg", [0, 5])
def test_one_axis_that_grows_is_enough_whichever_it_is(leg):
    wn = [2.0] * 6
    wn[leg] = 600.0
    found = judge(held("inverse_dynamics", wn))
    assert found.status == "unstable"
    assert f"magnitude {largest_pole(600.0):.4g} with" in found.claim
