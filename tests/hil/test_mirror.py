"""The newest tick in shared memory: never torn, only this user's, of today's layout, and the log does not notice it."""

from __future__ import annotations

import json
import multiprocessing
import stat
import struct
import time
import zlib

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.signals import Warn
from drivers.tick_columns import ROW, Column
from hil.record import Recording
from hil.record.mirror import FIGURES, Mirror, MirrorReader, mirror_path
from hil.record.row import TICKS, Table, describe
from tests.hil.samples import random_rows

ABOUT = {"name": "test", "columns": describe(TICKS.columns)}
SMALL = tuple(Column("output", name, int, "", "", (), ()) for name in ("tick", "t_ns"))
HEAD, SLOT, WORDS = 65536, 32768, 32


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


def test_a_reader_beside_a_writer_that_never_rests_sees_whole_pieces(tmp_path):
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


@pytest.fixture
def shown(tmp_path):
    """A mirror of rows of two numbers, its path, and a function that writes a piece with this number."""
    path, mirror = tmp_path / "m", Mirror(tmp_path / "m", {"name": "täst", "columns": describe(SMALL)})

    def write(number, events=b"[]"):
        row, figures = np.zeros((), Table("", SMALL).dtype), np.zeros((), FIGURES)
        row["tick"], row["t_ns"], figures["ticks"], figures["log_bytes"] = number, -number, 10 * number, 7
        mirror.write(row, figures, events)

    yield path, write
    mirror.close()


def patched(path, at, data):
    with path.open("r+b") as file:
        file.seek(at)
        file.write(data)


def test_pieces_are_read_as_they_were_written_in_today_s_layout(shown):
    path, write = shown
    reader = MirrorReader(path)
    assert (reader.newest, reader.ended, reader.read(), reader.about["name"]) == (0, False, None, "täst")
    for number in range(1, 7):
        write(number, json.dumps([{"number": number}]).encode())
        found = newest(reader)
        assert (found.number, int(found.row["tick"]), int(found.row["t_ns"])) == (number, number, -number)
        assert (int(found.figures["ticks"]), int(found.figures["log_bytes"])) == (10 * number, 7)
        assert (found.events, reader.newest) == ([{"number": number}], number)
        data, at = path.read_bytes(), HEAD + number % 4 * SLOT
        assert (data[:8], struct.unpack_from("<q", data, 16)) == (b"HILMIR01", (number,))
        stored, size, crc = struct.unpack_from("<3q", data, at)
        assert (stored, crc) == (number, zlib.crc32(data[at + WORDS : at + WORDS + size]))
    assert len(path.read_bytes()) == HEAD + 4 * SLOT
    with pytest.raises(ValueError, match="allowed"):
        write(7, b" " * SLOT)


@pytest.mark.parametrize("word", [0, 1, 2], ids=["number", "size", "crc"])
def test_a_place_that_is_half_written_is_not_read(shown, word):
    path, write = shown
    write(1)
    reader, at = MirrorReader(path), HEAD + SLOT + 8 * word
    assert reader.read() is not None
    (value,) = struct.unpack_from("<q", path.read_bytes(), at)
    patched(path, at, struct.pack("<q", value + 1))
    assert reader.read() is None


@pytest.mark.parametrize(
    ("at", "data"),
    [
        (0, bytes(8)),
        *((8, struct.pack("<q", n)) for n in (0, -1, 1 << 62)),
        (WORDS, b"{,"),
        (HEAD + 4 * SLOT, b"\0"),
    ],
)
def test_another_head_description_or_size_is_refused(shown, at, data):
    patched(shown[0], at, data)
    with pytest.raises(LogError, match="not what this version"):
        MirrorReader(shown[0])


def test_the_file_is_of_this_user_alone_and_is_removed_with_the_run(tmp_path):
    path = tmp_path / "m"
    mirror = Mirror(path, ABOUT)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert mirror_path("localcan", "a/b").parent.stat().st_mode & 0o077 == 0
    assert mirror_path("localcan", "a/b").name == "localcan.a%2Fb.mirror"
    reader = MirrorReader(path)
    with pytest.raises(TypeError):
        reader._map[0] = 1
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


def test_the_recorder_shows_the_newest_row_fifty_times_a_second(tmp_path):
    path, shown = tmp_path / "a.mcap", tmp_path / "m"
    rows = random_rows(1500, seed=5)
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
        for row in random_rows(20):
            recording.tick(row, (), ())
    assert recording.close().complete
    assert "cannot see this run" in capfd.readouterr().err


def test_a_killed_recorder_leaves_what_was_shown_last(tmp_path):
    shown = tmp_path / "m"
    recording = Recording.start(tmp_path / "a.mcap", configuration="", mirror=(shown, {}))
    recording.tick(random_rows(1)[0], (), ())
    reader = MirrorReader(shown)
    until(reader.read)
    recording._process.kill()
    recording.close()
    assert not reader.ended
    assert int(newest(reader).row["tick"]) == 0
    assert reader.about["columns"] == describe(TICKS.columns)
