"""Legs that are pushed to see whether they move: each with its own force and duration."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.loop.probe import beyond, fill_probe
from tests.hil.encoder_bench import BOTH_SIGNS, six

FORCES_N = np.array([300.0, 150.0, 420.0, 80.0, 260.0, 510.0])
"""Largest friction force of each leg."""


def probed(limits, pushes, legs=range(6), force_N=0.0):
    """Forces (n, 6) in these ticks of a push, and for each tick True if it begins a push."""
    memory, tick = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(force_N))
    found, begun = [], []
    for push in pushes:
        memory.push[[*legs]] = push
        begun.append(fill_probe(tick, tick, limits, memory))
        found.append(np.array(tick.probe_force))
    return np.array(found), begun


@BOTH_SIGNS
@pytest.mark.parametrize("legs", [[0], [5], [1, 4]], ids=str)
@pytest.mark.parametrize("sticks", [0, 1])
def test_probe_push_acts_on_the_suspected_legs_only_each_with_its_own_force(sign, legs, sticks):
    """The full force acts in the first tick, or, with a rise over eight ticks, in the fourth."""
    limits = SimpleNamespace(push_ticks=8, push_N=FORCES_N, sticks=sticks, rise_ticks=1)
    found, begun = probed(limits, [sign * k for k in range(1, 5)], legs)
    whole = np.where(np.isin(np.arange(6), legs), sign * FORCES_N, 0.0)
    np.testing.assert_allclose(
        found[0 if sticks else 3 :], np.tile(whole, (4 if sticks else 1, 1)), rtol=1e-12
    )
    assert begun == [True, False, False, False]


@BOTH_SIGNS
@pytest.mark.parametrize("leg", [0, 5])
@pytest.mark.parametrize("rise", [1, 4])
def test_sticking_leg_is_pushed_in_one_direction_with_equal_rise_and_fall(sign, leg, rise):
    limits = SimpleNamespace(push_ticks=20, push_N=FORCES_N, sticks=1, rise_ticks=rise)
    found, _ = probed(limits, [sign * k for k in [*range(1, 21), *[0] * rise]], [leg])
    assert not np.delete(found, leg, axis=1).any()
    whole, forces = FORCES_N[leg], sign * found[:, leg]
    np.testing.assert_allclose(np.diff(forces[:rise]), whole / rise)
    np.testing.assert_allclose(forces[rise - 1 : 20], whole)
    np.testing.assert_allclose(np.diff(forces[19:]), -whole / rise)
    assert forces[-1] == pytest.approx(0.0, abs=1e-9)


@BOTH_SIGNS
@pytest.mark.parametrize(
    ("last", "ticks", "now"),
    [(6, 0, 4), (2.5, 0, 0.5), (2, 0, 0), (0, 3, 2), (4, 3, 5), (6, 3, 5), (1, -3, -1)],
)
def test_probe_push_begins_reverses_and_ends_within_the_allowed_force_slope(sign, last, ticks, now):
    """5 N over 5 ticks: 2 N per tick; the push is complete in the third."""
    limits = SimpleNamespace(push_ticks=5, push_N=six(5.0), sticks=0, rise_ticks=1)
    found, _ = probed(limits, [sign * ticks], force_N=sign * float(last))
    np.testing.assert_allclose(found, [six(sign * now)])


@pytest.mark.parametrize(
    ("load", "friction", "along", "against", "low", "high"),
    [
        (10.0, 0.0, 1.0, 1.0, 10.0, 10.0),
        (10.0, 5.0, 1.0, 1.0, 5.0, 15.0),
        (-10.0, 5.0, 1.0, 1.0, -15.0, -5.0),
        (0.0, 5.0, 1.0, 1.0, -5.0, 5.0),
        (10.0, 5.0, 0.9, 0.8, 5.0 * 0.8, 15.0 / 0.9),  # the load pulls the motor back; the motor lifts it
        (-10.0, 5.0, 0.9, 0.8, -15.0 / 0.9, -5.0 * 0.8),
        (2.0, 5.0, 0.9, 0.8, -3.0 / 0.9, 7.0 / 0.9),  # driven either way
    ],
)
def test_friction_and_gear_losses_hold_a_leg_within_a_range_about_the_load(
    load, friction, along, against, low, high
):
    assert beyond(low - 1.0, load, friction, along, against) == pytest.approx(-1.0)
    assert beyond(low + 1e-9, load, friction, along, against) == pytest.approx(0.0, abs=2e-9)
    assert beyond(high - 1e-9, load, friction, along, against) == pytest.approx(0.0, abs=2e-9)
    assert beyond(high + 1.0, load, friction, along, against) == pytest.approx(1.0)
