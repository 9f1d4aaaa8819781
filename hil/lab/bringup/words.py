"""Mistakes of a rehearsal in words: `encoder_scale leg=2 value=1.01`, `ids_swapped leg=1 other=4`."""

from collections.abc import Sequence
from math import isfinite

from drivers.errors import ConfigurationError
from drivers.family import Family
from plant_fmu.rehearsal.wiring import MISTAKES, OF_WATCHDOG, RANGES, Mistake, Wiring, legs_of, wired

_KEYS = ("leg", "other", "third", "value")


def mistake_of(words: str) -> Mistake:
    """Return a mistake. Raises ConfigurationError for words that are none."""
    name, *rest = words.split() or [""]
    if name not in MISTAKES:
        raise ConfigurationError(f"--mistake {words!r}: unknown, allowed: {', '.join(MISTAKES)}")
    given = _given(words, rest)
    legs = {key: int(given[key]) for key in _KEYS[:3] if key in given}
    needed = _KEYS[: legs_of(name)]
    lacks = [key for key in needed if key not in given]
    more = [key for key in legs if key not in needed]
    if lacks or more or any(given[key] != leg for key, leg in legs.items()):
        wrong = f"without {', '.join(lacks)}" if lacks else f"given: {' '.join(rest)}"
        legs_words = f" with {', '.join(needed)}, legs 0 to 5" if needed else " without legs"
        raise ConfigurationError(f"--mistake {words!r}: {wrong}, allowed: {name}{legs_words}")
    value = given.get("value")
    if value is not None:
        _refuse_size(words, name, value)
    return Mistake(name, **{"leg": 0, **legs}, value=value)


def _given(words: str, rest: Sequence[str]) -> dict[str, float]:
    """Return the numbers by their keys. Raises ConfigurationError for the first word that is none."""
    given: dict[str, float] = {}
    for word in rest:
        key, _, text = word.partition("=")
        if key not in _KEYS:
            raise ConfigurationError(f"--mistake {words!r}: {word!r}, allowed: {', '.join(_KEYS)} = a number")
        if key in given:
            raise ConfigurationError(f"--mistake {words!r}: {word!r}: {key} is given twice, allowed: once")
        try:
            given[key] = float(text)
        except ValueError:
            given[key] = float("nan")
        if not isfinite(given[key]):
            raise ConfigurationError(f"--mistake {words!r}: {word!r}, allowed: {key}= a finite number")
    return given


def _refuse_size(words: str, name: str, value: float) -> None:
    if name not in RANGES:
        raise ConfigurationError(f"--mistake {words!r}: {name} has no size, allowed: no value=")
    low, high = RANGES[name]
    if not low <= value <= high:
        raise ConfigurationError(
            f"--mistake {words!r}: value={value:g}, allowed: {low:g} to {high:g} ({MISTAKES[name][3]})"
        )


def wiring_of(mistakes: Sequence[str], protocol: Family) -> Wiring:
    """Return the wiring with some mistakes of drives of a protocol.

    Raises ConfigurationError for words that are no mistake, that these drives cannot make, or that together
    wire everything as it should be.
    """
    known = [mistake_of(words) for words in mistakes]
    for words, mistake in zip(mistakes, known, strict=True):
        if mistake.name in OF_WATCHDOG and not protocol.traits.has_watchdog:
            raise ConfigurationError(
                f"--mistake {words!r}: these drives have no watchdog that is set from here, "
                f"allowed: all but {', '.join(sorted(OF_WATCHDOG))}"
            )
    try:
        wiring = wired(*known)
    except ValueError as error:
        raise ConfigurationError(f"--mistake: {error}") from None
    if known and wiring == Wiring():
        raise ConfigurationError(
            f"--mistake {'; '.join(mistakes)!r}: nothing is wired wrongly by that, "
            "allowed: a size, or a set of mistakes, that changes something"
        )
    return wiring
