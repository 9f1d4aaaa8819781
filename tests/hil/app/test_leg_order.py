"""The response of an FMU's legs against that of the model: order, signs and size are named."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.app.check.leg_order import findings
from plant_fmu.fmu.probe import Probe

LEGS = np.arange(6)
_A = np.random.default_rng(7).normal(size=(6, 6))
ODD = _A @ _A.T + 6.0 * np.eye(6)
"""Response of a platform without any symmetry."""
SWAP, SHIFT = [0, 1, 4, 3, 2, 5], [1, 2, 3, 4, 5, 0]


def reordered(K, rows=LEGS, columns=LEGS):
    return K[np.ix_(rows, columns)]


def found(K, moved=None, model=ODD):
    return findings(Probe(np.zeros(6), K, 1e-6 * (K if moved is None else moved)), model)


@pytest.mark.parametrize("order", [SWAP, SHIFT, [5, 4, 3, 2, 1, 0], [2, 0, 1, 5, 3, 4]])
@pytest.mark.parametrize("size", [0.4, 1.0, 2.5])
def test_wrong_leg_order_of_an_fmu_is_reported_with_legs_and_keys_at_any_mass(order, size):
    K = size * ODD
    for keys, sentences in (
        ("force, length, rate and brake", found(reordered(K, order, order))),
        ("force", found(reordered(K, columns=order))),
        ("length and rate", found(reordered(K, order))),
        ("rate", found(reordered(K, order), K)),
        ("length", found(K, reordered(K, order))),
    ):
        first, *rest = sentences
        named = {
            int(i): int(j) for i, j in re.findall(r"(\d)(?: of the FMU answers)? as (?:leg )?(\d)", first)
        }
        assert named == {i: order[i] for i in range(6) if order[i] != i}
        assert f"order of plant.model.{keys} right?" in first
        assert [f"{size:.2f} times" in each for each in rest] == [True] * (size != 1.0)


@pytest.mark.parametrize("legs", [[3], [0, 5], [0, 1, 2, 3, 4, 5]])
def test_wrong_force_or_length_sign_of_an_fmu_is_reported_with_its_legs(legs):
    sign = np.ones(6)
    sign[legs] = -1.0
    named = f"leg {', '.join(map(str, legs))} of the FMU"
    (force,) = found(ODD * sign)
    assert force.startswith(f"a force > 0 shortens {named}")
    (rate,) = found(ODD * sign[:, np.newaxis], ODD)
    assert rate.startswith(f"plant.model.rate has the wrong sign of {named}")
    (length,) = found(ODD, ODD * sign[:, np.newaxis])
    assert length.startswith(f"plant.model.length has the wrong sign of {named}")


def test_fmu_response_unlike_the_model_in_size_or_pattern_is_reported():
    assert found(ODD) == []
    assert found(1.04 * ODD) == []
    assert "0.90 times" in found(0.9 * ODD)[0]
    legs = np.linalg.inv(np.linalg.inv(ODD) + 0.02 * np.eye(6))  # 0.02 kg along each leg
    ratio = np.diag(legs) / np.diag(ODD)
    assert f"{ratio.min():.2f} to {ratio.max():.2f} times" in found(legs)[0]


def test_wrong_order_and_sign_are_also_reported_for_an_fmu_with_uncoupled_legs():
    single = np.diag([1.0, 2.0, 1.0, 2.0, 1.0, 3.0])
    assert found(single) == []
    assert "leg 2 of the FMU answers as leg 4" in found(single[:, SWAP])[0]
    assert found(single * [1, 1, 1, -1, 1, 1])[0].startswith("a force > 0 shortens leg 3")


@pytest.mark.parametrize("dead", [[2], [0, 1, 2, 3, 4, 5]])
def test_fmu_legs_that_do_not_respond_to_a_force_are_reported(dead):
    for K in (ODD.copy(), ODD.copy().T):
        K[:, dead] = 0.0
        (sentence,) = found(K)
        assert f"push of leg {', '.join(map(str, dead))} of the FMU moves no leg" in sentence
