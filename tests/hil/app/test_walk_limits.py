"""Limits along a path: violations by any leg and direction, on long paths too."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arrays import Array
from hil.app.check.demand import Silence
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.app.reachability import SAMPLES, Walk, drive_forces, span_s, violations, walk
from hil.robot.dynamics import Model
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant, PlantSettings, StewartPlant

C = load("virtual")
LOW, HIGH = C.platform.length_min_m, C.platform.length_max_m
MIDDLE = 0.5 * (LOW + HIGH)
LIMITS = C.limits.model_copy(
    update={
        "stroke_margin_m": 0.02, "deceleration_m_s2": 10.0, "speed_m_s": 2.0, "force_N": 1000.0, "force_step_N": 300.0,
        "force_window_N": 700.0, "acceleration_m_s2": 5.0,
    }
)  # fmt: skip
ROWS = 9
HERE = 4
"""Row with the event of one leg; the other legs are at rest in the middle of the stroke."""

STEP_S = 1e-3
LEGS = range(6)
WAYS = (1.0, -1.0)


def walked(leg: int, *, q: float = MIDDLE, dq: float = 0.0, ddq: float = 0.0, tau: float = 0.0) -> Walk:
    """A walk with other values for one leg in one row."""
    q_m, rest = np.full((ROWS, 6), MIDDLE), np.zeros((2, 6))
    rate, acceleration, force = (np.zeros((ROWS, 6)) for _ in range(3))
    for rows, value in ((q_m, q), (rate, dq), (acceleration, ddq), (force, tau)):
        rows[HERE, leg] = value
    t, ones = np.linspace(0.0, STEP_S * (ROWS - 1), ROWS), np.ones(ROWS)
    return Walk(t, q_m, rate, acceleration, force, rest, ones, ones, every_tick=True, repeats=False)


def broken(w: Walk, *, but: str = "") -> list[str]:
    """Messages of the violated limits, except those that contain one of the given words."""
    found = violations(w, C.platform, LIMITS, STEP_S)
    assert all(each.t == pytest.approx(STEP_S * HERE, abs=STEP_S) for each in found)
    messages = [each.message for each in found if "within one tick" not in each.message]  # of a single row
    return [message for message in messages if not but or but not in message]


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("way", WAYS)
def test_leg_too_fast_to_stop_before_its_soft_end_is_a_violation(leg, way):
    """With 10 m/s^2 over 50 mm: 1 m/s. The end behind the leg does not count, at any distance."""
    ahead, behind = (HIGH - 0.02, LOW + 0.02)[:: int(way)]
    assert broken(walked(leg, q=ahead - 0.05 * way, dq=0.99 * way)) == []
    (message,) = broken(walked(leg, q=ahead - 0.05 * way, dq=1.01 * way))
    assert message == (
        f"leg {leg}: too fast to stop before a soft end with limits.deceleration_m_s2 10: {1.01 * way:g} m/s"
    )
    assert broken(walked(leg, q=behind + 0.01 * way, dq=1.9 * way)) == []


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize(
    ("key", "limit", "words"),
    [
        ("tau", 1000.0, "force above limits.force_N 1000"),
        ("dq", 2.0, "rate above limits.speed_m_s 2"),
        ("ddq", 5.0, "acceleration above limits.acceleration_m_s2 5"),
    ],
)
def test_limit_on_a_leg_magnitude_is_checked_in_both_directions_along_a_path(leg, key, limit, words):
    for way in WAYS:
        assert broken(walked(leg, **{key: 0.99 * limit * way}), but="force changes") == []
        (message,) = broken(walked(leg, **{key: 1.01 * limit * way}), but="force changes")
        assert message.startswith(f"leg {leg}: {words}: {1.01 * limit * way:g} ")


@pytest.mark.parametrize("leg", LEGS)
def test_leg_beyond_a_soft_end_violates_the_limit(leg):
    for end, way in ((HIGH - 0.02, 1.0), (LOW + 0.02, -1.0)):
        assert broken(walked(leg, q=end - 1e-4 * way)) == []
        (message,) = broken(walked(leg, q=end + 1e-4 * way))
        assert message == f"leg {leg}: length outside the soft ends 0.77 to 2.18 m: {end + 1e-4 * way:g} m"


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize(("size_N", "limits"), [(299, []), (301, ["step"]), (701, ["step", "window"])])
def test_large_force_change_violates_its_limits_in_both_directions(leg, size_N, limits):
    for way in WAYS:
        found = sorted(broken(walked(leg, tau=size_N * way)))
        words = [f"leg {leg}: force changes by more than limits.force_{each}_N" for each in limits]
        assert [message[: len(each)] for message, each in zip(found, words, strict=True)] == words


SILENCE = Silence(T=0.1, a=6.0)
"""From 1 m/s: 0.1 m + 6 x 0.01 / 2 m = 0.13 m."""


@pytest.mark.parametrize("leg", LEGS)
@pytest.mark.parametrize("way", WAYS)
def test_travel_after_lost_commands_is_compared_with_the_end_ahead_of_the_leg(leg, way):
    ahead, behind = (HIGH, LOW)[:: int(way)]
    found = SILENCE.beyond(walked(leg, q=ahead - 0.12 * way, dq=1.0 * way), LOW, HIGH)
    assert found == pytest.approx({"t": STEP_S * HERE, "leg": leg, "travel_m": 0.13, "free_m": 0.12})
    assert SILENCE.beyond(walked(leg, q=ahead - 0.14 * way, dq=1.0 * way), LOW, HIGH) is None
    # away from an end it is that of a leg at rest: 0.03 m
    assert SILENCE.beyond(walked(leg, q=behind + 0.04 * way, dq=1.0 * way), LOW, HIGH) is None
    still = SILENCE.beyond(walked(leg, q=behind + 0.02 * way, dq=1.0 * way), LOW, HIGH)
    assert still == pytest.approx({"t": STEP_S * HERE, "leg": leg, "travel_m": 0.03, "free_m": 0.02})
    assert SILENCE.travel_m(walked(leg, dq=2.0 * way)) == pytest.approx(0.23)


def forces(model: StewartPlant | BenchPlant, q_m: float, rate: float, ddq: float) -> tuple[Array, Array]:
    """Forces, in motion and at rest, of a plant with the rate of leg k in proportion to k + 1."""
    q, dq = np.full((3, 6), q_m), np.zeros((3, 6))
    dq[1] = rate * np.arange(1.0, 7.0)
    return drive_forces(PlantSettings(model=model), q, dq, np.full((3, 6), ddq), np.full((3, 6), 50.0), np.full((2, 6), 50.0))  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_friction_and_reflected_mass_add_force_along_the_motion(way):
    """50 N of the rigid bodies, 10 N of dry friction, 200 N s/m, 4 kg at 2 m/s^2; only the first at rest."""
    model = StewartPlant(
        type="stewart", viscous_friction_N_s_m=200.0, coulomb_friction_N=10.0, reflected_mass_kg=4.0
    )
    tau, rest = forces(model, MIDDLE, 0.1 * way, 2.0)
    np.testing.assert_allclose(tau[1], 50.0 + 8.0 + way * (10.0 + 20.0 * np.arange(1, 7)))
    np.testing.assert_allclose(tau[0], 58.0)
    np.testing.assert_allclose(rest, 50.0)


def along(points, interpolation="cubic", force_step_N=4000):
    """Walk along waypoints (t_s, z_m)."""
    begin, end = C.text.index("reference:  "), C.text.index("limits:  ")
    listed = ", ".join(f"{{t_s: {t}, position_m: [0, 0, {z}]}}" for t, z in points)
    section = f"reference: {{type: waypoints, interpolation: {interpolation}, points: [{listed}]}}\n"
    text = f"{C.text[:begin]}{section}{C.text[end:]}"
    text = text.replace("force_step_N: 4000 ", f"force_step_N: {force_step_N} ")
    c = loads(text, "my.yaml")
    platform = build_platform(c.platform)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, Model(platform), trajectory, span_s(trajectory), STEP_S, c.plant)
    return w, [v.message for v in violations(w, c.platform, c.limits, STEP_S)]


LATE = [(0, 1.0), (40.0, 1.0), (40.5, 1.05), (80.0, 1.05)]
"""Rest for 40 s, then a cubic move of 0.5 s with an acceleration step of 6 x 0.05 / 0.5^2 = 1.2 m/s^2."""


def test_force_step_within_a_long_path_is_found_as_on_a_short_one():
    """The same move alone, sampled in every tick, has the same step of the leg forces."""
    w, _ = along(LATE)
    short, _ = along([(0, 1.0), (0.5, 1.05)])
    assert not w.every_tick
    assert short.every_tick
    assert len(w.t) == SAMPLES + 1
    t, step = w.steps()
    # Each of six legs lifts a sixth of 1.2 m/s^2 times some 1300 kg, over the sine of its slope.
    assert 300.0 < np.abs(step).max() < 700.0
    assert np.abs(step).max() == pytest.approx(np.abs(short.steps()[1]).max(), rel=0.02)
    assert t[np.abs(step).max(axis=1).argmax()] == pytest.approx(40.0, abs=2.5e-3)


def test_force_step_above_the_limit_is_refused_on_a_long_path_too():
    _, found = along(LATE, force_step_N=200)
    assert any("limits.force_step_N 200 in one tick" in each for each in found)
    assert not along(LATE, force_step_N=800)[1]


@pytest.mark.parametrize(
    "points",
    [
        [(0, 1.0), (0.0009, 1.02), (1, 1.02)],
        [(0, 1.0), (0.0004, 1.02)],
        [(0, 1.0), (1, 1.0), (1.0004, 1.02)],
        [(0, 1.0), (50, 1.0), (50.0008, 1.02), (90, 1.02)],
    ],
)
def test_path_with_a_jump_within_one_tick_is_refused(points):
    """20 mm in z; limits.speed_m_s of some m/s allows some mm in 1 ms."""
    _, found = along(points, "quintic")
    assert any("within one tick" in message for message in found)


def test_fast_motion_within_the_speed_limit_is_not_reported_as_a_jump():
    """A quintic peaks at 1.875 times its mean speed, and no leg is faster than the platform."""
    seconds = 1.875 * 0.1 / (0.99 * C.limits.speed_m_s)
    _, found = along([(0, 1.0), (seconds, 1.1)], "quintic", force_step_N=40000)
    assert not any("within one tick" in message for message in found)
