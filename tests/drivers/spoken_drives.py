"""A family of motor drives whose frames are words: each says what a test writes, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.arrays import array_at
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import data_at, of_python
from drivers.frame_array import FRAME, received_array, sent_frames
from drivers.motor_kernels import HEARD
from drivers.motors import NO_BRAKE, Exchange, MotorProtocol
from drivers.protocol import ALWAYS, DriveSetup, Frame, Received, Traits
from drivers.signals import DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from hil.contracts.by_value import Remembered
from tests.drivers.motor_families import UNLIKE, Heard, Motors, last_tick

SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
SINCE_NS = 1_000


class SpokenProtocol(MotorProtocol):
    """Frames are numbers of what they say."""

    number_at = 0, 0
    torque_limit = 2.0

    def __init__(
        self,
        exchanges: int | Sequence[int] = 0,
        *,
        reports: bool = True,
        unasked_s: float = 0.0,
        transmission: Any = UNLIKE,
    ) -> None:
        address, self._keeps = of_python(self._hear, INTEGER, INTEGER, INTEGER)
        self.ear: Any = SimpleNamespace(address=address)
        super().__init__(transmission, (0,) * 6, (1, 32, 2.0))
        self._given = reports, unasked_s
        self.counts = (exchanges,) * 6 if isinstance(exchanges, int) else tuple(exchanges)
        self.words: list[Heard | None] = []

    @cached_property
    def traits(self) -> Traits:
        return self.traits_of(
            (),
            family="spoken",
            emergency_stop=(),
            command_delay_ticks=1,
            set_up_frames=1,
            shares_identifiers=True,
            dangers=(NO_BRAKE, "nobody watches"),
            power_told="feedback" if self._given[0] else "never",
            unasked_s=self._given[1],
        )

    def _heard(self, frame: Frame) -> Any:
        into = np.zeros((), HEARD)
        array = received_array([Received(0, frame)])
        return into if self._hear(0, data_at(array), data_at(into)) else None

    def _hear(self, _ear: int, frame: int, into: int) -> int:
        heard = self.words[sent_frames(array_at(frame, 1, FRAME))[0].id]
        if heard is not None:
            told = (
                heard.broken,
                heard.foreign,
                heard.motion,
                heard.feedback,
                heard.torque,
                heard.power,
                heard.answer,
            )
            has = sum(1 << k for k, bit in enumerate(told) if bit is not None and bit is not False)
            motion, answer = heard.motion or (0.0, 0.0), heard.answer or (0, 0.0)
            array_at(into, 1, HEARD)[0] = (
                heard.leg, has, *motion, heard.torque or 0.0, heard.power or 0, heard.fault, *answer,
            )  # fmt: skip
        return int(heard is not None)

    def requests(self, _watchdog_s: float) -> Any:
        """A number for each row: IDLE to DRIVE."""
        return [[Frame(0x100 + leg, bytes((row,))) for leg in range(6)] for row in range(4)]

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        return tuple(
            tuple(
                Exchange(f"register {k}", 10 + k, (Frame(0x200 + 16 * leg + k, b""),), 0.1 + k + 10 * leg)
                for k in range(count)
            )
            for leg, count in enumerate(self.counts)
        )

    def fault_text(self, code: int) -> str:
        return str(code)

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        return (frame.id - 0x100,) if 0x100 <= frame.id < 0x106 else ()


class Spoken(Motors):
    """Such a family by value."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(SpokenProtocol(*given, **named))

    def word(self, heard: Heard | None) -> Frame:
        """Return the frame that says this."""
        self.words.append(heard)
        return Frame(len(self.words) - 1, b"")

    def begun(self, **fields: Any) -> Remembered:
        """Return the dialogue of drives that are heard and disabled, with other fields."""
        values: dict[str, Any] = {
            "done": tuple(1 + n for n in self.counts),
            "power": (int(DriveState.OFF),) * 6,
        }
        return self.start(SETUP)._replace(**values | fields)

    def told(
        self,
        *words: Heard | tuple[int, Heard] | None,
        last: Record | None = None,
        number: int = 13,
        **fields: Any,
    ) -> tuple[Any, Remembered]:
        """Return a tick and the dialogue after these words; a word with a time comes then, others in time."""
        timed: list[Any] = [each if type(each) is tuple else (SINCE_NS, each) for each in words]
        run = received_array([Received(t_ns, self.word(heard)) for t_ns, heard in timed])
        tick = new_record()
        tick["tick"] = number
        for name in ("blind", "rejected", "doubled", "foreign"):
            tick[name] = 9
        since_ns = SINCE_NS if words else ALWAYS
        return tick, self.decode(
            self.begun(**fields), run, last_tick() if last is None else last, tick, since_ns
        )


def feedback(leg: int, turns: float = 0.5, speed: float = 0.0, **more: Any) -> Heard:
    """Return an answer to the poll: of a disabled drive where nothing else is given."""
    values: dict[str, Any] = {"motion": (turns, speed), "power": int(DriveState.OFF)}
    return Heard(leg, feedback=True, **values | more)


RUNNING: dict[str, Any] = {
    "mode": int(DriveMode.RUN),
    "power": (int(DriveState.RUN),) * 6,
    "ran": (True,) * 6,
}
"""Fields of a dialogue whose drives are enabled, as they are asked to be."""
