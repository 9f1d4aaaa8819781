"""What our own protocol answers to the questions that other families make the contract ask."""

from collections.abc import Mapping, Sequence
from typing import Any

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.protocol import ALL_LEGS, Frame, PowerTold
from drivers.resolution import Resolution
from drivers.signals import LEGS, Reaction

MAX_NODE = 127


def checked_nodes(node_ids: Sequence[int]) -> tuple[int, ...]:
    """Return the drives' node numbers. Raises ConfigurationError: not six different ones of 1..127."""
    nodes = tuple(node_ids)
    if len(nodes) != LEGS or len(set(nodes)) != LEGS:
        raise ConfigurationError(f"drives.node_ids: allowed: {LEGS} different ones, given: {list(nodes)}")
    for leg, node in enumerate(nodes):
        if not 1 <= node <= MAX_NODE:
            raise ConfigurationError(
                f"drives.node_ids[{leg}]: out of range, allowed: a whole number at least 1 and at most "
                f"{MAX_NODE}, given: {node}"
            )
    return nodes


class Traits:
    """One identifier a feedback, a stop that latches, every reaction, its own brake."""

    stop_latches = True
    force_on_brakes = True
    has_watchdog = True
    power_told: PowerTold = "feedback"
    _configured: Mapping[int, int]
    """Identifier of a CONFIG -> leg."""
    senders: Mapping[int, int]
    """Identifier of a feedback or status -> leg."""
    dangers = ()
    reactions = tuple(Reaction)
    shares_identifiers = False
    answers_name_sync = True
    unasked_s = 0.0
    latches_together = True
    _exact: bool
    """Whether the fields are doubles."""
    _feedback_range: Array
    """Begins with the steps of length, m, and rate, m/s."""
    _command_range: Array
    """Begins with the step of a force, N."""

    @staticmethod
    def restarted(memory: int, _legs: Sequence[int]) -> int:
        """Return the memory as it is: a drive's state tells."""
        return memory

    def resolution(self, _rate_Hz: float) -> Resolution:
        """Return half a step of each: they are rounded."""
        if self._exact:
            return Resolution.of(0.0, 0.0, 0.0)
        length, rate = 0.5 * self._feedback_range[:2]
        return Resolution.of(length, rate, 0.5 * self._command_range[0])

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """Return None: the field is wider than any leg."""
        return None

    @staticmethod
    def carried(_dialogue: Any, force: Array) -> Array:
        """Return the forces as they are: the field is fine enough."""
        return force

    def awaited(self, frame: Frame) -> int:
        """Return the identifier."""
        return frame.id

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the leg of a CONFIG; SYNC, command and E-stop are for all."""
        leg = self._configured.get(frame.id)
        return ALL_LEGS if leg is None else (leg,)

    def sender(self, frame: Frame) -> int:
        """Return the leg of a feedback or status."""
        return self.senders.get(frame.id, -1)

    def fault_text(self, _code: int) -> str:
        """Return nothing: all codes are DriveFault."""
        return ""
