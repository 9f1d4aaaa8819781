"""The mirror byte by byte, and the order in which both ends touch it: readers may be of another version."""

from __future__ import annotations

import json
import mmap
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.mirror import FIGURES, Mirror, MirrorReader
from hil.record.row import Table, describe

COLUMNS = tuple(Column("output", name, int, "", "", (), ()) for name in ("tick", "t_ns"))
ABOUT = {"name": "täst", "columns": describe(COLUMNS)}
HEAD, SLOT, WORDS = 65536, 32768, 32


def piece(number):
    row = np.zeros((), Table("", COLUMNS).dtype)
    figures = np.zeros((), FIGURES)
    row["tick"], row["t_ns"], figures["ticks"], figures["log_bytes"] = number, -number, 10 * number, 7
    return row, figures


def descriptors():
    return sorted(each.name for each in Path("/proc/self/fd").iterdir())


def words(data, at):
    return struct.unpack_from("<4q", data, at)


def test_the_file_has_a_head_a_description_and_four_places_that_are_filled_in_turn(tmp_path):
    mirror = Mirror(tmp_path / "m", ABOUT)
    text = json.dumps(ABOUT).encode()
    magic = int.from_bytes(b"HILMIR01", "little")
    data = (tmp_path / "m").read_bytes()
    assert words(data, 0) == (magic, len(text), 0, 0)
    assert data[WORDS : WORDS + len(text) + 1] == text + b"\0"
    assert len(data) == HEAD + 4 * SLOT
    reader = MirrorReader(tmp_path / "m")
    assert (reader.newest, reader.ended, reader.read()) == (0, False, None)
    assert reader.about == ABOUT
    assert reader.inode == (tmp_path / "m").stat().st_ino
    for number in range(1, 7):
        row, figures = piece(number)
        events = json.dumps([{"number": number}]).encode()
        mirror.write(row, figures, events)
        data = (tmp_path / "m").read_bytes()
        assert words(data, 0) == (magic, len(text), number, 0)
        at = HEAD + number % 4 * SLOT
        content = row.tobytes() + figures.tobytes() + events
        assert words(data, at)[:3] == (number, len(content), zlib.crc32(content))
        assert data[at + WORDS : at + WORDS + len(content) + 1] == content + b"\0"
        found = reader.read()
        assert found is not None
        assert (found.number, found.row, found.figures) == (number, row[()], figures[()])
        assert found.events == [{"number": number}]
        assert reader.newest == number
    mirror.write(*piece(7))
    last = reader.read()
    assert last is not None
    assert last.events == []
    mirror.close()
    assert reader.ended


def test_a_place_that_claims_bytes_of_the_next_one_is_not_read_although_their_checksum_is_right(tmp_path):
    mirror = Mirror(tmp_path / "m", ABOUT)
    mirror.write(*piece(1))
    reader = MirrorReader(tmp_path / "m")
    assert reader.read() is not None
    at, room = HEAD + SLOT, SLOT - WORDS
    crc = zlib.crc32(mirror._map[at + WORDS : at + WORDS + room + 8])
    struct.pack_into("<2q", mirror._map, at + 8, room + 8, crc)
    assert reader.read() is None


def test_a_description_and_a_piece_may_fill_their_room_and_take_no_byte_more(tmp_path):
    empty = len(json.dumps({**ABOUT, "x": ""}))
    mirror = Mirror(tmp_path / "m", {**ABOUT, "x": "x" * (HEAD - WORDS - empty)})
    reader = MirrorReader(tmp_path / "m")
    assert len(reader.about["x"]) == HEAD - WORDS - empty
    says = f"a description of {HEAD - WORDS + 1} bytes; allowed: {HEAD - WORDS}"
    with pytest.raises(OSError, match=says):
        Mirror(tmp_path / "n", {**ABOUT, "x": "x" * (HEAD - WORDS - empty + 1)})
    assert not (tmp_path / "n").exists()
    row, figures = piece(3)
    room = SLOT - WORDS - len(row.tobytes()) - FIGURES.itemsize
    for number in range(1, 5):
        mirror.write(row, figures, b"[" + b" " * (room - 3) + f"{number}]".encode())
    last = reader.read()
    assert last is not None
    assert last.number == 4
    events: list[Any] = last.events
    assert events == [4]
    with pytest.raises(ValueError, match=f"a piece of {SLOT - WORDS + 1} bytes; allowed: {SLOT - WORDS}"):
        mirror.write(row, figures, b"[" + b" " * (room - 1) + b"]")
    assert reader.newest == 4
    mirror.close()


@pytest.mark.parametrize(("torn", "read"), [(1, True), (999, True), (1000, False)])
def test_a_reader_tries_a_thousand_times(tmp_path, monkeypatch, torn, read):
    Mirror(tmp_path / "m", ABOUT).write(*piece(1))
    reader = MirrorReader(tmp_path / "m")
    times, whole = [torn], zlib.crc32

    def crc(data):
        times[0] -= 1
        return 0 if times[0] >= 0 else whole(data)

    monkeypatch.setattr(zlib, "crc32", crc)
    assert (reader.read() is not None) is read


def flags_of(monkeypatch, make):
    found: list[tuple[int, ...]] = []
    opened = os.open

    def watch(path, *how):
        found.append(how)
        return opened(path, *how)

    monkeypatch.setattr(os, "open", watch)
    make()
    monkeypatch.undo()
    return found


def test_the_file_is_new_and_no_link_and_neither_end_gives_it_to_children_or_keeps_it_open(
    tmp_path, monkeypatch
):
    before = len(descriptors())
    keep: list[Any] = []
    written = flags_of(monkeypatch, lambda: keep.append(Mirror(tmp_path / "m", ABOUT)))
    read = flags_of(monkeypatch, lambda: keep.append(MirrorReader(tmp_path / "m")))
    assert written == [(os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)]
    assert read == [(os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW,)]
    assert len(descriptors()) - before == 2, "what a mapping has of its own"
    with pytest.raises(TypeError):
        keep[1]._map[0] = 1


@pytest.mark.parametrize("refused", ["posix_fallocate", "mmap"])
def test_a_mirror_that_cannot_be_made_leaves_neither_a_file_nor_a_descriptor(tmp_path, monkeypatch, refused):
    (tmp_path / f"m.{os.getpid()}").write_text("of a process of this number that was killed")
    before = descriptors()

    def refuse(*_):
        raise MemoryError

    monkeypatch.setattr(os if refused == "posix_fallocate" else mmap, refused, refuse)
    with pytest.raises(MemoryError):
        Mirror(tmp_path / "m", ABOUT)
    monkeypatch.undo()
    assert descriptors() == before
    assert not list(tmp_path.iterdir())


def test_room_for_all_of_a_mirror_is_taken_at_once(tmp_path, monkeypatch):
    asked: list[tuple[int, int]] = []

    def allocate(fd, *what):
        asked.append(what)
        os.ftruncate(fd, sum(what))

    monkeypatch.setattr(os, "posix_fallocate", allocate)
    Mirror(tmp_path / "m", ABOUT)
    assert asked == [(0, HEAD + 4 * SLOT)]


def test_a_mirror_whose_file_is_gone_is_closed_all_the_same(tmp_path):
    mirror = Mirror(tmp_path / "m", ABOUT)
    reader = MirrorReader(tmp_path / "m")
    (tmp_path / "m").unlink()
    mirror.close()
    assert reader.ended


def patched(path: Path, at: int, data: bytes):
    content = bytearray(path.read_bytes())
    content[at : at + len(data)] = data
    path.write_bytes(content)


NO_COLUMNS, NO_TABLE = b'{"a": 1}', b'{"columns": "[]"}'


@pytest.mark.parametrize(
    ("at", "data"),
    [
        (0, b"\0" * 8), (8, struct.pack("<q", 0)), (8, struct.pack("<q", -1)), (8, struct.pack("<q", HEAD - WORDS + 1)),
        (8, struct.pack("<q", -HEAD)), (8, struct.pack("<q", 1 << 62)), (8, struct.pack("<q", -(1 << 63))),
        (WORDS, b"{,"), (8, struct.pack("<qqq", len(NO_COLUMNS), 0, 0) + NO_COLUMNS),
        (8, struct.pack("<qqq", len(NO_TABLE), 0, 0) + NO_TABLE), (8, struct.pack("<qqq", 2, 0, 0) + b"[]"),
        (HEAD + 4 * SLOT, b"\0"),
    ],
)  # fmt: skip
def test_a_file_whose_head_or_description_or_size_is_another_is_no_mirror(tmp_path, at, data):
    Mirror(tmp_path / "m", ABOUT)
    patched(tmp_path / "m", at, data)
    before = len(descriptors())
    with pytest.raises(LogError, match="m is not what this version of hil shows of a run"):
        MirrorReader(tmp_path / "m")
    assert len(descriptors()) == before
