"""Logs usable for learning: complete, at the configured rate, without forces cut by a limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.signals import Mode, Warn
from hil.app.configuration.configuration import load
from hil.lab.identify.runs import Recorded
from hil.lab.learn import runs
from hil.lab.learn.runs import learning_run

T, COUNT, LEAD = 1e-3, 300, 450
PATH = Path("a.mcap")
COLUMNS = [
    *((name, int) for name in ("tick", "mode", "faults", "warnings")),
    ("reference_time_s", float),
    ("probe_force", float, 6),
]


def rows_of(approach: int) -> Any:
    """Rows with `approach` ticks of an approach, the ticks of a reference, and some after it."""
    rows = np.zeros(approach + COUNT + 100, COLUMNS)
    rows["tick"] = 7000 + np.arange(len(rows))
    rows["mode"] = Mode.PARKING
    rows["mode"][: approach + COUNT] = Mode.TRACKING
    rows["mode"][:approach] = Mode.APPROACH
    rows["reference_time_s"][approach:] = T * np.arange(COUNT + 100)
    return rows


def whole(rows: Any) -> tuple[int, Any]:
    return runs._whole(PATH, rows, T, COUNT)


@pytest.mark.parametrize(("approach", "lead"), [(0, 0), (1, 1), (200, 200), (LEAD, LEAD), (900, LEAD)])
def test_ticks_at_the_end_of_the_approach_are_used_before_the_path(approach: int, lead: int) -> None:
    found, rows = whole(rows_of(approach))
    assert (found, len(rows)) == (lead, lead + COUNT)
    np.testing.assert_array_equal(rows["tick"], 7000 + approach - lead + np.arange(lead + COUNT))


@pytest.mark.parametrize("approach", [200, 900])
@pytest.mark.parametrize("lost", [[1], [150, 199]])
def test_learning_uses_no_ticks_of_an_approach_with_a_lost_tick(approach: int, lost: list[int]) -> None:
    """lost: ticks counted back from the start of the reference."""
    found, rows = whole(np.delete(rows_of(approach), approach - np.array(lost)))
    assert found == 0
    np.testing.assert_array_equal(rows["tick"], 7000 + approach + np.arange(COUNT))


@pytest.mark.parametrize(
    "limit", [Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW], ids=lambda w: w.name
)
@pytest.mark.parametrize("at", [-LEAD, -1, 0, COUNT - 1], ids=str)
def test_learning_from_a_run_with_forces_cut_by_a_limit_is_refused(limit: Warn, at: int) -> None:
    rows = rows_of(500)
    rows["warnings"][500 + at] = int(limit)
    with pytest.raises(LogError, match="limits cut"):
        whole(rows)


@pytest.mark.parametrize("rate_Hz", [500.0, 1001.0])
def test_learning_from_a_run_at_another_rate_than_configured_is_refused(
    monkeypatch: pytest.MonkeyPatch, rate_Hz: float
) -> None:
    """`hil run` reduces the rate if a machine cannot hold it, which changes period and delays."""
    recorded = Recorded(load("virtual"), rows_of(500), rate_Hz, {})
    monkeypatch.setattr(runs, "recorded_run", lambda _: recorded)
    with pytest.raises(LogError, match="rate_Hz"):
        learning_run(PATH)


@pytest.mark.parametrize("period_s", [1e-4, 2e-2])
@pytest.mark.parametrize("at", [0, COUNT - 1], ids=str)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_time_of_the_reference_may_be_off_by_a_millionth_of_the_period(
    period_s: float, at: int, side: float
) -> None:
    rows = rows_of(0)
    rows["reference_time_s"] *= period_s / T
    rows["reference_time_s"][at] += side * 0.9e-6 * period_s
    assert runs._whole(PATH, rows, period_s, COUNT)[0] == 0
    rows["reference_time_s"][at] += side * 0.2e-6 * period_s
    with pytest.raises(LogError, match="the reference's time differs from the clock's"):
        runs._whole(PATH, rows, period_s, COUNT)
