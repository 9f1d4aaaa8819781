"""A second controller is found whenever it sends during the scan, and its drives are left alone."""

import pytest

from drivers.signals import DriveState, Foreign
from hil.lab.bringup.steps import scan
from tests.hil.lab.bringup.rehearsals import Rehearsal, named


def disturbed(at, name="virtual"):
    """A machine with foreign frames on its bus in some ticks; at: tick -> kind."""
    rehearsal = Rehearsal(name)
    step = rehearsal.drives.step

    def heard(*arguments, **options):
        record = step(*arguments, **options)
        record["foreign"] = at.get(rehearsal.drives.tick, 0)
        return record

    rehearsal.drives.step = heard  # type: ignore[method-assign]
    return rehearsal


def last(name):
    rehearsal = Rehearsal(name)
    return rehearsal.drives.ticks(scan.LISTEN_S) - 1


@pytest.mark.parametrize("name", ["virtual", "desktop"])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_one_frame_of_another_controller_is_found_in_any_tick(name, share):
    rehearsal = disturbed({round(share * last(name)): int(Foreign.COMMAND)}, name)
    outcome = rehearsal.run((scan.STEP,))
    assert named(outcome) == {("second_controller", ())}


@pytest.mark.parametrize("what", [f for f in Foreign if f])
def test_drives_of_another_controller_are_neither_reset_nor_set_up(what):
    rehearsal, set_up = disturbed({5: int(what)}), list[object]()
    rehearsal.drives.prepare = lambda leg: set_up.append(leg) or ("",) * 6  # type: ignore[func-returns-value]
    scan.find(rehearsal.context)
    assert set_up == []
    states = [DriveState(int(s)) for s in rehearsal.bench.nodes.snapshot().state]
    assert states == [DriveState.BOOT] * 6
