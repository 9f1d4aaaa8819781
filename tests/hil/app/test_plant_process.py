"""`hil run --plant`: a plant that does not serve or has ended, and its last output."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers import build_protocol
from drivers.errors import PlantError
from drivers.protocol import DriveSetup
from drivers.signals import Command, DriveMode, Reaction
from hil.app import plant
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load
from hil.app.run import processes
from hil.app.run.processes import LAST_LINES, SupervisedPlant
from hil.cli import main
from hil.contracts.by_value import ByValue
from hil.contracts.messages import Configure
from tests.hil.lab.bringup.families import FAMILIES

Begin = Callable[[str], SupervisedPlant]
SERVES = "echo >&$report; "
SPEAKS = "i=0; while [ $i -lt 3000 ]; do echo step $i of the model >&2; i=$((i+1)); done; "


@pytest.fixture
def begin(monkeypatch: pytest.MonkeyPatch) -> Begin:
    """Start a shell script as the plant; `$report` is the pipe for its readiness."""

    def start(_module: str, *words: str, **options: Any) -> subprocess.Popen[bytes]:
        report = words[words.index("--report") + 1]
        return subprocess.Popen(["/bin/bash", "-c", f"report={report}; {given[-1]}"], **options)

    given: list[str] = []
    monkeypatch.setattr(processes, "start", start)

    def run(script: str) -> SupervisedPlant:
        given.append(script)
        c: Any = SimpleNamespace(source="virtual")
        return SupervisedPlant(c, Path("x-plant.mcap"))

    return run


@pytest.mark.parametrize(("given_s", "held_s"), [(0.2, 0.2), (None, 0.01)])
def test_plant_process_uses_the_watchdog_time_of_the_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given_s: float | None, held_s: float
) -> None:
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    file = tmp_path / "desk.yaml"
    file.write_text(with_changes(text, FAMILIES["odrive"]), encoding="utf-8")
    served: list[Configuration] = []

    def serve(c: Configuration, *, ready: Callable[[], None], **_: Any) -> dict[str, Any]:
        served.append(c)
        ready()
        return {"success": True}

    def start(_module: str, *words: str, **options: Any) -> subprocess.Popen[bytes]:
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, done.output
        return subprocess.Popen(["/bin/true"], **options)

    monkeypatch.setattr(plant, "run_plant", serve)
    monkeypatch.setattr(processes, "start", start)
    with SupervisedPlant(load(str(file)), tmp_path / "x-plant.mcap", watchdog_s=given_s):
        (c,) = served
    protocol = ByValue(build_protocol(c.bus, c.drives))
    dialogue = protocol.start(DriveSetup(held_s, Reaction.BRAKE, 312.5))
    _, frames = protocol.command(dialogue, Command(DriveMode.OFF, np.zeros(6)), 0)
    said = [each for frame in frames for each in protocol.parse(protocol.power_up(), frame)[1]]
    told = [each.watchdog_s for each in said if isinstance(each, Configure)]
    assert told == pytest.approx([held_s] * 6)
    assert c.drives.watchdog_ms == pytest.approx(1e3 * held_s)


@pytest.mark.parametrize("said", ["", "it compiles"])
def test_plant_that_does_not_serve_in_time_is_reported(
    begin: Begin, monkeypatch: pytest.MonkeyPatch, said: str
) -> None:
    slow, waited_s = begin(f"echo {said} >&2; kill -STOP $$; exec sleep 60"), []

    def time_is_over(_r: Any, _w: Any, _x: Any, longest_s: float) -> Any:
        waited_s.append(longest_s)
        os.waitid(os.P_PID, slow.pid, os.WSTOPPED)
        os.kill(slow.pid, signal.SIGCONT)
        return [], [], []

    monkeypatch.setattr(processes, "select", SimpleNamespace(select=time_is_over))
    with pytest.raises(PlantError) as refused, slow:
        pass
    text = str(refused.value)
    assert waited_s == [60.0]
    assert "did not start: it did not serve within 60 s" in text
    assert "`hil sim`" in text
    assert "SIGTERM" not in text
    assert text.endswith(f"Its last output: {said}" if said else "try again")


def test_plant_that_ends_early_is_reported_with_its_message(
    begin: Begin,
) -> None:
    with (
        pytest.raises(PlantError, match=r"^the plant did not start: ended with exit code 2: one\ntwo$"),
        begin("echo one >&2; echo >&2; echo two >&2; exit 2"),
    ):
        pass


@pytest.mark.parametrize("serves", [False, True])
def test_last_lines_of_a_long_plant_output_are_reported(begin: Begin, *, serves: bool) -> None:
    if serves:
        with begin(f"{SERVES}{SPEAKS} kill -SEGV $$") as ended:
            ended._process.wait()
            text = ended.trouble().partition("was killed by SIGSEGV: ")[2]
            assert ended.finish()["trouble"] == ended.trouble()
    else:
        with pytest.raises(PlantError) as refused, begin(f"{SPEAKS} exit 3"):
            pass
        text = str(refused.value).partition("ended with exit code 3: ")[2]
    assert text.splitlines() == [f"step {n} of the model" for n in range(3000 - LAST_LINES, 3000)]
