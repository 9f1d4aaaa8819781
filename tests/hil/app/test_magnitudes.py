"""Numbers whose square or inverse no float holds: refused with their place, whichever they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.yaml_positions import path_text
from tests.broad import broad

CONFIGS = Path(load("virtual").source).parent


def numbers(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value[:1]):
            yield from numbers(each, (*path, key))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


def changed(text: str, path: tuple[str | int, ...], number: float) -> str:
    value = place = yaml.load(text, yaml.CSafeLoader)
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = number
    return str(yaml.dump(value, Dumper=yaml.CSafeDumper))


TEXTS = {name: load(name).text for name in ("virtual", "lab")}
PLACES = [(name, path) for name, text in TEXTS.items() for path in numbers(yaml.safe_load(text))]


@pytest.mark.parametrize(
    "number", broad([-1.1e30, 0.9e-60, 2 * 10**30, 10**300], quick=1), ids="{:.2g}".format
)
def test_an_absurd_number_is_refused_wherever_it_stands(number):
    assert len(PLACES) > 50
    for name, path in PLACES:
        with pytest.raises(ConfigurationError) as refused:
            loads(changed(TEXTS[name], path, number), "a.yaml", CONFIGS)
        assert f": {path_text(path)}: " in str(refused.value), (name, path)


def test_a_limit_of_1e30_stands_for_none():
    text = changed(load("virtual").text, ("limits", "condition"), 1e30)
    assert loads(text, "a.yaml", CONFIGS).limits.condition == 1e30


@pytest.mark.parametrize(("number", "taken"), [(1e15, True), (1e-60, True), (0.0, True), (10**15, True)])
def test_the_last_number_within_reason_is_judged_by_its_own_bounds_alone(number, taken):
    path = ("plant", "drives", "damping_N_s_m")
    assert loads(changed(load("virtual").text, path, number), "a.yaml", CONFIGS).plant is not None


def test_all_of_them_are_told_at_once_and_beside_other_mistakes():
    text = changed(load("virtual").text, ("controller", "wn_rad_s"), 1e200)
    text = changed(text, ("engage", "stop_s"), 1e-200).replace("name:", "nome:", 1)
    with pytest.raises(ConfigurationError) as refused:
        loads(text, "a.yaml", CONFIGS)
    told = str(refused.value)
    assert "controller.wn_rad_s: allowed in size: 0, and 1e-60 to 1e+15, given: 1e+200" in told
    assert "engage.stop_s: allowed in size" in told
    assert "nome" in told


def test_a_parameter_of_a_foreign_fmu_may_have_any_size():
    plant = "plant: {model: {type: fmu, path: a.fmu, force: [a, b, c, d, e, f], length: [g, h, i, j, k, l], rate: [m, n, o, p, q, r], parameters: {x: 1.0e-30, y: 1.0e+30}}}\n"
    text = load("virtual").text
    kept = yaml.safe_load(text)
    kept.pop("plant")
    with pytest.raises(ConfigurationError) as refused:
        loads(yaml.safe_dump(kept) + plant + "zzz: 1\n", "a.yaml")
    assert "allowed in size" not in str(refused.value)
