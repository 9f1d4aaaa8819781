"""Shared memory of one localcan channel: its file, bit timing, participants and their doorbell sockets.

Joining and leaving take the file's lock, for a bounded time; sending and receiving never do.
"""

import contextlib
import mmap
import os
import select
import socket
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import Ints
from drivers.can.bus_time import BitTiming
from drivers.can.localcan import layout as at
from drivers.errors import BusError

JOIN_S = 2.0
"""Longest wait for others that join or leave; each takes a few ms."""
LEAVE_S = 0.2
_AGAIN_S = 0.001


class Mode(NamedTuple):
    """Bit rates of a channel, and CAN FD or classic. Modes with equal text are compatible."""

    timing: BitTiming
    fd: bool

    def __str__(self) -> str:
        rate, fast = self.timing
        return f"CAN FD {rate}/{fast} bit/s" if self.fd else f"classic CAN {rate} bit/s"


class Wire:
    """Shared memory of one channel, created with the lock held, and the doorbells of its participants.

    A doorbell is a datagram socket; a ring says that there is something to read. File and sockets lie in a
    folder of this user alone.
    Mutable state: the mapping, shared with all participants; the lock, if held; the doorbell.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._prefix = str(path.with_suffix(""))
        while True:
            try:
                self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            except OSError as error:
                raise BusError(
                    f"localcan: {path}: {error.strerror}; remove it or set XDG_RUNTIME_DIR"
                ) from error
            locked, status = self.lock(JOIN_S), os.fstat(self._fd)
            if locked and status.st_nlink:
                break
            # without a link: the last participant removed the file between our open and our lock
            os.close(self._fd)
            if not locked:
                raise BusError(
                    f"localcan: a process has locked {path} for {JOIN_S:g} s: it was stopped while it joined "
                    f"or left. Resume it (`fuser {path}` lists the processes, `kill -CONT` resumes one) or "
                    "end it"
                )
        new = status.st_size != at.SIZE
        try:
            if new:
                self._claim(0, at.OUTBOX_AT * at.WORD)
            self.memory = mmap.mmap(self._fd, at.SIZE)
        except OSError as error:
            if new:
                self.path.unlink(missing_ok=True)
            os.close(self._fd)
            raise self._no_room(error) from error
        self.words: Ints = np.frombuffer(self.memory, np.int64)
        self._slots = self.words[at.SLOTS_AT :][: at.SLOTS * at.SLOT].reshape(at.SLOTS, at.SLOT)
        self.bell = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.bell.setblocking(False)

    def lock(self, seconds: float) -> bool:
        """Lock the channel against others that join or leave; False if that took more than `seconds`."""
        import fcntl  # noqa: PLC0415 - not on Windows

        until = time.monotonic() + seconds
        while True:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
            if time.monotonic() > until:
                return False
            time.sleep(_AGAIN_S)

    def _claim(self, start: int, length: int) -> None:
        """Reserve memory for part of the file: on a full file system a later write would kill the process."""
        os.ftruncate(self._fd, at.SIZE)
        os.posix_fallocate(self._fd, start, length)

    def _no_room(self, error: OSError) -> BusError:
        return BusError(
            f"localcan: no room in {self.path.parent} or in memory ({error.strerror}); free some space, "
            "raise the limit of a process (`ulimit -v`), or set XDG_RUNTIME_DIR"
        )

    def unlock(self) -> None:
        """Release the lock, so that others can join and leave."""
        import fcntl  # noqa: PLC0415 - not on Windows

        fcntl.flock(self._fd, fcntl.LOCK_UN)

    def close(self) -> None:
        """Release doorbell, lock and file; the memory is unmapped with its last user."""
        self.bell.close()
        self.unlock()  # explicit, as close() is not enough: the mapping has a descriptor of its own
        os.close(self._fd)

    @property
    def mode(self) -> Mode | None:
        """Bit timing that the participants use; None until one of them sets it."""
        packed = int(self.words[at.TIMING_AT])
        rates = BitTiming(packed & 0x7FFFFFFF, packed >> 31 & 0x7FFFFFFF)
        return Mode(rates, bool(packed >> 62)) if packed else None

    def fix(self, mode: Mode) -> None:
        """Set the bit timing for the life of this bus, in one atomic word: two writers cannot mix theirs."""
        (rate, fast), fd = mode
        self.words[at.TIMING_AT] = rate | fast << 31 | int(fd) << 62

    # participants
    def present(self) -> dict[int, int]:
        """Process id of each participant, by serial number."""
        pairs = self._slots[:, [at.SLOT_SERIAL, at.SLOT_PID]].tolist()
        return {serial: pid for serial, pid in pairs if serial}

    def enter(self) -> int:
        """Take a slot and open its doorbell, with the lock held; the result is the serial number.

        The participant is on the bus once it writes the number into the slot.
        Raises BusError without a free slot, without memory, or if the socket cannot be opened.
        """
        empty = np.flatnonzero(self._slots[:, at.SLOT_SERIAL] == 0)
        if not len(empty):
            raise BusError(f"localcan: {self.path.name} has {at.SLOTS} participants, the limit; close one")
        self.words[at.SERIAL_AT] += 1
        serial = int(self.words[at.SERIAL_AT]) * at.SLOTS + int(empty[0])
        try:
            self._claim(at.record_at(serial, 0) * at.WORD, at.OUTBOX * at.RECORD_WORDS * at.WORD)
        except OSError as error:
            raise self._no_room(error) from error
        bell, slot = Path(self.bell_of(serial)), self._slots[empty[0]]
        try:
            bell.unlink(missing_ok=True)
            self.bell.bind(str(bell))
        except OSError as error:
            raise BusError(
                f"localcan: cannot open the socket {bell}: {error}; "
                "set XDG_RUNTIME_DIR to a folder of your own with a short path"
            ) from error
        slot[[at.SLOT_PID, at.SLOT_RUNG, at.SLOT_DUE]] = os.getpid(), 0, 0
        self.words[at.USED_AT] = max(int(self.words[at.USED_AT]), int(empty[0]) + 1)
        return serial

    # doorbells
    def bell_of(self, serial: int) -> str:
        """Path of the doorbell socket of the participant with this serial number."""
        return f"{self._prefix}.{serial}"

    def ring(self, serial: int) -> bool:
        """Ring the doorbell of a participant; False if its process has ended."""
        try:
            self.bell.sendto(b"", self.bell_of(serial))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except BlockingIOError:
            pass
        return True

    def silence(self) -> None:
        """Empty the doorbell: discard all rings received so far."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self.bell.recv(1)

    def wait(self, seconds: float) -> None:
        """Sleep until the doorbell rings, at most `seconds`."""
        select.select([self.bell], [], [], seconds)
