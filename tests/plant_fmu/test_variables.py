"""The variables of our FMU: size, first value, range and place of each, as documented and as its C code has them."""

from __future__ import annotations

import re
from math import cos, radians, sin

import pytest

from plant_fmu.stewart.variables import (
    INTERNAL_STEP,
    STEP_SIZE,
    TYPES,
    VARIABLES,
    element_name,
    header,
    tables,
    type_of,
)

ZEROS, EYE = [0.0] * 6, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
FREE, POSITIVE, SHARE = (None, None), (0.0, None), (0.0, 1.0)


def ring(radius: float, *degrees: float) -> list[float]:
    return [x for a in degrees for x in (radius * cos(radians(a)), radius * sin(radians(a)), 0.0)]


Row = tuple[str, tuple[int, ...], list[float] | None, tuple[float | None, float | None]]
TABLE: dict[str, Row] = {
    "time": ("independent", (), None, FREE),
    "base_joints": ("parameter", (6, 3), ring(2.0, 0, 60, 120, 180, 240, 300), FREE),
    "platform_joints": ("parameter", (6, 3), ring(1.0, 30, 30, 150, 150, 270, 270), FREE),
    "mass": ("parameter", (), [1150.0], POSITIVE),
    "com": ("parameter", (3,), [0.0] * 3, FREE),
    "inertia": ("parameter", (3, 3), [570.0, 0.0, 0.0, 0.0, 285.0, 0.0, 0.0, 0.0, 285.0], FREE),
    "cylinder_mass": ("parameter", (), [85.0], POSITIVE),
    "cylinder_com": ("parameter", (), [0.75], POSITIVE),
    "cylinder_inertia": ("parameter", (2,), [0.0, 16.0], POSITIVE),
    "rod_mass": ("parameter", (), [22.0], POSITIVE),
    "rod_com": ("parameter", (), [0.75], POSITIVE),
    "rod_inertia": ("parameter", (2,), [0.0, 4.1], POSITIVE),
    "gravity": ("parameter", (3,), [0.0, 0.0, -9.81], FREE),
    "leg_spin": ("parameter", (), [1.0], (1.0, 2.0)),
    "universal_joint_base_axes": ("parameter", (6, 3), [0.0, 0.0, 1.0] * 6, FREE),
    "force_bandwidth": ("parameter", (), [0.0], POSITIVE),
    "viscous_friction": ("parameter", (6,), ZEROS, POSITIVE),
    "coulomb_friction": ("parameter", (6,), ZEROS, POSITIVE),
    "reflected_mass": ("parameter", (6,), ZEROS, POSITIVE),
    "length_min": ("parameter", (6,), ZEROS, POSITIVE),
    "length_max": ("parameter", (6,), [1e6] * 6, POSITIVE),
    "stop_stiffness": ("parameter", (), [2e7], (1.0, None)),
    "stop_damping": ("parameter", (), [1e5], POSITIVE),
    "brake_force": ("parameter", (6,), [20_000.0] * 6, POSITIVE),
    "initial_position": ("parameter", (3,), [0.0, 0.0, 1.0], FREE),
    "initial_rotation": ("parameter", (3, 3), EYE, FREE),
    "initial_twist": ("parameter", (6,), ZEROS, FREE),
    "internal_step": ("parameter", (), [1e-4], FREE),
    "force": ("input", (6,), ZEROS, FREE),
    "brake": ("input", (6,), [1.0] * 6, SHARE),
    "wrench": ("input", (6,), ZEROS, FREE),
    "length": ("output", (6,), None, FREE),
    "rate": ("output", (6,), None, FREE),
    "applied_force": ("output", (6,), None, FREE),
    "position": ("output", (3,), None, FREE),
    "rotation": ("output", (3, 3), None, FREE),
    "twist": ("output", (6,), None, FREE),
    "acceleration": ("output", (6,), None, FREE),
    "kinetic_energy": ("output", (), None, FREE),
    "potential_energy": ("output", (), None, FREE),
}
"""Name -> causality, shape, first values (the platform of Taghirad, Parallel Robots, chapter 5), least and most."""
MIXED = {
    "initial_twist": ("Velocity", "AngularVelocity"),
    "wrench": ("Force", "Torque"),
    "twist": ("Velocity", "AngularVelocity"),
    "acceleration": ("Acceleration", "AngularAcceleration"),
}


def ends(kind: str) -> tuple[float | None, float | None]:
    return TYPES[kind].min, TYPES[kind].max


def count(shape: tuple[int, ...]) -> int:
    return {(): 1, (2,): 2, (3,): 3, (6,): 6, (3, 3): 9, (6, 3): 18}[shape]


def test_variables_have_the_documented_causality_shape_first_value_and_range():
    found = {
        v.name: (v.causality, v.shape, None if v.start is None else [float(x) for x in v.start], ends(v.type))
        for v in VARIABLES
    }
    assert list(found) == list(TABLE)
    for name, row in TABLE.items():
        assert found[name] == row, name
    assert {v.name: v.size for v in VARIABLES} == {name: count(row[1]) for name, row in TABLE.items()}
    assert (INTERNAL_STEP, STEP_SIZE) == (1e-4, 1e-3)


def test_of_six_mixed_components_the_first_three_are_linear_and_the_others_angular():
    for v in VARIABLES:
        kinds = [type_of(v, k) for k in range(v.size)]
        linear, angular = MIXED.get(v.name, (v.type, v.type))
        assert kinds == ([linear] * 3 + [angular] * 3 if v.name in MIXED else [linear] * v.size), v.name


def test_elements_are_named_by_row_and_column_from_1():
    by_name = {v.name: v for v in VARIABLES}
    assert element_name(by_name["mass"], 0) == "mass"
    assert [element_name(by_name["com"], k) for k in range(3)] == ["com[1]", "com[2]", "com[3]"]
    for name, rows in (("inertia", 3), ("base_joints", 6)):
        names = [f"{name}[{i},{j}]" for i in range(1, rows + 1) for j in (1, 2, 3)]
        assert [element_name(by_name[name], k) for k in range(3 * rows)] == names


def test_the_c_tables_have_each_variable_at_its_place_with_its_range_and_first_values():
    head, body = header(), tables("{a token}")
    starts = list(range(len(TABLE)))
    at = 0
    for k, row in enumerate(TABLE.values()):
        starts[k] = at
        at += count(row[1])
    assert re.findall(r"#define (\w+) (\d+)", head) == [
        ("N_VARIABLES", str(len(TABLE))),
        ("N_VALUES", str(at)),
    ]
    members = re.findall(r"^    double (\w+)(?:\[(\d+)\])?;$", head, re.MULTILINE)
    assert members == [(name, str(count(row[1])) if row[1] else "") for name, row in TABLE.items()]
    rows = re.findall(r"\{(\d+), (\d+), (\w+), (\w+), ([^,]+), ([^,}]+)\}", body)
    for (name, row), place, found in zip(TABLE.items(), starts, rows, strict=True):
        kind = "ENUMERATION" if name == "leg_spin" else "FLOAT64"
        assert found[:4] == (str(place), str(count(row[1])), row[0].upper(), kind), name
        assert [float(x) for x in found[4:]] == [
            -1e308 if row[3][0] is None else row[3][0],
            1e308 if row[3][1] is None else row[3][1],
        ]
    (values,) = re.findall(r"START\[N_VALUES\] = \{(.*)\};", body)
    expected = [x for _, shape, start, _ in TABLE.values() for x in start or [0.0] * count(shape)]
    assert [float(x) for x in values.split(", ")] == expected
    (names,) = re.findall(r"NAMES\[N_VALUES\] = \{(.*)\};", body)
    elements = [f'"{element_name(v, k)}"' for v in VARIABLES for k in range(v.size)]
    assert re.findall(r'"[^"]*"', names) == elements
    (owners,) = re.findall(r"OWNER\[N_VALUES\] = \{(.*)\};", body)
    belongs = [k for k, row in enumerate(TABLE.values()) for _ in range(count(row[1]))]
    assert [int(x) for x in owners.split(", ")] == belongs
    assert 'TOKEN[] = "{a token}";' in body


@pytest.mark.parametrize("name", ["initial_position", "initial_rotation", "base_joints"])
def test_every_text_of_a_first_value_is_read_back_to_the_bit(name):
    (values,) = re.findall(r"START\[N_VALUES\] = \{(.*)\};", tables(""))
    place = sum(count(TABLE[each][1]) for each in list(TABLE)[: list(TABLE).index(name)])
    start = TABLE[name][2]
    assert start is not None
    found = values.split(", ")[place : place + len(start)]
    assert [float(x).hex() for x in found] == [x.hex() for x in start]
