"""One emulated drive: what it remembers, how modes move it, what it does by itself.

Rule of the room: no time, no frames, no plant; `Nodes` owns the six drives.
"""

from __future__ import annotations

from math import exp, pi

from drivers.config import DriveSettings
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.config import DriveEmulation

# Names of the module: an attribute of an Enum class takes several times as long to look up.
BOOT, OFF, READY, RUN, FAULT = DriveState
BRAKE, DAMP, HOLD, ZERO = Reaction
_NO_COUNTER = -1

TRANSITIONS: dict[int, dict[DriveState, DriveState]] = {
    DriveMode.OFF: {READY: OFF, RUN: OFF},
    DriveMode.READY: {OFF: READY, RUN: READY},
    DriveMode.RUN: {READY: RUN},
    DriveMode.RESET: {READY: OFF, RUN: OFF, FAULT: OFF},
}
"""What each commanded mode does to a drive; a state that is not listed stays as it is."""


class ForceStage:
    """What the six drives have in common: rated force, gains of the reactions, force lag. Constant.

    step_s is the plant's internal step, over which the lag is exact.
    """

    def __init__(self, emulation: DriveEmulation, settings: DriveSettings, step_s: float) -> None:
        self.limit = settings.force_limit_N
        self.damping = emulation.damping_N_s_m
        self.stiffness = emulation.hold_stiffness_N_m
        # First-order lag over one step: its end value and its mean.
        x = 2.0 * pi * emulation.force_bandwidth_Hz * step_s
        self.lags = x > 0.0
        self.lag_end = exp(-x)
        self.lag_mean = (1.0 - exp(-x)) / x if x > 0.0 else 1.0


class Drive:
    """One drive. A new one has just been powered up. Mutable state: every attribute but the stage."""

    __slots__ = (
        "acting",
        "command",
        "configured",
        "counter",
        "fault",
        "frozen_m",
        "hold_m",
        "lagged",
        "reaction",
        "stage",
        "state",
        "watchdog_ns",
    )

    def __init__(self, settings: DriveSettings, stage: ForceStage) -> None:
        self.stage = stage
        self.state = BOOT
        self.fault = DriveFault.NONE
        self.configured = False
        self.watchdog_ns = round(settings.watchdog_ms * 1e6)
        self.reaction = Reaction[settings.reaction.upper()]
        self.acting = BRAKE
        """The reaction of the fault that is latched."""
        self.hold_m = 0.0
        self.command = 0.0
        """N, the last valid one; zero outside READY and RUN."""
        self.counter = _NO_COUNTER
        self.lagged = 0.0
        """N, state of the force lag."""
        self.frozen_m: float | None = None
        """What a frozen encoder keeps reading."""

    @property
    def controls(self) -> bool:
        """Whether the drive follows its encoder by itself."""
        return self.state is FAULT and (self.acting is DAMP or self.acting is HOLD)

    def reaction_force(self, l: float, dl: float) -> float:
        """Return what a drive that `controls` does at length l m and rate dl m/s, N."""
        f = -self.stage.damping * dl
        if self.acting is HOLD:
            f -= self.stage.stiffness * (l - self.hold_m)
        return f

    def lag(self, f: float) -> float:
        """Let the force stage follow f N for one step of the plant; return its mean over the step, N."""
        gap = self.lagged - f
        self.lagged = f + gap * self.stage.lag_end
        return f + gap * self.stage.lag_mean
