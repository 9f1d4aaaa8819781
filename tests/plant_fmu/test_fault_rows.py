"""Every kind of fault that there is can be written in a configuration, each by its own name."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import TypeAdapter

from plant_fmu.faults import FAULTS, AnyFault
from plant_fmu.faults.fault import Fault

USUAL = {
    "leg": 2,
    "factor": 2.0,
    "share": 0.5,
    "by_m": 0.01,
    "by_m_s": 0.01,
    "sigma_m": 0.001,
    "limit_N": 10.0,
    "by_ms": 1.0,
    "for_s": 1.0,
    "mass_kg": 5.0,
}


def below(kind: type[Fault]) -> Iterator[type[Fault]]:
    """Yield the classes of faults that have a name of their own."""
    for each in kind.__subclasses__():
        if each.model_fields["kind"].default is not None and "kind" in each.__annotations__:
            yield each
        yield from below(each)


def test_each_kind_has_its_row_and_is_read_by_its_name():
    there = {each for each in below(Fault) if each.__module__.startswith("plant_fmu.faults.")}
    assert set(FAULTS.values()) == there
    assert len(FAULTS) == len(there)
    read = TypeAdapter(AnyFault)
    for name, kind in FAULTS.items():
        needed = {
            key: USUAL[key]
            for key, field in kind.model_fields.items()
            if field.is_required() and key != "kind"
        }
        assert type(read.validate_python({"kind": name, **needed})) is kind
