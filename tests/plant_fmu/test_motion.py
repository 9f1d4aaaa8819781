"""When what drives are told moves their legs: from the instant of each command on, whatever came before it."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Command, DriveMode
from tests.drivers.legs_frames import command_frames
from tests.plant_fmu.test_nodes import MASS, MS, Rig


@pytest.mark.parametrize("late_us", [0, 100, 700])
def test_a_command_acts_from_its_own_instant_on_and_not_from_that_of_its_sync(late_us):
    rig = Rig()
    rig.run()
    rig.tick += 1
    command = Command(DriveMode.RUN, np.arange(1.0, 7.0) * MASS)
    rig.at(1 * MS, *rig.protocol.begin(None, rig.tick))
    rig.at(1 * MS + 1000 * late_us, *command_frames(rig.protocol, command, rig.tick))
    rig.at(3 * MS)
    moved_s = 2e-3 - 1e-6 * late_us
    np.testing.assert_allclose(rig.nodes.snapshot().rate, np.arange(1.0, 7.0) * moved_s, rtol=1e-9)
