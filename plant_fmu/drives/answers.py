"""The drives' end of a protocol whose answers need no memory, as `RememberingDrives`."""

from typing import cast

from drivers.arrays import Array, Ints
from drivers.protocol import DriveProtocol, Frame, Memory, RememberingDrives, Status, Sync


class PlainDrives:
    """The drives of a protocol whose answers do not depend on its memory."""

    def __init__(self, protocol: DriveProtocol) -> None:
        self._protocol = protocol

    def answer(
        self,
        memory: Memory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[Memory, list[tuple[int, Frame]]]:
        """Encode the feedbacks."""
        return memory, self._protocol.feedbacks(sync, length, rate, force, state, fault)

    def report(self, memory: Memory, status: Status) -> tuple[Memory, tuple[Frame, ...]]:
        """Encode the status."""
        return memory, self._protocol.status(status)


def drives_of(protocol: DriveProtocol) -> RememberingDrives:
    """Return the drives' end of a protocol that answers: the protocol itself where it remembers."""
    return cast("RememberingDrives", protocol) if hasattr(protocol, "report") else PlainDrives(protocol)
