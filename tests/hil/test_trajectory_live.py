"""Live set-points: limits on every axis for any target, exact arrival, and a path that stays allowed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError
from hil.trajectory.live import LiveTrajectory
from tests.pose_judges import ANYWHERE
from tests.pose_judges import judged as by_address

PERIOD = 1e-3
V, A, J = 0.3, 1.0, 10.0
LIMITS = np.array([[V] * 6, [A] * 6, [J] * 6])
START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def off(*words):
    """Start pose, displaced by six numbers."""
    return START + np.array(words)


def live(limits=LIMITS, period=PERIOD, start=START):
    return LiveTrajectory(start, limits, period)


def run(trajectory, script, ticks, admit=ANYWHERE):
    """Aim at script[tick]: six coordinates (n, 6) at each tick, the first at time zero, and the refusals."""
    samples, found = [], []
    for k in range(ticks):
        if k in script:
            trajectory.aim(np.array(script[k], float))
        if k:
            found.append(trajectory.advance(k, admit))
        samples.append(trajectory.sample(0.0))
    return six_words(samples), found


def six_words(samples):
    turns = Rotation.from_matrix([s.R for s in samples]).as_rotvec()
    return np.column_stack([[s.p for s in samples], turns])


def within_limits(words):
    """Check acceleration and jerk limits on every axis, with means over a tick."""
    a = np.diff(words, n=2, axis=0) / PERIOD**2
    assert np.abs(a).max() <= A * (1 + 1e-6)
    assert np.abs(np.diff(a, axis=0) / PERIOD).max() <= J * (1 + 1e-3)


def recording(answer=lambda judged: 0):
    """Judge of poses, and the list of the poses that it was given; `answer` gives its refusal."""
    judged: list[np.ndarray] = []

    @by_address
    def look(chi):
        judged.append(chi)
        return answer(judged)

    return look, judged


def goes(trajectory, first, last, admit=ANYWHERE):
    for k in range(first, last):
        trajectory.advance(k, admit)
    return trajectory.sample(0.0)


def seeded_script(seed, every=150, count=30):
    rng = np.random.default_rng(seed)
    poses = START + rng.uniform(-0.3, 0.3, (count, 6)) * rng.choice([1e-4, 0.05, 1], (count, 6))
    return {int(k): pose for k, pose in zip(np.cumsum(rng.integers(1, 2 * every, count)), poses, strict=True)}


@pytest.mark.parametrize("seed", range(3))
def test_live_trajectory_keeps_the_limits_of_every_axis_for_any_set_points(seed):
    limits = np.array([[0.3, 0.2, 0.1, 0.3, 0.5, 0.2], [1, 2, 0.5, 1, 3, 0.7], [10, 30, 4, 20, 25, 9]])
    script = seeded_script(seed)
    words, _ = run(live(limits), script, max(script) + 6500)
    v = np.diff(words, axis=0) / PERIOD  # means over a tick: never above the largest value within
    a = np.diff(v, axis=0) / PERIOD
    j = np.diff(a, axis=0) / PERIOD
    for found, limit, rounding in ((v, limits[0], 1e-9), (a, limits[1], 1e-6), (j, limits[2], 1e-3)):
        assert (np.abs(found) <= limit * (1 + rounding)).all()
        assert (np.abs(found).max(axis=0) > 0.8 * limit).sum() >= 3, "the limits are used"
    last = script[max(script)]
    np.testing.assert_allclose(words[-1], last, rtol=0, atol=1e-14)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_lower_speed_limit_is_reached_within_the_other_limits_in_both_directions(way):
    trajectory = live()
    trajectory.aim(START + way * np.array([1.0, 0.5, 0.0, 0.0, 0.3, 0.0]))
    samples, share = [], {700: 0.25, 1600: 1.0}
    for k in range(3000):
        if k:
            trajectory.advance(k, ANYWHERE)
        if k in share:
            trajectory.limit(share[k])
        samples.append(trajectory.sample(0.0))
    words = six_words(samples)
    v = way * np.diff(words, axis=0) / PERIOD
    within_limits(words)
    assert v[699, 0] == pytest.approx(V)
    assert v[1500, 0] == pytest.approx(0.25 * V)
    assert v[2400, 0] == pytest.approx(V)


def test_twist_and_its_rate_agree_with_derivatives_of_the_pose():
    trajectory = live()
    samples = []
    for k in range(2500):
        if k in {0, 400, 900}:
            trajectory.aim(START + {0: 0.2, 400: -0.1, 900: 0.05}[k])
        trajectory.advance(k, ANYWHERE)
        samples.append(trajectory.sample(0.0))
    p = np.array([s.p for s in samples])
    twist = np.array([s.twist for s in samples])
    dtwist = np.array([s.dtwist for s in samples])
    # a quarter of the jerk's step, J h / 4, is what a difference over two ticks can be off
    assert np.abs((p[2:] - p[:-2]) / (2 * PERIOD) - twist[1:-1, :3]).max() < J * PERIOD**2
    assert np.abs((twist[2:] - twist[:-2]) / (2 * PERIOD) - dtwist[1:-1]).max() < 2 * J * PERIOD
    back = [
        Rotation.from_matrix(b.R) * Rotation.from_matrix(a.R).inv()
        for a, b in zip(samples, samples[2:], strict=False)
    ]
    omega = np.array([turn.as_rotvec() for turn in back]) / (2 * PERIOD)
    assert np.abs(omega - twist[1:-1, 3:]).max() < 4 * J * PERIOD**2
    assert np.abs(twist).max() > 0.2


@pytest.mark.parametrize(
    ("distance", "seconds"),
    [
        (0.2, 0.2 / V + V / A + 2 * A / J),  # trapezoid of speed, then the window
        (0.04, 2 * np.sqrt(0.04 / A) + 2 * A / J),  # triangle
        (1e-6, 2 * np.sqrt(1e-6 / A) + 2 * A / J),
    ],
)
def test_a_move_takes_the_time_of_the_closed_form_and_lands_exactly(distance, seconds):
    words, _ = run(live(), {0: off(distance, 0, 0, 0, 0, 0)}, 3000)
    arrived = int(np.argmax(np.abs(words[:, 0] - distance) < 1e-15)) * PERIOD
    assert seconds - PERIOD <= arrived <= seconds + 3 * PERIOD
    assert np.ptp(words[int(arrived / PERIOD) :, 0]) < 1e-15
    assert words[:, 0].max() <= distance + 1e-15, "no overshoot"


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("moment", [1, 80, 300, 600, 900])
def test_a_stop_comes_to_rest_within_the_limits_at_its_stated_time(moment, way):
    trajectory = live()
    goal = off(0.25 * way, 0, 0, 0.2 * way, 0, 0)
    before, _ = run(trajectory, {0: goal}, moment + 1)
    assert trajectory.duration_s is None
    trajectory.brake()
    assert trajectory.duration_s is not None
    end = round(trajectory.duration_s / PERIOD)
    assert end - moment <= (V / A + 2 * A / J) / PERIOD + 2
    samples = []
    for k in range(moment + 1, end + 50):
        trajectory.advance(k, ANYWHERE)
        samples.append(trajectory.sample(0.0))
    after = np.vstack([before, six_words(samples)])
    assert np.ptp(after[end:], axis=0).max() == 0.0
    within_limits(after)


def test_live_trajectory_brakes_before_a_refused_pose_and_stays():
    trajectory = live()
    words, found = run(
        trajectory, {0: off(0.25, 0, 0, 0, 0, 0)}, 2500, admit=by_address(lambda chi: 7 * (chi[0] > 0.1))
    )
    assert words[:, 0].max() <= 0.1
    assert words[-1, 0] > 0.1 - 1.1 * V * PERIOD, "the stop is within one tick of motion from the limit"
    assert [x for x in found if x] == [7], "the refusal must be reported once"
    within_limits(words)
    assert np.ptp(words[-500:, 0]) < 1e-15


UNLIKE = np.array([[0.3, 0.2, 0.1, 0.3, 0.5, 0.2], [1, 2, 0.5, 1, 3, 0.7], [10, 30, 1, 20, 6, 9]])


@pytest.mark.parametrize("moment", [3, 150, 420, 600, 1100])
def test_live_trajectory_checks_the_poses_of_its_braking_path(moment):
    trajectory = live(UNLIKE)
    script = {0: off(0.2, -0.1, 0.1, 0.1, 0, 0.2), 400: off(-0.2, 0.1, 0.1, 0, -0.2, 0.1), 900: START}
    before, _ = run(trajectory, script, moment)
    look, judged = recording()
    trajectory.advance(moment, look)
    trajectory.brake()
    assert trajectory.duration_s is not None
    end = round(trajectory.duration_s / PERIOD)
    samples = []
    for k in range(moment + 1, end):
        trajectory.advance(k, ANYWHERE)
        samples.append(trajectory.sample(0.0))
    taken = six_words(samples)
    assert 5 < len(judged) <= 16
    for chi in judged:
        assert np.abs(taken - chi).max(axis=1).min() < 1e-12
    np.testing.assert_allclose(judged[0], taken[-1], rtol=0, atol=1e-12)
    assert not np.allclose(before[-1], taken[-1], atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_axes_of_a_live_trajectory_that_stop_one_after_another_stay_at_allowed_poses(seed):
    """Allowed region with an inner corner: x or z may be large, but not both.

    A judgement of the ends of braking alone would let it 20 mm into the corner. Between the judged instants,
    about 80 ms apart here, it may still graze the corner.
    """

    def depth(chi):
        return min(chi[0] - START[0], chi[2] - START[2]) - 0.05

    limits = LIMITS.copy()
    limits[2, 0] = 2.0  # the mean is over 1 s in x, over 0.2 s in z
    rng = np.random.default_rng(seed)
    goals = [off(x, 0, z, 0, 0, 0) for x, z in rng.uniform(-0.1, 0.2, (40, 2)) if min(x, z) < 0.05]
    script = {500 * n: goal for n, goal in enumerate(goals)}
    words, found = run(
        live(limits), script, 500 * len(goals), admit=by_address(lambda chi: int(depth(chi) > 0))
    )
    assert any(found), "the path must have met the forbidden corner"
    assert max(map(depth, words)) < 2e-3
    assert (np.ptp(words[:, [0, 2]], axis=0) > 0.15).all()


def test_live_trajectory_after_skipped_ticks_is_bitwise_equal_to_one_without_skips():
    steady, skipping = live(), live()
    for trajectory in (steady, skipping):
        trajectory.aim(START + 0.1)
    for k in range(1, 201):
        steady.advance(k, ANYWHERE)
    for k in (1, 5, 120, 200):
        skipping.advance(k, ANYWHERE)
    for a, b in zip(steady.sample(0.0), skipping.sample(0.0), strict=True):
        assert a.tobytes() == b.tobytes()


@pytest.mark.parametrize("word", range(6))
def test_a_jerk_too_small_for_its_acceleration_is_refused_on_any_axis(word):
    limits = LIMITS.copy()
    limits[1:, word] = 5.0, 2.0
    with pytest.raises(ConfigurationError, match=r"is 2.5 s on some axis.* at most 2 s"):
        live(limits)
    limits[1:, word] = 4.0, 2.0
    np.testing.assert_array_equal(live(limits).sample(0.0).p, START[:3])


def test_equal_set_points_after_a_reset_give_equal_bits():
    script = seeded_script(9)
    one, _ = run(live(), script, 2000)
    for end in (LiveTrajectory.brake, LiveTrajectory.halt):
        trajectory = live()
        trajectory.aim(FAR)
        trajectory.limit(0.5)
        goes(trajectory, 1, 300)
        end(trajectory)
        goes(trajectory, 300, 400)
        trajectory.reset()
        assert trajectory.duration_s is None
        assert trajectory.resting
        two, _ = run(trajectory, script, 2000)
        assert one.tobytes() == two.tobytes()


FAR = off(2.0, -1.0, 1.5, 0.4, 0, 0.3)


def test_a_halt_comes_to_exact_rest_and_ends_with_a_new_target():
    trajectory = live()
    trajectory.aim(FAR)
    goes(trajectory, 1, 500)
    trajectory.halt()
    assert not trajectory.resting
    there = goes(trajectory, 500, 1100)
    assert trajectory.resting
    for a, b in zip(goes(trajectory, 1100, 1200), there, strict=True):
        assert a.tobytes() == b.tobytes()
    assert not there.twist.any()
    trajectory.aim(FAR)
    assert not trajectory.resting


def test_braking_path_of_a_live_trajectory_is_checked_from_its_end_to_the_first_refusal():
    trajectory = live()
    trajectory.aim(START)
    at_rest, nothing = recording()
    goes(trajectory, 1, 10, at_rest)
    assert not nothing
    trajectory.aim(FAR)
    goes(trajectory, 10, 300)
    look, judged = recording(lambda judged: len(judged) if len(judged) >= 3 else 0)
    assert trajectory.advance(300, look) == 3
    x = [chi[0] for chi in judged]
    assert x == sorted(x, reverse=True)
    assert trajectory.advance(301, look) == 0, "the accepted braking path must not be checked again"
    assert len(judged) == 3


@pytest.mark.parametrize("share", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("ticks", [1, 6])
def test_refused_live_trajectory_is_replaced_by_the_braking_path_of_the_previous_tick(share, ticks):
    """Only the first of the skipped ticks is refused; after it the path is the one to rest."""
    trajectory, braked = live(), live()
    for each in (trajectory, braked):
        each.aim(FAR)
        goes(each, 1, 500)
    braked.halt()
    trajectory.limit(share)
    assert trajectory.advance(499 + ticks, by_address(lambda _: 5)) == 5
    assert trajectory.advance(500 + ticks, by_address(lambda _: 5)) == 0
    there = goes(trajectory, 501 + ticks, 1300)
    assert trajectory.resting
    np.testing.assert_allclose(there.p, goes(braked, 500, 1300).p, rtol=0, atol=1e-12)
