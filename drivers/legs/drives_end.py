"""The own protocol's tables by address, for compiled passes, and its frames for callers in Python."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.pointed import FAILED, data_at
from drivers.ends import MESSAGE, READING, SYNC, Hearing
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.legs import device_kernels as kernels
from drivers.legs.device_kernels import BUS, END, NO_SYNC
from drivers.legs.messages import CommandFrame
from drivers.protocol import (
    ALL_LEGS,
    DeviceCommand,
    DeviceMessage,
    Frame,
    Rejected,
    Status,
    Sync,
)
from drivers.signals import LEGS

_UNTRUSTED = {
    kernels.SYNC_BROKEN: "length or CRC of SYNC",
    kernels.SYNC_REPEATED: "repeated SYNC",
    kernels.BROKEN: "CRC of a command",
    kernels.UNKNOWN_MODE: "unknown mode",
    kernels.UNFIT: "force not finite or out of range",
}


class Tables(Protocol):
    """What the end of the drives of a bus is made from."""

    @property
    def commands(self) -> tuple[Ints, Array, int, tuple[CommandFrame, ...]]:
        """Form and range of the commands, the bits of a Cycle that they carry, and the frames."""

    def fill_end(self, end: Any) -> None:
        """Fill in what all buses have in common; see `drivers.legs.device_kernels.END`."""


class LegsEnd:
    """Six drives of the own protocol. Mutable state: the Cycle of the present SYNC of each bus."""

    parse = kernels.parse.address
    answer = kernels.answer.address
    report = kernels.report.address

    def __init__(self, codecs: Sequence[Tables], legs: Sequence[Sequence[int]] | None = None) -> None:
        """Take the tables of each bus and its legs; None: there is one bus, and its drives hear all of it."""
        first = codecs[0]
        there = [ALL_LEGS] if legs is None else legs
        self._keeps = codecs
        self._several = legs is not None
        self._buses = np.zeros(len(codecs), BUS)
        for k, (codec, own) in enumerate(zip(codecs, there, strict=True)):
            self._fill(self._buses[k], codec, own)
        self._end = end = np.zeros((), END)
        end["buses"], end["several"], end["bus"] = len(codecs), self._several, data_at(self._buses)
        first.fill_end(end)
        for bus, own in enumerate(there):
            end["home"][list(own)] = bus
        self.context = data_at(end)
        self._messages, self._reading = np.zeros(1, MESSAGE), np.zeros((), READING)
        self._frames, self._legs = np.zeros(LEGS, FRAME), np.zeros(LEGS, np.int64)

    @staticmethod
    def _fill(bus: Any, codec: Tables, legs: Sequence[int]) -> None:
        form, scale, mask, commands = codec.commands
        bus["present"], bus["legs"], bus["leg"][: len(legs)] = NO_SYNC, len(legs), legs
        bus["form"], bus["form_size"], bus["scale"], bus["mask"] = (
            data_at(form),
            form.size,
            data_at(scale),
            mask,
        )
        bus["commands"] = len(commands)
        for k, (of, slots, register) in enumerate(commands):
            bus["id"][k], bus["size"][k], bus["register"][k] = of.id, of.length, register
            bus["first"][k], bus["forces"][k] = slots[0], len(slots)

    @property
    def memory(self) -> Any:
        """The Cycle of the present SYNC, of several buses each."""
        present: list[int] = self._buses["present"].tolist()
        return tuple(present) if self._several else present[0]

    @memory.setter
    def memory(self, memory: Any) -> None:
        self._buses["present"] = memory

    # for callers in Python

    def heard(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Return what a SYNC or a command tells the drives."""
        array = sent_array([frame])
        if kernels.parse(self._end, array, self._messages) != 1:
            return ()
        kind, mode, counter, count, legs, force = self._messages[0].tolist()
        legs = tuple(legs[:count])
        if kind == SYNC:
            return (Sync(counter, legs),)
        if count:
            return (DeviceCommand(legs, mode, np.array(force[:count]), counter),)
        if mode == kernels.LENGTH:
            return (Rejected(f"command of {len(frame.data)} bytes"),)
        if mode == kernels.NOT_PRESENT:
            present = int(self._buses["present"][frame.bus])
            return (Rejected(f"command {counter} while the present SYNC is {present}"),)
        return (Rejected(_UNTRUSTED[mode]),)

    def answers(
        self, sync: Sync, length: Array, rate: Array, force: Array, state: Ints
    ) -> list[tuple[int, Frame]] | None:
        """Return the feedbacks to a SYNC, each with its leg; None where a value is not a number."""
        self._reading[()] = length, rate, force, state, 0
        message: Any = self._messages[0]
        message["counter"], message["count"] = sync.counter, len(sync.legs)
        message["legs"][: len(sync.legs)] = sync.legs
        count = kernels.answer(self._end, self._messages, self._reading, self._frames, self._legs)
        if count == FAILED:
            return None
        return list(zip(self._legs[:count].tolist(), sent_frames(self._frames[:count]), strict=True))

    def reports(self, status: Status) -> tuple[Frame, ...] | None:
        """Return a drive's status; None where no CONFIG could have set its watchdog."""
        leg, state, fault, holds, due = status
        watchdog_ns, reaction = (-1, 0) if holds is None else (round(holds.watchdog_s * 1e9), holds.reaction)
        given = (leg, state, fault, watchdog_ns, int(reaction), int(due))
        return sent_frames(self._frames[:1]) if kernels.report(self._end, *given, self._frames) == 1 else None

    def hearing(self, wanted: Sequence[int]) -> Hearing:
        """Return the controller's end, whose feedbacks have these identifiers, leg order."""
        return Hearing(kernels.fresh.address, kernels.addressed.address, self.context, tuple(wanted), self)
