"""Waiting for frames on an interface that can only be asked and waited for."""

from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Set as AbstractSet

from drivers.protocol import ERROR, Received


def collect(
    receive: Callable[[], list[Received]],
    block: Callable[[float], None],
    deadline_ns: int,
    wanted: AbstractSet[int],
    *,
    first: bool,
) -> list[Received]:
    """Receive until all of `wanted` (with `first`: anything) has come, or the monotonic deadline."""
    received: list[Received] = []
    missing = set(wanted)
    while True:
        new = receive()
        received += new
        if missing:
            missing.difference_update([frame.id for _, frame in new if not frame.flags & ERROR])
        if not missing and (received or not first):
            return received
        left = deadline_ns - time.monotonic_ns()
        if left <= 0:
            return received
        block(left * 1e-9)
