"""`hil plot`: any column by name, several logs in the same panels, and refusals."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from drivers.tick_columns import RECORDED, ROW
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.cli import main
from hil.study.log_columns import curves
from hil.study.plot import Curve, draw, plot

PNG = b"\x89PNG\r\n"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for name, duration in (("one", 0.3), ("two", 0.5)):
        simulate(load("ideal"), log=folder / f"{name}.mcap", duration_s=duration, check_replay=False)
    return folder / "one.mcap", folder / "two.mcap"


def texts(path):
    """All text in an SVG file."""
    return ["".join(e.itertext()) for e in ET.parse(path).iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.parametrize("name", [c.name for c in RECORDED])
def test_every_column_gives_one_curve_per_element_with_its_unit(name):
    rows = np.zeros(3, ROW)
    rows[name] = np.arange(rows[name].size).reshape(rows[name].shape)
    (column,) = (c for c in RECORDED if c.name == name)
    found = curves(RECORDED, name)
    labels = [f"{name}.{e}" for e in column.elements] or [name]
    assert [s.label for s in found] == labels
    for k, signal in enumerate(found):
        assert signal.of(rows).tolist() == rows[name].reshape(3, -1)[:, k].tolist()
        assert curves(RECORDED, signal.label) == [signal]
        assert signal.unit in column.unit


def test_plotted_difference_of_columns_is_computed_element_by_element():
    rows = np.zeros(2, ROW)
    rows["q_d"], rows["q"] = 3.0, np.arange(6.0)
    assert [curve.of(rows)[0] for curve in curves(RECORDED, "q_d - q")] == [3.0, 2.0, 1.0, 0.0, -1.0, -2.0]
    (one,) = curves(RECORDED, "q_d.leg_1 - q.leg_5")
    assert (one.of(rows)[0], one.unit) == (-2.0, "m")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("qq", r"^log: no column 'qq'; did you mean .*\bq\b"),
        ("q.leg_6", r"no column 'q\.leg_6'; did you mean .*q\.leg_"),
        ("q - p", "invalid difference"),
        ("q - dq", "invalid difference"),
        ("mode - faults", "invalid difference"),
    ],
)
def test_an_unknown_column_is_refused_with_the_allowed_ones(name, message):
    with pytest.raises(LogError, match=message):
        curves(RECORDED, name, "log")


def test_a_picture_shows_units_names_of_values_and_both_logs(logs, tmp_path):
    out = tmp_path / "both.svg"
    plot(logs, ("tau.leg_3", "mode", "dq"), out=out)
    said = texts(out)
    assert {"one: tau.leg_3", "two: tau.leg_3", "N", "m/s", "s", "TRACKING", "PARKED"} <= set(said)


def test_the_command_draws_a_difference_as_png(tmp_path, logs):
    out = tmp_path / "x.png"
    result = CliRunner().invoke(
        main, ["plot", str(logs[0]), "-c", "p - p_d", "--out", str(out), "--to", "0.1"]
    )
    assert (result.exit_code, out.read_bytes()[: len(PNG)]) == (0, PNG)


def test_only_the_time_between_from_and_to_is_drawn(logs, tmp_path):
    plot(logs[:1], ("reference_time_s",), out=tmp_path / "a.svg", start_s=0.05, end_s=0.06)
    ticks = [float(t.replace("−", "-")) for t in texts(tmp_path / "a.svg") if t.replace(".", "").isdigit()]
    assert max(t for t in ticks if t < 1.0) <= 0.07
    with pytest.raises(LogError, match="allowed: within 0 to"):
        plot(logs[:1], ("q",), out=tmp_path / "b.svg", start_s=1e3)


def test_plot_of_a_truncated_log_has_a_remark_and_of_a_damaged_log_is_refused(logs, tmp_path, monkeypatch):
    monkeypatch.setattr("hil.study.plot.draw", lambda *_: None)
    whole = logs[1].read_bytes()
    cut, torn = tmp_path / "cut.mcap", tmp_path / "torn.mcap"
    cut.write_bytes(whole[: int(0.9 * len(whole))])
    torn.write_bytes(whole[: len(whole) // 2] + bytes(64) + whole[len(whole) // 2 + 64 :])
    assert plot(logs, ("q",), out=tmp_path / "a.svg")["remark"] is None
    found = plot([cut, logs[0]], ("q",), out=tmp_path / "b.svg")
    assert found["remark"].startswith(f"{cut}: the log is cut")
    with pytest.raises(LogError, match=r"torn\.mcap: damaged .*--salvage"):
        plot([torn], ("q",), out=tmp_path / "c.svg")


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1.7e308, -1.7e308])
def test_plotted_numbers_too_large_for_an_axis_leave_a_gap(tmp_path, value):
    values = np.array([0.0, 2.0, value, value, 3.0])
    curve = Curve("tau", 0, np.arange(5.0), values, "N", {}, flags=False)
    draw(["tau"], [[curve]], tmp_path / "a.svg", "a")
    ticks = [float(text.replace("\u2212", "-")) for text in texts(tmp_path / "a.svg") if text[-1:].isdigit()]
    assert len(ticks) > 8
    assert (min(ticks), max(ticks)) == (0.0, 4.0), "the time; the values end at 3"
