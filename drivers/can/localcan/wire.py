"""The shared memory of one localcan channel: header, participants, transmit queue, ring of sent frames.

Layout, lock and arbitration only; nobody waits here. Everything but `lock` needs the lock.

A process may be killed between any two instructions. The kernel then frees the lock; `dirty` tells the next
holder that the queue was being rebuilt, and it starts over with an empty one. Frames reach the ring, and
queued frames the queue, before the count that makes them visible.
"""

import fcntl
import mmap
import os
import struct
import threading
from pathlib import Path
from typing import NamedTuple

from drivers.can.arbitration import arbitrate
from drivers.can.bus_time import BitTiming
from drivers.errors import BusError

VERSION = 1
"""Part of the file's name: programs with another layout meet on another wire."""
MAGIC = b"hilwire1"
SLOTS = 64
"""Participants at most."""
QUEUE = 4096
"""Frames waiting for the bus at most, all participants together."""
RING = 16384
"""Sent frames that a slow reader can lag behind: 2 s at 8000 frames/s."""

RECORD = struct.Struct("<qqIIIHH64s")
"""t_ns (queued; in the ring: end), priority, duration ns, sender, id, flags, length, data."""
_ORDER = struct.Struct("<qqII72x")
_TIME = struct.Struct("<q")
_STATE = struct.Struct("<qqqqq")
_COUNT = struct.Struct("<I")
_SLOT = struct.Struct("<IIqII8x")

_BITRATE, _DATA_BITRATE, _FD, _STATE_AT, _SERIAL, _USED, _LOST = 16, 24, 32, 40, 80, 88, 96
_HEAD_AT, _QUEUED_AT = _STATE_AT + 16, _STATE_AT + 24
_SLOTS_AT = 128
_QUEUE_AT = 4096
_RING_AT = _QUEUE_AT + QUEUE * RECORD.size
_SIZE = _RING_AT + RING * RECORD.size


class Slot(NamedTuple):
    """One participant as the others see it."""

    serial: int
    """Unique on this wire, serial % SLOTS is the slot; 0 is an empty slot."""
    pid: int
    rung_ns: int
    """When its doorbell was last rung; 0 while it waits for the next ring."""
    queued: int
    """Its frames in the transmit queue."""


class Wire:
    """One channel's shared memory.

    Mutable state: the mapping, shared with every participant, and whether this process holds the lock.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        # re-entrant: an interrupt inside lock() must not lock this thread out for good
        self._thread = threading.RLock()
        while True:
            try:
                self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            except OSError as error:
                raise BusError(
                    f"localcan: {path}: {error.strerror}; remove it or set XDG_RUNTIME_DIR"
                ) from error
            fcntl.flock(self._fd, fcntl.LOCK_EX)
            status = os.fstat(self._fd)
            if status.st_uid != os.getuid() or status.st_mode & 0o077:
                os.close(self._fd)
                raise BusError(f"localcan: {path} is not this user's alone; remove it")
            if status.st_nlink:
                break
            # the last participant removed the file between our open and our lock
            os.close(self._fd)
        if status.st_size != _SIZE:
            self._allocate()
        self.memory = mmap.mmap(self._fd, _SIZE)
        if self.memory[:8] != MAGIC:
            self.clear()
        # locked: the caller sweeps, registers and unlocks
        self._thread.acquire()

    def _allocate(self) -> None:
        try:
            os.ftruncate(self._fd, _SIZE)
            # a sparse file on a full memory file system would kill the process at the first write
            os.posix_fallocate(self._fd, 0, _SIZE)
        except OSError as error:
            self.path.unlink(missing_ok=True)
            os.close(self._fd)
            raise BusError(
                f"localcan: no room for {_SIZE // 1024} KiB in {self.path.parent} ({error.strerror}); "
                "free some or set XDG_RUNTIME_DIR"
            ) from error

    def lock(self) -> None:
        """Wait for the wire. Held for some 20 us at a time: spin shortly before going to sleep."""
        self._thread.acquire()
        for _ in range(8):
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            return
        fcntl.flock(self._fd, fcntl.LOCK_EX)

    def unlock(self) -> None:
        """Let the others in."""
        fcntl.flock(self._fd, fcntl.LOCK_UN)
        self._thread.release()

    def close(self) -> None:
        """Unmap. Gives the lock back if it is held."""
        self.memory.close()
        os.close(self._fd)

    def forget(self) -> None:
        """Close this process's copy of the descriptor without a word to the others: after a fork."""
        os.close(self._fd)

    def clear(self) -> None:
        """Start a new bus: nobody on it, nothing sent, timing open."""
        self.memory[:_QUEUE_AT] = bytes(_QUEUE_AT)
        self.memory[:8] = MAGIC

    # header
    @property
    def timing(self) -> BitTiming | None:
        """Bit timing that the participants agreed on, None while none has stated one."""
        bitrate, data_bitrate = struct.unpack_from("<qq", self.memory, _BITRATE)
        return BitTiming(bitrate, data_bitrate) if bitrate else None

    @property
    def fd(self) -> bool:
        """Whether CAN FD frames may be sent; meaningful with `timing`."""
        return bool(self.memory[_FD])

    @property
    def lost(self) -> int:
        """Frames that were queued when a holder of the lock died."""
        return int(_TIME.unpack_from(self.memory, _LOST)[0])

    def fix(self, timing: BitTiming, fd: bool) -> None:
        """Set the timing for the life of this bus."""
        self.memory[_FD] = fd
        struct.pack_into("<q", self.memory, _DATA_BITRATE, timing.data_bitrate)
        _TIME.pack_into(self.memory, _BITRATE, timing.bitrate)

    # participants
    def slots(self) -> list[Slot]:
        """Return all slots that were ever in use, empty ones included."""
        used = _TIME.unpack_from(self.memory, _USED)[0]
        raw = self.memory[_SLOTS_AT : _SLOTS_AT + used * _SLOT.size]
        return [Slot(*fields[:4]) for fields in _SLOT.iter_unpack(raw)]

    def to_ring(self, serial: int, now_ns: int, again_ns: int) -> list[int]:
        """Mark and return the others that wait for a ring, or have not answered one for `again_ns`."""
        used = _TIME.unpack_from(self.memory, _USED)[0]
        raw = self.memory[_SLOTS_AT : _SLOTS_AT + used * _SLOT.size]
        serials = [
            other
            for other, _, rung, _, _ in _SLOT.iter_unpack(raw)
            if other and other != serial and (not rung or now_ns - rung > again_ns)
        ]
        for other in serials:
            self.set_rung(other, now_ns)
        return serials

    def register(self, pid: int) -> int:
        """Take a slot and return the new serial number. Raises BusError when all are taken."""
        slots = self.slots()
        index = next((i for i, slot in enumerate(slots) if not slot.serial), len(slots))
        if index >= SLOTS:
            raise BusError(f"localcan: {self.path.name} has {SLOTS} participants, no more fit; close one")
        generation = _TIME.unpack_from(self.memory, _SERIAL)[0] + 1
        _TIME.pack_into(self.memory, _SERIAL, generation)
        serial = int(generation * SLOTS + index)
        _SLOT.pack_into(self.memory, _SLOTS_AT + index * _SLOT.size, serial, pid, 0, 0, 0)
        if index == len(slots):
            _TIME.pack_into(self.memory, _USED, index + 1)
        return serial

    def unregister(self, serial: int) -> None:
        """Empty a slot; what its owner queued is still sent."""
        at = _SLOTS_AT + serial % SLOTS * _SLOT.size
        if _SLOT.unpack_from(self.memory, at)[0] == serial:
            _SLOT.pack_into(self.memory, at, 0, 0, 0, 0, 0)

    def set_rung(self, serial: int, t_ns: int) -> None:
        """Note that a doorbell was rung, or with 0 that its owner waits for the next ring."""
        _TIME.pack_into(self.memory, _SLOTS_AT + serial % SLOTS * _SLOT.size + 8, t_ns)

    def queued_by(self, serial: int) -> int:
        """Count a participant's frames in the transmit queue."""
        return int(_COUNT.unpack_from(self.memory, _SLOTS_AT + serial % SLOTS * _SLOT.size + 16)[0])

    def _add_queued(self, serial: int, change: int) -> None:
        at = _SLOTS_AT + serial % SLOTS * _SLOT.size
        if _COUNT.unpack_from(self.memory, at)[0] == serial:
            queued = _COUNT.unpack_from(self.memory, at + 16)[0]
            _COUNT.pack_into(self.memory, at + 16, max(0, queued + change))

    # transmit queue and ring
    def advance(self, now_ns: int) -> tuple[int, int, int]:
        """Decide what begins by now; return (frames ever sent, frames queued, when the bus falls free)."""
        memory = self.memory
        dirty, free, head, queued, _ = _STATE.unpack_from(memory, _STATE_AT)
        if dirty:
            self._recover(now_ns)
            return self.advance(now_ns)
        if not queued or free > now_ns:
            return head, queued, free
        raw = memory[_QUEUE_AT : _QUEUE_AT + queued * RECORD.size]
        entries = list(_ORDER.iter_unpack(raw))
        order = [(t, key, i, length) for i, (t, key, length, _) in enumerate(entries)]
        sent, free = arbitrate(order, free, now_ns)
        if not sent:
            return head, queued, free
        _TIME.pack_into(memory, _STATE_AT, 1)
        size = RECORD.size
        senders: dict[int, int] = {}
        for i, end in sent:
            at = _RING_AT + head % RING * size
            memory[at : at + size] = _TIME.pack(end) + raw[i * size + 8 : i * size + size]
            head += 1
            sender = entries[i][3]
            senders[sender] = senders.get(sender, 0) + 1
        for sender, frames in senders.items():
            self._add_queued(sender, -frames)
        if len(sent) < queued:
            gone = {i for i, _ in sent}
            rest = b"".join(raw[i * size : i * size + size] for i in range(queued) if i not in gone)
            memory[_QUEUE_AT : _QUEUE_AT + len(rest)] = rest
        queued -= len(sent)
        _STATE.pack_into(memory, _STATE_AT, 1, free, head, queued, 0)
        _TIME.pack_into(memory, _STATE_AT, 0)
        return head, queued, free

    def _recover(self, now_ns: int) -> None:
        """Start over with an empty queue after a holder of the lock died while it rebuilt the queue."""
        _, _, head, queued, _ = _STATE.unpack_from(self.memory, _STATE_AT)
        _TIME.pack_into(self.memory, _LOST, self.lost + queued)
        for slot in self.slots():
            if slot.serial:
                self._add_queued(slot.serial, -slot.queued)
        _STATE.pack_into(self.memory, _STATE_AT, 1, now_ns, head, 0, 0)
        _TIME.pack_into(self.memory, _STATE_AT, 0)

    def enqueue(self, serial: int, records: list[bytes]) -> None:
        """Append packed RECORDs; the caller has checked that they fit."""
        queued = _TIME.unpack_from(self.memory, _QUEUED_AT)[0]
        at = _QUEUE_AT + queued * RECORD.size
        raw = b"".join(records)
        self.memory[at : at + len(raw)] = raw
        _TIME.pack_into(self.memory, _QUEUED_AT, queued + len(records))
        self._add_queued(serial, len(records))

    def withdraw(self, serial: int) -> int:
        """Drop a participant's frames that have not started; return how many."""
        queued = _TIME.unpack_from(self.memory, _QUEUED_AT)[0]
        raw = self.memory[_QUEUE_AT : _QUEUE_AT + queued * RECORD.size]
        records = (raw[i : i + RECORD.size] for i in range(0, len(raw), RECORD.size))
        kept = [record for record in records if RECORD.unpack(record)[3] != serial]
        _TIME.pack_into(self.memory, _STATE_AT, 1)
        self.memory[_QUEUE_AT : _QUEUE_AT + len(kept) * RECORD.size] = b"".join(kept)
        _TIME.pack_into(self.memory, _QUEUED_AT, len(kept))
        dropped = int(queued) - len(kept)
        self._add_queued(serial, -dropped)
        _TIME.pack_into(self.memory, _STATE_AT, 0)
        return dropped

    def sent(self, first: int, last: int) -> bytes:
        """Return the RECORDs number first to last - 1 of the ring; last - first <= RING."""
        a, b = first % RING, last % RING
        size = RECORD.size
        if first == last:
            return b""
        if a < b:
            return self.memory[_RING_AT + a * size : _RING_AT + b * size]
        return self.memory[_RING_AT + a * size : _SIZE] + self.memory[_RING_AT : _RING_AT + b * size]

    def waiting(self, queued: int) -> bytes:
        """Return the RECORDs in the transmit queue."""
        return self.memory[_QUEUE_AT : _QUEUE_AT + queued * RECORD.size]
