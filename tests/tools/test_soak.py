"""A short soak across a wrap of the tick counter, and the mistakes that its marks detect."""

from __future__ import annotations

import pytest

from hil.record.log import Log
from tools.benchmarks.benchmark import patient
from tools.soak import Shift, differences, figures, shift

RATE_Hz = 1000.0
SECONDS = 2.6
GOOD = Shift(0, 2600, [], 1.0, "", 0, (0.0, 0.0), (100.0, 20))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("soak")


@pytest.fixture(scope="module")
def c(folder):
    return patient("virtual", folder, SECONDS)


def met(shifts, name):
    (each,) = [f for f in figures(shifts, RATE_Hz) if f.name == name]
    return each.met


@pytest.mark.parametrize(
    ("first", "crossed"), [(2**16 - 2000, ["16 bit"]), (2**32 - 2000, ["16 bit", "31 bit", "32 bit"])]
)
def test_soak_run_crosses_the_wrap_of_its_tick_counter_and_replays_exactly(c, folder, first, crossed):
    log = folder / "good.mcap"
    found = shift(c, first, SECONDS, log)
    assert (found.first, found.crossed, found.trouble, found.different) == (first, crossed, "", 0)
    assert found.ticks > SECONDS * RATE_Hz
    assert not log.exists()
    assert min(found.held) > 0


def test_soak_run_moves_at_its_counter_wrap_and_replay_from_another_tick_differs(c, folder, monkeypatch):
    log = folder / "kept.mcap"
    monkeypatch.setattr("tools.soak.differences", lambda *_: 1)
    found = shift(c, 2**16 - 2000, SECONDS, log)
    rows = Log.open(log).rows()
    assert abs(rows["dq"][rows["tick"] == 2**16]).max() > 0.01
    assert differences(c, found.first, log) == 0
    assert differences(c, 5, log) >= found.ticks


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"trouble": "latched fault"}, "shifts in trouble"),
        ({"different": 1}, "ticks that differ"),
        ({"grown_MB": (1.1, 0.0)}, "loop, growth in a shift"),
        ({"grown_MB": (0.0, 3.1)}, "recorder, growth in a shift"),
        ({"held": (101.1, 20)}, "process, second shift to last"),
        ({"held": (100.0, 21)}, "open files, second shift to last"),
    ],
)
def test_each_limit_of_the_soak_detects_the_corresponding_mistake(change, name):
    assert met([GOOD] * 3, name) is True
    assert met([GOOD, GOOD, GOOD._replace(**change)], name) is False
