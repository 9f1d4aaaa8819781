"""Legs on several buses in lockstep: bus time, skew, faults of one bus, the log."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.can.bus_time import BitTiming
from drivers.errors import ConfigurationError
from drivers.frame_array import received_frames
from drivers.signals import Fault, Warn
from hil.app.check.bus import report_bus
from hil.app.check.findings import Report
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.bus_budget import loads as loads_of_buses
from hil.app.configuration.configuration import Configuration, loads
from hil.app.sim.build import build_lockstep
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.cli import main
from hil.loop.run_end import Course
from hil.record.log import Log
from hil.study.export.command import export_log
from hil.study.report.timing import traffic
from plant_fmu.faults.kinds import BusOff
from plant_fmu.faults.plan import FaultPlan
from tests.loop.test_desktop_drives import FAMILIES
from tests.loop.test_desktop_drives import TEXT as DESKTOP

TWO = resources.files("configs").joinpath("two_buses.yaml").read_text(encoding="utf-8")
FIRST = "{channel: two0, legs: [0, 1, 2]}"
SECOND = "{channel: two1, legs: [3, 4, 5]}"
CIA402 = """  protocol: cia402
  options: {rated_torque_Nm: 9.5, velocity: difference}
  transmission: {lead_m: 0.02, counts_per_turn: 131072, offset_m: 0.7}"""
SLOWLY = (
    ("rate_Hz: 2000\n", "rate_Hz: 500\n"),
    ("watchdog_ms: 5 ", "watchdog_ms: 10 "),
    ("feedback_window_us: 340 ", "feedback_window_us: 1500 "),
)
SHORT = (
    ("force_ramp_s: 0.5", "force_ramp_s: 0.1"),
    ("stop_s: 0.5", "stop_s: 0.2"),
    ("blend_s: 0.5", "blend_s: 0.1"),
)
SPLITS = {
    "2x3": ((0, 1, 2), (3, 4, 5)),
    "3x2": ((0, 3), (1, 4), (2, 5)),
    "6x1": tuple((leg,) for leg in range(6)),
    "uneven": ((5, 0), (2, 4, 1, 3)),
}


def changed(text: str, *changes: tuple[str, str]) -> Configuration:
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "changed")


def split(legs: tuple[tuple[int, ...], ...]) -> str:
    lines = (f"    - {{channel: c{k}, legs: {list(there)}}}\n" for k, there in enumerate(legs))
    return "channels:\n" + "".join(lines)


@contextlib.contextmanager
def bench(c: Configuration, *faults: BusOff) -> Iterator[tuple[Lockstep, Course]]:
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c, FaultPlan(faults))
    try:
        yield build_lockstep(c, cycle, nodes), Course(cycle, None, armed=True)
    finally:
        plant.close()


@cache
def run() -> tuple[dict[str, Any], Log]:
    folder = TemporaryDirectory()
    path = Path(folder.name) / "run.mcap"
    found = simulate(changed(TWO, *SHORT), log=path, duration_s=0.1)
    log = Log.open(path)
    log.kept = folder  # type: ignore[attr-defined]
    return found, log


# budget


def test_2_kHz_take_68_percent_of_each_of_two_buses_by_the_sum_of_the_frames():
    c = changed(TWO)
    found = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    # SYNC 75 bit; 16 bytes 34 bit at 1 Mbit/s and 193 at 5; 12 bytes 34 and 153, three times
    by_hand_us = 75 + (34 + 193 / 5) + 3 * (34 + 153 / 5)
    assert [each.total_ns for each in found] == [round(1e3 * by_hand_us)] * 2 == [341_400] * 2
    assert [each.load_percent for each in found] == pytest.approx([68.28] * 2)
    report = Report(c.name)
    report_bus(report, c)
    assert [line for line in report.sections if line.startswith("bus")] == [
        "bus localcan two0 (legs 0, 1, 2), layout fd",
        "bus localcan two1 (legs 3, 4, 5), layout fd",
    ]
    assert report.figures["bus"]["channels"]["two1"]["feedback_us"] == pytest.approx(75 + 193.8)


def test_a_bus_that_is_too_full_is_refused_with_its_own_arithmetic_at_its_own_place():
    with pytest.raises(ConfigurationError) as refused:
        changed(TWO, ("legs: [0, 1, 2]", "legs: [0, 1]"), ("legs: [3, 4, 5]", "legs: [2, 3, 4, 5]"))
    text = str(refused.value)
    assert "bus.channels[1]: the frames of one tick do not fit" in text
    # four legs need the command of 32 bytes: 75 + 105.6 + 4 x 64.6
    assert "total 439.0 us of a 500.0 us period = 87.8 % at 2000 Hz (allowed 70 %)" in text
    assert "bus.channels[0]" not in text
    slow = SECOND.replace("}", ", data_bitrate_bit_s: 1000000}")
    with pytest.raises(ConfigurationError, match=r"(?s)bus\.channels\[1\].*data phase 1 Mbit/s"):
        changed(TWO, (SECOND, slow))


@pytest.mark.parametrize("slower", [0, 1])
def test_the_slower_bus_decides_on_the_load_that_is_told_and_on_the_window_of_the_feedbacks(slower):
    """With 2 Mbit/s of data a command takes 130.5 us, a feedback 110.5 us; 537 us in all are 26.85 % of 2 ms."""
    place = (FIRST, SECOND)[slower]
    c = changed(TWO, (place, place.replace("}", ", data_bitrate_bit_s: 2000000}")), *SLOWLY)
    told = loads_of_buses(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    assert told["bus_load_percent"] == pytest.approx(26.85)
    other = pytest.approx(17.07)
    expected = {f"two{slower}": pytest.approx(26.85), f"two{1 - slower}": other}
    assert told["bus_load_percent_by_channel"] == expected
    # SYNC and three feedbacks: 75 + 331.5 us there, 268.8 us on the other bus
    for window_us, late in ((407, False), (406, True), (270, True)):
        loop = c.loop.model_copy(update={"feedback_window_us": window_us})
        report = Report(c.name)
        report_bus(report, c.model_copy(update={"loop": loop}))
        found = [each for each in report.warnings if "take 406 us" in each and "legs will be stale" in each]
        assert bool(found) == late


@pytest.mark.parametrize(("legs", "rate_Hz"), [("2x3", 939.6), ("3x2", 1359.2)])
def test_cia402_drives_run_as_fast_as_their_buses_carry(legs, rate_Hz):
    c = cia402(SPLITS[legs], 400)
    found = bus_budgets(c.bus, c.drives, c.sensors, 400.0)
    assert {round(each.allowed_rate_Hz, 1) for each in found} == {rate_Hz}
    with pytest.raises(ConfigurationError, match=f"these frames fit up to {rate_Hz:.0f} Hz"):
        cia402(SPLITS[legs], rate_Hz + 1.0)


def cia402(legs, rate_Hz):
    lab = resources.files("configs").joinpath("lab.yaml").read_text(encoding="utf-8")
    return changed(
        lab,
        ("channel: lab0\n", split(legs)),
        ("layout: fd", "layout: classic"),
        ("  protocol: legs", CIA402),
        ("rate_Hz: 1000\n", f"rate_Hz: {rate_Hz}\n"),
    )


# runs


def test_two_buses_at_2_kHz_carry_the_robot_and_the_log_replays_to_the_bit():
    found, log = run()
    assert found["success"], found
    assert (found["final_mode"], found["stale_ticks"], found["rejected_frames"]) == ("PARKED", 0, 0)
    assert found["replay"]["exact"]
    assert found["bus_load_percent_by_channel"] == pytest.approx({"two0": 68.28, "two1": 68.28})
    ticks = list(log.ticks())[50:60]
    for tick in ticks:
        assert sorted((frame.id, frame.bus) for frame in tick.sent if frame.id in (0x80, 0x111)) == [
            (0x80, 0), (0x80, 1), (0x111, 0), (0x111, 1)
        ]  # fmt: skip
        answers = {(r.frame.id - 0x281, r.frame.bus) for r in tick.received if 0x281 <= r.frame.id <= 0x286}
        assert answers == {(0, 0), (1, 0), (2, 0), (3, 1), (4, 1), (5, 1)}


def test_log_export_and_report_name_the_bus_of_every_frame(tmp_path):
    _, log = run()
    assert log.can_channels == ("two0", "two1")
    export_log(log.path, [tmp_path / "a.log"])
    lines = [line.split()[1:] for line in (tmp_path / "a.log").read_text().splitlines()]
    named = {(channel, frame.split("#")[0]) for channel, frame in lines}
    assert {("two0", "080"), ("two1", "080"), ("two0", "281"), ("two1", "286")} <= named
    assert not {("two0", "284"), ("two1", "281")} & named
    c = changed(TWO)
    busy = traffic(log, log.rows(), [BitTiming.of(each) for each in c.bus.buses]).busy_ns
    assert set(busy) == {"bus two0", "bus two1"}
    assert np.median(busy["bus two1"]) == 341_400


@pytest.mark.parametrize(
    "family", ["damiao", *(pytest.param(f, marks=pytest.mark.long) for f in FAMILIES if f != "damiao")]
)
@pytest.mark.parametrize(
    "legs", [pytest.param(k, marks=[] if k == "3x2" else pytest.mark.long) for k in SPLITS]
)
def test_every_family_runs_to_parked_on_several_buses(family, legs, tmp_path):
    c = changed(DESKTOP, *FAMILIES[family], ("channel: desktop0\n", split(SPLITS[legs])))
    found = simulate(c, log=tmp_path / "run.mcap", duration_s=0.1)
    assert found["success"], found
    assert (found["replay"]["exact"], found["rejected_frames"], found["stale_ticks"]) == (True, 0, 0)


@pytest.mark.long
@pytest.mark.parametrize(("legs", "rate_Hz"), [("2x3", 625), ("3x2", 1250)])
def test_cia402_drives_run_to_parked_on_several_buses(legs, rate_Hz, tmp_path):
    found = simulate(cia402(SPLITS[legs], rate_Hz), log=tmp_path / "run.mcap", duration_s=1.0)
    assert found["success"], found
    assert (found["replay"]["exact"], found["rejected_frames"]) == (True, 0)


# skew


def test_the_skew_is_the_time_between_the_ends_of_sync_and_the_legs_are_read_at_their_own():
    slow = SECOND.replace("}", ", bitrate_bit_s: 500000}")
    c = changed(TWO, (SECOND, slow), *SLOWLY)
    with bench(c) as (lockstep, _):
        lockstep.step()
        inp, _, out = lockstep.step()
    assert inp.sync_skew_ns == out.row["sync_skew_ns"] == 75_000  # 75 bit at 1 and at 0.5 Mbit/s
    heard = received_frames(inp.frames)
    first = {r.frame.bus: r.t_ns - inp.t_ns for r in reversed(heard) if 0x281 <= r.frame.id <= 0x286}
    assert first == {0: 75_000 + 64_600, 1: 150_000 + 68_000 + 30_600}
    assert not out.row["warnings"] & Warn.LATE


@pytest.mark.parametrize("family", ["damiao", "moteus"])
def test_where_a_bus_has_more_polls_than_another_the_skew_is_between_the_first_of_each(family):
    c = changed(DESKTOP, *FAMILIES[family], ("channel: desktop0\n", split(SPLITS["uneven"])))
    with bench(c) as (lockstep, _):
        inp, opening, out = lockstep.step()
    assert [opening["bus"].tolist().count(bus) for bus in (0, 1)] == [2, 4]
    assert inp.sync_skew_ns == 0
    assert not out.row["warnings"] & Warn.LATE


@pytest.mark.parametrize(("limit_us", "late"), [(74.9, True), (75.0, False)])
def test_buses_that_are_farther_apart_than_the_limit_make_a_late_tick(limit_us, late):
    slow = SECOND.replace("}", ", bitrate_bit_s: 500000}")
    limit = ("limits:\n", f"limits:\n  sync_skew_us: {limit_us}\n")
    c = changed(TWO, (SECOND, slow), *SLOWLY, limit)
    with bench(c) as (lockstep, _):
        row = lockstep.step()[2].row
    assert bool(row["warnings"] & Warn.LATE) == late


def test_by_default_a_tenth_of_the_period_is_late():
    cycle = build_cycle(changed(TWO), 2000.0, 5e-3)
    assert cycle.parts.safety.limits["sync_skew_ns"] == 50_000


# faults


def test_a_bus_that_is_cut_silences_its_own_legs_and_is_named():
    fault = ("plant:\n", "plant:\n  faults: [{kind: bus_off, bus: 1, mode: LOADING, at_s: 0.1}]\n")
    with bench(changed(TWO, fault)) as (lockstep, course):
        for tick in range(2000):
            inp, _, out = lockstep.step(course.commands(tick, ()))
            course.ending(tick)
            if inp.bus_off:
                break
        assert inp.bus_off == 0b10
        for later in range(tick + 1, tick + 4):
            inp, _, out = lockstep.step(course.commands(later, ()))
            course.ending(later)
        ages = out.row["age"].tolist()
        assert ages[:3] == [0, 0, 0]
        assert min(ages[3:]) >= 3
        assert lockstep.cycle.faults & Fault.BUS
        story = course.story()
        assert story is not None
        assert "bus two1 (legs 3, 4, 5) is off" in story.short


def test_every_bus_is_cut_where_none_is_named():
    fault = ("plant:\n", "plant:\n  faults: [{kind: bus_off, at_s: 0.0}]\n")
    with bench(changed(TWO, fault)) as (lockstep, _):
        inp = [lockstep.step()[0] for _ in range(3)][-1]
    assert inp.bus_off == 0b11
    assert not len(inp.frames)


def test_a_flood_of_one_bus_leaves_the_other_alone():
    fault = ("plant:\n", "plant:\n  faults: [{kind: bus_flood, bus: 1, rate_Hz: 20000, at_s: 0.05}]\n")
    with bench(changed(TWO, fault)) as (lockstep, _):
        rows = [lockstep.step()[2].row.copy() for _ in range(130)]
    assert max(row["age"][:3].max() for row in rows[5:]) == 0
    assert rows[-1]["age"][3:].min() > 10


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TWO, r"plant\.faults\[0\]\.bus: no such bus, allowed: 0 to 1, the place in bus\.channels, given: 2"),
        (DESKTOP, r"plant\.faults\[0\]\.bus: no such bus, allowed: 0, there is one bus, given: 2"),
    ],
)
def test_a_fault_of_a_bus_that_there_is_not_is_refused(text, message):
    with pytest.raises(ConfigurationError, match=message):
        changed(text, ("plant:\n", "plant:\n  faults: [{kind: bus_flood, bus: 2}]\n"))
    with pytest.raises(ConfigurationError, match="bus_off: no such bus"), bench(changed(text), BusOff(bus=5)):
        pass


def test_a_fault_of_a_bus_that_there_is_not_is_refused_from_the_command_line_too():
    done = CliRunner().invoke(main, ["sim", "two_buses", "--fault", "bus_off bus=3 at_s=0.5"])
    assert done.exit_code == 2
    assert "bus_off: no such bus, allowed: 0 to 1" in done.output
