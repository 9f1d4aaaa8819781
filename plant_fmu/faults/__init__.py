"""Faults of plant, drives, frames and process. A module that defines fault kinds is imported here."""

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from plant_fmu.faults import kinds as kinds
from plant_fmu.faults.fault import FAULTS, Fault

__all__ = ["FAULTS", "AnyFault"]

if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Annotated[Union[tuple(FAULTS.values())], Field(discriminator="kind")]  # noqa: UP007
    """An entry of `plant.faults`."""
