"""Section `feedforward`: leg forces, learned from earlier runs, over the time of the reference."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import NonNegative, Positive


class FeedforwardSettings(Section):
    """Leg forces that `hil learn` wrote for one reference, controller and platform."""

    file: str
    """CSV file of `hil learn`, relative to the configuration file."""
    limit_N: Positive
    """Largest learned force of a leg. `hil learn` limits its output to this; a file with more is refused."""
    fade_s: Annotated[float, Field(ge=0.001, le=10)] = 0.05
    """Fade-out time where a run leaves the clock of its reference (hold, speed, stop), and fade-in time where
    the run reaches full speed only after the reference's start."""


class MadeFor(Section):
    """Fingerprints of the reference, controller and platform for which the forces were learned."""

    reference: str
    controller: str
    platform: str


class FeedforwardHead(Section):
    """Head of a file that `hil learn` wrote: what the forces were learned from, and how."""

    kind: Literal["feedforward"]
    source: str
    """Log from which the forces were learned."""
    run: Annotated[int, Field(ge=1)]
    """Number of runs learned from."""
    made_for: MadeFor
    rate_Hz: Positive
    """Loop rate of these runs."""
    cutoff_Hz: Positive
    """Cut-off frequency of the zero-phase filter."""
    contraction: Annotated[float, Field(ge=0, lt=1)]
    """Largest factor by which the error may shrink from run to run, over frequency and uncertainty."""
    first_rms_error_mm: NonNegative
    """RMS leg error of the very first run."""
    rms_error_mm: NonNegative
    """RMS leg error of the run in `source`."""
    peak_N: NonNegative
    """Largest force in the file."""
    rows: Annotated[int, Field(ge=2)]
    """Number of rows in the file; a truncated file would keep its last force."""
    digest: str = ""
    """Checksum of the times and forces; a file with other values is refused."""
