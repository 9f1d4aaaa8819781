"""Names of logs and pictures that two runs choose in the same second, before either has made its file."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hil.app import reserved as reservations
from hil.app.output import log_path, picture_path
from hil.app.reserved import reserved

CHILD = """
import sys
from pathlib import Path
from hil.app.reserved import reserved
print(reserved(Path(sys.argv[1])), flush=True)
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.strftime", lambda *_: "20260131T120000")


@pytest.mark.parametrize("suffix", ["", "-plant"])
def test_runs_of_the_same_second_get_names_of_their_own_before_their_logs_are_there(
    tmp_path: Path, suffix: str
) -> None:
    names = [log_path(str(tmp_path / "runs"), "bench", None, suffix).name for _ in range(3)]
    assert names == [f"bench-20260131T120000{number}{suffix}.mcap" for number in ("", "-2", "-3")]
    assert list((tmp_path / "runs").iterdir()) == []


@pytest.mark.parametrize("given", [None, "."])
def test_pictures_of_the_same_second_do_not_replace_each_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str | None
) -> None:
    monkeypatch.chdir(tmp_path)
    first = picture_path(str(tmp_path), "a", None if given is None else Path(given))
    first.write_bytes(b"\x89PNG\r\n")
    second = picture_path(str(tmp_path), "a", None if given is None else Path(given))
    third = picture_path(str(tmp_path), "a", None)
    names = [first.name, second.name, third.name]
    assert names == [f"a-20260131T120000{number}.png" for number in ("", "-2", "-3")]


def test_a_name_that_was_given_is_not_another_one_the_second_time(tmp_path: Path) -> None:
    given = tmp_path / "a.mcap"
    assert [log_path("", "bench", given) for _ in range(2)] == [given, given]


def test_a_name_is_another_process_own_until_that_ends(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    (tmp_path / "link").symlink_to(tmp_path)
    words = [sys.executable, "-c", CHILD, str(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "True\n"
        assert not reserved(path)
        assert not reserved(tmp_path / "link" / "a.mcap"), "the same file by another way"
        assert reserved(tmp_path / "b.mcap")
        other.kill()
        other.wait()
        assert reserved(path)
    assert not reserved(path)


def test_a_name_whose_file_was_made_is_held_no_longer(tmp_path: Path) -> None:
    paths = [tmp_path / f"{n}.mcap" for n in range(3)]
    for path in paths:
        assert reserved(path)
        path.touch()
    assert [path for path in reservations._held if path.parent == tmp_path] == [paths[-1]]


@pytest.mark.parametrize("missing", ["socket", "name"])
def test_a_system_without_such_names_refuses_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    def refused(*_: Any) -> Any:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    class Nameless(socket.socket):
        bind = refused

    monkeypatch.setattr("hil.app.reserved.socket.socket", refused if missing == "socket" else Nameless)
    for _ in range(2):
        assert log_path(str(tmp_path), "bench", None).name == "bench-20260131T120000.mcap"
