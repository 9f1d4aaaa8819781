"""A designed controller in the loop: replay without its file, entry without a bump, limits without windup."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.broad import broad
from tests.loop import unrecorded
from tests.loop.test_engage import both_ends, until

DATA = Path(__file__).parents[1] / "data"
ORDER = 2


def bench(folder, controller, *, name="virtual", reference=None, more=""):
    """A shipped bench with the controller's text in `folder`."""
    (folder / "controller.yaml").write_text(controller)
    text = load(name).text
    a, b = text.index("\ncontroller:") + 1, text.index("\nengage:") + 1
    text = f"{text[:a]}controller: {{law: state_space, controller_file: controller.yaml}}\n\n{text[b:]}"
    if reference is not None:
        a, b = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
        text = f"{text[:a]}{reference}\n\n{text[b:]}"
    return loads(text + more, "bench.yaml", folder)


CONTROLLER = (DATA / "controller.yaml").read_text()


@pytest.fixture(scope="module", params=broad(["pose", "joint"], quick=1))
def recorded(request, tmp_path_factory):
    """A run into the book's path, which begins at 1.25 s, and its summary."""
    folder = tmp_path_factory.mktemp("state_space")
    text = CONTROLLER.replace("axes: joint", f"axes: {request.param}")
    summary = simulate(bench(folder, text), log=folder / "run.mcap", duration_s=1.6, check_replay=False)
    assert summary["success"], summary
    return folder, summary


def test_a_log_replays_to_the_bit_also_when_the_file_has_changed_or_gone(recorded):
    folder, _ = recorded
    log = folder / "run.mcap"
    attached = Log.open(log).attachments["controller.yaml"].decode()
    assert attached == (folder / "controller.yaml").read_text()
    (folder / "controller.yaml").write_text(attached.replace("C: [[1, 1]]", "C: [[0.5, 1]]"))
    assert replay_log(log)[0].exact
    (folder / "controller.yaml").unlink()
    assert replay_log(log)[0].exact
    (folder / "controller.yaml").write_text(attached)


@pytest.mark.long
def test_another_controller_in_the_log_would_not_have_replayed(recorded, monkeypatch):
    """The attachment is what the replay runs."""
    folder, _ = recorded
    other = (
        Log.open(folder / "run.mcap").attachments["controller.yaml"].replace(b"C: [[1, 1]]", b"C: [[0.5, 1]]")
    )
    whole = Log.open

    def swapped(path):
        log = whole(path)
        log.attachments["controller.yaml"] = other
        return log

    monkeypatch.setattr(Log, "open", swapped)
    verdict, _ = replay_log(folder / "run.mcap")
    assert not verdict.exact
    assert {d.column for d in verdict.first} & {"tau", "law_tau", "frames_crc32"}


def test_the_summary_names_the_law_and_its_order(recorded):
    _, summary = recorded
    assert summary["law"] == "state_space"
    assert summary["controller_order"] == ORDER


def test_the_law_takes_over_at_the_very_force_that_holds(recorded):
    """Before, the ramp has 10 / 300^3 of the force left; after, encoders of 1 um are in it."""
    folder, _ = recorded
    rows = Log.open(folder / "run.mcap").rows()
    begins = int(np.argmax(rows["mode"] == Mode.RELEASING))
    holding = rows["tau"][begins - 1]
    step = rows["tau"][begins] - holding
    ramp = 1.875 * np.abs(holding).max() * 1e-3 / 0.3
    assert np.abs(step).max() < 1e-6 * np.abs(holding).max()
    entry = rows[(rows["mode"] == Mode.RELEASING) | (rows["mode"] == Mode.APPROACH)]
    assert np.abs(np.diff(entry["tau"], axis=0)).max() < 1.5 * ramp


def test_the_controller_has_made_one_step_after_the_first_tick(tmp_path, monkeypatch):
    """What the cycle asked to learn the force of the entry is forgotten."""
    lockstep, close = both_ends(bench(tmp_path, CONTROLLER))
    law, calls = lockstep.cycle.parts.law, []

    def noting(name):
        method = getattr(law, name)

        def call(*arguments):
            calls.append(name)
            return method(*arguments)

        monkeypatch.setattr(law, name, call)

    noting("effort")
    noting("reset")
    try:
        until(lockstep, Mode.RELEASING)
    finally:
        close()
    assert calls[-2:] == ["effort", "reset"]


# -- limits --------------------------------------------------------------------------------------------------

BELOW_M, FORCE_N = 0.03, 4300.0
"""How far below the reference the platform starts, and the force that a leg may give; 3618.6 N hold it."""
HOLD = "reference:\n  type: hold\n  pose: {position_m: [0, 0, 1]}\n  duration_s: 1.5\n"


@pytest.fixture(scope="module")
def heights(tmp_path_factory):
    """z less its reference (ticks,) m of the same start, with and without anti-windup."""
    found = {}
    for name, anti_windup in (
        ("anti-windup", "[0, 0.2]"),
        ("none", "[0, 0]"),
    ):
        folder = tmp_path_factory.mktemp("windup")
        text = CONTROLLER.replace("[0, 0.2]", anti_windup).replace("[2, 0]", "[4, 0]")
        c = bench(
            folder, text, name="ideal", reference=HOLD, more=f"  initial_position_m: [0, 0, {1 - BELOW_M}]\n"
        )
        c = c.model_copy(update={"limits": c.limits.model_copy(update={"force_N": FORCE_N})})
        summary, rows = unrecorded.run(c)
        assert any(summary["limited_ticks"].values()), summary
        found[name] = rows["p"][rows["mode"] == Mode.TRACKING][:, 2] - 1.0
    return found


def test_without_anti_windup_the_same_error_overshoots_several_times_more(heights, capsys):
    over = {name: float(z.max()) for name, z in heights.items()}
    with capsys.disabled():
        print("\n30 mm below, a fifth of the weight to spare: overshoot")
        for name, z in over.items():
            print(f"  {name:12} {1e3 * z:7.2f} mm")
    assert over["none"] > 3.0 * over["anti-windup"]
    assert abs(heights["anti-windup"][-1]) < 0.02 * BELOW_M
