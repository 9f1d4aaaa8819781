"""`--tolerance`: how far two logs may be apart, in the words of the command line."""

from collections.abc import Collection, Sequence
from difflib import get_close_matches
from math import inf, isnan
from typing import NamedTuple

from drivers.errors import ConfigurationError
from drivers.tick_columns import Column


class Tolerances(NamedTuple):
    """What is allowed."""

    relative: float
    """Of every column of floats without a tolerance of its own: of |b|, and of 1 where that is less; inf: no
    column without one is judged."""
    absolute: dict[str, float]
    """By column, in its unit; inf: it is not judged."""

    @property
    def alone(self) -> float:
        """How many ticks one log may have that the other lacks: the tolerance of the column `tick`."""
        return self.absolute.get("tick", inf if self.relative == inf else 0.0)


def read_tolerances(
    words: Sequence[str], columns: Sequence[Column], uncompared: Collection[str] = ()
) -> Tolerances:
    """Return tolerances of words: `tau=0.5`, `compute_ns=inf`, or `1e-9` for all other columns of floats.

    `inf` alone: the other columns are not judged.

    columns : that are compared; uncompared : names of those that only one of the logs has, or that are of
    another type in it. These may be given, so that words fit logs of any release, and count for nothing.

    Raises ConfigurationError for words of another form, for a column that neither log has, and for one whose
    values have names and no distance.
    """
    known = {column.name: column for column in columns}
    relative, absolute = 0.0, dict[str, float]()
    for each in words:
        name, equals, text = each.rpartition("=")
        value = _number(text, each)
        column = known.get(name)
        if equals and column is None and name not in uncompared:
            near = get_close_matches(name, [*known, *uncompared], n=3)
            hint = f"did you mean {', '.join(near)}?" if near else "docs/guides/columns.md lists the columns"
            raise ConfigurationError(f"--tolerance {each}: neither log has a column {name!r}; {hint}")
        if column is not None and column.names and value not in (0.0, inf):
            raise ConfigurationError(
                f"--tolerance {each}: the values of {name} have names and no distance, allowed: {name}=0 for "
                f"the same, {name}=inf for any"
            )
        if equals:
            absolute[name] = value
        else:
            relative = value
    return Tolerances(relative, absolute)


def _number(text: str, words: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if isnan(value) or value < 0.0:
        raise ConfigurationError(
            f"--tolerance {words}: allowed: COLUMN=VALUE in the column's unit, as tau=0.5, or one number, "
            "the relative tolerance of all columns of floats; >= 0, inf: not judged"
        )
    return value
