"""What the fused estimate writes into a tick, column by column, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.compiled.compiler import MATRIX, kernel, record
from drivers.compiled.pointed import context_of
from drivers.tick_columns import TICK, part
from hil.contracts.records import record_of
from hil.estimation.fusion_kernels import fill_estimate
from hil.estimation.fusion_layout import FUSION, STEP
from tests.hil.test_fusion import PLATFORM, A, B, legs

fill = kernel(record(FUSION), record(STEP), MATRIX, record(TICK, *part("estimate", "fusion")))(fill_estimate)
ROBOT = context_of(FUSION, base_joints=A, platform_joints=B, radius=PLATFORM.radius)
UNUSED = 4
"""A leg whose length the estimate did not use."""


@pytest.mark.parametrize("off", range(6))
def test_each_element_of_the_estimate_stands_in_its_place(off):
    p, R = np.array([0.05, -0.1, 1.1]), Rotation.from_rotvec([0.1, -0.05, 0.2])
    twist = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    s = np.zeros((), STEP)
    s["x"][0:3], s["x"][3:12], s["x"][12:18] = p, R.as_matrix().ravel(), twist
    q, dq = legs(p, R, twist)
    error = 1e-4 * (np.arange(6) + 1.0)
    error[off] = -2e-3
    s["length"] = q + error
    s["used"] = 1
    s["used"][UNUSED] = 0
    s["innovation"] = np.arange(6) - 2.5
    variances = np.array([4.0, 9.0, 16.0, 25.0, -1.0, 36.0, 49.0, 64.0, 81.0, 100.0, 121.0, 144.0])
    tick = record_of()

    fill(ROBOT, s, np.diag(variances), tick)

    assert tick["p"].tolist() == p.tolist()
    assert tick["R"].tolist() == R.as_matrix().tolist()
    assert tick["twist"].tolist() == twist.tolist()
    assert tick["q"] == pytest.approx(q, abs=1e-14)
    assert tick["dq"] == pytest.approx(dq, abs=1e-14)
    assert tick["J"] @ twist == pytest.approx(dq, abs=1e-14)
    assert tick["innovation_q"].tolist() == [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5]
    assert tick["pose_std"].tolist() == [2.0, 3.0, 4.0, 5.0, 0.0, 6.0]
    assert tick["fk_residual"] == pytest.approx(np.abs(np.delete(error, UNUSED)).max(), abs=1e-14)
    assert 1.0 < tick["condition"] < 50.0


def test_a_state_that_is_no_number_has_no_residual():
    s = np.zeros((), STEP)
    s["x"][0:3], s["x"][3:12] = np.nan, np.eye(3).ravel()
    s["used"] = 1
    tick = record_of()
    fill(ROBOT, s, np.eye(12), tick)
    assert np.isnan(tick["fk_residual"])
    assert not tick["condition"] < np.inf
