"""When a run is a success: with a whole log that replays, or one whose only lack was counted."""

import errno
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.config import BusSettings
from drivers.errors import ConfigurationError, LogError
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app.output import closing
from hil.app.run import command
from hil.loop.clock import RealTime
from hil.loop.run_end import NO_DRIVES, Ending
from hil.record import LogSummary
from hil.record.log import Log

TICKS = 12
PARKED = Ending(Mode.PARKED, Fault.NONE, "", TICKS)
C: Any = SimpleNamespace(source="a.yaml", controller=None, bus=None, drives=None, sensors=None)
CYCLE: Any = SimpleNamespace(parts=SimpleNamespace(rate_Hz=1000.0, law=None))
FULL = "disk_full: No space left on device"


@pytest.fixture
def verdict(tmp_path, monkeypatch):
    """A function that sums up a run that parked: ticks that are missing, dropped and lost; how it replays."""

    def summed(
        *,
        missing=0,
        dropped=0,
        lost=0,
        different=0,
        agrees=True,
        error="",
        ticks=TICKS,
        trouble="",
        unreadable="",
        fails=None,
        ending=PARKED,
        skipped=0,
        stood_ns=None,
    ):
        def replayed(_):
            if fails is not None:
                raise fails
            return None, {"agrees": agrees, "different_ticks": different}

        def opened(_):
            if unreadable:
                raise LogError(unreadable)
            return SimpleNamespace(rows=lambda: rows)

        rows = np.zeros(ticks, ROW)
        rows["tick"] = np.arange(ticks)
        rows["tick"][ticks // 2 :] += missing + skipped
        rows["skipped"][ticks // 2 :][:1] = skipped
        rows["stretched_ns"] = stood_ns or 0
        monkeypatch.setattr(Log, "open", opened)
        monkeypatch.setattr(command, "replay_log", replayed)
        for name in ("figures", "law_figures", "loads"):
            monkeypatch.setattr(command, name, lambda *_: {})
        whole = not (dropped or lost or error)
        closed = LogSummary(
            tmp_path / "a.mcap", ticks, 0, dropped, lost, 0, 0.0, whole, error, gave_up=bool(error)
        )
        return command._summary(
            C,
            CYCLE,
            ending,
            trouble,
            RealTime([], []),
            closed,
            stretching=stood_ns is not None,
        )

    return summed


def test_a_whole_log_that_replays_is_a_success(verdict):
    found = verdict()
    assert (found["success"], found["trouble"], found["dropped_ticks"]) == (True, None, 0)
    assert "recorder" not in found
    assert not verdict(agrees=False, different=1)["success"]
    assert not verdict(trouble="a fault")["success"]


@pytest.mark.parametrize(
    ("dropped", "lost", "ticks"), [(0, 0, TICKS), (3, 0, TICKS), (0, 4, TICKS), (9, 9, 0)]
)
def test_a_run_whose_recorder_gave_up_is_no_success_although_what_the_log_has_replays(
    verdict, dropped, lost, ticks
):
    found = verdict(error=FULL, missing=dropped, dropped=dropped, lost=lost, ticks=ticks)
    assert not found["success"]
    assert found["trouble"] == f"{FULL}: {dropped + lost} ticks are not in the log"
    also = verdict(error=FULL, lost=1, trouble="a fault")
    assert also["trouble"] == f"a fault; {FULL}: 1 ticks are not in the log"


@pytest.mark.parametrize(
    ("missing", "dropped", "different", "success"),
    [
        (5, 5, 0, True),
        (1, 1, 0, True),
        (6, 5, 0, False),
        (4, 5, 0, False),
        (50, 1, 0, False),
        (1, 0, 0, False),
        (0, 5, 0, False),
        (5, 5, 1, False),
    ],
)
def test_a_log_with_gaps_proves_a_run_only_where_each_missing_tick_was_counted_as_dropped(
    verdict, missing, dropped, different, success
):
    """Beyond a gap a replay says nothing: it does not agree, and has no tick that differs."""
    found = verdict(missing=missing, dropped=dropped, different=different, agrees=False)
    assert found["success"] is success
    assert found["dropped_ticks"] == dropped


@pytest.mark.parametrize("skipped", [0, 1, 7])
@pytest.mark.parametrize(("dropped", "missing"), [(2, 2), (2, 1), (2, 3)])
def test_periods_that_the_loop_skipped_are_no_ticks_that_the_log_lacks(verdict, skipped, dropped, missing):
    found = verdict(skipped=skipped, missing=missing, dropped=dropped, agrees=False)
    assert found["success"] is (missing == dropped)


@pytest.mark.parametrize(
    ("mode", "ending"),
    [
        (Mode.PARKED, "parked"),
        (Mode.FAULT, "fault"),
        (Mode.HELD, "held"),
        (Mode.WAITING, "not begun"),
        (Mode.IDLE, "not begun"),
    ],
)
@pytest.mark.parametrize("requested", [True, False])
def test_a_summary_says_how_the_run_ended_and_whether_that_was_asked_for(verdict, mode, ending, requested):
    found = verdict(ending=replace(PARKED, mode=mode, requested=requested))
    assert found["ending"] == ending + (" on request" if requested else "")
    assert found["success"] is (mode is Mode.PARKED)


@pytest.mark.parametrize(("tick", "last"), [(-1, None), (0, 0), (5, 5), (TICKS - 1, TICKS - 1)])
def test_the_ticks_before_a_fault_end_with_its_own_be_it_the_first_of_all(verdict, tick, last):
    found = verdict(ending=replace(PARKED, mode=Mode.FAULT, faults=Fault.BUS, fault_tick=tick))
    shown = [each["tick"] for each in found.get("last_ticks", [])]
    assert shown == ([] if last is None else list(range(last + 1)))


@pytest.mark.parametrize("stood_ns", [None, 0, 5_000_000])
def test_how_long_the_time_of_a_bench_stood_still_is_told_where_it_may(verdict, stood_ns):
    found = verdict(stood_ns=stood_ns)
    assert ("bench_time" in found) is (stood_ns is not None)
    if stood_ns is not None:
        assert found["bench_time"]["stretches"] == (TICKS if stood_ns else 0)


@pytest.mark.parametrize("with_plant", [True, False])
@pytest.mark.parametrize("several", [True, False])
def test_where_no_drive_answered_each_bus_is_named_and_the_plant_only_where_none_was_started(
    with_plant, several
):
    bus = {
        "interface": "localcan",
        "channels": [{"channel": "a", "legs": [0, 1, 2]}, {"channel": "b", "legs": [3, 4, 5]}],
    } if several else {"interface": "localcan", "channel": "a"}  # fmt: skip
    c: Any = SimpleNamespace(source="mine.yaml", bus=BusSettings.model_validate(bus))
    silent = replace(PARKED, mode=Mode.WAITING, reason=NO_DRIVES)
    found = command._explained(silent, c, with_plant=with_plant).reason
    where = (
        "localcan channel a (legs 0, 1, 2) and localcan channel b (legs 3, 4, 5)"
        if several
        else "localcan channel a"
    )
    assert found.startswith(f"no drive answered on {where} within 2 s: check power, wiring, bit rate and ")
    assert ("hil plant mine.yaml" in found) is not with_plant
    for other in (PARKED, replace(PARKED, mode=Mode.FAULT, reason="latched fault STALE")):
        assert command._explained(other, c, with_plant=with_plant) is other


@pytest.mark.parametrize("dropped", [0, 3])
def test_a_log_that_was_closed_and_cannot_be_read_again_is_no_success_and_its_summary_says_why(
    verdict, dropped
):
    damaged = "a.mcap: damaged at byte 4711"
    found = verdict(unreadable=damaged, missing=dropped, dropped=dropped)
    assert (found["success"], found["trouble"], found["dropped_ticks"]) == (False, damaged, dropped)
    also = verdict(unreadable=damaged, dropped=dropped, trouble="a fault")
    assert also["trouble"] == f"a fault; {damaged}"


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        (LogError("a.mcap: no such file"), "a.mcap: no such file"),
        (ConfigurationError("a.mcap:config.yaml:3: no law"), "a.mcap:config.yaml:3: no law"),
        (OSError(errno.ENOSPC, "No space left on device", "/t/x"), "/t/x: No space left on device"),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
    ],
)
@pytest.mark.parametrize("error", ["", FULL])
def test_a_run_that_cannot_be_replayed_in_the_end_has_its_summary_and_last_ticks_all_the_same(
    verdict, fails, why, error
):
    stopped = replace(PARKED, mode=Mode.FAULT, faults=Fault.ESTOP, fault_tick=7)
    found = verdict(fails=fails, error=error, ending=stopped, trouble="a fault")
    full = f"{FULL}: 0 ticks are not in the log" if error else ""
    said = f"the log was not replayed: {why}"
    assert found["trouble"] == "; ".join(filter(None, ("a fault", full, said)))
    assert not found["success"]
    assert not verdict(fails=fails)["success"]
    assert found["last_ticks"][-1]["tick"] == 7
    assert "replay" not in found


@pytest.mark.parametrize(
    ("error", "why"),
    [(LogError("a.mcap: no such file"), "a.mcap: no such file"), (OSError(28, "No space"), "No space")],
)
def test_a_picture_that_cannot_be_drawn_in_the_end_is_no_success_and_says_why(
    monkeypatch, tmp_path, error, why
):
    def fails(*_):
        raise error

    monkeypatch.setattr(Log, "open", fails)
    result: dict[str, Any] = {"tracking": {"ticks": 3}, "rate_Hz": 1000.0}
    command._draw(result, SimpleNamespace(name="a"), tmp_path / "a.mcap", tmp_path / "a.png")  # type: ignore[arg-type]
    assert (result["success"], result["unwritten"]) == (False, [why])
    assert "picture" not in result


def test_a_log_whose_recorder_died_is_said_to_be_cut_beside_the_reason(verdict):
    found = verdict(unreadable="a.mcap: cut at 99 bytes", error="the recorder died", lost=4)
    assert found["recorder"] == "the recorder died: 4 ticks are not in the log; a.mcap: cut at 99 bytes"


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.STALE, Fault.STALE | Fault.SPEED, Fault.ESTOP])
def test_the_end_of_a_log_says_which_faults_were_latched_by_their_bits(faults):
    ending = replace(PARKED, mode=Mode.FAULT, faults=faults)
    assert closing(ending, "why") == {"ending": "FAULT", "reason": "why", "faults": int(faults)}
