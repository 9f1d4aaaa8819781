"""The figures of a page, recomputed from the log's table: curves, extremes, percentiles, bus load."""

from __future__ import annotations

import base64
import json
import re
from math import sqrt
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.can.bus_time import BitTiming
from drivers.protocol import BUS, Frame
from drivers.signals import Mode, Warn
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.record.log import Log
from hil.study.report import sections
from hil.study.report.charts import Chart, Curve, charts
from hil.study.report.command import report
from hil.study.report.margins import Margin
from hil.study.report.page import figure, thin
from hil.study.report.timing import Traffic, counts, spreads, traffic
from tests.hil.study.test_report_limits import limited, rows_of

LEGS = [f"leg_{leg}" for leg in range(6)]


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4").astype(np.float64)


def cells(text):
    """Cells of each row of a table."""
    rows = re.findall(r"<tr>(.*?)</tr>", text)
    return [
        [re.sub(r"<.*?>", "", c).strip() for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", r)] for r in rows
    ]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """Page of a run short enough for curves with all samples, and its log as a table."""
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
    """Assert that curves equal values (n, m), and are NaN while no reference is followed."""
    found = curves(chart)
    for label, y in zip(labels, values.T, strict=True):
        wanted = y if follows is None else np.where(follows, y, np.nan)
        scale = np.nanmax(np.abs(wanted))
        np.testing.assert_allclose(found[label], wanted, rtol=0, atol=1e-6 * scale, err_msg=label)


def test_errors_are_reference_minus_measurement_in_mm_or_mrad(page):
    shown, _, frame, _ = page
    follows = frame["mode"].between(Mode.RELEASING, Mode.PARKING).to_numpy()
    assert 0 < follows.sum() < len(frame)
    matrix = [r + c for r in "xyz" for c in "xyz"]
    for name, parts, title in (("p", "xyz", "Position"), ("q", LEGS, "Leg")):
        labels = [part.replace("_", " ") for part in parts]
        error = 1e3 * (columns(frame, f"{name}_d", parts) - columns(frame, name, parts))
        expect(shown[f"{title} error [mm]"], labels, error, follows)
    R, R_d = (
        Rotation.from_matrix(columns(frame, name, matrix)[follows].reshape(-1, 3, 3)) for name in ("R", "R_d")
    )
    e = np.full((len(frame), 3), np.nan)
    e[follows] = 1e3 * (R_d * R.inv()).as_rotvec()
    assert shown["rotation"]["unit"] == "mrad"
    expect(shown["rotation"], ["rx", "ry", "rz"], e)
    np.testing.assert_allclose(unpacked(shown["rotation"]["t"]), frame.index, atol=1e-6)


@pytest.mark.parametrize(
    ("key", "names", "levels"),
    [
        # 25 kN of the controller, 30 kN of the drives
        ("Leg force [N]", {"tau": "sent", "drive_force": "reported by the drive"}, [-25000.0, 25000.0]),
        ("Leg length [m]", {"q": "measured"}, [0.75, 2.2]),
        ("Leg rate [m/s]", {"dq": "measured"}, [-2.0, 2.0]),
        ("Position [m]", {"p": "measured"}, []),
        ("Lyapunov function [(m/s^2)^2]", {"lyapunov": "V, energy of the tracking error"}, []),
        ("Share [1]", {"lyapunov_share": "error, of its certified limit"}, [1.0]),
    ],
)
def test_a_chart_has_the_columns_of_the_log_and_the_limits(page, key, names, levels):
    shown, _, frame, _ = page
    assert shown[key]["levels"] == levels
    for name, word in names.items():
        there = [label for label in frame if label == name or label.startswith(f"{name}.")]
        elements = [label.partition(".")[2].replace("_", " ") for label in there]
        labels = [f"{element}, {word}" if element else word for element in elements]
        expect(shown[key], labels, frame[there].to_numpy())
        assert name in shown[key]["columns"].split(", ")


def test_references_are_dotted_and_modes_are_labelled_by_name(page):
    shown, _, frame, _ = page
    kinds = {c["label"]: c["kind"] for c in shown["Leg length [m]"]["curves"]}
    assert (kinds["leg 3, reference"], kinds["leg 3, measured"]) == ("dotted", "line")
    names = dict(shown["mode"]["names"])
    named = [names[value] for value in curves(shown["mode"])["mode"].tolist()]
    assert named == [Mode(mode).name for mode in frame["mode"].tolist()]


def test_bus_load_is_the_sum_of_the_frame_times(page):
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
    np.testing.assert_allclose(curves(shown["answered"])["last feedback"], answered, rtol=1e-5)
    assert shown["answered"]["levels"] == [1000.0]


def test_the_3d_view_has_joints_poses_and_forces_of_the_run(page):
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


def test_force_and_moment_of_a_wrench_have_separate_charts():
    rows = rows_of(5, wrench=[1000.0, -2000.0, 3000.0, 40.0, 50.0, -60.0])
    shown = {c.key: c for c in charts(rows, None, Traffic(np.full(5, np.nan), {}), 1000.0)}
    for key, unit, labels, values in (
        ("Load on the platform [N]", "N", ["fx", "fy", "fz"], [1000.0, -2000.0, 3000.0]),
        ("Load on the platform [N m]", "N m", ["mx", "my", "mz"], [40.0, 50.0, -60.0]),
    ):
        assert shown[key].unit == unit
        assert [c.label for c in shown[key].curves] == labels
        assert [c.values[0] for c in shown[key].curves] == pytest.approx(values)


def test_extremes_are_minimum_maximum_and_rms():
    y = np.array([3.0, np.nan, -4.0, 0.0, 1.0])
    made = figure(Chart("x", "X", "x", "m", (Curve("a", y),)), np.array([0.0, 0.1, 0.2, 0.3, 0.4]))
    assert cells(made)[1] == ["a", "-4 at 0.200 s", "3 at 0.000 s", f"{sqrt(26 / 4):.5g}"]


def test_percentiles_cover_all_ticks():
    rows = rows_of(1001, lateness_ns=1000 * np.arange(1001)[::-1])
    rows["compute_ns"] = 2_000
    rows["compute_ns"][0] = 10**9
    found = dict(spreads(rows, np.full(1001, np.nan)))
    assert found["wake-up, late by"] == pytest.approx((500e3, 990e3, 999e3, 1000e3))
    assert set(found["computing of a tick"]) == {2000.0}, "the first tick has no computing time before it"
    assert "last feedback after the tick's start" not in found
    log: Any = SimpleNamespace(lockstep=False, metadata={})
    made = sections.timing(log, spreads(rows, np.full(1001, np.nan)), [], [])
    assert cells(made)[:2] == [
        ["time", "p50", "p99", "p99.9", "max"],
        ["wake-up, late by", "500.0 µs", "990.0 µs", "999.0 µs", "1000.0 µs"],
    ]


def test_late_ticks_and_missing_ticks_are_counted():
    rows = rows_of(100)
    rows["skipped"][[0, 50]] = 7, 2
    rows["tick"][50:] += 2
    rows["tick"][80:] += 5
    rows["warnings"][[3, 4]] = Warn.LATE
    assert [n for _, n in counts(rows)] == [2, 5]


def test_margin_in_a_report_is_the_limit_minus_the_value():
    found = Margin("leg rate", "limits.speed_m_s", 0.5, 2.0, "m/s", 3, 4)
    made = sections.limits([found], np.linspace(0.0, 0.9, 10), "")
    assert cells(made)[1][2:] == ["0.5 m/s", "2 m/s", "1.5 m/s", "4", "0.300", "limits.speed_m_s"]
    assert "25.0 %" in cells(made)[1][1]


@pytest.mark.parametrize(("of_controller", "least"), [(25000.0, 25000.0), (40000.0, 30000.0)])
def test_the_force_chart_shows_the_smaller_of_both_force_limits(of_controller, least):
    rows = rows_of(5, tau=1.0)
    shown = charts(rows, limited(force_N=of_controller), Traffic(np.full(5, np.nan), {}), 1000.0)
    (force,) = (chart for chart in shown if chart.title == "Leg force")
    assert force.levels == (-least, least), "30 kN are those of the drives"


def test_the_load_of_each_bus_follows_from_its_own_bit_rate():
    frame = Frame(0x80, bytes(8))
    sent = (frame, frame._replace(flags=BUS), frame._replace(flags=BUS))
    log: Any = SimpleNamespace(
        can_channels=("a", "b"), ticks=lambda: [SimpleNamespace(sent=sent, received=(), row={"t_ns": 0})]
    )
    busy = traffic(log, rows_of(1), [BitTiming(1_000_000, 1_000_000), BitTiming(250_000, 250_000)]).busy_ns
    assert list(busy) == ["bus a", "bus b"]
    assert busy["bus b"][0] == 2 * 4 * busy["bus a"][0] > 0, "two frames at a quarter of the rate"
    assert list(traffic(log, rows_of(1), [BitTiming(1_000_000, 1_000_000), None]).busy_ns) == ["bus a"]


@pytest.mark.parametrize("at", [0, 1, 4999, 12345, 99_998, 99_999])
def test_thinning_of_a_chart_keeps_a_peak_of_one_sample_and_its_time(at):
    t = np.linspace(0.0, 99.999, 100_000)
    y, z = np.sin(t), np.full(100_000, np.nan)
    y[at], z[at] = 50.0, -7.0
    x, (thin_y, thin_z) = thin(t, [y, z], bins=500)
    assert len(x) <= 1000
    assert (np.diff(x) >= 0).all()
    assert thin_y.max() == 50.0
    assert abs(x[np.argmax(thin_y)] - t[at]) <= 0.2
    assert np.nanmin(thin_z) == -7.0
