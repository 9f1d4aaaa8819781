"""A log with one changed byte in a received frame: replay reports tick and column."""

import json
import re
from dataclasses import replace

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.signals import Mode
from hil.cli import main
from hil.record.log import Log
from hil.record.mcap_file import record_bytes
from hil.record.salvage import salvage
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.replay.short_run import moved

RECEIVED, SENT = 1, 2


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("log") / "run.mcap")


def replayed(path, *words):
    return CliRunner().invoke(main, ["replay", str(path), *map(str, words)])


@pytest.fixture(scope="module")
def frame_type(log):
    """Protobuf type of the frames, from the schema in the file."""
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


def test_replay_accepts_an_unchanged_copy_of_a_log(log, tmp_path):
    rewrite_log(log, tmp_path / "copy.mcap")
    result = replayed(tmp_path / "copy.mcap")
    assert result.exit_code == 0, result.output


def test_log_without_its_last_ticks_is_a_failure(log, tmp_path):
    last = int(Log.open(log).rows("tick")["tick"][-1])
    rewrite_log(log, tmp_path / "short.mcap", lambda _, data, tick: data if tick <= last - 9 else None)
    result = replayed(tmp_path / "short.mcap")
    assert result.exit_code == 1, result.output
    assert f"9 ticks missing from tick {last - 8}" in " ".join(result.output.split())
    report = salvage(tmp_path / "short.mcap", tmp_path / "whole.mcap")
    assert report.remarks == (f"its summary counts {last + 1} ticks, but {last - 8} are present",)


@pytest.mark.parametrize(("mode", "byte"), [(Mode.IDLE, 5), (Mode.TRACKING, 0), (Mode.PARKED, 11)])
def test_replay_detects_a_changed_byte_at_rest_and_in_motion(log, frame_type, tmp_path, mode, byte):
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
def test_replay_detects_a_frame_removed_from_the_log(log, frame_type, tmp_path, direction, index):
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


def replay_counted(log, target, index=0, end=""):
    """Replay a copy with `index` more ticks in its index and, if given, `end` as tick count at its end."""
    rewrite_log(log, target, end={"ticks": end} if end else {})
    found = mcap_summary(target).statistics
    tick = next(number for number, each in mcap_summary(target).channels.items() if each.topic == "/tick")
    counts = found.channel_message_counts
    other = replace(found, channel_message_counts=counts | {tick: counts[tick] + index})
    target.write_bytes(target.read_bytes().replace(record_bytes(found), record_bytes(other)))
    result = replayed(target)
    return result.exit_code, " ".join(result.output.split())


@pytest.mark.parametrize(("index", "more"), [(4, 0), (0, 4), (3, 4)])
def test_ticks_counted_by_index_or_end_but_absent_are_missing(log, tmp_path, index, more):
    count = len(Log.open(log).rows("tick"))
    code, said = replay_counted(log, tmp_path / "a.mcap", index, str(count + more))
    assert code == 1
    assert f"4 ticks missing from tick {count}" in said


@pytest.mark.parametrize(("index", "end"), [(-1, ""), (0, "5"), (0, "-9"), (0, "five"), (0, "9" * 40)])
def test_index_or_end_with_too_few_ticks_means_an_altered_log(log, tmp_path, index, end):
    code, said = replay_counted(log, tmp_path / "a.mcap", index, end)
    assert code == 2
    assert "it was altered since it was written" in said
