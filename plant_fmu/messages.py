"""What frames of a controller say to the drives of any family, and what a drive says of its state."""

from typing import NamedTuple

from drivers.arrays import Array
from drivers.protocol import ALL_LEGS, Frame
from drivers.signals import Reaction


class Sync(NamedTuple):
    """The drives of `legs` latch their encoders and answer."""

    counter: int
    """What the answers carry to tell this SYNC from others; 0 in a protocol without."""
    legs: tuple[int, ...] = ALL_LEGS


class DeviceCommand(NamedTuple):
    """A command as the drives decode it. `legs` lists the legs that this frame addresses."""

    legs: tuple[int, ...]
    mode: int
    force: Array
    """N, one per addressed leg."""
    counter: int
    """Another one than in the leg's command before; else the command is a repetition and does not count.

    Whether it is that of the present SYNC has been checked: an older one, or a future one, is Rejected."""


class UnwatchedCommand(DeviceCommand):
    """A command that does not feed the drives' watchdogs: `Alive` does."""


class Alive(NamedTuple):
    """What the watchdogs of the drives of `legs` wait for, where that is not the command itself."""

    legs: tuple[int, ...] = ALL_LEGS


class Configure(NamedTuple):
    """Set-up of one drive (leg 0..5)."""

    leg: int
    watchdog_s: float
    reaction: Reaction


class EmergencyStop(NamedTuple):
    """The drives of `legs` fault at once."""

    legs: tuple[int, ...] = ALL_LEGS


class Answer(NamedTuple):
    """A drive's own part of the start-up dialogue, sent at once."""

    leg: int
    frame: Frame


class Rejected(NamedTuple):
    """A frame of ours that cannot be trusted."""

    reason: str


DeviceMessage = Sync | DeviceCommand | Alive | Configure | EmergencyStop | Answer | Rejected


class Status(NamedTuple):
    """What a drive is in: for its heartbeat, when it is set up, and when state or fault change."""

    leg: int
    state: int
    fault: int
    set_up: Configure | None = None
    """What holds in the drive; None before it has been set up."""
    due: bool = True
    """The heartbeat's period is over; else something has changed, which some drives do not send at once."""
