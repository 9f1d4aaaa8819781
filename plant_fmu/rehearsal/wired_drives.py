"""The drives' end of a protocol with drives that are set up wrongly: node numbers, watchdogs, presence."""

from collections.abc import Sequence
from copy import copy
from math import isinf
from typing import Any, cast

import numpy as np

from drivers.protocol import DriveProtocol, Frame
from drivers.signals import LEGS
from drivers.tick_columns import Record
from plant_fmu.drives import drives_end
from plant_fmu.drives.ends import READING, DrivesEnd
from plant_fmu.messages import Answer, Configure, DeviceCommand, DeviceMessage, Rejected, Status, Sync
from plant_fmu.rehearsal.wiring import OWN, Wiring

NEVER_S = 1e6
"""What a drive without a watchdog adds to the time that it was told."""
HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""
PRE_OPERATIONAL = b"\x7f"


def wired_drives(protocol: DriveProtocol, wiring: Wiring, node_ids: Sequence[int]) -> DriveProtocol:
    """Return a drive protocol whose drives' end, powered up, is that of a wiring."""
    wired = copy(protocol)
    cast("Any", wired).drives_end = lambda: WiredEnd(protocol, wiring, node_ids)
    return wired


class WiredEnd(DrivesEnd):
    """The drives' end of a protocol, wired.

    What drives remember is by the number that they answer to: two with one number share it.
    """

    def __init__(self, protocol: DriveProtocol, wiring: Wiring, node_ids: Sequence[int]) -> None:
        self._end = drives_end(protocol)
        self._wiring = wiring
        self._node_ids = tuple(node_ids)
        self._plain = wiring.answers_as == OWN and all(wiring.present) and not any(wiring.other_protocol)
        """Each drive answers, and under its own number."""
        self._mute = {k for k in range(LEGS) if not wiring.present[k] or wiring.other_protocol[k]}

    def hear(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Return what a frame says to the drives that believe it to be theirs."""
        return tuple(each for one in self._end.hear(frame) for each in self._heard(one))

    def _heard(self, message: DeviceMessage) -> list[DeviceMessage]:
        if isinstance(message, Rejected):
            return [message]
        legs = (message.leg,) if isinstance(message, Configure | Answer) else message.legs
        named = self._wiring.answers_as
        takes = tuple(k for k in range(LEGS) if named[k] in legs and k not in self._mute)
        match message:
            case Configure():
                return [message._replace(leg=k, watchdog_s=self._waits(k, message.watchdog_s)) for k in takes]
            case Answer():
                return [message] if message.leg in takes else []
            case DeviceCommand() if takes:
                forces = np.array([message.force[legs.index(named[k])] for k in takes], float)
                return [message._replace(legs=takes, force=forces)]
            case _:
                return [message._replace(legs=takes)] if takes else []

    def _waits(self, drive: int, watchdog_s: float) -> float:
        factor = self._wiring.watchdog[drive]
        return watchdog_s + NEVER_S if isinf(factor) else watchdog_s * factor

    def _told(self, drive: int, watchdog_s: float) -> float:
        """Return what the drive was told that waits so long: it confirms that."""
        factor = self._wiring.watchdog[drive]
        return round(watchdog_s - NEVER_S, 9) if isinf(factor) else watchdog_s / factor

    def reply(self, sync: Sync, reading: Record) -> list[tuple[int, Frame]]:
        """Return what the drives answer, each under the number that it was given."""
        if self._plain:
            return self._end.reply(sync, reading)
        frames = []
        for drive in sync.legs:
            if drive in self._mute:
                continue
            as_leg, given = self._wiring.answers_as[drive], reading.copy()
            for name in READING.fields or ():
                given[name][as_leg] = reading[name][drive]
            answers = self._end.reply(sync._replace(legs=(as_leg,)), given)
            frames += [(drive, frame) for leg, frame in answers if leg == as_leg]
        return frames

    def announce(self, status: Status) -> tuple[Frame, ...]:
        """Return one drive's heartbeat, which confirms what the drive was told."""
        drive = status.leg
        if self._wiring.other_protocol[drive]:
            return (Frame(HEARTBEAT + self._node_ids[drive], PRE_OPERATIONAL),)
        if not self._wiring.present[drive]:
            return ()
        as_leg, holds = self._wiring.answers_as[drive], status.set_up
        if holds is not None:
            holds = Configure(as_leg, self._told(drive, holds.watchdog_s), holds.reaction)
        return self._end.announce(status._replace(leg=as_leg, set_up=holds))

    def restart(self, legs: Sequence[int]) -> None:
        """Forget what drives remember that were switched off and on."""
        self._end.restart([self._wiring.answers_as[k] for k in legs])
