"""The controller's end of single-motor drives in the loop: the kernels' record has the dialogue."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers import motor_kernels as kernels
from drivers.arrays import Rows
from drivers.compiled.pointed import Pointed, data_at
from drivers.controller_end import ControllerEnd
from drivers.frame_array import FRAME, sent_array
from drivers.motor_dialogue import MotorDialogue
from drivers.protocol import DriveSetup, Frame
from drivers.several_buses import SeveralBuses
from drivers.signals import LEGS
from drivers.tick_columns import Record

_SIX = ("torque", "rate", "power", "done", "asked", "said", "owed")


def remember(m: Record, dialogue: MotorDialogue) -> None:
    """Put a dialogue into its record of `drivers.motor_kernels`."""
    for name in (*_SIX, "ran", "mode", "patience_ticks"):
        m[name] = getattr(dialogue, name)
    m["has_read"] = [each is not None for each in dialogue.read]
    m["read"] = [each or 0.0 for each in dialogue.read]
    for leg, exchanges in enumerate(dialogue.exchanges):
        m["exchanges"][leg] = len(exchanges)
        for k, exchange in enumerate(exchanges):
            m["registers"][leg, k], m["values"][leg, k] = exchange.register, exchange.value


def after(m: Record, dialogue: MotorDialogue) -> MotorDialogue:
    """Return the dialogue with what its record remembers by now."""
    reads = zip(m["read"].tolist(), m["has_read"].tolist(), strict=True)
    six: dict[str, Any] = {name: tuple(m[name].tolist()) for name in _SIX}
    ran, read = tuple(map(bool, m["ran"].tolist())), tuple(value if has else None for value, has in reads)
    return dialogue._replace(mode=int(m["mode"]), ran=ran, read=read, **six)


class MotorsEnd(ControllerEnd):
    """The controller's end, compiled. The record has the dialogue."""

    def __init__(
        self,
        protocol: Any,
        setup: DriveSetup,
        family: tuple[Record, Rows, Pointed],
        polls: Sequence[Frame],
    ) -> None:
        """Take the family's record and frames, which are copied, what takes a command, and its polls."""
        prepared, frames, self._commanding = family
        self._own, self._frames = prepared.copy(), frames.copy()
        if isinstance(protocol, SeveralBuses):
            self._own["buses"], self._own["bus_of"] = len(protocol.legs), protocol.bus_of
            polls = protocol.spread(polls)
        self._polls = sent_array(polls)
        self._own["frames"] = data_at(self._frames)
        super().__init__(protocol, setup)
        self.codec = data_at(self._own)

    def _functions(self) -> tuple[int, int, Any]:
        return kernels.decode.address, self._commanding.address, (self._own, self._frames)

    @property
    def dialogue(self) -> MotorDialogue:
        """What the controller's end remembers."""
        return after(self._own, self._begun)

    @dialogue.setter
    def dialogue(self, dialogue: MotorDialogue) -> None:
        self._begun = dialogue
        remember(self._own, dialogue)

    def begin(self, number: int) -> Rows:
        """Return one poll a drive."""
        if len(self._polls):
            return self._polls
        into = np.empty(LEGS, FRAME)
        kernels.begin(self._own, number, data_at(into))
        return into
