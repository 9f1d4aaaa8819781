"""The force asked for: the law's own, and how it takes over from what holds the platform and gives way."""

from drivers.arrays import ZERO6, Array
from drivers.tick_columns import Record
from hil.control.pointed_law import called_by_pointer
from hil.loop.learned import Learned
from hil.loop.modes import Durations
from hil.loop.parts import Parts
from hil.loop.ramps import tau_at_rest
from hil.trajectory.path import PoseSample


class Effort:
    """What the law asks for, with what was learned and the ramps of entry and exit.

    Mutable state, all of it public; `reset` restores the initial one.
    """

    def __init__(self, parts: Parts, durations: Durations) -> None:
        self.parts = parts
        self.durations = durations
        self.period_s = 1.0 / parts.rate_Hz
        self.law = called_by_pointer(parts.law)
        """The law's function, and what keeps it and what it has raised."""
        self.model = parts.model
        forces = parts.learned
        self.learned = None if forces is None else Learned(forces, parts.trajectory, self.period_s)
        self.reach_N = float(parts.safety.limits["force_window_N"])
        """How far the law may go from the holding force where the platform is held: without an end it pushes
        a brake open whose leg seems to move, as its encoder drifts."""
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        self.holding = ZERO6
        """(6,) N: what holds weight and external wrench where the brakes open, or the force as they close."""
        self.offset = ZERO6
        """(6,) N: holding force less the law's own at the moment of entry; fades out."""
        self.entry_tick: int | None = None
        """When the entry offset began to fade; None while it is whole."""
        self.last_tau = ZERO6
        if self.learned is not None:
            self.learned.reset()

    def statics(self, p: Array, R: Array, wrench: Array) -> Array:
        """Return the forces (6,) N that hold weight and external wrench (6,) N, N m at a pose.

        p (3,) m, R (3, 3); wrench at the platform's origin; base frame.
        """
        return self.model.inverse_dynamics(p, R, ZERO6, ZERO6, wrench)

    def hold(self, tick: Record, holding: Array, sample: PoseSample, *, on_it: bool = False) -> None:
        """Begin with a holding force (6,) N at a sample at rest; on_it: as if the platform were there.

        The offset makes up for what the law asks for there, without load. As the law is given it at entry:
        it begins with this very tick, and the offset fits.
        """
        self.entry_tick, self.holding = None, holding
        self.offset = holding - tau_at_rest(self.law.keeps, self.parts.platform, tick, sample, on_it=on_it)
