"""The shipped mu controller in the closed loop, on the bus path.

The load and the wrong model of test_robust.py: model x 0.9, and 10 kN along x, y and z at once from the far
point of the book's path on; beside inverse dynamics of wn 20 rad/s.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.record.metrics import total_variation
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.loop import unrecorded

ROOT = Path(__file__).resolve().parents[2]
LOAD_S = 2.3
LOAD = WrenchStep(at_s=LOAD_S, force_N=(10e3, 10e3, 10e3), moment_N_m=(0.0, 0.0, 0.0))
LAWS = {
    "plain": "  law: inverse_dynamics\n  wn_rad_s: 20\n",
    "mu": "  law: state_space\n  controller_file: mu\n",
}


def bench(law):
    text = load("virtual").text
    a, b = text.index("\ncontroller:") + 1, text.index("\nengage:") + 1
    text = f"{text[:a]}controller:\n{law}  model: {{inertia_scale: 0.9}}\n\n{text[b:]}"
    for old, new in (("periods: 10", "periods: 1"), ("following_error_m: 0.01", "following_error_m: 0.1")):
        assert text.count(f"  {old}\n") == 1, old
        text = text.replace(f"  {old}\n", f"  {new}\n")
    return loads(text, "mu.yaml", ROOT)


@pytest.fixture(scope="module")
def tracked():
    found = {}
    for name, law in LAWS.items():
        summary, rows = unrecorded.run(bench(law), FaultPlan([LOAD]))
        assert summary["success"], summary
        found[name] = rows[rows["mode"] == Mode.TRACKING]
    return found


def test_a_load_that_nobody_measures_and_a_light_model_move_the_legs_by_less_than_two_millimetres(
    tracked, capsys
):
    plain, mu = tracked["plain"], tracked["mu"]
    error_mm = {name: 1e3 * np.abs(rows["q_d"] - rows["q"]).max(axis=1) for name, rows in tracked.items()}
    after = mu["tick"] * 1e-3 >= LOAD_S + 0.3
    ratio = total_variation(mu["tau"]).sum() / total_variation(plain["tau"]).sum()
    with capsys.disabled():
        print(f"\nmodel x 0.9, 10 kN: inverse dynamics wn 20 {error_mm['plain'].max():.1f} mm, mu peak "
              f"{error_mm['mu'].max():.2f} mm, from 0.3 s on {error_mm['mu'][after].max():.4f} mm, "
              f"force variation {ratio:.2f} times")  # fmt: skip
    assert after.sum() > 600
    assert error_mm["plain"].max() == pytest.approx(34.0, abs=0.5)
    assert error_mm["mu"].max() <= 2.0
    assert error_mm["mu"][after].max() <= 0.05
    assert ratio <= 3.0
