"""When a simulation is a success: parked, both logs whole, and a log that replays; and which one it was."""

from __future__ import annotations

import contextlib
import errno
import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.signals import Fault, Mode
from hil.app.configuration.configuration import load
from hil.app.sim import command
from hil.loop.homing import LastPose
from hil.loop.run_end import Ending
from plant_fmu.config import FmuPlant

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
    fails: Exception | None = None,
    figures: dict[str, Any] | None = None,
    unreadable: str = "",
    **more: Any,
) -> dict[str, Any]:
    """Return the summary of a simulation of no tick.

    own, plant: why its log, and that of the plant, is not whole; plant None: there is none. fails: what its
    replay raises. figures: of its log; unreadable: why it has none.
    """

    def replayed(_: Path) -> tuple[None, dict[str, Any]]:
        if fails is not None:
            raise fails
        return None, {"agrees": agrees}

    def recording(error: str) -> Any:
        closed = SimpleNamespace(error=error, recorder_cpu_s=0.0)
        log = SimpleNamespace(event=lambda *_: None, close=lambda *_: closed)
        return lambda *_, **__: contextlib.nullcontext(log)

    monkeypatch.setattr(command, "record", recording(own))
    monkeypatch.setattr(command, "_record_plant", recording(plant or ""))
    monkeypatch.setattr(command, "_run_to_end", lambda *_: ending)
    monkeypatch.setattr(command, "_figures", lambda *_: (dict(figures or {}), unreadable))
    monkeypatch.setattr(command, "replay_log", replayed)
    return command.simulate(
        VIRTUAL, log=folder / "a.mcap", duration_s=0.1, plant_log=plant is not None, **more
    )


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


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        (LogError("a.mcap: no such file"), "a.mcap: no such file"),
        (OSError(errno.ENOSPC, "No space left on device", "/t/x"), "/t/x: No space left on device"),
    ],
)
@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_a_simulation_that_cannot_be_replayed_in_the_end_has_its_summary_all_the_same(
    monkeypatch, tmp_path, ending, fails, why
):
    found = simulated(monkeypatch, tmp_path, ending, fails=fails)
    said = f"the log was not replayed: {why}"
    assert (found["success"], found["trouble"]) == (
        False,
        "; ".join(filter(None, (ending.trouble, said))),
    )
    assert found["log"] == str(tmp_path / "a.mcap")


def ended(monkeypatch: pytest.MonkeyPatch, ends: Any, faults: Fault) -> list[tuple[Any, ...]]:
    """Return what is written into the log of a simulation whose loop ends so in its tick 7, of 2 ms."""
    written: list[tuple[Any, ...]] = []

    def run(*_: Any) -> Any:
        if isinstance(ends, Ending):
            return ends
        raise ends

    monkeypatch.setattr(command, "_run", run)
    lockstep: Any = SimpleNamespace(
        cycle=SimpleNamespace(mode=Mode.TRACKING, faults=faults), tick=7, period_ns=2_000_000
    )
    recording: Any = SimpleNamespace(
        event=lambda *each: written.append(("event", *each)),
        close=lambda each: written.append(("close", each)),
    )
    operator: Any = None
    try:
        command._run_to_end(lockstep, (recording, None, Path("a.mcap")), 1.0, None, operator)
    except KeyboardInterrupt as interrupt:
        written.append((str(interrupt),))
    return written


@pytest.mark.parametrize("faults", [Fault.NONE, Fault.STALE, Fault.STALE | Fault.ESTOP])
def test_an_interrupted_simulation_closes_its_log_with_its_mode_and_its_faults_and_says_when(
    monkeypatch, faults
):
    assert ended(monkeypatch, KeyboardInterrupt(), faults) == [
        ("close", {"ending": "TRACKING", "reason": "interrupted", "faults": int(faults)}),
        ("at 0.014 s of simulated time; the log until then: a.mcap",),
    ]


def test_the_trouble_of_a_simulation_stands_in_its_log_at_its_last_tick(monkeypatch):
    trouble = ("event", 14_000_000, "error", "latched fault ESTOP")
    assert ended(monkeypatch, STOPPED, Fault.ESTOP) == [trouble]
    assert ended(monkeypatch, PARKED, Fault.NONE) == []


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


def test_simulations_of_an_fmu_that_was_built_anew_under_its_name_are_not_the_same_run(tmp_path):
    model = FmuPlant.model_validate(
        {"type": "fmu", "path": "a.fmu", "force": ["f"], "length": ["q"], "rate": ["v"]}
    )
    assert VIRTUAL.plant is not None
    c = VIRTUAL.model_copy(update={"plant": VIRTUAL.plant.model_copy(update={"model": model})})
    c._folder = tmp_path
    found = []
    for content in (b"one", b"two", b"one", b""):
        (tmp_path / "a.fmu").write_bytes(content)
        found.append(command.run_identity(c, 2.0, None, None, ()))
    assert found[0] == found[2]
    assert len(set(found)) == 3


def test_simulations_whose_legs_stand_elsewhere_are_not_the_same_run_and_since_when_is_nothing():
    one = np.ones(6)
    stood = LastPose(one, 0.01 * one, 0.2 * one, 0.02 * one, "parked 2026-01-01", "hil homing a")
    others: list[LastPose | None] = [None, stood]
    for name in ("length", "limit_m", "step_m", "m_per_turn"):
        for leg in range(6):
            moved = getattr(stood, name).copy()
            moved[leg] = np.nextafter(moved[leg], 2.0)
            others.append(stood._replace(**{name: moved}))
    found = [command.run_identity(VIRTUAL, 2.0, None, None, (), each) for each in others]
    assert len(set(found)) == len(others) == 26
    later = stood._replace(origin="parked 2026-01-02")
    assert command.run_identity(VIRTUAL, 2.0, None, None, (), later) == found[1]


def test_the_identity_of_a_run_is_asked_for_with_where_its_legs_stand(monkeypatch, tmp_path):
    asked = []

    def identity(*given):
        asked.append(given)
        return "a"

    stood = object()
    keeper = SimpleNamespace(
        last_pose=stood, begin=lambda _: None, close=lambda: None, summary=lambda _: {}, trouble=""
    )
    monkeypatch.setattr(command, "Keeper", lambda *_, **__: keeper)
    monkeypatch.setattr(command, "run_identity", identity)
    parts = SimpleNamespace(trajectory=SimpleNamespace(duration_s=1.0), law=None)
    monkeypatch.setattr(command, "build_cycle", lambda *_, **__: SimpleNamespace(parts=parts))
    monkeypatch.setattr(command, "build_lockstep", lambda *_, **__: None)
    monkeypatch.setattr(command, "law_figures", lambda *_: {})
    simulated(monkeypatch, tmp_path, PARKED)
    assert [given[-1] for given in asked] == [stood]


def faulty(*names: str) -> Any:
    return SimpleNamespace(plant=SimpleNamespace(faults=names))


@pytest.mark.parametrize(
    ("begun", "waiting", "expected"),
    [
        ([], [], {"time_not_reached": ["a", "b", "c"]}),
        (["b"], [], {"injected": ["b"], "time_not_reached": ["a", "c"]}),
        ([], ["c"], {"mode_not_reached": ["c"], "time_not_reached": ["a", "b"]}),
        (["a"], ["c"], {"injected": ["a"], "mode_not_reached": ["c"], "time_not_reached": ["b"]}),
        (["c", "a", "b"], [], {"injected": ["c", "a", "b"]}),
    ],
)
def test_each_fault_has_struck_or_waits_for_its_mode_or_for_its_time_and_is_told_once(
    monkeypatch, begun, waiting, expected
):
    monkeypatch.setattr(command, "show_fault", str)
    nodes: Any = SimpleNamespace(schedule=SimpleNamespace(begun=lambda _: begun), now_ns=0, waiting=waiting)
    assert command._injected(faulty("a", "b", "c"), nodes) == expected


def test_set_points_that_were_not_reached_stand_beside_those_that_were_taken(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "Script", lambda *_: SimpleNamespace(left=3))
    monkeypatch.setattr(command, "run_identity", lambda *_: "1")
    given = {"setpoints": {"taken": 5, "refused": 1, "why": None}}
    for figures in ({}, given):
        folder = tmp_path / str(len(figures))
        folder.mkdir()
        found = simulated(monkeypatch, folder, PARKED, figures=figures, setpoints=folder / "poses.csv")
        assert found["setpoints"] == figures.get("setpoints", {}) | {"not_reached": 3}


def test_commands_that_were_not_given_were_neither_given_nor_refused():
    operator: Any = SimpleNamespace(left=2, refused=1)
    assert command._commands([], operator) == {}
    assert command._commands([(0.0, "hold")] * 7, operator) == {
        "commands": {"given": 5, "refused": 1, "not_reached": 2}
    }


def test_a_simulation_whose_plant_log_exists_is_refused_before_its_own_log_is_begun(monkeypatch, tmp_path):
    begun = []
    (tmp_path / "a-plant.mcap").write_bytes(b"an earlier one")
    monkeypatch.setattr(command, "build_nodes", lambda *_: begun.append("plant"))
    with pytest.raises(LogError, match=r"a-plant\.mcap: exists and is not overwritten"):
        simulated(monkeypatch, tmp_path, PARKED, plant="")
    assert begun == []
    assert [path.name for path in tmp_path.iterdir()] == ["a-plant.mcap"]


@pytest.mark.parametrize(("own", "told"), [("", "a.mcap: damaged"), (FULL, FULL)])
@pytest.mark.parametrize("ending", [PARKED, STOPPED], ids=["parked", "stopped"])
def test_a_log_that_cannot_be_read_is_a_trouble_of_its_own_where_its_recorder_had_none(
    monkeypatch, tmp_path, ending, own, told
):
    found = simulated(monkeypatch, tmp_path, ending, own, unreadable="a.mcap: damaged")
    assert found["success"] is False
    assert found["trouble"] == "; ".join(filter(None, (ending.trouble, told)))
    assert "replay" not in found
