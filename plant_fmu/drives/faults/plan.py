"""The faults of one run."""

from collections.abc import Sequence
from math import inf

import numpy as np

from drivers.protocol import Frame
from plant_fmu.drives.faults.fault import Fault, FrameFault, Present


class FaultPlan:
    """The faults of one run. `seed` decides which frames suffer."""

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self.seed = seed
        self._timed = [fault for fault in faults if not isinstance(fault, FrameFault)]
        self._frames = [fault for fault in faults if isinstance(fault, FrameFault)]
        self.touches_frames = bool(self._frames)
        """Whether `pass_on` can change anything."""

    def edges_s(self) -> list[float]:
        """Return the instants at which a fault of drives or plant begins or ends, rising."""
        edges = {edge for fault in self._timed for edge in (fault.start_s, fault.stop_s)}
        return sorted(edge for edge in edges if edge < inf)

    def present(self, t_s: float) -> Present:
        """Return the faults of drives and plant at this instant."""
        return Present(fault for fault in self._timed if fault.active(t_s))

    def pass_on(self, frame: Frame, t_s: float, generator: np.random.Generator) -> Frame | None:
        """Return the frame as it arrives, or None if it is lost. Draws from `generator`."""
        arriving: Frame | None = frame
        for fault in self._frames:
            if arriving is None:
                break
            struck = fault.active(t_s) and fault.identifier in (None, frame.id)
            if struck and generator.random() < fault.probability:
                arriving = fault.strike(arriving, generator)
        return arriving
