"""Measurements of a CAN interface: latency, loss at the loop's rate, queue, CAN FD, recovery.

`near` sends and `far` receives: two interfaces of one bus, or two sockets on one interface. All frames have
identifiers of BLOCK, to which no drive of the configuration answers.
"""

import socket
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.can import netlink
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.errors import RunError
from drivers.frame_array import sent_array
from drivers.protocol import BRS, FD, Frame
from hil.loop.clock import Deadlines

BLOCK = range(0x7C0, 0x7E0)
"""Identifiers of the frames: no CANopen device listens to them (CiA 301); lower ones go first."""
SINGLES = 1000
"""Frames sent one by one for the latency."""
PATIENCE_NS = 20_000_000
"""Patience with one frame; after it the frame counts as lost."""
BURST = 128
"""Most frames sent at once."""
QUIET_NS = 1_500_000_000
"""Time for which the bus must carry no frames of others before anything is sent."""
_REST_NS = 100_000_000
"""Patience with the last frames of several."""
_DOWN_NS = 3_000_000_000
"""Patience with an interface that was down."""
Tell = Callable[[int], None]
Shapes = Sequence[tuple[int, int]]
"""Length and flags of frames."""


class Loss(NamedTuple):
    """Frames of all ticks, in both directions."""

    sent: int
    lost: int
    unsent: int


def frames_of(shapes: Shapes) -> Rows:
    """Frames of these lengths, with identifiers of BLOCK and nothing but zeros."""
    return sent_array(
        Frame(BLOCK[k % len(BLOCK)], bytes(length), flags & (FD | BRS))
        for k, (length, flags) in enumerate(shapes)
    )


def only_ours(received: Rows) -> Rows:
    """Pass frames of BLOCK. Raises RunError for others: a drive that sends may also listen."""
    strange = [each for each in received["id"].tolist() if each not in BLOCK]
    if strange:
        raise RunError(
            f"the bus carries frames of others, the first 0x{strange[0]:X}: nothing more is sent, as a drive "
            "may listen; switch the drives off or unplug them, and stop other programs on this bus"
        )
    return received


def require_quiet(near: Bus) -> None:
    """Listen before anything is sent. Raises RunError if others send frames."""
    end = near.clock.now() + QUIET_NS
    while near.clock.now() < end:
        only_ours(near.wait(end))


def latencies_us(near: Bus, far: Bus, timing: BitTiming, tell: Tell) -> Array:
    """Latencies (n,) us of single classic frames of 8 bytes, without bus time; n: frames received.

    From before the call that sends to the time stamp of reception. The bus time is the longest of such a
    frame, as in the bus budget: bus time of the budget and latency are together what was measured.
    """
    wire_ns = 0 if near.virtual else frame_time_ns(8, 0, timing)
    found: list[int] = []
    for number in range(SINGLES):
        identifier = BLOCK[number % len(BLOCK)]
        frame = sent_array([Frame(identifier, bytes(8), 0)])
        begun = near.clock.now()
        near.send(frame)
        received = only_ours(far.drain(begun + PATIENCE_NS, {identifier}))
        arrived = received["t_ns"][received["id"] == identifier].tolist()
        found += [t_ns - begun - wire_ns for t_ns in arrived[:1]]
        tell(number + 1)
    return np.maximum(1e-3 * np.array(found, float), 0.0)


def loss_at_rate(
    near: Bus, far: Bus, ours: Rows, theirs: Rows, rate_Hz: float, ticks: int, tell: Tell
) -> Loss:
    """Send the frames of a tick at the rate of the loop, `ours` from near and `theirs` from far."""
    deadlines = Deadlines(rate_Hz, 0.0, clock=near.clock)
    unsent = heard = 0
    for tick in range(ticks):
        deadlines.wait()
        unsent += near.send(ours) + (far.send(theirs) if len(theirs) else 0)
        heard += len(only_ours(far.drain_now())) + len(only_ours(near.drain_now()))
        tell(tick + 1)
    end = near.clock.now() + _REST_NS
    while near.clock.now() < end:
        heard += len(far.wait(min(end, near.clock.now() + 1_000_000))) + len(near.drain_now())
    sent = ticks * (len(ours) + len(theirs)) - unsent
    return Loss(sent, sent - heard, unsent)


def queue_depth(near: Bus, far: Bus) -> tuple[int, bool]:
    """(frames of 8 bytes accepted at once, True if the interface then refused one)."""
    taken = BURST - near.send(frames_of([(8, 0)] * BURST))
    end = near.clock.now() + 10 * _REST_NS
    heard = 0
    while heard < taken and near.clock.now() < end:
        heard += len(far.wait(near.clock.now() + _REST_NS))
    return taken, taken < BURST


def passes_fd(near: Bus, far: Bus) -> bool:
    """True if a CAN FD frame of 64 bytes arrives with its bit-rate switch."""
    near.send(frames_of([(64, FD | BRS)]))
    received = far.wait(near.clock.now() + _REST_NS)
    return bool(((received["flags"] & (FD | BRS)) == FD | BRS).any() and received["length"].max() == 64)


def recovery_ms(near: Bus, far: Bus, channel: str) -> float | None:
    """Time, ms, from taking the interface down to the first frame received after it is up again.

    A run does the same after bus-off. None without CAP_NET_ADMIN, or if no frame is received.
    """
    if not netlink.administers():
        return None
    number, begun = socket.if_nametoindex(channel), near.clock.now()
    for up in (False, True):
        netlink.set_up(number, up=up)
    while near.clock.now() < begun + _DOWN_NS:
        near.send(frames_of([(8, 0)]))
        received = far.wait(near.clock.now() + 2_000_000)
        if len(received):
            return 1e-6 * (int(received["t_ns"][0]) - begun)
    return None
