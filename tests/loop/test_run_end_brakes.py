"""Parked on brakes that nobody has proven, a run watches the legs before it ends."""

from __future__ import annotations

import pytest

from drivers.signals import DriveState, Mode
from hil.loop.run_end import Course
from tests.loop.test_run_end import cycle, first_end, states


@pytest.mark.parametrize(
    ("proven", "state", "ticks"),
    [
        (True, DriveState.OFF, 7),
        (False, DriveState.OFF, 7 + 25),
        (True, DriveState.READY, 7 + 25),
        (False, DriveState.READY, 7 + 25),
    ],
)
@pytest.mark.parametrize("leg", [0, 3, 5])
def test_a_parked_run_ends_at_once_only_where_the_brakes_are_proven_and_all_drives_are_off(
    proven, state, ticks, leg
):
    drives = states()
    drives[leg] = state
    now = cycle(Mode.PARKED, mode_tick=7, drive_state=drives)
    now.proven = proven
    course = Course(now)
    ending = next((found for tick in range(7, 100) if (found := course.ending(tick))), None)
    assert ending is not None
    assert ending.ticks == ticks


def test_brakes_that_are_proven_while_the_legs_are_watched_end_the_run():
    now = cycle(Mode.PARKED, mode_tick=0)
    now.proven = False
    course = Course(now)
    assert first_end(course, 10) is None
    now.proven = True
    assert course.ending(10) is not None
