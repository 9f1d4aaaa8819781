"""Control laws, one per file; each is an entry point of the group `hil.laws`."""

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from drivers.registry import sections
from hil.control.law import LawSettings

LAWS = sections("hil.laws", LawSettings, "law")
"""Value of `controller.law` in the configuration -> settings class."""

if TYPE_CHECKING:
    ControllerSettings = LawSettings
else:
    ControllerSettings = Annotated[Union[tuple(LAWS.values())], Field(discriminator="law")]  # noqa: UP007
"""Section `controller`: the settings of one law in LAWS."""
