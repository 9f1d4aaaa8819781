"""The operator's commands of a simulation: a list, or a file of lines `t_s word numbers`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from math import inf
from pathlib import Path

from drivers.errors import ConfigurationError
from hil.app.configuration.text_file import read_text
from hil.app.operate import REPEAT_S, REPEATED
from hil.loop.tick_row import NOTHING, Given
from hil.operate.words import Said, parse
from hil.signals import Operator

LONGEST_S = 3600.0
"""A word is repeated for so long at most."""
LATEST_S = 1e9
"""No word comes later, and no run is longer: thirty years."""
TimedCommand = tuple[float, str]
"""Simulated s since the first tick, and a word of the operator channel, as (2.5, "speed 40"); a word that a
client repeats has its length behind it, as (2.5, "jog x 1 for 1.5")."""


class CommandScript:
    """What the operator says in each tick of a simulation.

    Mutable state: how many words have been given, before the last tick, too; which commands were refused, and
    why each was in its last tick. Raises ConfigurationError for a command that the
    operator channel would not take.
    """

    def __init__(self, commands: Iterable[TimedCommand], rate_Hz: float, source: str = "commands") -> None:
        said = [
            (tick, each, n)
            for n, (t, text) in enumerate(commands, 1)
            for tick, each in _said(t, text, rate_Hz, f"{source}: command {n}")
        ]
        self._said = sorted(said, key=lambda each: each[0])
        self._before = self._given = 0
        self._refused: set[int] = set()
        self._why: dict[int, str] = {}
        self.arms = any(each.operator is Operator.ENGAGE for _, each, _ in said)
        """Whether the script itself lets the platform move."""

    @property
    def left(self) -> int:
        """How many commands have not been given at all; one that is repeated is one."""
        begun = {n for _, _, n in self._said[: self._given]}
        return len({n for _, _, n in self._said[self._given :]} - begun)

    @property
    def refused(self) -> int:
        """How many commands were refused, a word of one that is repeated at least."""
        return len(self._refused)

    @property
    def over(self) -> bool:
        """Whether all has been said."""
        return self._given == len(self._said)

    def silent(self, tick: int) -> float:
        """Return for how many ticks, from one on that has been asked for, nothing is said; 1 at least."""
        return inf if self.over else max(1, self._said[self._given][0] - tick)

    def __call__(self, tick: int) -> Given:
        """Return the commands of a tick, in their order."""
        self._before = first = self._given
        while self._given < len(self._said) and self._said[self._given][0] <= tick:
            self._given += 1
        if first == self._given:
            return NOTHING
        said = [each for _, each, _ in self._said[first : self._given]]
        return Given(
            tuple(each.operator for each in said if each.operator is not None),
            tuple(each.order for each in said if each.order is not None),
            tuple(each.setpoint for each in said if each.setpoint is not None),
        )

    def answered(self, operator: Sequence[str], orders: Sequence[str], setpoints: Sequence[str]) -> list[str]:
        """Take why each word of the last tick was refused, empty where it was taken; return what is news.

        By their kinds, in their order. What a repeated command was refused for in its last tick is no news.
        """
        said = self._said[self._before : self._given]
        own = sum(each.setpoint is not None for _, each, _ in said)
        whys = iter(operator), iter(orders), iter(setpoints[len(setpoints) - own :])
        news = []
        for _, each, n in said:
            why = next(whys[0 if each.operator is not None else 1 if each.order is not None else 2])
            if why:
                self._refused.add(n)
                if why != self._why.get(n):
                    news.append(why)
            self._why[n] = why
        return news


def read_commands(path: Path) -> list[TimedCommand]:
    """Return the commands of a file: a line each, `t_s word numbers`; # begins a remark.

    Raises ConfigurationError for a line without a time, and for a command that no controller would take.
    """
    found = []
    for n, line in enumerate(read_text(path).removeprefix("\ufeff").splitlines(), 1):
        words = line.partition("#")[0].split(maxsplit=1)
        if not words:
            continue
        try:
            t = float(words[0])
        except ValueError:
            raise ConfigurationError(
                f"{path}:{n}: {words[0]!r} is no time, allowed: seconds, then a word, as `2.5 hold`"
            ) from None
        text = words[1] if len(words) > 1 else ""
        _said(t, text, 1.0, f"{path}:{n}")  # refuses it with its line
        found.append((t, text))
    return found


def _said(t: float, text: str, rate_Hz: float, where: str) -> list[tuple[int, Said]]:
    """Return what a command says, with its ticks: `jog x 1 for 1.5` is said as often as a client says it.

    Raises ConfigurationError, which begins with `where`.
    """
    word, repeats, length = text.partition(" for ")
    times = [t]
    if repeats and text.split(maxsplit=1)[0] in REPEATED:
        try:
            seconds = float(length)
        except ValueError:
            seconds = math.nan
        if not 0.0 < seconds <= LONGEST_S:
            raise ConfigurationError(f"{where}: for {length.strip()!r}, allowed: seconds up to {LONGEST_S:g}")
        times = [t + k * REPEAT_S for k in range(math.ceil(seconds / REPEAT_S - 1e-9))]
    else:
        word = text
    if not 0.0 <= t <= LATEST_S:
        raise ConfigurationError(f"{where}: time {t!r}, allowed: seconds from 0 to {LATEST_S:g}")
    try:
        said = parse(word)
    except ValueError as error:
        raise ConfigurationError(f"{where}: {error}") from None
    if said == Said():
        raise ConfigurationError(f"{where}: {text!r} asks a running controller, none is here")
    return [(math.ceil(at * rate_Hz - 1e-6), said) for at in times]
