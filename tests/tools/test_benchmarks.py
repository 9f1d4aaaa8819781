"""The benchmark's figures and marks, each part of it made short, and two checkouts in turn."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.errors import RunError
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from tools.benchmarks import versions
from tools.benchmarks.__main__ import PARTS, main
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark
from tools.benchmarks.tick import steps, tick

NAN = float("nan")


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    """A benchmark whose simulated run is a short one."""
    folder = tmp_path_factory.mktemp("benchmark")
    benchmark = Benchmark(folder, seconds=3.0, memory_minutes=1.0, say=lambda _: None)
    benchmark.simulated = simulate(
        load("virtual"), log=folder / "sim.mcap", duration_s=2.0, check_replay=False
    )
    return benchmark


@pytest.mark.parametrize(
    ("values", "mark", "met"),
    [
        ({"": 40.0}, Mark(40.0), True),
        ({"": 40.1}, Mark(40.0), False),
        ({"": 9.9}, Mark(10.0, at_most=False), False),
        ({"": 10.0}, Mark(10.0, at_most=False), True),
        ({"": NAN}, Mark(10.0), False),
        ({"": NAN}, Mark(10.0, at_most=False), False),
        ({"median": 30.0, "p99": 50.0}, Mark(40.0), False),
        ({}, Mark(40.0), None),
        ({"": 1.0}, None, None),
    ],
)
def test_a_mark_is_met_where_every_value_is_within(values, mark, met):
    assert Figure("x", values, "us", mark).met is met


def test_a_sleep_before_the_step_is_no_part_of_its_time(benchmark):
    entries, sleep_s = benchmark.ticks[:300], 2e-3
    begun = time.perf_counter_ns()
    found = list(steps(entries, benchmark.cycle(), sleep_s))
    wall = time.perf_counter_ns() - begun
    assert all(step.same for step in found)
    assert 0 < sum(step.took_ns for step in found) < wall - len(entries) * sleep_s * 1e9


def test_a_tick_that_comes_out_differently_fails_its_part(benchmark):
    changed = Benchmark(benchmark.folder, 3.0, 1.0, lambda _: None)
    changed.ticks = [*benchmark.ticks[:5], *benchmark.ticks[6:300]]
    with pytest.raises(RunError, match="came out differently"):
        tick(changed)


REAL_TIME = {name: [pytest.mark.realtime(patient=True)] for name in ("realtime", "memory")} | {
    "two_buses": [pytest.mark.realtime]
}
"""Parts that run processes in real time."""


@pytest.mark.long
@pytest.mark.parametrize("part", [pytest.param(name, marks=REAL_TIME.get(name, [])) for name in PARTS])
def test_every_part_can_be_short_yields_its_figures_and_succeeds(part, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = ["--only", part, "--seconds", "2", "--memory-minutes", "0.05", "--json", "benchmark.json"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    summary = json.loads(Path("benchmark.json").read_text())
    assert set(summary["parts"]) == {part}
    assert summary["machine"]["kernel"] == os.uname().release
    assert f"{summary['marks_met']} of {summary['marks']} marks met" in result.stdout
    figures = {each["name"].strip(): each for each in summary["parts"][part]}
    assert summary["marks"] > 0 or part == "two_buses"
    assert all(each["values"] for each in figures.values() if "mark" in each), "nothing measured for a mark"
    if part in {"realtime", "two_buses"}:  # docs/guides/buses.md: SYNC 75.0 us, three feedbacks 193.8 us
        assert figures["wake-up to six feedbacks"]["values"]["median"] >= 268.8
        assert figures["rate"]["values"][""] <= {"realtime": 1000.0, "two_buses": 2000.0}[part]
    assert not list(Path("runs").iterdir()), "nothing stays behind"


@pytest.mark.long
def test_two_versions_give_a_ratio_for_the_loop_and_for_replay(monkeypatch, capsys):
    here = str(Path(__file__).parents[2])
    words = ["versions", here, here, "--duration", "2", "--rounds", "1"]
    monkeypatch.setattr(sys, "argv", words)
    versions.main()
    found = re.findall(r"([\d.]+), ([\d.]+) \| ([\d.]+) \(", capsys.readouterr().out)
    assert len(found) == len(versions.KINDS)
    for old, new, ratio in found:
        assert float(old) / float(new) == pytest.approx(float(ratio), rel=0.02)


def test_another_file_is_not_overwritten(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("keep me")
    result = CliRunner().invoke(main, ["--only", "tick", "--json", "notes.txt"])
    assert result.exit_code == 2
    assert result.stderr.startswith("benchmark: --json notes.txt: exists")
    assert Path("notes.txt").read_text() == "keep me"
