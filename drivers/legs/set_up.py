"""What can be told of a set-up that a drive does not confirm: its status has a checksum of it, no values."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Rows
from drivers.frame_array import sent_frames
from drivers.legs.codec import Codec
from drivers.legs.crc import identifier_state
from drivers.legs.device_kernels import intact
from drivers.legs.kernels import FOREIGN
from drivers.legs.messages import set_up_checksum
from drivers.protocol import Frame
from drivers.signals import LEGS, Reaction

NOT_HEARD = -1
"""Said by a drive whose status has not been heard."""
_NEWEST = 8
"""Versions of the protocol that are tried."""


def checksums_heard(
    said: tuple[int, ...], frames: Rows, status_ids: Sequence[int], length: int, at: int
) -> tuple[int, ...]:
    """Return what the drives have said of their set-up, leg order, with the statuses among frames of FRAME.

    A status has `length` bytes, the two of the checksum from `at` on.
    """
    statuses = frames[np.isin(frames["id"], status_ids)]
    for identifier, data, flags in sent_frames(statuses):
        ours = not flags & FOREIGN and len(data) == length
        if ours and intact(data, identifier_state(identifier)):
            leg = status_ids.index(identifier)
            said = (*said[:leg], int.from_bytes(data[at : at + 2], "little"), *said[leg + 1 :])
    return said


def lack(said: int, times: int, frame: Frame, config: Codec, rated_force_N: float) -> str:
    """Return which value of its CONFIG a drive has not confirmed that was sent it some times.

    A watchdog and a rated force can have so many values that a checksum names none.
    """
    watchdog, *sent = config.unpack(frame.data)

    def checksum(values: Sequence[int]) -> int:
        return set_up_checksum(frame.id, config.pack(watchdog, *values), rated_force_N)

    expected = checksum(sent)
    if not times:
        return "it was sent no CONFIG"
    if said in (NOT_HEARD, expected):
        return f"no status of it was heard that confirms one of {times} CONFIG"
    if said == 0:
        return "it reports no set-up: it has accepted no CONFIG"
    names = "reaction", "leg", "version of the protocol"
    for k, values in enumerate((range(len(Reaction)), range(1, LEGS + 1), range(_NEWEST))):
        for value in values:
            if value != sent[k] and checksum((*sent[:k], value, *sent[k + 1 :])) == said:
                shown, known = ((Reaction(v).name.lower() if k == 0 else v) for v in (value, sent[k]))
                return f"its checksum is that of {names[k]} {shown}, sent was {known}"
    watchdog_ms = 1e3 * watchdog * config.scale[0]
    return (
        f"its checksum is 0x{said:04X}, not 0x{expected:04X}, and fits no other reaction, leg or version "
        f"alone: watchdog (sent: {watchdog_ms:g} ms), rated force (drives.force_limit_N: {rated_force_N:g} "
        "N) or several values differ"
    )
