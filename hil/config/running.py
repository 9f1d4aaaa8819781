"""Sections of a run: `loop`, `engage`, `operator`, `recording`, `watch`."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import Positive

UpToAMinute = Annotated[float, Field(ge=0, le=60)]


class LoopSettings(Section):
    """Rate, timing and real-time scheduling of the control loop."""

    rate_Hz: Annotated[float, Field(ge=1, le=100_000)] = 1000.0
    feedback_window_us: Positive | None = None
    """Longest wait for the six feedbacks after SYNC; default: 75 % of the period."""
    cpu: Annotated[int, Field(ge=0, le=1023)] | None = None
    """CPU to pin the loop to (only together with SCHED_FIFO)."""
    priority: Annotated[int, Field(ge=1, le=99)] = 80
    """SCHED_FIFO priority."""
    spin_us: Annotated[float, Field(ge=0, le=10_000)] = 100.0
    """Busy-wait time before each deadline."""
    without_realtime: Literal["slow", "refuse"] = "slow"
    """Without SCHED_FIFO, or if `--plant` finds that it is not kept: run at a rate that holds, or refuse."""
    on_stall: Literal["stretch", "fault"] = "stretch"
    """With `--plant`, or with a served bench, on localcan, while this machine stalls one side: stop the bench
    clock, or continue as on hardware, where a long stall ends in a fault."""

    def window_s(self, rate_Hz: float) -> float:
        """Longest wait, s, for the six feedbacks after SYNC if the loop runs at `rate_Hz`."""
        return 0.75 / rate_Hz if self.feedback_window_us is None else self.feedback_window_us * 1e-6


class EngageSettings(Section):
    """Timing from rest on the brakes to the first reference sample, and of stops."""

    force_ramp_s: UpToAMinute = 0.3
    """Time in which the static holding force builds up against the closed brakes, or fades out; the brake
    test at the start takes as long. 0: the law starts at once, without brake tests."""
    brake_release_s: UpToAMinute = 0.1
    """Time for the brakes to open."""
    brake_close_s: UpToAMinute | None = None
    """Time for the brakes to close and to stop the legs; default: as `brake_release_s`."""
    approach_speed_m_s: Positive = 0.2
    """Mean leg speed of the quintic move from the measured pose to the reference's start."""
    stop_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """Time in which a controlled stop along the path comes to rest."""
    blend_s: UpToAMinute = 0.5
    """Time over which the holding-force offset fades into the law."""

    @property
    def closing_s(self) -> float:
        """Time for the brakes to close, s."""
        return self.brake_release_s if self.brake_close_s is None else self.brake_close_s


class OperatorSettings(Section):
    """What the operator must do before and during motion, and the speeds of set-up motions."""

    start: Literal["automatic", "asked"] = "automatic"
    """`asked`: after the approach the platform waits at the reference's start for `hil ctl start`."""
    deadman_s: Positive | None = None
    """Dead-man's switch: motion requires a signal of the operator's held key (`hil ctl key`) at most this
    old. Else the platform comes to rest along its path and needs a new `start`. Default: no key. Not a
    safety function."""
    setup_speed_m_s: Positive = 0.05
    """Speed of a jog, and of the ways back to the path and to the first pose."""
    setup_speed_deg_s: Positive = 5.0
    """The same speed for rotations."""
    stays: bool = False
    """The run continues after parking and faults, to be armed again. Ctrl-C or `hil ctl end` ends it."""


class WebsocketSettings(Section):
    """Address for Foxglove or Lichtblick during the run. Every client can read the whole log."""

    host: str = "127.0.0.1"
    """Address to listen at; 0.0.0.0 admits the whole network."""
    port: Annotated[int, Field(ge=1, le=65535)] = 8765


class RecordingSettings(Section):
    """Folder, memory and size limit of the recorded logs."""

    folder: str = "runs"
    on_recorder_loss: Literal["continue", "stop"] = "continue"
    """Reaction of the daemon to a dead recorder."""
    ring_ticks: Annotated[int, Field(ge=256, le=131_072)] = 8192
    """Length of the shared-memory ring; it occupies about 3 kB of memory per tick."""
    websocket: WebsocketSettings | None = None
    """In real time: send the messages of the log to viewers as they are written (extra `viewers`)."""
    budget_GB: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Size limit for the logs of this configuration in `folder`, the new run included. Before a run the
    oldest logs are removed, those with faults last and the newest never. Default: no log is ever removed."""


class WatchSettings(Section):
    """Live page of `hil watch`."""

    operate: bool = False
    """Allow the page to operate the platform, not only to show it; each of its commands carries the token."""
