"""A log in which one byte of one recorded received frame was changed: replay names the tick and the column."""

import json
import re
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.errors import LogError
from drivers.signals import Mode
from hil.app.replay import _require_as_many_as_told
from hil.cli import main
from hil.loop.replay import Comparison
from hil.record.log import Log
from hil.record.salvage import salvage
from tests.hil.rewrite import rewrite_log
from tests.replay.moving import moved

RECEIVED, SENT = 1, 2


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("log") / "run.mcap")


def replayed(path, *words):
    return CliRunner().invoke(main, ["replay", str(path), *map(str, words)])


@pytest.fixture(scope="module")
def frame_type(log):
    """Protobuf type of the frames, from the schema that the file itself carries."""
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return next(type(m) for _, channel, _, m in reader.iter_decoded_messages(["/can"]))


def tamper(log, target, frame_type, tick, byte, mask=0x01):
    """Copy the log with one byte changed in the first received frame of 12 bytes of `tick`: a leg's feedback."""
    changed: list[int] = []

    def edit(topic, data, sequence):
        if topic != "/can" or changed:
            return data
        message = frame_type.FromString(data)
        if (message.tick, message.direction, len(message.data)) != (tick, RECEIVED, 12):
            return data
        content = bytearray(message.data)
        content[byte] ^= mask
        changed.append(tick)
        return data.replace(message.data, bytes(content))

    rewrite_log(log, target, edit)
    assert changed == [tick]


def test_a_copy_without_a_change_replays(log, tmp_path):
    rewrite_log(log, tmp_path / "copy.mcap")
    result = replayed(tmp_path / "copy.mcap")
    assert result.exit_code == 0, result.output


def test_a_log_whose_last_ticks_are_missing_is_no_success_though_all_that_is_there_is_sound(log, tmp_path):
    last = int(Log.open(log).rows("tick")["tick"][-1])
    rewrite_log(log, tmp_path / "short.mcap", lambda _, data, tick: data if tick <= last - 9 else None)
    result = replayed(tmp_path / "short.mcap")
    assert result.exit_code == 1, result.output
    assert f"9 ticks missing from tick {last - 8}" in " ".join(result.output.split())
    report = salvage(tmp_path / "short.mcap", tmp_path / "whole.mcap")
    assert report.remarks == (f"its end counts {last + 1} ticks, {last - 8} are there",)


@pytest.mark.parametrize("byte", [5, 0, 11])
@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.TRACKING, Mode.PARKED])
def test_one_changed_byte_is_found_at_rest_and_in_motion(log, frame_type, tmp_path, mode, byte):
    rows = Log.open(log).rows()
    ticks = rows["tick"][rows["mode"] == mode]
    tick = int(ticks[len(ticks) // 2])
    tamper(log, tmp_path / "tampered.mcap", frame_type, tick, byte)
    result = replayed(tmp_path / "tampered.mcap", "--json", tmp_path / "verdict.json")
    assert result.exit_code == 1, result.output
    summary = json.loads((tmp_path / "verdict.json").read_text())
    assert summary["success"] is False
    assert summary["different_ticks"] >= 1
    # The checksum of the frames differs in any case, and the drives' own checksum refuses the frame.
    named = re.findall(r"^hil: tick (\d+): (\w+): recorded .*, replayed ", result.stderr, re.MULTILINE)
    assert {int(t) for t, _ in named} == {tick}
    assert {"frames_crc32", "rejected"} <= {column for _, column in named}


@pytest.mark.parametrize(("direction", "index"), [(RECEIVED, 0), (SENT, 7)])
def test_a_frame_taken_away_is_found(log, frame_type, tmp_path, direction, index):
    tick = 300

    def edit(topic, data, _sequence):
        if topic == "/can":
            message = frame_type.FromString(data)
            if (message.tick, message.direction, message.index) == (tick, direction, index):
                return None
        return data

    rewrite_log(log, tmp_path / "short.mcap", edit)
    result = replayed(tmp_path / "short.mcap")
    assert result.exit_code == 1, result.output
    column = "frames_received" if direction == RECEIVED else "sent frames"
    assert f"hil: tick {tick}: {column}: recorded " in result.stderr


END = 7
"""The tick behind the last of five."""


def counted(index, end, *, cut="", gaps=()):
    """Return the gaps of a replay of five ticks of a log whose index and end count so many."""
    log: Any = SimpleNamespace(
        path="a.mcap", cut=cut, summary=SimpleNamespace(ticks=index), metadata={"summary": {"ticks": end}}
    )
    comparison = Comparison(ticks=5, end=END, gaps=list(gaps))
    _require_as_many_as_told(log, comparison)
    return comparison.gaps


@pytest.mark.parametrize(
    ("index", "end", "missing"), [(5, "5", 0), (5, "", 0), (5, "9", 4), (9, "5", 4), (9, "", 4), (6, "8", 3)]
)
def test_ticks_that_index_or_end_count_beyond_those_that_are_there_are_missing(index, end, missing):
    assert counted(index, end) == ([(END, missing)] if missing else [])
    assert counted(index, end, gaps=[(3, 1)]) == [(3, 1)], "nothing behind a gap was looked at"
    assert counted(index, end, cut="cut at byte 9") == [], "it has no end"


@pytest.mark.parametrize(
    ("index", "end"), [(4, "5"), (5, "4"), (4, ""), (5, "-9"), (5, "five"), (5, "9" * 40)]
)
def test_an_index_or_an_end_that_counts_fewer_ticks_than_there_are_was_altered(index, end):
    with pytest.raises(LogError, match=r"^a\.mcap: 5 ticks are there, .*: it was altered"):
        counted(index, end)
