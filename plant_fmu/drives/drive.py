"""Six emulated drives: what they remember, how modes move them, what they do by themselves.

`Nodes` owns the drives.
"""

from functools import partial
from math import exp, inf, nan, pi
from operator import itemgetter

import numpy as np

from drivers.arrays import Array, Ints
from drivers.config import DriveSettings
from drivers.protocol import Configure, Status
from drivers.signals import INVALID, LEGS, DriveFault, Reaction
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives import kernels
from plant_fmu.drives.kernels import BOOT, BRAKE, NEVER_NS, WORKS
from plant_fmu.faults.fault import Present

_NO_COUNTER = -1


def at_motor(settings: DriveSettings, transmission: Transmission | None) -> DriveSettings:
    """Return the settings with the force that a drive clips: its torque's, before the losses on the way."""
    if transmission is None:
        return settings
    rated_N = settings.force_limit_N / float(transmission.driving.min())
    return settings.model_copy(update={"force_limit_N": rated_N})


class Drives:
    """Six drives that have just been powered up. Every array has one element a drive.

    `enter` is the kernel of this name, on these drives.

    Mutable state: two matrices, whose rows are the attributes; `kernels` says what they are; where legs stood
    when a fault began that scales what their encoders count.
    """

    def __init__(self, settings: DriveSettings, emulation: DriveEmulation, step_s: float) -> None:
        """Power up; `step_s` is the plant's internal step, over which the force lag is exact."""
        self._integers = integers = np.zeros((kernels.FOLLOWED + 1, LEGS), np.int64)
        self._reals = reals = np.zeros((kernels.TRUE + 1, LEGS))
        self._origins: dict[tuple[int, int], float] = {}
        """m, by leg and the fault's beginning in ns."""
        self.state = integers[kernels.STATE]
        self.fault = integers[kernels.REASON]
        self.configured = integers[kernels.CONFIGURED]
        self.watchdog_ns = integers[kernels.WATCHDOG]
        self.deadline_ns = integers[kernels.DEADLINE]
        self.reaction = integers[kernels.REACTION]
        self.acting = integers[kernels.ACTING]
        self.moved_ns = integers[kernels.MOVED :]
        """(2, 6), see `kernels`."""
        self.command = reals[kernels.COMMAND]
        self.held_m = reals[kernels.HELD]
        self.force = reals[kernels.FORCE]
        """N, what the drives put on the plant."""
        self.brake = reals[kernels.BRAKES]
        """1 engaged, 0 released."""
        self.state[:] = BOOT
        integers[kernels.COUNTER] = _NO_COUNTER
        self.watchdog_ns[:] = round(settings.watchdog_ms * 1e6)
        self.deadline_ns[:] = NEVER_NS
        self.reaction[:] = Reaction.BRAKE
        self.acting[:] = BRAKE
        integers[kernels.STUCK] = WORKS
        self.moved_ns[:] = NEVER_NS
        reals[kernels.FROZEN] = nan
        reals[kernels.MOST] = inf
        for row in (kernels.SHUT, kernels.TRUE, kernels.SHARE, kernels.GAIN, kernels.SCALE):
            reals[row] = 1.0
        # First-order lag over one step: its end value and its mean, both 1 without a lag.
        x = 2.0 * pi * emulation.force_bandwidth_Hz * step_s
        self.lags = x > 0.0
        end = exp(-x)
        common = np.array([
            settings.force_limit_N,
            emulation.damping_N_s_m,
            emulation.hold_stiffness_N_m,
            float(self.lags),
            end,
            (1.0 - end) / x if self.lags else end,
            1e6 * emulation.brake_open_ms,
            1e6 * emulation.brake_close_ms,
        ])  # fmt: skip
        self.enter = partial(kernels.enter, integers, reals)
        self.matrices = integers, reals, common
        """What the pass works on."""

    def status(self, leg: int, *, due: bool) -> Status:
        """Return what a drive is in."""
        set_up = Configure(leg, int(self.watchdog_ns[leg]) * 1e-9, Reaction(int(self.reaction[leg])))
        holds = set_up if self.configured[leg] else None
        return Status(leg, int(self.state[leg]), int(self.fault[leg]), holds, due)

    def disturb(self, present: Present, length: Array, rate: Array, t_ns: int) -> None:
        """Let the faults of this instant act, the plant being there.

        An encoder freezes at what it reads, and scales what it moves from there on.
        """
        reals, integers = self._reals, self._integers
        self.drift(present, t_ns)
        self._scale(present, length)
        integers[kernels.LOST] = 0  # one that is lost freezes at what it would read
        reads, _, _ = self.encoders(length, rate)
        integers[kernels.LOST] = [INVALID if lost else 0 for lost in present.lost]
        frozen = reals[kernels.FROZEN]
        frozen[:] = np.where(present.frozen, np.where(np.isnan(frozen), reads, frozen), nan)
        reals[kernels.GAIN], reals[kernels.MOST] = present.gain, present.saturation_N
        integers[kernels.STUCK] = [WORKS if stuck is None else stuck for stuck in present.stuck]
        integers[kernels.SLOW], reals[kernels.SHARE] = present.slow_ns, present.share
        for leg in np.flatnonzero(present.reset).tolist():
            self.enter(leg, BOOT, DriveFault.NONE)
            self.configured[leg], integers[kernels.COUNTER, leg] = False, _NO_COUNTER

    def _scale(self, present: Present, length: Array) -> None:
        """Let encoders count a multiple of what their legs move from where each of their faults began.

        Of several faults of one leg a later one multiplies what the earlier ones make of the motion.
        """
        scale, shift = np.ones(LEGS), np.zeros(LEGS)
        for leg, factor, since_ns in sorted(present.scales, key=itemgetter(2)):
            origin = self._origins.setdefault((leg, since_ns), float(length[leg]))
            shift[leg] += scale[leg] * (1.0 - factor) * origin
            scale[leg] *= factor
        self._reals[kernels.SCALE], self._reals[kernels.SHIFT] = scale, shift

    def drift(self, present: Present, t_ns: int) -> None:
        """Let encoders that drift be off by as much as they are by now."""
        self._reals[kernels.OFFSET], self._reals[kernels.DRIFT] = present.offset_m, 0.0
        for leg, by_m_s, since_ns in present.drifts:
            self._reals[kernels.OFFSET, leg] += by_m_s * (t_ns - since_ns) * 1e-9
            self._reals[kernels.DRIFT, leg] += by_m_s

    def encoders(
        self, length: Array, rate: Array, dt_s: float = 0.0, quantum_m: float = 0.0
    ) -> tuple[Array, Array, Ints]:
        """Return what feedback carries: length m, rate m/s, state; see `kernels.read_encoders`."""
        l, dl, state = np.empty(LEGS), np.empty(LEGS), np.empty(LEGS, np.int64)
        kernels.read_encoders(self._integers, self._reals, length, rate, dt_s, quantum_m, l, dl, state)
        return l, dl, state
