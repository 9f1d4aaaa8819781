"""How the process of an FMU is ended, by its parent and with it."""

from __future__ import annotations

import os
import pickle
import subprocess
from multiprocessing.connection import Pipe
from types import SimpleNamespace
from typing import Any

import pytest

from plant_fmu.fmu import child
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.child import ChildHost

SPEC = FmuSpec(path="a.fmu", force=["f"], length=["q"], rate=["v"])


@pytest.mark.parametrize("hangs", [False, True])
@pytest.mark.parametrize("gone", [False, True])
def test_a_process_is_asked_to_end_and_killed_only_where_it_does_not(hangs, gone):
    did: list[str] = []
    host: Any = object.__new__(ChildHost)
    host.spec, host._ended = SPEC, None
    host._line, theirs = Pipe()

    def wait(timeout_s: float | None = None) -> None:
        did.append(f"wait {timeout_s}, {'closed' if host._line.closed else 'open'}")
        if hangs and "kill" not in did:
            raise subprocess.TimeoutExpired("child", 0.0)

    host._process = SimpleNamespace(wait=wait, kill=lambda: did.append("kill"))
    host._folder = SimpleNamespace(cleanup=lambda: did.append("remove"))
    if gone:
        theirs.close()
    host.close()
    killed = ["kill", "wait None, open"] if hangs else []
    assert did == ["wait 10.0, open", *killed, "remove"]
    assert gone or theirs.recv() is None
    assert host._line.closed
    assert host._ended == "a.fmu: the FMU is closed"
    host.close()
    assert did[-1] == "remove", "a second call does nothing"
    theirs.close()


class LeftError(Exception):
    """What stands in for the end of this process."""


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("line", ["closed", "held open by another"])
def test_a_child_ends_with_its_parent_whoever_holds_the_line_and_removes_its_files(
    monkeypatch, tmp_path, there, line
):
    def leave(code: int) -> None:
        raise LeftError(code)

    folder, (ours, theirs) = tmp_path / "fmu-x", Pipe()
    if there:
        folder.mkdir()
        (folder / "model.so").write_bytes(b"x")
    parents = [70, 70, 1]
    if line == "closed":
        theirs.close()
    monkeypatch.setattr(child, "_LIFE_CHECK_MS", 1)
    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(os, "getppid", lambda: parents.pop(0))
    with pytest.raises(LeftError, match=r"^1$"):
        child._end_with_parent(ours, 70, str(folder))
    assert parents == ([70, 70, 1] if line == "closed" else [])
    assert list(tmp_path.iterdir()) == []
    ours.close()
    theirs.close()


def test_what_to_host_crosses_to_a_process_to_the_bit():
    spec = FmuSpec(
        path="a b/\u00e4.fmu",
        force=["f1"],
        length=["q"],
        rate=["v"],
        step_us=0.1 + 0.2,
        brake=["b"],
        wrench=["w"],
        parameters={"m": 1e-17, "n": 3, "on": True, "name": "x", "com": [0.1, 0.2]},
        truth=["p", "R"],
        assume_unit={"f1": "N"},
        allow_execution_tool=True,
        memory_GB=0.3,
    )
    for each in (spec, SPEC):
        assert pickle.loads(pickle.dumps(each)) == each
