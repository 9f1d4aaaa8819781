"""A cut feed-forward: its section takes it, however many digits its limit has, and what it leaves is predicted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hil.app.configuration.configuration import load
from hil.app.configuration.feedforward_file import learned_forces, read_feedforward
from hil.config.feedforward import FeedforwardSettings
from hil.lab.learn.command import Knowledge, learned
from hil.lab.learn.report import lines, summary, written
from hil.lab.learn.trial import trial
from tests.hil.lab.learn.test_learned_from import COUNT, ERROR, LEAD, T, run_of


def printed(limit_N: float) -> dict[str, Any]:
    """Return the section that is printed for a file."""
    section: dict[str, Any] = yaml.safe_load(written(Path("next.csv"), limit_N)[-1])["feedforward"]
    return section


def taken(folder: Path, text: str, section: dict[str, Any]) -> float:
    """Return the largest force that a run takes of a file and its section."""
    c = load("virtual")
    (folder / "next.csv").write_text(text)
    settings = FeedforwardSettings.model_validate(section)
    forces = learned_forces(settings, c.reference, c.controller, c.platform, folder)
    assert forces is not None
    return float(abs(read_feedforward(text.encode(), "next.csv")[1]).max())


@pytest.mark.parametrize(
    ("limit_N", "peak_N"),
    [
        (1.00006, 1.0),
        (1.00004, 1.0),
        (0.3, 0.3),
        (4.35, 4.35),
        (4.448222, 4.4482),
        (10.0, 10.0),
        (0.00007, 0.0),
    ],
)
def test_a_run_takes_forces_that_were_cut_at_a_limit_of_any_digits(
    tmp_path: Path, limit_N: float, peak_N: float
) -> None:
    outcome = learned([run_of(0)], Knowledge(limit_N=limit_N))
    assert outcome.cut > 0
    assert taken(tmp_path, outcome.text, printed(limit_N)) == peak_N
    assert taken(tmp_path, outcome.text, {"file": "next.csv", "limit_N": limit_N}) == peak_N


@pytest.mark.parametrize("force_N", [22241.11, 25000.0, 3000.3, 123456.789, 0.7])
def test_the_printed_limit_of_a_share_of_the_drives_force_is_that_of_the_file(
    tmp_path: Path, force_N: float
) -> None:
    """Without section feedforward it is a fifth of limits.force_N."""
    c = load("virtual")
    limits = c.limits.model_copy(update={"force_N": force_N})
    c = c.model_copy(update={"limits": limits})
    run = run_of(0, c=c)
    run = run._replace(trial=run.trial._replace(e=1e4 * run.trial.e))
    outcome = learned([run], Knowledge())
    assert outcome.cut > 0
    section = printed(0.2 * force_N)
    assert section["limit_N"] == pytest.approx(0.2 * force_N, rel=1e-14)
    assert taken(tmp_path, outcome.text, section) == pytest.approx(0.2 * force_N, abs=1.01e-4)


OWN_MM = 1e3 * float(np.sqrt((ERROR[LEAD:] ** 2).mean()))


@pytest.mark.parametrize("runs", [1, 2])
def test_forces_that_are_cut_down_to_nothing_are_predicted_to_leave_the_error_as_it_is(runs: int) -> None:
    outcome = learned([run_of(number, 0.5**number) for number in range(runs)], Knowledge(limit_N=0.00007))
    assert outcome.cut > 0
    left_mm = OWN_MM * 0.5 ** (runs - 1)
    assert summary(outcome, None)["predicted_next_mm"] == pytest.approx(left_mm, rel=1e-4)
    assert f"Next run   {left_mm:.2g} mm rms predicted" in "\n".join(lines(outcome, 0.00007, None))


def test_forces_that_no_limit_cuts_are_predicted_to_halve_the_first_error() -> None:
    outcome = learned([run_of(0)], Knowledge(limit_N=1e4))
    assert outcome.cut == 0
    assert outcome.predicted_mm == pytest.approx(0.5 * OWN_MM, rel=0.1)


@pytest.mark.parametrize("masses_kg", [1.0, 100.0])
def test_a_cut_force_is_predicted_to_take_off_a_constant_error_what_it_holds_against_the_law(
    masses_kg: float,
) -> None:
    """A constant error needs a constant a = wn^2 e, wn 20 rad/s; cut at F it takes F / (m wn^2) off each leg."""
    e = np.full((LEAD + 4 * COUNT, 6), 1e-3)
    e[:, 3:] *= -1.0
    there = trial(T, LEAD, e, np.zeros_like(e), np.zeros_like(e), np.full(6, 20.0))
    masses = np.broadcast_to(masses_kg * np.eye(6), (len(e), 6, 6))
    run = run_of(0)._replace(trial=there, force_per_acceleration=masses)
    outcome = learned([run], Knowledge(limit_N=0.1 * masses_kg))
    assert outcome.cut > COUNT
    assert outcome.predicted_mm == pytest.approx(1.0 - 1e3 * 0.1 / 20.0**2, rel=0.02)
