"""Jog commands: answers, their duration, memory of a refusal, and the braking path to a limit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Refusal
from hil.config.running import OperatorSettings
from hil.loop.jogging import Jogging
from hil.loop.motion import Motion
from hil.trajectory.move import GeodesicMove
from tests.hil.test_jogging import HERE, PLATFORM, STOP_S, jog

WORD = jog("y", 0.5)


def made(admission=lambda _: 0, too_sudden=lambda *_: False, **settings):
    """Jogging at 1000 Hz, with commands that last 100 ticks, and a motion at rest on its path."""
    jogging = Jogging(OperatorSettings(**settings), 1000.0, PLATFORM, admission, too_sudden)
    motion = Motion(1e-3, HERE.p, HERE.R, STOP_S)
    motion.start(GeodesicMove(HERE.p, HERE.R, HERE.p + np.array([0.0, 0.0, 0.1]), HERE.R, 60.0), 0)
    motion.settle(0, 0.0)
    return jogging, motion


def six_words(sample):
    return np.r_[sample.p, Rotation.from_matrix(sample.R).as_rotvec()]


def take(both, order, tick, on_hold=True, key=True):
    jogging, motion = both
    return jogging.take(order, tick, motion, on_hold=on_hold, key=key)


def step(both, first, last, key=True):
    jogging, motion = both
    for tick in range(first, last):
        motion.advance(tick)
        jogging.step(tick, motion, key=key)


@pytest.mark.parametrize(("heard", "answered"), [(99, True), (100, False)])
def test_jog_refused_at_a_limit_is_accepted_again_only_after_a_pause_of_100_ms(heard, answered):
    both = made(lambda _: int(Refusal.STROKE))
    take(both, WORD, 7)
    step(both, 7, 8)
    assert bool(take(both, WORD, 7 + heard)) is answered


@pytest.mark.parametrize("left_s", [0.0, 20.0])
@pytest.mark.parametrize(("name", "deg_s"), [("x", 5.0), ("ry", 5.0), ("leg4", 0.7), ("-leg4", 0.7)])
def test_jog_is_checked_at_the_pose_reached_by_braking_from_the_next_tick(name, deg_s, left_s):
    judged = []

    def note(chi):
        judged.append(chi)
        return 0

    both = made(note, setup_speed_deg_s=deg_s)
    both[1].override.place(0, left_s)
    step(both, 0, 50)
    here = six_words(both[1].sample(50))
    take(both, jog(name.strip("-"), -1.0 if "-" in name else 1.0), 50)
    step(both, 50, 140)
    both[1].advance(140)
    both[0].let_go()
    step(both, 140, 700)
    assert both[1].resting
    assert len(judged) == 90
    assert np.abs(judged[0] - here).max() < 1e-8, "the first checked pose must be the present pose"
    np.testing.assert_allclose(judged[-1], six_words(both[1].sample(700)), rtol=0, atol=1e-10)
    assert np.abs(judged[-1] - here).max() > 1e-4
