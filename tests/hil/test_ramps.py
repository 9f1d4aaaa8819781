"""How force comes and goes: the step's shape, its share of the holding force, and what a law asks for at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from drivers.tick_columns import Record, copy_of
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.contracts.records import record_of
from hil.loop.ramps import holding_share, smoothstep, tau_at_rest
from hil.robot.kinematics import leg_lengths
from hil.trajectory.path import PoseSample

PLATFORM = build_platform(load("virtual").platform)
QUARTER = 0.103515625
"""10/4^3 - 15/4^4 + 6/4^5."""


@pytest.mark.parametrize(
    ("x", "y"),
    [(-2.0, 0.0), (0.0, 0.0), (0.25, QUARTER), (0.5, 0.5), (0.75, 1.0 - QUARTER), (1.0, 1.0), (3.0, 1.0)],
)
def test_the_step_rises_from_0_to_1_and_stays_there(x, y):
    assert smoothstep(x) == y


@pytest.mark.parametrize(
    ("mode", "elapsed_s", "share"),
    [
        (Mode.LOADING, 0.0, 0.0),
        (Mode.LOADING, 0.2, 0.0),
        (Mode.LOADING, 0.25, QUARTER),
        (Mode.LOADING, 0.4, 1.0),
        (Mode.UNLOADING, 0.0, 1.0),
        (Mode.UNLOADING, 0.05, 1.0 - QUARTER),
        (Mode.UNLOADING, 0.15, QUARTER),
        (Mode.UNLOADING, 0.2, 0.0),
    ],
)
def test_the_holding_force_comes_behind_a_brake_test_as_long_as_its_ramp_and_goes_at_once(
    mode, elapsed_s, share
):
    assert holding_share(mode, elapsed_s, 0.2) == pytest.approx(share, abs=1e-12)


class Law:
    """State: what it was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def reset(self) -> None:
        self.told.append("anew")

    def effort(self, tick: Record) -> None:
        self.told.append(copy_of(tick))
        tick["tau_law"] = np.arange(6.0)


@pytest.mark.parametrize("on_it", [False, True])
def test_at_rest_the_law_is_asked_afresh_without_load_at_the_sample_or_where_the_platform_was_measured(on_it):
    law: Any = Law()
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    there = PoseSample(np.array([0.01, 0.02, 1.0]), np.eye(3), np.zeros(6), np.zeros(6))
    measured: dict[str, Any] = {"q": 1.5, "p": [0.1, 0.2, 0.9], "R": turned, "dq": 0.3, "twist": 0.4}
    tick = record_of(wrench=7.0, tau_law=99.0, **measured)
    before = tick.tobytes()
    np.testing.assert_array_equal(tau_at_rest(law, PLATFORM, tick, there, on_it=on_it), np.arange(6.0))
    assert tick.tobytes() == before, "the tick stays as it is"
    first, seen, last = law.told
    assert (first, last) == ("anew", "anew")
    assert not seen["wrench"].any()
    length = leg_lengths(PLATFORM, there.p, there.R)
    np.testing.assert_allclose(seen["q_d"], length, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(seen["p_d"], there.p)
    if on_it:
        measured = {"p": there.p, "R": there.R, "q": seen["q_d"], "dq": 0.0, "twist": 0.0}
    for name, value in measured.items():
        np.testing.assert_array_equal(seen[name], np.broadcast_to(value, seen[name].shape))
