"""The shipped H-infinity controllers in the closed loop, on the bus path.

The load and the wrong model of test_robust.py: model x 0.9, and 10 kN along x, y and z at once from the far
point of the book's path on. The constant model, frozen at home, against the same with PD of equal crossover.
"""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.record.metrics import total_variation
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.loop import unrecorded

ROOT = Path(__file__).resolve().parents[2]
LOAD_S = 2.3
LOAD = WrenchStep(at_s=LOAD_S, force_N=(10e3, 10e3, 10e3), moment_N_m=(0.0, 0.0, 0.0))
PLAIN = "  law: inverse_dynamics\n  wn_rad_s: 20\n"
HINF = "  law: state_space\n  controller_file: hinf\n"
LIGHT = "  model: {inertia_scale: 0.9}\n"
FROZEN = "  model: {variant: constant, frozen_at: {position_m: [0, 0, 1]}}\n"


def bench(controller, **changes):
    """`virtual` with another section controller, one pass of its path, or another reference."""
    text = load("virtual").text
    changes = {"controller": f"controller:\n{controller}", **changes}
    ends = {"controller": "\nengage:", "reference": "\nlimits:"}
    for section, new in changes.items():
        a, b = text.index(f"\n{section}:") + 1, text.index(ends[section]) + 1
        text = f"{text[:a]}{new}\n{text[b:]}"
    text = text.replace("  periods: 10\n", "  periods: 1\n")
    text = text.replace("  following_error_m: 0.01\n", "  following_error_m: 0.1\n")
    return loads(text, "hinf.yaml", ROOT)


def tracked(configuration, faults=None):
    summary, rows = unrecorded.run(configuration, faults)
    assert summary["success"], summary
    return rows[rows["mode"] == Mode.TRACKING]


@pytest.fixture(scope="module")
def loaded():
    return {
        name: tracked(bench(law + LIGHT), FaultPlan([LOAD]))
        for name, law in (("plain", PLAIN), ("hinf", HINF))
    }


def error_mm(rows):
    return 1e3 * np.abs(rows["q_d"] - rows["q"]).max(axis=1)


def test_a_load_that_nobody_measures_and_a_light_model_move_the_legs_by_less_than_two_millimetres(
    loaded, capsys
):
    plain, hinf = loaded["plain"], loaded["hinf"]
    after = hinf["tick"] * 1e-3 >= LOAD_S + 0.3
    ratio = total_variation(hinf["tau"]).sum() / total_variation(plain["tau"]).sum()
    with capsys.disabled():
        print(f"\nmodel x 0.9, 10 kN: inverse dynamics wn 20 {error_mm(plain).max():.1f} mm, H-infinity peak "
              f"{error_mm(hinf).max():.2f} mm, from 0.3 s on {error_mm(hinf)[after].max():.4f} mm, "
              f"force variation {ratio:.2f} times")  # fmt: skip
    assert after.sum() > 600
    assert error_mm(plain).max() == pytest.approx(34.0, abs=0.5)
    assert error_mm(hinf).max() <= 2.0
    assert error_mm(hinf)[after].max() <= 0.05
    assert ratio <= 3.0


@pytest.mark.long
def test_at_equal_crossover_the_peak_is_alike_and_the_lasting_error_is_not(loaded, capsys):
    w_c = crossover("hinf")
    law = f"  law: inverse_dynamics\n  wn_rad_s: {wn_of(w_c)!r}\n  damping_ratio: 1\n"
    hinf, equal = loaded["hinf"], tracked(bench(law + LIGHT), FaultPlan([LOAD]))
    peak, lasting = [], []
    for rows in (hinf, equal):
        peak.append(error_mm(rows).max())
        lasting.append(error_mm(rows)[rows["tick"] * 1e-3 >= LOAD_S + 0.3].max())
    ratio = total_variation(hinf["tau"]).sum() / total_variation(equal["tau"]).sum()
    with capsys.disabled():
        print(f"\nmodel x 0.9, 10 kN, crossover {w_c:.0f} rad/s: H-infinity peak {peak[0]:.2f} mm, from 0.3 s "
              f"on {lasting[0]:.3f} mm; inverse dynamics {peak[1]:.2f} and {lasting[1]:.2f} mm; force variation "
              f"{ratio:.2f} times")  # fmt: skip
    assert peak[0] == pytest.approx(0.83, abs=0.02)
    assert peak[1] == pytest.approx(0.95, abs=0.02)
    assert lasting[0] <= lasting[1] / 20.0


def small_motion(frequency_Hz, amplitude_m):
    """Six axes at once, so that no leg rests."""
    axes = {"x_m": 0.0, "y_m": 1.0, "z_m": 2.0, "rx_deg": 0.5, "ry_deg": 1.5, "rz_deg": 2.5}
    lines = [
        f"    - {{axis: {axis}, amplitude: {amplitude_m * (1 if axis.endswith('m') else 60)}, "
        f"frequency_Hz: {frequency_Hz}, phase_rad: {phase}}}"
        for axis, phase in axes.items()
    ]
    return "\n".join(
        ["reference:", "  type: sinusoids", "  ramp_s: 0.5", "  duration_s: 2", "  components:", *lines]
    )


def rms_mm(rows):
    steady = (rows["reference_time_s"] > 0.5) & (rows["reference_time_s"] < 1.5)
    assert steady.sum() > 900
    return 1e3 * float(np.sqrt(((rows["q_d"] - rows["q"])[steady] ** 2).mean()))


def crossover(controller):
    file = ROOT / f"configs/controllers/{controller}.yaml"
    return float(yaml.safe_load(file.read_text())["design"]["crossover_rad_s"])


def wn_of(w_c):
    """Of critically damped PD that crosses over there: |(2 wn j w + wn^2) / w^2| = 1."""
    return w_c / sqrt(2.0 + sqrt(5.0))


@pytest.mark.long
@pytest.mark.parametrize(("frequency_Hz", "amplitude_m", "smaller"), [(3.0, 0.01, 2.0), (1.0, 0.03, 4.0)])
def test_constant_dynamics_gain_by_h_infinity_against_pd_of_equal_crossover(
    frequency_Hz, amplitude_m, smaller, capsys
):
    w_c = crossover("constant_hinf")
    wn = wn_of(w_c)
    laws = {
        "hinf": "  law: state_space\n  controller_file: constant_hinf\n",
        "pd": f"  law: inverse_dynamics\n  wn_rad_s: {wn!r}\n  damping_ratio: 1\n",
    }
    reference = small_motion(frequency_Hz, amplitude_m)
    rms = {name: rms_mm(tracked(bench(law + FROZEN, reference=reference))) for name, law in laws.items()}
    with capsys.disabled():
        print(f"\nconstant dynamics, {frequency_Hz:g} Hz, crossover {w_c:.1f} rad/s: H-infinity "
              f"{rms['hinf']:.4f} mm rms, PD of wn {wn:.1f} rad/s {rms['pd']:.4f} mm, "
              f"{rms['pd'] / rms['hinf']:.1f} times")  # fmt: skip
    assert w_c >= 120.0
    assert rms["pd"] >= smaller * rms["hinf"]
