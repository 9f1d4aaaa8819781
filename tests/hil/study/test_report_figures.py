"""The figures of a page, computed again from the log's table by other means: curves, extremes, percentiles, bus load."""

from __future__ import annotations

import base64
import json
import re
from math import sqrt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import DriveFault, DriveState, Fault, Mode, Warn
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.record.log import Event, Log
from hil.record.schema import SUMMARY
from hil.study.report import sections
from hil.study.report.charts import Chart, Curve, charts
from hil.study.report.command import report
from hil.study.report.margins import Margin, margins
from hil.study.report.page import figure
from hil.study.report.story import quantity, told
from hil.study.report.timing import Traffic, counts, spreads
from tests.drivers.cia402_drives import drives
from tests.drivers.motor_families import GEAR, ODriveProtocol

LEGS = [f"leg_{leg}" for leg in range(6)]


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4").astype(np.float64)


def cells(text):
    """The cells of each row of a table."""
    rows = re.findall(r"<tr>(.*?)</tr>", text)
    return [
        [re.sub(r"<.*?>", "", c).strip() for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", r)] for r in rows
    ]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of a run that a curve has all samples of, and the log as a table."""
    folder = tmp_path_factory.mktemp("page")
    simulate(load("virtual"), log=folder / "a.mcap", duration_s=1.6, check_replay=False)
    text = (report(folder / "a.mcap")["page"], (folder / "a.html").read_text(encoding="utf-8"))[1]
    data = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    log = Log(folder / "a.mcap")
    frame = log.frame(numbers=True)
    assert 2000 < len(frame) < 4000
    return {chart["key"]: chart for chart in data["charts"]}, data["scene"], frame, log


def columns(frame, name, parts):
    return frame[[f"{name}.{part}" for part in parts]].to_numpy()


def curves(chart):
    return {c["label"]: unpacked(c["values"]) for c in chart["curves"]}


def expect(chart, labels, values, follows=None):
    """Assert that curves are values (n, m), and nan where nothing is followed."""
    found = curves(chart)
    for label, y in zip(labels, values.T, strict=True):
        wanted = y if follows is None else np.where(follows, y, np.nan)
        scale = np.nanmax(np.abs(wanted))
        np.testing.assert_allclose(found[label], wanted, rtol=0, atol=1e-6 * scale, err_msg=label)


def test_the_curves_of_tracking_are_reference_less_measured_in_the_unit_of_the_axis(page):
    shown, _, frame, _ = page
    follows = frame["mode"].between(Mode.RELEASING, Mode.PARKING).to_numpy()
    assert 0 < follows.sum() < len(frame)
    xyz, matrix = "xyz", [r + c for r in "xyz" for c in "xyz"]
    p, p_d = (columns(frame, name, xyz) for name in ("p", "p_d"))
    assert shown["e_p"]["unit"] == shown["e_q"]["unit"] == "mm"
    expect(shown["e_p"], xyz, 1e3 * (p_d - p), follows)
    expect(shown["e_q"], LEGS, 1e3 * (columns(frame, "q_d", LEGS) - columns(frame, "q", LEGS)), follows)
    expect(shown["p"], xyz, p)
    expect(shown["p"], [f"{x}, reference" for x in xyz], p_d, follows)
    R, R_d = (
        Rotation.from_matrix(columns(frame, name, matrix)[follows].reshape(-1, 3, 3)) for name in ("R", "R_d")
    )
    e = np.full((len(frame), 3), np.nan)
    e[follows] = 1e3 * (R_d * R.inv()).as_rotvec()
    assert shown["e_R"]["unit"] == "mrad"
    expect(shown["e_R"], ["rx", "ry", "rz"], e)
    expect(shown["dq"], LEGS, columns(frame, "dq", LEGS))
    np.testing.assert_allclose(unpacked(shown["e_p"]["t"]), frame.index, atol=1e-6)


def test_forces_stand_in_N_with_the_smaller_of_both_limits(page):
    shown, _, frame, _ = page
    for name in ("tau", "drive_force"):
        assert shown[name]["unit"] == "N"
        expect(shown[name], LEGS, columns(frame, name, LEGS))
        assert shown[name]["levels"] == [-25000.0, 25000.0], "25 kN of the controller, 30 kN of the drives"
    assert shown["q"]["levels"] == [0.75, 2.2]
    assert shown["dq"]["levels"] == [-2.0, 2.0]


def test_v_stands_under_its_bound_and_modes_under_their_names(page):
    shown, _, frame, _ = page
    expect(shown["V"], ["V", "bound"], frame[["lyapunov", "lyapunov_bound"]].to_numpy())
    expect(shown["share"], ["share"], frame[["lyapunov_share"]].to_numpy())
    assert shown["share"]["levels"] == [1.0]
    names = dict(shown["mode"]["names"])
    named = [names[value] for value in curves(shown["mode"])["mode"].tolist()]
    assert named == [Mode(mode).name for mode in frame["mode"].tolist()]


def test_the_bus_is_as_busy_as_its_frames_are_long(page):
    """SYNC 75 us, 32 bytes 105.6 us, six times 12 bytes 64.6 us: 568.2 of 1000 us, see drivers/can/bus_time.py."""
    shown, _, frame, log = page
    busy = curves(shown["bus"])["bus hil0"]
    assert np.median(busy) == pytest.approx(56.82, abs=0.01)
    last: dict[int, int] = {}
    for each in log.can_frames():
        if not each.sent:
            last[each.tick] = max(last.get(each.tick, 0), each.t_ns)
    answered = [1e-3 * (last[tick] - t_ns) if tick in last else np.nan for tick, t_ns in zip(
        frame["tick"].tolist(), frame["t_ns"].tolist(), strict=True)]  # fmt: skip
    assert np.isfinite(answered).sum() > 2000
    found = curves(shown["time"])["last feedback after the tick's start"]
    np.testing.assert_allclose(found, answered, rtol=1e-5)
    assert shown["time"]["levels"] == [1000.0]


def test_what_plays_has_the_joints_poses_and_loads_of_the_run(page):
    _, scene, frame, _ = page
    c = load("virtual")
    np.testing.assert_allclose(scene["base"], np.array(c.platform.base_joints_m))
    np.testing.assert_allclose(scene["platform"], np.array(c.platform.platform_joints_m))
    t, p = unpacked(scene["t"]), unpacked(scene["p"]).reshape(-1, 3)
    at = np.searchsorted(frame.index, t - 1e-4)
    np.testing.assert_allclose(p, columns(frame, "p", "xyz")[at], atol=1e-6)
    load_ = unpacked(scene["load"]).reshape(-1, 6)
    np.testing.assert_allclose(load_, columns(frame, "tau", LEGS)[at] / 25000.0, atol=1e-6)


# -- from made-up rows ---------------------------------------------------------------------------------------


def rows_of(n, **values):
    rows = np.zeros(n, ROW)
    rows["tick"] = np.arange(n)
    rows["t_ns"] = 1_000_000 * np.arange(n)
    rows["mode"] = Mode.TRACKING
    for name, value in values.items():
        rows[name] = value
    return rows


def test_force_and_moment_of_a_wrench_are_charts_of_their_own():
    rows = rows_of(5, wrench=[1000.0, -2000.0, 3000.0, 40.0, 50.0, -60.0])
    shown = {c.key: c for c in charts(rows, None, Traffic(np.full(5, np.nan), {}), 1000.0)}
    for key, unit, labels, values in (
        ("wrench_force", "N", ["fx", "fy", "fz"], [1000.0, -2000.0, 3000.0]),
        ("wrench_moment", "N m", ["mx", "my", "mz"], [40.0, 50.0, -60.0]),
    ):
        assert (shown[key].unit, [c.label for c in shown[key].curves]) == (unit, labels)
        assert [c.values[0] for c in shown[key].curves] == pytest.approx(values)


def test_extremes_are_least_largest_and_the_root_of_the_mean_square():
    y = np.array([3.0, np.nan, -4.0, 0.0, 1.0])
    made = figure(Chart("x", "X", "x", "m", (Curve("a", y),)), np.array([0.0, 0.1, 0.2, 0.3, 0.4]))
    assert cells(made)[1] == ["a", "-4 at 0.200 s", "3 at 0.000 s", f"{sqrt(26 / 4):.5g}"]


def test_percentiles_are_those_of_all_ticks():
    rows = rows_of(1001, lateness_ns=1000 * np.arange(1001)[::-1])
    rows["compute_ns"] = 2_000
    rows["compute_ns"][0] = 10**9
    found = {s.name: s.values for s in spreads(rows, np.full(1001, np.nan))}
    assert found["wake-up, late by"] == pytest.approx((500e3, 990e3, 999e3, 1000e3))
    assert set(found["computing of a tick"]) == {2000.0}, "the first tick has none before it"
    assert "last feedback after the tick's start" not in found
    made = sections.timing(spreads(rows, np.full(1001, np.nan)), [], [], {}, lockstep=False)
    assert cells(made)[:2] == [
        ["time", "p50", "p99", "p99.9", "max"],
        ["wake-up, late by", "500.0 µs", "990.0 µs", "999.0 µs", "1000.0 µs"],
    ]


def test_counts_are_those_of_the_whole_log():
    rows = rows_of(100)
    rows["skipped"][[0, 50]] = 7, 2
    rows["tick"][50:] += 2
    rows["tick"][80:] += 5
    rows["age"][[10, 20], 3] = 1
    rows["age"][30] = 2
    rows["warnings"][[3, 4]] = Warn.LATE
    rows["rejected"][[5, 6]] = 3
    rows["sends_failed"][9], rows["bus_errors"][9] = 4, 6
    rows["recorder_dropped"][80:] = 5
    rows["bus_overflow"][[2, 3]] = 5, 6
    # passive from the start, active, warning, passive, off, off, warning: a better state is no entry
    rows["bus_state"][[0, 10, 11, 12, 13, 14, 15]] = 3, 1, 2, 3, 4, 4, 2
    rows["bus_off"][13:15] = 1
    powered = np.arange(100) >= 15
    assert [n for _, n in counts(rows, powered)] == [100, 2, 2, 2, 6, 4, 6, 11, 1, 2, 1, 2, 5, 5]


def test_times_on_the_page_count_from_the_first_row():
    rows = rows_of(10, t_ns=5_000_000_000 + 100_000_000 * np.arange(10))
    rows["mode"][4:] = Mode.STOPPING
    t = np.linspace(0.0, 0.9, 10)
    modes, events = sections.modes(rows, t, [Event(5_250_000_000, "info", "here")])
    assert cells(modes)[1:] == [["TRACKING", "0.000", "0.400"], ["STOPPING", "0.400", "0.500"]]
    assert cells(events)[1] == ["0.250", "info", "here"]


def test_what_is_left_of_a_limit_is_the_limit_less_the_value():
    found = Margin("leg rate", "limits.speed_m_s", 0.5, 2.0, "m/s", 3, 4)
    made = sections.limits([found], np.linspace(0.0, 0.9, 10), "")
    assert cells(made)[1][2:] == ["0.5 m/s", "2 m/s", "1.5 m/s", "4", "0.300", "limits.speed_m_s"]
    assert "25.0 %" in cells(made)[1][1]


def test_a_story_from_rows_has_the_mode_before_the_fault_and_the_drives_of_its_tick():
    rows = rows_of(100)
    rows["faults"][40:] = Fault.SPEED
    rows["faults"][70:] = Fault.SPEED | Fault.STALE
    rows["mode"][40:] = Mode.FAULT
    rows["drive_state"] = DriveState.RUN
    rows["drive_state"][60:] = DriveState.FAULT
    found = told({}, rows, 1000.0)
    assert [(f.fault, f.time_s, f.mode) for f in found.findings] == [
        ("SPEED", 0.04, "TRACKING"),
        ("STALE", 0.07, "FAULT"),
    ]
    assert found.drives == ("RUN",) * 6


@pytest.mark.parametrize(
    ("protocol", "fault", "said"),
    [
        (
            drives(),
            0x8130,
            "FAULT (33072: EMCY 0x8130, life guard or heartbeat error: the controller's heartbeat",
        ),
        (
            ODriveProtocol(range(6), 0.05, GEAR).protocol,
            0x100 + 0x2000,
            "FAULT (8448: motor over temperature)",
        ),
        (drives(), DriveFault.ESTOP, "FAULT (ESTOP)"),
        (None, 0x8130, "FAULT (33072)"),
    ],
)
def test_a_makers_code_is_shown_with_its_meaning(protocol, fault, said):
    rows = rows_of(10)
    rows["faults"][4:], rows["drive_state"], rows["drive_fault"] = Fault.DRIVE, DriveState.FAULT, fault
    by_rows = told({}, rows, 1000.0, protocol)
    story = {"findings": [{"fault": "DRIVE"}], "drives": [{"leg": 0, "state": "FAULT", "fault": int(fault)}]}
    by_story = told({SUMMARY: {"story": json.dumps(story)}}, rows, 1000.0, protocol)
    assert by_rows.drives[0].startswith(said)
    assert by_story.drives[0].startswith(said)


@pytest.mark.parametrize("protocol", [drives(), ODriveProtocol(range(6), 0.05, GEAR).protocol])
def test_drives_without_force_on_closed_brakes_are_not_said_to_hold_the_platform(protocol):
    rows = rows_of(10)
    rows["faults"][4:], rows["mode"][4:] = Fault.STALE, Mode.HELD
    (_, text), *_ = told({}, rows, 1000.0, protocol).done
    assert "on which they give no force" in text
    assert "the force held" not in text
    (_, text), *_ = told({}, rows, 1000.0).done
    assert "the force held the platform" in text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(0.005, "m", "5 mm"), (0.25, "m", "0.25 m"), (-2e-6, "m", "-0.002 mm"), (16043.4, "N", "16043 N"), (0.5, "1", "0.5")],
)  # fmt: skip
def test_a_quantity_has_the_prefix_of_its_size(value, unit, text):
    assert quantity(value, unit) == text


# -- margins -------------------------------------------------------------------------------------------------


def nearest(rows, key, change=None):
    c = load("virtual")
    c = c if change is None else c.model_copy(update={"limits": c.limits.model_copy(update=change)})
    (found,) = (m for m in margins(rows, c, 500.0) if m.key == key)
    return found


def test_a_force_is_measured_against_the_smaller_of_both_limits():
    rows = rows_of(9, q=1.475, q_d=1.475)
    rows["tau"][3, 2] = -5000.0
    assert nearest(rows, "limits.force_N").limit == 25000.0
    assert nearest(rows, "drives.force_limit_N", {"force_N": 40000.0}).limit == 30000.0


def test_a_slower_loop_may_change_its_force_by_more_in_a_tick():
    rows = rows_of(9, q=1.475, q_d=1.475)
    assert nearest(rows, "limits.force_step_N").limit == 8000.0, "4000 N at 1000 Hz, at 500 Hz"


def test_an_acceleration_of_the_reference_counts_in_both_directions():
    rows = rows_of(9, q=1.475, q_d=1.475)
    rows["ddq_d"][4, 1], rows["ddq_d"][6, 1] = -9.0, 3.0
    found = nearest(rows, "limits.acceleration_m_s2", {"acceleration_m_s2": 10.0})
    assert (found.value, found.row, found.leg) == (9.0, 4, 1)


def test_a_length_is_measured_from_the_middle_to_the_nearer_end():
    rows = rows_of(9, q=1.475, q_d=1.475)
    rows["q"][2, 3], rows["q"][5, 0] = 0.80, 2.10
    found = nearest(rows, "platform.length_max_m")
    assert (found.row, found.leg) == (2, 3)
    assert found.used_percent == pytest.approx(100 * 0.675 / 0.725)


def test_the_nearest_limit_comes_first_and_a_stretch_has_its_share_of_the_run():
    rows = rows_of(5000, q=1.475, q_d=1.475)
    rows["stretched_ns"][[1000, 3000]] = 400_000_000, 3_000_000
    found = margins(rows, load("virtual"), 1000.0)
    used = [m.used_percent for m in found]
    assert used == sorted(used, reverse=True)
    (stretch,) = (m for m in found if m.key == "limits.stretch_percent")
    assert (stretch.row, stretch.value) == (1000, 4e8)
    assert stretch.limit == pytest.approx(5e8 + 0.05 * 1e9)
