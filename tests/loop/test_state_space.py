"""A designed controller in the loop: replay without its file, entry without a bump, limits without windup."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.broad import broad
from tests.loop.bench import run

CONTROLLER = (Path(__file__).parents[1] / "data" / "controller.yaml").read_text()


def designed(folder, controller, name="virtual", **sections):
    """A shipped bench with the controller's text in `folder`."""
    (folder / "controller.yaml").write_text(controller)
    law = {"law": "state_space", "controller_file": "controller.yaml"}
    return loads(with_changes(load(name).text, {"controller": law} | sections), "bench.yaml", folder)


@pytest.mark.parametrize("axes", broad(["pose", "joint"], quick=1))
def test_state_space_law_is_replayed_from_the_log_and_not_from_its_file(axes, tmp_path, monkeypatch):
    c = designed(tmp_path, CONTROLLER.replace("axes: joint", f"axes: {axes}"))
    log = tmp_path / "run.mcap"
    summary = simulate(c, log=log, duration_s=1.6, check_replay=False)
    assert summary["success"], summary
    assert (summary["law"], summary["controller_order"]) == ("state_space", 2)
    attached = Log.open(log).attachments["controller.yaml"]
    assert attached.decode() == (tmp_path / "controller.yaml").read_text()
    (tmp_path / "controller.yaml").write_bytes(attached.replace(b"C: [[1, 1]]", b"C: [[0.5, 1]]"))
    assert replay_log(log)[0].exact
    (tmp_path / "controller.yaml").unlink()
    assert replay_log(log)[0].exact
    whole = Log.open

    def swapped(path):
        found = whole(path)
        found.attachments["controller.yaml"] = attached.replace(b"C: [[1, 1]]", b"C: [[0.5, 1]]")
        return found

    monkeypatch.setattr(Log, "open", swapped)
    assert not replay_log(log)[0].exact, "what is attached is what runs"


def test_state_space_law_starts_at_the_holding_force(tmp_path):
    """Before, the ramp lacks 10 / 300^3 of the force; after, encoder steps of 1 um add to it."""
    rows = run(designed(tmp_path, CONTROLLER), stop_s=1.3).rows
    begins = int(np.argmax(rows["mode"] == Mode.RELEASING))
    holding = np.abs(rows["tau"][begins - 1]).max()
    assert np.abs(rows["tau"][begins] - rows["tau"][begins - 1]).max() < 1e-6 * holding
    entry = rows[(rows["mode"] == Mode.RELEASING) | (rows["mode"] == Mode.APPROACH)]
    assert np.abs(np.diff(entry["tau"], axis=0)).max() < 1.5 * 1.875 * holding * 1e-3 / 0.3


BELOW_M, FORCE_N = 0.03, 4300.0
"""Start of the platform below the reference, and the force limit of a leg; 3618.6 N hold the platform."""


def test_state_space_law_overshoots_several_times_more_without_anti_windup(tmp_path):
    found = []
    for anti_windup in ("[0, 0.2]", "[0, 0]"):
        text = CONTROLLER.replace("[0, 0.2]", anti_windup).replace("[2, 0]", "[4, 0]")
        hold = {"type": "hold", "pose": {"position_m": [0, 0, 1]}, "duration_s": 1.5}
        start = {"initial_position_m": [0, 0, 1 - BELOW_M]}
        limits = {"force_N": FORCE_N}
        ran = run(designed(tmp_path, text, "ideal", reference=hold, plant=start, limits=limits))
        assert any(ran.summary["limited_ticks"].values())
        found.append(ran.tracking["p"][:, 2] - 1.0)
    good, without = found
    assert without.max() > 3.0 * good.max()
    assert abs(good[-1]) < 0.02 * BELOW_M
