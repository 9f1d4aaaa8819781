"""The words of a jog: answers, how long one lasts, what is kept of it, and the way on which a limit stops it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Refusal
from hil.config.running import OperatorSettings
from hil.loop.jogging import Jogging
from hil.loop.motion import Motion
from hil.signals import Operator, Order, explain
from hil.trajectory.move import GeodesicMove
from tests.hil.test_jogging import HERE, PLATFORM, STOP_S, Held, Q, jog, lengths
from tests.hil.test_operating import KEY

WORD = jog("y", 0.5)


def made(admission=lambda _: 0, too_sudden=lambda *_: False, **settings):
    """A jogging of 1000 Hz, whose words last 100 ticks, and a motion at rest on its path."""
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


@pytest.mark.parametrize("forgets", [Jogging.reset, Jogging.let_go])
def test_a_limit_that_is_forgotten_refuses_no_word(forgets):
    both = made(lambda _: int(Refusal.STROKE))
    assert take(both, WORD, 0) == ""
    step(both, 0, 1)
    assert not both[1].away, "a jog that is refused where it would begin leaves the path alone"
    refusal = both[0].refusal
    assert explain(Refusal.STROKE) in refusal
    assert take(both, WORD, 1) == refusal
    forgets(both[0])
    assert both[0].refusal == ""
    assert take(both, WORD, 2) == ""


@pytest.mark.parametrize(("heard", "answered"), [(99, True), (100, False)])
def test_a_word_counts_again_on_the_way_of_a_limit_once_it_has_been_silent_for_100_ms(heard, answered):
    both = made(lambda _: int(Refusal.STROKE))
    take(both, WORD, 7)
    step(both, 7, 8)
    assert bool(take(both, WORD, 7 + heard)) is answered


@pytest.mark.parametrize("left_s", [0.0, 20.0])
@pytest.mark.parametrize(("name", "deg_s"), [("x", 5.0), ("ry", 5.0), ("leg4", 0.7), ("-leg4", 0.7)])
def test_the_judged_pose_is_the_one_to_which_braking_from_the_next_tick_leads(name, deg_s, left_s):
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
    assert np.abs(judged[0] - here).max() < 1e-8, "it begins where it is"
    np.testing.assert_allclose(judged[-1], six_words(both[1].sample(700)), rtol=0, atol=1e-10)
    assert np.abs(judged[-1] - here).max() > 1e-4


# -- through the operator's orders


def near(chi):
    """Refuse poses at which a leg is more than 5 mm longer or shorter."""
    q = lengths(chi[:3], Rotation.from_rotvec(chi[3:]).as_matrix())
    return int(Refusal.STROKE) if np.abs(q - Q).max() > 5e-3 else 0


@pytest.mark.parametrize("name", ["x", "leg3"])
@pytest.mark.parametrize("others", [[], [Order(Operator.SPEED, (0.5,)), KEY]], ids=len)
def test_where_a_limit_stops_a_jog_its_word_is_refused_and_no_other_order(name, others):
    held = Held(near, deadman_s=0.2)
    held.say(KEY)
    orders = [*others, jog(name), *others]
    answers = [held.say(KEY, *orders)[0][1:] for _ in range(400)]
    word = len(others)
    first = next(tick for tick, given in enumerate(answers) if any(given))
    assert first > 50
    assert f"jog {name}: it stops" in answers[first][word]
    for given in answers:
        assert not any(given[:word] + given[word + 1 :])
