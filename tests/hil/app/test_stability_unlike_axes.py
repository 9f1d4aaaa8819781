"""What `hil stability` says of six axes with gains of their own: each figure is that of the worst of them."""

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
from hil.app.stability.judged import slowest_of
from hil.app.stability.subject import Stated, Subject
from hil.app.stability.wording import describe
from hil.design.stability.sampled import Axis, analyse, gains
from tests.hil.app.test_stability_command import bench

T = 1e-3
IDEAL = {"plant": {"model": {"force_bandwidth_Hz": 0}, "drives": {"encoder_resolution_m": 0}}}
LAWS = ("inverse_dynamics", "partial_linearisation", "pose_inverse_dynamics")
ALIKE = [20.0] * 6
HEAVY = {
    "mass_kg": 40,
    "com_m": [0, 0, 0],
    "shape": {"type": "sphere", "radius_m": 1},
    "mass_range_kg": [0, 2000],
}


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
def test_small_errors_die_out_as_slowly_as_those_of_the_slowest_axis(law, leg, monkeypatch):
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


def test_margins_are_those_of_the_axis_that_bears_least_and_the_peak_gain_that_of_the_weakest():
    fast, slow = (judge(held("inverse_dynamics", [wn] * 6)).figures["sampled"] for wn in (20.0, 2.0))
    found = judge(held("inverse_dynamics", [20.0, 20.0, 2.0, 20.0, 20.0, 20.0])).figures["sampled"]
    for name in ("delay_margin_ms", "gain_margin", "phase_margin_deg"):
        assert found[name] == pytest.approx(min(fast[name], slow[name]), rel=1e-9), name
    assert found["cross_over_rad_s"] == pytest.approx(fast["cross_over_rad_s"], rel=1e-9)
    assert found["peak_gain_s2"] == pytest.approx(1.0 / 2.0**2, rel=1e-2)


def test_each_margin_is_the_least_though_they_be_of_different_axes():
    """Less damped and slower: less phase, more delay to spare."""
    axis = Axis(T, T)
    fast, wild = analyse(axis, gains(60.0**2, 120.0, T)), analyse(axis, gains(10.0**2, 5.0, T))
    assert fast.margins is not None
    assert wild.margins is not None
    assert wild.margins.phase_deg < fast.margins.phase_deg
    assert wild.margins.delay_s > fast.margins.delay_s
    for loops in ([fast, wild], [wild, fast]):
        _, figures = describe(loops)
        assert figures["sampled"]["phase_margin_deg"] == wild.margins.phase_deg
        assert figures["sampled"]["delay_margin_ms"] == 1e3 * fast.margins.delay_s


@pytest.mark.parametrize("leg", [0, 5])
def test_one_axis_that_grows_is_enough_whichever_it_is(leg):
    wn = [2.0] * 6
    wn[leg] = 600.0
    found = judge(held("inverse_dynamics", wn))
    assert found.status == "unstable"
    assert f"magnitude {largest_pole(600.0):.4g} with" in found.claim


def test_with_wrong_masses_the_slowest_loop_is_looked_for_at_both_ends():
    """Less gain leaves K_D / 2 of 16 1/s, more gain a pole at 14.2 1/s."""
    found = judge(held("inverse_dynamics", ALIKE), Stated(model_error=0.2))
    rate = min(-np.log(largest_pole(20.0, gain)) / T for gain in (0.8, 1.2))
    assert found.status == "conditional"
    assert found.figures["sampled"]["decay_rate_1_s"] == pytest.approx(rate, rel=1e-6)
    slowest = min(float(-np.roots([1.0, 40.0 * g, 400.0 * g]).real.max()) for g in (0.8, 1.2))
    assert found.figures["decay_rate_1_s"] == pytest.approx(slowest, rel=1e-6)


def test_of_several_payloads_each_loop_counts():
    """Margins of the lightest, rates of the heaviest, though each corner has axes of its own."""
    seen = []
    c = held("inverse_dynamics", ALIKE, {"platform": {"platform": {"payload": [HEAVY]}}})
    model = c.controller.believed
    assert model is not None

    def loops(gain):
        seen.append(gain)
        return [analyse(Axis(T, T, 0.0, gain), gains(400.0, 40.0, T))] * 6

    judged = Subject(c, Stated()).judged(model, "joint", loops)
    assert len(seen) == 3
    assert min(seen) < 0.6
    assert max(seen) > 1.01
    rates = [-np.log(largest_pole(20.0, gain)) / T for gain in seen]
    assert judged.slowest.decay_rate == pytest.approx(min(rates), rel=1e-6)
    assert slowest_of(judged.every) is judged.slowest
