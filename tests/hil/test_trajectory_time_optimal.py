"""Time-optimal moves: durations in closed form, limits reached but never exceeded, straight lines, replay."""

import io
import sys
from itertools import pairwise

import numpy as np
import pytest
from ruckig import InputParameter, Ruckig, Synchronization, Trajectory
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError, LogError
from hil.config.reference import TimeOptimalReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.time_optimal import plan, planned_trajectory

HOME = Pose(position_m=(0, 0, 1))
LIMITS = {
    "velocity_m_s": [0.5, 0.4, 0.3],
    "velocity_deg_s": 20,
    "acceleration_m_s2": 2,
    "acceleration_deg_s2": [60, 90, 120],
    "jerk_m_s3": 20,
    "jerk_deg_s3": 900,
}
POINTS = [
    ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    ((0.3, 0.1, 1.05), (5.0, 0.0, 0.0)),
    ((0.28, -0.2, 0.9), (0.0, 15.0, -10.0)),
    ((0.28, -0.2, 0.9), (0.0, 15.0, -10.5)),
]


def settings(points=POINTS, periods=1, limits=LIMITS):
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in points]
    given = {"type": "time_optimal", "points": poses, "limits": limits, "periods": periods}
    return TimeOptimalReference.model_validate(given)


def build(*what, recorded=None, **how):
    return build_trajectory(settings(*what, **how), HOME, None, recorded=recorded)


def six_words(trajectory, t):
    """Six coordinates at times t; rotation vectors from the rotation matrices."""
    samples = [trajectory.sample(float(s)) for s in t]
    return np.array([[*s.p, *Rotation.from_matrix(s.R).as_rotvec()] for s in samples])


@pytest.mark.parametrize(
    ("d", "V", "duration"),
    [
        # all seven pieces, V = 0.5, A = 2, J = 20: D/V + V/A + A/J
        (0.4, 0.5, 0.4 / 0.5 + 0.5 / 2 + 2 / 20),
        # the velocity is not reached: A/J + sqrt((A/J)^2 + 4 D/A)
        (0.1, 0.5, 0.1 + np.sqrt(0.1**2 + 4 * 0.1 / 2)),
        # nor is the acceleration: four pieces of jerk, D = 2 J T^3
        (0.002, 0.5, 4 * (0.002 / (2 * 20)) ** (1 / 3)),
        # V < A^2/J: the ramps last 2 sqrt(V/J)
        (0.4, 0.1, 0.4 / 0.1 + 2 * np.sqrt(0.1 / 20)),
    ],
)
def test_a_symmetric_move_takes_the_time_of_the_closed_form(d, V, duration):
    trajectory = build([POINTS[0], ((d, 0.0, 1.0), (0, 0, 0))], limits=LIMITS | {"velocity_m_s": V})
    assert trajectory.duration_s == pytest.approx(duration, rel=1e-12)
    assert trajectory.sample(duration / 2).p[0] == pytest.approx(d / 2, rel=1e-12)
    np.testing.assert_allclose(trajectory.sample(duration).p, [d, 0, 1], rtol=0, atol=1e-15)


def test_limits_are_reached_and_never_exceeded():
    trajectory = build()
    h = 2.5e-4
    t = np.arange(0.0, trajectory.duration_s, h)
    chi = six_words(trajectory, t)
    v = np.diff(chi, axis=0) / h  # means over h: never above the largest value
    a = np.diff(v, axis=0) / h
    j = np.diff(a, axis=0) / h
    V = np.r_[0.5, 0.4, 0.3, np.deg2rad([20, 20, 20])]
    A = np.r_[2, 2, 2, np.deg2rad([60, 90, 120])]
    J = np.r_[20, 20, 20, np.deg2rad([900, 900, 900])]
    assert (np.abs(v) <= V * (1 + 1e-9)).all()
    assert (np.abs(a) <= A * (1 + 1e-6)).all()
    assert (np.abs(j) <= J * (1 + 1e-3)).all(), "rounded positions differ by up to 4e-16 / h^3 = 3e-5"
    ends = np.array([np.r_[p, np.deg2rad(r)] for p, r in POINTS])
    at = [int(np.argmin(np.abs(chi - end).sum(axis=1))) for end in ends]
    assert at == sorted(at)
    for first, last in pairwise(at):
        share = [float((np.abs(x[first : last - 2]) / limit).max()) for x, limit in ((v, V), (a, A), (j, J))]
        assert max(share) > 0.999, "some axis is at a limit in each move"
        assert share[2] > 0.999, "a time-optimal move always starts with the largest jerk"


def test_axes_without_a_straight_line_still_arrive_together():
    """x needs 10 s at its velocity limit; y on the same line would need 2 m/s^2, but has 0.05 m/s^2."""
    V, A, J = [0.1, 5.0, 3.0], [2.0, 0.05, 1.0], [20.0, 2.0, 5.0]
    start, end = [0.0, 0.0, 1.0], [1.0, 0.9, 1.02]
    ask, answer = InputParameter(3), Trajectory(3)
    ask.current_position, ask.target_position = start, end
    ask.max_velocity, ask.max_acceleration, ask.max_jerk = V, A, J
    ask.synchronization = Synchronization.Phase
    Ruckig(3).calculate(ask, answer)
    trajectory = build(
        [(start, (0, 0, 0)), (end, (0, 0, 0))],
        limits=LIMITS | {"velocity_m_s": V, "acceleration_m_s2": A, "jerk_m_s3": J},
    )
    assert trajectory.duration_s == pytest.approx(1.0 / 0.1 + 2 * np.sqrt(0.1 / 20), rel=1e-12)
    for t in np.linspace(0.0, trajectory.duration_s, 1001):
        x, v, a = answer.at_time(t)
        sample = trajectory.sample(float(t))
        np.testing.assert_allclose(sample.p, x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(sample.twist[:3], v, rtol=0, atol=1e-12)
        np.testing.assert_allclose(sample.dtwist[:3], a, rtol=0, atol=1e-9)


def test_periods_repeat_a_closed_list():
    loop = [*POINTS[:3], POINTS[0]]
    once, thrice = build(loop), build(loop, periods=3)
    assert thrice.duration_s == pytest.approx(3 * once.duration_s)
    np.testing.assert_allclose(thrice.sample(once.duration_s + 0.7).p, once.sample(0.7).p, rtol=0, atol=1e-13)


def recorded(table):
    file = io.BytesIO()
    np.save(file, table)
    return file.getvalue()


GOOD = plan(settings())
TABLE = np.load(io.BytesIO(GOOD))


def changed(row, column, value):
    table = TABLE.copy()
    table[row, column] = value
    return recorded(table)


def test_a_recorded_plan_gives_the_same_trajectory_to_the_bit():
    fresh = build()
    other = [POINTS[0], POINTS[2]]
    for replayed in (build(other, recorded=GOOD), build(recorded=recorded(np.asfortranarray(TABLE)))):
        assert replayed.duration_s == fresh.duration_s
        for t in np.linspace(0, fresh.duration_s, 301):
            for a, b in zip(fresh.sample(t), replayed.sample(t), strict=True):
                assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize(
    "file",
    [
        recorded(TABLE[:, :-1]),
        recorded(TABLE[:0]),
        recorded(TABLE.ravel()),
        recorded(TABLE.astype(np.int64)),
        GOOD[: -8 * 37],
        GOOD + GOOD[-8 * 37 :],
        b"no plan",
        changed(0, 0, 0.0),
        changed(1, 0, TABLE[0, 0]),
        changed(2, 5, np.nan),
    ],
    ids=[
        "narrow",
        "empty",
        "flat",
        "integers",
        "short",
        "long",
        "no file",
        "at zero",
        "no time",
        "no number",
    ],
)
def test_a_damaged_plan_in_a_log_is_refused(file):
    with pytest.raises(LogError, match="plan of the reference"):
        planned_trajectory(file, 1)


@pytest.mark.parametrize(
    ("key", "limit", "seconds"),
    [
        ("velocity_m_s", 3e-5, "10000 s"),  # 0.3 m / v
        ("acceleration_m_s2", 1.2e-8, "10000 s"),  # 2 sqrt(0.3 m / a)
        ("jerk_m_s3", 9.6e-12, "10000 s"),  # cbrt(32 x 0.3 m / j)
        ("velocity_m_s", 0.3 / 7599.9, "not a valid|Duration"),  # below it alone, and above it with the ramps
    ],
)
def test_a_move_of_hours_is_refused_with_its_time(key, limit, seconds):
    slow = dict(LIMITS, acceleration_m_s2=2e-6) if limit > 1e-5 and key == "velocity_m_s" else LIMITS
    with pytest.raises(ConfigurationError, match=rf"reference.limits: .*({seconds}).*7600 s"):
        build([((0, 0, 1), (0, 0, 0)), ((0.3, 0, 1), (0, 0, 0))], limits={**slow, key: limit})


def test_moves_of_more_than_a_day_are_refused():
    there, back = ((0, 0, 1), (0, 0, 0)), ((0.3, 0, 1), (0, 0, 0))
    with pytest.raises(ConfigurationError, match=r"reference.limits: .*86400 s"):
        build([there, back] * 10, limits=dict(LIMITS, velocity_m_s=0.3 / 5000))


def test_time_optimal_reference_without_ruckig_is_refused_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ruckig", None)
    with pytest.raises(ConfigurationError, match="pip install ruckig"):
        build()
