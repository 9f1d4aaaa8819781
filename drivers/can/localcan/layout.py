"""Layout of the shared memory of one localcan channel, in words of 8 bytes.

Header, one slot per participant, the log, one outbox per participant. Each word has one writer or changes
only by atomic operations; a frame is complete in its sender's outbox before the slot counts it. So a process
that is stopped or killed between any two instructions leaves nothing half done, and nobody waits for it.
"""

from drivers.compiled.compiler import helper

VERSION = 4
"""Part of the file name: programs with different layouts use different wires."""
SLOTS = 64
"""Most participants on one channel."""
LOG = 1 << 15
"""Entries of the log, one per frame: a reader may lag by 2 s at 14 000 frames/s."""
OUTBOX = 1 << 13
"""Frames of one sender by which a reader may lag: 1.2 s at 7000 frames/s."""
WORD = 8

TIMING_AT, SERIAL_AT, USED_AT, CLOCK_AT, WAKE_AT, WORK_AT = range(6)
"""Header: bit timing, 0 until it is set; participants so far; slots ever used; and for `bench_clock`: whether
time may stand still, and the times allowed to wake up and to work, ns."""
HINT_AT, OFFSET_AT, LATEST_AT = 16, 24, 32
"""Words that change all the time, far from each other: an index near the log's end; lag of virtual time
behind CLOCK_MONOTONIC, ns; latest virtual time read by any participant, ns."""
SLOTS_AT = 64
SLOT = 16
SLOT_SERIAL, SLOT_PID, SLOT_RUNG, SLOT_COUNT, SLOT_DUE, SLOT_FIRST = range(6)
"""Words of a slot: serial number of its participant, unique on this wire (serial % SLOTS is the slot; 0:
empty); its process; time of its last ring, 0 while it waits for one; frames ever put into its outbox; its due
of `bench_clock`, 0 if it does not hold time; number of the first frame in its outbox that may still wait."""
LOG_AT = 2048
OUTBOX_AT = LOG_AT + LOG
NUMBER, END, QUEUED, PRIORITY, DURATION, SENDER, DETAIL = range(7)
"""Words of a frame in an outbox: number, end ns (negative until it starts, 0 if withdrawn), time of queueing
ns, priority, duration ns, sender's serial number; from DETAIL on as in FRAME: identifier to bus, and data."""
RECORD_WORDS = DETAIL + 9
SIZE = WORD * (OUTBOX_AT + SLOTS * OUTBOX * RECORD_WORDS)
"""Bytes of the file; unused parts take no memory."""

NUMBER_BITS, LAP_SHIFT = 20, 26
"""Entry of the log, a frame that starts: number, slot and, from LAP_SHIFT on, lap."""
FIRST = LOG
"""Index of the first entry ever: the words of an empty log count as entries of the lap before."""


@helper
def slot_at(serial: int) -> int:
    """Index of the first word of the slot of the participant with this serial number."""
    return SLOTS_AT + serial % SLOTS * SLOT


@helper
def record_at(serial: int, number: int) -> int:
    """Index of the first word of the record of a participant's frame; number: counts its sent frames."""
    return OUTBOX_AT + (serial % SLOTS * OUTBOX + number % OUTBOX) * RECORD_WORDS
