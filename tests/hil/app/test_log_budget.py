"""`recording.budget_GB`: logs that are removed or kept, and refused runs."""

from __future__ import annotations

import shutil

import pytest

from drivers.errors import LogError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.log_budget import dated_logs, make_room
from hil.app.sim.command import simulate
from hil.record.mcap_file import McapFile


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A log without a fault, one with a fault, and a cut one."""
    folder = tmp_path_factory.mktemp("logs")
    good, bad, cut = (folder / f"{name}.mcap" for name in ("good", "bad", "cut"))
    assert simulate(load("virtual"), log=good, duration_s=0.2, check_replay=False)["success"]
    faulty = with_faults(load("virtual"), ("encoder_jump leg=0 at=2.5 by=5e-3",))
    assert not simulate(faulty, log=bad, duration_s=2.0, check_replay=False)["success"]
    cut.write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    return {"good": good, "bad": bad, "cut": cut}


def configured(folder, budget):
    text = load("virtual").text.replace("  folder: runs", f"  folder: {folder}\n  budget_GB: {budget}")
    return loads(text, "virtual")


@pytest.fixture
def runs(logs, tmp_path):
    """Six runs, the second with a fault, the third cut; a plant's log; unrelated files."""
    names = {
        "virtual-20260101T000000": "good",
        "virtual-20260101T000001": "bad",
        "virtual-20260101T000002": "cut",
        "virtual-20260101T000003": "good",
        "virtual-20260101T000003-plant": "good",
        "virtual-20260101T000003-2": "good",
        "virtual-20260101T000004": "good",
        "mine": "good",
        "virtual-mine": "good",
        "virtual2-20250101T000000": "good",
    }
    for name, kind in names.items():
        shutil.copy(logs[kind], tmp_path / f"{name}.mcap")
    return tmp_path


OTHERS = {"mine", "virtual-mine", "virtual2-20250101T000000"}


def left(folder):
    return {path.stem for path in folder.glob("*.mcap")}


def test_log_budget_removes_the_oldest_fault_free_logs_first_and_never_the_newest(runs):
    removed = [path.rsplit("/", 1)[1].removesuffix(".mcap") for path in make_room(configured(runs, 1e-6), 0)]
    assert removed == [
        "virtual-20260101T000000",
        "virtual-20260101T000003",
        "virtual-20260101T000003-plant",
        "virtual-20260101T000003-2",
        "virtual-20260101T000001",
        "virtual-20260101T000002",
    ]
    assert left(runs) == OTHERS | {"virtual-20260101T000004"}


def test_log_budget_removes_no_more_logs_than_needed(runs):
    size = (runs / "mine.mcap").stat().st_size
    total = sum(log.stat().st_size for logs in dated_logs(runs, "virtual").values() for log in logs)
    removed = make_room(configured(runs, (total + 0.5 * size) / 1e9), size)
    assert [path.rsplit("/", 1)[1] for path in removed] == ["virtual-20260101T000000.mcap"]


def test_no_log_is_removed_without_a_budget_or_if_the_new_log_has_a_given_path(runs, tmp_path):
    before = left(runs)
    c = loads(load("virtual").text.replace("folder: runs", f"folder: {runs}"), "virtual")
    assert make_room(c, 0) == []
    assert make_room(configured(runs, 1e-6), 0, runs / "own.mcap") == []
    assert left(runs) == before


def test_run_that_needs_more_than_budget_or_disk_is_refused(runs):
    with pytest.raises(LogError, match=r"budget_GB 0.001: this run may write 0.002 GB"):
        make_room(configured(runs, 1e-3), 2_000_000)
    free = shutil.disk_usage(runs).free
    with pytest.raises(LogError, match=r"are free, and this run may write"):
        make_room(load("virtual"), 100 * free, runs / "own.mcap")
    assert len(left(runs)) == 10


def test_log_budget_keeps_both_logs_of_a_run_that_is_still_being_recorded(runs):
    own, other = "virtual-20260101T000000-2", "virtual-20260101T000002-2"
    both = {own, f"{own}-plant", other, f"{other}-plant"}
    shutil.copy(runs / "mine.mcap", runs / f"{own}-plant.mcap")
    shutil.copy(runs / "mine.mcap", runs / f"{other}.mcap")
    open_files = [McapFile(runs / f"{name}.mcap", "a test") for name in (own, f"{other}-plant")]
    c = configured(runs, 1e-6)
    assert len(make_room(c, 0)) == 6
    assert left(runs) == OTHERS | both | {"virtual-20260101T000004"}
    for file in open_files:
        file.close()
    assert len(make_room(c, 0)) == 4
    assert left(runs) == OTHERS | {"virtual-20260101T000004"}
