"""Faults between drives and bus: frames that are lost, delayed, corrupted or added."""

from collections.abc import Sequence
from operator import itemgetter

from drivers.family import Family
from drivers.protocol import Frame, Received
from plant_fmu.drives.codec import SYNC, DrivesEnd
from plant_fmu.faults.foreign_controller import forged
from plant_fmu.faults.kinds import FramesForgedCommand
from plant_fmu.faults.plan import Schedule

_TIME = itemgetter(0)
AHEAD_NS = 2_000_000
"""Largest time by which a frame of an extra node is queued in advance."""
Timed = tuple[int, Frame]


class Gateway:
    """Applies the faults of a schedule to passing frames, and adds the frames of extra nodes.

    A returned frame may have a later time: it enters the bus then. Mutable state: frames to deliver later,
    frames of extra nodes to put on the bus, the time of the last step, the codec's state at the drives' end.
    """

    def __init__(self, schedule: Schedule, protocol: Family, end: DrivesEnd, t0_ns: int) -> None:
        """Create a gateway; `end` is a drives' end that no other object uses, powered up."""
        self._schedule = schedule
        self._protocol = protocol
        self._end = end
        self._later: list[Timed] = []
        self._added: list[Timed] = []
        self._until_ns = t0_ns

    def hear(self, received: Sequence[Received], until_ns: int) -> list[Received]:
        """Frames that reach the drives by `until_ns`, in time order: passed, delayed or forged ones."""
        heard = self._later
        for t_ns, frame in received:
            for at_ns, arriving, foreign in self._schedule.carry(t_ns, frame, to_drives=True):
                heard.append((at_ns, arriving))
                if foreign:
                    self._added.append((at_ns, arriving))
                self._forge(at_ns, arriving, heard)
        ahead_ns = min(until_ns - self._until_ns, AHEAD_NS)
        self._until_ns = until_ns
        self._send(until_ns + ahead_ns, heard)
        heard.sort(key=_TIME)
        self._later = [entry for entry in heard if entry[0] > until_ns]
        return [Received(*entry) for entry in heard[: len(heard) - len(self._later)]]

    def _forge(self, t_ns: int, frame: Frame, heard: list[Timed]) -> None:
        """Add a forged command after a SYNC or after a drive's poll, ahead of the controller's command."""
        protocol, addressed = self._protocol, self._protocol.addressed
        for message in self._end.hear(frame):
            if message["kind"] == SYNC:
                for fault in (own.fault for own in self._schedule.active(t_ns)):
                    if isinstance(fault, FramesForgedCommand):
                        asked = set(addressed(frame))  # all drives on the bus of a SYNC, or the polled one
                        frames = forged(protocol, fault.force_N, int(message["counter"]))
                        self._add(t_ns, [each for each in frames if asked & set(addressed(each))], heard)

    def _send(self, until_ns: int, heard: list[Timed]) -> None:
        for fault, own in self._schedule.senders():
            period_ns = 1e9 / fault.rate_Hz
            while (t_ns := own.start_ns + round(own.sent * period_ns)) <= until_ns and t_ns < own.stop_ns:
                self._add(t_ns, fault.frames(self._protocol, own.sent), heard)
                own.sent += 1

    def _add(self, t_ns: int, frames: Sequence[Frame], heard: list[Timed]) -> None:
        timed = [(t_ns, frame) for frame in frames]
        heard += timed
        self._added += timed

    def send(self, sent: Sequence[Timed]) -> list[Timed]:
        """Frames for the bus in time order: those of the drives, after their faults, and of extra nodes."""
        out = [
            (at_ns, arriving)
            for t_ns, frame in sent
            for at_ns, arriving, _ in self._schedule.carry(t_ns, frame, to_drives=False)
        ]
        out += self._added
        self._added = []
        out.sort(key=_TIME)
        return out
