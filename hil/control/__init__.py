"""Control laws: one per file, each an entry point of the group `hil.laws`."""

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from drivers.registry import sections
from hil.control.law import LawSettings

LAWS = sections("hil.laws", LawSettings, "law")
"""`controller.law` of the configuration -> its settings."""

if TYPE_CHECKING:
    ControllerSettings = LawSettings
else:
    ControllerSettings = Annotated[Union[tuple(LAWS.values())], Field(discriminator="law")]  # noqa: UP007
"""Section `controller`: one of LAWS."""
