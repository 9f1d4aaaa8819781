"""Conversion of frames to and from messages of python-can."""

import can

from drivers.can.link import OWN
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame


def to_message(
    frame: tuple[int, int, int, int, int, bytes], epoch_ns: int = 0, channel: str | int = ""
) -> can.Message:
    """python-can Message of a tuple of `unpack_frames`; `epoch_ns`: Unix time minus the frame's clock, ns."""
    t_ns, id_, _, size, flags, data = frame
    return can.Message(
        timestamp=(t_ns + epoch_ns) * 1e-9,
        arbitration_id=id_,
        is_extended_id=bool(flags & EXTENDED),
        is_remote_frame=bool(flags & REMOTE),
        is_error_frame=bool(flags & ERROR),
        is_fd=bool(flags & FD),
        is_rx=not flags & OWN,
        bitrate_switch=bool(flags & BRS),
        error_state_indicator=bool(flags & ESI),
        channel=channel,
        data=data[:size],
    )


def from_message(message: can.Message) -> Frame:
    """Frame of a python-can Message. The length code of a remote frame is dropped."""
    flags = (
        EXTENDED * message.is_extended_id
        | REMOTE * message.is_remote_frame
        | ERROR * message.is_error_frame
        | FD * message.is_fd
        | BRS * message.bitrate_switch
        | ESI * message.error_state_indicator
    )
    return Frame(message.arbitration_id, bytes(message.data), flags)
