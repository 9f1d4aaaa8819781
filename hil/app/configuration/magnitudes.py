"""Numbers that no robot has: squared or divided by, they would leave what a float holds."""

from collections.abc import Iterator

from hil.app.configuration.yaml_positions import Document, Path, Problem, Value
from hil.config.number import LEAST, MOST

NO_LIMIT, MOST_SEED = 1e30, 2**64
"""In section `limits`, where a large number stands for none; of a seed."""
_OTHERS = ("plant", "model", "parameters")
"""Those of a foreign FMU are its own."""


def beyond_reason(document: Document) -> list[Problem]:
    """Return the numbers that are larger or smaller than any that is meant."""
    return [
        Problem(document.value_position(path), path, message)
        for path, message in _found(document.value, ())
        if path[: len(_OTHERS)] != _OTHERS
    ]


def _found(value: Value, path: Path) -> Iterator[tuple[Path, str]]:
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _found(each, (*path, key))
    elif isinstance(value, list):
        for k, each in enumerate(value):
            yield from _found(each, (*path, k))
    elif isinstance(value, int | float) and value:
        most = MOST_SEED if path[-1] == "seed" else NO_LIMIT if path[0] == "limits" else MOST
        if not LEAST <= abs(value) <= most:
            yield path, f"allowed in size: 0, and {LEAST:g} to {most:g}, given: {float(value):g}"
