"""Recorder in a thread of this process: for simulations where there is no shared memory without a name.

That is everywhere but on Linux, where the recorder is a process.
"""

from __future__ import annotations

import queue
from collections.abc import Mapping
from importlib import import_module
from threading import Thread
from typing import Any

from hil.record.ring import Ring


class RecorderThread(Thread):
    """Both ends of the recorder's pipes as queues. State: the summary, once the recording is closed."""

    def __init__(self, ring: Ring) -> None:
        super().__init__(daemon=True)
        self.ring = ring
        self.inbox: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self.answers: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        self.summary: Mapping[str, str] | None = None
        self.start()

    def run(self) -> None:
        """Record until the recording is closed; the recorder's module imports this one's callers."""
        setup = self.inbox.get()
        if setup is not None:
            setup = {**setup, "packer": None}  # that of this process
            import_module("hil.record.recorder").record(
                setup, lambda _: self.ring, lambda: self, self.answers.put
            )

    def ended(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s`; True if the recording has been closed."""
        try:
            self.summary = self.inbox.get(timeout=timeout_s)
        except queue.Empty:
            return False
        return True

    def poll(self) -> int | None:
        """None while the thread runs, as that of a process."""
        return None if self.is_alive() else 0

    def answer(self, timeout_s: float) -> dict[str, Any]:
        """Next answer of the recorder, waited for up to `timeout_s`."""
        try:
            return dict(self.answers.get(timeout=timeout_s))
        except queue.Empty:
            return {"error": f"the recorder did not answer within {timeout_s:g} s"}

    def finish(self) -> None:
        """Wait up to 5 s until the log is closed."""
        self.inbox.put(None)
        self.join(5.0)
