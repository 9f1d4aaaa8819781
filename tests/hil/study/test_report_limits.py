"""What a page says of limits, of several buses and of its time, from made-up rows."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.config import ImuSettings, SensorSettings, TrackerSettings, WrenchSensorSettings
from drivers.errors import LogError
from drivers.protocol import BUS, Frame
from drivers.signals import Mode
from drivers.tick_columns import RECORDED
from hil.app.configuration.configuration import load
from hil.record.schema import IDENTITY
from hil.study.report import sections
from hil.study.report.charts import charts
from hil.study.report.command import _rate, _subtitle
from hil.study.report.margins import margins
from hil.study.report.story import told
from hil.study.report.timing import Traffic, traffic
from tests.hil.study.test_report_figures import nearest, rows_of


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("column", "key", "limit"),
    [
        ("q_d", "limits.following_error_m", {"following_error_m": 0.5, "following_error_s": 0.0}),
        ("dq", "limits.speed_m_s", {"speed_m_s": 0.5}),
        ("tau", "limits.force_N", {"force_N": 0.5}),
    ],
)
def test_what_a_limit_is_measured_against_counts_in_both_directions(column, key, limit, sign):
    rows = rows_of(9, q=1.475, q_d=1.475)
    rows[column][5, 4] += sign * 0.4
    rows[column][6, 2] -= sign * 0.3
    found = nearest(rows, key, limit)
    assert (found.value, found.row, found.leg) == (pytest.approx(0.4), 5, 4)
    assert found.used_percent == pytest.approx(80.0)


@pytest.mark.parametrize(("column", "key"), [("fk_residual", "consistency_m"), ("condition", "condition")])
def test_residual_and_condition_have_each_its_own_limit(column, key):
    rows = rows_of(9, q=1.475, q_d=1.475)
    rows[column][4] = 0.3
    found = nearest(rows, f"limits.{key}", {"consistency_m": 2.0, "condition": 4.0, key: 1.5})
    assert (found.value, found.limit, found.row) == (0.3, 1.5, 4)


@pytest.mark.parametrize("said", ["0", "-1", "nan", "inf", "1e300", "1e9", "100001", "fast", "9" * 400])
def test_a_rate_that_no_loop_has_is_refused_in_short_as_windows_of_ticks_grow_with_it(said):
    run = {"kind": "sim", "rate_Hz": said}
    log: Any = SimpleNamespace(metadata={IDENTITY: run}, columns=RECORDED)
    with pytest.raises(LogError, match=r"^a\.mcap: .*rate_Hz: .*at most 100000$") as caught:
        _rate(log, Path("a.mcap"))
    assert len(str(caught.value)) < 200
    run["rate_Hz"] = "1e5"
    assert _rate(log, Path("a.mcap")) == 1e5


@pytest.mark.parametrize(
    ("remark", "verdict"), [("", "Parked without a fault"), ("the log is damaged", "ends in PARKED")]
)
def test_a_log_of_which_something_is_missing_is_not_called_a_run_without_a_fault(remark, verdict):
    quiet = told({}, rows_of(5, mode=Mode.PARKED), 1000.0)
    made = sections.opening(quiet, rows_of(5, mode=Mode.PARKED), remark)
    assert verdict in made
    assert ("Parked without a fault" in made) is (not remark)
    assert ("This page shows what is there" in made) is bool(remark)


@pytest.mark.parametrize(("of_controller", "least"), [(25000.0, 25000.0), (40000.0, 30000.0)])
def test_the_line_of_the_forces_is_the_smaller_limit_whichever_that_is(of_controller, least):
    c = load("virtual")
    c = c.model_copy(update={"limits": c.limits.model_copy(update={"force_N": of_controller})})
    shown = {each.key: each for each in charts(rows_of(5), c, Traffic(np.full(5, np.nan), {}), 1000.0)}
    for name in ("tau", "drive_force"):
        assert shown[name].levels == (-least, least), "30 kN are those of the drives"


def test_each_bus_is_as_busy_as_its_own_bit_rate_makes_it():
    frame = Frame(0x80, bytes(8))
    sent = (frame, frame._replace(flags=BUS), frame._replace(flags=BUS))
    log: Any = SimpleNamespace(
        can_channels=("a", "b"), ticks=lambda: [SimpleNamespace(sent=sent, received=(), row={"t_ns": 0})]
    )
    busy = traffic(log, rows_of(1), [BitTiming(1_000_000, 1_000_000), BitTiming(250_000, 250_000)]).busy_ns
    assert list(busy) == ["bus a", "bus b"]
    assert busy["bus b"][0] == 2 * 4 * busy["bus a"][0] > 0, "two frames at a quarter of the rate"


def test_a_run_in_real_time_began_with_its_first_tick_and_not_when_the_machine_was_switched_on():
    booted = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)
    log: Any = SimpleNamespace(
        epoch_ns=int(booted.timestamp()) * 10**9, lockstep=False, metadata={"hil": {"kind": "run"}}
    )
    rows = rows_of(3)
    rows["t_ns"] += (2 * 86_400 + 3) * 10**9
    assert "real time, begun 2026-03-03T12:00:03Z" in _subtitle(log, rows, None, 1000.0)


@pytest.mark.parametrize(
    "sensors",
    [
        SensorSettings(tracker=TrackerSettings()),
        SensorSettings(imu=ImuSettings()),
        SensorSettings(wrench=WrenchSensorSettings()),
    ],
    ids=["tracker", "imu", "wrench"],
)
def test_no_limit_is_told_of_refused_frames_where_those_of_sensors_are_among_them(sensors):
    """They never fault, and a log does not tell them from those of the drives."""
    rows = rows_of(200)
    rows["rejected"][:] = 1
    c = load("virtual")
    with_sensors = c.model_copy(update={"sensors": sensors})
    told = [
        [m.used_percent for m in margins(rows, each, 1000.0) if "frames were refused" in m.name]
        for each in (c, with_sensors)
    ]
    assert told == [[400.0], []]
