"""Tracking error from delay, against loops integrated in small steps."""

from math import ceil, exp, pi
from typing import Any

import numpy as np
import pytest

from hil.design.stability.delay_effect import delay_effect, stale_s
from hil.design.stability.sampled_loop import Axis, analyse, gains
from hil.trajectory.path import PoseSample

AXIS = Axis(period_s=2e-3, transport_s=1.3e-3, lag_s=0.8e-3)
K_P, K_D = 900.0, 60.0
FINE_s = 2e-5


class Instants:
    """A reference with the time as its x, and a robot whose forces depend on it only: J M^-1 J^T = 1."""

    def __init__(self, force):
        self.force = force

    def sample(self, t):
        return PoseSample(np.full(3, t), np.eye(3), np.zeros(6), np.zeros(6))

    def along_reference(self, s):
        times = s.p[:, 0]
        forces = np.array([self.force(t) for t in times])
        return forces[:, None] * np.ones(6), np.broadcast_to(np.eye(6), (len(times), 6, 6))


def cost(force, *stretches, axis=AXIS):
    robot: Any = Instants(force)
    loops = [analyse(axis, gains(K_P, K_D, axis.period_s))] * 6
    return delay_effect(robot, robot, stretches, axis, loops, 0.0), robot


def integrated(force, end_s, phase_s=0.0):
    """Largest |e| and |de| of e'' = -a - (tau_a - tau), where a and tau_a are sampled, held and delayed."""
    T, transport, lag, _ = AXIS
    keep = exp(-FINE_s / lag)
    e = de = 0.0
    acts = asked = force(-1.0)  # of what is commanded: the lag's state, and its target
    queue: list[tuple[float, float]] = []
    worst = np.zeros(2)
    due = phase_s - T
    for n in range(ceil(end_s / FINE_s)):
        t = n * FINE_s - T
        if t >= due - 1e-12:
            queue.append((due + transport, K_P * e + K_D * de + force(due)))
            worst = np.maximum(worst, np.abs([e, de]))
            due += T
        while queue and queue[0][0] <= t + 1e-12:
            asked = queue.pop(0)[1]
        acts = asked + (acts - asked) * keep
        de += FINE_s * (force(t) - acts)
        e += FINE_s * de
    return worst


def step(t):
    return 5.0 if t >= 0.2503 else 0.0


def wave(hertz):
    def force(t):
        return 8.0 * np.sin(2.0 * pi * hertz * max(t, 0.0))

    return force


@pytest.mark.parametrize(
    "force", [step, wave(1.0), wave(5.0), wave(20.0)], ids=["jump", "1 Hz", "5 Hz", "20 Hz"]
)
def test_tracking_error_from_delay_matches_integration_in_small_steps(force):
    found, _ = cost(force, (0.0, 0.7))
    worst = np.max(
        [integrated(force, 1.0, phase * AXIS.period_s) for phase in (0.0, 0.25, 0.5, 0.75)], axis=0
    )
    assert found.error == pytest.approx(worst[0], rel=0.02)
    assert found.rate == pytest.approx(worst[1], rel=0.02)


def test_tracking_error_from_delay_after_a_force_jump_continues_across_blocks():
    """The same jump 9.744 s later, 6 ms before the end of the first 10 s block, at the same phase."""
    early, _ = cost(step, (0.0, 1.0))
    late_in_the_block, _ = cost(lambda t: step(t - 9.744), (0.0, 10.5))
    assert late_in_the_block.error == pytest.approx(early.error, rel=1e-3)
    assert late_in_the_block.rate == pytest.approx(early.rate, rel=1e-3)


@pytest.mark.parametrize(
    ("ahead_ms", "stale_ms"), [(0.0, 4.1), (1.3, 2.8), (2.0, 2.1), (2.8, 1.5), (4.1, 2.8), (10.0, 8.7)]
)
def test_age_of_a_predicted_force_is_its_largest_time_error_while_it_acts(ahead_ms, stale_ms):
    """Forces act from 1.3 ms after the measurement for 2 ms, with 0.8 ms of lag; too much prediction is as bad as none."""
    assert stale_s(AXIS, 1e-3 * ahead_ms) == pytest.approx(1e-3 * stale_ms)
