"""How the process of an FMU is waited for and ended, and what its board holds, without a process."""

from __future__ import annotations

import os
import pickle
import select
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import PlantError
from plant_fmu.fmu import child
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.child import ChildHost

SPEC = FmuSpec(Path("a.fmu"), ("f",), ("q",), ("v",), 1e-3)


class Process:
    """A process that ends when it is waited for, or only once it is killed."""

    pid = 4321

    def __init__(self, did: list[str], *, hangs: bool = False) -> None:
        self._did, self._hangs = did, hangs

    def kill(self) -> None:
        self._did.append("kill")
        self._hangs = False

    def wait(self, timeout_s: float | None = None) -> None:
        self._did.append(f"wait {timeout_s}")
        if self._hangs:
            raise subprocess.TimeoutExpired("child", 0.0)


def is_open(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True


def hosting(did: list[str], *, hangs: bool = False, refuses: bool = False) -> Any:
    """A host whose process and files are these; `did` is what happens to them, in order."""
    host: Any = object.__new__(ChildHost)
    host.spec, host._ended = SPEC, None
    host._process = Process(did, hangs=hangs)
    read, host._command_w = os.pipe()
    os.close(read)
    host._reply_r, host._life_w = os.pipe()
    files = host._command_w, host._life_w, host._reply_r
    wait = host._process.wait

    def waited(timeout_s: float | None = None) -> None:
        did.append("".join("oc"[not is_open(fd)] for fd in files))
        wait(timeout_s)

    def asked(command: int, timeout_s: float, what: str) -> None:
        did.append(f"ask {command} {timeout_s} {what}")
        if refuses:
            raise PlantError("it refuses")

    host._process.wait, host._ask = waited, asked
    host._board = {}
    host._folder = SimpleNamespace(cleanup=lambda: did.append("remove"))
    host.files = files
    return host


ASK, FREED = "ask 3 5.0 close", ["remove"]
WAIT = ["coo", "wait 60.0"]
"""Its commands end before it is waited for, its life line and its answers stay."""


@pytest.mark.parametrize(
    ("how", "ended", "did"),
    [
        ({}, None, [ASK, *WAIT, *FREED]),
        ({"refuses": True}, None, [ASK, "kill", *WAIT, *FREED]),
        ({"hangs": True}, None, [ASK, *WAIT, "kill", "coo", "wait None", *FREED]),
        ({}, "it died", [*WAIT, *FREED]),
    ],
)
def test_a_process_is_asked_to_free_its_fmu_then_waited_for_and_killed_only_where_it_does_not_end(
    how, ended, did
):
    found: list[str] = []
    host = hosting(found, **how)
    host._ended = ended
    host.close()
    assert found == did
    assert [is_open(fd) for fd in host.files] == [False] * 3
    assert host._ended == (ended or "a.fmu: the FMU is closed")
    host.close()
    assert found == did, "a second call does nothing"


def test_a_process_that_does_not_answer_in_time_is_stopped_and_that_stays_the_reason():
    did: list[str] = []
    host = hosting(did)
    polled: list[float] = []
    host._poll = SimpleNamespace(poll=polled.append)
    with pytest.raises(
        PlantError, match=r"a\.fmu: the FMU did not step within 0\.25 s; its process was stopped"
    ):
        host._wait(0.25, "step")
    assert polled == [250.0]
    assert did == ["kill", "ooo", "wait None"]
    del host._ask
    for use in (lambda: host._ask(1, 5.0, "step"), lambda: host.step(*[np.zeros(6)] * 3, 1e-3)):
        with pytest.raises(PlantError, match="did not step within"):
            use()
    host.close()


def test_the_answers_of_a_process_are_lengths_and_rates_pose_twist_and_forces():
    host: Any = object.__new__(ChildHost)
    host.spec = FmuSpec(**{**vars(SPEC), "truth": ("p", "R", "twist", "applied")})
    asked: list[Any] = []
    host._ask = lambda *given: asked.append(given)
    host._board = {"measured": np.arange(12.0), "truth": np.arange(100.0, 124.0)}
    q, dq = host._measured()
    assert (q.tolist(), dq.tolist()) == (list(range(6)), list(range(6, 12)))
    truth = host.truth()
    assert asked == [(2, 5.0, "give its outputs")]
    assert [each.tolist() for each in (truth.p, truth.twist)] == [[100, 101, 102], list(range(112, 118))]
    assert truth.R.tolist() == [[103, 104, 105], [106, 107, 108], [109, 110, 111]]
    assert truth.applied_force.tolist() == host.applied_force().tolist() == list(range(118, 124))
    host._board["truth"][:] = 0.0
    assert truth.applied_force[0] == 118.0, "the caller's to keep"
    host.spec = SPEC
    assert (host.truth(), host.applied_force()) == (None, None)
    assert len(asked) == 1


def test_a_process_is_given_our_priority_before_it_is_asked_to_reset(monkeypatch):
    did: list[Any] = []
    host = hosting([])
    host._measured, host._ask = lambda: "measured", lambda *given: did.append(given)
    monkeypatch.setattr(child, "_follow", did.append)
    assert host.reset() == "measured"
    assert did == [4321, (0, 60.0, "reset")]


def test_a_step_hands_over_force_brake_wrench_and_time_before_it_is_asked_for():
    host = hosting([])
    host._measured, record = lambda: "measured", dict[str, Any]()
    host._board = record
    asked: list[Any] = []
    host._ask = lambda *given: asked.append((*given, dict(record)))
    assert host.step("force", "brake", "wrench", 0.25) == "measured"
    given = {"force": "force", "brake": "brake", "wrench": "wrench", "dt": 0.25}
    assert asked == [(1, 5.0, "step", given)]


class LeftError(Exception):
    """What stands in for the end of this process."""


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("line", ["closed", "held open by another"])
def test_a_child_ends_with_its_parent_whoever_holds_its_life_line_and_removes_its_files(
    monkeypatch, tmp_path, there, line
):
    def leave(code: int) -> None:
        raise LeftError(code)

    folder, (read, write) = tmp_path / "fmu-x", os.pipe()
    if there:
        folder.mkdir()
        (folder / "model.so").write_bytes(b"x")
    parents = [70, 70, 1]
    if line == "closed":
        os.close(write)
    monkeypatch.setattr(child, "_LIFE_CHECK_MS", 1)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(os, "getppid", lambda: parents.pop(0))
    with pytest.raises(LeftError, match=r"^1$"):
        child._end_with_parent(read, 70, str(folder))
    assert parents == ([70, 70, 1] if line == "closed" else [])
    assert list(tmp_path.iterdir()) == []
    os.close(read)
    if line != "closed":
        os.close(write)


def test_a_child_looks_once_a_second_whether_its_parent_is_there(monkeypatch, tmp_path):
    def leave(code: int) -> None:
        raise LeftError(code)

    asked: list[Any] = []
    line = SimpleNamespace(register=lambda *given: asked.append(given), poll=asked.append)
    monkeypatch.setattr(select, "poll", lambda: line)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(os, "getppid", lambda: 70 if len(asked) < 4 else 1)
    with pytest.raises(LeftError, match=r"^1$"):
        child._end_with_parent(5, 70, str(tmp_path / "none"))
    assert asked == [(5, select.POLLHUP), 1000, 1000, 1000]


def test_what_to_host_crosses_to_a_process_to_the_bit():
    spec = FmuSpec(
        path=Path("a b/\u00e4.fmu"),
        force=("f1", "f2"),
        length=("q",),
        rate=("v",),
        step_s=0.1 + 0.2,
        brake=("b",),
        wrench=("w",),
        parameters={"m": 1e-17, "n": 3, "on": True, "name": "x", "com": [0.1, 0.2]},
        truth=("p", "R"),
        assume_unit={"f1": "N"},
        allow_execution_tool=True,
        memory_GB=0.3,
    )
    for each in (spec, SPEC):
        assert pickle.loads(pickle.dumps(each)) == each
    assert FmuSpec(Path("a.fmu"), ("f",), ("q",), ("v",), 1e-3, (), (), {}, (), {}, False, 4.0) == SPEC
