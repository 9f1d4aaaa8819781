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
from tests.hil.app.test_stability_command import bench

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


@pytest.mark.parametrize("leg", [0, 5])
def test_one_axis_that_grows_is_enough_whichever_it_is(leg):
    wn = [2.0] * 6
    wn[leg] = 600.0
    found = judge(held("inverse_dynamics", wn))
    assert found.status == "unstable"
    assert f"magnitude {largest_pole(600.0):.4g} with" in found.claim
