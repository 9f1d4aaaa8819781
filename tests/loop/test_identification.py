"""The linearised axes of the virtual bench, identified from a run and compared with their closed form.

configs/virtual.yaml: encoders of 1 um, leg rates in the feedback frames, bus time, drives of 200 Hz, 1 kHz.
Its plant has a time grid of 0.1 ms: rates are latched at 0.1 ms after the tick and forces act at 0.6 ms, 0.5
ms later. The encoders are latched with SYNC, 0.075 ms after the tick, so the delay from position to force is
0.025 ms longer than in the closed form; 0.4 degrees at 30 Hz.
"""

from __future__ import annotations

from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.signals import Mode
from hil.app.sim.command import simulate
from hil.config.axis_model import AxisModel
from hil.lab.identify.axes import axes_of_log, excited_axes
from hil.lab.identify.estimators.axis_fit import Fit
from hil.record.log import Log
from tests.broad import broad
from tests.loop.bench import changed

T = 1e-3
TRANSPORT_S, LAG_S = 0.5e-3, 1 / 1257
TOTAL_MS = 1.80


def truth(f):
    """Frequency response of the bench: hold, transport, lag and double integrator."""
    s = 2j * pi * np.asarray(f)
    return (1 - np.exp(-s * T)) / (s * T) * np.exp(-TRANSPORT_S * s) / (1 + s * LAG_S) / s**2


class Made(NamedTuple):
    log: Path
    rows: Rows
    model: AxisModel
    fit: Fit
    summary: dict[str, Any]


@pytest.fixture(scope="module", params=broad(["inverse_dynamics", "pose_inverse_dynamics"], quick=1))
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    path = tmp_path_factory.mktemp("axes") / "a.mcap"
    c = changed("virtual", controller={"law": request.param, "wn_rad_s": 20})
    summary = simulate(excited_axes(c, None, 10.5)[0], log=path, check_replay=False)
    assert summary["success"], summary
    rows, found = Log.open(path).rows(), axes_of_log(path)
    return Made(path, rows[rows["mode"] == Mode.TRACKING], found.model, found.fit, summary)


def measured(axis):
    G = np.array(axis.magnitude) * np.exp(1j * np.deg2rad(axis.phase_deg))
    return np.array(axis.frequency_Hz), G, np.array(axis.coherence)


def test_identified_response_of_all_six_axes_is_within_2_percent_and_2_degrees_of_the_closed_form(made):
    for axis in made.model.measured:
        f, G, coherence = measured(axis)
        judged = (f <= 30.0) & (coherence > 0.9)
        assert judged.sum() >= 7, "the excitation of the axis shows in its coherence"
        off = G[judged] / truth(f[judged])
        assert np.abs(np.abs(off) - 1).max() <= 0.02
        assert np.abs(np.rad2deg(np.angle(off))).max() <= 2.0
    assert np.ptp(made.rows["q"], axis=0).min() >= 2e-3
    assert not any(made.summary["limited_ticks"].values())


def test_phase_slope_of_the_identified_axes_gives_the_total_delay_of_the_loop(made):
    """By a straight line through the measured phases, and by the fit."""
    turned = [measured(axis) for axis in made.model.measured]
    f = np.concatenate([f for f, _, _ in turned])
    phase = np.angle(-np.concatenate([G for _, G, _ in turned]))
    omega = 2 * pi * f[f <= 30.0]
    slope_ms = -1e3 * (omega @ phase[f <= 30.0]) / (omega @ omega)
    assert slope_ms == pytest.approx(TOTAL_MS, abs=0.05)
    assert 1e3 * made.fit.delays.total_s == pytest.approx(TOTAL_MS, abs=0.05)
    if made.model.axes == "joint":
        assert made.fit.delays.transport_s == pytest.approx(TRANSPORT_S, abs=0.1e-3)
        assert made.fit.delays.lag_s == pytest.approx(LAG_S, abs=0.1e-3)
        assert made.fit.gain == pytest.approx(np.ones(6), abs=0.01)
        assert 2 * made.fit.delays.total_std_s < 0.02e-3


def test_identified_uncertainty_bound_covers_the_closed_form_with_0_025_ms_more_delay(made):
    """The closed form with 0.025 ms more delay is not the nominal one; the bound must cover the difference."""
    nominal, profile = made.model.nominal, made.model.uncertainty
    f = np.array(profile.frequency_Hz)
    s = 2j * pi * f
    P0 = np.exp(-1e-3 * nominal.transport_ms * s) / (1 + 1e-3 * nominal.lag_ms * s)
    P0 = P0 * (1 - np.exp(-s * T)) / (s * T) / s**2
    late = np.exp(-0.025e-3 * s)
    for gain in nominal.gain:
        assert (np.abs(truth(f) * late / (gain * P0) - 1) <= np.array(profile.bound)).all()
    assert np.interp(10.0, f, profile.bound) < 0.05
