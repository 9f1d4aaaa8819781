"""The shared memory of one localcan channel: its file, its timing, who is on it.

Only joining and leaving take the file's lock, and wait for it for a bounded time.
"""

import fcntl
import mmap
import os
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import Ints
from drivers.can.bus_time import BitTiming
from drivers.can.localcan import layout
from drivers.can.localcan.layout import (
    MAGIC,
    MAGIC_AT,
    OUTBOX,
    OUTBOX_AT,
    RECORD,
    SERIAL_AT,
    SIZE,
    SLOT,
    SLOT_COUNT,
    SLOT_DUE,
    SLOT_PID,
    SLOT_RUNG,
    SLOT_SERIAL,
    SLOTS,
    SLOTS_AT,
    TIMING_AT,
    USED_AT,
    WORD,
    outbox_at,
    slot_at,
)
from drivers.errors import BusError

JOIN_S = 2.0
"""Joining waits no longer for others that join or leave; each takes a few ms."""
LEAVE_S = 0.2
_AGAIN_S = 0.001


class Slot(NamedTuple):
    """One participant as the others see it."""

    serial: int
    """Unique on this wire, serial % SLOTS is the slot; 0 is an empty slot."""
    pid: int


class Wire:
    """One channel's shared memory; made with the lock held.

    Mutable state: the mapping, shared with every participant, and whether this process holds the lock.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        until = time.monotonic() + JOIN_S
        while True:
            try:
                self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            except OSError as error:
                raise BusError(
                    f"localcan: {path}: {error.strerror}; remove it or set XDG_RUNTIME_DIR"
                ) from error
            if not self._lock(until):
                os.close(self._fd)
                raise BusError(
                    f"localcan: a process has held {path} for {JOIN_S:g} s, stopped while it joined or left: "
                    f"let it go on (`fuser {path}` names the processes, `kill -CONT` wakes one) or end it"
                )
            status = os.fstat(self._fd)
            if status.st_uid != os.getuid() or status.st_mode & 0o077:
                os.close(self._fd)
                raise BusError(f"localcan: {path} is not this user's alone; remove it")
            if status.st_nlink:
                break
            # the last participant removed the file between our open and our lock
            os.close(self._fd)
        new = status.st_size != SIZE
        try:
            if new:
                self._claim(0, OUTBOX_AT * WORD)
            self.memory = mmap.mmap(self._fd, SIZE)
        except (BusError, OSError) as error:
            if new:
                self.path.unlink(missing_ok=True)
            os.close(self._fd)
            if isinstance(error, BusError):
                raise
            raise BusError(
                f"localcan: {path}: {error.strerror}: {SIZE / 1e6:.1f} MB of memory are mapped; "
                "raise what a process may have (`ulimit -v`), or end what takes the memory"
            ) from error
        self.words: Ints = np.frombuffer(self.memory, np.int64)
        if self.words[MAGIC_AT] != MAGIC:
            self.clear()

    def _lock(self, until: float) -> bool:
        while True:
            try:
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > until:
                    return False
                time.sleep(_AGAIN_S)
            else:
                return True

    def _claim(self, start: int, length: int) -> None:
        """Have memory for a part of the file: a full file system would kill the process at a first write."""
        try:
            os.ftruncate(self._fd, SIZE)
            os.posix_fallocate(self._fd, start, length)
        except OSError as error:
            raise BusError(
                f"localcan: no room for {length // 1024} KiB in {self.path.parent} ({error.strerror}); "
                "free some or set XDG_RUNTIME_DIR"
            ) from error

    def lock(self) -> bool:
        """Wait for the others that join or leave, for LEAVE_S at most; tell whether the lock was had."""
        return self._lock(time.monotonic() + LEAVE_S)

    def unlock(self) -> None:
        """Let the others join and leave."""
        fcntl.flock(self._fd, fcntl.LOCK_UN)

    def close(self) -> None:
        """Give lock and file back; the memory is unmapped with the last who looks at it."""
        self.unlock()  # said, not left to close(): the mapping has a descriptor of its own
        os.close(self._fd)

    def forget(self) -> None:
        """Close this process's copy of the descriptor without a word to the others: after a fork."""
        os.close(self._fd)

    def clear(self) -> None:
        """Start a new bus: nobody on it, nothing sent, timing open."""
        self.words[:OUTBOX_AT] = 0
        self.words[MAGIC_AT] = MAGIC

    # timing
    @property
    def timing(self) -> BitTiming | None:
        """Bit timing that the participants agreed on, None while none has stated one."""
        packed = int(self.words[TIMING_AT])
        return BitTiming(packed & 0x7FFFFFFF, packed >> 31 & 0x7FFFFFFF) if packed else None

    @property
    def fd(self) -> bool:
        """Whether CAN FD frames may be sent; meaningful with `timing`."""
        return bool(self.words[TIMING_AT] >> 62 & 1)

    def fix(self, timing: BitTiming, fd: bool) -> None:
        """Set the timing for the life of this bus, in one word: two who do so at once cannot mix theirs."""
        self.words[TIMING_AT] = timing.bitrate | timing.data_bitrate << 31 | int(fd) << 62

    # participants
    def slots(self) -> list[Slot]:
        """Return all slots that were ever in use, empty ones included."""
        used = int(self.words[USED_AT])
        rows = self.words[SLOTS_AT : SLOTS_AT + used * SLOT].reshape(used, SLOT)
        return [Slot(int(row[SLOT_SERIAL]), int(row[SLOT_PID])) for row in rows]

    def reserve(self) -> int:
        """Choose a newcomer's serial number (with the lock held). Raises BusError without a free slot."""
        slots = self.slots()
        index = next((i for i, slot in enumerate(slots) if not slot.serial), len(slots))
        if index >= SLOTS:
            raise BusError(f"localcan: {self.path.name} has {SLOTS} participants, no more fit; close one")
        generation = int(self.words[SERIAL_AT]) + 1
        self.words[SERIAL_AT] = generation
        serial = generation * SLOTS + index
        self._claim(outbox_at(serial) * WORD, OUTBOX * RECORD.size)
        return serial

    def register(self, serial: int, pid: int) -> None:
        """Take the slot; from now on the others ring this participant, so its doorbell has to be there."""
        at = slot_at(serial)
        for place, value in ((SLOT_PID, pid), (SLOT_RUNG, 0), (SLOT_DUE, 0), (SLOT_SERIAL, serial)):
            self.words[at + place] = value
        self.words[USED_AT] = max(int(self.words[USED_AT]), serial % SLOTS + 1)

    # frames
    def put(self, serial: int, number: int, *fields: object) -> None:
        """Write a frame into its sender's outbox: the fields of RECORD after number and end."""
        RECORD.pack_into(self.memory, WORD * layout.record_at(serial, number), number, -1 - number, *fields)

    def count(self, serial: int) -> int:
        """Return how many frames were ever put into this outbox: the number of the next one."""
        return int(self.words[slot_at(serial) + SLOT_COUNT])

    def counted(self, serial: int, frames: int) -> None:
        """Note how many frames were ever put into this outbox."""
        self.words[slot_at(serial) + SLOT_COUNT] = frames
