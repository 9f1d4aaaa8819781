"""The table of a tick's columns: their names, elements and units, and the records that are made of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers import tick_columns as t
from drivers.signals import NEVER, Mode


@pytest.mark.parametrize(
    ("name", "shape", "labels", "units"),
    [
        ("tick", (), ("tick",), ("",)),
        ("tau", (6,), tuple(f"tau.leg_{k}" for k in range(6)), ("N",) * 6),
        ("p", (3,), ("p.x", "p.y", "p.z"), ("m",) * 3),
        ("R", (3, 3), tuple(f"R.{a}{b}" for a in "xyz" for b in "xyz"), ("1",) * 9),
        (
            "twist",
            (6,),
            tuple(f"twist.{k}" for k in ("vx", "vy", "vz", "wx", "wy", "wz")),
            ("m/s",) * 3 + ("rad/s",) * 3,
        ),
        (
            "wrench",
            (6,),
            tuple(f"wrench.{k}" for k in ("fx", "fy", "fz", "mx", "my", "mz")),
            ("N",) * 3 + ("N m",) * 3,
        ),
        (
            "pose_std",
            (6,),
            tuple(f"pose_std.{k}" for k in ("x", "y", "z", "rx", "ry", "rz")),
            ("m",) * 3 + ("rad",) * 3,
        ),
        ("doubt_value", (), ("doubt_value",), ("m, m/s",)),
        ("J", (6, 6), tuple(f"J.{k}" for k in range(36)), ("m",) * 18 + ("1",) * 18),
    ],
)
def test_a_column_has_shape_labels_and_units(name, shape, labels, units):
    column = t.COLUMNS[name]
    assert (column.shape, column.labels, column.units) == (shape, labels, units)
    assert column.size == len(labels)


def test_elements_without_names_are_labelled_by_their_places():
    plain = t.Column("effort", "x", float, "N, m", "", (), (2, 2))
    assert plain.labels == ("x.0_0", "x.0_1", "x.1_0", "x.1_1")
    assert plain.units == ("N", "N", "m", "m")
    assert t.Column("effort", "x", float, "N, m", "", (), (3,)).units == ("N, m",) * 3
    assert t.column("effort", "x", float, "N", "", "a", "b").shape == (2,)


def test_numbers_are_eight_bytes_and_an_enumeration_names_its_numbers():
    assert t.COLUMNS["mode"].kind == t.COLUMNS["tick"].kind == "<i8"
    assert t.COLUMNS["tau"].kind == "<f8"
    assert t.COLUMNS["mode"].names == {mode.name: int(mode) for mode in Mode}
    assert t.COLUMNS["doubled"].names == {f"LEG_{leg}": 1 << leg for leg in range(6)}
    assert t.COLUMNS["tau"].names == t.COLUMNS["tick"].names == {}
    for dtype in (t.ROW, t.TICK):
        assert dtype.itemsize == 8 * sum(t.COLUMNS[name].size for name in dtype.names or ())


def test_the_row_of_the_log_is_the_beginning_of_a_tick():
    names = t.TICK.names or ()
    assert names == tuple(c.name for c in (*t.RECORDED, *t.WORKING))
    assert t.ROW.names == names[: len(t.RECORDED)]
    record: Any = t.new_record()
    row: Any = t.row_of(record)
    record["tick"], record["q"] = 7, [1, 2, 3, 4, 5, 6]
    assert (row["tick"], row["q"].tolist()) == (7, [1, 2, 3, 4, 5, 6])
    assert row.base is record.base
    assert (record.base.nbytes, record.base.dtype) == (t.TICK.itemsize, np.float64), "all columns, no more"


def test_a_record_begins_before_the_first_tick_and_a_copy_goes_its_own_way():
    record: Any = t.new_record()
    assert (record["tick"], record["age"].tolist()) == (-1, [NEVER] * 6)
    nowhere = {name for name in t.COLUMNS if np.isnan(record[name].astype(float)).all()}
    assert nowhere == {
        "t_d",
        "encoder_share",
        "lyapunov",
        "lyapunov_rate",
        "lyapunov_bound",
        "lyapunov_share",
    }
    zeros = set(t.COLUMNS) - nowhere - {"tick", "age"}
    assert not any(record[name].any() for name in zeros)
    other = t.copy_of(record)
    other["tick"] = 5
    assert [int(each["tick"]) for each in (record, t.FIRST, t.new_record())] == [-1, -1, -1]
    with pytest.raises(ValueError, match="read-only"):
        t.FIRST["tick"] = 1


def test_replay_reads_the_inputs_back_and_compares_the_rest():
    assert {"tick", "t_ns", "latch_ns", "bus_state", "recorder_dropped"} <= set(t.INPUT_COLUMNS)
    assert not {"frames_received", "frames_crc32", "mode", "tau"} & set(t.INPUT_COLUMNS)
    assert sorted(t.INPUT_COLUMNS + t.COMPUTED_COLUMNS) == sorted(c.name for c in t.RECORDED)
    assert len(t.INPUT_COLUMNS) + 5 == t.INPUT_ELEMENTS, "one of them has an element a leg"
    assert t.part("effort") == (
        "tau_law",
        "tau_learned",
        "legs_refused",
        "probe_force",
        "shortfall",
        "tau_asked",
    )
    assert t.part("measurement", "verdict")[:2] == ("rejected", "foreign")
