"""The table of columns of a log: what it has to have, and how protobuf and its schema show a column."""

from itertools import pairwise

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from drivers.tick_columns import RECORDED, Column
from hil.record.row import TICKS, RowCodec, Table, columns_of, describe, row_schema
from hil.record.schema import message_class


def column(
    name: str, kind: type = int, elements: tuple[str, ...] = (), shape: tuple[int, ...] = ()
) -> Column:
    return Column("output", name, kind, "m", "what it is", elements, shape)


TICK, TIME = column("tick"), column("t_ns")


@pytest.mark.parametrize(("name", "other"), [("tick", TIME), ("t_ns", TICK)])
@pytest.mark.parametrize("instead", ["nothing", "another", "floats", "several"])
def test_a_row_without_the_number_or_the_time_of_its_tick_is_refused(name, other, instead):
    there: dict[str, list[Column]] = {
        "nothing": [],
        "another": [column("count")],
        "floats": [column(name, float), column("count")],
        "several": [column(name, shape=(1,)), column("count")],
    }
    with pytest.raises(ValueError, match=f"the row needs a scalar integer column {name}"):
        Table("/tick", (other, *there[instead])).check()
    with pytest.raises(ValueError, match=f"the row needs a scalar integer column {name}"):
        columns_of(describe((other, *there[instead])))
    Table("/tick", (other, column(name))).check()
    assert columns_of(describe((other, column(name)))) == (other, column(name))


@pytest.mark.parametrize("kind", [int, float])
def test_protobuf_reads_numbers_without_names_as_a_list(kind):
    table = Table("/tick", (TICK, TIME, column("A", kind, (), (2, 3)), column("b", kind, (), (1,))))
    rows = np.zeros(2, table.dtype)
    rows["tick"], rows["A"], rows["b"] = [4, 5], np.arange(12).reshape(2, 2, 3), [[8], [9]]
    codec = RowCodec(table.columns)
    records = codec.layout.new(2)
    codec.write(rows, records)
    read = message_class(row_schema(table))
    found = [read.FromString(record.tobytes()[31:]) for record in records]
    assert [(m.tick, list(m.A), list(m.b)) for m in found] == [
        (4, [0, 1, 2, 3, 4, 5], [8]),
        (5, [6, 7, 8, 9, 10, 11], [9]),
    ]
    assert np.array([codec.parse(m) for m in found]).tobytes() == rows.tobytes()


def test_the_comments_of_the_fields_stand_on_lines_of_their_own_in_the_order_of_the_fields():
    (file,) = FileDescriptorSet.FromString(row_schema(TICKS).descriptors).file
    places = list(file.source_code_info.location)
    fields = file.message_type[0].field
    assert [list(at.path) for at in places] == [[4, 0, 2, k] for k in range(len(fields))]
    lines = [at.span[0] for at in places]
    assert lines[0] >= 0
    assert all(b > a for a, b in pairwise(lines))
    columns = {c.name: c for c in RECORDED}
    for field, at in zip(fields, places, strict=True):
        c = columns[field.name.removesuffix("_number")]
        assert at.leading_comments == (f" {c.meaning} [{c.unit}]\n" if c.unit else f" {c.meaning}\n")
