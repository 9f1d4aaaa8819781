"""The faults of one run, and when each of them begins and ends."""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.arrays import Array
from drivers.protocol import Frame
from plant_fmu.faults.fault import NEVER_NS, Fault, Occurrence, Passage, Place, Present
from plant_fmu.faults.kinds import FramesForgedCommand, SenderFault
from plant_fmu.plant import Truth

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


class FaultPlan:
    """The faults of one run; seed: of all their random numbers; gravity: (3,) m/s^2, base frame."""

    def __init__(
        self, faults: Sequence[Fault] = (), seed: int = 0, gravity: Sequence[float] = STANDARD_GRAVITY
    ) -> None:
        self.faults = tuple(faults)
        self.seed = seed
        self.gravity = np.array(gravity, float)
        frames = (Passage, SenderFault, FramesForgedCommand)
        self.touches_frames = any(isinstance(fault, frames) for fault in self.faults)
        """True if a fault changes frames in transit, or adds some."""


class Schedule:
    """Start and end times of the faults of a plan in one run.

    Mutable state: the occurrences of the faults.
    """

    def __init__(self, plan: FaultPlan, t0_ns: int) -> None:
        self._occurrences = [
            Occurrence(
                fault,
                t0_ns + round(fault.at_s * 1e9) if fault.mode is None else NEVER_NS,
                np.random.default_rng((plan.seed, getattr(fault, "seed", 0), n)),
            )
            for n, fault in enumerate(plan.faults)
        ]
        self._passages = [(each.fault, each) for each in self._occurrences if isinstance(each.fault, Passage)]

    def starts_ns(self, fault: Fault) -> int:
        """Start of a fault of the plan, ns; NEVER_NS while it waits for a mode."""
        return next(each.start_ns for each in self._occurrences if each.fault == fault)

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults of the plan whose times count from a mode that the controller has not reached yet."""
        return tuple(each.fault for each in self._occurrences if each.start_ns == NEVER_NS)

    def begun(self, t_ns: int) -> tuple[Fault, ...]:
        """Faults that have begun by `t_ns`."""
        return tuple(each.fault for each in self._occurrences if each.start_ns <= t_ns)

    def reached(self, mode: str, t_ns: int) -> bool:
        """Start the faults that wait for this mode at `t_ns`; True if there are any."""
        found = [each for each in self._occurrences if each.start_ns == NEVER_NS and each.fault.mode == mode]
        for each in found:
            each.start_ns = t_ns + round(each.fault.at_s * 1e9)
        return bool(found)

    def edges_ns(self, since_ns: int) -> list[int]:
        """Times, ns, from `since_ns` on at which a fault begins or ends, ascending."""
        edges = {edge for each in self._occurrences for edge in (each.start_ns, each.stop_ns)}
        return sorted(edge for edge in edges if since_ns <= edge < NEVER_NS)

    def active(self, t_ns: int) -> tuple[Occurrence, ...]:
        """Faults, as occurrences, that are present at `t_ns`."""
        return tuple(each for each in self._occurrences if each.start_ns <= t_ns < each.stop_ns)

    def present(self, t_ns: int) -> Present:
        """Combined effects of all faults on drives and plant at `t_ns`."""
        present = Present()
        for each in self.active(t_ns):
            present.own = each
            each.fault.act(present)
        return present

    def carry(self, t_ns: int, frame: Frame, *, to_drives: bool) -> list[tuple[int, Frame, bool]]:
        """(arrival ns, frame, True if an extra node sent it) of each copy of a frame after all faults."""
        arriving = [(t_ns, frame, False)]
        for fault, own in self._passages:
            if not own.start_ns <= t_ns < own.stop_ns:
                continue
            place: Place = (to_drives, frame.bus, frame.id)
            arriving = [
                (*each, foreign or (k > 0 and fault.adds))
                for at, before, foreign in arriving
                for k, each in enumerate(
                    fault.carry(at, before, place, own) if fault.concerns(before) else [(at, before)]
                )
            ]
        return arriving

    def senders(self) -> Iterator[tuple[SenderFault, Occurrence]]:
        """Faults that are extra nodes on the bus and have begun or will begin."""
        for each in self._occurrences:
            if isinstance(each.fault, SenderFault) and each.start_ns < NEVER_NS:
                yield each.fault, each


def weight(masses: Sequence[tuple[float, Array]], truth: Truth, gravity: Array) -> Array:
    """Weight of masses on the platform: wrench (6,) N, N m at the platform origin, base frame."""
    wrench = np.zeros(6)
    for mass, position in masses:
        force = mass * gravity
        wrench += (*force, *np.cross(truth.R @ position, force))
    return wrench
