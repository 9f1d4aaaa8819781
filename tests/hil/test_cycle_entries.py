"""What the entry of a mode sets up: speed, the force that holds, and where the reference stays from then on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.compose import build_cycle
from hil.contracts.records import record_of
from hil.loop.admission import NO_SETPOINTS
from hil.signals import Operator
from tests.hil.test_cycle import Bench, held_to
from tests.hil.test_cycle_again import VIRTUAL, a_bench


def stopped(mode: Mode) -> Bench:
    """A bench that has been stopped in its approach, in a mode of the way to closed brakes."""
    bench = a_bench()
    bench.until(Mode.APPROACH)
    bench.step((Operator.STOP,))
    while bench.cycle.mode is not mode:
        bench.step()
        assert bench.tick < 2000
    return bench


@pytest.mark.parametrize(("before", "mode"), [(Mode.RELEASING, Mode.APPROACH), (Mode.LOADING, Mode.TRACKING)])
@pytest.mark.parametrize("speed", [0.4, 1.0])
def test_a_motion_begins_at_the_speed_that_is_asked_for_and_parks_no_more(before, mode, speed):
    cycle = build_cycle(VIRTUAL, 1000.0, 0.01)
    operating, parts = cycle.operating, cycle.parts
    operating.speed, operating.parks, operating.go = speed, True, False
    cycle.mode = before
    cycle._enter(mode, record_of(tick=1000, p=parts.home_p, R=np.eye(3), J=np.eye(6)))
    assert cycle.motion.override.sigma == speed
    assert (operating.go, operating.parks) == (True, False)


@pytest.mark.parametrize("more", [0.9, 1.1])
def test_a_platform_whose_brake_has_failed_its_test_is_held_by_the_force_that_held_it_and_not_by_the_law_alone(
    more,
):
    """A load has come meanwhile of which the law knows nothing."""
    bench = stopped(Mode.UNLOADING)
    effort = bench.cycle.effort
    effort.holding = more * effort.holding
    with held_to(bench, standstill_m=-1.0):
        bench.step()
    assert bench.cycle.mode is Mode.HELD
    for _ in range(5):
        bench.step()
        np.testing.assert_allclose(bench.cycle.tick["tau_asked"], more * 3618.625746, atol=1.0)
        np.testing.assert_allclose(bench.cycle.tick["tau"], more * 3618.625746, atol=1.0)


def test_the_reference_stays_with_a_platform_that_yields_until_the_brakes_are_shut():
    bench = stopped(Mode.PARKING)
    with held_to(bench, following_error_m=-1.0):
        bench.step()
    modes = []
    for _ in range(12):
        bench.drives.length = bench.drives.length + 2e-6
        bench.step()
        modes.append(bench.cycle.mode)
        tick = bench.cycle.tick
        if modes[-1] is Mode.PARKING:
            np.testing.assert_array_equal(tick["p_d"], tick["p"])
    assert modes[:3] == [Mode.PARKING] * 3
    assert modes[-2:] == [Mode.UNLOADING] * 2
    assert np.abs(tick["p_d"] - tick["p"]).max() > 1e-6, "there the legs have to stand"


def test_a_reset_of_the_cycle_resets_every_part_that_remembers():
    told: list[str] = []
    cycle = build_cycle(VIRTUAL, 1000.0, 0.01)
    names = ("law", "wrench", "predictor", "safety", "steering")
    stubs: dict[str, Any] = {
        name: SimpleNamespace(reset=lambda name=name: told.append(name)) for name in names
    }
    stubs["steering"].counts = NO_SETPOINTS
    cycle.parts = replace(cycle.parts, **stubs)
    cycle.reset()
    assert sorted(told) == sorted(names)
