"""Faults as text, e.g. `encoder_jump leg=0 at=2 by=5e-3`, the short form of an entry of `plant.faults`.

The kind comes first, then its keys; a key may be written without its unit.
"""

from collections.abc import Iterable
from difflib import get_close_matches

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import without_effect
from hil.app.configuration.problems import split_unit, validated
from hil.app.configuration.yaml_positions import parse, path_text
from plant_fmu.faults import FAULTS
from plant_fmu.faults.fault import Fault


def short_keys(kind: type[Fault]) -> dict[str, str]:
    """{key without unit: key} of a kind of fault."""
    return {split_unit(key)[0]: key for key in kind.model_fields if key != "kind"}


def read_fault(text: str) -> Fault:
    """Parse a fault from its text form, e.g. `encoder_jump leg=0 at=2 by=5e-3`.

    Raises ConfigurationError: unknown kind or key, a key twice, a value that is not allowed or missing.
    """
    name, *words = text.split() or [""]
    where = f'--fault "{text}"'
    kind = FAULTS.get(name)
    if kind is None:
        near = get_close_matches(name, FAULTS, 1, 0.6)
        guess = f"did you mean {near[0]}? " if near else ""
        raise ConfigurationError(f"{where}: unknown kind {name!r}, {guess}allowed: {', '.join(FAULTS)}")
    short, lines = short_keys(kind), [f"kind: {name}"]
    for word in words:
        key, _, value = word.partition("=")
        if not value:
            raise ConfigurationError(f"{where}: {word}: no value, allowed: KEY=VALUE")
        lines.append(f"{short.get(key, key)}: " + (f"[{value}]" if "," in value else value))
    fault, found = validated(kind, parse("\n".join(lines)))
    if fault is None:
        raise ConfigurationError(*(f"{where}: {path_text(p.path)}: {p.message}" for p in found))
    return fault


def show_fault(fault: Fault) -> str:
    """Text form of a fault, e.g. `encoder_jump leg=0 at=2`, without default values."""
    given = fault.model_dump(exclude_defaults=True)
    words = [str(fault.kind)]
    for short, key in short_keys(type(fault)).items():
        if key in given:
            value = given[key]
            numbers = value if isinstance(value, tuple) else (value,)
            shown = (f"{x:g}" if isinstance(x, float) else str(x) for x in numbers)
            words.append(f"{short}={','.join(shown)}")
    return " ".join(words)


def with_faults(c: Configuration, texts: Iterable[str]) -> Configuration:
    """Configuration with further faults, given in their text form.

    Raises ConfigurationError for invalid text, and for faults that have no effect at its plant.
    """
    faults = [read_fault(text) for text in texts]
    if not faults:
        return c
    if c.plant is None:
        raise ConfigurationError(
            f"{c.source}: plant: missing, but faults act on it: this configuration is for real drives"
        )
    found = [message for fault in faults if (message := without_effect(c.plant, str(fault.kind)))]
    if found:
        raise ConfigurationError(*(f"{c.source}: {message}" for message in found))
    plant = c.plant.model_copy(update={"faults": [*c.plant.faults, *faults]})
    return c.model_copy(update={"plant": plant})
