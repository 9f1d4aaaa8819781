"""The newest tick in shared memory: never torn, only this user's, and the log does not notice it."""

from __future__ import annotations

import errno
import json
import multiprocessing
import stat
import subprocess
import time
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.signals import Warn
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.mcap_file import McapFile
from hil.record.mirror import FIGURES, SLOT_BYTES, Mirror, MirrorReader, _place, mirror_path
from hil.record.recorder import Recorder, _Control, _publisher
from hil.record.recording import Live
from hil.record.ring import Ring
from hil.record.row import TICKS, Run, describe
from tests.hil.samples import random_rows

ABOUT = {"name": "test", "columns": describe(TICKS.columns)}


def rows_of(count, seed=0):
    rows = random_rows(count, seed=seed)
    rows["tick"] = np.arange(count)
    return rows


def until(found, seconds=10.0):
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.005)
    return value


def newest(reader):
    piece = reader.read()
    assert piece is not None
    return piece


def hammer(path, seconds):
    """Write pieces all of whose numbers are one, as fast as possible."""
    mirror = Mirror(path, ABOUT)
    row, figures = np.zeros((), ROW), np.zeros((), FIGURES)
    end, k = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        k += 1
        row["tick"] = row["t_ns"] = figures["ticks"] = figures["log_bytes"] = k
        row["R"][...] = row["tau"][...] = row["lyapunov_share"] = k
        mirror.write(row, figures, b"[" + b" " * (k % 2000) + str(k).encode() + b"]")


def test_a_reader_beside_a_writer_that_never_rests_sees_whole_pieces_alone(tmp_path):
    path = tmp_path / "m"
    writer = multiprocessing.get_context("spawn").Process(target=hammer, args=(path, 1.0))
    writer.start()
    until(path.exists, 30.0)
    reader = MirrorReader(path)
    until(reader.read)
    seen, torn = set(), []
    while writer.is_alive():
        piece = reader.read()
        if piece is None:
            continue
        row = piece.row
        values = {
            piece.number, *piece.events, int(row["tick"]), int(row["t_ns"]), float(row["lyapunov_share"]),
            int(piece.figures["ticks"]), int(piece.figures["log_bytes"]), *row["R"].ravel(), *row["tau"],
        }  # fmt: skip
        if len(values) != 1:
            torn.append(values)
        seen.add(piece.number)
    writer.join()
    assert writer.exitcode == 0
    assert torn == []
    assert len(seen) > 50, "the reader kept up with a part of them"


@pytest.mark.parametrize("word", [0, 1, 2], ids=["number", "size", "crc"])
def test_a_place_that_is_half_written_is_not_read(tmp_path, word):
    mirror = Mirror(tmp_path / "m", ABOUT)
    mirror.write(np.zeros((), ROW), np.zeros((), FIGURES))
    reader = MirrorReader(tmp_path / "m")
    assert reader.read() is not None
    mirror._words[_place(1) // 8 + word] += 1
    assert reader.read() is None


def test_the_file_is_of_this_user_alone_and_goes_with_the_run(tmp_path):
    path = tmp_path / "m"
    mirror = Mirror(path, ABOUT)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert mirror_path("localcan", "a/b").parent.stat().st_mode & 0o077 == 0
    assert mirror_path("localcan", "a/b").name == "localcan.a%2Fb.mirror"
    reader = MirrorReader(path)
    mirror.write(np.zeros((), ROW), np.zeros((), FIGURES), b'[{"text": "last"}]')
    mirror.close()
    assert not path.exists()
    assert reader.ended
    assert newest(reader).events == [{"text": "last"}], "who has mapped it keeps what was shown last"
    with pytest.raises(FileNotFoundError):
        MirrorReader(path)


def test_a_run_that_follows_keeps_its_file_when_the_one_before_closes_late(tmp_path):
    path = tmp_path / "m"
    first, second = Mirror(path, ABOUT), Mirror(path, {**ABOUT, "name": "second"})
    first.close()
    assert MirrorReader(path).about["name"] == "second"
    second.close()
    assert not path.exists()


def test_what_is_no_mirror_is_refused(tmp_path):
    path = tmp_path / "m"
    path.write_bytes(b"")
    with pytest.raises(LogError, match="not what this version"):
        MirrorReader(path)
    Mirror(path, ABOUT)
    data = bytearray(path.read_bytes())
    path.write_bytes(b"x" + data[1:])
    with pytest.raises(LogError, match="not what this version"):
        MirrorReader(path)
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(OSError, match=r"symbolic|Too many levels"):
        MirrorReader(tmp_path / "link")


def test_a_piece_that_fits_no_place_is_refused(tmp_path):
    mirror = Mirror(tmp_path / "m", ABOUT)
    with pytest.raises(ValueError, match="allowed"):
        mirror.write(np.zeros((), ROW), np.zeros((), FIGURES), b" " * SLOT_BYTES)


def test_the_recorder_shows_the_newest_row_fifty_times_a_second_and_counts_every_one(tmp_path):
    path, shown = tmp_path / "a.mcap", tmp_path / "m"
    rows = rows_of(1500, seed=5)
    rows["skipped"] = 0
    rows["skipped"][100::100] = 2
    with Recording.start(path, configuration="", mirror=(shown, {"name": "x"})) as recording:
        reader = MirrorReader(shown)
        assert reader.about["name"] == "x"
        assert reader.read() is None, "no tick yet"
        recording.event(0, "error", "first\n{}")
        numbers, begun = set(), time.monotonic()
        for k, row in enumerate(rows):
            recording.tick(row, (), ())
            if k == 700:
                recording.event(700, "warning", "y" * 5000)
            while time.monotonic() < begun + 1e-3 * k:
                piece = reader.read()
                if piece is not None:
                    numbers.add(piece.number)
                    assert abs(int(piece.row["tick"]) - k) < 400
                time.sleep(5e-4)
        seconds = time.monotonic() - begun
        last = until(lambda: (p := reader.read()) and int(p.figures["ticks"]) == 1500 and p)
        assert last.row.tobytes() == rows[-1].tobytes()
        assert int(last.figures["stale"]) == np.count_nonzero(rows["warnings"] & Warn.STALE)
        assert int(last.figures["skipped"]) == int(rows["skipped"].sum())
        assert int(last.figures["dropped"]) == 0
        until(lambda: int(newest(reader).figures["waiting"]) == 0)
        until(lambda: len(newest(reader).events) == 2)
        first, second = newest(reader).events
        assert first == {"number": 1, "t_ns": 0, "level": "error", "text": "first\n{}"}
        assert second["text"].startswith("yyy")
        assert len(second["text"]) < 700
    assert recording.close().complete
    assert reader.ended
    assert not shown.exists()
    assert 20 <= len(numbers) / seconds <= 51, "every 20 ms on a machine that is not too busy"


def test_a_mirror_that_cannot_be_made_costs_the_picture_and_not_the_log(tmp_path, capfd):
    path = tmp_path / "a.mcap"
    with Recording.start(path, configuration="", mirror=(tmp_path / "no" / "m", {})) as recording:
        for row in rows_of(20):
            recording.tick(row, (), ())
    assert recording.close().complete
    assert "cannot see this run" in capfd.readouterr().err


def test_a_mirror_that_cannot_be_made_is_told_on_standard_error_alone(tmp_path, capsys):
    """Standard output has the recorder's answers to the loop, one JSON object a line."""
    path = tmp_path / "no" / "m"
    ring = Ring.create(TICKS.dtype, 256)
    assert _publisher(ring, (path, {})) is None
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err == f"hil: `hil watch` cannot see this run: {path}: No such file or directory\n"


def test_a_recorder_that_is_killed_leaves_what_was_shown_last(tmp_path):
    shown = tmp_path / "m"
    recording = Recording.start(tmp_path / "a.mcap", configuration="", mirror=(shown, {}))
    recording.tick(rows_of(1)[0], (), ())
    reader = MirrorReader(shown)
    until(reader.read)
    recording._process.kill()
    recording.close()
    assert not reader.ended
    assert int(newest(reader).row["tick"]) == 0
    assert json.loads(json.dumps(reader.about))["columns"] == describe(TICKS.columns)
    shown.unlink()


def recorder(folder, ring):
    setup: dict[str, Any] = {"identity": {}, "environment": {}, "scene": None, "live": Live(), "mirror": (folder / "m", ABOUT),
             "path": str(folder / "a.mcap"), "created_ns": 0, "attachments": [("config.yaml", b"")]}  # fmt: skip
    return Recorder(ring, Run("/tick", TICKS.columns, 0, ("can0",), lockstep=False), setup)


@pytest.mark.parametrize("refused", ["__init__", "add_metadata", "add_attachment", "sync"])
def test_a_run_whose_log_cannot_be_opened_is_never_shown_and_hides_no_other(tmp_path, monkeypatch, refused):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    other = Mirror(tmp_path / "m", {**ABOUT, "name": "another run"})
    monkeypatch.setattr(McapFile, refused, refuse)
    with pytest.raises(OSError, match="No space left"):
        recorder(tmp_path, Ring.create(TICKS.dtype, 256))
    assert MirrorReader(tmp_path / "m").about["name"] == "another run"
    other.close()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_a_run_whose_log_cannot_be_written_any_more_is_shown_as_ended(tmp_path, monkeypatch, number):
    def refuse(*_):
        raise OSError(number, "it says")

    ring = Ring.create(TICKS.dtype, 256)
    recording = Recording(ring, cast("subprocess.Popen[bytes]", None), tmp_path / "a.mcap", lockstep=False)
    failing = recorder(tmp_path, ring)
    for row in rows_of(7):
        recording.tick(row, (), ())
    reader = MirrorReader(tmp_path / "m")
    monkeypatch.setattr(McapFile, "add_chunk", refuse)
    ended = cast("_Control", SimpleNamespace(ended=lambda _: True))
    with pytest.raises(OSError, match="it says"):
        failing.run(ended)
    assert reader.ended
    assert int(newest(reader).figures["ticks"]) == 7
    assert not (tmp_path / "m").exists()
    failing.file.discard()
