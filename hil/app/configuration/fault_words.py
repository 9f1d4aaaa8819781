"""Faults as words: `encoder_jump leg=0 at=2 by=5e-3`, the short form of an entry of `plant.faults`.

The kind, then its keys; a key may be written without its unit.
"""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import not_brought_about
from hil.app.configuration.problems import split_unit, validated
from hil.app.configuration.yaml_positions import parse, path_text
from plant_fmu.faults import FAULTS
from plant_fmu.faults.fault import Fault


def short_keys(kind: type[Fault]) -> dict[str, str]:
    """Return the keys of a kind: without unit -> whole."""
    return {split_unit(key)[0]: key for key in kind.model_fields if key != "kind"}


def read_fault(text: str) -> Fault:
    """Return the fault that words describe.

    Raises ConfigurationError: unknown kind or key, a key twice, a value that is not allowed or missing.
    """
    name, *words = text.split() or [""]
    where = f'--fault "{text}"'
    kind = FAULTS.get(name)
    if kind is None:
        near = get_close_matches(name, FAULTS, 1, 0.6)
        guess = f"did you mean {near[0]}? " if near else ""
        raise ConfigurationError(f"{where}: unknown kind {name!r}, {guess}allowed: {', '.join(FAULTS)}")
    lines: dict[str, str] = {}
    for word in words:
        key, equals, value = word.partition("=")
        whole = _whole(where, kind, name, key)
        if not equals or not value:
            raise ConfigurationError(f"{where}: {word}: no value, allowed: KEY=VALUE")
        if whole in lines:
            raise ConfigurationError(f"{where}: {key}: given twice")
        lines[whole] = f"{whole}: [{value}]" if "," in value else f"{whole}: {value}"
    document = parse("\n".join((f"kind: {name}", *lines.values())) + "\n")
    fault, found = validated(kind, document)
    if fault is not None:
        return fault
    raise ConfigurationError(*(f"{where}: {path_text(p.path)}: {p.message}" for p in found))


def _whole(where: str, kind: type[Fault], name: str, key: str) -> str:
    """Return a key with its unit."""
    short = short_keys(kind)
    if key in short:
        return short[key]
    if key in short.values():
        return key
    near = get_close_matches(key, short, 1, 0.6)
    guess = f"did you mean {near[0]}? " if near else ""
    raise ConfigurationError(f"{where}: {key}: unknown key of {name}, {guess}allowed: {', '.join(short)}")


def show_fault(fault: Fault) -> str:
    """Return the words of a fault, defaults left out."""
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
    """Return the configuration with more faults than its own.

    Raises ConfigurationError for words that mean no fault, and for faults that its plant cannot have.
    """
    return with_more(c, [read_fault(text) for text in texts])


def with_more(c: Configuration, faults: Sequence[Fault]) -> Configuration:
    """Return the configuration with more faults than its own. Raises ConfigurationError as `with_faults`."""
    if not faults:
        return c
    if c.plant is None:
        raise ConfigurationError(
            f"{c.source}: plant: missing, and faults act on it: this configuration is for real drives"
        )
    found = [message for fault in faults if (message := not_brought_about(c.plant, str(fault.kind)))]
    if found:
        raise ConfigurationError(*(f"{c.source}: {message}" for message in found))
    plant = c.plant.model_copy(update={"faults": [*c.plant.faults, *faults]})
    return c.model_copy(update={"plant": plant})
