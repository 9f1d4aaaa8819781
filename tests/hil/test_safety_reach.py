"""The limits on forces work on the six of the legs, and on nothing that lies behind them."""

import numpy as np
import pytest

from hil.safety import force_limits

WORK = {
    "limit_force": lambda tau: force_limits.limit_force(tau, 1.0),
    "limit_step": lambda tau: force_limits.limit_step(tau, np.zeros(60)[:6], 1.0),
    "limit_window": lambda tau: force_limits.limit_window(tau, np.zeros(60)[:6], np.zeros(60)[:6], 1.0),
}


@pytest.mark.parametrize("name", WORK)
@pytest.mark.parametrize("asked", [5.0, -5.0, 0.5])
def test_a_limit_brings_six_forces_within_it_and_leaves_what_is_behind_them(name, asked):
    behind = np.array([9.0, -9.0] * 27)
    forces = np.concatenate([np.full(6, asked), behind])
    assert WORK[name](forces[:6]) == (abs(asked) > 1.0)
    np.testing.assert_array_equal(forces[:6], np.clip(asked, -1.0, 1.0))
    np.testing.assert_array_equal(forces[6:], behind)
