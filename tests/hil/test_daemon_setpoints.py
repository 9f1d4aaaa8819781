"""What the daemon does with the outcome of set-points: senders get their answers, the log its event."""

from types import SimpleNamespace

import numpy as np

from drivers.signals import Refusal
from hil.loop.daemon import _answer
from hil.loop.steering import Steering
from hil.signals import SetPoint
from hil.trajectory.live import LiveTrajectory

START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


class Heard:
    """Stands for the channel and the recorder."""

    def __init__(self):
        self.answers, self.events = [], []

    def answer(self, answers):
        self.answers.append(list(answers))

    def event(self, t_ns, level, text):
        self.events.append((t_ns, level, text))


def test_senders_are_answered_once_and_refusals_stand_in_the_log():
    limits = np.array([[0.3] * 6, [1.0] * 6, [10.0] * 6])
    steering = Steering(
        LiveTrajectory(START, limits, 1e-3), lambda chi: Refusal.STROKE if chi[0] > 0.2 else 0
    )
    cycle = SimpleNamespace(parts=SimpleNamespace(steering=steering))
    heard = Heard()
    here, there = SetPoint(0.1, 0, 1, 0, 0, 0), SetPoint(0.5, 0, 1, 0, 0, 0)
    for tick, setpoints in enumerate([(here,), (), (there, here), ()], start=1):
        steering.step(setpoints, tick, tracking=True)
        _answer(heard, cycle, heard, tick * 1_000_000)  # type: ignore[arg-type]
    assert heard.answers == [[0], [Refusal.STROKE, 0]]
    text = "set-point refused: a leg would be outside the soft ends of its stroke"
    assert heard.events == [(3_000_000, "warning", text)]
