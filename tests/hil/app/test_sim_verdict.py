"""Outcome of `hil sim`: success needs a parked platform and complete logs that replay."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import LogError
from drivers.signals import Fault, Mode
from hil.app import replay
from hil.app.configuration.configuration import load
from hil.app.sim import command
from hil.loop.run_end import Ending
from hil.record.log import Log

VIRTUAL = load("virtual")
PARKED = Ending(Mode.PARKED, Fault.NONE, "", 9)
STOPPED = Ending(Mode.FAULT, Fault.ESTOP, "latched fault ESTOP", 9)
FULL = "disk_full: No space left on device"


def simulated(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    ending: Ending,
    own: str = "",
    plant: str | None = None,
    *,
    agrees: bool = True,
    unreadable: str = "",
    **more: Any,
) -> dict[str, Any]:
    """Summary of a simulation of zero ticks.

    own, plant: errors of its log and of the plant's log, plant None: without that log. unreadable: error on reading its log.
    """

    def recording(error: str) -> Any:
        closed = SimpleNamespace(error=error, recorder_cpu_s=0.0)
        log = SimpleNamespace(event=lambda *_: None, close=lambda *_: closed)
        return lambda *_, **__: contextlib.nullcontext(log)

    def opened(_: Path) -> Any:
        if unreadable:
            raise LogError(unreadable)
        return SimpleNamespace(rows=lambda: range(2))

    monkeypatch.setattr(command, "record", recording(own))
    monkeypatch.setattr(command, "_record_plant", recording(plant or ""))
    monkeypatch.setattr(command, "_run_to_end", lambda *_: ending)
    monkeypatch.setattr(Log, "open", opened)
    monkeypatch.setattr(replay, "figures", lambda _: {})
    monkeypatch.setattr(replay, "replay_log", lambda _: (None, {"agrees": agrees}))
    return command.simulate(
        VIRTUAL, log=folder / "a.mcap", duration_s=0.1, plant_log=plant is not None, **more
    )


VERDICTS: dict[str, tuple[dict[str, Any], bool, str]] = {
    "parked": ({}, True, ""),
    "replay differs": ({"agrees": False}, False, ""),
    "two whole logs": ({"plant": ""}, True, ""),
    "own log": ({"own": FULL}, False, FULL),
    "own log, whole plant": ({"own": FULL, "plant": ""}, False, FULL),
    "log of the plant": ({"plant": FULL}, False, FULL),
    "both logs": ({"own": FULL, "plant": FULL}, False, FULL),
    "unreadable": ({"unreadable": "a.mcap: damaged"}, False, "a.mcap: damaged"),
    "own log, unreadable": ({"own": FULL, "unreadable": "a.mcap: damaged"}, False, FULL),
}


@pytest.mark.parametrize(("run", "success", "trouble"), VERDICTS.values(), ids=VERDICTS)
@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_simulation_with_an_incomplete_log_fails(monkeypatch, tmp_path, ending, run, success, trouble):
    found = simulated(monkeypatch, tmp_path, ending, **run)
    assert found["success"] is (ending is PARKED and success)
    assert (found["trouble"] or "") == "; ".join(filter(None, (ending.trouble, trouble)))
    assert found["log"] == str(tmp_path / "a.mcap")
    assert "replay" not in found or trouble == "", "no replay may be reported with an incomplete log"


def ended(ends: Any, faults: Fault) -> list[tuple[Any, ...]]:
    """Records in the log of a simulation with this end in its tick 7, of 2 ms."""
    written: list[tuple[Any, ...]] = []

    def run(*_: Any, **__: Any) -> Any:
        if isinstance(ends, Ending):
            return ends
        raise ends

    cycle = SimpleNamespace(mode=Mode.TRACKING, faults=faults)
    lockstep: Any = SimpleNamespace(cycle=cycle, tick=7, period_ns=2_000_000, run=run)
    recording: Any = SimpleNamespace(
        event=lambda *each: written.append(("event", *each)),
        close=lambda each: written.append(("close", each)),
    )
    operator: Any = SimpleNamespace(arms=False, silent=None)
    try:
        command._run_to_end(lockstep, (recording, None, Path("a.mcap")), 1.0, None, operator)
    except KeyboardInterrupt as interrupt:
        written.append((str(interrupt),))
    return written


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.STALE, Fault.STALE | Fault.ESTOP])
def test_interrupted_simulation_closes_its_log_with_its_faults(faults):
    assert ended(KeyboardInterrupt(), faults) == [
        ("close", {"ending": "TRACKING", "reason": "interrupted", "faults": int(faults)}),
        ("at 0.014 s of simulated time; the log until then: a.mcap",),
    ]


def test_existing_plant_log_is_refused_before_the_simulation(monkeypatch, tmp_path):
    begun = []
    (tmp_path / "a-plant.mcap").write_bytes(b"an earlier one")
    monkeypatch.setattr(command, "build_nodes", lambda *_: begun.append("plant"))
    with pytest.raises(LogError, match=r"a-plant\.mcap: exists and is not overwritten"):
        simulated(monkeypatch, tmp_path, PARKED, plant="")
    assert begun == []
    assert [path.name for path in tmp_path.iterdir()] == ["a-plant.mcap"]
