"""The controller's end of CiA 402 drives: the kernels' record with the dialogue, and Python's part of it."""

from collections.abc import Sequence
from typing import Any

from drivers.arrays import Rows
from drivers.cia402 import kernels
from drivers.cia402 import objects as o
from drivers.cia402.set_up import Cia402Dialogue, Slope, advanced, answered
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import data_at, of_python
from drivers.controller_end import ControllerEnd, array_at, tick_at
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.protocol import DriveProtocol, DriveSetup, Frame
from drivers.several_buses import SeveralBuses
from drivers.signals import DriveState
from drivers.tick_columns import Record

_SIX = ("at", "asked", "tries", "states", "rate", "owed", "missed")
_ONE = ("mode", "stopped", "resets")
_SLOPES = ("mean", "T", "latched_ns", "length")


class Drives:
    """The record of `drivers.cia402.kernels`, and what of the dialogue is decided in Python.

    Mutable state: the dialogue.
    """

    def __init__(self, tables: Record, heartbeats: Sequence[Frame]) -> None:
        """Take the family's record, which is copied, and the frames of our heartbeat."""
        self.record, self._beats = tables.copy(), sent_array(heartbeats)
        news, self._keeps = of_python(self._news, INTEGER, INTEGER, INTEGER)
        self.record["news"], self.record["beats"] = news, data_at(self._beats)
        self.record["beat_frames"] = len(self._beats)

    @property
    def dialogue(self) -> Cia402Dialogue:
        """What the controller's end remembers."""
        c = self.record
        values: dict[str, Any] = {name: tuple(c[name].tolist()) for name in _SIX}
        values |= {name: int(c[name]) for name in _ONE}
        columns = zip(*(c[name].tolist() for name in _SLOPES), c["has_length"].tolist(), strict=True)
        slopes = tuple(Slope(d, T, ns, there if has else None) for d, T, ns, there, has in columns)
        return self._begun._replace(slopes=slopes, **values)

    @dialogue.setter
    def dialogue(self, dialogue: Cia402Dialogue) -> None:
        self._begun, c = dialogue, self.record
        for name in (*_SIX, *_ONE, "beat"):
            c[name] = getattr(dialogue, name)
        c["steps"], c["period_s"] = list(map(len, dialogue.plans)), 1.0 / dialogue.setup.rate_Hz
        for leg, (d, T, latched_ns, length) in enumerate(dialogue.slopes):
            c["mean"][leg], c["T"][leg], c["latched_ns"][leg] = d, T, latched_ns
            c["length"][leg], c["has_length"][leg] = length or 0.0, length is not None

    def _news(self, leg: int, frame: int, at: int) -> int:
        """Take an SDO answer, or the TPDO of a drive that is not set up; return whether it is believed."""
        dialogue, tick = self.dialogue, tick_at(at)
        if not frame:
            step = dialogue.step(leg)
            if step is not None and step.kind == "nmt":
                self.dialogue = advanced(dialogue, leg)
            return 1
        data = sent_frames(array_at(frame, 1, FRAME))[0].data
        following, reply = answered(dialogue, leg, data, int(tick["tick"])), o.read_reply(data)
        if reply is None or following is None:
            return 0
        self.dialogue, faults = following, tick["drive_fault"]
        if reply.key == o.ERROR_CODE and tick["drive_state"][leg] == DriveState.FAULT:
            faults[leg] = faults[leg] or (0 if reply.abort else reply.value)
        return 1


class Cia402End(ControllerEnd):
    """The controller's end, compiled. The record has the dialogue."""

    def __init__(
        self, protocol: DriveProtocol, setup: DriveSetup, tables: Record, sync: Frame, heartbeat: Frame
    ) -> None:
        """Take the family's tables, its SYNC and its heartbeat."""
        several = protocol if isinstance(protocol, SeveralBuses) else None
        to_all = several.spread if several else tuple
        self._drives, self._sync = Drives(tables, to_all([heartbeat])), sent_array(to_all([sync]))
        if several:
            self._drives.record["buses"], self._drives.record["bus_of"] = len(several.legs), several.bus_of
        super().__init__(protocol, setup)
        self.codec = data_at(self._drives.record)

    def _functions(self) -> tuple[int, int, Any]:
        return kernels.decode.address, kernels.command.address, self._drives

    @property
    def dialogue(self) -> Cia402Dialogue:
        """What the controller's end remembers."""
        return self._drives.dialogue

    @dialogue.setter
    def dialogue(self, dialogue: Cia402Dialogue) -> None:
        self._drives.dialogue = dialogue

    def begin(self, _number: int) -> Rows:
        """Return SYNC."""
        return self._sync
