"""Mirror of the newest tick: never torn, private to its user, bound to its version, harmless to the log."""

from __future__ import annotations

import json
import multiprocessing
import stat
import time

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import ROW, Column
from hil.record import Recording
from hil.record.environment import product_version
from hil.record.mirror import FIGURES, PAST_ROWS, Mirror, MirrorReader, mirror_path
from hil.record.row import TICKS, Table, describe
from tests.hil.samples import random_rows

ABOUT = {"name": "test", "version": product_version(), "columns": describe(TICKS.columns)}
SMALL = tuple(Column("output", name, int, "", "", (), ()) for name in ("tick", "t_ns"))


def until(found, seconds=10.0):
    end = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < end, "the expected update of the mirror did not come"
        time.sleep(0.005)
    return value


def newest(reader):
    piece = reader.read()
    assert piece is not None
    return piece


def hammer(path, seconds):
    """Write thousands of pieces a second, each filled with a single number."""
    mirror = Mirror(path, ABOUT)
    row, figures = np.zeros((), ROW), np.zeros((), FIGURES)
    end, k = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        k += 1
        row["tick"] = row["t_ns"] = figures["ticks"] = figures["log_bytes"] = k
        row["R"][...] = row["tau"][...] = row["lyapunov_share"] = k
        mirror.write(row, figures, b"[" + b" " * (k % 2000) + str(k).encode() + b"]")
        time.sleep(1e-4)


def test_mirror_keeps_rows_of_the_last_minute_in_their_order(tmp_path):
    path = tmp_path / "m"
    mirror = Mirror(path, ABOUT)
    row = np.zeros((), ROW)
    for tick in range(0, 3 * PAST_ROWS * 20 + 1800, 20):  # 20 ms apart, more than the slots hold
        row["tick"], row["t_ns"] = tick, 1_000_000 * tick
        mirror.write(row, np.zeros((), FIGURES))
    past = MirrorReader(path).past()
    assert len(past) == PAST_ROWS
    assert set(np.diff(past["tick"])) == {60}
    assert tick - past["tick"][-1] < 60
    assert tick - past["tick"][0] == pytest.approx(60_000, abs=120), "a minute at 1 kHz"
    with path.open("r+b") as file:  # a row that is half written
        file.seek(-1000 * ROW.itemsize, 2)
        file.write(b"\xff" * 8)
    assert len(MirrorReader(path).past()) == PAST_ROWS - 1
    mirror.close()


def test_mirror_reader_sees_only_whole_updates_of_a_fast_writer(tmp_path):
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
    assert len(seen) > 20, "the reader kept up with a part of them"


def show(mirror, number, events=b"[]"):
    row, figures = np.zeros((), Table("", SMALL).dtype), np.zeros((), FIGURES)
    row["tick"], row["t_ns"], figures["ticks"], figures["log_bytes"] = number, -number, 10 * number, 7
    mirror.write(row, figures, events)


def test_mirror_updates_are_read_as_written_and_never_partially(tmp_path):
    path = tmp_path / "m"
    mirror = Mirror(path, ABOUT | {"name": "täst", "columns": describe(SMALL)})
    reader = MirrorReader(path)
    assert (reader.newest, reader.read(), reader.about["name"]) == (0, None, "täst")
    for number in range(1, 7):
        show(mirror, number, json.dumps([{"number": number}]).encode() + b" " * (7 - number))
        found = newest(reader)
        assert (found.number, int(found.row["tick"]), int(found.row["t_ns"])) == (number, number, -number)
        assert (int(found.figures["ticks"]), int(found.figures["log_bytes"])) == (10 * number, 7)
        assert (found.events, found.ended, reader.newest) == ([{"number": number}], False, number)
    data = path.read_bytes()
    place = data.rindex(b'[{"number": 6}]')
    with path.open("r+b") as file:
        file.seek(place)
        file.write(b" ")
    assert reader.read() is None
    mirror.close()
    assert newest(reader).ended


@pytest.mark.parametrize("data", [b"", b"x", bytes(64), b"\3" + bytes(7) + b"[1]", b"\2" + bytes(7) + b"{}"])
def test_mirror_reader_refuses_foreign_files_and_other_versions(tmp_path, data):
    (tmp_path / "m").write_bytes(data + bytes(1))
    with pytest.raises(LogError, match="another version"):
        MirrorReader(tmp_path / "m")
    Mirror(tmp_path / "m", ABOUT | {"version": "0.0.1"}).write(np.zeros((), ROW), np.zeros((), FIGURES))
    with pytest.raises(LogError, match="another version"):
        MirrorReader(tmp_path / "m")


def test_mirror_file_is_private_to_its_user_and_removed_with_the_run(tmp_path):
    path = tmp_path / "m"
    mirror = Mirror(path, ABOUT)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert mirror_path("localcan", "a/b").parent.stat().st_mode & 0o077 == 0
    assert mirror_path("localcan", "a/b").name == "localcan.a%2Fb.mirror"
    reader = MirrorReader(path)
    mirror.write(np.zeros((), ROW), np.zeros((), FIGURES), b'[{"text": "last"}]')
    mirror.close()
    assert not path.exists()
    assert newest(reader).ended
    assert newest(reader).events == [{"text": "last"}], "a reader with the file mapped keeps the update"
    with pytest.raises(FileNotFoundError):
        MirrorReader(path)


def test_new_run_keeps_its_mirror_file_if_the_previous_run_closes_late(tmp_path):
    path = tmp_path / "m"
    first, second = Mirror(path, ABOUT), Mirror(path, {**ABOUT, "name": "second"})
    first.close()
    assert MirrorReader(path).about["name"] == "second"
    second.close()
    assert not path.exists()


def test_the_recorder_updates_the_newest_row_fifty_times_a_second(tmp_path):
    path, shown = tmp_path / "a.mcap", tmp_path / "m"
    rows = random_rows(1500, seed=5)
    with Recording.start(path, configuration="", mirror=(shown, {"name": "x"})) as recording:
        reader = MirrorReader(shown)
        assert reader.about["name"] == "x"
        assert reader.read() is None, "no tick yet"
        numbers, begun = set(), time.monotonic()
        for k, row in enumerate(rows):
            recording.tick(row, (), ())
            while time.monotonic() < begun + 1e-3 * k:
                piece = reader.read()
                if piece is not None:
                    numbers.add(piece.number)
                    assert abs(int(piece.row["tick"]) - k) < 400
                time.sleep(5e-4)
        seconds = time.monotonic() - begun
        last = until(lambda: (p := reader.read()) and int(p.figures["ticks"]) == 1500 and p)
        assert last.row.tobytes() == rows[-1].tobytes()
        until(lambda: int(newest(reader).figures["waiting"]) == 0)
    assert recording.close().complete
    assert newest(reader).ended
    assert not shown.exists()
    assert 20 <= len(numbers) / seconds <= 51, "every 20 ms on a machine that is not too busy"


def test_a_mirror_that_cannot_be_created_does_not_stop_the_log(tmp_path, capfd):
    path = tmp_path / "a.mcap"
    with Recording.start(path, configuration="", mirror=(tmp_path / "no" / "m", {})) as recording:
        for row in random_rows(20):
            recording.tick(row, (), ())
    assert recording.close().complete
    assert "cannot see this run" in capfd.readouterr().err


def test_last_mirror_update_of_a_killed_recorder_stays_readable(tmp_path):
    shown = tmp_path / "m"
    recording = Recording.start(tmp_path / "a.mcap", configuration="", mirror=(shown, {}))
    recording.tick(random_rows(1)[0], (), ())
    reader = MirrorReader(shown)
    until(reader.read)
    recording.process.kill()
    recording.close()
    assert not newest(reader).ended
    assert int(newest(reader).row["tick"]) == 0
    assert reader.about["columns"] == describe(TICKS.columns)
