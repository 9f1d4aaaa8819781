"""Entry points of all installed packages, ours included: laws, protocols, emulated drives, plants.

::

    [project.entry-points."hil.laws"]        # pyproject.toml of any installed package
    mine = "my_package.law:MySettings"
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import new_class
from typing import Any, Literal, TypeVar, get_args

from drivers.errors import ConfigurationError
from drivers.section import Section

Kind = TypeVar("Kind", bound=Section)


@cache
def registered(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name, in the order of their names.

    Raises ConfigurationError if two packages register the same name.
    """
    found: dict[str, EntryPoint] = {}
    for entry in sorted(_all().select(group=group), key=lambda each: each.name):
        other = found.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise ConfigurationError(
                f"{group}: {entry.name} is registered as {other.value} (package {_package(other)}) and as "
                f"{entry.value} (package {_package(entry)}); uninstall one of them"
            )
    return found


@cache
def _all() -> Any:
    return entry_points()


def loaded(group: str, name: str) -> Any:
    """Object that an entry point refers to. Raises ConfigurationError if its package cannot be imported."""
    entry = registered(group)[name]
    try:
        return entry.load()
    except Exception as error:
        raise ConfigurationError(
            f"{group}: {name} = {entry.value} of package {_package(entry)} cannot be loaded: "
            f"{type(error).__name__}: {error}; correct the package, or uninstall it"
        ) from error


def sections(group: str, base: type[Kind], field: str) -> dict[str, type[Kind]]:
    """Configuration sections registered in an entry-point group, by name.

    field: key whose value selects the section by its name. Raises ConfigurationError as `loaded` and
    `named`, and for a group without any entry point.
    """
    if not registered(group):
        raise ConfigurationError(
            f"{group}: no entry points: the installation is older than its source; install it again (make)"
        )
    return {name: named(name, loaded(group, name), base, field) for name in registered(group)}


def named(name: str, section: Any, base: type[Kind], field: str) -> type[Kind]:
    """Subclass of a section that accepts only `name` as the value of its key `field`.

    Raises ConfigurationError if `section` is not a subclass of `base`, or has another name.
    """
    if not (isinstance(section, type) and issubclass(section, base)):
        raise ConfigurationError(
            f"{field} {name}: {section!r} is not a subclass of {base.__module__}.{base.__name__}"
        )
    return _named(name, section, base, field)


@cache
def _named(name: str, section: type[Kind], base: type[Kind], field: str) -> type[Kind]:
    own = get_args(section.model_fields[field].annotation)
    if own and own != (name,):
        raise ConfigurationError(
            f"{field} {name}: {section.__qualname__}.{field} is {own[0]}; use the same name for both"
        )
    if own:
        return section

    def reduced(self: Section) -> tuple[Any, ...]:
        """Pickle as a call of `revived`: other processes do not have the class."""
        return revived, (section, base, field, name, self.model_dump())

    body = {"__module__": __name__, "__annotations__": {field: Literal[name]}, "__reduce__": reduced}
    return new_class(section.__name__, (section,), exec_body=lambda there: there.update(body))


def revived(section: type[Kind], base: type[Kind], field: str, name: str, values: dict[str, Any]) -> Kind:
    """Instance of a class made by `named`, from its values: unpickles it in another process."""
    made: Kind = named(name, section, base, field).model_validate(values)
    return made


def _package(entry: EntryPoint) -> str:
    return "?" if entry.dist is None else entry.dist.name
