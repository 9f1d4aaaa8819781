"""What the sections of all laws with a model of the robot have in common."""

from __future__ import annotations

from drivers.config import Section
from hil.config.delay import DelayCompensation
from hil.config.model import ModelSettings


class ModelBasedSettings(Section):
    """A law with a model: what it believes of the robot, and whether it uses that to look ahead."""

    model: ModelSettings = ModelSettings()
    delay_compensation: DelayCompensation | None = None
    """State and reference of the instant at which the force acts; left out: of the measurement."""
