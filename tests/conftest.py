"""Rules of the whole suite: a test marked `realtime` has the machine to itself, and comes late.

The suite runs in several processes (pytest-xdist). Every test holds a shared lock, a real-time test the
exclusive one; whoever waits for it stands in the door, so that no further test slips in before. A patient
real-time test, whose limits outlast a busy neighbour, is alone among real-time tests only.

A real-time test that fails while the machine stood still for longer than its limits outlast says nothing of
the project: it runs again, five times at most, and the summary says so. Nor does a time limit for one example of
hypothesis.
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
"""A stall that a real-time test need not outlast, by its patience."""
ATTEMPTS = 6
"""Tries of a real-time test, each after the first only beside a stall that was measured."""

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
    """Have a place beside the other test processes, or, `alone`, wait until they pause and be the only one.

    At any time one `realtime` test runs; whoever waits for that does not stand in the others' way.
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
    """Let each test run in its place."""
    realtime = _is_realtime(item)
    alone = realtime and not _is_patient(item)
    with place(item.config.rootpath / ".pytest_cache", alone=alone, realtime=realtime):
        return (yield)


@pytest.hookimpl(tryfirst=True, specname="pytest_runtest_protocol")
def pytest_run_in_real_time(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a real-time test, again where the machine stood still; leave others to pytest."""
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
    """Say something of a test among the warnings of the summary, where warnings are errors, too."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.warn(text, pytest.PytestWarning, stacklevel=2)
    (warning,) = caught
    kwargs = {"warning_message": warning, "when": "runtest", "nodeid": item.nodeid, "location": None}
    item.ihook.pytest_warning_recorded.call_historic(kwargs=kwargs)


@pytest.hookimpl(trylast=True)
def pytest_runtest_setup() -> None:
    """Let what a test starts hear Ctrl-C, which it would inherit the deafness to.

    In the background of a script SIGINT is ignored, and a command that was called in this process leaves it so.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the real-time tests last, since a mistake elsewhere shows sooner, but the patient ones first.

    While these run, the other processes still have something to do.
    """
    items.sort(key=_when)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector from half a million objects that are there for good: 0.2 s a time."""
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
