"""A log as a Rerun recording: Rerun's own tools find the scalars, the states and the robot."""

import subprocess
import sys
from itertools import groupby

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.signals import Mode, Warn
from hil.cli import main
from hil.record import Recording
from hil.record.log import Log
from hil.study.export import export_log
from hil.study.view import command
from hil.study.view import recording as rrd
from tests.hil.samples import random_ticks, record

EXTRA = "optional extra `viewers`: pip install 'hexapod-hil[viewers]'"


def simulated(path):
    """A short run with a fault: an encoder jumps, and the brakes close."""
    words = ["sim", "virtual", "--duration", "3", "--fault", "encoder_jump leg=0 at=2.5 by=5e-3"]
    done = CliRunner().invoke(main, [*words, "--log", str(path)])
    assert path.exists(), done.output
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("log") / "a.mcap")


@pytest.fixture(scope="module")
def rows(path):
    return Log(path).rows()


@pytest.fixture(scope="module")
def recording(path):
    """The recording, written in several groups."""
    pytest.importorskip("rerun", reason=EXTRA)
    patch = pytest.MonkeyPatch()
    patch.setattr(rrd, "GROUP", 300)
    out = path.with_suffix(".rrd")
    export_log(path, [out])
    patch.undo()
    return out


@pytest.fixture(scope="module")
def query(recording):
    """Read entity and component -> ticks and values from Rerun's catalog, without missing values."""
    pytest.importorskip("datafusion", reason=EXTRA)
    from rerun.server import Server  # noqa: PLC0415 - needs the extra

    with Server(host="127.0.0.1", datasets={"log": [str(recording)]}) as server:
        data = server.client().get_dataset("log")

        def ask(entity, component):
            table = data.filter_contents([entity]).reader(index="tick").to_arrow_table()
            name = f"{entity}:{component}"
            if "tick" not in table.column_names or name not in table.column_names:
                return None
            pairs = zip(table["tick"].to_pylist(), table[name].to_pylist(), strict=True)
            return sorted(
                ((t, v) for t, v in pairs if v is not None), key=lambda pair: (pair[0] is None, pair[0])
            )

        yield ask


@pytest.mark.long
@pytest.mark.parametrize(("entity", "column", "element"), [("tau/leg_3", "tau", 3), ("p/z", "p", 2)])
def test_each_component_is_a_named_scalar_in_every_tick(query, rows, entity, column, element):
    ticks, values = zip(*query(f"/tick/{entity}", "Scalars:scalars"), strict=True)
    np.testing.assert_array_equal(ticks, rows["tick"])
    np.testing.assert_array_equal(np.ravel(values), rows[column][:, element])
    unit = {"tau": "N", "p": "m"}[column]
    named = {f"{entity.replace('/', '.')} [{unit}]"}
    assert {v for _, (v,) in query(f"/tick/{entity}", "SeriesLines:names")} == named


@pytest.mark.long
def test_the_leg_error_is_computed_although_it_is_not_in_the_log(query, rows):
    values = [v[0] for _, v in query("/differences/q_d-q/leg_5", "Scalars:scalars")]
    np.testing.assert_allclose(values, rows["q_d"][:, 5] - rows["q"][:, 5], rtol=0, atol=0)


@pytest.mark.long
def test_modes_and_flags_are_recorded_by_name_when_they_change(query, rows):
    expected = []
    for number, ticks in groupby(rows[["tick", "mode"]].tolist(), key=lambda pair: pair[1]):
        expected.append((next(ticks)[0], [Mode(number).name]))
    assert len(expected) > 5, "the run has to go through its modes"
    assert query("/tick/mode", "StateChange:state") == expected
    seen = {name for _, (text,) in query("/tick/warnings", "StateChange:state") for name in text.split("|")}
    assert seen == {flag.name for n in set(rows["warnings"].tolist()) for flag in Warn(n)} | {"NONE"}


@pytest.mark.long
def test_the_platform_moves_as_in_the_log(query, rows):
    pose = dict(query("/robot/platform", "Transform3D:translation"))
    turned = dict(query("/robot/platform", "Transform3D:quaternion"))
    assert len(pose) > 50
    by_tick = dict(zip(rows["tick"].tolist(), rows, strict=True))
    for tick, (p,) in pose.items():
        np.testing.assert_allclose(p, by_tick[tick]["p"], atol=1e-6)
        x, y, z, w = turned[tick][0]
        third = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(third, by_tick[tick]["R"][:, 2], atol=1e-6)
    assert np.ptp([p[0][2] for p in pose.values()]) > 1e-3, "the platform must move in the recorded run"
    assert query("/robot/platform", "LineStrips3D:strips"), "the recording has the lines of the platform"


@pytest.mark.long
def test_events_are_recorded_with_their_level(query, path):
    texts = [v for _, v in query("/events", "TextLog:text")]
    levels = [v for _, v in query("/events", "TextLog:level")]
    events = Log(path).events()
    assert events
    assert [[e.text] for e in sorted(events)] == texts
    assert [[{"warning": "WARN"}.get(e.level, e.level.upper())] for e in sorted(events)] == levels


@pytest.mark.long
def test_a_log_without_a_platform_is_written_without_a_robot(tmp_path):
    pytest.importorskip("rerun", reason=EXTRA)
    log = tmp_path / "a.mcap"
    with Recording.start(log, configuration="", lockstep=True) as started:
        record(started, random_ticks(40, seed=3))
    result = export_log(log, [tmp_path / "a.rrd"], columns=["tau.leg_3", "mode"])
    assert result["written"][str(tmp_path / "a.rrd")] == {"rows": 40}
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "a.rrd")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "/tick/tau/leg_3" in done.stdout
    assert "/tick/tau/leg_2" not in done.stdout
    assert " - /robot" not in done.stdout


@pytest.mark.long
@pytest.mark.parametrize("what", ["empty", "cut", "whole"])
def test_rerun_verifies_recordings_of_empty_truncated_and_whole_logs(tmp_path, path, what):
    pytest.importorskip("rerun", reason=EXTRA)
    log = tmp_path / "a.mcap"
    if what != "empty":
        log.write_bytes(path.read_bytes()[: 2_000_000 if what == "cut" else None])
    else:
        with Recording.start(log, configuration="", lockstep=True):
            pass
    out = tmp_path / "a.rrd"
    result = export_log(log, [out])
    assert result["success"] == (what != "cut")
    assert result["written"][str(out)]["rows"] == len(Log(log).rows())
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(out)], capture_output=True, check=False
    )
    assert done.returncode == 0


@pytest.mark.long
def test_rerun_is_started_on_the_recording_and_listens_on_loopback_only(path, tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason=EXTRA)
    started: list[list[str]] = []

    def run(words, **_):
        started.append(words)
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr("hil.study.view.command.subprocess.run", run)
    out = tmp_path / "a.rrd"
    assert command.view(path, "rerun", out=out)["success"]
    assert started == [[sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(out)]]
    assert out.stat().st_size > 100_000
