"""Section `operator`: what the operator has to do for the platform to move, and what a run waits for."""

from typing import Literal

from drivers.section import Section
from hil.config.values import Positive


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
    """The run goes on after it has parked and after a fault, so that `reset`, `arm` and `start` make it move
    again. Ctrl-C or `hil ctl end` ends it."""
