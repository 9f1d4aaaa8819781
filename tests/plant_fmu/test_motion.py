"""When what drives are told moves their legs: from the instant of each command on, whatever came before it."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Command, DriveMode, DriveState, Reaction
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.test_nodes import MASS, MS, Rig


@pytest.mark.parametrize("late_us", [0, 100, 700])
def test_a_command_acts_from_its_own_instant_on_and_not_from_that_of_its_sync(late_us):
    rig = Rig()
    rig.run()
    rig.tick += 1
    command = Command(DriveMode.RUN, np.arange(1.0, 7.0) * MASS)
    rig.at(1 * MS, *opening(rig.protocol, rig.tick))
    rig.at(1 * MS + 1000 * late_us, *command_frames(rig.protocol, command, rig.tick))
    rig.at(3 * MS)
    moved_s = 2e-3 - 1e-6 * late_us
    np.testing.assert_allclose(rig.nodes.snapshot().rate, np.arange(1.0, 7.0) * moved_s, rtol=1e-9)


def test_drives_that_damp_go_by_their_rates_at_the_instant_at_which_the_others_are_told_something():
    """The first three hear nothing from 0 ms on and damp from 10 ms on; 20000 N s/m."""
    rig = Rig("classic", reaction=Reaction.DAMP)
    rig.run(10.0 * MASS)
    for t_ms in (5, 10, 15):
        rig.tick += 1
        command = Command(DriveMode.RUN, np.full(6, 10.0 * MASS))
        frames = command_frames(rig.protocol, command, rig.tick)
        rig.at(t_ms * MS, *opening(rig.protocol, rig.tick), frames[1])
    found = rig.nodes.snapshot()
    assert found.state.tolist() == [DriveState.FAULT] * 3 + [DriveState.RUN] * 3
    assert (found.rate > 0.01).all()
    np.testing.assert_allclose(found.force[:3], -20_000.0 * found.rate[:3], rtol=1e-12)
    np.testing.assert_allclose(found.force[3:], 10.0 * MASS, rtol=1e-3)
