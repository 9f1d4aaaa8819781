"""The motions that excite a loop lie in the band that their loop can sample, at any rate."""

import numpy as np
import pytest

from hil.app.configuration.configuration import load
from hil.app.identify.delay import exact_model, excitation_pose, excited
from hil.identify.excitation import CARRIER_Hz, delay_excitation


@pytest.mark.parametrize("rate_Hz", [25.0, 50.0, 90.0, 100.0, 149.0, 150.0, 250.0, 1000.0, 2000.0])
def test_the_lines_that_find_a_delay_end_at_three_tenths_of_any_rate(rate_Hz: float) -> None:
    c = load("virtual")
    reference = delay_excitation(exact_model(c), excitation_pose(c), rate_Hz, 100.0, 20.0)
    lines = np.unique([s.frequency_Hz for s in reference.components if s.frequency_Hz != CARRIER_Hz])
    assert lines.max() <= 0.3 * rate_Hz * (1.0 + 1e-9)
    assert len(lines) == 36, "six of each axis, and none of two"


def test_a_slow_loop_is_excited_with_its_own_limits() -> None:
    made = excited(load("vcan50"), None, 4.0)
    assert made.configuration.loop.rate_Hz == 50.0
    assert made.force_N > 0.0
