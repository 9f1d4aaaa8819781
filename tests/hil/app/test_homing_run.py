"""`hil run` and the homing file: the file of the drives that it runs, marked while brakes may open."""

from __future__ import annotations

import contextlib
import errno
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import DriveState, Fault, Mode
from drivers.tick_columns import new_record
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.homing import keeping
from hil.app.homing.command import state_homing
from hil.app.homing.file import HomingFile, read_homing, write_homing
from hil.app.homing.keeping import Keeper
from hil.app.run import command
from hil.loop.homing import LastPose
from tests.hil.app.test_homing import configuration, state

LENGTHS = [0.31, 0.32, 0.33, 0.34, 0.35, 0.36]

FILES = {False: "real.yaml", True: "bench.yaml"}

"""Of real and of emulated drives."""


class EndsHere(BaseException):
    """The process dies as the loop begins."""


def cycle_of(**changes: Any) -> Any:
    """Return what a keeper asks of a cycle: six drives that are off, at rest, measured and known."""
    state = changes.pop("drive_state", int(DriveState.OFF))
    tick = {
        "age": np.zeros(6, int),
        "rate": np.zeros(6),
        "length": np.array(LENGTHS) + 0.005,
        "drive_state": np.full(6, state),
    }
    homing = SimpleNamespace(known=True, opened=True, raw=np.array(LENGTHS))
    there = {
        "tick": tick | changes.pop("tick", {}),
        "homing": homing,
        "faults": Fault(0),
        "mode": Mode.PARKED,
    }
    parts = SimpleNamespace(trajectory=SimpleNamespace(duration_s=1.0))
    return SimpleNamespace(parts=parts, **there | changes)


@pytest.fixture
def stated(tmp_path: Path) -> Configuration:
    """Drives of both kinds, whose files say other lengths."""
    c = configuration(tmp_path)
    state_homing(c, emulated=False, lengths_m=LENGTHS)
    state_homing(c, emulated=True, lengths_m=LENGTHS[::-1])
    return c


@contextlib.contextmanager
def sockets(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


def states(c: Configuration) -> dict[bool, str]:
    return {emulated: read_homing(c, c.folder / name).state for emulated, name in FILES.items()}


@contextlib.contextmanager
def nothing(*_: Any, **__: Any) -> Any:
    yield SimpleNamespace(event=lambda *_: None)


def stand_in(monkeypatch: pytest.MonkeyPatch, build_cycle: Callable[..., Any]) -> None:
    """Let a run have that cycle, and neither recorder nor plant."""
    for name in ("record", "SupervisedPlant"):
        monkeypatch.setattr(command, name, nothing)
    monkeypatch.setattr(command, "select_rate", lambda *_, **__: (400.0, 0.01))
    monkeypatch.setattr(command, "build_cycle", build_cycle)
    monkeypatch.setattr(command, "make_room", lambda *_: [])


@pytest.mark.parametrize("with_plant", [False, True])
def test_a_run_reads_the_file_of_its_own_drives_and_marks_it_alone_before_the_loop_begins(
    stated: Configuration, monkeypatch: pytest.MonkeyPatch, with_plant: bool
) -> None:
    told: list[LastPose] = []
    during: list[dict[bool, str]] = []
    cycle = cycle_of(tick={"age": np.full(6, 99)})

    def build_cycle(*_: Any, last_pose: LastPose) -> Any:
        told.append(last_pose)
        return cycle

    def begins(*_: Any) -> Any:
        during.append(states(stated))
        raise EndsHere

    stand_in(monkeypatch, build_cycle)
    monkeypatch.setattr(command, "real_time", begins)
    for opened in (False, True):
        cycle.homing.opened = opened
        with sockets(monkeypatch), pytest.raises(EndsHere):
            command.run_daemon(stated, with_plant=with_plant, arm=True, draw=False)
        left = "moved" if opened else "stated"
        assert states(stated) == {with_plant: left, not with_plant: "stated"}
    assert during == [{with_plant: "moved", not with_plant: "stated"}] * 2
    expected = LENGTHS[::-1] if with_plant else LENGTHS
    assert [pose.length.tolist() for pose in told] == [expected] * 2


def pressed(monkeypatch: pytest.MonkeyPatch, which: int, moment: str) -> list[str]:
    """Let Ctrl-C come as the file is written for that time, before it is there or behind; what is written."""
    written: list[str] = []

    def write(c: Configuration, path: Path, file: HomingFile) -> None:
        written.append(file.state)
        if len(written) == which and moment == "before":
            raise KeyboardInterrupt
        write_homing(c, path, file)
        if len(written) == which and moment == "behind":
            raise KeyboardInterrupt

    monkeypatch.setattr(keeping, "write_homing", write)
    return written


MOMENTS = pytest.mark.parametrize("moment", ["before", "behind"])


@MOMENTS
@pytest.mark.parametrize("with_plant", [False, True])
def test_an_interrupt_as_a_run_marks_its_file_leaves_it_as_it_was(
    stated: Configuration, monkeypatch: pytest.MonkeyPatch, with_plant: bool, moment: str
) -> None:
    cycle = cycle_of(tick={"age": np.full(6, 99)})
    cycle.homing.opened = False
    stand_in(monkeypatch, lambda *_, **__: cycle)
    written = pressed(monkeypatch, 1, moment)
    with sockets(monkeypatch), pytest.raises(KeyboardInterrupt, match="nothing has moved"):
        command.run_daemon(stated, with_plant=with_plant, arm=True, draw=False)
    assert written == ["moved", "stated"]
    assert states(stated) == {False: "stated", True: "stated"}


@pytest.mark.parametrize(
    "changes",
    [
        {"mode": Mode.TRACKING},
        {"faults": Fault.ENCODER},
        {"drive_state": int(DriveState.RUN)},
        {"tick": {"age": np.array([0, 0, 0, 0, 0, 6])}},
        {"homing": SimpleNamespace(known=False, opened=True, raw=np.zeros(6))},
    ],
    ids=["not at its end", "an encoder is not believed", "powered", "not heard lately", "turns not known"],
)
def test_a_run_that_does_not_know_where_it_left_the_legs_stays_marked(
    stated: Configuration, changes: dict[str, Any]
) -> None:
    keeper = Keeper(stated, emulated=False)
    keeper.begin(cycle_of(**changes))
    keeper.close()
    assert states(stated) == {False: "moved", True: "stated"}


@pytest.mark.parametrize(
    "drives",
    [
        {"node_ids": [2, 1, 3, 4, 5, 6]},
        {"node_ids": [1, 2, 3, 4, 6, 5]},
        {"transmission": {"offset_m": 0.301}},
        {"transmission": {"sign": [1, 1, 1, 1, 1, -1]}},
        {"options": {"position_rad": 20.0}},
        {"homing": {"forgotten_turns": 0.05}},
    ],
    ids=str,
)
def test_a_file_is_not_believed_once_a_leg_has_other_turns_by_number_gear_or_field(
    stated: Configuration, drives: dict[str, Any]
) -> None:
    other = loads(with_changes(stated.text, {"name": "desktop", "drives": drives}), "desktop", stated.folder)
    for emulated in (False, True):
        assert Keeper(stated, emulated=emulated).last_pose is not None
        with pytest.raises(ConfigurationError, match="another robot"):
            Keeper(other, emulated=emulated)


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
