"""What is refused is closed again: a daemon that is asked a thousand times has no more files open than before."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.can.runtime_folder import RoleLock
from drivers.errors import BusError, RunError
from drivers.files import open_regular, read_regular


def open_now() -> int:
    """Return how many descriptors this process has."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def refused(act: Callable[[], object], error: type[Exception], message: str) -> int:
    """Return how many descriptors a refusal has left open."""
    before = open_now()
    with pytest.raises(error, match=message):
        act()
    return open_now() - before


def test_what_is_no_regular_file_or_too_large_is_closed(tmp_path):
    pipe, large = tmp_path / "pipe", tmp_path / "large"
    os.mkfifo(pipe)
    large.write_bytes(bytes(11))
    for path in (tmp_path, pipe):
        assert refused(partial(open_regular, path), OSError, "not a regular file") == 0
    assert refused(lambda: read_regular(large, 10), OSError, "more than the 10 bytes") == 0


def test_who_cannot_join_a_bus_or_has_its_role_refused_keeps_nothing(runtime):
    first = Participant("d", BitTiming(1_000_000, 5_000_000), fd=True)
    try:
        other = BitTiming(500_000, 5_000_000)
        assert refused(lambda: Participant("d", other, fd=True), BusError, "runs as CAN FD") == 0
        assert refused(lambda: Participant("d", fd=False), BusError, "runs as CAN FD") == 0
    finally:
        first.close()
    for interface in ("localcan", "socketcan"):
        lock = RoleLock(interface, "d", "plant")
        try:
            assert refused(partial(RoleLock, interface, "d", "plant"), RunError, "already has a plant") == 0
        finally:
            lock.close()


@pytest.mark.parametrize("interface", ["localcan", "socketcan"])
def test_a_role_and_a_bus_that_are_given_back_leave_nothing_open(runtime, interface):
    before = open_now()
    for _ in range(3):
        lock = RoleLock(interface, "d", "controller")
        lock.close()
        lock.close()
    node = Participant("d", BitTiming(1_000_000, 5_000_000), fd=True)
    node.close()
    node.close()
    del node
    assert open_now() == before
