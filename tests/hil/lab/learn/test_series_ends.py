"""A series of runs that cannot go on ends with the best file so far, wherever it fails; the first run says why."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from drivers.errors import ConfigurationError, HilError, LogError, ModelError, PlantError
from hil.app.configuration.configuration import load
from hil.lab.learn import rehearsal
from hil.lab.learn.command import Knowledge
from hil.lab.learn.rehearsal import rehearse

C = load("virtual")
FAILURES = [
    ("_with", OSError(28, "No space left on device")),
    ("_with", ConfigurationError("feedforward.file: it was changed since")),
    ("simulate", LogError("/tmp: 0.1 GB are free")),
    ("simulate", PlantError("the FMU does not start")),
    ("learning_run", LogError("limits cut the forces")),
    ("learning_run", ConfigurationError("a law of another kind")),
    ("learned", ModelError("no filter makes the error fall")),
    ("learned", LogError("its feed-forward takes 40000000 bytes")),
]
"""What a run of a series calls, and how that may fail."""


class _Step(NamedTuple):
    rms_mm: float


class _Learned(NamedTuple):
    """An outcome that goes on; its text is of the file of the next run."""

    text: str
    steps: list[_Step]
    state: str = "learned"


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Let each run have half the error of the one before; return what makes a run fail at a call."""
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
            monkeypatch.setattr(rehearsal, name, called(name))

    monkeypatch.setattr(rehearsal, "refuse_unreachable", lambda _: None)
    monkeypatch.setattr(rehearsal, "limit_of", lambda *_: 100.0)
    return fails


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize(("call", "error"), FAILURES, ids=str)
def test_a_later_run_that_fails_ends_the_series_and_what_was_best_is_kept(
    runs: Any, tmp_path: Path, number: int, call: str, error: Exception
) -> None:
    runs(number, call, error)
    found = rehearse(C, 5, Knowledge(), tmp_path, lambda _: None)
    assert (found.trouble, found.interrupted) == (f"run {number}: {error}", False)
    assert [step.rms_mm for step in found.steps] == [1.0, 0.5][:number]
    assert found.best == ("" if number == 1 else "of run 1"), "the first run is without a file"


@pytest.mark.parametrize(("call", "error"), FAILURES, ids=str)
def test_a_first_run_that_fails_has_taught_nothing_and_its_error_is_told(
    runs: Any, tmp_path: Path, call: str, error: Exception
) -> None:
    runs(0, call, error)
    with pytest.raises((HilError, OSError)) as told:
        rehearse(C, 5, Knowledge(), tmp_path, lambda _: None)
    assert told.value is error
