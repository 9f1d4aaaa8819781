"""Commands that write a file: no foreign file is replaced, no two outputs share a file, no result is lost."""

from __future__ import annotations

import errno
import json
import os
import resource
import shlex
import shutil
import signal
import tempfile
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import load
from hil.app.files import made_whole, new_file
from hil.app.output import check_json_path, fail, further, log_path, write_json
from hil.app.sim.command import simulate
from hil.cli import main
from tests.hil.lab.test_calibrate_command import rows, write

SAID = "this command already uses that file; give another file"
FULL = "No space left on device"


def hil(line: str) -> Any:
    return CliRunner().invoke(main, shlex.split(line))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    simulate(load("ideal"), log=path, duration_s=0.1, check_replay=False)
    return path


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """An empty working folder, without a bus of another process."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    with tempfile.TemporaryDirectory(prefix="hil-") as sockets:
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        yield folder


@pytest.mark.parametrize(
    "line",
    [
        "replay --suite . --junit x",
        "replay a.mcap --what-if x",
        "replay a.mcap --set a.b=1 --log x",
        "replay a.mcap --salvage x",
        "campaign x",
        "campaign rerun nowhere.yaml 1 --log x",
        "learn a.mcap -o n.csv --axes x",
        "export a.mcap a.csv x",
        "calibrate nowhere.yaml x",
        "sim nowhere.yaml --commands x",
        "new x",
    ],
)
def test_summary_does_not_replace_another_file_of_its_command(line, here):
    result = hil(f"{line} --json x")
    assert result.exit_code == 2, result.output
    assert f"--json x: {SAID}" in result.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize(
    "line",
    [
        "design hinf nowhere.yaml -o x --plot {}",
        "bringup nowhere.yaml --state x --log {}",
    ],
)
@pytest.mark.parametrize("name", ["x", "../here/x"])
def test_two_outputs_that_are_one_file_under_different_names_are_refused(line, name, here):
    result = hil(line.format(name))
    assert (result.exit_code, SAID in result.stderr) == (2, True), result.output
    assert list(here.iterdir()) == []


OUTPUTS = {
    "check virtual --json X": "a.json",
    "sim ideal --duration 0.1 --json X": "a.json",
    "sim ideal --duration 0.1 --log X": "a.mcap",
    "plant virtual --log X": "a.mcap",
    "replay LOG --json X": "a.json",
    "stability ideal --json X": "a.json",
    "replay LOG --salvage X": "a.mcap",
    "replay LOG --set limits.force_N=1e5 --log X": "a.mcap",
    "report LOG --out X": "a.html",
    "plot LOG --out X": "a.png",
    "export LOG X": "a.csv",
    "view LOG --out X": "a.rrd",
    "replay --suite . --junit X": "a.xml",
    "faults ideal --junit X": "a.xml",
    "design hinf hinf -o X": "a.yaml",
    "identify payload LOG -o X": "a.yaml",
    "identify sensors LOG -o X": "a.yaml",
    "calibrate lab poses.csv --out X": "a.yaml",
    "learn LOG -o X": "a.csv",
    "identify virtual -o X": "a.yaml",
    "bringup virtual --rehearse --yes --state X": "a.json",
    "new X": "a.yaml",
}
"""Command -> the name of its output."""


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("line", OUTPUTS)
@pytest.mark.parametrize("there", ["theirs", "a folder", "another log"])
def test_commands_do_not_replace_an_output_file_that_they_did_not_write(log, here, line, there):
    name = OUTPUTS[line]
    write(here / "poses.csv", rows())
    if there == "a folder":
        Path(name).mkdir()
    elif there == "theirs":
        Path(name).write_text("theirs")
    else:
        shutil.copy(log, name)
    before = files(here)
    result = hil(line.replace("LOG", str(log)).replace("X", name))
    assert (result.exit_code, name in result.stderr) == (2, True), result.output
    assert files(here) == before
    if there != "a folder":
        assert Path(name).read_bytes() == (b"theirs" if there == "theirs" else log.read_bytes())


@pytest.mark.parametrize(
    "line", [each for each in OUTPUTS if each.startswith(("report", "plot", "view", "export"))]
)
def test_option_force_does_not_replace_a_log(log, here, line):
    other = shutil.copy(log, here / OUTPUTS[line])
    result = hil(f"{line.replace('LOG', str(log)).replace('X', OUTPUTS[line])} --force")
    assert (result.exit_code, "no log is ever overwritten" in result.stderr) == (2, True), result.output
    assert other.read_bytes() == log.read_bytes()


EARLY = [
    line for line, name in OUTPUTS.items() if not name.endswith("mcap") and not line.startswith("bringup")
]
"""Commands that need an existing folder: not for logs, and a bring-up checks its own later."""


@pytest.mark.parametrize("line", EARLY)
def test_output_in_a_missing_folder_is_refused_before_the_work_begins(log, here, line):
    write(here / "poses.csv", rows())
    result = hil(line.replace("LOG", str(log)).replace("X", f"nowhere/{OUTPUTS[line]}"))
    assert (result.exit_code, "nowhere" in result.stderr) == (2, True), result.output
    assert files(here) == [here / "poses.csv"]


@pytest.mark.parametrize("text", ['["success", 1]', "{}", '{"a": "success"}', "null", "notes", "[" * 100_000])
def test_summary_replaces_only_an_earlier_summary(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(LogError, match="is not a summary of hil and is not overwritten"):
        check_json_path(path)
    for earlier in ('{"success": false}', ""):
        path.write_text(earlier)
        check_json_path(path)


@pytest.mark.parametrize("force", [False, True])
def test_pipe_is_never_replaced_by_a_file(tmp_path, force):
    pipe = tmp_path / "pipe.html"
    os.mkfifo(pipe)
    with pytest.raises(LogError, match="is a device or a pipe"):
        new_file(pipe, force=force)
    assert pipe.is_fifo()


def test_dangling_link_is_refused_as_the_name_of_a_log(tmp_path):
    link = tmp_path / "link.mcap"
    link.symlink_to(tmp_path / "unmounted.mcap")
    with pytest.raises(LogError, match="exists and is not overwritten"):
        log_path("", "a", link)


def test_logs_of_the_same_second_get_different_names(tmp_path, monkeypatch):
    monkeypatch.setattr("time.strftime", lambda *_: "20260131T120000")
    first = log_path(str(tmp_path), "bench", None, "-plant")
    first.touch()
    second = log_path(str(tmp_path), "bench", None, "-plant")
    assert [first.name, second.name] == [
        "bench-20260131T120000-plant.mcap",
        "bench-20260131T120000-2-plant.mcap",
    ]


def test_summary_with_numbers_that_are_not_finite_is_valid_json(tmp_path):
    write_json(tmp_path / "a.json", {"success": True, "x": float("nan"), "y": [float("inf"), 1.5]})
    assert json.loads((tmp_path / "a.json").read_text()) == {"success": True, "x": None, "y": [None, 1.5]}


# -- the disk is full ----------------------------------------------------------------------------------------


@pytest.fixture
def small_files():
    """Limit of 2 kB for every file, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


FORMATS = {
    "html": "report LOG --out",
    "png": "plot LOG --out",
    **dict.fromkeys(("log", "asc", "blf", "csv", "parquet"), "export LOG"),
}


@pytest.mark.parametrize("ending", FORMATS)
def test_output_on_a_full_disk_is_reported_and_leaves_no_file(log, here, small_files, ending):
    done = hil(f"{FORMATS[ending].replace('LOG', str(log))} a.{ending}")
    assert done.exit_code == 2
    assert done.stderr.startswith(f"hil: a.{ending}: ")
    assert done.stderr.endswith("File too large\n")
    assert list(here.iterdir()) == []


def test_failed_write_of_an_output_keeps_the_earlier_file(here):
    out = here / "a.csv"
    out.write_text("old")

    def half():
        with made_whole(out, overwrite=True) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        half()
    assert [p.name for p in here.iterdir()] == ["a.csv"]
    assert out.read_text() == "old"


def test_output_file_created_by_others_during_the_work_is_not_replaced(tmp_path):
    out = tmp_path / "a.yaml"
    with pytest.raises(LogError, match="exists and is not overwritten"), made_whole(out, overwrite=False):
        out.write_text("theirs")
    assert out.read_text() == "theirs"


def test_summary_keeps_an_earlier_error_when_a_later_one_is_added():
    summary: dict[str, Any] = {"success": True, "trouble": None}
    for why in ("", "the recorder stopped", "the picture failed"):
        fail(summary, why)
    assert summary == {"success": False, "trouble": "the recorder stopped; the picture failed"}


@pytest.mark.parametrize("success", [True, False])
def test_summary_lists_each_output_that_failed_and_keeps_the_figures(success):
    summary: dict[str, Any] = {"success": success, "figure": 7}
    with further(summary):
        summary["one"] = 1
    assert summary == {"success": success, "figure": 7, "one": 1}
    for error in (
        OSError(errno.ENOSPC, FULL, "a.png"),
        LogError("b.xml: full"),
        ConfigurationError("c: full"),
    ):
        with further(summary):
            raise error
    said = [f"a.png: {FULL}", "b.xml: full", "c: full"]
    assert summary == {"success": False, "figure": 7, "one": 1, "unwritten": said}


@pytest.fixture
def full_disk(monkeypatch):
    """A disk with room for the summary only."""
    replace = Path.replace

    def full(self, target):
        if Path(target).suffix != ".json":
            raise OSError(errno.ENOSPC, FULL)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", full)


@pytest.mark.parametrize(
    ("line", "output", "figure"),
    [
        ("replay --suite FOLDER --jobs 1 --junit a.xml", "a.xml", "passed"),
        ("calibrate lab poses.csv --out a.yaml", "a.yaml", "base_joints_m"),
    ],
)
def test_json_summary_has_the_figures_of_an_unwritten_output(here, log, full_disk, line, output, figure):
    write(here / "poses.csv", rows())
    result = hil(f"{line.replace('FOLDER', str(log.parent))} --json a.json")
    assert result.exit_code == 1, result.output
    found = json.loads(Path("a.json").read_text())
    assert not found["success"]
    assert figure in found, sorted(found)
    assert (output in found["unwritten"][0], FULL in result.stderr) == (True, True)
    assert not Path(output).exists()
