"""Files that a command writes: whole or not at all, and in the place of nothing that is not its own."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from hil.app.configuration.configuration import load
from hil.app.configuration.section_file import check_section_path
from hil.app.files import beginning, made_whole, new_file, printable
from hil.app.output import check_json_path, log_path, picture_path
from hil.app.sim.command import simulate
from hil.cli import main
from hil.config.axis_model import AxisModel
from hil.lab.identify.payload_block import REMARK


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    simulate(load("ideal"), log=path, duration_s=0.1, check_replay=False)
    return path


def hil(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture
def small_files():
    """No file may grow beyond 2 kB, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("force", [False, True])
def test_a_device_or_a_pipe_is_never_replaced_by_a_file(tmp_path, force):
    pipe = tmp_path / "pipe.html"
    os.mkfifo(pipe)
    with pytest.raises(LogError, match="is a device or a pipe"):
        new_file(pipe, force=force)
    assert pipe.is_fifo()


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_and_a_missing_folder_are_refused(tmp_path, force):
    with pytest.raises(LogError, match="is a folder"):
        new_file(tmp_path, force=force)
    with pytest.raises(LogError, match="there is no folder"):
        new_file(tmp_path / "no" / "a.html", force=force)


CHECKS: dict[str, Callable[[Path], object]] = {
    "--json": check_json_path,
    "--picture": lambda path: picture_path("", "", path),
    "--out": lambda path: new_file(path, force=True),
    "-o": lambda path: check_section_path("-o", path, AxisModel),
}


@pytest.mark.parametrize("way", ["there", "new", "a link", "a link to nothing"])
@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS)
def test_an_output_in_a_folder_that_takes_no_new_file_is_refused_before_the_work(
    tmp_path, monkeypatch, check, way
):
    closed, name = tmp_path / "closed", "a.png"
    closed.mkdir()
    if "new" not in way and "nothing" not in way:
        (closed / name).touch()
    path = closed / name
    if "link" in way:
        path = tmp_path / name
        path.symlink_to(closed / name)
    monkeypatch.setattr("os.access", lambda at, mode: not (Path(at) == closed and mode & os.W_OK))
    with pytest.raises(LogError, match=r"a\.png: no right to write there"):
        check(path)


@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS)
def test_an_earlier_output_that_may_not_be_written_is_not_replaced(tmp_path, monkeypatch, check):
    path = tmp_path / "a.png"
    path.touch()
    monkeypatch.setattr("os.access", lambda at, mode: not (Path(at) == path and mode & os.W_OK))
    with pytest.raises(LogError, match=r"a\.png: no right to write there"):
        check(path)


def test_a_summary_goes_into_a_pipe_whatever_its_folder_takes(tmp_path, monkeypatch):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    monkeypatch.setattr("os.access", lambda at, _: Path(at) == pipe)
    check_json_path(pipe)


@pytest.mark.parametrize(
    "text",
    [
        '["success", 1]',
        '"success"',
        '"no success"',
        "{}",
        '{"a": "success"}',
        "7",
        "null",
        "notes",
        "[" * 100_000,
    ],
)
def test_a_file_that_is_no_summary_is_not_overwritten_by_one(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(LogError, match="is not a summary of hil and is not overwritten"):
        check_json_path(path)
    for earlier in ('{"success": false}', ""):
        path.write_text(earlier)
        check_json_path(path)


@pytest.mark.parametrize("text", ["kind: another\n", "a: 1\n", "- 1\n", "kind: [\n"])
def test_a_file_that_is_no_section_of_that_kind_is_not_overwritten_by_one(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(LogError, match=r"^-o .*a\.yaml: exists, is not a file of kind axis-model and is not"):
        check_section_path("-o", path, AxisModel)


def test_a_link_to_nothing_is_no_name_for_a_log(tmp_path):
    link = tmp_path / "link.mcap"
    link.symlink_to(tmp_path / "unmounted.mcap")
    with pytest.raises(LogError, match="exists and is not overwritten"):
        log_path("", "a", link)


def test_an_earlier_file_of_the_same_command_is_replaced_and_no_other_one(tmp_path):
    mine, other = tmp_path / "mine.yaml", tmp_path / "other.yaml"
    mine.write_text(f"{REMARK}a: 1\n")
    other.write_text("a: 1\n")
    own = beginning("a file of hil", REMARK.encode())
    assert new_file(mine, option="-o", own=own) == mine
    with pytest.raises(LogError, match=r"^-o .*other\.yaml: exists, is not a file of hil and is not over"):
        new_file(other, option="-o", own=own)
    with pytest.raises(LogError, match="add --force"):
        new_file(mine, force=False)


def test_a_command_without_force_does_not_advise_it(tmp_path):
    page = tmp_path / "page.html"
    page.touch()
    done = hil("campaign", "payload", "--page", page)
    said = f"hil: --page {page}: exists and is not overwritten; name another file\n"
    assert (done.exit_code, done.stderr) == (2, said)


def test_a_file_that_comes_while_one_is_made_stays_and_no_option_is_advised(tmp_path):
    """Also the file of a command without --force."""
    out = tmp_path / "a.yaml"
    said = f"^{re.escape(str(out))}: exists and is not overwritten; name another file$"
    with pytest.raises(LogError, match=said), made_whole(out, overwrite=False):
        out.write_text("theirs")
    assert out.read_text() == "theirs"


@pytest.mark.parametrize("words", [["export"], ["report", "--out"], ["plot", "--out"]], ids=" ".join)
def test_no_command_writes_over_another_log(path, tmp_path, words):
    name = {"export": "b.log", "report": "b.html", "plot": "b.png"}[words[0]]
    shutil.copy(path, tmp_path / name)
    done = hil(words[0], path, *words[1:], tmp_path / name, "--force")
    assert (done.exit_code, "no log is ever overwritten" in done.stderr) == (2, True)
    assert (tmp_path / name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    "name", ["a.log", "a.asc", "a.blf", "a.csv", "a.parquet", "a.html", "a.png", "a.svg"]
)
def test_a_full_disk_leaves_nothing_behind_and_the_message_names_the_file(path, tmp_path, small_files, name):
    words = {
        "html": ["report", path, "--out"],
        "png": ["plot", path, "--out"],
        "svg": ["plot", path, "--out"],
    }
    out = tmp_path / name
    done = hil(*words.get(name.partition(".")[2], ["export", path]), out)
    assert done.exit_code == 2
    assert f"{out}: cannot be written: " in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_utf_8_whatever_the_locale_says(tmp_path):
    out = tmp_path / "a.html"
    program = f"from pathlib import Path; from hil.app.files import write_whole; write_whole(Path({str(out)!r}), chr(0x2013))"
    plain = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    subprocess.run([sys.executable, "-c", program], env=os.environ | plain, check=True)
    assert out.read_bytes() == "–".encode()


def test_a_name_is_shown_whatever_the_locale_says():
    program = "from hil.app.files import printable as p; print(ascii(p(chr(0xe9) + chr(0x2013))))"
    plain = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=os.environ | plain, check=True, capture_output=True)
    assert done.stdout == b"'\\xe9\\u2013'\n"


def test_halves_of_signs_are_shown_as_signs():
    assert printable("a\udcc3\udca9") == "a\xe9", "bytes of a name"
    for half in ("\udcff", "\ud800", "\ud83d", "\udc7f", "\udd00", "\udfff"):
        assert printable(f"a{half}b") == "a\ufffdb", ascii(half)


def test_what_fails_leaves_the_earlier_file(tmp_path):
    out = tmp_path / "a.csv"
    out.write_text("old")

    def half():
        with made_whole(out, overwrite=True) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        half()
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
    assert out.read_text() == "old"


def test_a_name_that_is_no_text_is_shown_with_signs_in_its_place(path, tmp_path):
    odd = tmp_path / os.fsdecode(b"a\xff.mcap")
    shutil.copy(path, odd)
    assert printable(odd.name) == "a�.mcap"
    for words in (["report", odd], ["plot", odd, "-c", "mode"], ["export", odd, tmp_path / "a.log"]):
        assert hil(*words).exit_code == 0, words
    assert "<h1>a�.mcap</h1>" in odd.with_suffix(".html").read_text(encoding="utf-8")
