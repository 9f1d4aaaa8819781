"""One participant on a localcan channel, in Frames and nanoseconds of CLOCK_MONOTONIC."""

import os
import time
from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from drivers.can.arbitration import arbitrate, priority
from drivers.can.bus_time import FD_LENGTHS, BitTiming, frame_time_ns
from drivers.can.localcan.doorbell import Doorbell
from drivers.can.localcan.wire import QUEUE, RECORD, RING, VERSION, Slot, Wire
from drivers.can.runtime_folder import forget_in_child, runtime_folder, safe_name
from drivers.errors import BusError
from drivers.protocol import ERROR, EXTENDED, FD, Frame, Received

OWN = 1 << 6
"""Flag of a Received frame that this participant has sent itself (only with `own`)."""
DEFAULT_TIMING = BitTiming(1_000_000, 5_000_000)
TX_LIMIT = 64
"""Frames that one participant can have waiting for the bus."""
KNOWN = 1024
"""Kinds of frames (identifier, flags, length) whose check is remembered: cyclic ones come each tick."""
_LENGTHS = frozenset(FD_LENGTHS)
_AGAIN_NS = 20_000_000
_SLICE_S = 0.1
_FOREVER = 1 << 62
_NOTHING = (b"", b"", 0)
"""Nothing ahead: the record on the wire, the records queued, when the bus falls free."""


class Participant:
    """A node on the channel.

    The timing (`timing`, `fd`) is that of the first participant that states one; None takes what is there.
    `own`: receive the frames sent here, too. `spin_us`: busy-wait before the end of an awaited frame.
    `tx_limit`: frames that may wait for the bus before `send` takes no more.

    Mutable state: the shared wire; the read position, what lay ahead of it at the last look, and how many
    frames slow reading has lost; the kinds of frames that have passed the check, with priority and duration.
    Raises BusError when the timing disagrees or the folder cannot be used.
    """

    def __init__(
        self,
        channel: str,
        timing: BitTiming | None = None,
        *,
        fd: bool | None = None,
        own: bool = False,
        spin_us: float = 50.0,
        tx_limit: int = TX_LIMIT,
    ) -> None:
        self._missed = 0
        self._own = own
        self._spin_ns = int(spin_us * 1000)
        self._tx_limit = tx_limit
        self._ahead = _NOTHING
        self._fixed: BitTiming | None = None
        self._known: dict[tuple[int, int, int], tuple[int, int]] = {}
        self._dead: set[int] = set()
        self.channel = channel
        self._closed = True
        self._wire = Wire(runtime_folder() / f"{safe_name(channel)}.wire{VERSION}")
        self._bell = Doorbell(channel)
        self.fileno = self._bell.fileno
        try:
            self._join(timing, fd)
        except BaseException:
            self._bell.close()
            self._wire.close()
            raise
        self._wire.unlock()
        self._closed = False
        forget_in_child(self)

    # joining and leaving
    def _remove(self, serial: int) -> None:
        self._wire.unregister(serial)
        self._bell.remove(serial)

    def _join(self, timing: BitTiming | None, fd: bool | None) -> None:
        wire = self._wire
        others: list[Slot] = []
        for slot in wire.slots():
            if not slot.serial:
                continue
            if self._bell.ring(slot.serial):
                others.append(slot)
            else:
                self._remove(slot.serial)
        if not others:
            wire.clear()
        self._agree(timing, fd, others)
        self._cursor = wire.advance(time.monotonic_ns())[0]
        self.serial = wire.register(os.getpid())
        try:
            self._bell.bind(self.serial)
        except BusError:
            wire.unregister(self.serial)
            raise

    def _agree(self, timing: BitTiming | None, fd: bool | None, others: list[Slot]) -> None:
        wire = self._wire
        agreed = wire.timing
        if agreed is None:
            if timing is not None or fd is not None:
                wire.fix(timing or DEFAULT_TIMING, fd is not False)
            return
        wanted_fd = wire.fd if fd is None else fd
        wanted = timing or agreed
        same_rates = wanted == agreed if wanted_fd else wanted.bitrate == agreed.bitrate
        if wanted_fd != wire.fd or not same_rates:
            raise BusError(
                f"localcan {self.channel} runs as {_describe(agreed, wire.fd)}, asked for was "
                f"{_describe(wanted, wanted_fd)}: use the timing of the others "
                f"(processes {', '.join(str(slot.pid) for slot in others)}) or another channel"
            )

    def forget(self) -> None:
        """Drop a fork's copy of the participant: the socket shall die with the one who opened it."""
        if not self._closed:
            self._closed = True
            self._bell.close()
            self._wire.forget()

    def close(self) -> None:
        """Leave the bus; frames still queued are sent. The last one takes the wire with it."""
        if self._closed:
            return
        self._closed = True
        self._wire.lock()
        try:
            self._remove(self.serial)
            if not any(slot.serial and self._bell.ring(slot.serial) for slot in self._wire.slots()):
                self._wire.path.unlink(missing_ok=True)
        finally:
            self._wire.unlock()
            self._bell.close()
            self._wire.close()

    # sending
    @property
    def timing(self) -> BitTiming:
        """Bit timing of the channel."""
        return self._fixed or self._wire.timing or DEFAULT_TIMING

    @property
    def fd(self) -> bool:
        """Whether the channel carries CAN FD frames."""
        return self._wire.fd or self._wire.timing is None

    def send(self, frames: Sequence[Frame]) -> int:
        """Queue frames at this node and return how many it took: fewer when `tx_limit` frames wait already.

        Returns at once. Raises BusError for a frame that this bus cannot carry.
        """
        timing = self.timing
        packed = [self._check(frame, timing) for frame in frames]
        wire = self._wire
        wire.lock()
        try:
            now = time.monotonic_ns()
            _, queued, _ = wire.advance(now)
            if self._fixed is None:
                if wire.timing is None:
                    wire.fix(timing, fd=True)
                self._fixed = wire.timing
            taken = min(len(packed), self._tx_limit - wire.queued_by(self.serial), QUEUE - queued)
            if taken <= 0:
                return 0
            wire.enqueue(
                self.serial,
                [
                    RECORD.pack(now, key, duration, self.serial, id_, flags, len(data), data)
                    for key, duration, id_, flags, data in packed[:taken]
                ],
            )
            for serial in self._dead:
                self._remove(serial)
            self._dead.clear()
            # an unanswered ring is repeated: the one who should have rung may have been killed
            listeners = wire.to_ring(self.serial, now, _AGAIN_NS)
        finally:
            wire.unlock()
        for serial in listeners:
            if not self._bell.ring(serial):
                self._dead.add(serial)
        return taken

    def _check(self, frame: Frame, timing: BitTiming) -> tuple[int, int, int, int, bytes]:
        id_, data, flags = frame
        known = self._known.get((id_, flags, len(data)))
        if known is not None:
            return *known, id_, flags & ~OWN, data
        if not 0 <= id_ <= (0x1FFFFFFF if flags & EXTENDED else 0x7FF):
            raise BusError(
                f"localcan: identifier 0x{id_:X} does not fit a CAN frame; extended ones need the flag"
            )
        if flags & FD:
            if not self.fd:
                raise BusError(
                    f"localcan {self.channel} is a classic CAN bus: frame 0x{id_:X} needs CAN FD "
                    "(open the channel with fd=True first)"
                )
            if len(data) not in _LENGTHS:
                data = data.ljust(next((n for n in FD_LENGTHS if n >= len(data)), len(data)), b"\0")
        cost = priority(id_, flags), frame_time_ns(len(data), flags, timing)
        if self._fixed is not None and len(self._known) < KNOWN and len(data) == len(frame.data):
            self._known[id_, flags, len(data)] = cost
        return *cost, id_, flags & ~OWN, data

    def flush_tx(self) -> int:
        """Drop this node's frames that have not started; return how many."""
        self._wire.lock()
        try:
            self._wire.advance(time.monotonic_ns())
            return self._wire.withdraw(self.serial)
        finally:
            self._wire.unlock()

    # receiving
    off = False
    """This bus cannot go off."""

    @property
    def overflow(self) -> int:
        """Frames lost so far: to slow reading, or queued when a participant died that held the wire."""
        return self._missed + self._wire.lost

    def receive(self) -> list[Received]:
        """Return what has ended since the last call, in the order of the wire. Does not block."""
        wire, now = self._wire, time.monotonic_ns()
        wire.lock()
        try:
            head, queued, free = wire.advance(now)
            if head - self._cursor > RING:
                self._missed += head - RING - self._cursor
                self._cursor = head - RING
            raw = wire.sent(self._cursor, head)
            waiting = wire.waiting(queued)
        finally:
            wire.unlock()
        flying = b""
        # every frame in the ring has started: at most the last one has not ended
        if raw and free > now:
            flying = raw[-RECORD.size :]
            raw = raw[: -RECORD.size]
            head -= 1
        self._cursor = head
        self._ahead = flying, waiting, free
        if not raw:
            return []
        me = self.serial
        received = []
        for end, _, _, sender, id_, flags, length, data in RECORD.iter_unpack(raw):
            if sender != me:
                received.append(Received(end, Frame(id_, data[:length], flags)))
            elif self._own:
                received.append(Received(end, Frame(id_, data[:length], flags | OWN)))
        return received

    # waiting
    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until all missing identifiers (none: the next foreign frame) will have ended.

        Sleeps until somebody sends where that cannot be foreseen, and at most until the deadline.
        """
        end = self._foresee(missing)
        if end is not None:
            self._sleep_until(min(end, deadline_ns))
        elif self.arm(idle=False):
            left = (deadline_ns - time.monotonic_ns()) * 1e-9
            if left > 0:
                # in slices: a ring can be lost when the one who rings is killed
                self._bell.wait(min(left, _SLICE_S))

    def _foresee(self, missing: AbstractSet[int]) -> int | None:
        """Return when all missing identifiers will have ended, as far as the last look can tell.

        A frame queued later can only push this instant back, unless it is itself awaited.
        """
        flying, waiting, free = self._ahead
        flight = [(free, r[3], r[4], r[5]) for r in RECORD.iter_unpack(flying)]
        if waiting:
            records = list(RECORD.iter_unpack(waiting))
            order = [(r[0], r[1], i, r[2]) for i, r in enumerate(records)]
            sent, _ = arbitrate(order, free, _FOREVER)
            flight += [(end, records[i][3], records[i][4], records[i][5]) for i, end in sent]
        left = set(missing)
        for end, sender, id_, flags in flight:
            if sender == self.serial and not self._own:
                continue
            if not flags & ERROR:
                left.discard(id_)
            if not left:
                return int(end)
        return None

    def _sleep_until(self, t_ns: int) -> None:
        left = t_ns - time.monotonic_ns() - self._spin_ns
        if left > 0:
            time.sleep(left * 1e-9)
        end = min(t_ns, time.monotonic_ns() + self._spin_ns)
        while time.monotonic_ns() < end:
            pass

    def arm(self, *, idle: bool = True) -> bool:
        """Empty the doorbell and ask for the next ring, unless something has come since the last look.

        idle: and unless any frame is under way. Then the doorbell is left ringing, so that select() on
        `fileno` returns at once. Returns whether the doorbell waits for the next ring.
        """
        wire = self._wire
        wire.lock()
        try:
            now = time.monotonic_ns()
            head, queued, free = wire.advance(now)
            flying = 1 if free > now and head > self._cursor else 0
            underway = (flying + queued) * RECORD.size
            news = head - flying > self._cursor or underway != len(self._ahead[0]) + len(self._ahead[1])
            if news or (idle and underway):
                if idle:
                    self._bell.ring(self.serial)
                return False
            self._bell.silence()
            wire.set_rung(self.serial, 0)
            return True
        finally:
            wire.unlock()

    def ring(self) -> None:
        """Make `fileno` readable: frames were received that the reader has not taken yet."""
        self._bell.ring(self.serial)


def _describe(timing: BitTiming, fd: bool) -> str:
    if fd:
        return f"CAN FD {timing.bitrate}/{timing.data_bitrate} bit/s"
    return f"classic CAN {timing.bitrate} bit/s"
