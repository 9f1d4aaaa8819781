"""The faults of one run, and which of them are present when."""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.arrays import Array
from drivers.protocol import Frame
from plant_fmu.faults.fault import NEVER_NS, Fault, Passage, Passed, Place, Present
from plant_fmu.faults.kinds import FramesForgedCommand, SenderFault
from plant_fmu.plant import Truth

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


class FaultPlan:
    """The faults of one run. `seed` varies the chance of all of them; gravity (3,) m/s^2, base frame."""

    def __init__(
        self, faults: Sequence[Fault] = (), seed: int = 0, gravity: Sequence[float] = STANDARD_GRAVITY
    ) -> None:
        self.faults = tuple(faults)
        self.seed = seed
        self.gravity = np.array(gravity, float)
        frames = (Passage, SenderFault, FramesForgedCommand)
        self.touches_frames = any(isinstance(fault, frames) for fault in self.faults)
        """Whether frames are changed on their way, or added."""


class Schedule:
    """When the faults of a plan begin and end in one run.

    Mutable state: when each fault begins, as far as that is known; its chance, and the frames it has seen;
    the faults that were present when last asked, and from when until when these are the ones.
    """

    def __init__(self, plan: FaultPlan, t0_ns: int) -> None:
        self._plan = plan
        self._start_ns = [
            t0_ns + round(fault.at_s * 1e9) if fault.mode is None else NEVER_NS for fault in plan.faults
        ]
        self._passed = [
            Passed(np.random.default_rng((plan.seed, getattr(fault, "seed", 0), n)))
            for n, fault in enumerate(plan.faults)
        ]
        self._present: tuple[tuple[int, Fault], ...] = ()
        self._from_ns = self._until_ns = 0

    def starts_ns(self, fault: Fault) -> int:
        """Return when a fault of the plan begins; NEVER_NS where it will not, as things stand."""
        return self._start_ns[self._plan.faults.index(fault)]

    def _starts(self) -> Iterator[tuple[Fault, int]]:
        return zip(self._plan.faults, self._start_ns, strict=True)

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults whose mode has not been reached."""
        return tuple(fault for fault, at in self._starts() if at == NEVER_NS)

    def begun(self, t_ns: int) -> tuple[Fault, ...]:
        """Return the faults that have begun by an instant."""
        return tuple(fault for fault, at in self._starts() if at <= t_ns)

    def reached(self, mode: str, t_ns: int) -> bool:
        """Let the time of the faults count that wait for this mode; tell whether there are any."""
        found = False
        for n, fault in enumerate(self._plan.faults):
            if fault.mode == mode and self._start_ns[n] == NEVER_NS:
                self._start_ns[n] = t_ns + round(fault.at_s * 1e9)
                found = True
        self._from_ns = self._until_ns = 0
        return found

    def edges_ns(self, since_ns: int) -> list[int]:
        """Return the instants from `since_ns` on at which a fault begins or ends, rising."""
        edges = {edge for fault, at in self._starts() for edge in (at, at + fault.lasts_ns)}
        return sorted(edge for edge in edges if since_ns <= edge < NEVER_NS)

    def active(self, t_ns: int) -> tuple[tuple[int, Fault], ...]:
        """Return the faults that are present at an instant, each with its number."""
        if not self._from_ns <= t_ns < self._until_ns:
            spans = [(at, at + fault.lasts_ns) for fault, at in self._starts()]
            edges = [edge for span in spans for edge in span]
            self._from_ns = max((edge for edge in edges if edge <= t_ns), default=t_ns)
            self._until_ns = min((edge for edge in edges if edge > t_ns), default=NEVER_NS)
            self._present = tuple(
                (n, self._plan.faults[n]) for n, (begin, end) in enumerate(spans) if begin <= t_ns < end
            )
        return self._present

    def present(self, t_ns: int) -> Present:
        """Return the faults of drives and plant at this instant."""
        present = Present()
        for n, fault in self.active(t_ns):
            present.since_ns, present.generator = self._start_ns[n], self._passed[n].generator
            fault.act(present)
        return present

    def carry(self, t_ns: int, frame: Frame, *, to_drives: bool) -> list[tuple[int, Frame, bool]]:
        """Return when and as what a frame arrives, and whether it is one that nobody of ours has sent."""
        arriving = [(t_ns, frame, False)]
        for n, fault in self.active(t_ns):
            if not isinstance(fault, Passage):
                continue
            place: Place = (to_drives, frame.bus, frame.id)
            arriving = [
                (*each, foreign or (k > 0 and fault.adds))
                for at, before, foreign in arriving
                for k, each in enumerate(
                    fault.carry(at, before, place, self._passed[n])
                    if fault.concerns(before)
                    else [(at, before)]
                )
            ]
        return arriving

    def senders(self) -> Iterator[tuple[int, SenderFault, int, int]]:
        """Yield the nodes that should not be there: number, fault, from and until when they send, ns."""
        for n, (fault, at) in enumerate(self._starts()):
            if isinstance(fault, SenderFault) and at < NEVER_NS:
                yield n, fault, at, at + fault.lasts_ns


def weight(masses: Sequence[tuple[float, Array]], truth: Truth, gravity: Array) -> Array:
    """Return the wrench (6,) N, N m of masses on the platform at its origin, base frame."""
    wrench = np.zeros(6)
    for mass, position in masses:
        force = mass * gravity
        wrench[:3] += force
        (x, y, z), (X, Y, Z) = (truth.R @ position).tolist(), force.tolist()
        wrench[3:] += (y * Z - z * Y, z * X - x * Z, x * Y - y * X)
    return wrench
