"""Mean forces of the estimator, against the force path of the loop."""

import numpy as np
import pytest

from hil.lab.identify.estimators.force_delay import mean_forces
from hil.robot.force_path import ForcePath

T = 1e-3
COMMANDS = np.random.default_rng(5).normal(0.0, 500.0, (50, 6))


@pytest.mark.parametrize("lag", [0.0, 0.2e-3, 0.8e-3, 4e-3])
@pytest.mark.parametrize("transport", [0.0, 0.5e-3, 1e-3, 2.3e-3])
def test_mean_forces_agree_with_the_force_path_of_the_loop(transport, lag):
    path = ForcePath(T, transport, lag)
    for _ in range(200):
        path.send(COMMANDS[0])
        path.advance()
    expected = []
    for command in COMMANDS[:-1]:
        path.send(command)
        expected.append(path.advance())
    found = mean_forces(COMMANDS, T, transport, lag)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
