"""One participant on a localcan channel; frames are FRAME records, times ns of the channel's clock."""

import threading
from collections.abc import Set as AbstractSet
from functools import lru_cache
from pathlib import Path

import numpy as np

from drivers.arrays import Rows
from drivers.can.arbitration import priority
from drivers.can.bus_time import FD_LENGTHS, BitTiming, frame_time_ns
from drivers.can.link import Link
from drivers.can.localcan import layout as at
from drivers.can.localcan import log
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.wire import LEAVE_S, Mode, Wire
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import BusError
from drivers.frame_array import FRAME, unpack_frames
from drivers.protocol import EXTENDED, FD

DEFAULT_TIMING = BitTiming(1_000_000, 5_000_000)
DEFAULT_MODE = Mode(DEFAULT_TIMING, fd=True)
TX_LIMIT = 64
"""Most frames of one participant that may wait for the bus."""
BATCH = 512
"""Frames read from the wire at once."""
_AGAIN_NS = 20_000_000
_SLICE_S = 0.1
LOOK_S = 1e-3
"""Pause between two checks while time stands still, or a bus is off."""


@lru_cache(1024)
def _cost(identifier: int, flags: int, size: int, timing: BitTiming, classic: str) -> tuple[int, int, int]:
    """(priority, duration ns, length in bytes) of a frame on this bus.

    classic: the channel's name if it is a classic CAN bus, else empty. Raises BusError for a frame that this
    bus cannot carry.
    """
    if not 0 <= identifier <= (0x1FFFFFFF if flags & EXTENDED else 0x7FF):
        raise BusError(
            f"localcan: identifier 0x{identifier:X} does not fit a CAN frame; set EXTENDED for 29 bits"
        )
    if flags & FD and classic:
        raise BusError(
            f"localcan {classic} is a classic CAN bus: frame 0x{identifier:X} needs CAN FD "
            "(open the channel with fd=True first)"
        )
    length = next((n for n in FD_LENGTHS if n >= size), size) if flags & FD else size
    return priority(identifier, flags), frame_time_ns(length, flags, timing), length


class Participant(Link):
    """A node on a localcan channel.

    The first participant that sets bit rates (`timing`) or CAN FD (`fd`) fixes them; None accepts what is
    set. `own`: receive own frames, too. `spin_us`: busy-wait this long, us, before the end of an awaited
    frame. `clock`: clock of a participant on another channel, to be shared; it stops holding time when this
    one leaves. By default the channel has its own clock. Others that join this channel use its own clock,
    which follows the shared one.

    Mutable state: the shared wire; this reader's position in its log; frames received but not taken.
    Raises BusError if the timing differs or the folder cannot be used.
    """

    clock: BenchClock
    knows_ends = True

    def __init__(
        self,
        channel: str,
        timing: BitTiming | None = None,
        *,
        fd: bool | None = None,
        own: bool = False,
        spin_us: float = 50.0,
        clock: BenchClock | None = None,
    ) -> None:
        self._spin_ns = int(spin_us * 1000)
        self._inbox = bytearray()
        self._sent = range(0)
        """Numbers of the frames accepted by the last `send`."""
        self._queued_ns = 0
        self._thread = threading.RLock()
        """Users of python-can send and receive in several threads."""
        self.channel = channel
        self._closed = False
        self._wire = Wire(runtime_folder() / f"{safe_name(channel)}.wire{at.VERSION}")
        try:
            self._join(timing, fd, clock)
        except BaseException:
            self._wire.close()
            raise
        self._wire.unlock()
        self._state[log.HEARS_OWN] = own

    # joining and leaving
    def _remove(self, serial: int) -> None:
        if log.change(self._wire.words, at.slot_at(serial) + at.SLOT_SERIAL, serial, 0):
            Path(self._wire.bell_of(serial)).unlink(missing_ok=True)

    def _join(self, timing: BitTiming | None, fd: bool | None, clock: BenchClock | None) -> None:
        wire = self._wire
        for serial in wire.present():
            if not wire.ring(serial):
                self._remove(serial)
        others = wire.present()
        if not others:
            wire.words[: at.OUTBOX_AT] = 0
        agreed = self.mode
        wanted = Mode(timing or agreed.timing, agreed.fd if fd is None else fd)
        if wire.mode is not None and str(wanted) != str(agreed):
            raise BusError(
                f"localcan {self.channel} runs as {agreed}, but {wanted} was requested: "
                f"use the timing of its participants (processes {', '.join(map(str, others.values()))}) "
                "or another channel"
            )
        if wire.mode is None and (timing, fd) != (None, None):
            wire.fix(wanted)
        self.serial = wire.enter()
        # a little before the log's end, to find out when the bus becomes free
        begun = max(at.FIRST, int(wire.words[at.HINT_AT]) - at.OUTBOX // 8)
        self._state = np.array([self.serial, begun, 0, 0, 0])
        self._queue = np.zeros((log.QUEUE_ROWS, log.ENTRY + 1), np.int64)
        self._frames = np.zeros((BATCH, log.FRAME_WORDS), np.int64)
        self._serials = np.zeros(at.SLOTS, np.int64)
        self.clock = clock or BenchClock(wire, self.serial)
        self.clock.wires.append(wire.words)
        self.receive()  # discard frames that ended before
        self.overflow = self._state[log.LOST] = 0
        wire.words[at.slot_at(self.serial) + at.SLOT_SERIAL] = self.serial

    def close(self) -> None:
        """Leave the bus; queued frames are still sent. The last participant removes the shared memory."""
        if self._closed:
            return
        self._closed = True
        self.clock.leave()
        alone = self._wire.lock(LEAVE_S)
        try:
            self._remove(self.serial)
            if alone and not any(map(self._wire.ring, self._wire.present())):
                self._wire.path.unlink(missing_ok=True)
        finally:
            self._wire.close()

    # sending
    @property
    def mode(self) -> Mode:
        """Mode of the channel: bit timing, and CAN FD or classic."""
        return self._wire.mode or DEFAULT_MODE

    def send(self, frames: Rows) -> int:
        """Queue FRAME records at this node; returns how many were accepted: fewer at TX_LIMIT waiting.

        Never waits. Raises BusError for a frame that this bus cannot carry.
        """
        mode, content = self.mode, frames.tobytes()
        classic = "" if mode.fd else self.channel
        costs = [
            _cost(identifier, flags, size, mode.timing, classic)
            for _, identifier, _, size, flags, _ in unpack_frames(content)
        ]
        wire, state = self._wire, self._state
        if wire.mode is None:
            wire.fix(mode)
        with self._thread:
            self._look()
            number = int(wire.words[at.slot_at(self.serial) + at.SLOT_COUNT])
            taken = log.put(
                wire.words,
                state,
                *self.clock.arguments,
                self._queue,
                np.frombuffer(content, np.int64).reshape(-1, log.FRAME_WORDS),
                np.array(costs, np.int64).reshape(-1, 3),
                TX_LIMIT,
            )
            self._sent = range(number, number + taken)
        self._queued_ns = now = self.clock.now()
        if taken:
            self.clock.sends()
            # an unanswered ring is repeated: its sender may have been killed before it
            listeners = log.to_ring(wire.words, state, now, _AGAIN_NS, self._serials)
            for other in self._serials[:listeners].tolist():
                if not wire.ring(other):
                    self._remove(other)
        return taken

    def flush_tx(self) -> int:
        """Drop this node's frames whose transmission has not started; the result is their number."""
        with self._thread:
            self._look()
            return int(log.withdraw(self._wire.words, self._state, self._queue))

    def sent_ns(self) -> list[int]:
        """Time, ns, of each frame that the last `send` accepted: its end on the wire, once that is known.

        Before this node has seen the end, the time at which the frame was queued.
        """
        words, places = self._wire.words, [at.record_at(self.serial, number) for number in self._sent]
        return [int(end) if (end := words[place + at.END]) > 0 else self._queued_ns for place in places]

    # receiving
    def receive(self) -> Rows:
        """Frames whose transmission ended since the last call, FRAME records in wire order; no wait."""
        with self._thread:
            self._look()
            received, self._inbox = self._inbox, bytearray()
        return np.frombuffer(received, FRAME)

    def _look(self) -> None:
        words, now, taken = self._wire.words, self.clock.now(), BATCH
        while taken == BATCH:
            taken = log.look(words, self._state, self._queue, now, self._frames)
            self._inbox += self._frames[:taken].tobytes()
        self.overflow = int(self._state[log.LOST])

    # waiting
    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until all identifiers in `missing` (empty: another node's next frame) will have been sent.

        If that time is unknown, sleep until a participant sends. The sleep ends at `deadline_ns` at the
        latest.
        """
        clock, end = self.clock, self.foresee(missing)
        if end is None:
            # first the promise, then the request for a ring: a ring may bring the promise forward
            clock.waiting(deadline_ns)
            self._ask_for_ring()
            end = self.foresee(missing)
        if end is not None:
            clock.sleep_until(min(end, deadline_ns), self._spin_ns)
            return
        left_ns = deadline_ns - clock.now()
        if left_ns > 0 and not self._inbox:
            # in slices: a ring can be lost if its sender is killed
            self._wire.wait(LOOK_S if clock.stands() else min(left_ns * 1e-9, _SLICE_S))
        # awake: a ring would change nothing but bring the promise forward
        self._wire.words[at.slot_at(self.serial) + at.SLOT_RUNG] = clock.now()
        clock.working()

    def foresee(self, missing: AbstractSet[int] = frozenset()) -> int | None:
        """Time, ns, at which all identifiers in `missing` will have been sent; None if unknown at present.

        With an empty `missing`: the end of the next frame of another node.
        """
        awaited = np.fromiter(missing, np.int64, len(missing))
        with self._thread:
            end = log.foresee(self._wire.words, self._state, self._queue, awaited)
        return None if end < 0 else end

    def _ask_for_ring(self) -> None:
        """Empty the doorbell and request a ring from the next sender. Call it before reading the log."""
        self._wire.silence()
        place = at.slot_at(self.serial) + at.SLOT_RUNG
        log.change(self._wire.words, place, int(self._wire.words[place]), 0)

    def arm(self) -> bool:
        """Request a ring at the next frame; False, without request, if a frame has arrived or is near."""
        self._ask_for_ring()
        return not self._inbox and self.foresee() is None

    def fileno(self) -> int:
        """Descriptor of the doorbell socket, readable when frames have arrived after `arm`."""
        return self._wire.bell.fileno()

    def ring(self) -> None:
        """Make `fileno` readable, as some received frames have not been taken yet."""
        self._wire.ring(self.serial)
