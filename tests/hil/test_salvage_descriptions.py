"""What a damaged log says of itself: each part from the best place, and what was mended is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata
from mcap.records import Schema as SchemaRecord

from drivers.errors import LogError
from hil.record import descriptions as module
from hil.record.descriptions import Descriptions
from hil.record.mcap_file import record_bytes
from hil.record.mcap_read import Record
from hil.record.row import TICKS, describe, row_schema
from hil.record.schema import frame_schema, operator_schema
from hil.record.surviving import Lost

IDENTITY = {"topic": "/tick", "columns": describe(TICKS.columns), "mode": "lockstep"}
BAD = b"\xff\xff"
FRAMES = frame_schema().descriptors


def record(what, *, complete=True, offset=0):
    data = record_bytes(what)
    return Record(data[0], offset, data[9:], complete)


def identity(name="hil", **said):
    return record(Metadata(name=name, metadata=said or IDENTITY))


def schema(number, name="hil.Frame", data=FRAMES, encoding="protobuf", **how):
    return record(SchemaRecord(id=number, name=name, encoding=encoding, data=data), **how)


def channel(number, topic, schema_id):
    return record(
        Channel(id=number, topic=topic, message_encoding="protobuf", metadata={}, schema_id=schema_id)
    )


@pytest.fixture
def descriptions(monkeypatch):
    """A function that returns what is known of a log of these records."""

    def of(*records):
        def surviving(path, *, index):
            assert (path, index) == (Path("a.mcap"), True)
            yield from records

        monkeypatch.setattr(module, "surviving", surviving)
        return Descriptions(Path("a.mcap"))

    return of


def test_a_whole_log_is_taken_at_its_word(descriptions):
    found = descriptions(
        identity(),
        schema(1, row_schema(TICKS).name, row_schema(TICKS).descriptors),
        schema(2),
        channel(7, "/tick", 1),
        channel(8, "/can", 2),
        channel(9, "/of another program", 0),
        channel(3, "/tick", 1),
    )
    assert found.remarks == []
    assert found.identity == IDENTITY
    assert (list(found.schemas), list(found.channels)) == ([1, 2], [7, 8, 9, 3])
    assert found.of_ticks() == [7, 3]
    assert found.schemas[2].data == FRAMES


@pytest.mark.parametrize(
    "records", [[], [Lost(0, 9)], [identity("other")], [identity(topic="/tick", mode="lockstep")]]
)
def test_what_says_nowhere_that_it_is_a_log_of_ours_is_none(descriptions, records):
    with pytest.raises(
        LogError, match=r"a.mcap: no log of this product, or cut within its first bytes: nothing to"
    ):
        descriptions(*records)


def test_the_first_identity_counts_and_one_that_is_cut_does_not(descriptions):
    cut = identity()._replace(complete=False)
    first, second = {**IDENTITY, "seed": "1"}, {**IDENTITY, "seed": "2"}
    assert descriptions(cut, identity(**first), Lost(3, 5), identity(**second)).identity == first


def test_an_identity_of_version_0_1_0_has_its_types_alone(descriptions):
    said = {"topic": "/tick", "dtype": json.dumps([["tick", "<i8", []], ["t_ns", "<i8", []]])}
    assert descriptions(identity(**said)).identity == said
    damaged = {**said, "dtype": said["dtype"].replace("t_ns", "t_n5")}
    with pytest.raises(
        LogError, match=r"a.mcap: its table of columns is damaged: nothing to salvage: the row needs"
    ):
        descriptions(identity(**damaged))


def test_a_damaged_table_of_columns_is_mended_in_a_log_of_ticks_and_in_no_other(descriptions):
    damaged = IDENTITY["columns"].replace('"t_ns"', '"t_n5"')
    found = descriptions(identity(**{**IDENTITY, "columns": damaged}))
    assert found.identity == IDENTITY
    assert found.remarks == ["the table of columns is damaged; that of this version takes its place"]
    with pytest.raises(
        LogError, match=r"a.mcap: its table of columns is damaged: nothing to salvage: the row needs"
    ):
        descriptions(identity(**{**IDENTITY, "columns": damaged, "topic": "/plant"}))


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_schemas_of_one_number_the_one_that_can_be_used_counts_wherever_it_stands(descriptions, order):
    two = [schema(2, data=BAD), schema(2)][::order]
    found = descriptions(identity(), *two, channel(8, "/can", 2))
    assert (found.schemas[2].data, found.remarks) == (FRAMES, [])
    other = descriptions(identity(), schema(2, "first", b"1", ""), schema(2, "second", b"2", ""))
    assert other.schemas[2].name == "first", "of two that are right the first"


def test_the_first_channel_of_a_number_counts_and_a_schema_of_the_number_0_is_none(descriptions):
    found = descriptions(identity(), channel(8, "/can", 2), channel(8, "/other", 0), schema(2), schema(0))
    assert (found.channels[8].topic, list(found.schemas)) == ("/can", [2])


def test_a_record_that_cannot_be_read_is_said_with_its_place(descriptions):
    whole = channel(8, "/can", 2)
    found = descriptions(identity(), whole._replace(content=whole.content[:5], offset=321), schema(2))
    (remark,) = found.remarks
    assert remark.startswith("damaged at byte 321: ")
    assert found.channels == {}
    assert descriptions(identity(), Record(Opcode.CHUNK, 1, b"", True)).remarks == [], "others are not read"


@pytest.mark.parametrize(
    ("topic", "ours"),
    [
        ("/can", frame_schema()),
        ("/operator", operator_schema()),
        ("/tick", row_schema(TICKS)),
        ("/events", None),
    ],
)
@pytest.mark.parametrize("damaged", [True, False])
def test_a_schema_without_a_usable_copy_is_made_anew_if_it_is_ours_and_else_the_channel_has_none(
    descriptions, topic, ours, damaged
):
    there = [schema(5, data=BAD)] if damaged else []
    found = descriptions(
        identity(), *there, channel(8, topic, 5), channel(9, "/mine", 6), schema(6, "x", b"", "")
    )
    if ours is None:
        assert found.remarks == ["the schema of /events is lost"]
        assert (list(found.schemas), found.channels[8].schema_id) == ([6], 0)
    else:
        assert found.remarks == [f"the schema of {topic} is damaged; that of this version takes its place"]
        made = found.schemas[5]
        assert (made.id, made.name, made.encoding, made.data) == (5, ours.name, "protobuf", ours.descriptors)
        assert found.channels[8].schema_id == 5
    assert found.channels[9].schema_id == 6, "of another encoding, which is not looked into"


def test_the_schema_of_rows_of_version_0_1_0_is_not_made_anew(descriptions):
    said = {"topic": "/tick", "dtype": json.dumps([["tick", "<i8", []], ["t_ns", "<i8", []]])}
    assert descriptions(identity(**said), channel(1, "/tick", 5)).remarks == ["the schema of /tick is lost"]


def test_what_stands_in_a_chunk_adds_what_was_not_known(descriptions):
    found = descriptions(identity(), schema(2), channel(8, "/can", 2))
    new = found.further(
        [schema(3, "x", b"", ""), channel(9, "/new", 3), schema(2, "y", b"", ""), channel(8, "/z", 0)]
    )
    assert [(each.id, getattr(each, "topic", "a schema")) for each in new] == [(3, "a schema"), (9, "/new")]
    assert list(found.schemas) == [2, 3]
    assert found.further([channel(9, "/new", 3)]) == []
    made = found.unknown(12)
    assert found.channels[12] is made
    assert (made.id, made.topic, made.message_encoding, made.metadata, made.schema_id) == (
        12,
        "/unknown_12",
        "",
        {},
        0,
    )
