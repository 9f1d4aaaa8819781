"""A CAN FMU without an FMU: sends given bytes at given times, and keeps what it receives."""

from types import SimpleNamespace
from typing import Any

from plant_fmu.network.node import Node


class ScriptedNode(Node):
    """Stands for a `Node` with a countdown Tx clock. Mutable state: time, bytes still to send, `heard`."""

    def __init__(self, sends=(), most_bytes=2048):
        """sends: pairs (time ns, hexadecimal bytes), in order."""
        self.name = "scripted"
        fmu: Any = SimpleNamespace(step_ns=0, countdown=True, most_bytes=most_bytes)
        self.fmu = fmu
        self.reached_ns = 0
        self._left = [(t_ns, bytes.fromhex(text)) for t_ns, text in sends]
        self.heard = []
        """Pairs (time ns, hexadecimal bytes) of what it received."""

    def next_ns(self):
        return self._left[0][0] if self._left else None

    def advance(self, to_ns):
        self.reached_ns = max(self.reached_ns, to_ns)

    def exchange(self, received):
        if received:
            self.heard.append((self.reached_ns, received.hex()))
        due = [content for t_ns, content in self._left if t_ns <= self.reached_ns]
        self._left = self._left[len(due) :]
        return b"".join(due)
