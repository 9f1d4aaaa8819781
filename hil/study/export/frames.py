"""The CAN frames of a log as a file of frames, in the order of their times."""

from pathlib import Path

from drivers.can.frame_files import WRITERS
from drivers.protocol import BUS, Frame
from hil.record.log import Log


def write_frames(log: Log, path: Path, form: str, shift_ns: int) -> int:
    """Write all frames; return their number.

    form : a key of `drivers.can.frame_files.WRITERS`; shift_ns : what is added to the log's UTC. A frame that
    the log has more than a second after its time stands later in the file, at its own time.

    Raises LogError: the log is damaged.
    """
    writer = WRITERS[form](path, log.can_channels)
    offset, count = log.epoch_ns + shift_ns, 0
    try:
        for t_ns, _, sent, bus, can_id, data, flags in log.can_frames():
            writer.write(t_ns + offset, Frame(can_id, data, flags + bus * BUS), sent=sent)
            count += 1
    finally:
        writer.close()
    return count
