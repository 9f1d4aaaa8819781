"""The laws on the book's platform and trajectory, both ends of the bus in lockstep.

Expected errors: tests/data/book_closed_loop.json, simulated by others from the book's parameters.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.app.configuration.configuration import load, loads
from hil.control.pd import PDSettings
from tests.loop import unrecorded

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_closed_loop.json").read_text())["rows"]


@pytest.fixture(scope="module")
def ideal():
    return load("ideal")


def with_pd(configuration):
    """The same bench under the book's PD, kp 2e6 N/m and kv 5e4 N s/m."""
    lines = configuration.text.splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line.startswith("controller:"))
    last = next(
        (
            i
            for i in range(first + 1, len(lines))
            if lines[i].strip() and not lines[i][0].isspace() and lines[i][0] != "#"
        ),
        len(lines),
    )
    pd = "controller:\n  law: pd\n  kp_N_m: 2.0e+6\n  kv_N_s_m: 5.0e+4\n\n"
    return loads("".join([*lines[:first], pd, *lines[last:]]), "ideal with PD", configuration.folder)


def assert_no_limit_acted(summary):
    assert summary["success"], summary
    assert not any(summary["limited_ticks"].values()), summary["limited_ticks"]


def test_exact_inverse_dynamics_has_the_error_of_its_sampling_alone(ideal):
    summary, _ = unrecorded.run(ideal)
    row = BOOK["joint_IDC_exact_wn20_1kHz_ZOH"]
    assert_no_limit_acted(summary)
    assert summary["tracking"]["peak_leg_error_mm"] == pytest.approx(row["peak_leg_err_mm"], rel=0.10)
    assert summary["tracking"]["rms_leg_error_mm"] == pytest.approx(row["rms_leg_err_mm"], rel=0.10)
    assert summary["tracking"]["peak_force_N"] == pytest.approx(row["peak_leg_force_N"], rel=0.01)


def test_decentralised_pd_lags_by_what_the_book_says(ideal):
    configuration = with_pd(ideal)
    assert isinstance(configuration.controller, PDSettings)
    summary, _ = unrecorded.run(configuration)
    row = BOOK["joint_PD_ch6_1kHz_ZOH"]
    assert_no_limit_acted(summary)
    assert summary["tracking"]["peak_leg_error_mm"] == pytest.approx(row["peak_leg_err_mm"], rel=0.03)
    assert summary["tracking"]["rms_leg_error_mm"] == pytest.approx(row["rms_leg_err_mm"], rel=0.03)
    assert summary["tracking"]["peak_force_N"] == pytest.approx(row["peak_leg_force_N"], rel=0.03)
