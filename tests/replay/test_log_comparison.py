"""Comparison of two logs: the first divergence of each column, under stated tolerances."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, LogError
from drivers.signals import Mode
from drivers.tick_columns import COLUMNS, RECORDED, ROW
from hil.cli import main
from hil.record.log import Log
from hil.study.log_comparison import against, first_motion, read_tolerances
from tests.replay.short_run import moved

NAMES = ("tick", "t_ns", "mode", "tau")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("against") / "run.mcap")


class MadeUp:
    """A log of synthetic rows, read in blocks, with the names and metadata of a run."""

    path = "made.mcap"
    topic = "/tick"
    metadata = {"hil": {"rate_Hz": "1000"}}
    columns = tuple(COLUMNS[name] for name in NAMES)

    def __init__(self, ticks, size=3, tau=0.0, mode=0, zero_ns=0):
        self.rows = np.zeros(len(ticks), ROW)
        self.rows["tick"], self.rows["tau"], self.rows["mode"] = ticks, tau, mode
        self.rows["t_ns"] = zero_ns + 1_000_000 * np.asarray(ticks, np.int64)
        self.size = size
        self.origin_ns = int(self.rows["t_ns"][0]) if len(ticks) else 0

    def blocks(self, *names):
        for n in range(0, len(self.rows), self.size):
            yield self.rows[n : n + self.size].copy()


Made: Any = MadeUp


@pytest.fixture
def made(monkeypatch):
    """A function that compares two synthetic logs."""

    def compare(one, other, *words, align="tick"):
        logs = {"one": one, "other": other}
        monkeypatch.setattr(Log, "open", lambda path: logs[path.name])
        return against(Path("one"), Path("other"), words, align=align)

    return compare


@pytest.mark.parametrize("sizes", [(1, 1), (3, 7), (7, 3), (50, 2), (50, 50)])
def test_rows_are_paired_by_tick_number_for_any_block_size(sizes, made):
    rng = np.random.default_rng(1)
    a, b = (np.flatnonzero(rng.random(40) < 0.7) for _ in range(2))
    one, other = (Made(ticks, size, tau=ticks[:, None]) for ticks, size in zip((a, b), sizes, strict=True))
    other.rows["tau"][b == 30] += 1.0
    found = made(one, other)
    both = sorted(set(a) & set(b))
    assert found["ticks_compared"] == len(both)
    for key, lone in (("only_in_log", set(a) - set(b)), ("only_in_other", set(b) - set(a))):
        assert found[key] == {"ticks": len(lone), "first": min(lone)}
    (tau,) = found["columns"]
    assert (tau["column"], tau["ticks"], tau["first"]["tick"]) == ("tau", 1, 30)
    assert 30 in both


def test_log_equals_itself_and_a_log_with_another_clock_origin(log, made):
    result = CliRunner().invoke(main, ["replay", str(log), "--against", str(log)])
    assert result.exit_code == 0, result.output
    assert "none" in result.stdout
    found = made(Made(range(9)), Made(range(9), zero_ns=10**15))
    assert (found["success"], found["ticks_compared"], found["diverging"]) == (True, 9, [])


def test_first_divergence_of_a_column_is_reported_with_both_values(log, tmp_path):
    other = moved(tmp_path / "other.mcap", controller={"wn_rad_s": 25})
    words = ["replay", str(log), "--against", str(other), "--json", str(tmp_path / "a.json")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 1, result.output
    assert "tau.leg_" in result.stdout
    columns = json.loads((tmp_path / "a.json").read_text())["columns"]
    (tau,) = [each for each in columns if each["column"] == "tau"]
    one, two = (Log(path).rows() for path in (log, other))
    count = min(len(one), len(two))
    a, b = one["tau"][:count], two["tau"][:count]
    differs = (a != b).any(axis=1)
    row = int(differs.argmax())
    assert (tau["first"]["tick"], tau["ticks"], tau["unit"]) == (one["tick"][row], int(differs.sum()), "N")
    assert tau["largest"] == pytest.approx(np.abs(a - b).max(), rel=1e-12)
    leg = int(tau["first"]["element"].removeprefix("tau.leg_"))
    assert (tau["first"]["log"], tau["first"]["other"]) == (
        repr(a[row, leg].item()),
        repr(b[row, leg].item()),
    )


def test_tolerance_applies_to_its_column_and_inf_ignores_it(made):
    one, other = Made(range(9), tau=1.0, mode=5), Made(range(9), tau=1.4, mode=6)
    assert made(one, other)["diverging"] == ["mode", "tau"]
    assert made(one, other, "tau=0.5")["diverging"] == ["mode"]
    assert made(one, other, "tau=0.3", "mode=inf")["diverging"] == ["tau"]
    found = made(one, other, "0.5", "mode=inf")
    assert (found["success"], found["diverging"]) == (True, [])
    assert made(one, other, "inf", "tau=0.3")["diverging"] == ["tau"]
    assert made(one, other, "inf", "tau=0.5")["success"]
    shown = {each["column"]: (each["largest"], each["tolerance"]) for each in found["columns"]}
    assert shown == {"mode": (None, "not judged"), "tau": (pytest.approx(0.4), 0.0)}


def test_shorter_log_or_missing_tick_is_a_divergence(made):
    found = made(Made(range(9)), Made(range(7)))
    assert (found["success"], found["only_in_log"]) == (False, {"ticks": 2, "first": 7})
    found = made(Made([0, 1, 3]), Made(range(4)))
    assert (found["success"], found["only_in_other"]) == (False, {"ticks": 1, "first": 2})
    for words, success in (
        (["tick=1"], True),
        (["tick=0"], False),
        (["inf"], True),
        (["inf", "tick=0"], False),
    ):
        assert made(Made([0, 1, 3]), Made(range(4)), *words)["success"] is success


def test_align_motion_pairs_logs_at_the_first_moving_tick(made):
    modes = [Mode.LOADING] * 4 + [Mode.RELEASING] * 2 + [Mode.APPROACH] * 2 + [Mode.TRACKING] * 4
    tau = np.arange(12.0)[:, None] * np.ones(6)
    early, late = Made(range(12), tau=tau, mode=modes), Made(range(15), zero_ns=50)
    late.rows[["tau", "mode"]][:3] = 0
    late.rows["tau"][3:], late.rows["mode"][3:] = tau, modes
    assert first_motion(early) == (6, 6_000_000)
    assert first_motion(late) == (9, 9_000_050)
    assert not made(early, late)["success"]
    found = made(early, late, align="motion")
    assert (found["success"], found["ticks_compared"]) == (True, 6)
    late.rows["tau"][12, 2] += 1.0
    found = made(early, late, align="motion")
    (column,) = found["columns"]
    assert (column["column"], column["first"]["tick"], column["first"]["time_s"]) == ("tau", 9, 0.003)
    with pytest.raises(LogError, match=r"never moves, .* --align tick"):
        made(early, Made(range(5)), align="motion")


def test_columns_in_one_log_only_are_listed_but_not_compared(made):
    one, other = Made(range(4)), Made(range(4))
    one.columns = (*one.columns, COLUMNS["age"])
    other.columns = (COLUMNS["condition"], *other.columns[:-1], COLUMNS["tau"]._replace(type=int))
    found = made(one, other)
    assert found["success"]
    assert (found["columns_only_in_log"], found["columns_only_in_other"]) == (["age"], ["condition"])
    assert found["columns_of_another_type"] == ["tau"]
    assert found["columns_compared"] == 3


def test_logs_that_cannot_be_compared_are_refused(made):
    plant, slow = Made(range(3)), Made(range(3))
    plant.topic, slow.metadata = "/plant", {"hil": {"rate_Hz": "500"}}
    with pytest.raises(LogError, match=r"topic of .*: /tick, of made\.mcap: /plant"):
        made(Made(range(3)), plant)
    with pytest.raises(LogError, match=r"rate in Hz of .*: 1000, of made\.mcap: 500"):
        made(Made(range(3)), slow)
    with pytest.raises(LogError, match="no tick in common"):
        made(Made(range(3)), Made(range(3, 5)))


@pytest.mark.parametrize("words", [["tua=1"], ["tau=-1"], ["much"], ["mode=1"]])
def test_invalid_tolerances_are_refused(words):
    with pytest.raises(ConfigurationError, match="tolerance"):
        read_tolerances(words, RECORDED)
