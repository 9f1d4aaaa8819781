"""The mu controller under unknown payloads: coupled axes, inside and outside the stated box."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.stability.command import judge
from tests.hil.design.synthesis.test_coupling import coupled, gamma
from tests.hil.design.synthesis.test_mu_design import shipped, system
from tests.loop.bench import changed, run

BOX_kg, BOX_m = (0.0, 120.0), ((-0.2, 0.3), (-0.3, 0.2), (0.0, 0.3))
OUTSIDE_kg, OUTSIDE_m = (900.0, 2500.0), ((0.5, 0.9), (0.5, 0.9), (0.4, 0.9))
INERTIA = 0.2
"""Relative uncertainty of the inertia that the shipped design states."""


def robot(**payload):
    """The virtual bench under the mu controller, with this payload in the model."""
    body = {"payload": [payload | {"shape": {"type": "point"}}]}
    law = {"law": "state_space", "controller_file": "mu"}
    return changed("virtual", controller=law, platform={"platform": body}, reference={"periods": 1})


def boxed(kg, places):
    ranges = {"mass_range_kg": [min(kg[0], 0), kg[1]], "com_range_m": [list(place) for place in places]}
    return robot(mass_kg=0, com_m=[sum(place) / 2 for place in places], **ranges)


def drawn(count, kg, places, seed):
    draw = np.random.default_rng(seed)
    return [
        (float(draw.uniform(*kg)), tuple(float(draw.uniform(*place)) for place in places))
        for _ in range(count)
    ]


@pytest.mark.long
def test_loop_with_a_payload_inside_the_configured_range_is_stable_and_within_its_error_bound():
    c = boxed(BOX_kg, BOX_m)
    verdict = judge(c)
    assert verdict.figures["coupled_axes_covered"]
    bound = np.array(verdict.figures["ultimate_bound"])
    for mass, at in drawn(10, BOX_kg, BOX_m, 5):
        assert np.abs(np.linalg.eigvals(coupled(gamma(mass, at), system(shipped())))).max() < 1
        ran = run(c, plant_of=robot(mass_kg=mass, com_m=list(at)))
        assert ran.ending.success, ran.ending
        rows = ran.tracking
        assert (np.abs(rows["q_d"] - rows["q"]).max(axis=0) <= bound).all(), (mass, at)


@pytest.mark.long
def test_stability_with_payloads_outside_the_designed_range_is_reported_as_not_proven():
    for mass, at in drawn(20, OUTSIDE_kg, OUTSIDE_m, 6):
        least = np.linalg.eigvals(gamma(mass, at)).real.min()
        assert least < 1 / (1 + INERTIA)
        verdict = judge(boxed((0.0, mass), [(min(x, 0.0), x) for x in at]))
        assert verdict.status in {"not proven", "unstable"} or not verdict.figures["coupled_axes_covered"]
