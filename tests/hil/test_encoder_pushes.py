"""Legs that are pushed to see whether they move: each by its own force, and for its own turn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.loop.probe import fill_probe
from tests.hil.encoder_bench import BOTH_SIGNS, six

FORCES_N = np.array([300.0, 150.0, 420.0, 80.0, 260.0, 510.0])
"""What friction may hold of each leg."""


@BOTH_SIGNS
@pytest.mark.parametrize("legs", [[0], [3], [5], [1, 4], [*range(6)]], ids=str)
@pytest.mark.parametrize("sticks", [0, 1])
def test_a_leg_is_pushed_by_what_its_own_friction_may_hold_and_no_other_is(sign, legs, sticks):
    """Where it comes at once, in its first tick; where it rises over eight ticks, in the fourth."""
    pushed = np.isin(np.arange(6), legs)
    limits = SimpleNamespace(push_ticks=8, push_N=FORCES_N, sticks=sticks, rise_ticks=1)
    memory, tick = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(0.0))
    for k in range(1, 5):
        memory.push[pushed] = sign * k
        fill_probe(tick, tick, limits, memory)
        if sticks:
            np.testing.assert_allclose(tick.probe_force, np.where(pushed, sign * FORCES_N, 0.0), rtol=1e-12)
    np.testing.assert_allclose(tick.probe_force, np.where(pushed, sign * FORCES_N, 0.0), rtol=1e-12)


@BOTH_SIGNS
@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize(("rise", "turns"), [(1, 1), (2, 3), (4, 7)])
def test_a_leg_that_sticks_turns_round_as_steeply_as_its_own_push_rises(sign, leg, rise, turns):
    """From the whole force to the other one in 2 x rise - 1 ticks, whatever the other legs are pushed by."""
    ticks = 20
    limits = SimpleNamespace(push_ticks=ticks, push_N=FORCES_N, sticks=1, rise_ticks=rise)
    memory, tick, pushes = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(0.0)), []
    for k in range(1, 2 * ticks + 1):
        memory.push[leg] = sign * k
        fill_probe(tick, tick, limits, memory)
        pushes.append(sign * tick.probe_force)
    whole, there = FORCES_N[leg], np.arange(6) == leg
    found = np.array(pushes)
    np.testing.assert_allclose(found[:, ~there], 0.0)
    np.testing.assert_allclose(found[rise - 1 : ticks, leg], whole)
    np.testing.assert_allclose(np.diff(found[ticks - 1 : ticks + turns, leg]), -2.0 * whole / turns)
    np.testing.assert_allclose(found[ticks + turns - 1 :, leg], -whole)


@BOTH_SIGNS
@pytest.mark.parametrize(
    ("last", "ticks", "now"),
    [(6, 0, 4), (2.5, 0, 0.5), (2, 0, 0), (0, 3, 2), (4, 3, 5), (6, 3, 5), (1, -3, -1)],
)
def test_a_push_begins_turns_and_ends_by_no_more_than_allowed(sign, last, ticks, now):
    """5 N over 5 ticks: 2 N a tick; in the third one the push is whole."""
    limits = SimpleNamespace(push_ticks=5, push_N=six(5.0), sticks=0, rise_ticks=1)
    memory, tick = SimpleNamespace(push=six(sign * ticks)), SimpleNamespace(probe_force=six(0.0))
    before = SimpleNamespace(probe_force=six(sign * float(last)))
    fill_probe(tick, before, limits, memory)
    np.testing.assert_allclose(tick.probe_force, sign * now)
