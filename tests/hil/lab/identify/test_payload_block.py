"""The block printed by `hil identify payload`: pasted into the configuration, it gives the identified body."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.lab.identify.estimators.leg_equations import COLUMNS, REFLECTED
from hil.lab.identify.estimators.rigid_body import SIZE, parameters_of
from hil.lab.identify.payload_report import block_text
from hil.robot.geometry import Body
from tests.loop.loaded_plant import changed

FIGURES: dict[str, Any] = {
    "mass_kg": 80, "com_m": [0.012, -0.003, 0.21],
    "inertia_kg_m2": [[12.1, 0.4, 0], [0.4, 11.7, 0.1], [0, 0.1, 14.2]],
}  # fmt: skip
READ: dict[str, Any] = {
    "frame": {"origin_m": [0, 0, -0.05], "rotation_vector_deg": [0, 0, 90]},
    "inertia_about": {"point_m": [0, 0, 0], "rotation_vector_deg": [0, 20, 0]},
    "products": "positive_integral",
}
BOX: dict[str, Any] = {"mass_kg": 80, "com_m": [0, 0, 0.1], "shape": {"type": "box", "size_m": [1, 1.2, 0.2]}}
TENSOR = np.array([[8.0, 0.5, -0.2], [0.5, 9.0, 0.3], [-0.2, 0.3, 13.0]])
REFLECTED_KG = [9.0, 9.9, 18.0, 1.8, 27.0, 3.6]
BODY = Body(85.0, np.array([0.02, 0.03, 0.15]), TENSOR)


def whole(c, hidden=0.0, reflected_kg=None):
    """An identified body unlike section `platform`, and drives."""
    theta = np.zeros(COLUMNS)
    theta[:SIZE] = parameters_of(BODY)
    theta[REFLECTED:] = REFLECTED_KG
    unknown = np.zeros(COLUMNS)
    unknown[:SIZE] = hidden
    estimate = SimpleNamespace(
        std=np.full(COLUMNS, 0.01), unknown=unknown, scale=np.ones(COLUMNS), residual_N=np.ones(6),
        condition=5.0, samples=100,
    )  # fmt: skip
    made: Any = SimpleNamespace(
        theta=theta, believed=np.zeros(COLUMNS), carrier=np.zeros(SIZE), split=False, payload=None,
        reflected_kg=reflected_kg, estimate=estimate, whole=SimpleNamespace(smallest=1.0),
        sources=[SimpleNamespace(configuration=c, seconds=1.0, sent=None)],
        rms_believed_N=9.0, rms_force_N=100.0, held_out={},
    )  # fmt: skip
    return made


def of_platform(body, scale=1.0):
    """The shipped robot with another platform, and a law with scaled masses."""
    document = yaml.safe_load(load("lab").text)
    document["platform"]["platform"] = body
    document["controller"]["model"] |= {"inertia_scale": scale, "reflected_mass_kg": 5.0}
    return loads(yaml.safe_dump(document), "lab.yaml", Path())


@pytest.mark.parametrize(
    "body",
    [
        FIGURES,
        *(FIGURES | {key: READ[key]} for key in READ),
        FIGURES | READ,
        BOX,
        BOX | {"frame": READ["frame"]},
    ],
)
def test_printed_payload_block_pasted_into_the_configuration_gives_the_identified_body(body):
    c = of_platform(body)
    pasted = changed(c, **yaml.safe_load(block_text(whole(c))))
    theta = parameters_of(build_platform(pasted.platform).platform)
    assert theta == pytest.approx(parameters_of(BODY), abs=1e-5)


@pytest.mark.parametrize(("hidden", "reset"), [(0.0, True), (0.5, False)])
def test_printed_payload_block_resets_inertia_scale_only_if_it_contains_the_body(hidden, reset):
    """After pasting, the scaled reflected masses are the identified ones."""
    c = of_platform(FIGURES, 0.8)
    keys = yaml.safe_load(block_text(whole(c, hidden)))
    assert ("platform" in keys) == ("inertia_scale" in keys["controller"]["model"]) == reset
    believed: Any = changed(c, **keys).controller.believed
    assert believed.inertia_scale == (1.0 if reset else 0.8)
    masses = np.multiply(believed.inertia_scale, believed.reflected_mass_kg)
    assert masses == pytest.approx(REFLECTED_KG, rel=1e-4)
