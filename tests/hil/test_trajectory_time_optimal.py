"""Time-optimal moves: durations in closed form, limits touched and never exceeded, straight lines, replay."""

import io
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError
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


def build(points=POINTS, periods=1, limits=LIMITS, recorded=None):
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in points]
    settings = {"type": "time_optimal", "points": poses, "limits": limits, "periods": periods}
    return build_trajectory(TimeOptimalReference.model_validate(settings), HOME, None, recorded=recorded)


def move(dx, **changes):
    return build([POINTS[0], ((dx, 0.0, 1.0), (0, 0, 0))], limits=LIMITS | changes)


def six_words(trajectory, t):
    """The six words at instants t, by rotation vectors from the rotation matrices."""
    samples = [trajectory.sample(float(s)) for s in t]
    return np.array([[*s.p, *Rotation.from_matrix(s.R).as_rotvec()] for s in samples])


@pytest.mark.parametrize(
    ("d", "duration"),
    [
        # all seven pieces, V = 0.5, A = 2, J = 20: D/V + V/A + A/J
        (0.4, 0.4 / 0.5 + 0.5 / 2 + 2 / 20),
        # the velocity is not reached: A/J + sqrt((A/J)^2 + 4 D/A)
        (0.1, 0.1 + np.sqrt(0.1**2 + 4 * 0.1 / 2)),
        # nor is the acceleration: four pieces of jerk, D = 2 J T^3
        (0.002, 4 * (0.002 / (2 * 20)) ** (1 / 3)),
    ],
)
def test_a_symmetric_move_takes_the_time_of_the_closed_form(d, duration):
    trajectory = move(d)
    assert trajectory.duration_s == pytest.approx(duration, rel=1e-12)
    half = trajectory.sample(duration / 2)
    assert half.p[0] == pytest.approx(d / 2, rel=1e-12)
    np.testing.assert_allclose(trajectory.sample(duration).p, [d, 0, 1], rtol=0, atol=1e-15)


def test_a_move_that_reaches_the_velocity_but_not_the_acceleration():
    # V < A^2/J: the ramps last 2 sqrt(V/J)
    trajectory = move(0.4, velocity_m_s=0.1)
    assert trajectory.duration_s == pytest.approx(0.4 / 0.1 + 2 * np.sqrt(0.1 / 20), rel=1e-12)


def test_limits_are_touched_and_never_exceeded():
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


def test_it_rests_at_every_point():
    trajectory = build()
    ends = np.array([np.r_[p, np.deg2rad(r)] for p, r in POINTS])
    t = np.linspace(0, trajectory.duration_s, 20_001)
    speed = np.array([np.abs(trajectory.sample(float(s)).twist).max() for s in t])
    resting = [s for s, x in zip(t, speed, strict=True) if x < 1e-6]
    found = six_words(trajectory, resting)
    for end in ends:
        assert np.abs(found - end).max(axis=1).min() < 1e-8


def test_axes_go_in_proportion_where_their_limits_allow_it():
    trajectory = build([POINTS[0], ((0.3, 0.15, 1.0), (3.0, 0.0, 0.0))])
    chi = six_words(trajectory, np.linspace(0, trajectory.duration_s, 101)) - [0, 0, 1, 0, 0, 0]
    share = chi[:, 0] / 0.3
    np.testing.assert_allclose(chi[:, 1], 0.15 * share, rtol=0, atol=1e-13)
    np.testing.assert_allclose(chi[:, 3], np.deg2rad(3.0) * share, rtol=0, atol=1e-13)


def test_axes_that_cannot_go_in_proportion_move_as_the_planner_says_and_arrive_together():
    """x needs 10 s at its velocity; y on the same line would need 2 m/s^2, and has 0.05 m/s^2."""
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


def test_a_plan_gives_the_same_trajectory_to_the_bit():
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in POINTS]
    settings = TimeOptimalReference.model_validate(
        {"type": "time_optimal", "points": poses, "limits": LIMITS}
    )
    one, two = build(), build(recorded=plan(settings))
    for t in np.linspace(0, one.duration_s, 301):
        for a, b in zip(one.sample(t), two.sample(t), strict=True):
            assert a.tobytes() == b.tobytes()


def test_a_recorded_plan_wins_over_a_new_one():
    other = TimeOptimalReference.model_validate(
        {
            "type": "time_optimal",
            "points": [{"position_m": [0, 0, 1]}, {"position_m": [0, 0, 1.1]}],
            "limits": LIMITS,
        }
    )
    assert build(recorded=plan(other)).duration_s == pytest.approx(
        build_trajectory(other, HOME, None).duration_s
    )


def test_periods_repeat_a_closed_list():
    loop = [*POINTS[:3], POINTS[0]]
    once, thrice = build(loop), build(loop, periods=3)
    assert thrice.duration_s == pytest.approx(3 * once.duration_s)
    np.testing.assert_allclose(thrice.sample(once.duration_s + 0.7).p, once.sample(0.7).p, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("points", "periods", "complaint"),
    [
        ([POINTS[0], POINTS[0]], 1, r"reference.points\[1\]: the same pose as the point before it"),
        (POINTS, 2, r"reference.points: periods is 2, but the path ends"),
    ],
)
def test_what_is_no_move_is_refused(points, periods, complaint):
    with pytest.raises(ConfigurationError, match=complaint):
        build(points, periods)


def test_a_point_that_is_turned_by_more_than_half_a_turn_is_refused():
    with pytest.raises(ValidationError, match=r"points.1.rotation_vector_deg\n.*at most 180 deg"):
        build([POINTS[0], ((0, 0, 1), (0, 190, 0))], 1)


def test_a_recorded_plan_is_read_in_whatever_order_its_file_holds_it():
    """Kernels take the polynomials unseen."""
    settings = {"type": "time_optimal", "limits": LIMITS, "periods": 1}
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in POINTS]
    table = np.load(io.BytesIO(plan(TimeOptimalReference.model_validate({**settings, "points": poses}))))
    file = io.BytesIO()
    np.save(file, np.asfortranarray(table))
    t = np.linspace(0.0, build().duration_s, 20)
    np.testing.assert_array_equal(six_words(build(recorded=file.getvalue()), t), six_words(build(), t))


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [(0, 0, 0.0), (0, 0, -0.1), (1, 0, None), (1, 0, 1e-3), (2, 5, np.nan), (2, 0, np.inf)],
    ids=["begins at its end", "before it begins", "no time", "back", "no number", "no end"],
)
def test_a_recorded_plan_whose_times_do_not_increase_or_that_has_no_numbers_is_refused(row, column, value):
    settings = {"type": "time_optimal", "limits": LIMITS, "periods": 1}
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in POINTS]
    good = plan(TimeOptimalReference.model_validate({**settings, "points": poses}))
    assert planned_trajectory(good, 1).duration_s == build().duration_s
    table = np.load(io.BytesIO(good))
    table[row, column] = table[row - 1, 0] if value is None else value
    file = io.BytesIO()
    np.save(file, table)
    with pytest.raises(LogError, match="its numbers must be finite, its times increase"):
        planned_trajectory(file.getvalue(), 1)
