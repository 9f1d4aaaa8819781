"""Legs on several buses in lockstep: bus time, skew, faults of one bus, the log."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.can.bus_time import BitTiming
from drivers.errors import ConfigurationError
from drivers.frame_array import received_frames
from drivers.signals import Fault, Warn
from hil.app.check import figures
from hil.app.check.report import Report
from hil.app.check.subject import looked_at
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.configuration import Configuration, load
from hil.app.sim.command import simulate
from hil.cli import main
from hil.loop.run_end import Course
from hil.record.log import Log
from hil.study.export import export_log
from hil.study.report.timing import traffic
from plant_fmu.faults.kinds import BusFlood
from tests.broad import broad
from tests.loop.bench import bench, changed, new_cycle, run
from tools.drive_families import FAMILIES, Changes, merged

SLOWLY: dict[str, Any] = {"loop": {"rate_Hz": 500, "feedback_window_us": 1500}, "drives": {"watchdog_ms": 10}}
SHORT = {"engage": {"force_ramp_s": 0.1, "stop_s": 0.2, "blend_s": 0.1}}
SPLITS = {
    "3x2": ((0, 3), (1, 4), (2, 5)),
    "2x3": ((0, 1, 2), (3, 4, 5)),
    "6x1": tuple((leg,) for leg in range(6)),
    "uneven": ((5, 0), (2, 4, 1, 3)),
}


def split(legs: str) -> dict[str, Any]:
    lines = [{"channel": f"c{k}", "legs": list(there)} for k, there in enumerate(SPLITS[legs])]
    return {"bus": {"channel": None, "channels": lines}}


def two(*changes: Changes, which: int = 1, **bus: Any) -> Configuration:
    """`two_buses` with changes, and with other keys of one of its buses."""
    lines = [{"channel": "two0", "legs": [0, 1, 2]}, {"channel": "two1", "legs": [3, 4, 5]}]
    lines[which] = lines[which] | bus
    return changed("two_buses", **merged({"bus": {"channels": lines}}, *changes))


# -- budget ----------------------------------------------------------------------------------------------------


def test_loop_at_2_kHz_loads_each_of_two_buses_by_68_percent():
    c = load("two_buses")
    found = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    # SYNC 75 bit; 16 bytes 34 bit at 1 Mbit/s and 193 at 5; 12 bytes 34 and 153, three times
    by_hand_us = 75 + (34 + 193 / 5) + 3 * (34 + 153 / 5)
    assert [each.total_ns for each in found] == [round(1e3 * by_hand_us)] * 2 == [341_400] * 2
    assert [each.load_percent for each in found] == pytest.approx([68.28] * 2)
    report = Report(looked_at(c))
    figures.bus(report)
    assert report.figures["bus"]["channels"]["two1"]["feedback_us"] == pytest.approx(75 + 193.8)


# -- runs ------------------------------------------------------------------------------------------------------


def test_run_at_2_kHz_on_two_buses_logs_every_frame_with_its_bus(tmp_path):
    c = two(SHORT)
    found = simulate(c, log=tmp_path / "run.mcap", duration_s=0.1)
    log = Log.open(tmp_path / "run.mcap")
    assert found["success"], found
    assert (found["final_mode"], found["stale_ticks"], found["rejected_frames"]) == ("PARKED", 0, 0)
    assert found["replay"]["exact"]
    assert found["bus_load_percent_by_channel"] == pytest.approx({"two0": 68.28, "two1": 68.28})
    for tick in list(log.ticks())[50:60]:
        assert sorted((frame.id, frame.bus) for frame in tick.sent if frame.id in (0x80, 0x111)) == [
            (0x80, 0), (0x80, 1), (0x111, 0), (0x111, 1)
        ]  # fmt: skip
        answers = {(r.frame.id - 0x281, r.frame.bus) for r in tick.received if 0x281 <= r.frame.id <= 0x286}
        assert answers == {(0, 0), (1, 0), (2, 0), (3, 1), (4, 1), (5, 1)}
    assert log.can_channels == ("two0", "two1")
    export_log(log.path, [tmp_path / "a.log"])
    lines = [line.split()[1:] for line in (tmp_path / "a.log").read_text().splitlines()]
    named = {(channel, frame.split("#")[0]) for channel, frame in lines}
    assert {("two0", "080"), ("two1", "080"), ("two0", "281"), ("two1", "286")} <= named
    assert not {("two0", "284"), ("two1", "281")} & named
    busy = traffic(log, log.rows(), [BitTiming.of(each) for each in c.bus.buses]).busy_ns
    assert np.median(busy["bus two1"]) == 341_400


SPLIT_RUNS = [("mit, damiao DM4310", "3x2"), *zip(FAMILIES, [*SPLITS] * 3, strict=False)]


@pytest.mark.parametrize(("family", "legs"), broad(SPLIT_RUNS, quick=1))
def test_every_drive_family_runs_on_several_buses(family, legs):
    stop_s = 1.0 if family.startswith("cia402") else 0.1
    ran = run(changed("desktop", **merged(FAMILIES[family], split(legs))), stop_s=stop_s)
    assert ran.ending.success, ran.ending
    assert (ran.summary["rejected_frames"], ran.summary["stale_ticks"]) == (0, 0)


# -- skew ------------------------------------------------------------------------------------------------------


def test_skew_between_buses_is_the_time_between_the_ends_of_their_sync_frames():
    with bench(two(SLOWLY, bitrate_bit_s=500000)) as lockstep:
        lockstep.step()
        inp, _, out = lockstep.step()
    assert inp.sync_skew_ns == out.row["sync_skew_ns"] == 75_000  # 75 bit at 1 and at 0.5 Mbit/s
    heard = received_frames(inp.frames)
    first = {r.frame.bus: r.t_ns - inp.t_ns for r in reversed(heard) if 0x281 <= r.frame.id <= 0x286}
    assert first == {0: 75_000 + 64_600, 1: 150_000 + 68_000 + 30_600}


@pytest.mark.parametrize(("limit_us", "late"), [(74.9, True), (75.0, False)])
def test_skew_between_buses_above_the_limit_makes_the_period_late(limit_us, late):
    with bench(two(SLOWLY, {"limits": {"sync_skew_us": limit_us}}, bitrate_bit_s=500000)) as lockstep:
        row = lockstep.step()[2].row
    assert bool(row["warnings"] & Warn.LATE) == late
    default = new_cycle(load("two_buses")).parts.safety.limits["sync_skew_ns"]
    assert default == 50_000, "a tenth of the period"


# -- faults ----------------------------------------------------------------------------------------------------


def test_failure_of_one_bus_silences_only_the_legs_on_that_bus_and_is_reported():
    c = changed(
        "two_buses", plant={"faults": [{"kind": "bus_off", "bus": 1, "mode": "LOADING", "at_s": 0.1}]}
    )
    with bench(c) as lockstep:
        course, off = Course(lockstep.cycle), 0
        for tick in range(2000):
            inp, _, out = lockstep.step(course.commands(tick, ()))
            course.ending(tick)
            assert inp.bus_off in {0, 0b10}
            off += bool(inp.bus_off)
            if off == 4:
                break
        ages = out.row["age"].tolist()
        assert ages[:3] == [0, 0, 0]
        assert min(ages[3:]) >= 3
        assert lockstep.cycle.faults & Fault.BUS
        story = course.story()
    assert story is not None
    assert "bus two1 (legs 3, 4, 5) is off" in story.short


def test_flood_of_frames_on_one_bus_does_not_disturb_the_other_bus():
    with bench(load("two_buses"), BusFlood(bus=1, rate_Hz=20000, at_s=0.05)) as lockstep:
        rows = [lockstep.step()[2].row.copy() for _ in range(130)]
    assert max(row["age"][:3].max() for row in rows[5:]) == 0
    assert rows[-1]["age"][3:].min() > 10


@pytest.mark.parametrize(
    ("name", "allowed"), [("two_buses", "0 to 1"), ("desktop", "0, as there is one bus")]
)
def test_injected_fault_on_an_unknown_bus_is_refused(name, allowed):
    with pytest.raises(
        ConfigurationError, match=rf"plant\.faults\[0\]\.bus: unknown bus, allowed: {allowed}"
    ):
        changed(name, plant={"faults": [{"kind": "bus_flood", "bus": 2}]})
    done = CliRunner().invoke(main, ["sim", name, "--fault", "bus_off bus=3 at_s=0.5"])
    assert done.exit_code == 2
    assert "bus_off: unknown bus" in done.output
