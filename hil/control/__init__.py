"""Control laws: one per file, each an entry point of the group `hil.laws`."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args

from pydantic import Field, create_model

from drivers.errors import ConfigurationError
from drivers.registry import loaded, registered
from hil.control.law import LawSettings


def named(name: str, settings: Any) -> type[LawSettings]:
    """Class of a law's settings, under the name that `controller.law` has for it.

    Raises ConfigurationError for what is not a subclass of LawSettings, or has another name.
    """
    if not (isinstance(settings, type) and issubclass(settings, LawSettings)):
        raise ConfigurationError(f"law {name}: {settings!r} is not a subclass of hil.control.law.LawSettings")
    own = get_args(settings.model_fields["law"].annotation)
    if own and own != (name,):
        raise ConfigurationError(f"law {name}: {settings.__qualname__}.law is {own[0]}; give both one name")
    if own:
        return settings
    kind: Any = Literal[name]
    return create_model(settings.__name__, __base__=settings, law=(kind, ...))


LAWS: dict[str, type[LawSettings]] = {
    name: named(name, loaded("hil.laws", name)) for name in registered("hil.laws")
}
"""`controller.law` of the configuration -> its settings."""

if TYPE_CHECKING:
    ControllerSettings = LawSettings
else:
    ControllerSettings = Annotated[Union[tuple(LAWS.values())], Field(discriminator="law")]  # noqa: UP007
"""Section `controller`: one of LAWS."""
