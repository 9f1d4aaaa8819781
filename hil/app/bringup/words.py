"""Mistakes of a rehearsal in words: `encoder_scale leg=2 value=1.01`, `ids_swapped leg=1 other=4`."""

from collections.abc import Sequence
from math import isfinite

from drivers.errors import ConfigurationError
from plant_fmu.rehearsal.wiring import MISTAKES, Mistake, Wiring, legs_of, wired

_KEYS = ("leg", "other", "third", "value")


def mistake_of(words: str) -> Mistake:
    """Return a mistake. Raises ConfigurationError for words that are none."""
    name, *rest = words.split() or [""]
    given: dict[str, float] = {}
    for word in rest:
        key, equals, text = word.partition("=")
        try:
            number = float(text)
        except ValueError:
            number = float("nan")
        if key not in _KEYS or not equals or not isfinite(number):
            raise ConfigurationError(f"--mistake {words!r}: {word!r}, allowed: {', '.join(_KEYS)} = a number")
        given[key] = number
    if name not in MISTAKES:
        raise ConfigurationError(f"--mistake {words!r}: unknown, allowed: {', '.join(MISTAKES)}")
    legs = {key: int(given[key]) for key in _KEYS[:3] if key in given}
    needed = _KEYS[: legs_of(name)]
    lacks = [key for key in needed if key not in given]
    more = [key for key in legs if key not in needed]
    if lacks or more or any(given[key] != leg for key, leg in legs.items()):
        wrong = f"without {', '.join(lacks)}" if lacks else f"given: {' '.join(rest)}"
        raise ConfigurationError(
            f"--mistake {words!r}: {wrong}, allowed: {name} with {', '.join(needed)}, legs 0 to 5"
        )
    return Mistake(name, **{"leg": 0, **legs}, value=given.get("value"))


def wiring_of(mistakes: Sequence[str]) -> Wiring:
    """Return the wiring with some mistakes. Raises ConfigurationError."""
    try:
        return wired(*map(mistake_of, mistakes))
    except ValueError as error:
        raise ConfigurationError(f"--mistake: {error}") from None
