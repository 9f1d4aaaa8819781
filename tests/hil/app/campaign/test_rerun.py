"""What is recorded of a row again: the run of the row, with its chance and told to park when the row was."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.app.campaign import rerun
from hil.app.campaign.row import Ended


@pytest.mark.parametrize(
    ("ticks", "stop_tick", "duration_s"), [(700, None, 1.4), (700, 300, 0.6), (250, 0, 0.0)]
)
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_a_row_is_recorded_with_its_own_chance_and_parks_when_it_did(
    monkeypatch: pytest.MonkeyPatch, ticks: int, stop_tick: int | None, duration_s: float, seed: int
) -> None:
    ran: list[dict[str, Any]] = []
    monkeypatch.setattr(rerun, "simulate", lambda _, **given: ran.append(given))
    c: Any = SimpleNamespace(loop=SimpleNamespace(rate_Hz=500.0))
    job: Any = SimpleNamespace(seed=seed)
    rerun._simulate(c, job, Ended("complete", "", ticks, stop_tick), Path("a.mcap"))
    (given,) = ran
    assert given["duration_s"] == pytest.approx(duration_s, abs=1e-12)
    assert (given["faults"].faults, given["faults"].seed) == ((), seed)
    assert given["plant_log"]
