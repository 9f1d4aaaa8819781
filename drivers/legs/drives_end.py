"""The own protocol's tables by address, for compiled passes, and its frames for callers in Python."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.pointed import data_at
from drivers.ends import CompiledEnd, Hearing
from drivers.legs import device_kernels as kernels
from drivers.legs.device_kernels import BUS, END, NO_SYNC
from drivers.legs.messages import CommandFrame
from drivers.protocol import ALL_LEGS, Frame

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


class LegsEnd(CompiledEnd):
    """Six drives of the own protocol. Mutable state: the Cycle of the present SYNC of each bus."""

    def __init__(self, codecs: Sequence[Tables], legs: Sequence[Sequence[int]] | None = None) -> None:
        """Take the tables of each bus and its legs; None: there is one bus, and its drives hear all of it."""
        first = codecs[0]
        there = [ALL_LEGS] if legs is None else legs
        self._keeps = codecs
        self._several = legs is not None
        self._buses = np.zeros(len(codecs), BUS)
        for k, (codec, own) in enumerate(zip(codecs, there, strict=True)):
            self._fill(self._buses[k], codec, own)
        end = np.zeros((), END)
        end["buses"], end["several"], end["bus"] = len(codecs), self._several, data_at(self._buses)
        first.fill_end(end)
        for bus, own in enumerate(there):
            end["home"][list(own)] = bus
        super().__init__(end, kernels.parse, kernels.answer, kernels.report)

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

    def reason(self, why: int, counter: int, _number: float, frame: Frame) -> str:
        """Return why a SYNC or a command is rejected."""
        if why == kernels.LENGTH:
            return f"command of {len(frame.data)} bytes"
        if why == kernels.NOT_PRESENT:
            return f"command {counter} while the present SYNC is {self._buses['present'][frame.bus]}"
        return _UNTRUSTED[why]

    def hearing(self, wanted: Sequence[int]) -> Hearing:
        """Return the controller's end, whose feedbacks have these identifiers, leg order."""
        return Hearing(kernels.fresh.address, kernels.addressed.address, self.context, tuple(wanted), self)
