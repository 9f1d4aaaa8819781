"""Output to a closed pipe or a full disk loses no result."""

from __future__ import annotations

import contextlib
import io
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import pytest

from hil.app.output import show
from hil.cli import check, main, shared
from hil.cli.shared import finish, finish_lines

FULL = "cannot be written: No space left on device\n"
GOOD = {"success": True, "kind": "check", "text": "a"}
Invoked = Callable[[Callable[[Path], Any]], int]


@pytest.fixture
def json_file(tmp_path: Path) -> Path:
    return tmp_path / "a.json"


@pytest.fixture
def invoked(monkeypatch: pytest.MonkeyPatch, json_file: Path) -> Invoked:
    """Run a command with the given work in this process; return its exit code."""

    def invoke(work: Callable[[Path], Any]) -> int:
        monkeypatch.setattr("sys.argv", ["hil", "check", "--json", str(json_file)])
        monkeypatch.setattr(check, "load", lambda *_: work(json_file))
        with pytest.raises(SystemExit) as ended:
            main()
        assert isinstance(ended.value.code, int)
        return ended.value.code

    return invoke


def table_and_figures(_: Path) -> None:
    show("a table", {"success": True, "text": "b " * 9999})
    finish("check", GOOD)


ENDS: dict[str, Callable[[Path], Any]] = {
    "figures": lambda _: finish("check", GOOD),
    "many lines": lambda _: finish_lines(["a" * 70] * 999, GOOD),
    "a table before": table_and_figures,
}


@pytest.fixture(params=[-1, 0], ids=["buffered", "unbuffered"])
def full(request: pytest.FixtureRequest) -> Iterator[TextIO]:
    """A file on a full disk, with and without a buffer (PYTHONUNBUFFERED)."""
    with contextlib.suppress(OSError), Path("/dev/full").open("wb", buffering=request.param) as file:
        yield io.TextIOWrapper(file)


@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_standard_output_on_a_full_disk_loses_no_result(
    invoked: Invoked,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    json_file: Path,
    full: TextIO,
    end: Callable[[Path], Any],
) -> None:
    monkeypatch.setattr("sys.stdout", full)
    assert invoked(end) == 1
    assert capsys.readouterr().err == f"hil: standard output {FULL}"
    assert json_file.read_text().startswith('{\n  "success": true')


@pytest.mark.parametrize("end", list(ENDS.values())[:2], ids=list(ENDS)[:2])
def test_json_summary_is_written_even_if_the_output_pipe_is_closed(
    invoked: Invoked,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    json_file: Path,
    end: Callable[[Path], Any],
) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream:
        monkeypatch.setattr("sys.stdout", stream)
        assert invoked(end) == 141
    assert capsys.readouterr().err == ""
    assert json_file.exists()


@pytest.mark.parametrize("kept", [0, 900])
def test_remaining_time_of_a_continued_campaign_is_estimated_from_its_new_rows_only(
    kept: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr("hil.cli.shared.time.monotonic", lambda: now)
    with shared.counted("rows") as count:
        count(kept, kept + 100)
        now = 30.0
        count(kept + 25, kept + 100)
    assert capsys.readouterr().err == f"rows: {kept + 25} of {kept + 100}, 0:01:30 left\n"


def test_output_closed_at_the_start_does_not_change_the_exit_code(tmp_path: Path) -> None:
    command = f"{shlex.quote(sys.executable)} -m hil.cli schema --help >&- 2>{tmp_path / 'err'}"
    done = subprocess.run(["sh", "-c", command], check=False, timeout=60.0)
    assert (done.returncode, "Traceback" in (tmp_path / "err").read_text()) == (0, False)
