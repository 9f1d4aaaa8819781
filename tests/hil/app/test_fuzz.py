"""What strangers hand in, damaged at random from a seed: an answer, a HilError, never a traceback, and soon."""

import subprocess
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
