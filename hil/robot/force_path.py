"""From the commanded forces to those in the legs: a pure delay, a hold over one period, a first-order lag."""

from collections import deque
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array

_NOTHING = np.zeros(6)
_NOTHING.flags.writeable = False


def decay(x: float) -> float:
    """Return exp(-x), x >= 0, by halving and squaring: the C library's differs from machine to machine."""
    halvings = 0
    while x > 0.0625:
        x *= 0.5
        halvings += 1
        if halvings > 60:
            return 0.0
    term = total = 1.0
    for k in range(1, 14):
        term *= -x / k
        total += term
    for _ in range(halvings):
        total *= total
    return total


class Segment(NamedTuple):
    """A time over which one command drives the force stage."""

    sent: int
    """The command, counted back from the last one sent: 0."""
    duration_s: float
    mean: float
    """Share of the gap between force and command that is left on average over the segment."""
    end: float
    """The share left at its end."""


class ForcePath:
    """The forces in the six legs, as far as the commands determine them.

    A command that is computed from the measurement of an instant t drives the force stage from
    t + transport on, until the next one takes over: with lag T, T df/dt = command - f.

    Mutable state: the force at the last instant of measurement and the commands that still act. `reset`
    clears both; `send` and `advance` go on.
    """

    def __init__(self, period_s: float, transport_s: float, lag_s: float) -> None:
        self.period_s = period_s
        self.transport_s = transport_s
        self.lag_s = lag_s
        self._whole = int(transport_s / period_s)
        self._period = self.segments(period_s, newest=1)
        self.reset()

    def reset(self) -> None:
        """No force, and none under way."""
        self.force = _NOTHING
        """(6,) N at the last instant of measurement."""
        self._sent = deque([_NOTHING] * (self._whole + 2), maxlen=self._whole + 2)

    def segments(self, duration_s: float, *, newest: int = 0) -> tuple[Segment, ...]:
        """Cut `duration_s` from an instant of measurement on by the commands that act.

        newest: how many commands have been sent since that instant. What is not sent yet is taken to be as
        the last one.
        """
        found = []
        begin, end = 0.0, self.transport_s - self._whole * self.period_s
        sent = self._whole + newest
        while begin < duration_s:
            if sent == 0 or end > duration_s:
                end = duration_s
            if end > begin:
                found.append(self._segment(sent, end - begin))
            begin, end, sent = end, end + self.period_s, max(sent - 1, 0)
        return tuple(found)

    def _segment(self, sent: int, duration_s: float) -> Segment:
        if self.lag_s == 0.0:
            return Segment(sent, duration_s, 0.0, 0.0)
        x = duration_s / self.lag_s
        left = decay(x)
        return Segment(sent, duration_s, (1.0 - left) / x, left)

    def send(self, command: Array) -> None:
        """Take note of the command (6,) N that answers the last measurement."""
        self._sent.appendleft(command)

    def advance(self, periods: int = 1) -> Array:
        """Go on to the next measurement, `periods` later; return the mean force (6,) N until then.

        Where periods were skipped, the drives went on with what they had.
        """
        total = np.zeros(6)
        for k in range(periods):
            if k:
                self.send(self._sent[0])
            means, self.force = self.follow(self._period)
            for segment, mean in zip(self._period, means, strict=True):
                total = total + segment.duration_s * mean
        return total / (periods * self.period_s)

    def follow(self, segments: tuple[Segment, ...]) -> tuple[list[Array], Array]:
        """Return the mean force (6,) N over each segment from the last measurement on, and the last force."""
        force, means = self.force, []
        for segment in segments:
            command = self._sent[segment.sent]
            gap = force - command
            means.append(command + gap * segment.mean)
            force = command + gap * segment.end
        return means, force
