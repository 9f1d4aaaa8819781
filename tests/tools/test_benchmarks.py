"""The benchmark's figures and marks, each part of it made short, and two checkouts in turn."""

from __future__ import annotations

import json
import os
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import RunError
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.control import LAWS
from tools.benchmarks import versions
from tools.benchmarks.__main__ import PARTS, main
from tools.benchmarks.benchmark import CHANNEL, Benchmark, patient
from tools.benchmarks.figures import Figure, Mark, lines, spread
from tools.benchmarks.fmu import fmu
from tools.benchmarks.live import live_run, memory_figures
from tools.benchmarks.lockstep import recorder, replaying, simulation
from tools.benchmarks.process import cpu_s, resident_MB
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


def value(figures, name):
    (figure,) = [f for f in figures if f.name.strip() == name]
    return figure.values[""]


def test_a_spread_is_median_p99_and_maximum_in_the_requested_unit():
    ns = np.arange(101)[::-1] * 1000  # 0 .. 100 us: the k-th percentile is k us
    assert spread(ns, largest=True) == {"median": 50.0, "p99": 99.0, "max": 100.0}
    assert spread([]) == {}


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


def test_a_part_prints_every_figure_with_its_mark_in_columns():
    slow = Figure("time", {"median": 1.234, "p99": 12345.6}, "us", Mark(40.0))
    assert lines("part", [slow, Figure("other", note="not installed")]) == [
        "part",
        "  time   median 1.23, p99 12346 us  mark <= 40 us: not met",
        "  other                             not installed",
    ]


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


def test_processor_time_and_memory_of_a_process_are_those_that_it_counts_itself():
    before = cpu_s(os.getpid())
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    assert cpu_s(os.getpid()) - before == pytest.approx(0.2, abs=0.05)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    assert resident_MB(os.getpid()) == pytest.approx(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, rel=0.02)


def test_a_short_watch_of_the_memory_is_extrapolated_and_says_so():
    figures = memory_figures([100.0, 200.0, 101.0], minutes=1.0)
    assert [f.values[""] for f in figures] == [200.0, 1.0, 10.0]
    assert [f.met for f in figures] == [True, None, False]
    assert "EXTRAPOLATED" in figures[2].note
    assert [(f.values[""], f.met) for f in memory_figures([100.0, 102.0], 10.0)] == [
        (102.0, True),
        (2.0, True),
    ]


@pytest.mark.parametrize("name", ["virtual", "two_buses"])
def test_a_live_part_has_channels_of_its_own_and_no_stall_of_the_host_ends_it(tmp_path, name):
    c, shipped = patient(name, tmp_path, 1.0), load(name)
    assert c.loop.rate_Hz == shipped.loop.rate_Hz
    assert [each.channel for each in c.bus.buses] == [f"{CHANNEL}{k}" for k in range(len(shipped.bus.buses))]
    assert c.limits.stale_fault_ticks == c.limits.missed_stop_ticks == 0.2 * c.loop.rate_Hz
    assert (c.drives.watchdog_ms, c.loop.on_stall) == (200.0, "fault")


def test_a_run_that_does_not_begin_fails_its_part_with_its_reason(tmp_path):
    c = patient("virtual", tmp_path, 1.0)
    Path(c.source).write_text("bus: 3\n")
    with pytest.raises(RunError, match="exit code 2: hil: "):
        live_run(c, 1.0, tmp_path)


@pytest.mark.long
def test_the_tick_part_times_the_step_and_every_law(benchmark):
    figures = {f.name.strip(): f for f in tick(benchmark)}
    assert {"tick compute", "quietest block", "after a sleep", "forward kinematics"} <= set(figures)
    assert {f"with {law}" for law in LAWS} <= set(figures)
    assert all(f.values["median"] > 0.0 for f in figures.values())


@pytest.mark.long
def test_lockstep_parts_count_every_tick(benchmark):
    ticks = benchmark.simulated["ticks"]
    (factor,) = simulation(benchmark)
    assert factor.values[""] == pytest.approx((ticks - 1) / 1000.0 / benchmark.simulated["wall_s"])
    (speed,) = replaying(benchmark)
    assert speed.note == f"{ticks} ticks, 0 differences"
    figures = recorder(benchmark)
    assert value(figures, "dropped ticks") == 0.0
    share = value(figures, "its share of a core at 1 kHz")
    assert share == pytest.approx(value(figures, "recorder, a tick") / 10.0)
    row_bytes = benchmark.ticks[0].row.dtype.itemsize
    assert 0 < value(figures, "size of the log, a tick") < 3 * row_bytes


@pytest.mark.long
def test_hosting_costs_more_than_the_c_call_and_a_process_more_than_none(benchmark):
    def ordered() -> bool:
        figures = {f.name: f.values for f in fmu(benchmark)}
        names = ("1 ms step in C", "hosted, in process", "hosted, child process")
        alone, hosted, apart = (figures[name]["median"] for name in names)
        return 0.0 < alone < hosted < apart

    assert any(ordered() for _ in range(5)), "measured one after the other: other load may fall on one alone"


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
def test_two_versions_in_turn_give_a_ratio_for_the_loop_and_for_replay(monkeypatch, capsys):
    here = str(Path(__file__).parents[2])
    words = ["versions", here, here, "--duration", "2", "--rounds", "1"]
    monkeypatch.setattr(sys, "argv", words)
    versions.main()
    found = re.findall(r"([\d.]+), ([\d.]+) \| ([\d.]+) \(", capsys.readouterr().out)
    assert len(found) == len(versions.KINDS)
    for old, new, ratio in found:
        assert float(old) / float(new) == pytest.approx(float(ratio), rel=0.02)


def test_a_file_that_is_no_summary_is_not_overwritten(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("keep me")
    result = CliRunner().invoke(main, ["--only", "tick", "--json", "notes.txt"])
    assert result.exit_code == 2
    assert result.stderr.startswith("benchmark: --json notes.txt: exists")
    assert Path("notes.txt").read_text() == "keep me"
