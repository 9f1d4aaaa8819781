"""The external load on the platform: whether it is estimated, and from what."""

from typing import Annotated, Literal

from pydantic import Field

from hil.config.delay import ForceDelay
from hil.config.model import ModelSettings


class WrenchSettings(ForceDelay):
    """Where the external wrench of the State comes from; laws with a model compensate it."""

    source: Literal["none", "observer", "sensor"] = "none"
    """`observer`: from the forces sent and the motion they caused. `sensor`: the wrench of `sensors`."""
    bandwidth_Hz: Annotated[float, Field(gt=0, le=100)] = 15.0
    """Of the observer: a step is seen to 1 - exp(-2 pi bandwidth t). More is faster, noisier, and less
    forgiving of wrong delays and masses."""
    model: ModelSettings = ModelSettings()
    """Of the observer: what it does not hold, friction included, counts as external."""
