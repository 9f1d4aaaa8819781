"""The drives' part of the block that `hil identify payload` prints: what the configuration takes, leg by leg."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from hil.app.identify.payload_block import _drives
from hil.config.model import ModelSettings
from hil.identify.leg_equations import COLUMNS, COULOMB, REFLECTED, VISCOUS


def found(viscous, coulomb, reflected, std=1.0, unknown=0.0):
    theta = np.zeros(COLUMNS)
    for at, values in ((VISCOUS, viscous), (COULOMB, coulomb), (REFLECTED, reflected)):
        theta[at : at + 6] = values
    shown = np.full(COLUMNS, unknown)
    made: Any = SimpleNamespace(
        theta=theta, reflected_kg=None, estimate=SimpleNamespace(std=np.full(COLUMNS, std), unknown=shown)
    )
    return made


def test_no_drive_gets_a_negative_friction_or_mass_whatever_its_leg_shows():
    """Masses are zero together or none is: a leg with slightly less than none gets zero, the others what they show."""
    keys = _drives(found([200, -30, 1, 0, -1, 2.5], [-60, 50, -1, 3, 0, 1.9], [9.9, -0.5, 12, 1, -3, 7]))
    assert keys == {
        "viscous_friction_N_s_m": [200, 0, 0, 0, 0, 2.5],
        "coulomb_friction_N": [0, 50, 0, 3, 0, 0],
        "reflected_mass_kg": [9.9, 0, 12, 1, 0, 7],
    }
    assert ModelSettings(**keys).reflected_mass_kg == keys["reflected_mass_kg"], "the configuration takes it"


def test_masses_within_their_errors_are_none_in_all_legs():
    keys = _drives(found([1] * 6, [1] * 6, [1.5, -1.9, 1, 0, -1, 2]))
    assert keys["reflected_mass_kg"] == [0] * 6
