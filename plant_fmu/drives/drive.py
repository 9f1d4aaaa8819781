"""Six emulated drives: what they remember, how modes move them, what they do by themselves.

`Nodes` owns the drives.
"""

from functools import partial
from math import exp, nan, pi

import numpy as np

from drivers.arrays import Array, Ints
from drivers.config import DriveSettings
from drivers.signals import INVALID, LEGS, Reaction
from plant_fmu.config import DriveEmulation
from plant_fmu.drives import kernels
from plant_fmu.drives.faults.fault import Present
from plant_fmu.drives.kernels import BOOT, BRAKE, NEVER_NS, WORKS

_NO_COUNTER = -1


class Drives:
    """Six drives that have just been powered up. Every array has one element a drive.

    `enter`, `obey` and `actuate` are the kernels of these names, on these drives.

    Mutable state: two matrices, whose rows are the attributes; `kernels` says what they are.
    """

    def __init__(self, settings: DriveSettings, emulation: DriveEmulation, step_s: float) -> None:
        """Power up; `step_s` is the plant's internal step, over which the force lag is exact."""
        self._integers = integers = np.zeros((kernels.MOVED + 1, LEGS), np.int64)
        self._reals = reals = np.zeros((kernels.SHUT + 1, LEGS))
        self.state = integers[kernels.STATE]
        self.fault = integers[kernels.REASON]
        self.configured = integers[kernels.CONFIGURED]
        self.watchdog_ns = integers[kernels.WATCHDOG]
        self.deadline_ns = integers[kernels.DEADLINE]
        self.reaction = integers[kernels.REACTION]
        self.acting = integers[kernels.ACTING]
        self.moved_ns = integers[kernels.MOVED]
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
        self.reaction[:] = Reaction[settings.reaction.upper()]
        self.acting[:] = BRAKE
        integers[kernels.STUCK] = WORKS
        self.moved_ns[:] = NEVER_NS
        reals[kernels.SHUT] = 1.0
        reals[kernels.FROZEN] = nan
        reals[kernels.GAIN] = 1.0
        # First-order lag over one step: its end value and its mean.
        x = 2.0 * pi * emulation.force_bandwidth_Hz * step_s
        self.lags = x > 0.0
        common = np.array([
            settings.force_limit_N,
            emulation.damping_N_s_m,
            emulation.hold_stiffness_N_m,
            float(self.lags),
            exp(-x),
            (1.0 - exp(-x)) / x if x > 0.0 else 1.0,
            1e6 * emulation.brake_open_ms,
            1e6 * emulation.brake_close_ms,
        ])  # fmt: skip
        self.enter = partial(kernels.enter, integers, reals)
        self.obey = partial(kernels.obey, integers, reals, common)
        self.actuate = partial(kernels.actuate, integers, reals, common)

    def disturb(self, present: Present, length: Array, rate: Array) -> None:
        """Let the faults of this instant act, the plant being there; an encoder freezes at what it reads."""
        self._reals[kernels.OFFSET] = present.offset_m
        self._integers[kernels.LOST] = [INVALID if lost else 0 for lost in present.lost]
        reads, _, _ = self.encoders(length, rate)
        frozen = self._reals[kernels.FROZEN]
        frozen[:] = np.where(present.frozen, np.where(np.isnan(frozen), reads, frozen), nan)
        self._reals[kernels.GAIN] = present.gain
        self._integers[kernels.STUCK] = [WORKS if stuck is None else stuck for stuck in present.stuck]

    def encoders(
        self, length: Array, rate: Array, dt_s: float = 0.0, quantum_m: float = 0.0
    ) -> tuple[Array, Array, Ints]:
        """Return what feedback carries: length m, rate m/s, state; see `kernels.read_encoders`."""
        l, dl, state = np.empty(LEGS), np.empty(LEGS), np.empty(LEGS, np.int64)
        kernels.read_encoders(self._integers, self._reals, length, rate, dt_s, quantum_m, l, dl, state)
        return l, dl, state
