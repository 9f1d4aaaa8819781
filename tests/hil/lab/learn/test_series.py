"""A series of learning runs: its steps, its end, its force limit, and the written file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from drivers.errors import HilError, LogError, ModelError, PlantError
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.feedforward_file import (
    learned_forces,
    made_for,
    read_feedforward,
)
from hil.config.feedforward import FeedforwardHead, FeedforwardSettings
from hil.lab.learn import command
from hil.lab.learn.command import Knowledge, Outcome, Series, learned, rehearse
from hil.lab.learn.report import lines, summary
from hil.lab.learn.runs import LearningRun
from hil.lab.learn.trial import trial

C = load("virtual")
T, LEAD, COUNT = 1e-3, 450, 500
FIRST_MM = 1.6
"""Error of the first run of a series whose first log is not given."""
OUT = Path("next.csv")
MADE_FOR = made_for(C.reference, C.controller, C.platform, C.folder)
ERROR = np.zeros((LEAD + COUNT, 6))
ERROR[LEAD:] = np.outer(
    np.sin(2.0 * np.pi * 6.0 * T * np.arange(COUNT)), [5e-4, 4e-4, -5e-4, 3e-4, -2e-4, 5e-4]
)


def head_of(run: int) -> FeedforwardHead:
    return FeedforwardHead(
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


def run_of(number: int, share: float = 1.0, c: Configuration = C) -> LearningRun:
    """Run after `number` updates, with nearly no learned acceleration; its error is a share of ERROR."""
    still = np.zeros_like(ERROR)
    there = trial(T, LEAD, share * ERROR, still, 1e-6 * number * ERROR, np.full(6, 20.0))
    masses = np.broadcast_to(100.0 * np.eye(6), (LEAD + COUNT, 6, 6))
    head = head_of(number) if number else None
    return LearningRun(Path(f"run-{number}.mcap"), c, there, masses, still, MADE_FOR, head)


@pytest.mark.parametrize("number", [0, 1, 5])
def test_growing_error_ends_a_learning_series_as_contradicted_at_any_run(number: int) -> None:
    outcome = learned([run_of(number), run_of(number + 1, 2.0)], Knowledge())
    assert (outcome.state, outcome.text) == ("contradicted", "")
    found = outcome.steps[-1].contradicted
    assert found is not None
    assert found.factor == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("number", [0, 1, 5])
def test_error_of_the_first_run_is_passed_on_in_every_feedforward_file(number: int) -> None:
    outcome = learned([run_of(number), run_of(number + 1, 0.5)], Knowledge())
    assert outcome.state == "learned"
    head, _, start_s, _ = read_feedforward(outcome.text.encode(), "next.csv")
    own_mm = 1e3 * float(np.sqrt((ERROR[LEAD:] ** 2).mean()))
    assert head.first_rms_error_mm == pytest.approx(FIRST_MM if number else own_mm, rel=1e-5)
    assert head.rms_error_mm == pytest.approx(0.5 * own_mm, rel=1e-5)
    assert head.run == number + 2
    assert start_s == pytest.approx(-T * LEAD)


@pytest.mark.parametrize("what", ["reference", "controller", "platform"])
@pytest.mark.parametrize("other", [0, 2])
def test_learning_from_runs_of_different_machines_is_refused(what: str, other: int) -> None:
    series = [run_of(0), run_of(1), run_of(2)]
    series[other] = series[other]._replace(made_for=MADE_FOR.model_copy(update={what: "another"}))
    with pytest.raises(LogError, match=f"its {what}, .*, differs from"):
        learned(series, Knowledge())


def printed(outcome: Outcome, limit_N: float) -> dict[str, Any]:
    """The printed section for a file."""
    series = Series(outcome.steps, outcome, limit_N, outcome.text)
    line = next(line for line in lines(series, OUT) if line.startswith("feedforward:"))
    section: dict[str, Any] = yaml.safe_load(line)["feedforward"]
    return section


def taken(folder: Path, text: str, section: dict[str, Any]) -> float:
    """Largest force that a run reads from a file and its section."""
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
        (4.448222, 4.4482),
        (0.00007, 0.0),
    ],
)
def test_run_accepts_learned_forces_cut_at_a_limit_with_many_digits(
    tmp_path: Path, limit_N: float, peak_N: float
) -> None:
    outcome = learned([run_of(0)], Knowledge(limit_N=limit_N))
    assert outcome.cut > 0
    assert taken(tmp_path, outcome.text, printed(outcome, limit_N)) == peak_N
    assert taken(tmp_path, outcome.text, {"file": "next.csv", "limit_N": limit_N}) == peak_N


SHARES = {"learned": 0.5, "floor": 0.98, "contradicted": 2.0}
"""State -> error of the second run as a share of the first run's error."""


@pytest.mark.parametrize("state", SHARES)
@pytest.mark.parametrize("trouble", ["", "run 2: a fault", "interrupted"])
def test_learning_series_succeeds_only_without_contradiction_and_failure(state: str, trouble: str) -> None:
    outcome = learned([run_of(0), run_of(1, SHARES[state])], Knowledge())
    interrupted = trouble == "interrupted"
    found = summary(Series(outcome.steps, outcome, 300.0, outcome.text, trouble, interrupted), OUT)
    assert found["success"] is (state != "contradicted" and not trouble)
    assert found["state"] == ("interrupted" if interrupted else "failed" if trouble else state)
    assert found["written"] == (str(OUT) if state == "learned" else None)


FAILURES = [
    ("_with", OSError(28, "No space left on device")),
    ("simulate", PlantError("the FMU does not start")),
    ("learning_run", LogError("limits cut the forces")),
    ("learned", ModelError("no filter makes the error fall")),
]
"""Calls made by a run of a series, and an error of each."""


class _Step(NamedTuple):
    rms_mm: float


class _Learned(NamedTuple):
    """An outcome that goes on; its text is that of the next run's file."""

    text: str
    steps: list[_Step]
    state: str = "learned"


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Halve the error from run to run; return a function that makes a run fail at a call."""
    calls: dict[str, int] = {}

    def learn(*_: Any) -> Any:
        number = calls["learned"] - 1
        return _Learned(f"of run {number + 1}", [_Step(0.5**number)])

    stand_ins: dict[str, Any] = {
        "_with": lambda *_: C,
        "simulate": lambda *_, **__: {"success": True},
        "learning_run": lambda _: None,
        "learned": learn,
    }

    def fails(number: int, call: str, error: Exception) -> None:
        def called(name: str) -> Any:
            def answer(*given: Any, **named: Any) -> Any:
                calls[name] = calls.get(name, 0) + 1
                if name == call and calls[name] == number + 1:
                    raise error
                return stand_ins[name](*given, **named)

            return answer

        for name in stand_ins:
            monkeypatch.setattr(command, name, called(name))

    monkeypatch.setattr(command, "refuse_unreachable", lambda _: None)
    monkeypatch.setattr(command, "limit_of", lambda *_: 100.0)
    return fails


@pytest.mark.parametrize(
    ("number", "call", "error"), [(1 + k % 2, *each) for k, each in enumerate(FAILURES)], ids=str
)
def test_failure_of_a_later_run_ends_the_learning_series_and_keeps_the_best_file(
    runs: Any, tmp_path: Path, number: int, call: str, error: Exception
) -> None:
    runs(number, call, error)
    found = rehearse(C, 5, Knowledge(), tmp_path, lambda _: None)
    assert (found.trouble, found.interrupted) == (f"run {number}: {error}", False)
    assert [step.rms_mm for step in found.steps] == [1.0, 0.5][:number]
    assert found.best == ("" if number == 1 else "of run 1"), "the first run has no file"


@pytest.mark.parametrize(("call", "error"), FAILURES, ids=str)
def test_failure_of_the_first_learning_run_is_raised(
    runs: Any, tmp_path: Path, call: str, error: Exception
) -> None:
    runs(0, call, error)
    with pytest.raises((HilError, OSError)) as told:
        rehearse(C, 5, Knowledge(), tmp_path, lambda _: None)
    assert told.value is error
