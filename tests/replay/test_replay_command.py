"""What `hil replay` says around its work: what was salvaged first, and the story of a what-if."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from hil.app.replay import _require_as_many_as_told, summary
from hil.cli import main
from hil.loop.replay import Comparison
from hil.record.log import Log
from hil.record.salvage import SalvageReport
from hil.record.schema import SUMMARY
from tests.replay.test_what_if_shown import result


@pytest.fixture
def replayed(tmp_path, monkeypatch):
    """A function that runs `hil replay` on a log that is there and need not be read; returns what it prints."""
    path = tmp_path / "run.mcap"
    path.touch()
    good = Comparison(ticks=5), {**summary(Comparison(ticks=5), 1.0, 2.0), "agrees": True}
    monkeypatch.setattr("hil.app.replay.replay_log", lambda *_: good)
    monkeypatch.setattr(Log, "open", lambda _: None)

    def run(*words):
        found = CliRunner().invoke(main, ["replay", str(path), *map(str, words)])
        assert found.exit_code == 0, found.output
        return found

    return run


@pytest.mark.parametrize(
    ("lost", "said"), [(0, "12 bytes unreadable"), (3, "12 bytes unreadable, 3 ticks of damaged chunks lost")]
)
def test_what_was_salvaged_and_what_is_lost_is_said_on_standard_error(
    replayed, tmp_path, monkeypatch, lost, said
):
    out = tmp_path / "whole.mcap"
    given: dict[str, Any] = {"path": tmp_path, "out": out, "bytes_read": 99, "remarks": ("cut", "late")}
    report = SalvageReport(**given, ticks=70, bytes_lost=12, ticks_lost=lost)
    monkeypatch.setattr("hil.record.salvage.salvage", lambda *_: report)
    found = replayed("--salvage", out)
    assert found.stderr.splitlines() == [f"salvaged 70 ticks into {out}, {said}", "  cut", "  late"]
    assert f"log {out}" in " ".join(found.stdout.split()), "what is left is replayed"


@pytest.mark.parametrize("told", [None, {"lines": ["leg 3 is slow", "since tick 4"]}])
def test_the_story_of_a_what_if_stands_above_its_figures(replayed, monkeypatch, told):
    monkeypatch.setattr("hil.study.what_if.command.what_if_log", lambda *_, **__: result(what_if_story=told))
    lines = replayed("--set", "limits.force_N=1").stdout.splitlines()
    story = ["what the faults of the what-if have to tell:", "  leg 3 is slow", "  since tick 4"]
    assert lines[: lines.index("what-if: success")] == ([] if told is None else story)


END = 7
"""The tick behind the last of five."""


def counted(index: int, end: str, *, cut: str = "", gaps: Sequence[tuple[int, int]] = ()) -> Comparison:
    """Return what becomes of five replayed ticks of a log whose index and end count so many."""
    log: Any = SimpleNamespace(
        path="a.mcap", cut=cut, summary=SimpleNamespace(ticks=index), metadata={SUMMARY: {"ticks": end}}
    )
    comparison = Comparison(ticks=5, end=END, gaps=list(gaps))
    _require_as_many_as_told(log, comparison)
    return comparison


@pytest.mark.parametrize(
    ("index", "end", "missing"), [(5, "5", 0), (5, "", 0), (5, "9", 4), (9, "5", 4), (9, "", 4), (6, "8", 3)]
)
def test_ticks_that_index_or_end_count_beyond_those_that_are_there_are_missing(index, end, missing):
    assert counted(index, end).gaps == ([(END, missing)] if missing else [])
    assert counted(index, end, gaps=[(3, 1)]).gaps == [(3, 1)], "nothing behind a gap was looked at"
    assert counted(index, end, cut="cut at byte 9").gaps == [], "it has no end"


@pytest.mark.parametrize(
    ("index", "end", "told"),
    [(4, "5", "4, its end 5"), (5, "4", "5, its end 4"), (4, "", "4"), (5, "-9", "5, its end -9"), (5, "9" * 40, "5, its end 9")],
)  # fmt: skip
def test_an_index_or_an_end_that_counts_fewer_ticks_than_there_are_was_altered(index, end, told):
    with pytest.raises(
        LogError, match=f"^a.mcap: 5 ticks are there, and its index counts {told}.*: it was altered"
    ):
        counted(index, end)
