"""A log as a table: every component by name and unit, cut logs as far as they go, the plant's truth beside."""

import gc
import sys
import tracemalloc
from math import prod

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.records import Chunk

from drivers.errors import LogError
from drivers.tick_columns import ROW, Column
from hil.app.plant_columns import PLANT
from hil.record import Recording
from hil.record.data_frame import plant_rows_of
from hil.record.log import Log
from hil.record.mcap_read import MAX_CHUNK, decompress
from hil.record.salvage import salvage
from tests.hil.rewrite import rewrite_log
from tests.hil.samples import assert_same, log_of, random_rows, random_ticks

COUNT = 900
TICKS = random_ticks(COUNT, seed=21)
ROWS = np.array([tick.row for tick in TICKS])


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


def written(path, rows, configuration="", **options):
    with Recording.start(path, configuration=configuration, lockstep=True, **options) as recording:
        for row in rows:
            recording.tick(np.asarray(row), (), ())
    return path


# -- columns -------------------------------------------------------------------------------------------------


def test_every_number_of_a_row_is_a_column_with_a_unit_and_a_meaning(path):
    frame = Log(path).frame()
    assert frame.shape == (COUNT, ROW.itemsize // 8)
    assert frame.columns.is_unique
    assert frame.attrs["units"].keys() == frame.attrs["meanings"].keys() == set(frame.columns)
    assert all(frame.attrs["meanings"].values())


@pytest.mark.parametrize(
    ("label", "unit"),
    [
        ("t_ns", "ns"), ("q.leg_0", "m"), ("tau.leg_5", "N"), ("R.xy", "1"), ("age.leg_2", "ticks"),
        ("twist.vz", "m/s"), ("twist.wx", "rad/s"), ("wrench.fz", "N"), ("wrench.mx", "N m"),
        ("dtwist_d.vx", "m/s^2"), ("dtwist_d.wz", "rad/s^2"), ("pose_std.z", "m"), ("pose_std.rx", "rad"),
        ("mode", ""), ("drive_fault.leg_4", ""),
    ],
)  # fmt: skip
def test_a_component_has_its_own_unit(path, label, unit):
    assert Log(path).frame(label).attrs["units"] == {label: unit}


def test_the_values_are_those_of_the_rows_bit_for_bit(path):
    frame = Log(path).frame(numbers=True)
    for name in ROW.names or ():
        column = ROWS[name].reshape(COUNT, -1)
        labels = [label for label in frame.columns if label.split(".")[0] == name]
        assert len(labels) == prod(ROW[name].shape)
        for k, label in enumerate(labels):
            assert frame[label].to_numpy().tobytes() == np.ascontiguousarray(column[:, k]).tobytes(), label


def test_the_index_is_the_time_from_the_first_row_in_seconds(path):
    index = Log(path).frame("tick").index
    assert index.name == "t_s"
    np.testing.assert_allclose(index, np.arange(COUNT) * 1e-3, atol=1e-12)
    part = Log(path).frame("tick", start_s=0.3, stop_s=0.4)
    np.testing.assert_allclose(part.index, part["tick"] * 1e-3, atol=1e-12, err_msg="and so is a part of it")
    assert part["tick"].tolist() == list(range(300, 401))


def test_enumerations_and_flags_stand_by_name(tmp_path):
    rows = np.zeros(4, ROW)
    rows["tick"] = np.arange(4)
    rows["mode"] = [5, 10, 77, 0]
    rows["faults"] = [0, 3, 1 << 40, 1024 | 1 << 40]
    rows["drive_state"][:, 3] = [0, 1, 4, -2]
    frame = Log(written(tmp_path / "a.mcap", rows)).frame("mode", "faults", "drive_state.leg_3")
    assert frame["mode"].tolist() == ["TRACKING", "FAULT", "77", "WAITING"]
    assert frame["faults"].tolist() == ["NONE", "STALE|DRIVE", str(1 << 40), f"ESTOP|{1 << 40}"]
    assert frame["drive_state.leg_3"].tolist() == ["BOOT", "OFF", "FAULT", "-2"]
    assert frame["mode"].cat.categories[:3].tolist() == ["WAITING", "IDLE", "LOADING"]


def test_columns_and_components_are_chosen_by_name_in_the_order_asked_for(path):
    assert list(Log(path).frame("p", "tau.leg_3", "p.z").columns) == ["p.x", "p.y", "p.z", "tau.leg_3"]


def test_a_wrong_name_is_answered_with_the_nearest_right_ones(path):
    log = Log(path)
    with pytest.raises(LogError, match=r"no column 'tau.leg_6'; did you mean tau.leg_\d"):
        log.frame("tau.leg_6")
    with pytest.raises(LogError, match="no column 'lengths'"):
        log.rows("lengths")


def test_a_column_says_what_its_numbers_are_called(path):
    columns = {c.name: c for c in Log(path).columns}
    assert columns["mode"].names["TRACKING"] == 5
    assert columns["faults"].names["ESTOP"] == 1024
    assert columns["q"].names == {}
    assert columns["q"].labels == tuple(f"q.leg_{k}" for k in range(6))


def test_a_matrix_without_names_of_elements_is_named_by_place():
    assert Column("output", "A", float, "m", "", (), (2, 2)).labels == ("A.0_0", "A.0_1", "A.1_0", "A.1_1")


def test_without_pandas_the_message_says_how_to_install_it(path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LogError, match=r'pip install "hexapod-hil\[analysis\]"'):
        Log(path).frame()


# -- rows ----------------------------------------------------------------------------------------------------


def test_a_span_of_time_includes_both_ends(path):
    log = Log(path)
    assert log.rows("tick", start_s=0.1, stop_s=0.2)["tick"].tolist() == list(range(100, 201))
    assert log.frame("tick", start_s=0.85)["tick"].tolist() == list(range(850, COUNT))
    assert [int(t) for b in log.blocks("tick", stop_s=0.3) for t in b["tick"]] == list(range(301))


@pytest.mark.parametrize("options", [{}, {"chunk_size": 20_000}], ids=str)
def test_blocks_are_the_rows_in_pieces(path, tmp_path, options):
    rewrite_log(path, tmp_path / "b.mcap", **options)
    log = Log(tmp_path / "b.mcap")
    blocks = list(log.blocks())
    assert len(blocks) > 1
    assert np.concatenate(blocks).tobytes() == ROWS.tobytes()
    q = np.concatenate(list(log.blocks("tau", "q")))
    assert q.dtype.names == ("tau", "q")
    assert q["q"].tobytes() == np.ascontiguousarray(ROWS["q"]).tobytes()


def test_reading_in_pieces_takes_memory_for_a_piece_only(tmp_path):
    count = 20_000
    log = Log(written(tmp_path / "a.mcap", random_rows(count)))
    tracemalloc.start()
    try:
        seen = sum(len(block) for block in log.blocks("q"))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert seen == count
    assert peak < 0.2 * count * ROW.itemsize


@pytest.mark.long
def test_a_few_columns_of_a_log_take_memory_for_these_alone(tmp_path):
    count = 20_000
    log = Log(written(tmp_path / "a.mcap", random_rows(count)))
    tracemalloc.start()
    try:
        rows = log.rows("q")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(rows) == count
    assert peak < 0.2 * count * ROW.itemsize


@pytest.mark.long
def test_all_columns_take_little_more_memory_than_they_need(tmp_path):
    count = 20_000
    log = Log(written(tmp_path / "a.mcap", random_rows(count)))
    tracemalloc.start()
    try:
        rows = log.rows()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(rows) == count
    assert peak < 2.3 * count * ROW.itemsize


def test_a_process_that_reads_many_logs_keeps_nothing_of_them(tmp_path):
    path = written(tmp_path / "a.mcap", random_rows(5))

    def read(times: int) -> int:
        for _ in range(times):
            assert len(Log(path).rows()) == 5
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    read(3)
    tracemalloc.start()
    try:
        grown = -read(2) + read(20)
    finally:
        tracemalloc.stop()
    assert grown < 20 * 10_000, "bytes of twenty logs; their tables of columns alone took 134 kB each"


def test_rows_that_another_program_has_moved_come_in_tick_order(tmp_path):
    rows = np.zeros(6, ROW)
    rows["tick"] = [0, 2, 1, 3, 5, 4]
    rows["p"][:, 0] = rows["tick"]
    log = Log(written(tmp_path / "a.mcap", rows))
    assert log.rows("p")["p"][:, 0].tolist() == log.rows()["tick"].tolist() == [0, 1, 2, 3, 4, 5]


def test_no_piece_of_a_span_is_empty(path):
    blocks = [len(block) for block in Log(path).blocks("q", start_s=0.7, stop_s=0.71)]
    assert (min(blocks), sum(blocks)) == (11, 11)


def test_frames_come_in_the_order_of_their_times_and_none_is_missing(path):
    expected = []
    for tick in TICKS:
        now = int(tick.row["t_ns"])
        expected += [(t_ns, False, frame) for t_ns, frame in tick.received]
        expected += [(now, True, frame) for frame in tick.sent]
    expected.sort(key=lambda item: item[0])
    found = list(Log(path).can_frames())
    assert [(f.t_ns, f.sent, f.id, f.data, f.flags, f.bus) for f in found] == [
        (t_ns, sent, frame.id, frame.data, frame.flags % 256, frame.bus) for t_ns, sent, frame in expected
    ]


# -- cut -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.15, 0.3, 0.5, 0.77, 0.9, 0.98])
def test_a_cut_log_gives_what_a_salvage_gives(path, tmp_path, fraction):
    size = int(path.stat().st_size * fraction)
    bad = tmp_path / "cut.mcap"
    bad.write_bytes(path.read_bytes()[:size])
    log = Log(bad)
    report = salvage(bad, tmp_path / "whole.mcap")
    assert f"cut at {size} bytes" in log.cut
    assert 0 < report.ticks < COUNT
    assert_same(log.ticks(), TICKS[: report.ticks])
    assert log.rows().tobytes() == ROWS[: report.ticks].tobytes()
    assert len(log.frame("q")) == report.ticks
    frames = sum(len(tick.received) + len(tick.sent) for tick in TICKS[: report.ticks])
    assert log.summary[:2] == (report.ticks, frames)
    assert log.summary.closed == "cut"
    t_ns = log.rows("t_ns")["t_ns"]
    assert log.summary.duration_s == pytest.approx(1e-9 * (t_ns[-1] - t_ns[0]), abs=2e-3), "over all chunks"
    assert log.configuration == "a: 1\n"
    whole = Log(tmp_path / "whole.mcap")
    assert whole.cut == ""
    assert whole.rows().tobytes() == log.rows().tobytes()
    with pytest.raises(LogError, match="--salvage"):
        Log.open(bad)


@pytest.mark.parametrize(("name", "compress"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress)])
def test_a_chunk_that_unpacks_to_too_much_is_refused_before_it_is_unpacked(name, compress):
    bomb = compress(bytes(50_000_000))
    honest = Chunk(name, bomb, 0, 0, 0, MAX_CHUNK + 1)
    with pytest.raises(LogError, match=f"at most {MAX_CHUNK}"):
        decompress(honest)
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="damaged"):
            decompress(Chunk(name, bomb, 0, 0, 0, 1000))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000


# -- the plant -----------------------------------------------------------------------------------------------


def plant_rows(t_ns, syncs):
    rows = np.zeros(len(t_ns), PLANT.dtype)
    rows["tick"], rows["t_ns"], rows["syncs"] = np.arange(len(t_ns)), t_ns, syncs
    rows["p"][:, 2] = np.arange(len(t_ns))
    rows["drive_state"][:] = 3
    return rows


def tick_rows(t_ns, lateness_ns):
    rows = np.zeros(len(t_ns), ROW)
    rows["tick"], rows["t_ns"], rows["lateness_ns"] = np.arange(len(t_ns)), t_ns, lateness_ns
    return rows


def test_a_tick_gets_the_row_of_its_own_sync_and_none_where_the_plant_heard_none():
    ticks = tick_rows([0, 1_000_000, 2_000_000, 3_000_000], [10_000, 700_000, 0, 20_000])
    #                     tick 0   beat     tick 1     tick 2 lost, beat   tick 3; the grid is 50 us early
    plant = plant_rows([60_000, 400_000, 1_750_000, 2_000_000, 2_970_000], [1, 1, 2, 2, 3])
    assert plant_rows_of(ticks, plant).tolist() == [0, 2, -1, 4]


def test_a_plant_that_counts_no_sync_is_read_at_its_nearest_row():
    ticks = tick_rows([0, 1_000_000, 2_000_000], 0)
    plant = plant_rows([100_000, 900_000, 1_200_000], 0)
    assert plant_rows_of(ticks, plant).tolist() == [0, 1, -1]


def test_the_truth_stands_beside_the_ticks(tmp_path):
    written(tmp_path / "a.mcap", tick_rows([0, 1_000_000, 2_000_000], 0))
    written(tmp_path / "a-plant.mcap", plant_rows([50_000, 2_050_000], [1, 2]), table=PLANT)
    frame = Log(tmp_path / "a.mcap").frame("p.z", "plant.p.z", "plant.drive_state.leg_1")
    assert list(frame.columns) == ["p.z", "plant.p.z", "plant.drive_state.leg_1"]
    np.testing.assert_array_equal(frame["plant.p.z"], [0.0, np.nan, 1.0])
    assert frame["plant.drive_state.leg_1"].isna().tolist() == [False, True, False]
    assert frame["plant.drive_state.leg_1"].iloc[2] == "RUN"
    assert frame.attrs["units"]["plant.p.z"] == "m"
    every = Log(tmp_path / "a.mcap").frame("plant")
    assert every.shape == (3, PLANT.dtype.itemsize // 8)
    for names in (("plant", "plant.p"), ("plant.p.z", "plant"), ("plant", "plant")):
        assert list(Log(tmp_path / "a.mcap").frame(*names).columns) == list(every.columns)
    both = Log(tmp_path / "a.mcap").frame("p.z", "plant", "plant.p")
    assert list(both.columns) == ["p.z", *every.columns]


def test_a_plant_of_another_run_and_a_missing_one_are_refused(tmp_path):
    written(tmp_path / "a.mcap", tick_rows([0, 1_000_000, 2_000_000], 0))
    with pytest.raises(LogError, match=r"a-plant\.mcap, the plant's log, does not exist"):
        Log(tmp_path / "a.mcap").frame("plant.p")
    with pytest.raises(LogError, match="allowed: a log of a plant"):
        _ = Log(tmp_path / "a.mcap", plant=tmp_path / "a.mcap").plant
    later = written(tmp_path / "b.mcap", plant_rows([9_000_000_000, 9_001_000_000], [1, 2]), table=PLANT)
    with pytest.raises(LogError, match="is of another run"):
        Log(tmp_path / "a.mcap", plant=later).frame("plant.p")


def test_a_single_tick_whose_sync_the_plant_missed_gets_no_neighbours_row(tmp_path):
    ticks = written(
        tmp_path / "a.mcap", tick_rows([0, 1_000_000, 2_000_000], 0), metadata={"rate_Hz": 1000.0}
    )
    written(tmp_path / "a-plant.mcap", plant_rows([0, 2_000_000], [1, 2]), table=PLANT)
    log = Log(ticks)
    assert log.frame("plant.p.z", start_s=0.002, stop_s=0.002)["plant.p.z"].tolist() == [1.0]
    assert log.frame("plant.p.z")["plant.p.z"].isna().tolist() == [False, True, False]
    assert np.isnan(log.frame("plant.p.z", start_s=0.001, stop_s=0.001)["plant.p.z"]).tolist() == [True]


def test_in_simulated_time_a_plant_of_another_configuration_is_refused(tmp_path):
    for name, text in (("a", "a: 1\n"), ("b", "a: 2\n")):
        written(tmp_path / f"{name}.mcap", tick_rows([0, 1_000_000], 0), text)
        written(tmp_path / f"{name}-plant.mcap", plant_rows([0, 1_000_000], [1, 2]), text, table=PLANT)
    assert not Log(tmp_path / "a.mcap").frame("plant.p").isna().to_numpy().any()
    with pytest.raises(LogError, match=r"b-plant\.mcap is of another run: its configuration"):
        Log(tmp_path / "a.mcap", plant=tmp_path / "b-plant.mcap").frame("plant.p")


def test_a_plants_log_has_a_table_but_no_figures(tmp_path):
    log = Log(written(tmp_path / "p.mcap", plant_rows([0, 1_000_000], [1, 2]), table=PLANT))
    assert log.frame("length", "wrench.mz").attrs["units"]["wrench.mz"] == "N m"
    with pytest.raises(LogError, match="no figures"):
        log.figures()


def test_a_log_without_a_row_is_an_empty_table_with_all_its_columns(tmp_path):
    log = Log(written(tmp_path / "a.mcap", []))
    frame = log.frame()
    assert frame.shape == (0, ROW.itemsize // 8)
    assert (log.origin_ns, len(log.rows("q")), list(log.blocks()), list(log.can_frames())) == (0, 0, [], [])
