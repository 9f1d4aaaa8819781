"""Six gains are one for each leg: its force is that of a law which has its gain for all legs."""

from typing import Any

import numpy as np
import pytest

from hil.contracts.records import altered, arrived, asked
from hil.control import LAWS
from hil.trajectory.path import PoseSample
from tests.hil.control.legs import CONTEXT, HOME, PLATFORM

SIX = np.array([1.0, 1.7, 0.6, 2.3, 0.8, 1.2])
GAINS: dict[str, dict[str, float]] = {
    "pd": {"kp_N_m": 2e6, "kv_N_s_m": 5e4, "feedforward_mass_kg": 300.0},
    "pid": {
        "kp_N_m": 2e6,
        "kv_N_s_m": 5e4,
        "feedforward_mass_kg": 300.0,
        "ki_N_m_s": 1e7,
        "integral_limit_N": 60.0,
    },
    "pd_gravity": {"kp_N_m": 2e6, "kv_N_s_m": 5e4},
    "feedforward_pd": {"kp_N_m": 2e6, "kv_N_s_m": 5e4},
}
CASES = [(law, gain) for law, gains in GAINS.items() for gain in gains]
CHANCE = np.random.default_rng(5)
ERRORS = CHANCE.uniform(-1e-3, 1e-3, (10, 3, 6)) + np.array([2e-3, 0.0, 0.0])[:, None]
"""Of lengths and rates, and accelerations, tick by tick: the integral comes to its limit."""


def forces(law: str, gains: dict[str, Any], side: float):
    made = LAWS[law].model_validate({"law": law} | gains).build(CONTEXT)
    still = arrived(PLATFORM, PoseSample(*HOME, np.zeros(6), np.zeros(6)))
    found = []
    for e, de, ddq_d in side * ERRORS:
        tick = altered(still, q=still["q"] - e, dq=still["dq"] - 10.0 * de, ddq_d=1e3 * ddq_d)
        found.append(asked(made, tick))
    return np.array(found)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("law", "gain"), CASES)
def test_each_leg_has_its_own_gain(law, gain, side):
    gains = GAINS[law]
    together = forces(law, gains | {gain: (gains[gain] * SIX).tolist()}, side)
    alone = [forces(law, gains | {gain: gains[gain] * share}, side)[:, leg] for leg, share in enumerate(SIX)]
    np.testing.assert_allclose(together, np.transpose(alone), rtol=1e-12)
    differs = np.abs(together - forces(law, gains, side)).max(axis=0)
    assert differs[SIX != 1.0].min() > 1.0, "each gain counts"
