"""Rules of the whole suite: a test marked `realtime` has the machine to itself, and comes late.

The suite runs in several processes (pytest-xdist). Every test holds a shared lock, a real-time test the
exclusive one; whoever waits for it stands in the door, so that no further test slips in before. A patient
real-time test, whose limits outlast a busy neighbour, is alone among real-time tests only.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import IO

import pytest

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


@pytest.hookimpl(trylast=True)
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
        gc.collect()
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
