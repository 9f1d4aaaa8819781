"""Paths called by address: compiled ones, and one in plain Python, which may fail."""

import numpy as np
import pytest

from drivers.compiled.pointed import FAILED
from hil.loop.motion import Motion, sample_at
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import SAMPLE, HoldTrajectory, callee_of, sampled_by
from hil.trajectory.stopping import StoppingTrajectory
from tests.pose_judges import ANYWHERE

T, HERE, THERE, EYE = 0.25, np.array([0.0, 0.0, 1.0]), np.array([0.1, -0.1, 1.1]), np.eye(3)
MOVE = GeodesicMove(HERE, EYE, THERE, EYE, 2.0)


class Plain:
    """The move in plain Python; it fails from `bad_s` on."""

    duration_s = 2.0

    def __init__(self, bad_s=np.inf):
        self.bad_s = bad_s

    def sample(self, t):
        if t >= self.bad_s:
            raise ZeroDivisionError(t)
        return MOVE.sample(t)


def same(one, other):
    return all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("wrapped", [lambda path: path, lambda path: StoppingTrajectory(path, 0.5, 1.0)])
def test_a_plain_python_path_equals_the_compiled_one_to_the_bit(wrapped):
    ours, plain = wrapped(MOVE), wrapped(Plain())
    for t in (-1.0, 0.0, 0.7, 1.3, 5.0):
        assert same(sampled_by(callee_of(plain), t), ours.sample(t))


@pytest.mark.parametrize("wrapped", [lambda path: path, lambda path: StoppingTrajectory(path, 5.0, 1.0)])
def test_the_motion_raises_the_error_of_a_plain_python_path(wrapped):
    path, motion, into = Plain(), Motion(T, HERE, EYE, 0.5), np.zeros((), SAMPLE)
    motion.start(wrapped(path), 0)
    motion.sample(3)
    path.bad_s = 3.0
    assert sample_at(motion.record, motion.override.record, 12, into) == FAILED
    assert all(np.isnan(into[name]).all() for name in ("p", "R", "twist", "dtwist"))
    with pytest.raises(ZeroDivisionError, match="3"):
        motion.sample(12)
    assert same(motion.sample(4), MOVE.sample(1.0))


def test_sample_of_a_path_is_not_changed_by_the_next_sample():
    live = LiveTrajectory(np.zeros(6), np.ones((3, 6)), 1e-3)
    for path in (MOVE, HoldTrajectory(HERE, EYE), live):
        first = path.sample(0.5)
        before = [each.tobytes() for each in first]
        live.aim(np.ones(6))
        live.advance(1, ANYWHERE)
        for each in path.sample(1.0):
            each[:] = 7.0
        assert [each.tobytes() for each in first] == before


def test_function_addresses_recorded_for_a_motion_follow_every_change_of_its_path():
    motion = Motion(T, HERE, EYE, 0.5)
    live = LiveTrajectory(np.zeros(6), np.ones((3, 6)), T)

    def recorded(path, duration, then=(0, 0)):
        known = motion.record["function"], motion.record["context"], motion.record["duration"]
        assert known == (*path.callee[:2], duration)
        assert (motion.record["then_function"], motion.record["then_context"]) == then

    recorded(motion.trajectory, np.inf)
    motion.start(MOVE, 0, then=live)
    recorded(MOVE, 2.0, live.callee[:2])
    motion.stop(4, 0.5)
    recorded(motion.trajectory, 1.5)
    motion.leave(MOVE, 5)
    left = motion.trajectory
    recorded(MOVE, 2.0)
    motion.resume(6)
    assert motion.trajectory is not left
    recorded(motion.trajectory, 1.5)
    motion.start(live, 7)
    recorded(live, np.inf)
    motion.stop(8, 0.5)
    recorded(live, live.duration_s)
