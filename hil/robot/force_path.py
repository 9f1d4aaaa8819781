"""From commanded to actual leg forces: a pure delay, a hold over one period, a first-order lag."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, VECTOR, helper, kernel, record
from drivers.compiled.pointed import data_at, reals_at, record_at

SEGMENT = np.dtype([("sent", "<i8"), ("duration_s", "<f8"), ("mean", "<f8"), ("end", "<f8")])
"""Layout of a `Segment` for compiled code."""
FORCE_PATH = np.dtype(
    [
        ("period_s", "<f8"),
        ("segments", "<i8"),
        ("count", "<i8"),
        ("sent", "<i8"),
        ("slots", "<i8"),
        ("force", "<f8", 6),
    ]
)
"""Layout of a ForcePath for compiled code: address and number of the segments of a period; address of the
commands that still act, (slots, 6) N, newest first; predicted force (6,) N."""
path_at = record_at(record(FORCE_PATH))
segment_at = record_at(record(SEGMENT))
_SEGMENT_BYTES = SEGMENT.itemsize


def decay(x: float) -> float:
    """exp(-x), x >= 0, by halving and squaring: the C library rounds differently from machine to machine."""
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
    """A time interval in which one command (6,) N drives the force loops of the drives."""

    sent: int
    """Index of the command; 0 is the newest."""
    duration_s: float
    mean: float
    """Gap between force and command, mean over the segment, as a share of the gap at its start."""
    end: float
    """Gap at the end of the segment as a share of the gap at its start."""


def as_records(segments: Sequence[Segment]) -> Rows:
    """Segments as an array (n,) of SEGMENT records, which compiled code reads."""
    return np.array(list(segments), SEGMENT)


@helper
def follow(path: Any, address: int, force: Array, mean: Array) -> float:
    """Advance `force` (6,) N over the segment at `address`; fill `mean` (6,) N; return the duration, s."""
    segment = segment_at(address)
    command = reals_at(path.sent + 48 * segment.sent, 6)
    for i in range(6):
        gap = force[i] - command[i]
        mean[i] = command[i] + gap * segment.mean
        force[i] = command[i] + gap * segment.end
    return float(segment.duration_s)


@helper
def send(path: Any, command: Array) -> None:
    """Insert leg forces (6,) N as the newest command; the oldest command drops out."""
    sent = reals_at(path.sent, 6 * path.slots)
    for k in range(6 * (path.slots - 1)):
        place = 6 * path.slots - 1 - k
        sent[place] = sent[place - 6]
    for i in range(6):
        sent[i] = command[i]


@helper
def advance(path: Any, periods: int, tau: Array) -> None:
    """Advance by `periods`; fill tau (6,) N with the mean leg forces: `ForcePath.advance`, compiled."""
    mean = np.empty(6)
    tau[:] = 0.0
    for k in range(periods):
        if k:
            send(path, reals_at(path.sent, 6))
        for n in range(path.count):
            duration_s = follow(path, path.segments + _SEGMENT_BYTES * n, path.force, mean)
            for i in range(6):
                tau[i] += duration_s * mean[i]
    for i in range(6):
        tau[i] /= periods * path.period_s


_send = kernel(record(FORCE_PATH), VECTOR)(send)
_advance = kernel(record(FORCE_PATH), INTEGER, OUT_VECTOR)(advance)


class ForcePath:
    """Prediction of the actual leg forces from the commands sent.

    A command computed from the measurement at t drives the force loop from t + transport on, until the
    next command replaces it. With lag T, the force f obeys T df/dt = command - f.

    Mutable state: the force at the last instant of measurement and the commands that still act, in `record`
    and the arrays that it points to. `reset` clears both; `send` and `advance` change them.
    """

    def __init__(self, period_s: float, transport_s: float, lag_s: float) -> None:
        self.period_s = period_s
        self.transport_s = transport_s
        self.lag_s = lag_s
        self._whole = int(transport_s / period_s)
        self._period = as_records(self.segments(period_s, newest=1))
        self._sent = np.zeros((self._whole + 2, 6))
        self.record = np.zeros((), FORCE_PATH)
        for name, value in {
            "period_s": period_s,
            "segments": data_at(self._period),
            "count": len(self._period),
            "sent": data_at(self._sent),
            "slots": len(self._sent),
        }.items():
            self.record[name] = value

    @property
    def force(self) -> Array:
        """Predicted leg forces (6,) N at the last instant of measurement."""
        return self.record["force"].copy()

    def reset(self) -> None:
        """Set the predicted force and all commands to zero."""
        self.record["force"] = 0.0
        self._sent[:] = 0.0

    def segments(self, duration_s: float, *, newest: int = 0) -> tuple[Segment, ...]:
        """Divide `duration_s` after an instant of measurement into segments of one command each.

        newest: number of commands sent since that instant. Where the next command is not sent yet, the newest
        one is assumed to continue.
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
        """Store the leg forces (6,) N that were computed from the last measurement and sent."""
        _send(self.record, np.ascontiguousarray(command, np.float64))

    def advance(self, periods: int = 1) -> Array:
        """Advance to the next measurement, `periods` later, and return the mean force (6,) N until then.

        If periods were skipped, the drives continued with the newest command.
        """
        mean = np.empty(6)
        _advance(self.record, periods, mean)
        return mean
