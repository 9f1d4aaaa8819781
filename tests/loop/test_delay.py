"""Delay compensation in the closed loop: the book's path on the bus of configs/virtual.yaml.

SYNC to force takes 0.5 ms there (the drives' rates are those of a grid of 0.1 ms: latched at 0.1 ms, force
at 0.6 ms), the drives' force loop of 200 Hz lags 0.796 ms, the hold costs 0.5 ms.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.loop import unrecorded

AFTER_A_HOLD = """reference:
  type: waypoints
  interpolation: cubic
  points:
    - {t_s: 0, position_m: [0, 0, 1]}
    - {t_s: 0.1, position_m: [0, 0, 1]}
    - {t_s: 1.1, position_m: [0.25, 0.5, 0.75], rotation_vector_deg: [5, 10, 15]}
    - {t_s: 2.1, position_m: [0, 0, 1]}
"""
BOOK = """reference:
  type: waypoints
  interpolation: cubic
  points:
    - {t_s: 0, position_m: [0, 0, 1]}
    - {t_s: 1, position_m: [0.25, 0.5, 0.75], rotation_vector_deg: [5, 10, 15]}
    - {t_s: 2, position_m: [0, 0, 1]}
"""
TRUE = {"bus_ms": 0.5, "drive_lag_ms": 0.8, "hold_ms": 0.5}


def bench(name, reference, delay=None):
    text = load(name).text
    first, last = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
    text = text[:first] + reference + "\n" + text[last:]
    if delay is not None:
        keys = ", ".join(f"{key}: {value}" for key, value in delay.items())
        damping = "  damping_ratio: 1\n"
        assert text.count(damping) == 1
        text = text.replace(damping, f"{damping}  delay_compensation: {{{keys}}}\n")
    return loads(text, f"{name}.yaml", Path())


def run(configuration, path=None):
    """Simulate; return the rows, those of a log that replays where there is a path for one."""
    if path is None:
        summary, rows = unrecorded.run(configuration)
    else:
        summary = simulate(configuration, log=path)
        assert summary["replay"]["exact"]
        rows = Log.open(path).rows()
    assert summary["success"], summary
    assert not any(summary["limited_ticks"].values())
    return rows


def peak_mm(rows):
    moving = rows[rows["mode"] == Mode.TRACKING]
    return 1e3 * np.abs(moving["q_d"] - moving["q"]).max()


RUNS = {
    "bus": ("virtual", None),
    "bus, compensated": ("virtual", TRUE),
    "bus, twice the delay": ("virtual", {key: 2 * value for key, value in TRUE.items()}),
    "ideal": ("ideal", None),
    "ideal, compensated": ("ideal", {"hold_ms": 0.5}),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run after a hold by its name: its rows."""
    folder = tmp_path_factory.mktemp("delay")
    logged = {name: folder / f"{name}.mcap" for name in ("bus", "bus, compensated")}

    @cache
    def found(name):
        base, compensated = RUNS[name]
        return run(bench(base, AFTER_A_HOLD, compensated), logged.get(name))

    return found


@pytest.mark.long
def test_compensation_leaves_a_third_of_the_error_of_the_bus(runs, capsys):
    with capsys.disabled():
        print("\nexact inverse dynamics, wn 20 rad/s, the book's path after 0.1 s: peak leg error")
        for name, rows in ((name, runs(name)) for name in RUNS):
            print(f"  {name:24} {peak_mm(rows):.4f} mm")
    without, compensated = peak_mm(runs("bus")), peak_mm(runs("bus, compensated"))
    assert without <= 0.15
    assert compensated <= 0.05
    assert compensated <= without / 3


@pytest.mark.long
def test_what_is_left_comes_from_the_jump_of_the_acceleration(runs):
    """It falls between two ticks. Where the path is smooth, from 0.6 s to 1.1 s, an eighth is left."""

    def smooth_mm(rows):
        t = rows["reference_time_s"]
        return peak_mm(rows[(t > 0.6) & (t < 1.1)])

    assert smooth_mm(runs("bus")) == peak_mm(runs("bus"))
    assert smooth_mm(runs("bus, compensated")) < smooth_mm(runs("bus")) / 8
    assert peak_mm(runs("bus, compensated")) > 2 * smooth_mm(runs("bus, compensated"))


@pytest.mark.long
def test_twice_the_delay_is_worse_than_none_and_than_the_true_one(runs):
    wrong = peak_mm(runs("bus, twice the delay"))
    assert wrong > peak_mm(runs("bus"))
    assert wrong > 3 * peak_mm(runs("bus, compensated"))


@pytest.mark.long
def test_half_a_period_of_hold_is_compensated_on_the_ideal_path(runs):
    assert peak_mm(runs("ideal, compensated")) < peak_mm(runs("ideal")) / 10


def test_safety_and_the_log_keep_the_present_state_and_reference(runs):
    """Same path in both logs, tick by tick, and the logged pose is the measured one."""
    a, b = runs("bus"), runs("bus, compensated")
    np.testing.assert_array_equal(a["tick"], b["tick"])
    moving = (a["mode"] == Mode.TRACKING) & (b["mode"] == Mode.TRACKING)
    for column in ("q_d", "dq_d", "ddq_d"):
        assert a[column][moving].tobytes() == b[column][moving].tobytes()
    assert np.abs(a["q"][moving] - b["q"][moving]).max() < 0.2e-3


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """The book's path without a hold before it, stopped on the way."""
    path = tmp_path_factory.mktemp("stopped") / "a.mcap"
    summary = simulate(bench("virtual", BOOK, TRUE), log=path, duration_s=2.2)
    assert summary["success"], summary
    return Log.open(path).rows()


@pytest.mark.parametrize("mode", [Mode.RELEASING, Mode.APPROACH, Mode.STOPPING, Mode.PARKING])
def test_entry_and_exit_have_no_bump(stopped, mode):
    steps = np.abs(np.diff(stopped["tau"], axis=0)).max(axis=1)[stopped["mode"][1:] == mode]
    if mode is Mode.APPROACH:  # its last tick looks into the path
        steps = steps[:-1]
    assert steps.size > 1
    assert steps.max() < 60.0


def test_the_path_begins_before_its_time_by_the_delay(stopped):
    """The jump of the first acceleration, 2.5 kN, is commanded a tick early: 1.8 ms ahead is in the path."""
    begins = int(np.argmax(stopped["mode"] == Mode.TRACKING))
    steps = np.abs(np.diff(stopped["tau"], axis=0)).max(axis=1)
    assert stopped["mode"][begins - 1] == Mode.APPROACH
    assert steps[begins - 2] > 2000.0, "from the tick before the last of the approach to the last"
    assert max(steps[begins - 3], steps[begins - 1], steps[begins]) < 100.0
