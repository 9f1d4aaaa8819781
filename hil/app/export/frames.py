"""The CAN frames of a log as a file of frames, in the order of their times."""

from pathlib import Path

from drivers.can.frame_files import WRITERS
from drivers.protocol import BUS, Frame
from hil.record.log import Log


def write_frames(log: Log, path: Path, form: str, shift_ns: int) -> int:
    """Write all frames; return their number.

    form : a key of `drivers.can.frame_files.WRITERS`; shift_ns : what is added to the log's UTC. No time
    falls: a frame that the log has later than its time takes that of the one before.

    Raises LogError: the log is damaged.
    """
    writer = WRITERS[form](path, log.can_channel)
    offset, last, count = log.epoch_ns + shift_ns, 0, 0
    try:
        for t_ns, _, sent, bus, can_id, data, flags in log.can_frames():
            last = max(last, t_ns + offset)
            writer.write(last, Frame(can_id, data, flags + bus * BUS), sent=sent)
            count += 1
    finally:
        writer.close()
    return count
