"""Hosting an FMU, piece by piece: what its process may have, what crosses from it, what closing does."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Callable
from multiprocessing.connection import Pipe
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import HilError, PlantError
from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu import child
from plant_fmu.fmu.check import FmuSpec, Start
from plant_fmu.fmu.host import FmuHost

FMU = Path("a.fmu")
FIFO, OTHER = os.SCHED_FIFO, os.SCHED_OTHER
NO_LIMIT = resource.RLIM_INFINITY


@pytest.mark.parametrize(
    ("limit_GB", "of_the_machine", "bound"),
    [
        (4.0, NO_LIMIT, 4_000_000_000),
        (0.25, NO_LIMIT, 250_000_000),
        (4.0, 1_000_000_000, 1_000_000_000),
        (0.5, 1_000_000_000, 500_000_000),
    ],
)
def test_a_process_may_have_its_limit_of_memory_or_a_lower_one_of_the_machine(
    monkeypatch, limit_GB, of_the_machine, bound
):
    asked: list[Any] = []

    def allowed(kind: int) -> tuple[int, int]:
        asked.append(kind)
        return 7, of_the_machine

    monkeypatch.setattr(resource, "getrlimit", allowed)
    monkeypatch.setattr(resource, "setrlimit", lambda *given: asked.append(given))
    child._bound_memory(limit_GB)
    assert asked == [resource.RLIMIT_DATA, (resource.RLIMIT_DATA, (bound, bound))]


@pytest.mark.parametrize("flags", [0, os.SCHED_RESET_ON_FORK])
@pytest.mark.parametrize(("ours", "of_the_child"), [(50, 49), (2, 1), (1, 1)])
def test_a_child_follows_a_real_time_process_one_priority_below_but_at_1_at_least(
    monkeypatch, flags, ours, of_the_child
):
    given: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: FIFO | flags if pid == 0 else OTHER)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(ours if pid == 0 else 99))
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, policy, at: given.append((pid, policy, at.sched_priority))
    )
    child._follow(123)
    assert given == [(123, FIFO | os.SCHED_RESET_ON_FORK, of_the_child)]


def test_a_child_of_a_process_without_real_time_keeps_what_it_has_and_one_that_has_ended_is_no_error(
    monkeypatch,
):
    given: list[object] = []

    def gone(*arguments: object) -> None:
        given.append(arguments)
        raise ProcessLookupError

    monkeypatch.setattr(os, "sched_setscheduler", gone)
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: OTHER | os.SCHED_RESET_ON_FORK)
    child._follow(123)
    assert given == []
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: FIFO)
    monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(9))
    child._follow(123)
    assert len(given) == 1


def served(monkeypatch: pytest.MonkeyPatch, error: Exception) -> str:
    """Return what the child answers where loading the FMU raises an error."""

    def refuse(spec: FmuSpec) -> None:
        raise error

    monkeypatch.setattr(child, "FmuHost", refuse)
    monkeypatch.setattr(child, "_bound_memory", lambda _: None)
    monkeypatch.setattr(child, "_end_with_parent", lambda *_: None)
    ours, theirs = Pipe()
    ours.send(FmuSpec(path=str(FMU), force=["f"], length=["q"], rate=["v"]))
    ours.send(None)
    child.serve(theirs, 1, "no folder")
    return str(ours.recv())


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PlantError("a.fmu: höher"), "a.fmu: höher"),
        (HilError("no"), "no"),
        (MemoryError(), "no memory is left for the FMU's process: plant.model.memory_GB bounds it"),
    ],
)
def test_a_refusal_in_the_child_reaches_the_parent(monkeypatch, error, said):
    assert served(monkeypatch, error) == said


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError("no space left")])
def test_an_unforeseen_error_ends_the_child(monkeypatch, error):
    with pytest.raises(type(error)):
        served(monkeypatch, error)


def test_a_process_that_cannot_be_started_leaves_nothing_open_and_would_not_have_written_to_our_output(
    monkeypatch,
):
    asked: dict[str, Any] = {}

    def refuse(module: str, *arguments: str, **options: Any) -> None:
        asked.update(options, module=module, arguments=arguments)
        assert Path(arguments[-1]).is_dir()
        raise OSError("no more of them")

    monkeypatch.setattr(child, "start", refuse)
    before = sorted(Path("/proc/self/fd").iterdir())
    with pytest.raises(PlantError, match=r"a\.fmu: no child process for the FMU: no more of them"):
        child.ChildHost(FmuSpec(path=str(FMU), force=["f"], length=["q"], rate=["v"]))
    assert sorted(Path("/proc/self/fd").iterdir()) == before
    line, parent, folder = asked["arguments"]
    assert (asked["module"], int(parent), Path(folder).exists()) == (
        "plant_fmu.fmu.child",
        os.getpid(),
        False,
    )
    assert [int(line)] == asked["pass_fds"]
    assert (asked["stdin"], asked["stdout"]) == (subprocess.DEVNULL, 2), "its output is our errors'"
    assert asked["start_new_session"] is True
    assert asked["environment"] == {"TMPDIR": folder}


class Instance:
    """The FMU of a host: it notes its calls, and fails in those that are named."""

    def __init__(self, *fails: str) -> None:
        self.calls: list[str] = []
        self._fails = fails

    def _do(self, name: str) -> None:
        self.calls.append(name)
        if name in self._fails:
            raise RuntimeError(f"{name} fails")

    def terminate(self) -> None:
        self._do("terminate")

    def freeInstance(self) -> None:
        self._do("free")


def hosting(fmu: Instance | None, *, initialised: bool) -> tuple[FmuHost, list[str]]:
    """A host of this instance, and what it removes."""
    removed: list[str] = []
    host = object.__new__(FmuHost)
    host.spec, host.internal_step_s = FmuSpec(path=str(FMU), force=["f"], length=["q"], rate=["v"]), 1e-3
    host._fmu, host._messages = fmu, ["why"]
    host._record = np.zeros((), fmu_call.FMU)
    host._record["ready"] = initialised
    host._folder = SimpleNamespace(cleanup=lambda: removed.append("folder"))  # type: ignore[assignment]
    return host, removed


@pytest.mark.parametrize(
    ("fails", "initialised", "calls"),
    [
        ((), True, ["terminate", "free"]),
        ((), False, ["free"]),
        (("terminate",), True, ["terminate", "free"]),
    ],
)
def test_closing_ends_an_initialised_fmu_frees_it_once_and_removes_its_files(fails, initialised, calls):
    fmu = Instance(*fails)
    host, removed = hosting(fmu, initialised=initialised)
    host.close()
    assert (fmu.calls, removed) == (calls, ["folder"])
    host.close()
    assert fmu.calls == calls
    with pytest.raises(PlantError, match="closed or failed to initialise"):
        host.step(np.zeros(6), np.ones(6), np.zeros(6), 1e-3)


def test_an_fmu_that_cannot_be_freed_is_reported_with_its_message_and_its_files_are_removed():
    host, removed = hosting(Instance("free"), initialised=False)
    with pytest.raises(PlantError, match=r"a\.fmu: the FMU failed while closing: free fails: why$"):
        host.close()
    assert removed == ["folder"]


@pytest.mark.parametrize(
    ("flags", "said"), [((0, 1, 0), "ended the simulation"), ((0, 0, 1), "returned early")]
)
def test_a_step_that_was_interrupted_says_how_and_when(flags, said):
    host, _ = hosting(None, initialised=True)
    host._record["flags"][:3], host._record["last"] = flags, 0.25
    assert str(host._failed(fmu_call.INTERRUPTED)) == f"a.fmu: the FMU {said} at 0.25 s: why"


@pytest.mark.parametrize(
    ("ended", "what"),
    [
        (fmu_call.INPUTS_REFUSED, "take its inputs"),
        (fmu_call.OUTPUTS_REFUSED, "give its outputs"),
        (fmu_call.STEP_REFUSED, "step from here"),
    ],
)
def test_a_refusal_names_what_was_asked_and_the_status(ended, what):
    for status, label in (
        *((2, "discard"), (3, "error"), (4, "fatal"), (5, "pending")),
        *((6, "status 6, which FMI does not have"), (-1, "status -1, which FMI does not have")),
    ):
        host, _ = hosting(None, initialised=True)
        host._record["status"] = status
        told = str(host._failed(ended, "step from here"))
        assert told == f"a.fmu: the FMU refused to {what} ({label}): why"


def test_what_an_fmu_has_said_is_told_once_and_without_what_is_empty():
    host, _ = hosting(None, initialised=True)
    host._messages = ["", "first", "", "second"]
    assert host._said() == ": first; second"
    assert host._said() == ""


class Steps:
    """An FMU that notes what is asked of it, in order."""

    def __init__(self) -> None:
        self.calls: list[Any] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *given, **named: self.calls.append((name, *given, *named.items()))


def preparing(monkeypatch: pytest.MonkeyPatch, major: int, brake: int, status: int) -> tuple[Any, list[Any]]:
    """A host that is about to initialise: 18 inputs, brakes from `brake` on, which are set with this status."""
    fmu = Steps()
    host: Any = hosting(None, initialised=False)[0]
    host._fmu, host._used = fmu, False
    starts = (Start("m", "Float64", (7,), (1.5,)), Start("n", "Int64", (8, 9), (2, 3)))
    host._interface = SimpleNamespace(major=major, starts=starts)
    host._inputs, host._held = np.full(18, 9.0), np.zeros(18, np.int64)
    host._record["slots"] = 0, brake, 12

    def put(_record: Any) -> int:
        fmu.calls.append(("put", host._inputs.tolist()))
        return status

    monkeypatch.setattr(fmu_call, "put", put)
    return host, fmu.calls


@pytest.mark.parametrize("status", [0, 1])
@pytest.mark.parametrize("brake", [6, -1, 0])
@pytest.mark.parametrize("major", [2, 3])
def test_an_fmu_is_set_up_in_order_and_reset_before_each_further_time(monkeypatch, major, brake, status):
    host, calls = preparing(monkeypatch, major, brake, status)
    begin = [("setupExperiment", ("startTime", 0.0))] if major == 2 else []
    inputs = [float(brake <= k < brake + 6 and brake >= 0) for k in range(18)]
    set_up = [
        *begin,
        *[("setFloat64", [7], [1.5]), ("setInt64", [8, 9], [2, 3]), ("enterInitializationMode",)],
        *[("put", inputs), ("exitInitializationMode",)],
    ]
    host._initialise()
    assert calls == set_up
    assert host._record["ready"]
    host._inputs[:] = 5.0
    host._initialise()
    assert calls == [*set_up, ("reset",), *set_up]


def test_an_fmu_that_refuses_its_first_inputs_is_not_initialised(monkeypatch):
    host, calls = preparing(monkeypatch, 3, 6, 3)
    with pytest.raises(PlantError, match=r"refused to take its inputs \(error\): why"):
        host._initialise()
    assert calls[-1][0] == "put"
    assert not host._record["ready"]
    host._fmu = None
    with pytest.raises(PlantError, match="the FMU is closed; open it again"):
        host._initialise()


@pytest.mark.parametrize(
    "failing", ["setFloat64", "enterInitializationMode", "exitInitializationMode", "setupExperiment"]
)
def test_an_fmu_that_cannot_be_set_up_anew_takes_no_step_although_it_ran_before(monkeypatch, failing):
    host, _ = preparing(monkeypatch, 2, 6, 0)
    host._initialise()

    def fail(*_given: Any, **_named: Any) -> None:
        raise OSError("why")

    setattr(host._fmu, failing, fail)
    with pytest.raises(PlantError, match=r"cannot be initialised|refused parameter 'm'"):
        host._initialise()
    assert not host._record["ready"]
    host.internal_step_s = 0.001
    with pytest.raises(PlantError, match="closed or failed to initialise; reset it"):
        host.step(np.zeros(6), np.ones(6), np.zeros(6), 0.001)


def test_a_reset_begins_at_0_and_refuses_what_is_no_measurement(monkeypatch):
    host: Any = hosting(None, initialised=True)[0]
    host._outputs, host._initialise = np.arange(12.0), lambda: None
    host._record["status"] = 3
    ended = fmu_call.DONE
    monkeypatch.setattr(fmu_call, "fetch", lambda _: ended)
    host._record["ticks"] = 9
    q, dq = host.reset()
    assert (q.tolist(), dq.tolist()) == (list(range(6)), list(range(6, 12)))
    assert host._record["ticks"] == 0
    for ended, said in (  # noqa: B007 - what the next fetch answers
        (fmu_call.OUTPUTS_REFUSED, r"refused to give its outputs \(error\)"),
        (fmu_call.OUTPUT_NOT_FINITE, "gave a value that is not finite"),
    ):
        with pytest.raises(PlantError, match=said):
            host.reset()


@pytest.mark.parametrize(
    ("error", "said"),
    [(OSError("no symbol"), "cannot be loaded: no symbol"), (AttributeError("fmi"), "lacks a function")],
)
def test_a_library_that_does_not_load_leaves_the_working_directory_alone(monkeypatch, tmp_path, error, said):
    host: Any = hosting(None, initialised=False)[0]
    description = SimpleNamespace(fmiVersion="3.0")
    host._interface = SimpleNamespace(description=description, library="binaries/m.so")
    host._folder = SimpleNamespace(name=str(tmp_path))

    def load(*_given: Any, **_named: Any) -> None:
        os.chdir(tmp_path)  # where the library finds what lies beside it
        raise error

    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setattr("plant_fmu.fmu.host.instantiate_fmu", load)
    with pytest.raises(PlantError, match=said):
        host._load()
    assert Path.cwd() == here
