"""A log as a table: each component by name and unit, with the plant's rows of the same run."""

import sys
from math import prod
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import ROW, Column
from hil.app.plant_rows import PLANT
from hil.record import Recording
from hil.record.data_frame import plant_rows_of, require_one_run
from hil.record.log import Log
from hil.record.schema import CONFIGURATION, IDENTITY, RUN
from tests.hil.samples import log_of, random_ticks

COUNT = 900
TICKS = random_ticks(COUNT, seed=21)
ROWS = np.array([tick.row for tick in TICKS])
MS = 1_000_000
CLOCK_NS = 10_000_000_000
"""Largest difference between the start times of two logs of one run."""
EPOCH = 946_684_800_000_000_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


def written(path, rows, configuration="", **options):
    with Recording.start(path, configuration=configuration, lockstep=True, **options) as recording:
        for row in rows:
            recording.tick(np.asarray(row), (), ())
    return path


# -- columns ---------------------------------------------------------------------------------------------------


def test_each_number_of_a_row_is_a_column_with_unit_and_meaning(path):
    frame = Log(path).frame(numbers=True)
    assert frame.shape == (COUNT, ROW.itemsize // 8)
    assert frame.columns.is_unique
    assert frame.attrs["units"].keys() == frame.attrs["meanings"].keys() == set(frame.columns)
    assert all(frame.attrs["meanings"].values())
    for name in ROW.names or ():
        column = ROWS[name].reshape(COUNT, -1)
        labels = [label for label in frame.columns if label.split(".")[0] == name]
        assert len(labels) == prod(ROW[name].shape)
        for k, label in enumerate(labels):
            assert frame[label].to_numpy().tobytes() == np.ascontiguousarray(column[:, k]).tobytes(), label


def test_each_component_has_its_own_unit(path):
    units = {
        "t_ns": "ns", "q.leg_0": "m", "tau.leg_5": "N", "R.xy": "1", "age.leg_2": "ticks", "twist.vz": "m/s",
        "twist.wx": "rad/s", "wrench.fz": "N", "wrench.mx": "N m", "dtwist_d.vx": "m/s^2",
        "dtwist_d.wz": "rad/s^2", "pose_std.z": "m", "pose_std.rx": "rad", "mode": "", "drive_fault.leg_4": "",
    }  # fmt: skip
    assert Log(path).frame(*units).attrs["units"] == units


def test_index_is_the_time_since_the_first_row_in_seconds(path):
    index = Log(path).frame("tick").index
    assert index.name == "t_s"
    np.testing.assert_allclose(index, np.arange(COUNT) * 1e-3, atol=1e-12)
    part = Log(path).frame("tick", start_s=0.3, stop_s=0.4)
    np.testing.assert_allclose(part.index, part["tick"] * 1e-3, atol=1e-12, err_msg="and so is a part of it")
    assert part["tick"].tolist() == list(range(300, 401))


def test_enumerations_and_flags_are_shown_by_name(tmp_path):
    rows = np.zeros(4, ROW)
    rows["tick"] = np.arange(4)
    rows["mode"] = [5, 10, 77, 0]
    rows["faults"] = [0, 3, 1 << 40, 1024 | 1 << 40]
    rows["drive_state"][:, 3] = [0, 1, 4, -2]
    log = Log(written(tmp_path / "a.mcap", rows))
    frame = log.frame("mode", "faults", "drive_state.leg_3")
    assert frame["mode"].tolist() == ["TRACKING", "FAULT", "77", "WAITING"]
    assert frame["faults"].tolist() == ["NONE", "STALE|DRIVE", str(1 << 40), f"ESTOP|{1 << 40}"]
    assert frame["drive_state.leg_3"].tolist() == ["BOOT", "OFF", "FAULT", "-2"]
    assert frame["mode"].cat.categories[:3].tolist() == ["WAITING", "IDLE", "LOADING"]
    columns = {c.name: c for c in log.columns}
    assert (columns["mode"].names["TRACKING"], columns["faults"].names["ESTOP"]) == (5, 1024)


def test_columns_are_selected_by_name_and_typos_get_suggestions(path):
    log = Log(path)
    assert list(log.frame("p", "tau.leg_3", "p.z").columns) == ["p.x", "p.y", "p.z", "tau.leg_3"]
    with pytest.raises(LogError, match=r"no column 'tau.leg_6'; did you mean tau.leg_\d"):
        log.frame("tau.leg_6")
    with pytest.raises(LogError, match="no column 'lengths'"):
        log.rows("lengths")
    matrix = Column("output", "A", float, "m", "", (), (2, 2))
    assert matrix.labels == ("A.0_0", "A.0_1", "A.1_0", "A.1_1")


@pytest.mark.parametrize("names", [("q", "t_ns", "tick"), ("t_ns", "tick"), ("q", "tick", "q")])
def test_columns_appear_once_and_in_the_requested_order(path, names):
    found = Log(path).rows(*names)
    assert found.dtype.names == tuple(dict.fromkeys(names))
    for name in names:
        assert found[name].tobytes() == np.ascontiguousarray(ROWS[name]).tobytes()


def test_message_without_pandas_explains_its_installation(path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(LogError, match=r'pip install "hexapod-hil\[analysis\]"'):
        Log(path).frame()


def test_log_without_rows_is_an_empty_table_with_all_columns(tmp_path):
    log = Log(written(tmp_path / "a.mcap", []))
    assert log.frame().shape == (0, ROW.itemsize // 8)
    assert (log.origin_ns, len(log.rows("q")), list(log.blocks()), list(log.can_frames())) == (0, 0, [], [])


# -- the plant's row of a tick ---------------------------------------------------------------------------------


def plant_rows(t_ns, syncs):
    rows = np.zeros(len(t_ns), PLANT.dtype)
    rows["tick"], rows["t_ns"], rows["syncs"] = np.arange(len(t_ns)), t_ns, syncs
    rows["p"][:, 2] = np.arange(len(t_ns))
    rows["drive_state"][:] = 3
    return rows


def tick_rows(t_ns, lateness_ns=0):
    rows = np.zeros(len(t_ns), ROW)
    rows["tick"], rows["t_ns"], rows["lateness_ns"] = np.arange(len(t_ns)), t_ns, lateness_ns
    return rows


HALF = MS // 2
PLACES = {
    # ticks, lateness, plant's times, its counts of SYNC, the rows of the ticks
    "own SYNC, not the nearest": ([0, MS], 10_000, [0, 400_000, 950_000, 1_200_000], [1, 1, 1, 2], [0, 3]),
    "late": ([0, MS], [0, 700_000], [0, MS, 1_700_000], [1, 1, 2], [0, 2]),
    "one lost": (
        [0, MS, 2 * MS, 3 * MS], [10_000, 700_000, 0, 20_000],
        [60_000, 400_000, 1_750_000, 2_000_000, 2_970_000], [1, 1, 2, 2, 3], [0, 2, -1, 4],
    ),
    "half a period": ([0, MS], 0, [0, MS + HALF], [1, 2], [0, 1]),
    "more than half": ([0, MS], 0, [0, MS + HALF + 1], [1, 2], [0, -1]),
    "one row for two": ([0, MS // 4], 0, [10], [1], [0, -1]),
    "no SYNC counted": ([0, MS, 2 * MS], 0, [0, 900_000, 1_900_000], 0, [0, 1, 2]),
    "no SYNC counted, far": ([0, MS, 2 * MS], 0, [100_000, 900_000, 1_200_000], 0, [0, 1, -1]),
    "no ticks": ([], 0, [0], [1], []),
    "no rows": ([0, 1], 0, [], [], [-1, -1]),
    "long before": ([50 * MS], 0, [MS], [1], [-1]),
    "long after, no SYNC": ([0], 0, [50 * MS, 50 * MS + 10], 0, [-1]),
    "equally near": ([MS], 0, [MS - 400, MS + 400], [1, 2], [1]),
    "equally near ticks": ([0, MS], 0, [HALF], [1], [-1, 0]),
    "both ends": (
        [-400_000, 2_000_100, 2_900_000, 9 * MS], 0, [5_000, 2_000_000, 2_500_000], [1, 2, 3], [0, 1, 2, -1],
    ),
    "count begins again": ([0, MS, 2 * MS, 3 * MS], 0, [0, MS, 2 * MS, 3 * MS], [7, 8, 1, 2], [0, 1, -1, 3]),
}  # fmt: skip


@pytest.mark.parametrize(("ticks", "late", "times", "syncs", "places"), PLACES.values(), ids=PLACES)
def test_tick_gets_the_plant_row_of_its_own_sync_or_none(ticks, late, times, syncs, places):
    assert plant_rows_of(tick_rows(ticks, late), plant_rows(times, syncs), MS).tolist() == places


def test_true_state_is_in_the_table_of_the_ticks(tmp_path):
    written(tmp_path / "a.mcap", tick_rows([0, MS, 2 * MS]), metadata={"rate_Hz": 1000.0})
    written(tmp_path / "a-plant.mcap", plant_rows([50_000, 2_050_000], [1, 2]), table=PLANT)
    log = Log(tmp_path / "a.mcap")
    frame = log.frame("p.z", "plant.p.z", "plant.drive_state.leg_1")
    assert list(frame.columns) == ["p.z", "plant.p.z", "plant.drive_state.leg_1"]
    np.testing.assert_array_equal(frame["plant.p.z"], [0.0, np.nan, 1.0])
    assert frame["plant.drive_state.leg_1"].isna().tolist() == [False, True, False]
    assert frame["plant.drive_state.leg_1"].iloc[2] == "RUN"
    assert frame.attrs["units"]["plant.p.z"] == "m"
    every = log.frame("plant")
    assert every.shape == (3, PLANT.dtype.itemsize // 8)
    for names in (("plant", "plant.p"), ("plant.p.z", "plant")):
        assert list(log.frame(*names).columns) == list(every.columns)
    assert list(log.frame("p.z", "plant", "plant.p").columns) == ["p.z", *every.columns]
    for start_s, stop_s, heights in ((0.002, 0.002, [1.0]), (0.001, 0.001, [np.nan]), (None, 0.0, [0.0])):
        part = log.frame("plant.p.z", start_s=start_s, stop_s=stop_s)
        np.testing.assert_array_equal(
            part["plant.p.z"], heights, err_msg="a span without a SYNC is no other run"
        )


# -- one run ---------------------------------------------------------------------------------------------------


def described(
    path, *, epoch_ns=EPOCH, lockstep=True, configuration: bytes | None = b"x: 1\n", run: str | None = "7"
):
    """The fields of a log that identify its run."""
    made: Any = SimpleNamespace(
        path=path, epoch_ns=epoch_ns, lockstep=lockstep,
        attachments={CONFIGURATION: configuration} if configuration else {},
        metadata={IDENTITY: {RUN: run} if run else {}},
    )  # fmt: skip
    return made


LIVE: dict[str, Any] = {"lockstep": False, "run": None}
NO_TICK, OTHER, INPUTS = "it has no tick of a.mcap", "its configuration", "set-points, commands or faults"


@pytest.mark.parametrize(
    ("log", "plant", "places", "why"),
    [
        ({}, {}, [0, 1], ""),
        ({}, {"epoch_ns": EPOCH + CLOCK_NS}, [0, 1], ""),
        ({}, {"epoch_ns": EPOCH - CLOCK_NS}, [0, 1], ""),
        ({}, {"configuration": None}, [0, 1], ""),
        ({}, {"run": None}, [0, 1], ""),
        ({"run": None}, {"run": None}, [0, 1], ""),
        ({}, {}, [-1, -1, 2], ""),
        ({}, {}, [], ""),
        (LIVE, LIVE | {"configuration": b"y: 2\n"}, [0, 1], ""),
        ({}, {"epoch_ns": EPOCH + CLOCK_NS + 1}, [0, 1], NO_TICK),
        ({}, {"epoch_ns": EPOCH - CLOCK_NS - 1}, [0, 1], NO_TICK),
        ({}, {}, [-1, -1], NO_TICK),
        ({}, {"configuration": b"y: 2\n"}, [0, 1], OTHER),
        ({}, {"lockstep": False}, [0, 1], OTHER),
        (LIVE, {}, [0, 1], OTHER),
        ({}, {"run": "8"}, [0, 1], INPUTS),
    ],
)
def test_logs_of_different_runs_are_refused_with_the_difference(log, plant, places, why):
    """In real time the plant may have its own file; logs of earlier versions have no run identity."""
    both = described("a.mcap", **log), described("b.mcap", **plant), np.array(places, int)
    if not why:
        require_one_run(*both)
        return
    with pytest.raises(LogError, match=f"b.mcap belongs to another run: {why}"):
        require_one_run(*both)


def test_plant_log_of_another_run_or_missing_is_refused(tmp_path):
    for name, text, t_ns in (("a", "a: 1\n", 0), ("b", "a: 2\n", 0), ("c", "a: 1\n", 9_000_000_000)):
        written(tmp_path / f"{name}.mcap", tick_rows([0, MS]), text, metadata={"rate_Hz": 1000.0})
        if name != "a":
            written(tmp_path / f"{name}-plant.mcap", plant_rows([t_ns, t_ns + MS], [1, 2]), text, table=PLANT)
    a = tmp_path / "a.mcap"
    assert not Log(tmp_path / "b.mcap").frame("plant.p").isna().to_numpy().any()
    with pytest.raises(LogError, match=r"a-plant\.mcap, the plant's log, does not exist"):
        Log(a).frame("plant.p")
    with pytest.raises(LogError, match="allowed: a log of a plant"):
        _ = Log(a, plant=a).plant
    for other, why in (("b", "its configuration"), ("c", "it has no tick")):
        with pytest.raises(LogError, match=rf"{other}-plant\.mcap belongs to another run: {why}"):
            Log(a, plant=tmp_path / f"{other}-plant.mcap").frame("plant.p")


def test_plant_log_has_a_table_but_no_figures(tmp_path):
    log = Log(written(tmp_path / "p.mcap", plant_rows([0, MS], [1, 2]), table=PLANT))
    assert log.frame("length", "wrench.mz").attrs["units"]["wrench.mz"] == "N m"
    with pytest.raises(LogError, match="no figures"):
        log.figures()
