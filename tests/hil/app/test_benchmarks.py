"""The benchmark measures what it says: stages without changing the cycle, equations, percentiles, marks."""

import json
import os
import re
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.signals import Command, DriveMode, Mode
from hil.app.compose import build_cycle, build_protocol
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.contracts.records import asked, record_of
from hil.control import LAWS
from hil.loop.parts import Parts
from tests.drivers.legs_frames import command_frames, opening
from tools.benchmarks import cyclictest, realtime, versions
from tools.benchmarks.__main__ import PARTS, main
from tools.benchmarks.benchmark import CHANNEL, Benchmark
from tools.benchmarks.figures import Figure, Mark, lines, number, spread
from tools.benchmarks.fmu import fmu
from tools.benchmarks.laws import laws
from tools.benchmarks.lockstep import recorder, replaying, simulation
from tools.benchmarks.memory import memory_figures
from tools.benchmarks.process import cpu_s, resident_kB
from tools.benchmarks.tick import tick
from tools.benchmarks.timed_cycle import (
    BLOCK,
    TimedCycle,
    feed,
    quietest_figure,
)


def value(figures, name):
    (figure,) = [f for f in figures if f.name.strip() == name]
    return figure.values[""]


@pytest.fixture(scope="module")
def benchmark(tmp_path_factory):
    """A benchmark whose simulated run is a short one."""
    folder = tmp_path_factory.mktemp("benchmark")
    benchmark = Benchmark(folder, seconds=3.0, memory_minutes=1.0, say=lambda _: None)
    benchmark.simulated = simulate(
        load("virtual"), log=folder / "sim.mcap", duration_s=2.0, check_replay=False
    )
    return benchmark


# -- figures and marks ---------------------------------------------------------------------------------------


def test_a_spread_is_median_p99_and_maximum_in_the_unit_asked_for():
    ns = np.arange(101)[::-1] * 1000  # 0 .. 100 us: the k-th percentile is k us
    assert spread(ns, largest=True) == {"median": 50.0, "p99": 99.0, "max": 100.0}
    assert spread([]) == {}


@pytest.mark.parametrize(
    ("values", "mark", "met", "verdict"),
    [
        ({"": 40.0}, Mark(40.0), True, "met"),
        ({"": 40.1}, Mark(40.0), False, "not met"),
        ({"": 9.9}, Mark(10.0, at_most=False), False, "not met"),
        ({"": 10.0}, Mark(10.0, at_most=False), True, "met"),
        ({"": float("nan")}, Mark(10.0), False, "not met"),
        ({"": float("nan")}, Mark(10.0, at_most=False), False, "not met"),
        ({"median": 30.0, "p99": 50.0}, Mark(40.0), False, "median met, p99 not met"),
        ({"median": 30.0, "p99": 50.0}, Mark(40.0, of=("median",)), True, "met"),
        ({}, Mark(40.0), None, "not measured"),
        ({"": 1.0}, None, None, ""),
    ],
)
def test_a_verdict_says_what_the_values_are_beside_the_mark(values, mark, met, verdict):
    figure = Figure("x", values, "us", mark)
    assert figure.met is met
    assert figure.outcome() == verdict


def test_a_part_prints_every_figure_with_its_mark_in_columns():
    text = lines(
        "part",
        [
            Figure("time", {"median": 1.234, "p99": 12345.6}, "us", Mark(40.0)),
            Figure("other", note="not installed"),
        ],
    )
    assert text == [
        "part",
        "  time   median 1.23, p99 12346 us  mark <= 40 us: median met, p99 not met",
        "  other                             not installed",
    ]


def test_numbers_have_three_digits_and_no_exponent_where_none_is_needed():
    assert [number(x) for x in (0.01234, 9.999, 123.4, 123456.0, -250.2)] == [
        "0.0123",
        "10",
        "123",
        "123456",
        "-250",
    ]


# -- the tick --------------------------------------------------------------------------------------------------


def parts(benchmark) -> Parts:
    c = benchmark.configuration
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts


def test_the_stop_watch_around_the_step_leaves_a_sleep_out(benchmark):
    entries = benchmark.held.entries[:300]
    sleep_s = 2e-3
    cycle = TimedCycle(parts(benchmark), sleep_s)
    begun = time.perf_counter_ns()
    assert feed(entries, cycle) == 0
    wall = time.perf_counter_ns() - begun
    taken = sum(cycle.compute_ns(mode).sum() for mode in Mode)
    assert sum(len(cycle.compute_ns(mode)) for mode in Mode) == len(entries)
    assert 0 < taken < wall - len(entries) * sleep_s * 1e9


@pytest.mark.long
def test_the_tick_part_gives_the_compute_mark(benchmark):
    figures = tick(benchmark)
    assert figures[0].mark == Mark(40.0)
    assert not [f for f in figures if f.name == "result"], "ticks came out differently"
    assert [f.name.strip() for f in figures[1:3]] == ["quietest block", "after a sleep"]
    assert all(f.values["median"] > 0.0 for f in figures)


def nanoseconds(steps_us: list[float]) -> Any:
    return np.round(np.array(steps_us) * 1e3).astype(np.int64)


def test_the_quietest_block_is_found_among_disturbed_ones():
    steps = [70.0] * BLOCK + [38.0] * (BLOCK - 2) + [90.0] * 2 + [41.0] * BLOCK + [1.0] * (BLOCK - 1)
    figure = quietest_figure(nanoseconds(steps))
    assert figure.values == {"median": 38.0, "p99": pytest.approx(90.0, abs=1.0)}
    assert figure.note == f"of 3 blocks of {BLOCK} ticks; the median of 1 is within the mark"
    assert figure.mark is None, "the mark is judged by all ticks"


def test_fewer_ticks_than_a_block_have_no_quietest_one():
    figure = quietest_figure(nanoseconds([1.0] * (BLOCK - 1)))
    assert not figure.values
    assert "fewer" in figure.note


# -- processes -----------------------------------------------------------------------------------------------


def test_processor_time_and_memory_of_a_process_are_those_that_it_counts_itself():
    before = cpu_s(os.getpid())
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    assert cpu_s(os.getpid()) - before == pytest.approx(0.2, abs=0.05)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    assert resident_kB(os.getpid()) == pytest.approx(pages * os.sysconf("SC_PAGE_SIZE") / 1024, rel=0.02)


def test_a_short_watch_of_the_memory_is_extrapolated_and_says_so():
    figures = memory_figures([102_400, 204_800, 103_424], minutes=1.0)  # 1 MB more at the end
    assert [f.values[""] for f in figures] == [200.0, 1.0, 10.0]
    assert [f.met for f in figures] == [True, None, False]
    assert "EXTRAPOLATED" in figures[2].note


def test_a_watch_of_ten_minutes_is_judged_as_it_is():
    figures = memory_figures([102_400, 104_448], minutes=10.0)
    assert [(f.values[""], f.met) for f in figures] == [(102.0, True), (2.0, True)]
    assert not any("EXTRAPOLATED" in f.note for f in figures)


def test_percentiles_and_shares_of_a_histogram_of_cyclictest():
    text = """# /dev/cpu_dma_latency set to 0us
# Histogram
000001 000010
000002 000085
000003 000004
000150 000001
# Total: 000000100
# Min Latencies: 00001
# Avg Latencies: 00003
# Max Latencies: 00150
# Histogram Overflows: 00000
"""
    found = cyclictest.read(text.splitlines())
    assert found is not None
    assert found.percentiles() == {"p50": 2.0, "p99": 3.0, "max": 150.0}
    assert [found.later_than(us) for us in (0, 1, 2, 3, 149.5, 150)] == [100.0, 90.0, 5.0, 1.0, 1.0, 0.0]
    assert cyclictest.read(["no histogram"]) is None


def test_a_machine_without_cyclictest_is_told_where_it_comes_from(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert cyclictest.cyclictest(80, 1000, 1.0) == "cyclictest is not installed (Debian: rt-tests)"


# -- the parts -----------------------------------------------------------------------------------------------


@pytest.mark.long
def test_lockstep_parts_count_every_tick(benchmark):
    ticks = benchmark.simulated["ticks"]
    (factor,) = simulation(benchmark)
    assert factor.values[""] == pytest.approx((ticks - 1) / 1000.0 / benchmark.simulated["wall_s"])
    (speed,) = replaying(benchmark)
    assert speed.note == f"{ticks} ticks, 0 differences"
    figures = recorder(benchmark)
    assert value(figures, "dropped ticks") == 0.0
    assert value(figures, "its share of a core at 1 kHz") == pytest.approx(
        value(figures, "recorder, a tick") / 10.0
    )
    row_bytes = benchmark.held.entries[0].row.dtype.itemsize
    assert 0 < value(figures, "size of the log, a tick") < 3 * row_bytes


@pytest.mark.long
def test_hosting_costs_more_than_the_c_call_and_a_process_more_than_none(benchmark):
    def ordered() -> bool:
        figures = {f.name: f.values for f in fmu(benchmark)}
        names = ("1 ms step in C", "hosted, in process", "hosted, child process")
        alone, hosted, apart = (figures[name]["median"] for name in names)
        return 0.0 < alone < hosted < apart

    assert any(ordered() for _ in range(5)), "measured one after the other: other load may fall on one alone"


@pytest.mark.long
@pytest.mark.realtime(patient=True)
def test_the_loop_in_real_time_cannot_be_faster_than_the_bus(benchmark):
    c = benchmark.endless
    assert c.bus.channel == CHANNEL != load("virtual").bus.channel
    figures = {f.name: f for f in realtime.realtime(benchmark)}
    protocol = build_protocol(c)
    timing = BitTiming(c.bus.bitrate_bit_s, c.bus.data_bitrate_bit_s)
    (sync,) = opening(protocol, 0)
    # of the fd layout: 12 bytes each, flags as those of the command
    (command,) = command_frames(protocol, Command(DriveMode.OFF, np.zeros(6)), 0)
    feedbacks = 6 * frame_time_ns(12, command.flags, timing)
    least_us = (frame_time_ns(len(sync.data), sync.flags, timing) + feedbacks) / 1e3
    feedback = figures["SYNC to six feedbacks"].values["median"]
    assert least_us <= feedback < figures["SYNC to command sent"].values["median"]
    assert figures["rate"].values[""] <= 1000.0
    assert figures["dropped ticks"].values[""] == 0.0
    assert 0.0 < figures["recorder's share of a core"].values[""] < 100.0
    assert figures["tick compute"].values["median"] > 0.0


def test_two_buses_are_measured_at_their_shipped_rate_on_channels_of_their_own(benchmark):
    c, shipped = benchmark.two_buses, load("two_buses")
    assert c.loop.rate_Hz == shipped.loop.rate_Hz == 2000
    assert c.bus.legs == shipped.bus.legs
    own, usual = ({each.channel for each in of.bus.buses} for of in (c, shipped))
    assert len(own) == 2
    assert not own & (usual | {CHANNEL})
    assert c.limits.stale_fault_ticks == 400, "a stall of 0.2 s ends no run"


@pytest.mark.long
@pytest.mark.realtime
def test_two_buses_in_real_time_cannot_be_faster_than_their_frames_and_have_no_marks(benchmark):
    figures = {f.name: f for f in realtime.two_buses(benchmark)}
    # docs/guides/buses.md: SYNC 75.0 us and three feedbacks 193.8 us on each
    feedback = figures["SYNC to six feedbacks"].values["median"]
    assert 268.8 <= feedback < figures["SYNC to command sent"].values["median"]
    assert figures["rate"].values[""] <= 2000.0
    assert 0.0 < figures["SYNC, bus to bus"].values["median"] < 1000.0
    assert {"stale ticks", "skipped ticks", "wake-up lateness"} <= set(figures)
    assert all(f.mark is None for f in figures.values())


def test_every_law_of_the_table_is_timed_and_has_a_mark(benchmark):
    figures = {f.name: f for f in laws(benchmark)}
    assert set(LAWS) <= set(figures)
    assert all(f.mark is not None for name, f in figures.items() if not name.startswith("no law"))
    assert all(0.0 < f.values["median"] <= f.values["p99"] for f in figures.values())


# -- the command ---------------------------------------------------------------------------------------------


@pytest.mark.long
def test_one_part_prints_the_machine_the_marks_and_the_same_as_json(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["--only", "laws", "--json", "benchmark.json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(Path("benchmark.json").read_text())
    assert set(summary["parts"]) == {"laws"}
    assert summary["machine"]["cores"] == str(os.cpu_count())
    assert summary["machine"]["kernel"] == os.uname().release
    assert f"{summary['marks_met']} of {summary['marks']} marks met" in result.stdout
    assert not list(Path("runs").iterdir()), "nothing stays behind"


REAL_TIME = {
    "realtime": [pytest.mark.realtime(patient=True)],
    "two_buses": [pytest.mark.realtime],
    "memory": [pytest.mark.realtime(patient=True)],
}
"""Parts that run processes in real time."""


@pytest.mark.long
@pytest.mark.parametrize("part", [pytest.param(name, marks=REAL_TIME.get(name, [])) for name in PARTS])
def test_every_part_can_be_short_yields_its_figures_and_succeeds(part, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = ["--only", part, "--seconds", "2", "--memory-minutes", "0.02", "--json", "benchmark.json"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    figures = json.loads(Path("benchmark.json").read_text())["parts"][part]
    marked = [each for each in figures if "mark" in each]
    assert marked or part == "two_buses"
    assert all(each["values"] for each in marked), "a mark that nothing was measured for"
    assert sum(bool(each["values"]) for each in figures) > len(figures) / 2


@pytest.mark.long
def test_two_versions_in_turn_give_a_ratio_for_the_loop_and_for_replay(monkeypatch, capsys):
    here = str(Path(__file__).parents[3])
    words = ["versions", here, here, "--duration", "2", "--rounds", "1"]
    monkeypatch.setattr(sys, "argv", words)
    versions.main()
    found = re.findall(r"(\w+) +([\d.]+) us a tick, then ([\d.]+): ([\d.]+) times", capsys.readouterr().out)
    assert [kind for kind, *_ in found] == ["lockstep", "replay"]
    for _, old, new, ratio in found:
        assert float(old) / float(new) == pytest.approx(float(ratio), abs=0.02)


def test_a_file_that_is_no_summary_is_not_overwritten(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("keep me")
    result = CliRunner().invoke(main, ["--only", "laws", "--json", "notes.txt"])
    assert result.exit_code == 2
    assert result.stderr.startswith("benchmark: --json notes.txt: exists")
    assert Path("notes.txt").read_text() == "keep me"


def test_every_part_has_a_title_and_can_be_asked_for():
    assert all(title for _, title in PARTS.values())
    text = CliRunner().invoke(main, ["--help"]).output
    assert "|".join(PARTS) in text.replace("\n", "").replace(" ", "")
