"""Sections of a run: `loop`, `engage`, `operator`, `recording`, `watch`."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import Positive

UpToAMinute = Annotated[float, Field(ge=0, le=60)]


class LoopSettings(Section):
    """The fixed-rate loop."""

    rate_Hz: Annotated[float, Field(ge=1, le=100_000)] = 1000.0
    feedback_window_us: Positive | None = None
    """Longest wait for the six feedbacks after SYNC; default 75 % of the period."""
    cpu: Annotated[int, Field(ge=0, le=1023)] | None = None
    """CPU to pin the loop to (only together with SCHED_FIFO)."""
    priority: Annotated[int, Field(ge=1, le=99)] = 80
    """SCHED_FIFO priority."""
    spin_us: Annotated[float, Field(ge=0, le=10_000)] = 100.0
    """Busy-wait this long before each deadline."""
    without_realtime: Literal["slow", "refuse"] = "slow"
    """Without SCHED_FIFO, or where `--plant` finds it not kept: drop to a rate that holds, or refuse."""
    on_stall: Literal["stretch", "fault"] = "stretch"
    """With `--plant`, or at a served bench, on localcan, while this machine holds one side up: let bench time
    stand still, or go on as on hardware, where a long stall ends in a fault."""

    def window_s(self, rate_Hz: float) -> float:
        """Return the longest wait for the six feedbacks at a rate, s."""
        return 0.75 / rate_Hz if self.feedback_window_us is None else self.feedback_window_us * 1e-6


class EngageSettings(Section):
    """From rest to the first reference sample, without a bump."""

    force_ramp_s: UpToAMinute = 0.3
    """Time in which the static holding force builds up against the closed brakes, or fades out; the brake
    test at the start takes as long. 0 starts with the law at once, without brake tests."""
    brake_release_s: UpToAMinute = 0.1
    """Time given to the brakes to open."""
    brake_close_s: UpToAMinute | None = None
    """Time given to the brakes to close and to stop the legs; default: as `brake_release_s`."""
    approach_speed_m_s: Positive = 0.2
    """Mean leg speed of the quintic move from the measured pose to the reference's start."""
    stop_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """Time in which a controlled stop comes to rest along the path."""
    blend_s: UpToAMinute = 0.5
    """Time over which the holding-force offset fades into the law."""

    @property
    def closing_s(self) -> float:
        """Time given to the brakes to close, s."""
        return self.brake_release_s if self.brake_close_s is None else self.brake_close_s


class OperatorSettings(Section):
    """What the operator has to do; see the guide on operating a run."""

    start: Literal["automatic", "asked"] = "automatic"
    """`asked`: after the approach the platform waits at the start of the reference for `hil ctl start`."""
    deadman_s: Positive | None = None
    """Motion needs the operator's held key (`hil ctl key`), heard not longer ago than this. Else the platform
    comes to rest along its path, and goes on with a new `start` only. Default: no key. No safety function."""
    setup_speed_m_s: Positive = 0.05
    """Of a jog, and of the ways back to the path and to the first pose."""
    setup_speed_deg_s: Positive = 5.0
    """The same for turns."""
    stays: bool = False
    """The run goes on after parking and faults, to be armed again. Ctrl-C or `hil ctl end` ends it."""


class WebsocketSettings(Section):
    """Where Foxglove or Lichtblick connect while it runs. Who can connect reads all of the log."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 lets the whole network in."""
    port: Annotated[int, Field(ge=1, le=65535)] = 8765


class RecordingSettings(Section):
    """The log."""

    folder: str = "runs"
    on_recorder_loss: Literal["continue", "stop"] = "continue"
    """What the daemon does when the recorder dies."""
    ring_ticks: Annotated[int, Field(ge=256, le=131_072)] = 8192
    """Length of the shared-memory ring: all of it is memory that is taken, some 3 kB a tick."""
    websocket: WebsocketSettings | None = None
    """In real time: the messages of the log to viewers as they are written (extra `viewers`)."""
    budget_GB: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Before a run the oldest logs of this configuration in `folder` are removed, those with faults last and
    the newest never, until its logs and this run fit. Default: nothing is ever removed."""


class WatchSettings(Section):
    """The live page of `hil watch`."""

    operate: bool = False
    """The page may operate the platform, not only show it; each of its commands carries the token."""
