"""A run's last lengths are written as parked where every leg was measured and believed, and else are not."""

import errno
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.signals import DriveState, Fault, Mode
from drivers.tick_columns import new_record
from hil.app.homing.file import read_homing
from hil.app.homing.keeping import Keeper
from tests.hil.app.test_homing import configuration, state

NOT_BELIEVED = (
    Fault.STALE,
    Fault.KINEMATICS,
    Fault.ASSEMBLY,
    Fault.CONDITION,
    Fault.NOT_FINITE,
    Fault.LAW,
    Fault.ENCODER,
    Fault.UNCERTAIN,
    Fault.DUPLICATE_NODE,
)
BELIEVED = (Fault.NONE, Fault.DRIVE, Fault.STROKE, Fault.SPEED, Fault.FOLLOWING, Fault.ESTOP, Fault.BRAKE)


def kept(c, mode, fault, *, known=True, opened=True):
    """The keeper of a run whose legs rest, which has begun."""
    state(c)
    tick = new_record()
    tick["age"], tick["rate"], tick["length"] = 0, 0.0, 0.33
    tick["drive_state"] = DriveState.OFF
    homing = SimpleNamespace(known=known, raw=np.full(6, 0.5), opened=opened)
    keeper = Keeper(c, emulated=True)
    keeper.begin(SimpleNamespace(tick=tick, homing=homing, faults=fault, mode=mode))  # type: ignore[arg-type]
    return keeper


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """A function that ends a run whose legs rest, with a fault and one more change; the file's state."""
    folder = tmp_path_factory.mktemp("rest")
    c = configuration(folder)

    def end(fault, *, known=True):
        kept(c, Mode.FAULT if fault else Mode.PARKED, fault, known=known).close()
        return read_homing(c, folder / "bench.yaml")

    return end


@pytest.mark.parametrize("fault", NOT_BELIEVED)
def test_lengths_that_a_fault_has_made_doubtful_are_not_believed_by_the_next_run(ended, fault):
    assert ended(fault).state == "moved"
    assert ended(fault | Fault.ESTOP).state == "moved"


@pytest.mark.parametrize("fault", BELIEVED)
def test_lengths_at_rest_after_another_fault_are_kept(ended, fault):
    file = ended(fault)
    assert (file.state, list(file.lengths_m)) == ("parked", [0.33] * 6)


@pytest.mark.parametrize("opened", [True, False])
def test_a_run_whose_homing_file_cannot_be_written_in_the_end_is_told_and_the_file_stays_marked(
    tmp_path, monkeypatch, opened
):
    def full(path, _):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    c = configuration(tmp_path)
    keeper = kept(c, Mode.PARKED if opened else Mode.LOADING, Fault.NONE, opened=opened)
    assert keeper.trouble == ""
    monkeypatch.setattr("hil.app.configuration.section_file.write_whole", full)
    keeper.close()
    assert "bench.yaml: cannot be written: No space left on device" in keeper.trouble
    assert read_homing(c, tmp_path / "bench.yaml").state == "moved"


def test_legs_whose_turns_were_never_found_are_not_written_as_parked(ended):
    assert ended(Fault.NONE, known=False).state == "moved"
