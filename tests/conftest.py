"""Rules of the whole suite: a test marked `realtime` has the machine to itself, and runs late.

The suite runs in several processes (pytest-xdist). Every test holds a shared lock, a real-time test the
exclusive one. A test that waits for it holds the door lock, so that no other test can start. A patient
real-time test has limits that are longer than the disturbance by a busy neighbour; it excludes only other
real-time tests.

If a real-time test fails while the machine stalled for longer than the test's limits, the failure says
nothing about the project. The test runs again, up to five times, and the summary reports it. For the same
reason hypothesis has no time limit per example.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import signal
import warnings
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import IO

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings

from tests.stalls import StallWatch

settings.register_profile("shared machine", deadline=None)
settings.load_profile("shared machine")

STALL_S = {False: 0.004, True: 0.05}
"""Stall that a real-time test need not survive, by its patience."""
ATTEMPTS = 6
"""Tries of a real-time test; each further one only after a measured stall."""

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `hil` has it; the suite has a process a processor


@contextlib.contextmanager
def held(file: IO[str], kind: int) -> Iterator[None]:
    """Hold a lock of `kind` on `file`; unlock by name, since forked children share the file."""
    fcntl.flock(file, kind)
    try:
        yield
    finally:
        fcntl.flock(file, fcntl.LOCK_UN)


@contextlib.contextmanager
def place(folder: Path, *, alone: bool, realtime: bool) -> Iterator[None]:
    """Take a place among the test processes; if `alone`, wait until the others pause.

    At most one `realtime` test runs at a time; one that waits for this does not block the others.
    """
    folder.mkdir(exist_ok=True)
    with contextlib.ExitStack() as stay:
        if realtime:
            stage = stay.enter_context((folder / "stage.lock").open("w"))
            stay.enter_context(held(stage, fcntl.LOCK_EX))
        door = stay.enter_context((folder / "door.lock").open("w"))
        room = stay.enter_context((folder / "room.lock").open("w"))
        with held(door, fcntl.LOCK_EX):
            stay.enter_context(held(room, fcntl.LOCK_EX if alone else fcntl.LOCK_SH))
        yield


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run each test in its place."""
    realtime = _is_realtime(item)
    alone = realtime and not _is_patient(item)
    with place(item.config.rootpath / ".pytest_cache", alone=alone, realtime=realtime):
        return (yield)


@pytest.hookimpl(tryfirst=True, specname="pytest_runtest_protocol")
def pytest_run_in_real_time(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a real-time test, and repeat it if the machine stalled; leave other tests to pytest."""
    if not _is_realtime(item):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for attempt in range(1, ATTEMPTS + 1):
        with StallWatch() as watch:
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        failed = any(report.failed for report in reports)
        if not failed or watch.longest_s < STALL_S[_is_patient(item)] or attempt == ATTEMPTS:
            break
        _note(item, f"failed as the machine stood still for {watch.longest_s:.3f} s: run again")
        item.session._setupstate.teardown_exact(None)
        item._initrequest()  # type: ignore[attr-defined]
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _note(item: pytest.Item, text: str) -> None:
    """Add a note on a test to the warnings of the summary, also where warnings are errors."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.warn(text, pytest.PytestWarning, stacklevel=2)
    (warning,) = caught
    kwargs = {"warning_message": warning, "when": "runtest", "nodeid": item.nodeid, "location": None}
    item.ihook.pytest_warning_recorded.call_historic(kwargs=kwargs)


@pytest.hookimpl(trylast=True)
def pytest_runtest_setup() -> None:
    """Let processes that a test starts receive Ctrl-C: they would inherit an ignored SIGINT.

    A script in the background ignores SIGINT, and a command called in this process leaves it so.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the real-time tests to the end, the patient ones to the front.

    A mistake elsewhere then shows early, and the other processes are busy while the patient ones run.
    """
    items.sort(key=_when)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector away from half a million permanent objects: 0.2 s per collection."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _when(item: pytest.Item) -> int:
    if _is_patient(item):
        return 0
    return 2 if _is_realtime(item) else 1


def _is_realtime(item: pytest.Item) -> bool:
    return item.get_closest_marker("realtime") is not None


def _is_patient(item: pytest.Item) -> bool:
    mark = item.get_closest_marker("realtime")
    return mark is not None and bool(mark.kwargs.get("patient"))
