"""The configuration that a bring-up writes: node numbers, stroke, zeros, reduced limits; and the checklist."""

import numpy as np
import pytest
import yaml

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.checklist import checklist
from hil.lab.bringup.context import Finding
from hil.lab.bringup.found import found_text, mended
from hil.lab.bringup.procedure import STEPS
from tests.hil.lab.bringup.kit import Rehearsal

LEGS = range(6)


@pytest.fixture(scope="module")
def machines():
    """Rehearsals by the name of their configuration; what is known is set by each test."""
    return {name: Rehearsal(name) for name in ("virtual", "desktop")}


def fact(drive, tape_m=(0.25, 0.4), scale=1.0, offset_m=0.0):
    return {"drive": drive, "tape_m": list(tape_m), "scale": scale, "offset_m": offset_m, "bent_m": 0.0}


def written(machine, c, facts, *findings):
    """What is written, as a mapping, where encoders were found like that."""
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
def test_each_leg_gets_the_number_of_the_drive_that_counts_it(machines, drives, nodes):
    """drives: of each leg. Numbers that are not in the order of the legs."""
    virtual = machines["virtual"]
    c = loads(with_changes(virtual.c.text, {"drives": {"node_ids": [6, 4, 2, 3, 5, 1]}}), "x")
    moved = tuple(leg for leg in LEGS if drives[leg] != leg)
    facts = [fact(drive, (0.75, 2.2)) for drive in drives]
    assert written(virtual, c, facts, ("ids", moved))["drives"]["node_ids"] == nodes


SCALES = (1.25, 0.8, 0.5, -1.0, -1.0, -1.0)
"""m of reading a m by tape."""
OFFSETS_M = (4e-3, -3e-3, 0.0, 5e-3, -2e-3, 0.0)
"""What each leg reads too much at the middle of its tape."""


def test_with_a_corrected_lead_or_sign_each_leg_reads_the_tape(machines):
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


def test_exchanged_numbers_alone_are_fixed_in_the_file():
    """Drives 1 and 4 were read with each other's sign: exchanged, they are right."""
    rehearsal = Rehearsal("desktop")
    c = rehearsal.c
    facts = {
        str(leg): {"drive": drive, "tape_m": [0.25, 0.4], "scale": -1.0, "offset_m": 0.0, "bent_m": 0.0}
        for leg, drive in ((1, 4), (4, 1))
    }
    rehearsal.context.facts["encoder"] = facts
    findings = [
        Finding("ids", (1, 4), "exchanged", ""),
        Finding("drive_reversed", (1,), "", ""),
        Finding("offset", (4,), "", ""),
        Finding("wrong_lead", (4,), "", ""),
    ]
    assert mended(c, rehearsal.context, findings) == findings[:1]
    assert mended(c, rehearsal.context, findings[1:]) == findings[1:]
    found = loads(found_text(c, rehearsal.context, findings), "found", c.folder)
    n = list(c.drives.node_ids)
    assert list(found.drives.node_ids) == [n[0], n[4], n[2], n[3], n[1], n[5]]
    assert found.drives.transmission == c.drives.transmission


def test_crossed_encoder_cables_change_no_transmission_in_the_file():
    """Drives 0 and 2 have each other's encoder, drives 1 and 4 each other's number."""
    rehearsal = Rehearsal("desktop")
    c = rehearsal.c
    reads = {0: 2, 2: 0, 1: 4, 4: 1}
    rehearsal.context.facts["encoder"] = {
        str(leg): {"drive": drive, "tape_m": [0.25, 0.4], "scale": -1.0, "offset_m": 2e-3, "bent_m": 0.0}
        for drive, leg in reads.items()
    }
    crossed = Finding("encoder_crossed", (0, 2), "crossed", "")
    others = [Finding("offset", (0,), "", ""), Finding("drive_reversed", (2,), "", "")]
    exchanged = Finding("ids", (1, 4), "exchanged", "")
    for findings, done in (([crossed, *others], []), ([exchanged, crossed, *others], [exchanged])):
        assert mended(c, rehearsal.context, findings) == done
        found = loads(found_text(c, rehearsal.context, findings), "found", c.folder)
        n = list(c.drives.node_ids)
        assert list(found.drives.node_ids) == ([n[0], n[4], n[2], n[3], n[1], n[5]] if done else n)
        assert found.drives.transmission == c.drives.transmission


def test_limits_are_reduced_once_however_often_the_file_is_given(machines):
    virtual = machines["virtual"]
    c = virtual.c
    once = loads(found_text(c, virtual.context, []), "once", c.folder)
    assert once.limits.speed_m_s == 0.25 * c.limits.speed_m_s
    assert once.limits.following_error_m == 0.0025
    assert once.engage.approach_speed_m_s <= 0.5 * once.limits.speed_m_s
    twice = loads(found_text(once, virtual.context, []), "twice", c.folder)
    assert (twice.limits, twice.engage) == (once.limits, once.engage)


def test_checklist_marks_what_passed_and_what_was_found():
    rehearsal = Rehearsal("virtual", "encoder_sign leg=3")
    outcome = rehearsal.run(STEPS[:4])
    lines = checklist(rehearsal.context, outcome, ["[ ] together"])
    assert any(line.startswith("[x] scan") for line in lines)
    assert any(line.startswith("[!] encoder") for line in lines)
    assert any(line.startswith("[ ] force") for line in lines)
    assert any(line.startswith("    ! encoder_sign: leg 3: ") for line in lines)
