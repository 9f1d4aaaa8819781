"""Between the drives and the bus: frames that are lost, late, damaged or added on their way."""

from collections.abc import Sequence
from operator import itemgetter

from drivers.family import Family
from drivers.protocol import Frame, Received
from plant_fmu.drives.ends import SYNC, DrivesEnd
from plant_fmu.faults.kinds import FramesForgedCommand
from plant_fmu.faults.plan import Schedule
from plant_fmu.faults.stranger import forged

_TIME = itemgetter(0)
AHEAD_NS = 2_000_000
"""What others send is put on the bus at most so long before its time."""
Timed = tuple[int, Frame]


class Gateway:
    """Passes frames on as the faults of a schedule have it, and adds those of nodes that should not be there.

    A frame may leave it with a time to come: it is not on the bus before.
    Mutable state: frames that are to be heard later, frames of others that are to be put on the bus, the time
    of the last step, what the protocol remembers at the drives' end.
    """

    def __init__(self, schedule: Schedule, protocol: Family, end: DrivesEnd, t0_ns: int) -> None:
        """Take the schedule, and the protocol with a drives' end of its own, powered up."""
        self._schedule = schedule
        self._protocol = protocol
        self._end = end
        self._later: list[Timed] = []
        self._added: list[Timed] = []
        self._until_ns = t0_ns

    def hear(self, received: Sequence[Received], until_ns: int) -> list[Received]:
        """Return what reaches the drives by `until_ns`, in the order of time."""
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
        """Answer a SYNC, or the poll of a drive, before its controller sends another command."""
        protocol, addressed = self._protocol, self._protocol.addressed
        for message in self._end.hear(frame):
            if message["kind"] == SYNC:
                for fault in (own.fault for own in self._schedule.active(t_ns)):
                    if isinstance(fault, FramesForgedCommand):
                        asked = set(addressed(frame))  # all on the bus of a SYNC, or the one that is polled
                        frames = forged(protocol, fault.force_N, int(message["counter"]))
                        self._add(t_ns, [each for each in frames if asked & set(addressed(each))], heard)

    def _send(self, until_ns: int, heard: list[Timed]) -> None:
        """Let others send what they send by `until_ns`."""
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
        """Return what goes on the bus: what is left of what the drives have sent, and what others send."""
        out = [
            (at_ns, arriving)
            for t_ns, frame in sent
            for at_ns, arriving, _ in self._schedule.carry(t_ns, frame, to_drives=False)
        ]
        out += self._added
        self._added = []
        out.sort(key=_TIME)
        return out
