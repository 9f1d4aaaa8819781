"""What `hil stability` says of springs that are asked too much, and which of several robots it judges by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.loop_delay import loop_delay
from hil.app.stability import spring_models
from hil.app.stability.command import JUDGES, judge
from hil.app.stability.payloads import WORST_FIRST
from hil.app.stability.subject import Stated, Subject
from hil.config.model import ModelSettings
from hil.design.stability.assessment import Assessment
from hil.design.stability.energy import Basin
from hil.robot.kinematics import leg_lengths
from plant_fmu.config import BenchPlant
from tests.hil.app.test_stability_command import LEGS, POSE, bench
from tests.hil.app.test_stability_conditions import held

BODY = (
    "    payload:\n      - {mass_kg: 40, com_m: [0.05, 0, 0.2], shape: {type: point}, mass_range_kg: [0, 80], "
    "com_range_m: [[-0.1, 0.2], [0, 0], [0, 0.3]]}\n"
)


def changed(law, *changes):
    """Return the bench that holds a pose under a law, with parts of its text replaced."""
    text = bench(law, rest=True).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "my.yaml", Path())


def test_a_law_is_as_good_as_its_verdict_with_the_worst_of_the_payloads(monkeypatch):
    """Whichever of them that is; of equal ones none is preferred to a worse one."""
    inertia = "    inertia_kg_m2: [[570, 0, 0], [0, 285, 0], [0, 0, 285]]   # about the centre of mass\n"
    c = changed(f"  law: pd\n{LEGS}", (inertia, inertia + BODY))
    words = Subject(c, Stated()).carried
    assert len(words) == 6
    verdicts: dict[str, Any] = {}

    def verdict(subject, *_, **__):
        (carried,) = subject.carried
        return Assessment(verdicts[carried], carried, [], [], {})

    monkeypatch.setitem(JUDGES, "pd", verdict)
    for k, worst in enumerate(words):
        status, others = WORST_FIRST[k % 3 : k % 3 + 2]
        verdicts.update(dict.fromkeys(words, others))
        verdicts[words[k - 1]] = "proven"
        verdicts[worst] = status
        found = judge(c)
        assert (found.status, found.claim) == (status, f"{worst}, with {worst}")


HEAVY = (
    "    payload:\n      - {mass_kg: 40, com_m: [0, 0, 0], shape: {type: sphere, radius_m: 1}, "
    "mass_range_kg: [0, 2000]}\n"
)
"""Nearly twice the platform itself, and three times its inertia; or nothing."""


@pytest.mark.parametrize(
    ("law", "worse"),
    [
        (f"  law: pd\n{LEGS}", ["largest |z|", "sag", "stiffness"]),
        (f"  law: pd_gravity\n{LEGS}", ["largest |z|", "sag", "stiffness"]),
        (f"  law: cartesian_pd\n{POSE}", ["largest |z|", "sag"]),
        (
            f"  law: pid\n{LEGS}  ki_N_m_s: 3e6\n  integral_limit_N: 1e5\n",
            ["largest |z|", "slowest eigenvalue"],
        ),
    ],
)
def test_the_delay_that_springs_bear_is_that_of_the_lightest_payload_and_what_is_worse_with_another_is_told(
    law, worse
):
    """The less there is to accelerate, the faster the loop; the more, the deeper the weight and the slower the end."""
    inertia = "    inertia_kg_m2: [[570, 0, 0], [0, 285, 0], [0, 0, 285]]   # about the centre of mass\n"
    bare = judge(changed(law), quick=True)
    found = judge(changed(law, (inertia, inertia + HEAVY)), quick=True)
    assert found.status == bare.status == "conditional"
    assert ", with no payload" in found.claim
    deepest = "mm of leg length off the set-point with 2000 kg at (0, 0, 0) m"
    assert found.claim.endswith(deepest) == ("sag" in worse)
    margin = found.figures["sampled"]["delay_margin_ms"]
    assert margin == pytest.approx(bare.figures["sampled"]["delay_margin_ms"], rel=1e-3), (
        "what is held up sags less"
    )
    (line,) = (each for each in found.lines if each.startswith("payloads"))
    assert line.startswith("payloads       3 looked at; claim and figures are with no payload")
    told = line.partition("; worse with another: ")[2].split("; ")
    assert len(told) == len(worse)
    for each, name in zip(told, worse, strict=True):
        assert each.startswith(name)
        assert each.endswith(" with 2000 kg at (0, 0, 0) m")
    largest = found.figures["worst"]["largest_pole"]
    assert largest["carried"] == "2000 kg at (0, 0, 0) m"
    assert bare.figures["sampled"]["largest_pole"] < largest["value"] < 1.0


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


@pytest.mark.parametrize("alike", [True, False])
def test_a_pd_of_unlike_stiffnesses_of_rotation_has_no_energy_and_is_judged_by_small_errors(alike):
    stiffnesses = "2e5" if alike else "[2e5, 1e5, 3e5]"
    pose = POSE.replace("kp_rotation_N_m_rad: 2e5", f"kp_rotation_N_m_rad: {stiffnesses}")
    found = judge(changed(f"  law: cartesian_pd\n{pose}"), quick=True)
    assert found.status == "conditional"
    assert ("energy" in found.figures) == alike
    assert ("three stiffnesses of rotation" in found.claim) == (not alike)
    assert ("errors are small" in found.conditions) == (not alike)
    assert np.isfinite(found.figures["sampled"]["largest_pole"])


MOVED = {
    "mass_kg": 200, "com_m": [0, 0, 0.1], "shape": {"type": "point"}, "com_range_m": [[0, 0], [0, 0], [0.1, 1.0]],
}  # fmt: skip


@pytest.mark.parametrize("law", [f"  law: pd_gravity\n{LEGS}", f"  law: cartesian_pd\n{POSE}"])
def test_a_weight_that_is_the_same_at_the_reference_alone_is_not_compensated_exactly(law, monkeypatch):
    """A body that is higher up than the law believes weighs the same while the platform is level."""
    edge = Basin(72.0, np.zeros(3), "somewhere")
    monkeypatch.setattr(spring_models, "basin", lambda *_: edge)
    c = held(law, {"platform": {"platform": {"payload": [MOVED]}}})
    subject = Subject(c, Stated())
    level = subject.path[0]
    low, high = (robot.gravity(level.p, level.R) for robot in (subject.robots[0], subject.robots[-1]))
    assert low == pytest.approx(high)
    for one in subject.alone():
        found = JUDGES[c.controller.law](one, c.controller, False)
        (robot,) = one.robots
        exact = robot is subject.robots[0] or np.allclose(robot.constants, subject.robots[0].constants)
        assert found.status == "conditional"
        assert (
            "no other equilibrium lies in the sublevel set: not searched for" in found.conditions
        ) != exact
        assert (found.figures["energy"]["start_mm"] is None) == (
            not exact or c.controller.law != "pd_gravity"
        )


def test_legs_without_mass_weigh_as_the_law_believes_only_where_they_have_none():
    c = held(f"  law: pd_gravity\n{LEGS}  model: {{variant: massless_legs}}\n")
    found = judge(c, quick=True)
    assert "no other equilibrium lies in the sublevel set: not searched for" in found.conditions
    assert found.figures["energy"]["sag_mm"] > 0.1


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
