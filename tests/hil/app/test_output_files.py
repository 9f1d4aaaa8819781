"""Two output files of one command are never the same one: it is refused before the work begins."""

from __future__ import annotations

import fcntl
import json
import os
import select
import shlex
import struct
import termios
from pathlib import Path
from threading import Thread

import pytest
from click.testing import CliRunner

from hil.app.output import write_json
from hil.cli import main

SAID = "is another file of this command; name a file of its own"


def hil(line):
    return CliRunner().invoke(main, shlex.split(line))


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty folder to work in, with a link to where one of the files will be."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "link").symlink_to("x")
    return folder


@pytest.mark.parametrize(
    "line",
    [
        "replay --suite . --junit x",
        "replay a.mcap --against x",
        "replay a.mcap --what-if x",
        "replay a.mcap --set a.b=1 --plot x",
        "replay a.mcap --set a.b=1 --log x",
        "replay a.mcap --salvage x",
        "faults nowhere.yaml --junit x",
        "campaign nowhere.yaml --junit x",
        "campaign nowhere.yaml --page x",
        "campaign nowhere.yaml --out x",
        "campaign x",
        "campaign rerun nowhere.yaml 1 --log x",
        "design hinf nowhere.yaml --plot x",
        "design hinf nowhere.yaml -o x",
        "design hinf nowhere.yaml --model x",
        "design hinf nowhere.yaml --robot x",
        "design hinf x",
        "learn a.mcap -o n.csv --axes x",
        "learn a.mcap x -o n.csv",
        "plot a.mcap x",
        "export a.mcap a.csv x",
        "identify payload a.mcap x",
        "identify nowhere.yaml --model x",
        "calibrate nowhere.yaml x",
        "sim nowhere.yaml --setpoints x",
        "sim nowhere.yaml --commands x",
        "bringup nowhere.yaml --state x",
        "new x",
    ],
)
def test_a_summary_takes_the_place_of_no_other_file_that_the_command_names(line, here):
    result = hil(f"{line} --json x")
    assert result.exit_code == 2, result.output
    assert f"--json x: {SAID}" in result.stderr
    assert [file.name for file in here.iterdir()] == ["link"]


@pytest.mark.parametrize(
    ("line", "option"),
    [
        ("replay a.mcap --set a.b=1 --plot x --log {}", "--log"),
        ("replay a.mcap --set a.b=1 --salvage x --log {}", "--log"),
        ("replay a.mcap --set a.b=1 --salvage x --plot {}", "--plot"),
        ("campaign nowhere.yaml --page x --junit {}", "--junit"),
        ("campaign nowhere.yaml --junit x --page {}", "--junit"),
        ("design hinf nowhere.yaml -o x --plot {}", "--plot"),
        ("identify nowhere.yaml -o x --log {}", "--log"),
        ("bringup nowhere.yaml --state x --log {}", "--log"),
    ],
)
def test_no_two_other_outputs_are_one_file(line, option, here):
    result = hil(line.format("x"))
    assert result.exit_code == 2, result.output
    assert SAID in result.stderr
    assert f"{option} " in result.stderr
    assert [file.name for file in here.iterdir()] == ["link"]


@pytest.mark.parametrize(
    "line", ["design hinf nowhere.yaml -o x --plot {}", "faults nowhere.yaml --junit x --json {}"]
)
@pytest.mark.parametrize("name", ["./x", "../here/x", "link"])
def test_one_file_is_the_same_by_whatever_name(line, name):
    assert SAID in hil(line.format(name)).stderr


@pytest.mark.parametrize(
    "line", ["design hinf nowhere.yaml -o y --plot x.png", "campaign nowhere.yaml --page x"]
)
def test_files_of_different_names_are_no_reason_to_refuse(line):
    result = hil(f"{line} --json z")
    assert "nowhere.yaml" in result.stderr
    assert SAID not in result.stderr


def test_the_files_of_two_folders_may_have_one_name(here: Path):
    for folder in ("a", "b"):
        (here / folder).mkdir()
    assert SAID not in hil("design hinf nowhere.yaml -o a/x --plot b/x.png --json x").stderr


def waiting_bytes(fd: int) -> int:
    return int(struct.unpack("i", fcntl.ioctl(fd, termios.FIONREAD, bytes(4)))[0])


def test_a_summary_larger_than_a_pipe_holds_goes_into_it_whole_however_late_it_is_read(here: Path) -> None:
    os.mkfifo(here / "pipe")
    reader = os.open(here / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    os.set_blocking(reader, True)
    room = fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 4096)
    summary = {"success": True, "ticks": list(range(2 * room))}
    writing = Thread(target=write_json, args=(here / "pipe", summary))
    writing.start()
    while waiting_bytes(reader) < room and writing.is_alive():
        select.select([reader], [], [], 10.0)
    with os.fdopen(reader, "rb") as file:
        found = file.read()
    writing.join()
    assert json.loads(found) == summary
