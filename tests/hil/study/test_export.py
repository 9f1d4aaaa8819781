"""`hil export`: other tools read back the recorded values, at the right instant, without loss."""

import json
import re
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from can.io.asc import ASCReader
from can.io.blf import BLFReader
from can.io.canutils import CanutilsLogReader
from click.testing import CliRunner
from pyarrow import parquet

from drivers.protocol import BRS, BUS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, Received
from hil.cli import main
from hil.record import Recording
from hil.record.log import Log
from hil.study.export import export_log
from tests.hil.samples import log_of, random_ticks

TICKS = random_ticks(700, seed=33)
SIMULATED = 946_684_800.0
"""2000-01-01T00:00:00Z in Unix time."""
FIRST_NS = int(TICKS[0].row["t_ns"])
READERS: dict[str, Any] = {
    "log": CanutilsLogReader,
    "asc": lambda path: ASCReader(path, relative_timestamp=False),
    "blf": BLFReader,
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory, configuration="", can_channel="vcan0")


def hil(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def recorded():
    """Every frame of TICKS in the order of time: s, frame, True if sent."""
    found = []
    for tick in TICKS:
        found += [(t_ns, frame, False) for t_ns, frame in tick.received]
        found += [(int(tick.row["t_ns"]), frame, True) for frame in tick.sent]
    found.sort(key=lambda item: item[0])
    return [(t_ns * 1e-9, frame, sent) for t_ns, frame, sent in found]


def flags_of(message):
    return (
        EXTENDED * message.is_extended_id | FD * message.is_fd | BRS * message.bitrate_switch
        | ESI * message.error_state_indicator | REMOTE * message.is_remote_frame | ERROR * message.is_error_frame
    )  # fmt: skip


@pytest.fixture
def zone(monkeypatch):
    monkeypatch.setenv("TZ", "XST-5:30")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


# -- frames --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", READERS)
def test_python_can_reads_back_every_frame_at_its_absolute_time(path, tmp_path, zone, ending):
    out = tmp_path / f"a.{ending}"
    summary = export_log(path, [out])
    assert "--start" in summary["remark"], "simulated time"
    expected, found = recorded(), list(READERS[ending](out))
    assert len(found) == len(expected) == summary["written"][str(out)]["frames"]
    for message, (t_s, frame, sent) in zip(found, expected, strict=True):
        assert message.timestamp == pytest.approx(SIMULATED + t_s, abs=1.1e-6, rel=0)
        assert message.arbitration_id == frame.id
        assert bytes(message.data) == frame.data
        remote = (
            REMOTE if ending == "asc" and frame.flags & FD and not frame.data else 0
        )  # python-can's reading
        assert flags_of(message) == frame.flags % BUS | remote
        if ending == "log":
            assert message.channel == ("vcan0" if frame.bus == 0 else f"vcan0_{frame.bus}")
        else:
            assert message.is_rx is not sent
            assert message.channel == frame.bus


@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("start", ["2026-01-31T13:00:00.250001+01:00", "2026-01-31T12:00:00.250001"])
def test_option_start_sets_the_absolute_time_of_the_first_exported_tick(path, tmp_path, ending, start):
    out = tmp_path / f"a.{ending}"
    summary = export_log(path, [out], start=start)
    begin = datetime(2026, 1, 31, 12, 0, 0, 250_001, tzinfo=UTC).timestamp() - FIRST_NS * 1e-9
    expected, found = recorded(), list(READERS[ending](out))
    for message, (t_s, _, _) in zip(found, expected, strict=True):
        assert message.timestamp == pytest.approx(begin + t_s, abs=1.1e-6, rel=0)
    assert summary["first_tick_utc"] == "2026-01-31T12:00:00.250001Z"
    assert "remark" not in summary


@pytest.mark.parametrize("ending", READERS)
def test_exported_frame_that_was_read_seconds_late_keeps_its_own_time(tmp_path, ending):
    late = Received(100_500_000, Frame(0x7AA, b"late"))
    rows = np.zeros(3000, TICKS[0].row.dtype)
    rows["tick"], rows["t_ns"] = np.arange(3000), np.arange(3000) * 1_000_000
    with Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True) as recording:
        for k, row in enumerate(rows):
            recording.tick(np.asarray(row), (late,) if k == 2500 else (), (Frame(0x80, b"\x01"),))
    out = tmp_path / f"a.{ending}"
    export_log(tmp_path / "a.mcap", [out])
    found = list(READERS[ending](out))
    assert len(found) == 3001
    (odd,) = (message for message in found if message.arbitration_id == 0x7AA)
    assert odd.timestamp == pytest.approx(SIMULATED + 0.1005, abs=1.1e-6, rel=0)
    others = [message.timestamp for message in found if message is not odd]
    np.testing.assert_allclose(others, SIMULATED + np.arange(3000) * 1e-3, atol=1.1e-6, rtol=0)


# -- columns -------------------------------------------------------------------------------------------------


def test_pandas_reads_the_parquet_as_the_frame_of_the_log(path, tmp_path):
    export_log(path, [tmp_path / "a.parquet"])
    found, expected = pd.read_parquet(tmp_path / "a.parquet"), Log(path).frame()
    assert list(found.columns) == ["t_s", *expected.columns]
    assert found["t_s"].to_numpy().tobytes() == expected.index.to_numpy().tobytes()
    for name in expected.columns:
        if isinstance(expected[name].dtype, pd.CategoricalDtype):
            assert found[name].astype(str).tolist() == expected[name].astype(str).tolist()
        else:
            assert found[name].to_numpy().tobytes() == expected[name].to_numpy().tobytes(), name
    assert found.attrs["units"] == {"t_s": "s"} | expected.attrs["units"]
    assert found.attrs["epoch_ns"] == SIMULATED * 1e9
    schema = parquet.read_schema(tmp_path / "a.parquet")
    assert schema.field("wrench.mz").metadata[b"unit"] == b"N m"
    assert b"base frame" in schema.field("wrench.fx").metadata[b"meaning"]


def test_the_csv_has_units_and_every_number_exactly(path, tmp_path):
    export_log(path, [tmp_path / "a.csv"], columns=["tau.leg_3", "mode", "twist"])
    found, log = pd.read_csv(tmp_path / "a.csv"), Log(path)
    assert list(found.columns) == [
        "t_s [s]", "tau.leg_3 [N]", "mode", "twist.vx [m/s]", "twist.vy [m/s]", "twist.vz [m/s]",
        "twist.wx [rad/s]", "twist.wy [rad/s]", "twist.wz [rad/s]",
    ]  # fmt: skip
    rows = log.rows()
    np.testing.assert_array_equal(found["tau.leg_3 [N]"], rows["tau"][:, 3])
    np.testing.assert_array_equal(found["twist.wz [rad/s]"], rows["twist"][:, 5])
    assert found["mode"].astype(str).tolist() == log.frame("mode")["mode"].astype(str).tolist()


def test_values_that_first_occur_late_are_exported_by_name(tmp_path):
    count = 40_000
    rows = np.zeros(count, TICKS[0].row.dtype)
    rows["tick"], rows["t_ns"] = np.arange(count), np.arange(count) * 1_000_000
    rows["warnings"] = np.arange(count) // 10_000
    with Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True) as recording:
        for row in rows:
            recording.tick(np.asarray(row), (), ())
    export_log(tmp_path / "a.mcap", [tmp_path / "a.parquet"], columns=["warnings", "tick"])
    found = pd.read_parquet(tmp_path / "a.parquet")
    assert found["tick"].tolist() == list(range(count))
    assert found["warnings"].iloc[::10_000].tolist() == ["NONE", "STALE", "LATE", "STALE|LATE"]


# -- refusals ------------------------------------------------------------------------------------------------


def test_a_truncated_log_is_exported_to_its_end_and_reported(path, tmp_path):
    bad = tmp_path / "cut.mcap"
    size = path.stat().st_size // 2
    bad.write_bytes(path.read_bytes()[:size])
    done = hil("export", bad, tmp_path / "a.log", tmp_path / "a.csv", "--json", tmp_path / "a.json")
    assert done.exit_code == 1
    assert f"cut at {size} bytes" in done.stderr
    there = Log(bad).summary
    assert 0 < there.ticks < len(TICKS)
    assert len((tmp_path / "a.log").read_text().splitlines()) == there.frames
    assert len(pd.read_csv(tmp_path / "a.csv")) == there.ticks
    summary = json.loads((tmp_path / "a.json").read_text())
    assert summary["written"][str(tmp_path / "a.csv")] == {"rows": there.ticks}


def test_a_damaged_log_leaves_no_partial_file(path, tmp_path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    for ending in ("log", "blf", "csv", "parquet"):
        done = hil("export", bad, tmp_path / f"a.{ending}")
        assert done.exit_code == 2
        assert re.search(r"damaged (at|somewhere before) byte \d+", done.stderr)
    assert [p.name for p in tmp_path.iterdir()] == ["bad.mcap"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.mat"], "allowed: .log, .candump, .asc, .blf, .csv, .parquet"),
        (["a.csv", "--start", "2026-01-31"], "leave it out"),
        (["a.log", "--column", "q"], "no output is such a file"),
        (["a.log", "--start", "yesterday"], "ISO 8601"),
        (["a.csv", "--column", "taus"], "did you mean tau"),
        (["a.log", "./a.log"], "give each file once"),
        (["own.log"], "no log is ever overwritten"),
        (["no/a.log"], "there is no folder"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_invalid_options_are_refused_before_anything_is_written(path, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    Path("own.log").write_bytes(path.read_bytes())
    done = hil("export", path, *words)
    assert done.exit_code == 2
    assert message in done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "own.log"]
