"""What standard output or error cannot take ends no command, and costs no result: one line and the exit code say so."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import pytest

from drivers.errors import HilError
from hil.app.output import show, show_lines
from hil.cli import check, main
from hil.cli.shared import finish, finish_briefly, finish_lines

FULL = "cannot be written: No space left on device\n"
GOOD = {"success": True, "kind": "check", "text": "a"}
Invoked = Callable[[Callable[[Path], Any]], int]


@pytest.fixture
def json_file(tmp_path: Path) -> Path:
    return tmp_path / "a.json"


@pytest.fixture
def invoked(monkeypatch: pytest.MonkeyPatch, json_file: Path) -> Invoked:
    """Be the process of a command that does some work; its exit code."""

    def invoke(work: Callable[[Path], Any]) -> int:
        monkeypatch.setattr("sys.argv", ["hil", "check", "--json", str(json_file)])
        monkeypatch.setattr(check, "load", lambda *_: work(json_file))
        with pytest.raises(SystemExit) as ended:
            main()
        assert isinstance(ended.value.code, int)
        return ended.value.code

    return invoke


def table_and_figures(file: Path) -> None:
    show("a table", {"success": True, "text": "b " * 9999})
    finish("check", GOOD, file)


ENDS: dict[str, Callable[[Path], Any]] = {
    "figures": lambda file: finish("check", GOOD, file),
    "few figures": lambda file: finish_briefly("check", GOOD, file),
    "lines": lambda file: finish_lines(["a"], GOOD, file),
    "many lines": lambda file: finish_lines(["a" * 70] * 999, GOOD, file),
    "a table before": table_and_figures,
}


@pytest.fixture(params=[-1, 0], ids=["buffered", "unbuffered"])
def full(request: pytest.FixtureRequest) -> Iterator[TextIO]:
    """A file on a full disk; Python leaves out the buffer where PYTHONUNBUFFERED is set."""
    with contextlib.suppress(OSError), Path("/dev/full").open("wb", buffering=request.param) as file:
        yield io.TextIOWrapper(file)


@pytest.mark.parametrize("end", ENDS.values(), ids=ENDS)
def test_a_full_disk_behind_the_output_costs_no_result_and_is_no_refusal(
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


def test_a_full_disk_behind_the_output_leaves_a_refusal_what_it_is(
    invoked: Invoked, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], full: TextIO
) -> None:
    def refused(_: Path) -> None:
        show_lines(["a"])
        raise HilError("no such file")

    monkeypatch.setattr("sys.stdout", full)
    assert invoked(refused) == 2
    assert capsys.readouterr().err == f"hil: no such file\nhil: standard output {FULL}"


@pytest.mark.parametrize("success", [True, False])
def test_messages_that_cannot_be_written_cost_no_result_either(
    invoked: Invoked,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    json_file: Path,
    full: TextIO,
    success: bool,
) -> None:
    monkeypatch.setattr("sys.stderr", full)
    summary = {"success": success, "kind": "check", "trouble": "what nobody reads"}
    assert invoked(lambda file: finish("check", summary, file)) == 1
    assert capsys.readouterr().out.startswith(f"check: {'success' if success else 'failed'}\n")
    assert json_file.exists()


@pytest.mark.parametrize("end", [finish, finish_briefly])
def test_what_went_wrong_is_said_on_standard_error(
    invoked: Invoked, capsys: pytest.CaptureFixture[str], end: Callable[..., None]
) -> None:
    summary = {"success": False, "kind": "check", "trouble": "nobody answers"}
    assert invoked(lambda file: end("check", summary, file)) == 1
    assert "hil: nobody answers\n" in capsys.readouterr().err


@pytest.mark.parametrize(("encoding", "shown"), [("latin-1", "\xe9 \\u2013"), ("ascii", "\\xe9 \\u2013")])
@pytest.mark.parametrize("form", ["figures", "lines"])
def test_a_sign_that_the_locale_has_not_is_shown_as_its_number(
    invoked: Invoked,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    json_file: Path,
    encoding: str,
    shown: str,
    form: str,
) -> None:
    out, text = tmp_path / "out.txt", "\xe9 \u2013"
    work = {
        "figures": lambda file: finish("check", GOOD | {"text": text}, file),
        "lines": lambda file: finish_lines([text], GOOD, file),
    }[form]
    with out.open("w", encoding=encoding) as stream, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", stream)
        assert invoked(work) == 0
    assert shown in out.read_text(encoding=encoding)
    assert json_file.exists()


@pytest.mark.parametrize("end", list(ENDS.values())[:4], ids=list(ENDS)[:4])
def test_the_json_is_there_although_nobody_reads_the_summary(
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


@pytest.mark.parametrize("end", list(ENDS.values())[:3], ids=list(ENDS)[:3])
def test_a_summary_whose_json_cannot_be_written_is_shown_and_is_no_refusal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], end: Callable[[Path], Any]
) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    shutil.rmtree(folder)
    with pytest.raises(SystemExit) as ended:
        end(folder / "a.json")
    assert ended.value.code == 1
    out, error = capsys.readouterr()
    assert out
    assert error == f"hil: --json {folder}/a.json: cannot be written: {os.strerror(2)}\n"
