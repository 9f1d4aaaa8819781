"""The same law over an ideal and over a real path, every shipped bench, and every kind of reference.

What a delay costs: with exact inverse dynamics a force that is late by T disturbs e'' + 2 wn e' + wn^2 e by
T times the jerk of the reference, so the error is proportional to T. The ideal path is late by half a period,
the hold's, and its error is known from outside; the others follow from their delays.
"""

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.cli import main
from hil.record.log import Log
from tests.broad import broad
from tests.loop import unrecorded

DATA = Path(__file__).parents[1] / "data"
ZOH_IDEAL_MM = json.loads((DATA / "book_closed_loop.json").read_text())["rows"][
    "joint_IDC_exact_wn20_1kHz_ZOH"
]["peak_leg_err_mm"]
HOLD_S = 0.5e-3
"""A force held for a period of 1 ms is late by half of it."""
BUS_S = (75.0 + 6 * 64.6 + 60.0 + 105.6) * 1e-6
"""SYNC of 2 bytes, six feedbacks of 12, the controller's 60 us, a command of 32 bytes, at 1 and 5 Mbit/s."""
LAG_S = 1 / (2 * pi * 200.0)
"""First-order force loop of 200 Hz."""


def edited(name, *changes):
    text = load(name).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, f"{name}.yaml", Path())


@pytest.fixture(scope="module")
def peaks():
    """Peak leg error in mm of the book's path, one thing after the other added to the ideal path."""
    encoders = ("encoder_resolution_m: 0 ", "encoder_resolution_m: 1e-6 ")
    bus = ("layout: ideal", "layout: fd")
    benches = {
        "ideal": edited("ideal"),
        "encoders of 1 um": edited("ideal", encoders),
        "encoders and bus time": edited("ideal", encoders, bus),
        "encoders, bus time and drives of 200 Hz": edited("virtual", ("periods: 10", "periods: 1")),
    }
    found: dict[str, float] = {}
    for name, bench in benches.items():
        summary, _ = unrecorded.run(bench)
        assert summary["success"], (name, summary)
        assert not any(summary["limited_ticks"].values()), (name, summary["limited_ticks"])
        found[name] = summary["tracking"]["peak_leg_error_mm"]
    return found


@pytest.mark.long
def test_each_part_of_a_real_path_costs_some_accuracy_and_no_limit_acts(peaks, capsys):
    with capsys.disabled():
        print("\nexact inverse dynamics, wn 20 rad/s, 1 kHz, the book's path: peak leg error")
        for name, peak in peaks.items():
            print(f"  {name:40} {peak:.4f} mm")
    ideal, encoders, bus, drives = peaks.values()
    assert ideal == pytest.approx(ZOH_IDEAL_MM, rel=0.10)
    assert ideal < encoders < bus < drives
    assert encoders - ideal < 2e-3, "an encoder step of 1 um"


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "delay_s"),
    [
        ("encoders and bus time", HOLD_S + BUS_S),
        ("encoders, bus time and drives of 200 Hz", HOLD_S + BUS_S + LAG_S),
    ],
)
def test_the_error_grows_with_the_delay(peaks, name, delay_s):
    assert peaks[name] == pytest.approx(ZOH_IDEAL_MM * delay_s / HOLD_S, rel=0.05)


# -- every shipped bench -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", broad(["lab", "vcan50", "ideal", "bench", "virtual"], quick=3))
def test_every_shipped_bench_parks_and_replays(name, tmp_path):
    result = CliRunner().invoke(
        main,
        [
            "sim",
            name,
            "--duration",
            "0.8",
            "--log",
            str(tmp_path / "a.mcap"),
            "--json",
            str(tmp_path / "a.json"),
        ],
    )
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "a.json").read_text())
    assert summary["replay"]["exact"]
    assert summary["replay"]["ticks"] == summary["ticks"] > 0.8 * summary["rate_Hz"]
    assert summary["stale_ticks"] == summary["rejected_frames"] == 0
    assert not any(summary["limited_ticks"].values())


# -- every kind of reference ---------------------------------------------------------------------------------


def with_reference(text, folder=None):
    virtual = load("virtual").text
    first, last = virtual.index("\nreference:") + 1, virtual.index("\nlimits:") + 1
    return loads(virtual[:first] + text + "\n" + virtual[last:], "my.yaml", folder or Path())


def run(configuration, path):
    """Simulate; return the rows of the tracking and the time along the reference."""
    summary = simulate(configuration, log=path)
    assert summary["success"], summary
    assert summary["replay"]["exact"]
    rows = Log.open(path).rows()
    rows = rows[rows["mode"] == Mode.TRACKING]
    return rows, rows["reference_time_s"]


def at(rows, t, instant):
    return rows["p"][int(np.argmin(np.abs(t - instant)))]


def test_a_held_pose_is_held_within_encoder_steps(tmp_path):
    held = "reference:\n  type: hold\n  pose: {position_m: [0.05, -0.05, 1.02]}\n  duration_s: 1\n"
    rows, t = run(with_reference(held), tmp_path / "a.mcap")
    assert t[-1] == pytest.approx(1.0, abs=2e-3)
    error = np.abs(rows["p"] - [0.05, -0.05, 1.02]).max(axis=1)
    assert error.max() < 50e-6, "left over from the approach"
    assert error[t > 0.8].max() < 2e-6, "two steps of the encoder"


@pytest.mark.long
def test_sinusoids_on_all_axes(tmp_path):
    text = "reference:\n  type: sinusoids\n  duration_s: 5\n  ramp_s: 1\n  components:\n"
    for axis, amplitude, f in [
        ("x_m", 0.05, 0.5),
        ("z_m", 0.04, 0.25),
        ("rx_deg", 3, 0.5),
        ("rz_deg", 4, 0.25),
    ]:
        text += f"    - {{axis: {axis}, amplitude: {amplitude}, frequency_Hz: {f}}}\n"
    rows, t = run(with_reference(text), tmp_path / "a.mcap")
    middle = (t > 1.0) & (t < 4.0)
    x, z = 0.05 * np.sin(np.pi * t), 1 + 0.04 * np.sin(np.pi / 2 * t)
    assert np.abs(rows["p"][middle, 0] - x[middle]).max() < 0.1e-3
    assert np.abs(rows["p"][middle, 2] - z[middle]).max() < 0.1e-3
    assert np.abs(rows["p"][:, 1]).max() < 0.1e-3


def test_quintic_way_points_are_met(tmp_path):
    points = [(0, [0, 0, 1]), (1.0, [0.1, -0.1, 1.05]), (2.2, [-0.1, 0.05, 0.95]), (3.0, [0, 0, 1])]
    text = "reference:\n  type: waypoints\n  interpolation: quintic\n  points:\n"
    text += "".join(f"    - {{t_s: {t}, position_m: {p}}}\n" for t, p in points)
    rows, t = run(with_reference(text), tmp_path / "a.mcap")
    for instant, p in points:
        assert np.abs(at(rows, t, instant) - p).max() < 0.1e-3
    half = at(rows, t, 0.5)
    assert np.abs(half - [0.05, -0.05, 1.025]).max() < 0.5e-3, "a quintic is half way at half time"


def test_a_sampled_path_is_followed_and_replays_without_its_file(tmp_path):
    def circle(t):
        return 0.04 * (1 - np.cos(np.pi * t / 2)), 0.05 * np.sin(np.pi * t / 2) ** 2

    folder = tmp_path / "bench"
    folder.mkdir()
    lines = ["t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg"]
    for t in np.arange(0.0, 4.1, 0.2):
        x, y = circle(t)
        lines.append(f"{t:.1f},{x:.9f},{y:.9f},1,0,{20 * x:.9f},0")
    (folder / "path.csv").write_text("\n".join(lines))
    configuration = with_reference("reference:\n  type: sampled\n  path: path.csv\n", folder)
    rows, t = run(configuration, tmp_path / "a.mcap")
    assert t[-1] > 3.99
    x, y = circle(t)
    assert np.abs(rows["p"] - np.stack([x, y, np.ones_like(t)], axis=1)).max() < 0.1e-3
    (folder / "path.csv").unlink()
    verdict, _ = replay_log(tmp_path / "a.mcap")
    assert verdict.exact
