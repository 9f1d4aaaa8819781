"""Jogging: path, speed, the stop before a limit, and reasons for its end or refusal."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Mode, Refusal
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.config.running import OperatorSettings
from hil.loop.jogging import (
    LIVE,
    NO_KEY,
    NOT_RESTING,
    ON_HOLD,
    Jogging,
    LegJog,
    jog_path,
)
from hil.loop.motion import Motion
from hil.loop.operating import Operating
from hil.signals import JOG_NAMES, Operator, Order
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample
from tests.broad import broad
from tests.hil.test_operating import HOLD, KEY, START, free

LAB = load("lab").platform
OFFSETS = np.random.default_rng(5).uniform(-0.04, 0.04, (2, 6, 3))
PLATFORM = build_platform(LAB)
PLATFORM = replace(
    PLATFORM,
    base_joints=PLATFORM.base_joints + OFFSETS[0],
    platform_joints=PLATFORM.platform_joints + OFFSETS[1],
)
"""A pose without symmetry, which could hide a wrong leg order."""
HOME_P, HOME_R = pose_arrays(LAB.home)
TURNED = Rotation.from_rotvec([0.1, -0.05, 0.08]).as_matrix() @ HOME_R
HERE = PoseSample(HOME_P + np.array([0.02, -0.01, 0.03]), TURNED, np.zeros(6), np.zeros(6))
STOP_S, SPEED, TURN_deg_s = 0.4, 0.05, 5.0


def lengths(p, R):
    return np.linalg.norm(p + PLATFORM.platform_joints @ R.T - PLATFORM.base_joints, axis=1)


Q = lengths(HERE.p, HERE.R)


class Box:
    """Refuses poses with a leg outside low .. high, m; counts its calls."""

    def __init__(self, room=0.02):
        self.low, self.high = Q.min() - room, Q.max() + room
        self.asked = 0

    def __call__(self, chi):
        self.asked += 1
        q = lengths(chi[:3], Rotation.from_rotvec(chi[3:]).as_matrix())
        return 0 if (q >= self.low).all() and (q <= self.high).all() else int(Refusal.STROKE)


class Held:
    """A platform on hold at HERE, with the operating state that executes orders."""

    def __init__(self, admission, rate_Hz=1000.0, too_sudden=lambda *_: False, **settings):
        self.settings = OperatorSettings(
            **{"setup_speed_m_s": SPEED, "setup_speed_deg_s": TURN_deg_s} | settings
        )
        self.rate_Hz, self.tick = rate_Hz, 0
        jogs = Jogging(self.settings, rate_Hz, PLATFORM, admission, too_sudden)
        self.operating = Operating(self.settings, rate_Hz, STOP_S, jogs, free)
        self.motion = Motion(1.0 / rate_Hz, HERE.p, HERE.R, STOP_S)
        self.path = GeodesicMove(HERE.p, HERE.R, HERE.p + np.array([0.0, 0.0, 0.1]), HERE.R, 60.0)
        self.motion.start(self.path, 0)
        self.operating.go = False
        self.motion.settle(0, 0.0)

    def say(self, *orders):
        """Run one tick; return the answers and the sample."""
        self.operating.step(orders, self.tick, Mode.TRACKING, self.motion)
        sample = self.motion.sample(self.tick)
        self.tick += 1
        return self.operating.answers, sample

    def run(self, ticks, *orders, every=20):
        """Give orders every `every` ticks; return the answers and the samples."""
        answers, samples = [], []
        for k in range(ticks):
            answer, sample = self.say(*(orders if k % every == 0 else ()))
            answers += answer
            samples.append(sample)
        return answers, samples


def jog(name, fraction=1.0):
    return Order(Operator.JOG, (float(JOG_NAMES.index(name)), fraction))


def speed(samples):
    return np.array([[np.linalg.norm(s.twist[:3]), np.linalg.norm(s.twist[3:])] for s in samples])


@pytest.mark.parametrize("fraction", [1.0, -1.0])
@pytest.mark.parametrize(
    "name", broad(sorted(JOG_NAMES, key=lambda n: n not in ("x", "rz", "leg4")), quick=3)
)
def test_jog_stops_smoothly_just_inside_the_limit_with_a_reason(name, fraction):
    box = Box(0.015)
    held = Held(box)
    answers, samples = held.run(6000, jog(name, fraction))
    q = np.array([lengths(s.p, s.R) for s in samples])
    assert q.min() >= box.low
    assert q.max() <= box.high
    assert min(q[-1].min() - box.low, box.high - q[-1].max()) < 3e-4, "uses the stroke up to the limit"
    assert not samples[-1].twist.any()
    assert answers[0] == ""
    assert f"jog {name}: stopped, since farther on a leg would be outside" in answers[-1]
    refused = [why != "" for why in answers]
    assert refused == sorted(refused), "a refused jog must stay refused while its commands repeat"
    v = np.array([s.twist for s in samples])
    a = np.array([s.dtwist for s in samples])
    np.testing.assert_allclose(np.diff(v, axis=0) * 1e3, 0.5 * (a[1:] + a[:-1]), atol=2e-3)
    highest = np.array([SPEED, np.deg2rad(TURN_deg_s)])
    assert (speed(samples).max(axis=0) <= highest * (1 + 1e-3)).all()
    still = np.flatnonzero(v.any(axis=1))[-1]
    assert (np.diff(v[:still].any(axis=1).astype(int)) >= 0).all(), "the platform stops once without creeping"
    back, _ = held.run(100, jog(name, -fraction))
    assert back[0] == "", "the jog in the opposite direction must be accepted"


@pytest.mark.parametrize(
    ("rate_Hz", "seconds", "ticks"), [(1000.0, 1, 100), (250.0, 1, 25), (20.0, 3, 2), (5.0, 3, 1)]
)
def test_jog_brakes_100_ms_after_its_last_command(rate_Hz, seconds, ticks):
    """In a loop with a longer period, after one tick."""
    held = Held(Box(1.0), rate_Hz)
    held.run(int(seconds * rate_Hz), jog("y"), every=1)
    last = held.tick - 1
    _, samples = held.run(int(seconds * rate_Hz))
    slower = np.flatnonzero(speed(samples)[:, 0] < SPEED * (1 - 1e-9))[0] + last + 1
    assert slower == last + ticks + 1
    assert not samples[-1].twist.any()


def test_jog_without_the_key_is_refused_and_releasing_the_key_ends_it():
    held = Held(Box(1.0), deadman_s=0.05)
    assert held.say(jog("x"))[0] == [NO_KEY]
    held.run(600, KEY, jog("x"))
    answers, samples = held.run(700, jog("x"))
    assert NO_KEY in answers
    assert not samples[-1].twist.any()


def test_jog_is_refused_in_motion_and_with_a_live_reference():
    held = Held(Box(1.0))
    held.say(START)
    assert held.say(jog("x"))[0] == [ON_HOLD]
    held.run(300)
    assert held.say(HOLD, jog("x"))[0] == ["", NOT_RESTING]
    assert Held(None).say(jog("x"))[0] == [LIVE]
    held.operating.step([jog("x")], held.tick, Mode.APPROACH, held.motion)
    assert held.operating.answers == [ON_HOLD]


def test_jog_with_too_large_force_changes_is_refused_or_stopped():
    everywhere = Held(Box(1.0), too_sudden=lambda *_: True)
    answers, samples = everywhere.run(600, jog("x"))
    assert not np.array([s.twist for s in samples]).any()
    assert "limits.force_window_N" in answers[-1]
    border = HERE.p[0] + 0.01
    ahead = Held(Box(1.0), too_sudden=lambda s, _: s.p[0] > border)
    _, samples = ahead.run(2000, jog("x"))
    assert border - 3e-4 < samples[-1].p[0] <= border
    assert not samples[-1].twist.any()


@pytest.mark.parametrize("command", [Operator.START, Operator.PARK, Operator.HOLD])
def test_start_and_park_stop_a_jog_and_hold_does_not(command):
    held = Held(Box(1.0))
    _, samples = held.run(600, jog("x"), every=1)
    held.say(jog("x"), Order(command))
    _, more = held.run(600)
    v = np.array([s.twist[0] for s in samples[-1:] + more])
    assert np.abs(np.diff(v)).max() <= 2 * 1.5 / STOP_S * SPEED * 1e-3
    if command is Operator.HOLD:
        np.testing.assert_allclose(v[:20], SPEED)
        return
    assert (np.diff(v[1:20]) < 0.0).all()
    if command is Operator.PARK:
        assert held.motion.resting, "the way back to the first pose is the cycle's"
        assert not more[-1].twist.any()
    else:
        assert v[-1] < 0.0


# -- what it follows, against independent formulas


SPEEDS = 0.04, 0.3
"""Set-up speeds, m/s, rad/s."""


def rates(path, t, h=1e-4):
    """Twist and its rate by central differences of poses and twists, (6,) each."""
    before, after = path.sample(t - h), path.sample(t + h)
    turn = Rotation.from_matrix(after.R @ before.R.T).as_rotvec()
    twist = np.concatenate([after.p - before.p, turn]) / (2 * h)
    return twist, (after.twist - before.twist) / (2 * h)


@pytest.mark.parametrize("leg", range(6))
def test_leg_jog_keeps_five_lengths_and_its_twist_fits_its_poses(leg):
    rate = np.zeros(6)
    rate[leg] = 0.05
    path = LegJog(PLATFORM, HERE, rate)
    for t in np.arange(0.0, 1.2, 0.01):
        sample = path.sample(t)
        np.testing.assert_allclose(lengths(sample.p, sample.R), Q + t * rate, rtol=0, atol=1e-9)
        np.testing.assert_allclose(sample.R @ sample.R.T, np.eye(3), atol=1e-12)
    for t in (0.2, 0.7, 1.1):
        sample = path.sample(t)
        twist, dtwist = rates(path, t)
        np.testing.assert_allclose(sample.twist, twist, atol=1e-6 * np.abs(twist).max() + 1e-9)
        np.testing.assert_allclose(sample.dtwist, dtwist, atol=1e-4 * np.abs(dtwist).max() + 1e-8)


def test_leg_jog_stays_at_the_last_pose_if_the_lengths_are_impossible():
    path = LegJog(PLATFORM, HERE, np.array([1.0, 0, 0, 0, 0, 0]))
    last = path.sample(0.01)
    assert path.ahead(50.0) is None
    assert path.sample(50.0) is last


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("way", [1.0, -0.2])
def test_axis_jog_moves_along_or_about_a_base_axis_at_set_up_speed(axis, way):
    rate = np.sign(way) * np.where(np.arange(6) < 3, 0.04, 0.3) * (np.arange(6) == axis)
    path = jog_path(PLATFORM, HERE, axis, SPEEDS, way)
    assert path.duration_s is None
    sample = path.sample(1.5)
    np.testing.assert_allclose(sample.p, HERE.p + 1.5 * rate[:3], atol=1e-15)
    turn = Rotation.from_rotvec(1.5 * rate[3:]).as_matrix()
    np.testing.assert_allclose(sample.R, turn @ HERE.R, atol=1e-14)
    np.testing.assert_array_equal(sample.twist, rate)
    assert not sample.dtwist.any()
