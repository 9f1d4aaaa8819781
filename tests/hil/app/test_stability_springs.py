"""What `hil stability` says of springs that are asked too much, and which of several robots it judges by."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.loop_delay import loop_delay
from hil.app.stability.command import judge
from hil.app.stability.imperfect_drives import Drives
from tests.hil.app.test_stability_command import LEGS, bench


def changed(law, *changes):
    """Return the bench that holds a pose under a law, with parts of its text replaced."""
    text = bench(law, rest=True).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "my.yaml", Path())


@pytest.mark.parametrize(
    ("law", "soft_end"),
    [
        ("  law: pd\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n", ("length_min_m: 0.75", "length_min_m: 1.52")),
        (
            "  law: pd_gravity\n  kp_N_m: 4e4\n  kv_N_s_m: 4e3\n  model: {inertia_scale: 2}\n",
            ("length_max_m: 2.2", "length_max_m: 1.66"),
        ),
    ],
)
def test_a_rest_beyond_a_soft_end_is_not_called_stable(law, soft_end):
    """Home is inside; the springs of 40 kN/m carry the weight, or what is held up too much, 0.09 m away from it."""
    inside = judge(changed(law), quick=True)
    assert inside.status == "conditional"
    assert inside.figures["energy"]["sag_mm"] > 60.0
    found = judge(changed(law, soft_end), quick=True)
    assert found.status == "not proven"
    assert "it comes to rest outside its limits: leg" in found.claim


@pytest.mark.parametrize("down", [-9.81, 9.81])
def test_an_integral_has_to_carry_the_weight_in_push_and_pull(down):
    """3.66 kN a leg: 102 % of the one limit and 99 % of the other; with gravity upwards the legs pull."""
    gravity = "gravity_m_s2: [0, 0, -9.81]", f"gravity_m_s2: [0, 0, {down}]"
    for limit, status in ((3500.0, "not proven"), (3800.0, "conditional")):
        law = f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: {limit}\n"
        assert judge(changed(law, gravity)).status == status


T = 1e-3

IDEAL = {"plant": {"model": {"force_bandwidth_Hz": 0}, "drives": {"encoder_resolution_m": 0}}}

LAWS = ("inverse_dynamics", "partial_linearisation", "pose_inverse_dynamics")


def held(law: str, wn: list[float], *changes: dict[str, Any]) -> Configuration:
    """Return a robot that rests under a law with these gains, with changes."""
    text = bench(f"  law: {law}\n  wn_rad_s: {wn}\n", rest=True).text
    for each in (IDEAL, *changes):
        text = with_changes(text, each)
    return loads(text, "my.yaml", Path())


def largest_pole(wn: float, gain: float = 1.0) -> float:
    """Return the largest |z| of p'' = u, held for 1 ms and 1 ms late, under u = -gain (wn^2 p + 2 wn v)."""
    K_P, K_D = gain * wn**2, gain * 2.0 * wn
    A = np.array([[1.0, T, T * T / 2.0], [0.0, 1.0, T], [-K_P, -K_D, 0.0]])
    return float(np.abs(np.linalg.eigvals(A)).max())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("leg", [0, 5])
def test_errors_die_out_as_slowly_as_on_the_slowest_axis(law, leg, monkeypatch):
    """Whichever that is: wn 2 beside 20 leaves more than half of its error after 0.3 s."""
    wn = [20.0] * 6
    wn[leg] = 2.0
    c = held(law, wn)
    assert (loop_delay(c).transport_s, loop_delay(c).lag_s) == (T, 0.0)
    exact = Drives.of(c)._replace(length=np.zeros(6), rate=np.zeros(6))
    monkeypatch.setattr(Drives, "of", lambda _: exact)
    found = judge(c)
    pole = largest_pole(2.0)
    rate = -np.log(pole) / T
    assert 1.8 < rate < 2.0
    assert found.status == "proven"
    assert found.claim.endswith(f"small errors die out, the slowest as exp(-{rate:.3g} t)")
    assert found.figures["sampled"]["largest_pole"] == pytest.approx(pole, abs=1e-9)
    assert found.figures["sampled"]["decay_rate_1_s"] == pytest.approx(rate, rel=1e-6)
    (line,) = (one for one in found.lines if one.startswith("sampled loop"))
    assert f"slowest mode exp(-{rate:.3g} t)" in line


@pytest.mark.parametrize("leg", [0, 5])
def test_one_axis_that_grows_is_enough_whichever_it_is(leg):
    wn = [2.0] * 6
    wn[leg] = 600.0
    found = judge(held("inverse_dynamics", wn))
    assert found.status == "unstable"
    assert f"magnitude {largest_pole(600.0):.4g} with" in found.claim
