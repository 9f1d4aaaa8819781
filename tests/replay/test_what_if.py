"""What-if: outputs of another controller for recorded measurements."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, LogError
from drivers.signals import Fault, Warn
from hil.app.configuration.configuration import load
from hil.app.configuration.feedforward_file import feedforward_text
from hil.cli import main
from hil.loop import what_if as kernel
from hil.record.log import Log
from hil.study.what_if.command import OPEN_LOOP, what_if_log
from hil.study.what_if.inputs import changed, changes, read_changes, refuse_other_inputs
from tests.broad import broad
from tests.hil.app.test_feedforward_file import head_of, using
from tests.hil.rewrite import rewrite_log
from tests.replay.short_run import moved

LIMIT_N = 5000.0
"""Below the largest forces of the run, and above those at rest."""
VIRTUAL = load("virtual")
LEARNED = feedforward_text(head_of(VIRTUAL, rows=50), np.full((50, 6), 10.0), -4, 1e-3)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("what-if") / "run.mcap")


@pytest.fixture(scope="module")
def rows(log):
    return Log(log).rows()


@pytest.mark.parametrize("config", broad(["virtual", "lab-cia402", "desktop", "bench"], quick=1))
def test_what_if_with_the_same_configuration_has_no_differences(config, log, tmp_path):
    path = log if config == "virtual" else moved(tmp_path / "run.mcap", config)
    found = what_if_log(path)
    assert (found["success"], found["different_ticks"], found["different_frames_ticks"]) == (True, 0, 0)
    assert found["ticks"] == len(Log(path).rows()) > 200
    assert found["first"] == found["columns"] == found["changed"] == found["what_if_faults"] == []
    assert found["first_frames"] is found["first_tick"] is None


def test_lower_force_limit_cuts_each_force_and_changes_nothing_else(log, rows, monkeypatch):
    monkeypatch.setattr(kernel, "BLOCK", 100)  # the figures are sums over blocks
    found = what_if_log(log, None, [f"limits.force_N={LIMIT_N}"])
    over = np.maximum(np.abs(rows["tau"]) - LIMIT_N, 0.0)
    first, leg = np.argwhere(over > 0.0)[0]
    assert 0 < first < len(rows) - 1
    assert found["success"]
    assert found["changed"] == [f"limits.force_N: {VIRTUAL.limits.force_N} -> {LIMIT_N}"]
    assert found["first_tick"] == rows["tick"][first]
    (tau,) = [each for each in found["first"] if each["element"].startswith("tau.")]
    assert tau["time_s"] == pytest.approx(1e-9 * (rows["t_ns"][first] - rows["t_ns"][0]), abs=1e-12)
    worst = int(over[first].argmax())
    assert (tau["element"], tau["unit"]) == (f"tau.leg_{worst}", "N")
    assert float(tau["recorded"]) == rows["tau"][first, worst]
    assert float(tau["what_if"]) == np.sign(rows["tau"][first, worst]) * LIMIT_N
    forces = found["forces"]
    assert forces["ticks"] == len(rows)
    assert forces["largest_N"] == pytest.approx(over.max(axis=0), rel=1e-12)
    assert forces["rms_N"] == pytest.approx(np.sqrt((over**2).mean(axis=0)), rel=1e-12)
    expected = [None if not column.any() else int(rows["tick"][column.argmax()]) for column in over.T]
    assert forces["at_tick"] == expected
    assert leg in [n for n, at in enumerate(expected) if at is not None]
    acted = over.any(axis=1)
    limit = found["warnings"]["FORCE_LIMIT"]
    assert limit == {"recorded": 0, "answered": int(acted.sum()), "first_tick": int(rows["tick"][first])}
    assert not (rows["warnings"] & Warn.FORCE_LIMIT).any()
    assert {each["column"] for each in found["columns"]} >= {"tau", "warnings"}
    assert "tau_law" not in {each["column"] for each in found["columns"]}, "the law is the same"
    frames = found["first_frames"]
    assert (frames["tick"], frames["legs"]) == (rows["tick"][first], [0, 1, 2, 3, 4, 5])
    assert frames["recorded"] != frames["what_if"]
    assert frames["what_if"].split()[0] == frames["recorded"].split()[0], "the same identifier"


def test_new_fault_is_reported_and_figures_end_at_it(log, rows):
    limit = 0.6 * np.abs(rows["dq"]).max()
    strikes = int(np.flatnonzero((np.abs(rows["dq"]) > limit).any(axis=1))[0])
    found = what_if_log(log, None, [f"limits.speed_m_s={limit}"])
    (fault,) = [each for each in found["what_if_faults"] if each["fault"] == "SPEED"][:1]
    assert fault["tick"] == found["faults_part_at_tick"] == rows["tick"][strikes]
    assert found["forces"]["ticks"] == strikes
    assert found["forces"]["largest_N"] == [0.0] * 6
    assert found["recorded_faults"] == []
    assert found["what_if_story"]["findings"][0]["fault"] == "SPEED"
    assert found["ticks"] == len(rows), "the what-if continues after the fault"
    assert found["success"], "differences are no failure"


def test_fault_of_the_log_alone_is_reported_with_its_tick(tmp_path):
    path = moved(tmp_path / "fault.mcap", limits={"following_error_m": 2e-6})
    there = Log(path).rows()
    struck = int(there["tick"][np.flatnonzero(there["faults"] & Fault.FOLLOWING)[0]])
    found = what_if_log(path, None, [f"limits.following_error_m={VIRTUAL.limits.following_error_m}"])
    first = found["recorded_faults"][0]
    assert (first["fault"], first["tick"], found["faults_part_at_tick"]) == ("FOLLOWING", struck, struck)
    assert struck not in [each["tick"] for each in found["what_if_faults"]]
    named = [each["fault"] for each in found["recorded_faults"]]
    assert sorted(named) == sorted(set(named)), "each fault is listed once"


def test_faults_that_the_open_loop_may_cause_are_remarked(log):
    found = what_if_log(log, None, ["reference={type: hold}"])
    after = [each for each in found["what_if_faults"] if each["tick"] > found["first_frames"]["tick"]]
    assert after
    (remark,) = [each for each in found["remarks"] if "the open loop alone" in each]
    assert f"after tick {found['first_frames']['tick']} " in remark
    limit = what_if_log(log, None, [f"limits.force_N={LIMIT_N}"])
    assert not limit["what_if_faults"]
    assert not [each for each in limit["remarks"] if "open loop" in each]


def test_command_exits_1_for_a_gap_and_0_for_differences(log, tmp_path):
    gap = tmp_path / "gap.mcap"
    rewrite_log(log, gap, lambda topic, data, tick: None if tick == 500 and topic != "/events" else data)
    words = ["--set", f"limits.force_N={LIMIT_N}", "--json", str(tmp_path / "a.json")]
    cut = CliRunner().invoke(main, ["replay", str(gap), *words])
    assert cut.exit_code == 1, cut.output
    assert "1 ticks missing from tick 500" in cut.stderr
    whole = CliRunner().invoke(main, ["replay", str(log), *words])
    assert whole.exit_code == 0, whole.output
    result = json.loads((tmp_path / "a.json").read_text())
    assert (result["success"], result["kind"], result["note"]) == (True, "what_if", OPEN_LOOP)
    said = " ".join(whole.stdout.split())
    assert OPEN_LOOP in said
    assert f"tick {result['first_tick']} " in said


def test_written_what_if_log_is_marked_and_cannot_be_replayed(log, rows, tmp_path):
    out = tmp_path / "answer.mcap"
    found = what_if_log(log, None, [f"limits.force_N={LIMIT_N}"], out=out)
    assert found["success"]
    answer = Log.open(out)
    assert answer.metadata["hil"]["kind"] == "what-if"
    assert answer.metadata["hil"]["what_if_of"] == "run.mcap"
    assert answer.metadata["hil"]["open_loop"] == OPEN_LOOP
    assert any(OPEN_LOOP in event.text for event in answer.events())
    np.testing.assert_array_equal(answer.rows()["tau"], np.clip(rows["tau"], -LIMIT_N, LIMIT_N))
    other = [a.tobytes() != b.tobytes() for a, b in zip(answer.rows(), rows, strict=True)]
    assert found["different_ticks"] == sum(other) > found["different_frames_ticks"]
    given, there = (next(iter(Log(each).ticks())) for each in (out, log))
    assert (given.received, given.operator) == (there.received, there.operator)
    result = CliRunner().invoke(main, ["replay", str(out)])
    assert result.exit_code == 2
    assert "answer.mcap: holds a what-if on 'run.mcap'" in result.stderr
    with pytest.raises(LogError, match=r"answer\.mcap: is a log, and no log is ever overwritten"):
        what_if_log(log, out=out)


@pytest.mark.parametrize(
    ("config", "words", "key"),
    [
        ("virtual", ("bus.layout=ideal",), "bus.layout: ideal, allowed: fd"),
        ("virtual", ("loop.rate_Hz=500",), "loop.rate_Hz: 500.0, allowed: 1000.0"),
        ("virtual", ("drives.node_ids=[2,1,3,4,5,6]",), "drives.node_ids"),
        ("virtual", ("reactions.silence=damp",), "reactions.silence: damp, allowed: brake"),
        ("virtual", ("sensors.wrench={node_id: 9}", "bus.max_load_percent=90"), "sensors.wrench"),
        ("virtual-cia402", (), "drives.protocol: cia402, allowed: legs"),
        ("two_buses", (), "bus.channels"),
    ],
)
def test_configuration_that_reads_the_frames_differently_is_refused(config, words, key):
    here = changed(load(config), words, own=False)
    refuse_other_inputs(here, here, here.loop.rate_Hz)
    with pytest.raises(ConfigurationError) as refused:
        refuse_other_inputs(VIRTUAL, here, VIRTUAL.loop.rate_Hz)
    assert key in str(refused.value)
    assert "as in the log" in str(refused.value)


@pytest.mark.parametrize(
    "words",
    [
        ("platform.platform.mass_kg=500", "limits.speed_m_s=1", "monitor.action=warn"),
        ("reference={type: hold}", "engage.stop_s=1", "operator.stays=true"),
        ("bus.channel=other", "bus.max_load_percent=90", "drives.brake_after_ms=500", "recording.folder=x"),
        ("reactions.encoder=sto", "estimation.wrench={source: observer}"),
    ],
)
def test_controller_settings_may_differ_and_are_listed(words):
    here = changed(VIRTUAL, words, own=False)
    refuse_other_inputs(VIRTUAL, here, VIRTUAL.loop.rate_Hz)
    named = " ".join(changes(VIRTUAL, here))
    assert all(word.partition("=")[0] in named for word in words)
    assert changes(VIRTUAL, changed(VIRTUAL, ["description=x"], own=False)) == []


def test_changed_referenced_file_is_listed_as_a_change(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = ["t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", "0,0,0,1,0,0,0", "1,0.02,0,1,0,0,0", "2,0,0,1,0,0,0"]
    (tmp_path / "path.csv").write_text("\n".join(lines))
    c = changed(VIRTUAL, ["reference={type: sampled, path: path.csv}"], own=True)
    (tmp_path / "own.yaml").write_text(c.text)
    path = moved(tmp_path / "run.mcap", "own.yaml")
    (tmp_path / "own.yaml").write_text(Log(path).configuration)
    assert what_if_log(path, "own.yaml")["changed"] == what_if_log(path)["changed"] == []
    (tmp_path / "path.csv").write_text("\n".join(lines).replace("0.02", "0.03"))
    found = what_if_log(path, "own.yaml")
    assert found["changed"] == ["reference.path: the content of the file differs from the log's"]
    assert found["different_ticks"] > 0
    assert what_if_log(path)["different_ticks"] == 0


@pytest.fixture(scope="module")
def taught(tmp_path_factory):
    """Log of a run with a learned feed-forward."""
    folder = tmp_path_factory.mktemp("taught")
    (folder / "own.yaml").write_text(using(folder, LEARNED, limit_N=1000.0).text)
    return moved(folder / "taught.mcap", str(folder / "own.yaml"))


def test_file_that_is_not_attached_to_the_log_is_refused(log, taught):
    for path in (log, taught):
        with pytest.raises(
            ConfigurationError, match=r"--set feedforward\.file=other\.csv: .* a file on disk"
        ):
            what_if_log(path, None, ["feedforward={file: other.csv, limit_N: 1000}"])
    with pytest.raises(ConfigurationError, match="cannot refer to a file on disk"):
        what_if_log(log, None, ["controller={law: state_space, controller_file: hinf}"])


def test_what_if_without_feed_forward_removes_only_its_forces(taught):
    rows = Log(taught).rows()
    most = np.abs(rows["tau_learned"]).max(axis=0)
    assert most.min() > 1.0
    found = what_if_log(taught, None, ["feedforward="])
    assert found["forces"]["largest_N"] == pytest.approx(most, rel=1e-9)
    assert {each["column"] for each in found["columns"]} <= {"tau_learned", "tau", "encoder_share"}
    with pytest.raises(ConfigurationError, match=r"learned on another controller(?s:.*)--set feedforward="):
        what_if_log(taught, None, ["controller.wn_rad_s=25"])


def test_change_is_read_as_yaml_and_an_empty_one_removes_the_key():
    for wrong in (
        ["controller.wn_rad_s"],
        ["=3"],
        ["limits.x=]"],
        ["limits.x=1\ny: 2"],
        ["a.x=2", "a.x.y=1"],
    ):
        with pytest.raises(ConfigurationError, match="--set"):
            read_changes(wrong)
    words = ["a.b=1e3", "a.c=[1, 2]", "a.d={e: x}", "f=", "a.g.h=true"]
    expected = {"a": {"b": 1000.0, "c": [1, 2], "d": {"e": "x"}, "g": {"h": True}}, "f": None}
    assert read_changes(words) == expected
