"""Outcome of `hil run`: success needs a complete log that replays, or one with every gap counted."""

from __future__ import annotations

import errno
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, LogError
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app import replay
from hil.app.output import end_record
from hil.app.run import command
from hil.loop.clock import RealTime
from hil.loop.run_end import Ending
from hil.record import LogSummary
from hil.record.log import Log

TICKS = 12
PARKED = Ending(Mode.PARKED, Fault.NONE, "", TICKS)
C: Any = SimpleNamespace(source="a.yaml", controller=None, bus=None, drives=None, sensors=None, folder=None)
CYCLE: Any = SimpleNamespace(parts=SimpleNamespace(rate_Hz=1000.0, law=None))
FULL = "disk_full: No space left on device"
DAMAGED = "a.mcap: damaged at byte 4711"


@pytest.fixture
def verdict(tmp_path, monkeypatch):
    """Summary of a run with the given ticks, and the given results of closing, reading and replay."""

    def summed(
        *, missing=0, dropped=0, lost=0, skipped=0, ticks=TICKS, different=0, agrees=True, error="",
        trouble="", unreadable="", fails=None, ending=PARKED,
    ):  # fmt: skip
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
        monkeypatch.setattr(Log, "open", opened)
        monkeypatch.setattr(replay, "replay_log", replayed)
        for module, name in ((replay, "figures"), (command, "law_figures"), (command, "loads")):
            monkeypatch.setattr(module, name, lambda *_: {})
        whole = not (dropped or lost or error)
        closed = LogSummary(
            tmp_path / "a.mcap", ticks, 0, dropped, lost, 0, 0.0, whole, error, gave_up=bool(error)
        )
        said = replace(ending, reason=trouble) if trouble else ending
        return command._summary(C, CYCLE, said, RealTime([], []), closed)[0]

    return summed


def gap(missing: int, dropped: int, **more: Any) -> dict[str, Any]:
    """A replay ends at a gap: it does not agree, and has no different tick."""
    return {"missing": missing, "dropped": dropped, "agrees": False} | more


NOT_REPLAYED = "the log was not replayed: "
VERDICTS: dict[str, tuple[dict[str, Any], bool, str]] = {
    "whole": ({}, True, ""),
    "replay differs": ({"agrees": False, "different": 1}, False, ""),
    "fault": ({"trouble": "a fault"}, False, "a fault"),
    "recorder gave up": ({"error": FULL}, False, f"{FULL}: 0 ticks are not in the log"),
    "gave up, dropped": ({"error": FULL, "missing": 3, "dropped": 3}, False, f"{FULL}: 3 ticks are not in the log"),
    "gave up, lost": ({"error": FULL, "lost": 4}, False, f"{FULL}: 4 ticks are not in the log"),
    "gave up, nothing left": ({"error": FULL, "dropped": 9, "lost": 9, "ticks": 0}, False, f"{FULL}: 18 ticks are not in the log"),
    "fault, gave up": ({"error": FULL, "lost": 1, "trouble": "a fault"}, False, f"a fault; {FULL}: 1 ticks are not in the log"),
    "each gap counted": (gap(5, 5), True, ""),
    "one gap counted": (gap(1, 1), True, ""),
    "one not counted": (gap(6, 5), False, ""),
    "one counted too often": (gap(4, 5), False, ""),
    "many not counted": (gap(50, 1), False, ""),
    "none counted": (gap(1, 0), False, ""),
    "counted, not missing": (gap(0, 5), False, ""),
    "counted, differs": (gap(5, 5, different=1), False, ""),
    "skipped periods": (gap(2, 2, skipped=7), True, ""),
    "skipped, one less": (gap(1, 2, skipped=7), False, ""),
    "skipped, one more": (gap(3, 2, skipped=7), False, ""),
    "unreadable": ({"unreadable": DAMAGED}, False, DAMAGED),
    "fault, unreadable": ({"unreadable": DAMAGED, "trouble": "a fault"}, False, f"a fault; {DAMAGED}"),
    "dropped, unreadable": ({"unreadable": DAMAGED, "missing": 3, "dropped": 3}, False, DAMAGED),
    "log gone": ({"fails": LogError("no such file")}, False, f"{NOT_REPLAYED}no such file"),
    "no law": ({"fails": ConfigurationError("no law")}, False, f"{NOT_REPLAYED}no law"),
    "disk full": ({"fails": OSError(errno.ENOSPC, "No space", "/t/x")}, False, f"{NOT_REPLAYED}/t/x: No space"),
}  # fmt: skip


@pytest.mark.parametrize(("run", "success", "trouble"), VERDICTS.values(), ids=VERDICTS)
def test_run_fails_if_its_log_lost_ticks_that_were_not_counted(verdict, run, success, trouble):
    found = verdict(**run)
    assert found["success"] is success
    assert (found["trouble"] or "") == trouble
    assert found["dropped_ticks"] == run.get("dropped", 0) + run.get("lost", 0)


ENDINGS = {
    Mode.PARKED: "parked", Mode.FAULT: "fault", Mode.HELD: "held", Mode.WAITING: "not begun", Mode.IDLE: "not begun",
}  # fmt: skip


@pytest.mark.parametrize("mode", ENDINGS)
@pytest.mark.parametrize("requested", [True, False])
def test_summary_reports_how_the_run_ended_and_whether_on_request(verdict, mode, requested):
    found = verdict(ending=replace(PARKED, mode=mode, requested=requested))
    assert found["ending"] == ENDINGS[mode] + (" on request" if requested else "")
    assert found["success"] is (mode is Mode.PARKED)


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.STALE, Fault.STALE | Fault.SPEED])
def test_end_record_of_a_log_has_the_latched_faults(faults):
    ending = replace(PARKED, mode=Mode.FAULT, faults=faults)
    assert end_record(ending, "why") == {"ending": "FAULT", "reason": "why", "faults": int(faults)}
