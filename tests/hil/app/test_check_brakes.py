"""What `hil check` says of the emulated brakes."""

from __future__ import annotations

import pytest

from hil.app.check.command import inspect
from hil.app.configuration.configuration import Configuration, load

pytestmark = pytest.mark.usefixtures("unproven")

HOLDS_N = 3619
"""What the legs of `virtual` carry at rest, at most."""


def emulated(name: str, model: dict[str, float], drives: dict[str, float]) -> Configuration:
    c = load(name)
    assert c.plant is not None
    plant = {
        "model": c.plant.model.model_copy(update=model),
        "drives": c.plant.drives.model_copy(update=drives),
    }
    return c.model_copy(update={"plant": c.plant.model_copy(update=plant)})


def warned(c: Configuration) -> list[str]:
    return [each for each in inspect(c).warnings if each.startswith("plant.")]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("virtual", "emulated brakes hold 20000 N each, open in 50 ms, close in 30 ms"),
        ("bench", "emulated brakes open in 50 ms, close in 30 ms"),
        ("socketcan", None),
    ],
)
def test_force_and_times_of_emulated_brakes_are_printed(name, told):
    lines = [line for line in inspect(load(name)).sections["drives"] if "emulated" in line]
    assert lines == ([] if told is None else [told])


@pytest.mark.parametrize("force_N", [HOLDS_N + 1, HOLDS_N - 1])
def test_emulated_brakes_that_slip_under_the_weight_are_warned_of(force_N):
    found = warned(emulated("virtual", {"brake_force_N": force_N}, {}))
    assert len(found) == (force_N < HOLDS_N)
    assert all(
        each.startswith(f"plant.model.brake_force_N {force_N} is below the 3.62e+03 N") for each in found
    )


@pytest.mark.parametrize(
    ("drives", "keys"),
    [
        ({"brake_open_ms": 0.1, "brake_close_ms": 0.1}, ""),
        ({"brake_open_ms": 0.0, "brake_close_ms": 0.1}, "plant.drives.brake_open_ms 0: "),
        ({"brake_open_ms": 0.0, "brake_close_ms": 0.0}, "plant.drives.brake_open_ms and plant.drives.brake_close_ms 0: "),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["virtual", "bench", "ideal"])
def test_emulated_brakes_that_take_no_time_are_warned_of_where_time_counts(name, drives, keys):
    found = warned(emulated(name, {}, drives))
    if name == "ideal" or not keys:
        assert found == []
    else:
        assert [each.startswith(keys) for each in found] == [True]
