"""One participant on a localcan channel: elements of FRAME, nanoseconds of the channel's clock."""

import os
import threading
from collections.abc import Set as AbstractSet

import numpy as np

from drivers.arrays import Rows
from drivers.can.arbitration import arbitrate, priority
from drivers.can.bus_time import FD_LENGTHS, BitTiming, frame_time_ns
from drivers.can.localcan import log
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.doorbell import Doorbell
from drivers.can.localcan.layout import (
    END,
    NUMBER,
    OUTBOX,
    QUEUE,
    RECORD,
    SLOT_RUNG,
    SLOTS,
    VERSION,
    WITHDRAW,
    WORD,
    record_at,
    slot_at,
)
from drivers.can.localcan.wire import Slot, Wire
from drivers.can.no_controller import NoController
from drivers.can.runtime_folder import forget_in_child, runtime_folder, safe_name
from drivers.errors import BusError
from drivers.frame_array import FRAME, unpack_frames
from drivers.protocol import ERROR, EXTENDED, FD

OWN = 1 << 6
"""Flag of a received frame that this participant has sent itself (only with `own`)."""
DEFAULT_TIMING = BitTiming(1_000_000, 5_000_000)
TX_LIMIT = 64
"""Frames that one participant can have waiting for the bus."""
QUEUE_LIMIT = 4096
"""Frames waiting for the bus at most, all participants together."""
KNOWN = 1024
"""Kinds of frames (identifier, flags, length) whose check is remembered: cyclic ones come each tick."""
BATCH = 512
"""Frames taken from the wire at once."""
_LENGTHS = frozenset(FD_LENGTHS)
_AGAIN_NS = 20_000_000
_SLICE_S = 0.1
_LOOK_S = 1e-3
"""Between two looks while time stands still."""
_FOREVER = 1 << 62


class Participant(NoController):
    """A node on the channel.

    The timing (`timing`, `fd`) is that of the first participant that states one; None takes what is there.
    `own`: receive the frames sent here, too. `spin_us`: busy-wait before the end of an awaited frame.
    `tx_limit`: frames that may wait for the bus before `send` takes no more. `clock`: of a participant on
    another channel, whose time is this one's too; by default the channel has its own. Who joins this channel
    by itself goes by the channel's, which is kept to the lent one's.

    Mutable state: the shared wire; what this reader knows of its log; frames received by a look that was
    not for them; the kinds of frames that have passed the check, with priority and duration.
    Raises BusError when the timing disagrees or the folder cannot be used.
    """

    off = False
    """This bus cannot go off."""
    knows_ends = True

    def __init__(
        self,
        channel: str,
        timing: BitTiming | None = None,
        *,
        fd: bool | None = None,
        own: bool = False,
        spin_us: float = 50.0,
        tx_limit: int = TX_LIMIT,
        clock: BenchClock | None = None,
    ) -> None:
        self._own = own
        self._spin_ns = int(spin_us * 1000)
        self._tx_limit = min(tx_limit, OUTBOX // 2)
        self._fixed: BitTiming | None = None
        self._known: dict[tuple[int, int, int], tuple[int, int]] = {}
        self._inbox = bytearray()
        self._first_number = -1
        """Of the first frame of the last `send`; -1: none was taken."""
        self._taken = 0
        """How many it took."""
        self._taken_ns = 0
        self._thread = threading.RLock()
        """Users of python-can send and receive in several threads."""
        self.channel = channel
        self._closed = True
        self._lent_clock = clock
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
        log.join(self._wire.words, self._state, self._waiting)
        self._closed = False
        forget_in_child(self)

    # joining and leaving
    def _remove(self, serial: int) -> None:
        if log.vacate(self._wire.words, serial):
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
        self.serial = wire.reserve()
        self._state, self._waiting, self._flying = log.new_state(self.serial)
        self._ended = np.zeros((BATCH, log.ENDS + 1), np.int64)
        self._frames = np.zeros((BATCH, log.FRAME_WORDS), np.int64)
        self._serials = np.zeros(SLOTS, np.int64)
        self._bell.bind(self.serial)
        wire.register(self.serial, os.getpid())
        self.clock = self._lent_clock or BenchClock(wire.words, self.serial, self._bell)
        if self._lent_clock is not None:
            self._lent_clock.lend(wire.words)

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
        if self._lent_clock is None:
            self.clock.leave()
        else:
            self._lent_clock.take_back(self._wire.words)
        alone = self._wire.lock() and not self._bell.astray
        try:
            self._remove(self.serial)
            if alone and not any(s.serial and self._bell.ring(s.serial) for s in self._wire.slots()):
                self._wire.path.unlink(missing_ok=True)
        finally:
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

    def send(self, frames: Rows) -> int:
        """Queue frames at this node and return how many it took: fewer when `tx_limit` frames wait already.

        Returns at once. Raises BusError for a frame that this bus cannot carry.
        """
        timing = self.timing
        packed = [
            self._check(identifier, data, size, flags, timing)
            for _, identifier, _, size, flags, data in unpack_frames(frames.tobytes())
        ]
        wire, state, serial = self._wire, self._state, self.serial
        if self._fixed is None:
            if wire.timing is None:
                wire.fix(timing, fd=True)
            self._fixed = wire.timing
        with self._thread:
            self._look()
            room = min(self._tx_limit - int(state[log.OWN_WAITING]), QUEUE_LIMIT - int(state[log.WAITING]))
            taken = max(0, min(len(packed), room))
            number = wire.count(serial)
            self._first_number, self._taken = number if taken else -1, taken
            for key, duration, id_, flags, size, data in packed[:taken]:
                wire.put(serial, number, 0, key, duration, serial, id_, flags, size, data[:size])
                wire.counted(serial, number + 1)
                self._append(QUEUE, number)
                number += 1
        self._taken_ns = self.clock.now()
        if taken:
            self.clock.sends()
            # an unanswered ring is repeated: the one who should have rung may have been killed
            listeners = log.to_ring(wire.words, state, self.clock.now(), _AGAIN_NS, self._serials)
            for other in self._serials[:listeners].tolist():
                if not self._bell.ring(other):
                    self._remove(other)
        return taken

    def _check(
        self, id_: int, data: bytes, size: int, flags: int, timing: BitTiming
    ) -> tuple[int, int, int, int, int, bytes]:
        known = self._known.get((id_, flags, size))
        if known is not None:
            return *known, id_, flags & ~OWN, size, data
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
            if size not in _LENGTHS:
                size = next((n for n in FD_LENGTHS if n >= size), size)
        cost = priority(id_, flags), frame_time_ns(size, flags, timing)
        if self._fixed is not None and len(self._known) < KNOWN:
            self._known[id_, flags, size] = cost
        return *cost, id_, flags & ~OWN, size, data

    def flush_tx(self) -> int:
        """Drop this node's frames that have not started; return how many."""
        with self._thread:
            self._look()
            before = int(self._state[log.WITHDRAWN])
            self._append(WITHDRAW, self.serial // SLOTS)
            self._look()
            return int(self._state[log.WITHDRAWN]) - before

    def _append(self, kind: int, number: int) -> None:
        clock_words, clock, gettime, at = self.clock.arguments
        log.append(self._wire.words, clock_words, clock, self._state, gettime, at, kind, number)

    def first_sent_ns(self) -> int | None:
        """Return when the first frame of the last `send` ended, as far as this node has looked; else None."""
        return self._ended_ns(self._first_number) if self._first_number >= 0 else None

    def _ended_ns(self, number: int) -> int | None:
        """Return when a frame of this node ended; None where that is not known."""
        at = record_at(self.serial, number)
        end = int(self._wire.words[at + END])
        same = int(self._wire.words[at + NUMBER]) == number
        return end if same and end >= 0 else None

    def sent_ns(self) -> list[int]:
        """Return when each frame that the last `send` took ended, as far as this node has looked.

        Else when it was taken.
        """
        first = self._first_number
        ends = [self._ended_ns(first + k) for k in range(self._taken)]
        return [self._taken_ns if end is None else end for end in ends]

    # receiving
    @property
    def overflow(self) -> int:
        """Frames lost so far to slow reading."""
        return int(self._state[log.LOST])

    def receive(self) -> Rows:
        """Return what has ended since the last call, in the order of the wire. Does not block."""
        with self._thread:
            self._look()
            received, self._inbox = self._inbox, bytearray()
        return np.frombuffer(received, FRAME)

    def _look(self) -> None:
        """Take what has ended into the inbox."""
        words, state, now = self._wire.words, self._state, self.clock.now()
        own = OWN if self._own else 0
        ended = BATCH
        while ended == BATCH:
            ended = log.look(words, state, self._waiting, self._flying, self._ended, now)
            if ended:
                taken = log.take(words, state, self._ended, ended, own, self._frames)
                self._inbox += self._frames[:taken].tobytes()

    # waiting
    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until all missing identifiers (none: the next foreign frame) will have ended.

        Sleeps until somebody sends where that cannot be foreseen, and at most until the deadline.
        """
        clock, end = self.clock, self._foresee(missing)
        if end is not None:
            clock.sleep_until(min(end, deadline_ns), self._spin_ns)
            return
        # first promised, then asked for a ring: who rings may bring the promise forward
        clock.waiting(deadline_ns)
        if self.arm(idle=False):
            left_ns = deadline_ns - clock.now()
            if left_ns > 0:
                # in slices: a ring can be lost when the one who rings is killed
                self._bell.wait(_LOOK_S if clock.stands() else min(left_ns * 1e-9, _SLICE_S))
        # awake: a ring would change nothing but bring the promise forward
        self._wire.words[slot_at(self.serial) + SLOT_RUNG] = clock.now()
        clock.working()

    def foresee(self) -> int | None:
        """Return when the next foreign frame that is under way will have ended; None where there is none."""
        return self._foresee(frozenset())

    def _foresee(self, missing: AbstractSet[int]) -> int | None:
        """Return when all missing identifiers will have ended, as far as the last look can tell.

        A frame queued later can only push this instant back, unless it is itself awaited.
        """
        state, memory = self._state, self._wire.memory
        with self._thread:
            flight = self._flying[: state[log.FLYING]].tolist()
            rows = self._waiting[: state[log.WAITING]].tolist()
        if rows:
            order = [(row[log.SINCE], row[log.KEY], i, row[log.TAKES]) for i, row in enumerate(rows)]
            sent, _ = arbitrate(order, int(state[log.FREE]), _FOREVER)
            flight += [(rows[i][log.PLACE], 0, end) for i, end in sent]
        left = set(missing)
        for place, _, end in flight:
            _, _, _, _, _, sender, id_, flags, _, _ = RECORD.unpack_from(memory, WORD * place)
            if sender == self.serial and not self._own:
                continue
            if not flags & ERROR:
                left.discard(id_)
            if not left:
                return int(end)
        return None

    def arm(self, *, idle: bool = True) -> bool:
        """Empty the doorbell and ask for the next ring, unless something has come since the last look.

        idle: and unless any frame is under way. Then the doorbell is left ringing, so that select() on
        `fileno` returns at once. Returns whether the doorbell waits for the next ring.
        """
        words, state = self._wire.words, self._state
        self._bell.silence()
        # first asked for, then looked: what is sent in between rings
        log.ask_for_ring(words, state)
        if not self._inbox and not log.news(words, state, idle):
            return True
        if idle:
            self._bell.ring(self.serial)
        return False

    def ring(self) -> None:
        """Make `fileno` readable: frames were received that the reader has not taken yet."""
        self._bell.ring(self.serial)


def _describe(timing: BitTiming, fd: bool) -> str:
    if fd:
        return f"CAN FD {timing.bitrate}/{timing.data_bitrate} bit/s"
    return f"classic CAN {timing.bitrate} bit/s"
