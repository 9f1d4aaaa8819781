"""Sections `engage` and `recording`: how a run begins and ends, and what is kept of it."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import Positive

UpToAMinute = Annotated[float, Field(ge=0, le=60)]


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
