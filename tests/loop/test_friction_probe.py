"""Legs that friction holds at reversal: no push if the friction is known, and a frozen encoder is found.

A hexapod on racks, of 10 or 38 kg, with `legs` or `odrive` drives and 3 to 30 N of dry friction a leg.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hil
from tests.broad import broad

HEAVY: dict[str, Any] = {
    "platform": {"platform": {"mass_kg": 38, "inertia_kg_m2": [[0.35, 0, 0], [0, 0.35, 0], [0, 0, 0.4]]}},
    "limits": {"force_N": 290, "force_step_N": 120, "force_window_N": 280},
}
ODRIVE: dict[str, Any] = {"drives": {"protocol": "odrive", "options": None}, "loop": {"rate_Hz": 312.5}}
LEGS: dict[str, Any] = {"drives": {"protocol": "legs", "options": None, "transmission": None}}
FOUND_m = 4e-3
"""True error of a leg within which its frozen encoder must be found."""


def moved(friction_N: float, drives: dict[str, Any], **more: Any) -> hil.Run:
    """Six seconds of the hexapod, which replay exactly."""
    plant = {"model": {"coulomb_friction_N": friction_N}}
    changes = {**drives, "plant": plant, **HEAVY}
    return hil.sim("desktop", duration_s=6.0, plant_log=True, **changes, **more)


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


FRICTIONS = [(10.0, ODRIVE), (3.0, LEGS), (30.0, ODRIVE), (10.0, LEGS), (3.0, ODRIVE), (30.0, LEGS)]


@pytest.mark.parametrize(("friction_N", "drives"), broad(FRICTIONS, quick=1))
def test_leg_at_rest_under_friction_within_the_configured_value_gets_no_probing_force(friction_N, drives):
    run = moved(friction_N, drives)
    assert run.success, run.summary["trouble"]
    stands = np.abs(np.diff(run.log.frame("plant.length").to_numpy(), axis=0)) < 1e-7
    tracking = run.log.frame("mode")["mode"].to_numpy()[1:] == "TRACKING"
    assert stands[tracking].any(), "friction does hold legs"
    assert not run.log.frame("probe_force").to_numpy().any()
    assert run.summary["pushes"] is None


@pytest.mark.parametrize(
    ("friction_N", "drives", "at_s"),
    broad([(*each, (2.7, 3.9)[n % 2]) for n, each in enumerate(FRICTIONS)], 2),
)
def test_frozen_encoder_under_friction_is_detected_before_its_leg_is_far_off(friction_N, drives, at_s):
    leg = 2
    run = moved(friction_N, drives, faults=[f"encoder_freeze at={at_s} leg={leg}"])
    assert run.summary["faults"] == ["ENCODER"]
    (finding,) = run.summary["story"]["findings"]
    assert finding["leg"] == leg
    true = run.log.frame("plant.length").iloc[:, leg].loc[at_s : finding["time_s"]]
    assert abs(true.iloc[-1] - true.iloc[0]) < FOUND_m


def test_probing_force_against_friction_above_the_configured_value_is_logged_and_summarised():
    run = moved(10.0, LEGS, monitor={"friction_N": 5.0})
    force = run.log.frame("probe_force").to_numpy()
    pushes = int(((force[1:] != 0.0) & (force[:-1] == 0.0)).sum())
    assert run.success
    assert pushes > 0
    assert run.summary["pushes"]["count"] == pushes
    assert run.summary["pushes"]["largest_N"] == pytest.approx(np.abs(force).max())
    events = [each.text for each in run.log.events() if "stands still" in each.text]
    assert len(events) == pushes
    assert "monitor.friction_N" in events[0]
    sent, asked = (run.log.frame(name).to_numpy() for name in ("tau", "tau_law"))
    there = run.log.frame("mode")["mode"].to_numpy() == "TRACKING"
    late = run.log.frame("t_ns").index.to_numpy() > 3.0  # the entry offset has faded
    np.testing.assert_allclose((sent - asked)[there & late], force[there & late], atol=1e-9)


@pytest.mark.parametrize(
    ("fault", "drives"),
    broad(
        [
            ("encoder_freeze at=2.7 leg=1", ODRIVE), ("brake_stuck_closed leg=1 at=1", LEGS),
            ("encoder_freeze at=2.7 leg=1", LEGS), ("brake_stuck_closed leg=1 at=1", ODRIVE),
        ],
        quick=1,
    ),
)  # fmt: skip
def test_wrench_observer_does_not_take_a_leg_held_by_brake_or_frozen_encoder_for_a_load(fault, drives):
    observer = {"wrench": {"source": "observer"}}
    run = moved(10.0, drives, estimation=observer, faults=[fault])
    (finding, *_) = run.summary["story"]["findings"]
    assert (finding["fault"], finding["leg"]) == ("ENCODER", 1)
    true, wanted = (
        run.log.frame(name).iloc[:, 1].loc[: finding["time_s"]] for name in ("plant.length", "q_d")
    )
    assert abs(true - wanted).iloc[-1] < FOUND_m
    assert moved(10.0, drives, estimation=observer).summary["pushes"] is None
