"""Before the first step of a bring-up on a bus: who may agree to all of it, and the homing file is marked."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from drivers.errors import RunError
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.homing.command import state_homing
from hil.app.homing.file import homing_file, read_homing, write_homing
from hil.app.homing.keeping import Keeper
from hil.lab.bringup import command
from hil.lab.bringup.command import run_bringup
from hil.lab.bringup.context import Context
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.hands import served_bench
from hil.lab.bringup.machine import build_machine
from hil.lab.bringup.procedure import Outcome
from hil.robot.kinematics import leg_lengths
from tests.hil.lab.bringup.test_homing_file import forgetful
from tests.hil.lab.bringup.test_release import Recorder


@pytest.fixture
def stated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A machine whose homing file says where its legs stand."""
    monkeypatch.chdir(tmp_path)
    text = forgetful(tmp_path).text.replace("folder: runs", f"folder: {tmp_path}/runs")
    c = loads(text, "forgetful", tmp_path)
    state_homing(c, at_home=True)
    with tempfile.TemporaryDirectory(prefix="hil-") as sockets:
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        yield c


@pytest.fixture
def begun(stated: Configuration, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the homing file said as the steps of each bring-up began."""
    said: list[str] = []

    def proceed(c: Configuration, protocol: Any, end: Any, store: Any, *_: Any, **__: Any) -> Any:
        said.append(homing(c))
        machine = build_machine(c, protocol)
        context = Context(machine, Drives(protocol, end.line, 0.1), end.operator, store.facts, store.save)
        return Outcome((), (), stopped="ended"), context, "ended"

    @contextlib.contextmanager
    def log(_c: Configuration, path: Path, _clock: Any) -> Any:
        yield Recorder(path, 0)

    monkeypatch.setattr(command, "_proceed", proceed)
    monkeypatch.setattr(command, "_log", log)
    return said


def homing(c: Configuration) -> str:
    return read_homing(c, c.folder / "legs.homing.yaml").state


def test_nobody_agrees_to_all_steps_at_a_machine_beforehand(stated: Configuration, begun: list[str]) -> None:
    before = sorted(stated.folder.iterdir())
    with pytest.raises(RunError, match="for a bench: leave it out at a machine"):
        run_bringup("forgetful", stated, yes=True, say=lambda _: None)
    assert begun == []
    assert homing(stated) == "stated"
    assert sorted(stated.folder.iterdir()) == before


def test_the_homing_file_is_marked_before_the_first_leg_is_moved_by_hand(
    stated: Configuration, begun: list[str]
) -> None:
    for _ in range(2):
        run_bringup("forgetful", stated, say=lambda _: None)
        assert homing(stated) == "moved", "it stays so until somebody says where the legs are"
        state_homing(stated, at_home=True)
    assert begun == ["moved"] * 2


@pytest.mark.parametrize("served", [False, True])
def test_a_rehearsal_leaves_the_homing_file_of_the_machine_alone(
    stated: Configuration, begun: list[str], served: bool
) -> None:
    with served_bench(stated, []) if served else contextlib.nullcontext():
        run_bringup("forgetful", stated, mistakes=None if served else [], yes=True, say=lambda _: None)
    assert begun == ["stated"]
    assert homing(stated) == "stated"


@pytest.mark.parametrize("said", ["stated", "moved"])
def test_on_a_bench_the_legs_are_where_the_platform_hangs_whatever_the_file_of_the_machine_says(
    stated: Configuration, said: Literal["stated", "moved"]
) -> None:
    path = stated.folder / "legs.homing.yaml"
    elsewhere = [q + 0.01 for q in read_homing(stated, path).lengths_m]
    write_homing(stated, path, homing_file(stated, said, elsewhere, None))
    before = path.read_bytes()
    assert stated.plant is not None
    x, y, z = stated.platform.home.position_m
    begins = stated.plant.model_copy(update={"initial_position_m": (x, y, z + 0.005)})
    elsewhere_at_start = stated.model_copy(update={"plant": begins})
    keeper = Keeper(elsewhere_at_start, emulated=False, on_bench=True)
    assert keeper.last_pose is not None
    home = leg_lengths(build_platform(stated.platform), *pose_arrays(stated.platform.home))
    np.testing.assert_array_equal(keeper.last_pose.length, home)
    cycle = build_cycle(stated, stated.loop.rate_Hz, 0.1, last_pose=keeper.last_pose)
    keeper.begin(cycle)
    keeper.close()
    assert path.read_bytes() == before
    assert "file" not in keeper.summary(cycle)["homing"]
