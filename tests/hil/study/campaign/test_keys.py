"""Keys inside other keys: every axis acts in every row, whatever their order and spelling in the file."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import pytest

from hil.study.campaign.keys import apply
from hil.study.campaign.settings import ListedAxis

SECTION = {"type": "stewart", "coulomb_friction_N": 1.0, "gravity_m_s2": [0, 0, -9.8]}
AXES = {
    "model": ListedAxis(key="plant.model", values=[SECTION]),
    "friction_N": ListedAxis(key="plant.model.coulomb_friction_N", values=[250.0]),
    "gravity": ListedAxis(key="plant.model.gravity_m_s2", values=[[0, 0, -3.7]]),
    "across": ListedAxis(key=["loop.rate_Hz", "plant.model.gravity_m_s2[1]"], values=[0.5]),
    "bent": ListedAxis(faults={"pulled": ["payload_step mass=5"]}),
    "mass_kg": ListedAxis(key="plant.faults[1].mass_kg", values=[7.0]),
}
VALUES: dict[str, Any] = {name: next(iter(axis.values or axis.faults or {})) for name, axis in AXES.items()}


def base() -> dict[str, Any]:
    return {"plant": {"model": {"type": "bench"}, "faults": [{"kind": "drive_gain", "leg": 1}]}}


def test_nested_keys_are_set_whatever_the_order_of_their_axes() -> None:
    expected = {"type": "stewart", "coulomb_friction_N": 250.0, "gravity_m_s2": [0, 0.5, -3.7]}
    for order in permutations(AXES):
        found = apply(base(), {name: AXES[name] for name in order}, VALUES)
        assert (order, found["plant"]["model"]) == (order, expected)
        assert (order, found["loop"]) == (order, {"rate_Hz": 0.5})
        assert [fault.get("mass_kg") for fault in found["plant"]["faults"]] == [None, 7.0], order


@pytest.mark.parametrize("key", ["plant", "plant.faults"])
def test_faults_of_an_axis_are_added_to_faults_set_by_another_axis(key: str) -> None:
    faults = [{"kind": "drive_gain", "leg": 4, "factor": 0.9}]
    axes = {
        "bent": AXES["bent"],
        "whole": ListedAxis(key=key, values=[faults if key.endswith("faults") else {"faults": faults}]),
        "leg": ListedAxis(key="plant.faults[0].leg", values=[3]),
    }
    values = {"bent": VALUES["bent"], "whole": (axes["whole"].values or [])[0], "leg": 3}
    found = apply(base(), axes, values)["plant"]["faults"]
    assert [(fault["kind"], fault.get("leg")) for fault in found] == [
        ("drive_gain", 3),
        ("payload_step", None),
    ]
