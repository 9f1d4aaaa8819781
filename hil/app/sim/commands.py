"""Operator commands of a simulation, from a list or a file with lines `t_s word numbers`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from math import inf
from pathlib import Path

from drivers.errors import ConfigurationError
from hil.app.configuration.text_file import read_text
from hil.app.operate import REPEAT_S, REPEATED
from hil.loop.tick_row import NOTHING, Given
from hil.operate.commands import ParsedLine, parse
from hil.signals import Operator

LONGEST_S = 3600.0
"""Longest repetition of a command."""
LATEST_S = 1e9
"""Latest time of a command and longest run: thirty years."""
TimedCommand = tuple[float, str]
"""A command of the operator channel after simulated s since the first tick: (2.5, "speed 40").

A command that a client repeats ends with its duration: (2.5, "jog x 1 for 1.5").
"""


class CommandScript:
    """Operator commands to be given in each tick of a simulation.

    Mutable state: how many commands have been given, up to the last tick and up to the one before it; which
    were refused, with the last reason. Raises ConfigurationError for a command that the operator channel
    would refuse.
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
        """True if the script itself lets the platform move."""

    @property
    def left(self) -> int:
        """Number of commands not yet given; a repeated command counts once."""
        begun = {n for _, _, n in self._said[: self._given]}
        return len({n for _, _, n in self._said[self._given :]} - begun)

    @property
    def refused(self) -> int:
        """Number of refused commands; a repeated command counts once."""
        return len(self._refused)

    @property
    def over(self) -> bool:
        """True when all commands have been given."""
        return self._given == len(self._said)

    def silent(self, tick: int) -> float:
        """Number of ticks from `tick` on without a command, at least 1."""
        return inf if self.over else max(1, self._said[self._given][0] - tick)

    def __call__(self, tick: int) -> Given:
        """Commands that are due in a tick, in their order."""
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
        """Store the controller's answers, "" for accepted commands of the last tick; return new refusals.

        The answers are sorted by kind of command. A repeated command reports the same reason only once.
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
    """Read operator commands from a file, one per line: `t_s word numbers`; # begins a comment.

    Raises ConfigurationError for a line without a time, and for a command that the controller would refuse.
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
                f"{path}:{n}: {words[0]!r} is not a time, allowed: seconds, then a command, as `2.5 hold`"
            ) from None
        text = words[1] if len(words) > 1 else ""
        _said(t, text, 1.0, f"{path}:{n}")  # refuses an invalid command with its line
        found.append((t, text))
    return found


def _said(t: float, text: str, rate_Hz: float, where: str) -> list[tuple[int, ParsedLine]]:
    """A command with the ticks in which it is given: `jog x 1 for 1.5` is repeated as a client repeats it.

    Raises ConfigurationError, whose message begins with `where`.
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
    if said == ParsedLine():
        raise ConfigurationError(f"{where}: {text!r} is a query to a running controller, not available here")
    return [(math.ceil(at * rate_Hz - 1e-6), said) for at in times]
