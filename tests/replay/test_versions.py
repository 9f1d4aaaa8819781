"""A log of another version is refused in one sentence with the difference and the version that replays it."""

from enum import IntEnum
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from drivers.legs.protocol import LegsProtocol
from drivers.signals import Mode
from drivers.tick_columns import RECORDED, Column
from hil.app.compose import attachments
from hil.app.configuration.configuration import load
from hil.app.replay import open_run, replay_log
from hil.cli import main
from hil.record import Recording
from hil.record.log import Log
from hil.record.row import Table
from tests.hil.samples import assert_same, random_ticks, record
from tools.fuzz.container import split, whole

OLD = Path(__file__).resolve().parents[1] / "data" / "log_0.1.0.mcap"
RENUMBERED: Any = IntEnum("RENUMBERED", [(mode.name, max(Mode) - mode) for mode in Mode])  # type: ignore[misc]
NEW = Column("output", "temperature", float, "K", "of the oil")


def recorded(path, columns=RECORDED, **files):
    c = load("virtual")
    attached = dict(attachments(c)) | {name.replace("_", "."): text for name, text in files.items()}
    attached = {name: text for name, text in attached.items() if text is not None}
    table = Table("/tick", columns)
    ticks = random_ticks(20, dtype=table.dtype)
    with Recording.start(
        path, configuration=c.text, table=table, attachments=list(attached.items()), lockstep=True,
        metadata={"kind": "sim", "rate_Hz": 1000.0, "watchdog_s": 0.01},
    ) as recording:  # fmt: skip
        record(recording, ticks)
    return ticks


@pytest.mark.parametrize("command", [["replay"], ["replay", "--salvage", "x.mcap"]], ids=str)
def test_log_commands_refuse_a_log_of_version_0_1_0_and_report_it(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, [*command, str(OLD)])
    assert result.exit_code == 2
    assert "Traceback" not in result.stderr
    sentence = result.stderr.strip().splitlines()[-1]
    assert "version 0.1.0" in sentence
    assert list(tmp_path.iterdir()) == []


CHANGES = {
    "added": ((*RECORDED, NEW), "only the log has temperature"),
    "removed": (tuple(c for c in RECORDED if c.name != "tau"), "only this version has tau"),
    "renamed": (
        tuple(c._replace(name="torque") if c.name == "tau" else c for c in RECORDED),
        "only the log has torque; only this version has tau",
    ),
    "of another type": (
        tuple(c._replace(type=float) if c.name == "skipped" else c for c in RECORDED),
        "of another type or with other names: skipped",
    ),
    "of other elements": (
        tuple(c._replace(elements=("z", "y", "x")) if c.name == "p_d" else c for c in RECORDED),
        "of another type or with other names: p_d",
    ),
    "of other numbers": (
        tuple(c._replace(type=RENUMBERED) if c.name == "mode" else c for c in RECORDED),
        "of another type or with other names: mode",
    ),
    "moved": ((*RECORDED[:-2], RECORDED[-1], RECORDED[-2]), "in another order"),
}


@pytest.mark.parametrize(("columns", "difference"), CHANGES.values(), ids=CHANGES)
def test_log_with_other_columns_is_not_replayed_but_readable(tmp_path, columns, difference):
    ticks = recorded(tmp_path / "a.mcap", columns)
    result = CliRunner().invoke(main, ["replay", str(tmp_path / "a.mcap")])
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)
    sentence = " ".join(result.stderr.split())
    other = f"the build of version {version('hexapod-hil')}"
    assert f"its columns differ ({difference}): replay it with {other}" in sentence
    assert_same(Log.open(tmp_path / "a.mcap").ticks(), ticks)


OTHER_FORCE = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 31_000.0).database[1].encode()


@pytest.mark.parametrize(
    ("database", "said"),
    [
        (b'VERSION "other"', r"its protocol has version other, this one 2\.0; .*another legs\.dbc"),
        (None, r"its protocol has version unknown, .* another legs\.dbc"),
        (OTHER_FORCE, r"a\.mcap: it was made with another legs\.dbc: replay it with the build of version"),
    ],
)
def test_log_made_with_another_frame_database_is_refused(tmp_path, database, said):
    recorded(tmp_path / "a.mcap", legs_dbc=database)
    with pytest.raises(LogError, match=said):
        replay_log(tmp_path / "a.mcap")


RATE, WATCHDOG = b"rate_Hz\x06\x00\x00\x001000.0", b"watchdog_s\x04\x00\x00\x000.01"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b'"elements"', b'"segments"', "metadata record 'hil' cannot be read"),
        (b'"shape": [3, 3]', b'"shape": [3,-3]', "metadata record 'hil' cannot be read"),
        (b"epoch_ns", b"epoch_nx", "metadata record 'hil' cannot be read"),
        (RATE, RATE[:-6] + b"-100.0", "rate_Hz: -100.0, allowed: a number > 0"),
        (WATCHDOG, WATCHDOG[:-4] + b"none", "watchdog_s: 'none', allowed: a number > 0"),
    ],
)
def test_edited_metadata_is_an_error_message_without_a_traceback(tmp_path, old, new, said):
    recorded(tmp_path / "a.mcap")
    content = (tmp_path / "a.mcap").read_bytes()
    assert old in content
    (tmp_path / "b.mcap").write_bytes(whole(split(content.replace(old, new))))
    result = CliRunner().invoke(main, ["replay", str(tmp_path / "b.mcap")])
    assert isinstance(result.exception, SystemExit)
    assert result.exit_code == 2
    assert said in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ({"kind": "plant"}, "holds a log of kind 'plant'"),
        ({"kind": "what-if", "what_if_of": "day.mcap"}, r"holds a what-if on 'day\.mcap'"),
        ({"rate_Hz": "100000"}, ""),
        ({"rate_Hz": "100001"}, "has rate_Hz: .*, at most "),
        ({"watchdog_s": "3600"}, ""),
        ({"watchdog_s": "nan"}, "has watchdog_s: .*, at most "),
    ],
)
def test_log_of_another_kind_or_with_invalid_rate_or_watchdog_is_refused(monkeypatch, run, said):
    given = {"kind": "run", "rate_Hz": "1000", "watchdog_s": "0.01"} | run
    text = load("virtual").text
    log = SimpleNamespace(columns=RECORDED, metadata={"hil": given}, configuration=text, attachments={})
    monkeypatch.setattr(Log, "open", lambda _: log)
    if not said:
        assert {key: open_run(Path("a.mcap"))[1][key] for key in run} == {k: float(v) for k, v in run.items()}
        return
    with pytest.raises(LogError, match=said):
        replay_log(Path("a.mcap"))
