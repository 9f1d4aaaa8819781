"""Contract of every plant, whatever its implementation."""

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import PlantError
from plant_fmu.bench import Bench
from plant_fmu.config import BenchPlant, FmuPlant, StewartPlant
from plant_fmu.plant import Robot, whole_steps
from plant_fmu.stewart.build import build

BOOK = {
    "base_joints": [[2 * np.cos(a), 2 * np.sin(a), 0] for a in np.radians([0, 60, 120, 180, 240, 300])],
    "platform_joints": [[np.cos(a), np.sin(a), 0] for a in np.radians([30, 30, 150, 150, 270, 270])],
    "platform": {"mass": 1150, "com": [0, 0, 0], "inertia": np.diag([570, 285, 285]).tolist()},
    "cylinder": {"mass": 85, "com": 0.75, "inertia_axial": None, "inertia_transverse": 16},
    "rod": {"mass": 22, "com": 0.75, "inertia_axial": None, "inertia_transverse": 4.1},
    "gravity": [0, 0, -9.81],
}
ROBOT = Robot(BOOK, np.full(6, 1.0), np.full(6, 2.5), np.array([0.0, 0.0, 1.0]), np.eye(3))
FORCE = np.array([3700.0, 3600.0, 3650.0, 3500.0, 3620.0, 3610.0])
OPEN, SHUT, CALM = np.zeros(6), np.ones(6), np.zeros(6)


def stewart(version, isolation):
    settings = StewartPlant(type="stewart", fmi_version=version, isolation=isolation)
    return lambda: settings.open(ROBOT, Path())


def mapped(version, isolation):
    """Our FMU opened like a foreign one, by path and variable names."""

    def make():
        settings = {"type": "fmu", "path": str(build(version)), "isolation": isolation, "step_us": 100.0}
        for name in ("force", "length", "rate", "brake"):
            settings[name] = [f"{name}[{i}]" for i in range(1, 7)] if version == "2.0" else [name]
        model = FmuPlant.model_validate({**settings, "wrench": ["wrench"]})
        return model.open(ROBOT, Path())

    return make


MADE = {
    "bench": lambda: BenchPlant(type="bench").open(ROBOT, Path()),
    **{f"stewart-{v}-{i}": stewart(v, i) for v in ("2.0", "3.0") for i in ("in_process", "child_process")},
    "foreign-2.0-in_process": mapped("2.0", "in_process"),
    "foreign-3.0-child_process": mapped("3.0", "child_process"),
}


@pytest.fixture(scope="module", params=MADE)
def plant(request):
    plant = MADE[request.param]()
    yield plant
    plant.close()


def run(plant, n=30, dt=1e-3):
    return [plant.step(FORCE, OPEN, CALM, dt) for _ in range(n)]


def test_plant_reset_returns_lengths_at_rest_in_an_array_that_later_steps_do_not_change(plant):
    q, dq = plant.reset()
    kept = q.copy()
    assert q.shape == dq.shape == (6,)
    assert (q > 0).all()
    assert (dq == 0).all()
    run(plant, 5)
    assert (q == kept).all()


def test_plant_repeats_its_motion_to_the_bit_after_a_reset(plant):
    plant.reset()
    first = run(plant)
    plant.reset()
    for (q1, dq1), (q2, dq2) in zip(first, run(plant), strict=True):
        assert (q1 == q2).all()
        assert (dq1 == dq2).all()


def test_one_long_plant_step_equals_many_short_steps(plant):
    plant.reset()
    for _ in range(20):
        short = plant.step(FORCE, OPEN, CALM, 1e-3)
    plant.reset()
    long = plant.step(FORCE, OPEN, CALM, 20e-3)
    assert long[0] == pytest.approx(short[0], abs=1e-15)


def test_larger_force_on_a_plant_leg_makes_the_leg_longer(plant):
    plant.reset()
    few = plant.step(FORCE, OPEN, CALM, 0.05)[0]
    plant.reset()
    more = plant.step(FORCE + 500.0, OPEN, CALM, 0.05)[0]
    assert (more > few).all()


def test_engaged_brakes_hold_the_legs_of_the_plant(plant):
    q0, _ = plant.reset()
    for _ in range(100):
        q, dq = plant.step(FORCE, SHUT, CALM, 1e-3)
    assert np.abs(q - q0).max() < 1e-6
    assert np.abs(dq).max() < 1e-6


def test_leg_rates_of_the_plant_are_the_derivatives_of_its_lengths(plant):
    plant.reset()
    plant.step(FORCE + 500.0, OPEN, CALM, 0.02)
    q1, _ = plant.step(FORCE + 500.0, OPEN, CALM, 1e-3)
    _, dq = plant.step(FORCE + 500.0, OPEN, CALM, 1e-3)
    q3, _ = plant.step(FORCE + 500.0, OPEN, CALM, 1e-3)
    assert (q3 - q1) / 2e-3 == pytest.approx(dq, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("dt", [1.05e-4, 0.0, -1e-3, np.nan, np.inf])
def test_plant_step_that_is_not_a_multiple_of_the_internal_step_is_refused(plant, dt):
    plant.reset()
    with pytest.raises(PlantError, match="multiple"):
        plant.step(FORCE, OPEN, CALM, dt)
    plant.step(FORCE, OPEN, CALM, 1e-3)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_plant_input_that_is_not_finite_is_refused(plant, value, place):
    plant.reset()
    inputs = [FORCE.copy(), OPEN.copy(), CALM.copy()]
    inputs[place][3] = value
    with pytest.raises(PlantError, match="not finite"):
        plant.step(*inputs, 1e-3)
    plant.step(FORCE, OPEN, CALM, 1e-3)


def test_true_pose_and_forces_of_the_plant_agree_with_its_lengths_and_inputs(plant):
    q, _ = plant.reset()
    q, _ = plant.step(FORCE, OPEN, CALM, 0.02)
    truth = plant.truth()
    if truth is None:
        return
    arms = truth.p + np.array(BOOK["platform_joints"]) @ truth.R.T - np.array(BOOK["base_joints"])
    assert np.linalg.norm(arms, axis=1) == pytest.approx(q, abs=1e-12)
    assert pytest.approx(np.eye(3), abs=1e-12) == truth.R @ truth.R.T
    assert truth.applied_force == pytest.approx(FORCE, rel=1e-9)


def test_own_fmu_gives_the_same_bits_in_fmi_2_and_3_and_in_process_or_in_a_child_process():
    ends = []
    for version in ("2.0", "3.0"):
        for isolation in ("in_process", "child_process"):
            plant = stewart(version, isolation)()
            ends.append(run(plant, 50)[-1][0].tobytes())
            truth = plant.truth()
            assert truth is not None
            assert plant.rod_force() == pytest.approx(truth.applied_force, rel=1e-12), "no friction, no mass"
            assert truth.applied_force[0] > truth.applied_force[3] + 100, "unequal legs"
            plant.close()
    assert len(set(ends)) == 1


def test_upward_wrench_on_the_plant_lifts_the_platform(plant):
    if isinstance(plant, Bench):
        return
    plant.reset()
    q = plant.step(FORCE, OPEN, CALM, 0.02)[0]
    plant.reset()
    up = plant.step(FORCE, OPEN, np.array([0, 0, 3000.0, 0, 0, 0]), 0.02)[0]
    assert (up > q).all()


@pytest.mark.parametrize("step_s", [1.0, 0.5, 2.0**-13])
def test_plant_step_must_be_a_whole_number_of_internal_steps_within_1e_9(step_s):
    for n in (1, 2, 7, 1_000, 999_999_999):
        assert whole_steps(n * step_s, step_s) == n
    for n in (1, 7, 1_000):
        for off in (0.5e-9, -0.5e-9):
            assert whole_steps(n * step_s * (1.0 + off), step_s) == n
        for off in (2e-9, -2e-9, 0.4 / n, -0.4 / n):
            with pytest.raises(PlantError, match="multiple"):
                whole_steps(n * step_s * (1.0 + off), step_s)
    for n in (0, 10**9, 2 * 10**9):  # with so many steps, any length would be a multiple
        with pytest.raises(PlantError, match="multiple"):
            whole_steps(n * step_s, step_s)


def test_true_twist_of_the_plant_is_the_derivative_of_its_true_pose(plant):
    """Over 0.2 ms about the middle: p' = v, R' R^T = [omega] in the base frame."""
    plant.reset()
    plant.step(FORCE + 500.0, OPEN, np.array([300.0, 0, 0, 100.0, 200.0, 300.0]), 0.02)
    truths = []
    for _ in range(3):
        plant.step(FORCE, OPEN, CALM, 1e-4)
        truths.append(plant.truth())
    if truths[0] is None:
        assert truths == [None] * 3
        return
    before, now, after = truths
    turned = (after.R - before.R) / 2e-4 @ now.R.T
    moved = [*((after.p - before.p) / 2e-4), turned[2, 1], turned[0, 2], turned[1, 0]]
    assert now.twist.shape == (6,)
    assert np.abs(now.twist).min() > 1e-4
    assert now.twist == pytest.approx(moved, rel=1e-3, abs=1e-5)
