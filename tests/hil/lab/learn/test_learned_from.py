"""From consecutive runs to the next feed-forward: the first error of all, one maker, one limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.errors import LogError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.feedforward_file import feedforward_text, made_for, read_feedforward
from hil.config.feedforward import FeedforwardHead, MadeFor
from hil.lab.learn import rehearsal
from hil.lab.learn.command import Knowledge, learned, limit_of
from hil.lab.learn.rehearsal import rehearse
from hil.lab.learn.runs import LearningRun
from hil.lab.learn.trial import trial

C = load("virtual")
T, LEAD, COUNT = 1e-3, 450, 500
FIRST_MM = 1.6
"""Error of the first run of a series whose first log is not given."""
MADE_FOR = made_for(C.reference, C.controller, C.platform, C.folder)
ERROR = np.zeros((LEAD + COUNT, 6))
ERROR[LEAD:] = np.sin(2.0 * np.pi * 6.0 * T * np.arange(COUNT))[:, None] * (
    5e-4,
    4e-4,
    -5e-4,
    3e-4,
    -2e-4,
    5e-4,
)


def head_of(run: int, **changes: Any) -> FeedforwardHead:
    head = FeedforwardHead(
        kind="feedforward",
        source="first.mcap",
        run=run,
        made_for=MADE_FOR,
        rate_Hz=1000.0,
        cutoff_Hz=88.0,
        contraction=0.8,
        first_rms_error_mm=FIRST_MM,
        rms_error_mm=0.5,
        peak_N=100.0,
        rows=LEAD + COUNT,
    )
    return head.model_copy(update=changes)


def run_of(number: int, share: float = 1.0, c: Configuration = C) -> LearningRun:
    """Return the run with what so many runs have taught, next to nothing, its error a share of ERROR."""
    still = np.zeros_like(ERROR)
    there = trial(T, LEAD, share * ERROR, still, 1e-6 * number * ERROR, np.full(6, 20.0))
    masses = np.broadcast_to(100.0 * np.eye(6), (LEAD + COUNT, 6, 6))
    head = head_of(number) if number else None
    return LearningRun(Path(f"run-{number}.mcap"), c, there, masses, still, MADE_FOR, head)


@pytest.mark.parametrize("number", [0, 1, 5])
def test_an_error_that_grows_contradicts_wherever_in_a_series_it_does(number: int) -> None:
    outcome = learned([run_of(number), run_of(number + 1, 2.0)], Knowledge())
    assert (outcome.state, outcome.text) == ("contradicted", "")
    found = outcome.steps[-1].contradicted
    assert found is not None
    assert found.factor == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("number", [1, 5])
def test_what_is_small_beside_the_first_error_of_all_contradicts_nothing(number: int) -> None:
    outcome = learned([run_of(number, 0.02), run_of(number + 1, 0.04)], Knowledge())
    assert outcome.steps[-1].contradicted is None


@pytest.mark.parametrize("number", [0, 1, 5])
def test_the_error_of_the_first_run_goes_from_file_to_file(number: int) -> None:
    outcome = learned([run_of(number), run_of(number + 1, 0.5)], Knowledge())
    assert outcome.state == "learned"
    head, _, start_s, _ = read_feedforward(outcome.text.encode(), "next.csv")
    own_mm = 1e3 * float(np.sqrt((ERROR[LEAD:] ** 2).mean()))
    assert head.first_rms_error_mm == pytest.approx(FIRST_MM if number else own_mm, rel=1e-5)
    assert head.rms_error_mm == pytest.approx(0.5 * own_mm, rel=1e-5)
    assert head.run == number + 2
    assert start_s == pytest.approx(-T * LEAD)


@pytest.mark.parametrize("what", ["reference", "controller", "platform"])
@pytest.mark.parametrize("other", [0, 1, 2])
def test_runs_with_another_reference_controller_or_platform_do_not_teach_one_feed_forward(
    what: str, other: int
) -> None:
    assert what in MadeFor.model_fields
    series = [run_of(0), run_of(1), run_of(2)]
    series[other] = series[other]._replace(made_for=MADE_FOR.model_copy(update={what: "another"}))
    later = max(other, 1)
    with pytest.raises(LogError, match=rf"run-{later}\.mcap: has another {what} than run-{later - 1}\.mcap"):
        learned(series, Knowledge())


@pytest.mark.parametrize("rows", [LEAD + COUNT, LEAD + COUNT - 1], ids=["as many", "fewer"])
def test_consecutive_runs_of_two_rates_are_told_their_rates_and_not_that_their_order_is_wrong(
    rows: int,
) -> None:
    fast, slow = run_of(1), run_of(2)
    slow = slow._replace(trial=slow.trial._replace(period_s=2e-3, e=slow.trial.e[:rows]))
    with pytest.raises(LogError, match=r"run-2\.mcap: .* at 500 Hz, that of run-1\.mcap at 1000 Hz"):
        learned([fast, slow], Knowledge())


def test_consecutive_runs_of_other_lengths_are_told_their_lengths() -> None:
    short = run_of(2)
    short = short._replace(trial=short.trial._replace(e=short.trial.e[:-1]))
    with pytest.raises(LogError, match=r"run-2\.mcap: 1999 ticks .* of run-1\.mcap 2000"):
        learned([run_of(1), short], Knowledge())


class _Learned(NamedTuple):
    """An outcome that goes on."""

    text: str
    steps: list[Any]
    state: str = "learned"


class _Step(NamedTuple):
    rms_mm: float


@pytest.mark.parametrize(
    ("configured", "stated", "limit_N"),
    [(300.0, None, 300.0), (300.0, 200.0, 200.0), (None, 200.0, 200.0), (None, None, 5000.0)],
)
def test_each_run_of_a_series_has_the_limit_that_is_stated_or_configured(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    configured: float | None,
    stated: float | None,
    limit_N: float,
) -> None:
    """Without either it is a fifth of limits.force_N, 25 kN."""
    ran: list[Configuration] = []
    known: list[float | None] = []
    text = feedforward_text(head_of(1, rows=10), np.zeros((10, 6)), -4, T)

    def simulate(c: Configuration, **_: Any) -> dict[str, Any]:
        ran.append(c)
        return {"success": True}

    def learn(runs: list[LearningRun], knowledge: Knowledge) -> Any:
        known.append(limit_of(runs[-1], knowledge))
        return _Learned(text, [_Step(1.0)])

    monkeypatch.setattr(rehearsal, "refuse_unreachable", lambda _: None)
    monkeypatch.setattr(rehearsal, "simulate", simulate)
    monkeypatch.setattr(rehearsal, "learning_run", lambda _: run_of(len(ran) - 1, c=ran[-1]))
    monkeypatch.setattr(rehearsal, "learned", learn)
    (tmp_path / "old.csv").write_text(text)
    section = None if configured is None else {"limit_N": configured, "file": "old.csv"}
    c = loads(with_changes(C.text, {"name": "virtual", "feedforward": section}), "virtual", tmp_path)
    found = rehearse(c, 3, Knowledge(limit_N=stated), tmp_path, lambda _: None)
    assert (found.limit_N, known) == (limit_N, [limit_N] * 3)
    sections = [each.feedforward for each in ran]
    assert sections[0] is None, "the first run is without"
    assert [each.limit_N for each in sections[1:] if each is not None] == [limit_N] * 2
