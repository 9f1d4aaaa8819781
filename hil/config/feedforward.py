"""Section `feedforward`: leg forces that were learned from run to run over the reference's own time."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import NonNegative, Positive


class FeedforwardSettings(Section):
    """What `hil learn` found out about this reference, this controller and this platform."""

    file: str
    """CSV that `hil learn` writes, relative to the configuration file."""
    limit_N: Positive
    """Largest learned force of a leg. `hil learn` cuts what it writes there; a file with more is refused."""
    fade_s: Annotated[float, Field(ge=0.001, le=10)] = 0.05
    """Time in which it fades out where a run leaves the clock of its reference (hold, speed, stop), and in
    where the run reaches full speed only after the reference's start."""


class MadeFor(Section):
    """What a feed-forward belongs to, as fingerprints: on anything else its forces are wrong."""

    reference: str
    controller: str
    platform: str


class FeedforwardHead(Section):
    """The head of the file that `hil learn` writes: what it was learned from, and how."""

    kind: Literal["feedforward"]
    source: str
    """The log that it was learned from."""
    run: Annotated[int, Field(ge=1)]
    """So many runs it has learned from."""
    made_for: MadeFor
    rate_Hz: Positive
    """Of these runs."""
    cutoff_Hz: Positive
    """Where its zero-phase filter ends."""
    contraction: Annotated[float, Field(ge=0, lt=1)]
    """Largest factor by which the error may shrink from run to run, over frequency and uncertainty."""
    first_rms_error_mm: NonNegative
    """Of the legs, in the first run of all."""
    rms_error_mm: NonNegative
    """In the run that it was learned from."""
    peak_N: NonNegative
    """Largest force in the file."""
    rows: Annotated[int, Field(ge=2)]
    """Of the file: one that has been cut would keep its last force."""
    digest: str = ""
    """Of its times and forces; others than these nobody has learned."""
