"""Legs that are pushed to see whether they move: each by its own force, and for its own turn."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.loop.probe import beyond, fill_probe
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
@pytest.mark.parametrize("rise", [1, 2, 4])
def test_a_leg_that_sticks_is_pushed_one_way_and_let_go_as_steeply(sign, leg, rise):
    limits = SimpleNamespace(push_ticks=20, push_N=FORCES_N, sticks=1, rise_ticks=rise)
    memory, tick, pushes = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(0.0)), []
    for k in [*range(1, 21), *[0] * rise]:
        memory.push[leg] = sign * k
        fill_probe(tick, tick, limits, memory)
        pushes.append(sign * tick.probe_force)
    whole, there = FORCES_N[leg], np.arange(6) == leg
    found = np.array(pushes)
    np.testing.assert_allclose(found[:, ~there], 0.0)
    np.testing.assert_allclose(np.diff(found[:rise, leg]), whole / rise)
    np.testing.assert_allclose(found[rise - 1 : 20, leg], whole)
    np.testing.assert_allclose(np.diff(found[19:, leg]), -whole / rise)
    assert found[-1, leg] == pytest.approx(0.0, abs=1e-9)


def test_the_tick_in_which_a_push_begins_is_reported():
    limits = SimpleNamespace(push_ticks=5, push_N=six(5.0), sticks=1, rise_ticks=1)
    memory, tick = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(0.0))
    found = []
    for push in (0, 1, 2, 0, -1):
        memory.push[3] = push
        found.append(fill_probe(tick, tick, limits, memory))
    assert found == [False, True, False, False, True]


@pytest.mark.parametrize(
    ("force", "load", "friction", "excess"),
    [
        (10.0, 10.0, 0.0, 0.0),
        (14.9, 10.0, 5.0, 0.0),
        (5.1, 10.0, 5.0, 0.0),
        (16.0, 10.0, 5.0, 1.0),
        (4.0, 10.0, 5.0, -1.0),
        (-16.0, -10.0, 5.0, -1.0),
        (-4.0, -10.0, 5.0, 1.0),
        (6.0, 0.0, 5.0, 1.0),
        (-6.0, 0.0, 5.0, -1.0),
    ],
)
def test_friction_holds_a_leg_within_its_own_size_of_the_load(force, load, friction, excess):
    assert beyond(force, load, friction, 1.0, 1.0) == pytest.approx(excess)


@pytest.mark.parametrize(
    ("load", "friction", "low", "high"),
    [
        (10.0, 5.0, 5.0 * 0.8, 15.0 / 0.9),  # the load pulls the motor back; the motor lifts it
        (-10.0, 5.0, -15.0 / 0.9, -5.0 * 0.8),
        (2.0, 5.0, -3.0 / 0.9, 7.0 / 0.9),  # driven either way
    ],
)
def test_losses_of_the_gear_hold_a_leg_as_well(load, friction, low, high):
    assert beyond(low - 1.0, load, friction, 0.9, 0.8) == pytest.approx(-1.0)
    assert beyond(low + 1e-9, load, friction, 0.9, 0.8) == 0.0
    assert beyond(high - 1e-9, load, friction, 0.9, 0.8) == 0.0
    assert beyond(high + 1.0, load, friction, 0.9, 0.8) == pytest.approx(1.0)


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
