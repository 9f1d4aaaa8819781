"""The figures that a bring-up writes into a configuration: node numbers, stroke, zeros, first speed."""

import numpy as np
import pytest
import yaml

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup.context import Finding
from hil.lab.bringup.found import found_text
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.kit import Rehearsal

LEGS = range(6)


@pytest.fixture(scope="module")
def machines():
    """Rehearsals by the name of their configuration; what is known is set by each test."""
    return {name: Rehearsal(name, Wiring()) for name in ("virtual", "desktop")}


def fact(drive, tape_m=(0.25, 0.4), scale=1.0, offset_m=0.0):
    return {"drive": drive, "tape_m": list(tape_m), "scale": scale, "offset_m": offset_m, "bent_m": 0.0}


def written(machine, c, facts, *findings):
    """Return what is written, as a mapping, where encoders were found like that."""
    machine.context.facts = {"encoder": {str(leg): fact for leg, fact in enumerate(facts)}}
    return yaml.safe_load(
        found_text(c, machine.context, [Finding(name, legs, "", "") for name, legs in findings])
    )


@pytest.mark.parametrize(
    ("drives", "nodes"),
    [
        ([0, 2, 4, 3, 1, 5], [6, 2, 5, 3, 4, 1]),
        ([0, 4, 1, 3, 2, 5], [6, 5, 4, 3, 2, 1]),
        ([5, 0, 1, 2, 3, 4], [1, 6, 4, 2, 3, 5]),
        ([1, 2, 3, 4, 5, 0], [4, 2, 3, 5, 1, 6]),
        ([3, 1, 2, 0, 4, 5], [3, 4, 2, 6, 5, 1]),
    ],
)
def test_each_leg_gets_the_number_of_the_drive_that_counts_it_however_they_are_rotated(
    machines, drives, nodes
):
    """drives: of each leg. Numbers that are not in the order of the legs."""
    virtual = machines["virtual"]
    c = loads(with_changes(virtual.c.text, {"drives": {"node_ids": [6, 4, 2, 3, 5, 1]}}), "x")
    moved = tuple(leg for leg in LEGS if drives[leg] != leg)
    facts = [fact(drive, (0.75, 2.2)) for drive in drives]
    assert written(virtual, c, facts, ("ids", moved))["drives"]["node_ids"] == nodes


@pytest.mark.parametrize(("first", "last"), [(0, 3), (1, 5), (2, 0), (3, 3), (4, 1), (5, 2), (1, 4)])
def test_the_written_stroke_is_that_which_all_legs_reach(machines, first, last):
    """Leg `first` ends soonest as it gets shorter, leg `last` as it gets longer."""
    virtual = machines["virtual"]
    tapes = [
        (1.10 if leg == first else 0.80 - 0.01 * leg, 2.00 if leg == last else 2.15 + 0.01 * leg)
        for leg in LEGS
    ]
    facts = [fact(leg, tape_m) for leg, tape_m in enumerate(tapes)]
    stroke = written(virtual, virtual.c, facts, ("stroke", tuple(LEGS)))["platform"]
    assert (stroke["length_min_m"], stroke["length_max_m"]) == (1.101, 1.999)


SCALES = (1.25, 0.8, 0.5, -1.0, -1.0, -1.0)
"""m of reading a m by tape."""
OFFSETS_M = (4e-3, -3e-3, 0.0, 5e-3, -2e-3, 0.0)
"""What each leg reads too much at the middle of its tape."""


def test_with_a_corrected_lead_or_sign_each_leg_reads_the_tape_wherever_its_zero_is(machines):
    desktop = machines["desktop"]
    zeros = [0.30, 0.36, 0.29, 0.36, 0.28, 0.34]
    c = loads(with_changes(desktop.c.text, {"drives": {"transmission": {"offset_m": zeros}}}), "x")
    tapes = [(0.25 + 1e-3 * leg, 0.40 - 2e-3 * leg) for leg in LEGS]
    facts = [fact(leg, tapes[leg], SCALES[leg], OFFSETS_M[leg]) for leg in LEGS]
    gear = written(desktop, c, facts, ("wrong_lead", (0, 1, 2)), ("drive_reversed", (3, 4, 5)))["drives"][
        "transmission"
    ]
    signs, radius_m = (1, -1, 1, -1, 1, -1), 0.02
    for leg, (shortest, longest) in enumerate(tapes):
        middle = 0.5 * (shortest + longest)
        for tape in (shortest, middle, longest):
            read = middle + OFFSETS_M[leg] + SCALES[leg] * (tape - middle)
            turned_rad = (read - zeros[leg]) / (signs[leg] * radius_m)
            reads = gear["offset_m"][leg] + gear["sign"][leg] * gear["pulley_radius_m"][leg] * turned_rad
            assert reads == pytest.approx(tape, abs=1e-5), f"leg {leg} at {tape:g} m"
    assert np.abs(np.subtract(gear["offset_m"], zeros)).min() > 1e-3, "each zero has moved"


@pytest.mark.parametrize(("configured", "approach"), [(1.5, 0.25), (0.26, 0.25), (0.2, 0.2), (0.05, 0.05)])
def test_the_first_approach_is_at_most_half_of_the_reduced_speed_and_no_faster_than_configured(
    machines, configured, approach
):
    """A quarter of the configured 2 m/s is 0.5 m/s."""
    c = loads(with_changes(load("virtual").text, {"engage": {"approach_speed_m_s": configured}}), "x")
    found = written(machines["virtual"], c, [])
    assert found["limits"]["speed_m_s"] == 0.5
    assert found["engage"]["approach_speed_m_s"] == approach
