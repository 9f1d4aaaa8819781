"""The configuration written by a bring-up: node numbers, stroke, zeros, reduced limits; and the checklist."""

import numpy as np
import pytest
import yaml

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.context import Finding
from hil.lab.bringup.procedure import STEPS, checklist
from hil.lab.bringup.written_configuration import corrected, found_text
from tests.hil.lab.bringup.rehearsals import Rehearsal

LEGS = range(6)


@pytest.fixture(scope="module")
def machines():
    """Rehearsals by the name of their configuration; each test sets the facts."""
    return {name: Rehearsal(name) for name in ("virtual", "desktop")}


def fact(drive, tape_m=(0.25, 0.4), scale=1.0, offset_m=0.0):
    return {"drive": drive, "tape_m": list(tape_m), "scale": scale, "offset_m": offset_m, "bent_m": 0.0}


def written(machine, c, facts, *findings):
    """The written configuration as a mapping, for these facts about encoders."""
    machine.context.facts = {"encoder": {str(leg): fact for leg, fact in enumerate(facts)}}
    return yaml.safe_load(
        found_text(c, machine.context, [Finding(name, legs, "", "") for name, legs in findings])
    )


@pytest.mark.parametrize(
    ("drives", "nodes"),
    [
        ([0, 2, 4, 3, 1, 5], [6, 2, 5, 3, 4, 1]),
        ([0, 4, 1, 3, 2, 5], [6, 5, 4, 3, 2, 1]),
        ([3, 1, 2, 0, 4, 5], [3, 4, 2, 6, 5, 1]),
    ],
)
def test_written_node_number_of_each_leg_is_that_of_the_drive_that_measures_it(machines, drives, nodes):
    """drives: by leg. The configured node numbers are not in the order of the legs."""
    virtual = machines["virtual"]
    c = loads(with_changes(virtual.c.text, {"drives": {"node_ids": [6, 4, 2, 3, 5, 1]}}), "x")
    moved = tuple(leg for leg in LEGS if drives[leg] != leg)
    facts = [fact(drive, (0.75, 2.2)) for drive in drives]
    assert written(virtual, c, facts, ("ids", moved))["drives"]["node_ids"] == nodes


SCALES = (1.25, 0.8, 0.5, -1.0, -1.0, -1.0)
"""Scale of each reading, m per m by tape."""
OFFSETS_M = (4e-3, -3e-3, 0.0, 5e-3, -2e-3, 0.0)
"""Offset of each reading at the middle of its tape."""


def test_written_screw_lead_or_sign_makes_readings_agree_with_the_tape(machines):
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


MISREAD: dict[str, tuple[dict[int, int], tuple[str, ...], list[int]]] = {
    "each other's number": ({1: 4, 4: 1}, ("ids",), [0, 4, 2, 3, 1, 5]),
    "each other's encoder": ({0: 2, 2: 0}, ("encoder_crossed",), [0, 1, 2, 3, 4, 5]),
    "both": ({0: 2, 2: 0, 1: 4, 4: 1}, ("ids", "encoder_crossed"), [0, 4, 2, 3, 1, 5]),
}
"""Leg counted by each drive, names of the findings, and order of the written node numbers."""


@pytest.mark.parametrize("case", MISREAD)
def test_written_transmission_is_unchanged_if_drives_were_read_as_another_leg(machines, case):
    """Each was read with the other's sign, lead and zero, which are right after the exchange."""
    desktop, (reads, names, order) = machines["desktop"], MISREAD[case]
    desktop.context.facts = {
        "encoder": {str(leg): fact(drive, scale=-1.0, offset_m=2e-3) for drive, leg in reads.items()}
    }
    crossed = {"ids": (1, 4), "encoder_crossed": (0, 2)}
    first = [Finding(name, crossed[name], "", "") for name in names]
    others = [
        Finding(name, (next(iter(reads)),), "", "") for name in ("drive_reversed", "offset", "wrong_lead")
    ]
    c = desktop.c
    assert corrected(c, desktop.context, [*first, *others]) == [each for each in first if each.name == "ids"]
    assert corrected(c, desktop.context, others) == others
    found = loads(found_text(c, desktop.context, [*first, *others]), "found", c.folder)
    assert list(found.drives.node_ids) == [c.drives.node_ids[k] for k in order]
    assert found.drives.transmission == c.drives.transmission


def test_limits_of_a_configuration_written_by_a_bring_up_are_not_reduced_again(machines):
    virtual = machines["virtual"]
    c = virtual.c
    once = loads(found_text(c, virtual.context, []), "once", c.folder)
    assert once.limits.speed_m_s == 0.25 * c.limits.speed_m_s
    assert once.limits.following_error_m == 0.002
    assert once.engage.approach_speed_m_s <= 0.5 * once.limits.speed_m_s
    twice = loads(found_text(once, virtual.context, []), "twice", c.folder)
    assert (twice.limits, twice.engage) == (once.limits, once.engage)


@pytest.mark.parametrize("measured", [True, False])
def test_written_configuration_mentions_tape_lengths_only_if_any_were_measured(machines, measured):
    virtual = machines["virtual"]
    virtual.context.facts = {"encoder": {"0": fact(0)} if measured else {}}
    assert ("by tape" in found_text(virtual.c, virtual.context, [])) == measured


def test_checklist_marks_passed_failed_and_open_steps():
    rehearsal = Rehearsal("virtual", "encoder_sign leg=3")
    outcome = rehearsal.run(STEPS[:4])
    lines = checklist(rehearsal.context, outcome, ["[ ] together"])
    assert any(line.startswith("[x] scan") for line in lines)
    assert any(line.startswith("[!] encoder") for line in lines)
    assert any(line.startswith("[ ] force") for line in lines)
    assert any(line.startswith("    ! encoder_sign: leg 3: ") for line in lines)
