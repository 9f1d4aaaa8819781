"""What drives send that have just been powered up."""

from drivers.arrays import Array, Ints
from drivers.protocol import DriveProtocol, Frame, Status, Sync


def answers(
    protocol: DriveProtocol,
    sync: Sync,
    length: Array,
    rate: Array,
    force: Array,
    state: Ints,
) -> list[tuple[int, Frame]]:
    """Return what the drives answer to a SYNC or poll, each frame with its leg."""
    return protocol.answer(protocol.power_up(), sync, length, rate, force, state)[1]


def reports(protocol: DriveProtocol, status: Status) -> tuple[Frame, ...]:
    """Return what a drive sends of its state."""
    return protocol.report(protocol.power_up(), status)[1]
