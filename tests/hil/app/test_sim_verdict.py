"""When a simulation is a success: parked, both logs whole, and a log that replays; and which one it was."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.signals import Fault, Mode
from hil.app.configuration.configuration import load
from hil.app.sim import command
from hil.loop.run_end import Ending

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
) -> dict[str, Any]:
    """Return the summary of a simulation of no tick.

    own, plant: why its log, and that of the plant, is not whole; plant None: there is none.
    """

    def recording(error: str) -> Any:
        closed = SimpleNamespace(error=error, recorder_cpu_s=0.0)
        log = SimpleNamespace(event=lambda *_: None, close=lambda *_: closed)
        return lambda *_, **__: contextlib.nullcontext(log)

    monkeypatch.setattr(command, "record", recording(own))
    monkeypatch.setattr(command, "_record_plant", recording(plant or ""))
    monkeypatch.setattr(command, "_run_to_end", lambda *_: ending)
    monkeypatch.setattr(command, "_figures", lambda *_: ({}, ""))
    monkeypatch.setattr(command, "replay_log", lambda _: (None, {"agrees": agrees}))
    return command.simulate(VIRTUAL, log=folder / "a.mcap", duration_s=0.1, plant_log=plant is not None)


@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
@pytest.mark.parametrize("agrees", [True, False])
def test_a_simulation_is_a_success_where_it_parked_and_its_log_replays(monkeypatch, tmp_path, ending, agrees):
    found = simulated(monkeypatch, tmp_path, ending, agrees=agrees)
    assert found["replay"] == {"agrees": agrees}
    assert found["success"] is (ending is PARKED and agrees)


@pytest.mark.parametrize(("own", "plant"), [(FULL, None), (FULL, ""), ("", FULL), (FULL, FULL)])
@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_a_simulation_whose_log_or_plant_log_is_not_whole_is_no_success_and_says_why(
    monkeypatch, tmp_path, ending, own, plant
):
    found = simulated(monkeypatch, tmp_path, ending, own, plant)
    assert found["success"] is False
    assert found["trouble"] == "; ".join(filter(None, (ending.trouble, FULL)))
    assert "replay" not in found, "there is nothing to compare"


def test_a_simulation_of_two_whole_logs_is_a_success(monkeypatch, tmp_path):
    found = simulated(monkeypatch, tmp_path, PARKED, "", "")
    assert (found["success"], found["trouble"]) == (True, None)


FILES: list[list[tuple[str, bytes]]] = [
    [],
    [("path.csv", b"0 1")],
    [("path.csv", b"0 2")],
    [("feedforward.csv", b"0 1")],
    [("path.csv", b"0 1"), ("controller.yaml", b"a")],
    [("path.csv", b"0 1"), ("controller.yaml", b"b")],
    [("path.csv", b"0 1"), ("feedforward.csv", b"a")],
]


def test_simulations_whose_named_files_differ_in_name_or_content_are_not_the_same_run(monkeypatch):
    found = []
    for files in FILES:
        monkeypatch.setattr(command, "attachments", lambda _, files=files: files)
        found += [command.run_identity(VIRTUAL, 2.0, None, None, ()) for _ in range(2)]
    assert found[::2] == found[1::2]
    assert all(a != b for a, b in itertools.combinations(found[::2], 2))
