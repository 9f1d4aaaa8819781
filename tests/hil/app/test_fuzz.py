"""Untrusted input, damaged at random from a seed: an answer, a HilError, never a traceback, and soon."""

import os
import subprocess
import sys
from pathlib import Path
from random import Random

import numpy as np
import pytest

from drivers.tick_columns import ROW
from hil.record.log import Log
from tools.fuzz import case, container
from tools.fuzz.targets import TARGETS, stock

QUICK = {"log": 25, "configuration": 12, "csv": 20, "controller": 8, "fmu": 6, "operator": 6}
"""Cases of each kind; `make fuzz` runs thousands."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return stock(tmp_path_factory.mktemp("stock"), duration_s=0.05)


@pytest.mark.parametrize("target", TARGETS)
def test_damaged_input_is_answered(sound, target):
    results = [case.run(seed, sound, target) for seed in range(QUICK[target])]
    assert [r for r in results if r.problem not in {"", "hang"}] == []
    slow = [r for r in results if r.seconds > case.LONGEST_S]
    assert len(slow) < 3  # a first time may compile


@pytest.mark.long
@pytest.mark.parametrize("target", TARGETS)
def test_damaged_input_is_answered_from_many_seeds(sound, target):
    results = [case.run(seed, sound, target) for seed in range(1000, 1000 + 20 * QUICK[target])]
    assert [r for r in results if r.problem] == []


def test_the_fuzzer_finds_a_reader_that_fails(sound, monkeypatch):
    monkeypatch.setitem(TARGETS, "log", (lambda *_: str(int("x")), 1))
    result = case.run(1, sound, "log")
    assert result.problem == "traceback"
    assert result.detail.startswith("ValueError")
    monkeypatch.setitem(TARGETS, "log", (lambda *_: "red: \x1b[31m", 1))
    assert case.run(1, sound, "log").problem == "control character"
    monkeypatch.setitem(TARGETS, "log", (lambda *_: str(np.float64(1e308) * 10), 1))
    assert case.run(1, sound, "log").detail.startswith("RuntimeWarning"), "who reads the lines sees it"
    started: list[subprocess.Popen[bytes]] = []

    def leave(*_: object) -> str:
        started.append(subprocess.Popen(["sleep", "60"]))
        return ""

    monkeypatch.setitem(TARGETS, "log", (leave, 1))
    found = case.run(1, sound, "log")
    (process,) = started
    with process:
        process.kill()
    assert (found.problem, found.detail) == ("process", f"left behind: {process.pid}")


CRASH = """
import os, signal, sys
from types import ModuleType, SimpleNamespace

def crash(stock, rng, folder):
    (folder / "damaged.mcap").write_bytes(b"half a log")
    os.kill(os.getpid(), signal.SIGSEGV)

planted = sys.modules["tools.fuzz.targets"] = ModuleType("targets")
planted.TARGETS, planted.Stock = {"log": (crash, 1)}, SimpleNamespace
planted.stock = lambda folder: SimpleNamespace(folder=folder)
"""
"""For each process of Python, in place of the targets: a reader whose process dies."""


def test_a_crash_of_the_interpreter_is_a_finding_and_leaves_its_input_on_disk(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(CRASH)
    path = os.pathsep.join((str(tmp_path), str(Path(__file__).parents[3])))
    done = subprocess.run(
        [sys.executable, "-m", "tools.fuzz", "--seed", "7", "--cases", "2", "--only", "log"],
        env={**os.environ, "PYTHONPATH": path, "TMPDIR": str(tmp_path)},
        cwd=Path(__file__).parents[3], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "seed 7: log: died: -11" in done.stdout
    assert "2 cases from seed 7, 2 with a finding; go on with --seed 9" in done.stdout
    (folder,) = tmp_path.glob("hil-fuzz-*")
    assert str(folder) in done.stdout
    assert [(folder / seed / "damaged.mcap").read_bytes() for seed in "78"] == [b"half a log"] * 2
    assert "Segmentation fault" in (folder / "printed.txt").read_text()


def test_what_is_put_into_the_rows_of_a_log_comes_out_of_them(sound, tmp_path):
    whole, seen = Log(sound.folder / "sound.mcap").rows(), set()
    for seed in range(12):
        path = tmp_path / f"{seed}.mcap"
        path.write_bytes(container.whole(container.strange_values(container.split(sound.log), Random(seed))))
        names = [name for name in ROW.names or () if ROW[name].base.kind == "f"]
        rows = Log(path).rows(*names)
        assert len(rows) == len(whole)
        for name in names:
            seen |= set(map(repr, rows[name][rows[name] != whole[name]].tolist()))
    assert seen >= {"inf", "-inf", "nan", "1.7e+308", "5e-324"}
