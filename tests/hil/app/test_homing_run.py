"""Homing file in a run: marked while brakes may open, `parked` only with known lengths."""

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
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.homing import keeper
from hil.app.homing.command import state_homing
from hil.app.homing.file import HomingFile, read_homing, write_homing
from hil.app.homing.keeper import Keeper
from hil.app.run import command
from hil.loop.homing import LastPose
from tests.hil.app.test_homing import configuration

LENGTHS = [0.31, 0.32, 0.33, 0.34, 0.35, 0.36]
FILES = {False: "real.yaml", True: "bench.yaml"}
"""Files of the real and of the emulated drives."""


class EndsHere(BaseException):
    """Death of the process at the start of the loop."""


def cycle_of(**changes: Any) -> Any:
    """Cycle for a keeper: six drives that are off, at rest, measured and known."""
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
    """Drives of both kinds, with different lengths in their files."""
    c = configuration(tmp_path)
    state_homing(c, emulated=False, lengths_m=LENGTHS)
    state_homing(c, emulated=True, lengths_m=LENGTHS[::-1])
    return c


@contextlib.contextmanager
def sockets(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Short runtime folder: the path of a socket has at most 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


def states(c: Configuration) -> dict[bool, str]:
    return {emulated: read_homing(c, c.folder / name).state for emulated, name in FILES.items()}


@contextlib.contextmanager
def nothing(*_: Any, **__: Any) -> Any:
    yield SimpleNamespace(event=lambda *_: None)


def stand_in(monkeypatch: pytest.MonkeyPatch, build_cycle: Callable[..., Any]) -> None:
    """Run with the given cycle, without recorder and plant."""
    for name in ("record", "SupervisedPlant"):
        monkeypatch.setattr(command, name, nothing)
    monkeypatch.setattr(command, "select_rate", lambda *_, **__: (400.0, 0.01))
    monkeypatch.setattr(command, "build_cycle", build_cycle)
    monkeypatch.setattr(command, "make_room", lambda *_: [])


@pytest.mark.parametrize("with_plant", [False, True])
def test_run_marks_the_homing_file_of_its_drives_as_moved_before_the_loop(
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


def pressed(monkeypatch: pytest.MonkeyPatch, moment: str) -> list[str]:
    """Press Ctrl-C just before or just after the first write of the file; return the written states."""
    written: list[str] = []

    def write(c: Configuration, path: Path, file: HomingFile) -> None:
        written.append(file.state)
        if len(written) == 1 and moment == "before":
            raise KeyboardInterrupt
        write_homing(c, path, file)
        if len(written) == 1 and moment == "behind":
            raise KeyboardInterrupt

    monkeypatch.setattr(keeper, "write_homing", write)
    return written


@pytest.mark.parametrize("moment", ["before", "behind"])
@pytest.mark.parametrize("with_plant", [False, True])
def test_interrupt_while_the_homing_file_is_marked_restores_its_state(
    stated: Configuration, monkeypatch: pytest.MonkeyPatch, with_plant: bool, moment: str
) -> None:
    cycle = cycle_of(tick={"age": np.full(6, 99)})
    cycle.homing.opened = False
    stand_in(monkeypatch, lambda *_, **__: cycle)
    written = pressed(monkeypatch, moment)
    with sockets(monkeypatch), pytest.raises(KeyboardInterrupt, match="nothing has moved"):
        command.run_daemon(stated, with_plant=with_plant, arm=True, draw=False)
    assert written == ["moved", "stated"]
    assert states(stated) == {False: "stated", True: "stated"}


NOT_BELIEVED = (
    Fault.STALE, Fault.KINEMATICS, Fault.ASSEMBLY, Fault.CONDITION, Fault.NOT_FINITE, Fault.LAW, Fault.ENCODER,
    Fault.UNCERTAIN, Fault.DUPLICATE_NODE,
)  # fmt: skip
BELIEVED = (Fault.NONE, Fault.DRIVE, Fault.STROKE, Fault.SPEED, Fault.FOLLOWING, Fault.ESTOP, Fault.BRAKE)
UNKNOWN: dict[str, dict[str, Any]] = {
    "not at its end": {"mode": Mode.TRACKING},
    "powered": {"drive_state": int(DriveState.RUN)},
    "not heard lately": {"tick": {"age": np.array([0, 0, 0, 0, 0, 6])}},
    "a leg moves": {"tick": {"rate": np.array([0, 0, 0, 0, 0, -0.1])}},
    "turns not known": {"homing": SimpleNamespace(known=False, opened=True, raw=np.zeros(6))},
    **{f"fault {fault.name}": {"mode": Mode.FAULT, "faults": fault} for fault in NOT_BELIEVED},
    "fault and stop": {"mode": Mode.FAULT, "faults": Fault.ENCODER | Fault.ESTOP},
}


def ended(c: Configuration, changes: dict[str, Any]) -> HomingFile:
    """File of the real drives after a run with these changes."""
    keeper = Keeper(c, emulated=False)
    keeper.begin(cycle_of(**changes))
    assert states(c) == {False: "moved", True: "stated"}
    keeper.close()
    assert states(c)[True] == "stated"
    return read_homing(c, c.folder / FILES[False])


@pytest.mark.parametrize("why", UNKNOWN)
def test_homing_file_stays_marked_as_moved_if_the_final_leg_lengths_are_unknown(stated, why):
    assert ended(stated, UNKNOWN[why]).state == "moved"


@pytest.mark.parametrize("fault", BELIEVED)
def test_homing_file_gets_the_leg_lengths_at_rest_after_a_fault_that_keeps_them_known(stated, fault):
    file = ended(stated, {"mode": Mode.FAULT if fault else Mode.PARKED, "faults": fault})
    assert file.state == "parked"
    assert file.lengths_m == pytest.approx([each + 0.005 for each in LENGTHS])


def test_homing_file_that_cannot_be_written_stays_marked_as_moved(stated, monkeypatch):
    def full(path, _):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    keeper = Keeper(stated, emulated=False)
    keeper.begin(cycle_of())
    assert keeper.trouble == ""
    monkeypatch.setattr("hil.app.configuration.section_file.write_whole", full)
    keeper.close()
    assert "real.yaml: cannot be written: No space left on device" in keeper.trouble
    assert states(stated)[False] == "moved"


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
def test_homing_file_is_refused_after_a_change_of_the_transmission(stated, drives):
    other = loads(with_changes(stated.text, {"name": "desktop", "drives": drives}), "desktop", stated.folder)
    for emulated in (False, True):
        assert Keeper(stated, emulated=emulated).last_pose is not None
        with pytest.raises(ConfigurationError, match="another robot"):
            Keeper(other, emulated=emulated)
