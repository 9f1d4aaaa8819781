"""Text on what a controller waits for, the legs that move, and the drives without commands."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.protocol import DriveSetup
from drivers.signals import Mode, Reaction
from hil.contracts.records import record_of
from hil.loop.report import KEPT, moving_text, not_confirmed, off_not_sent, waiting_text
from hil.safety.motion import REST_m_s
from tests.hil.cycle_bench import Bench


class Late(Bench):
    """Bench on which some legs answer each SYNC a tick late, as on a bus too slow for its rate."""

    def step_late(self, *legs: int) -> str:
        """Step once, and give the text on what is missing."""
        drives, tick = self.drives, self.tick + 1
        answers = drives.feedback(tick)
        booting = len(answers) - 6
        old = drives.feedback(tick - 1) if tick else ()
        own = [answer for leg, answer in enumerate(answers[booting:]) if leg not in legs]
        self.step(frames=(*answers[:booting], *(old[leg] for leg in legs if old), *own))
        return waiting_text(self.cycle)


def test_drives_that_report_late_are_listed_until_all_six_legs_report_in_one_tick():
    bench = Late()
    for _ in range(7):
        bench.step_late(1)
    for _ in range(493):
        text = bench.step_late(1, 4)
    mode = bench.cycle.mode
    assert mode is Mode.WAITING
    assert bench.cycle.tick["age"].tolist() == [0, 1, 0, 0, 1, 0]
    assert "platform.home" not in text
    assert "drive 1, drive 4" in text
    assert "loop.rate_Hz" in text
    bench.step_late()
    assert bench.cycle.sight.located
    assert bench.cycle.mode is Mode.IDLE


def test_leg_lengths_that_fit_no_pose_are_reported_with_platform_home():
    bench = Late()
    bench.drives.length = bench.drives.length + 0.6 * (-1.0) ** bench.drives.length.argsort()
    for _ in range(500):
        text = bench.step_late()
    assert bench.cycle.mode is Mode.WAITING
    assert "no pose near platform.home" in text


@pytest.mark.parametrize("leg", [0, 5])
def test_a_drive_is_reported_silent_from_the_second_missing_tick_on(leg):
    bench = Late()
    for _ in range(60):
        bench.step()
    bench.drives.silent = {leg}
    bench.step()
    assert "silent" not in waiting_text(bench.cycle)
    bench.step()
    assert f"drive {leg} is silent" in waiting_text(bench.cycle)


@pytest.mark.parametrize("leg", [0, 5])
def test_only_a_fresh_rate_counts_as_motion_of_a_leg(leg):
    rate = np.where(np.arange(6) == leg, -REST_m_s, 0.9 * REST_m_s)
    cycle: Any = SimpleNamespace(tick=record_of(age=0, rate=rate))
    assert moving_text(cycle) == f"leg {leg} at -0.020 m/s"
    cycle.tick["age"][leg] = 1
    assert moving_text(cycle) == ""


@pytest.mark.parametrize("says", [off_not_sent, not_confirmed])
def test_the_watchdog_is_mentioned_only_if_the_drives_have_one(says: Any) -> None:
    setup = DriveSetup(0.0125, Reaction.BRAKE, 1000.0)
    with_one, without = (
        says(
            SimpleNamespace(protocol=SimpleNamespace(traits=SimpleNamespace(has_watchdog=has)), setup=setup),
            "brake",
        )
        for has in (True, False)
    )
    assert "12.5 ms" in with_one
    assert "`brake`" in with_one
    assert KEPT not in with_one
    assert KEPT in without
    assert "12.5 ms" not in without
