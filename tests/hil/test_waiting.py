"""What a controller waits for is what is lacking: late answers are not called a pose that does not fit.

And legs that move are those that are heard to.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.contracts.records import record_of
from hil.loop.report import moving_text, waiting_text
from hil.safety.motion import REST_m_s
from tests.hil.cycle_bench import Bench


class Late(Bench):
    """A bench on which some legs answer each SYNC a tick late, as on a bus that is too slow for its rate."""

    def step_late(self, *legs: int) -> str:
        """Do a tick, and return what is lacking."""
        drives, tick = self.drives, self.tick + 1
        answers = drives.feedback(tick)
        booting = len(answers) - 6
        old = drives.feedback(tick - 1) if tick else ()
        own = [answer for leg, answer in enumerate(answers[booting:]) if leg not in legs]
        self.step(frames=(*answers[:booting], *(old[leg] for leg in legs if old), *own))
        return waiting_text(self.cycle).removeprefix("the drives are not ready: ")


def test_drives_that_answer_late_are_named_since_when_and_not_laid_to_the_home():
    bench = Late()
    for _ in range(7):
        bench.step_late(1)
    bench.step_late(1, 4)
    for _ in range(493):
        text = bench.step_late(1, 4)
    assert bench.cycle.mode is Mode.WAITING
    assert bench.cycle.tick["age"].tolist() == [0, 1, 0, 0, 1, 0]
    assert "platform.home" not in text
    assert "drive 1 in none yet, drive 4 0.494 s ago the last time;" in text
    assert "loop.rate_Hz" in text


def test_lengths_of_one_tick_that_fit_no_pose_are_laid_to_the_home():
    bench = Late()
    bench.drives.length = bench.drives.length + 0.6 * (-1.0) ** bench.drives.length.argsort()
    for _ in range(500):
        text = bench.step_late()
    assert bench.cycle.mode is Mode.WAITING
    assert "no pose near platform.home" in text


@pytest.mark.parametrize("phase", [0, 7])
def test_one_tick_with_all_six_legs_is_enough_whenever_it_comes(phase):
    bench = Late()
    for _ in range(200 + phase):
        bench.step_late(3)
    modes = [bench.cycle.mode]
    bench.step_late()
    assert bench.cycle.sight.located
    assert [*modes, bench.cycle.mode] == [Mode.WAITING, Mode.IDLE]


def test_what_was_lacking_until_the_end_of_a_short_run_is_no_pose():
    bench = Late()
    for _ in range(30):
        text = bench.step_late()
    assert bench.cycle.sight.located
    assert text == "nothing is lacking by now, but it was until after the end; give the run more time"


@pytest.mark.parametrize("leg", [0, 3, 5])
def test_a_drive_that_was_heard_and_is_not_any_more_is_silent_from_the_second_tick_on(leg):
    bench = Late()
    for _ in range(60):
        bench.step()
    bench.drives.silent = {leg}
    bench.step()
    assert "silent" not in waiting_text(bench.cycle)
    bench.step()
    assert waiting_text(bench.cycle) == f"the drives are not ready: drive {leg} is silent"


@pytest.mark.parametrize("leg", range(6))
def test_a_leg_is_said_to_move_by_a_rate_of_this_tick_alone(leg):
    rate = np.where(np.arange(6) == leg, -REST_m_s, 0.9 * REST_m_s)
    cycle: Any = SimpleNamespace(tick=record_of(age=0, rate=rate))
    assert moving_text(cycle) == f"leg {leg} at -0.020 m/s"
    cycle.tick["age"][leg] = 1
    assert moving_text(cycle) == ""
