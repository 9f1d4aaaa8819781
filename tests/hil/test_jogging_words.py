"""The words of a jog: what each is answered in the tick of the stop, how long one lasts, and from where it counts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Refusal
from hil.loop.jogging import LegJog, setup_share
from hil.signals import Operator, Order
from tests.hil.test_jogging import (
    HOLD,
    KEY,
    PLATFORM,
    SPEED,
    START,
    Box,
    Held,
    Q,
    jog,
    lengths,
    speed,
)


def near(chi):
    """Refuse poses at which a leg is more than 5 mm longer or shorter."""
    q = lengths(chi[:3], Rotation.from_rotvec(chi[3:]).as_matrix())
    return int(Refusal.STROKE) if np.abs(q - Q).max() > 5e-3 else 0


@pytest.mark.parametrize("name", ["x", "leg3"])
@pytest.mark.parametrize("others", [[], [KEY], [Order(Operator.SPEED, (0.5,)), KEY]], ids=len)
def test_in_the_tick_in_which_a_limit_stops_a_jog_its_word_is_refused_and_no_other_order_is(name, others):
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


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(10.0, 1), (5.0, 1), (20.0, 2)])
def test_a_word_lasts_for_100_ms_and_in_a_slower_loop_for_its_tick(rate_Hz, ticks):
    held = Held(Box(1.0), rate_Hz)
    held.run(int(3 * rate_Hz), jog("y"), every=1)
    last = held.tick - 1
    _, samples = held.run(int(3 * rate_Hz))
    slower = np.flatnonzero(speed(samples)[:, 0] < SPEED * (1 - 1e-9))[0] + last + 1
    assert slower == last + ticks + 1
    assert not samples[-1].twist.any()


@pytest.mark.parametrize("name", ["leg0", "leg2", "leg5"])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_leg_begins_at_the_share_of_where_it_is_however_far_along_the_path_that_is(name, way):
    """A leg turns the platform less or more the farther it goes; so the share differs from place to place."""
    shares = []

    def noted(_sample, share):
        shares.append(share)
        return False

    held = Held(Box(1.0), too_sudden=noted, setup_speed_deg_s=0.7)
    held.say(START)
    held.run(2000)
    held.say(HOLD)
    held.run(600)
    begun = held.motion.time(held.tick)
    assert begun > 2.0
    here = held.motion.sample(held.tick)
    held.run(2, jog(name, way))
    rate = way * SPEED * (np.arange(6) == int(name[-1]))
    path = LegJog(PLATFORM, here, rate)
    speeds = SPEED, np.deg2rad(0.7)
    expected = setup_share(path.sample(0.0), speeds)
    later = path.ahead(begun)
    assert later is None or abs(setup_share(later, speeds) / expected - 1.0) > 1e-3
    np.testing.assert_allclose(shares, expected, rtol=1e-4)
    assert expected < 1.0


@pytest.mark.parametrize("command", [Operator.START, Operator.PARK, Operator.HOLD])
@pytest.mark.parametrize("name", ["x", "leg4"])
def test_a_jog_brakes_from_the_order_on_that_ends_it_and_goes_on_through_a_hold(command, name):
    held = Held(Box(1.0))
    _, samples = held.run(600, jog(name), every=1)
    held.say(jog(name), Order(command))
    _, more = held.run(20)
    v = speed([*samples[-1:], *more])[:, 0]
    if command is Operator.HOLD:
        np.testing.assert_allclose(v, v[0], rtol=1e-3)
    else:
        assert (np.diff(v[1:]) < 0.0).all()
        assert v[-1] < 0.999 * v[0]
