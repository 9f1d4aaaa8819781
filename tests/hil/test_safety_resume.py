"""A force that comes back at once is limited in size, too."""

import numpy as np
import pytest

from drivers.signals import Mode, Warn
from tests.hil.test_safety import Bench

BACK = np.array([250.0, -250.0, 99.0, -99.0, 130.0, 0.0])
WITHIN = np.array([100.0, -100.0, 99.0, -99.0, 100.0, 0.0])


@pytest.mark.parametrize("mode", [Mode.HELD, Mode.PARKING])
def test_a_holding_force_beyond_the_limit_comes_back_as_the_limit_in_its_first_tick(mode: Mode) -> None:
    bench = Bench()
    bench.tick(mode, 0.0)
    bench.safety.resume(BACK)
    for _ in range(3):
        verdict = bench.tick(mode, BACK)
        np.testing.assert_array_equal(verdict.tau, WITHIN)
        assert verdict.warnings & Warn.FORCE_LIMIT
        assert not verdict.warnings & Warn.FORCE_STEP


def test_from_a_force_that_came_back_the_next_steps_are_counted() -> None:
    bench = Bench()
    bench.safety.resume(BACK)
    verdict = bench.tick(Mode.HELD, 0.0)
    np.testing.assert_array_equal(verdict.tau, [50.0, -50.0, 49.0, -49.0, 50.0, 0.0])
    assert verdict.warnings & Warn.FORCE_STEP


def test_a_force_comes_back_at_once_where_the_window_of_forces_is_a_single_tick_too() -> None:
    bench = Bench(rate_Hz=1.0)
    bench.safety.resume(WITHIN)
    verdict = bench.tick(Mode.HELD, WITHIN)
    np.testing.assert_array_equal(verdict.tau, WITHIN)
    assert verdict.warnings == Warn.NONE
