"""The schemas of frames and commands as other programs read them, and the bytes that a layout is made of."""

from __future__ import annotations

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp

from hil.record.layout import (
    FIXED64,
    LENGTH,
    VARINT,
    Builder,
    varint,
)
from hil.record.schema import frame_schema, message_class, operator_schema
from hil.signals import Operator

FRAME = {
    "header": (1, "MESSAGE", "Header", "received: end of the frame; sent: the tick, or the send"),
    "id": (2, "FIXED32", "", "without flags"),
    "is_rtr": (3, "BOOL", "", ""),
    "is_extended": (4, "BOOL", "", ""),
    "is_error": (5, "BOOL", "", ""),
    "dlc": (6, "UINT32", "", "code of ISO 11898-1: 9 is 12 bytes, 15 is 64"),
    "data": (7, "BYTES", "", ""),
    "channel": (8, "STRING", "", ""),
    "direction": (9, "ENUM", "Direction", "seen from who wrote the log"),
    "fdf": (10, "BOOL", "", "CAN FD format"),
    "brs": (11, "BOOL", "", "bit rate switch"),
    "esi": (12, "BOOL", "", "error state indicator"),
    "tick": (13, "SFIXED64", "", "tick that consumed or sent the frame"),
    "index": (14, "FIXED32", "", "order within the tick"),
    "bus": (15, "UINT32", "", "which of the buses, from 0"),
}
COMMAND = {
    "stamp": (1, "MESSAGE", "Timestamp", ""),
    "command": (2, "ENUM", "Operator", ""),
    "tick": (3, "SFIXED64", "", ""),
    "index": (4, "FIXED32", "", ""),
    "setpoint": (5, "DOUBLE", "", "of SETPOINT: x, y, z in m and the rotation vector in rad; else the command's numbers"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("schema", "name", "fields"),
    [(frame_schema(), "hil.Frame", FRAME), (operator_schema(), "hil.OperatorCommand", COMMAND)],
    ids=["frame", "command"],
)
def test_a_message_has_its_fields_under_their_numbers_with_what_they_mean(schema, name, fields):
    times, file = FileDescriptorSet.FromString(schema.descriptors).file
    assert times.name == Timestamp.DESCRIPTOR.file.name
    assert list(file.dependency) == [times.name]
    assert (schema.name, file.package, file.syntax) == (name, "hil", "proto3")
    assert file.name == f"{name.replace('.', '/')}.proto"
    message = file.message_type[0]
    said = {at.path[3]: at.leading_comments for at in file.source_code_info.location}
    assert {tuple(at.path[:3]) for at in file.source_code_info.location} == {(4, 0, 2)}
    assert {at.path[3]: list(at.span) for at in file.source_code_info.location} == {
        k: [k + 1, 0, 0] for k in said
    }
    found = {}
    for k, field in enumerate(message.field):
        kind = FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_")
        text = said.get(k, "").removeprefix(" ").removesuffix("\n")
        found[field.name] = (field.number, kind, field.type_name.rpartition(".")[2], text)
    assert found == fields
    assert [f.name for f in message.field if f.label == FieldDescriptorProto.LABEL_REPEATED] == (
        ["setpoint"] if fields is COMMAND else []
    )


def test_directions_and_commands_have_their_names_and_0_is_unknown():
    _, frames = FileDescriptorSet.FromString(frame_schema().descriptors).file
    _, commands = FileDescriptorSet.FromString(operator_schema().descriptors).file
    assert [(v.name, v.number) for v in frames.enum_type[0].value] == [
        ("UNKNOWN_DIRECTION", 0),
        ("RX", 1),
        ("TX", 2),
    ]
    assert [(v.name, v.number) for v in commands.enum_type[0].value] == [
        ("UNKNOWN_OPERATOR", 0), *((each.name, each.value) for each in Operator)
    ]  # fmt: skip
    assert [f.name for f in frames.message_type[1].field] == ["stamp"]
    assert frames.message_type[1].field[0].number == 1
    assert message_class(frame_schema())().header.stamp.seconds == 0


# -- bytes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0, "00"), (1, "01"), (127, "7f"), (128, "8001"), (300, "ac02"), (16383, "ff7f"), (16384, "808001"), (1 << 35, "808080808001")],
)  # fmt: skip
def test_a_varint_has_seven_bits_a_byte_the_low_ones_first(value, expected):
    assert varint(value).hex() == expected


@pytest.mark.parametrize("count", [1, 15, 16, 63])
@pytest.mark.parametrize(("size", "wire_type"), [(8, FIXED64), (1, VARINT)])
def test_a_message_of_elements_has_a_tag_before_each_of_two_bytes_where_there_are_more_than_15(
    count, size, wire_type
):
    builder = Builder(6)
    builder.constant(b"\xaa")
    places = builder.message(3, size, count)
    last = builder.field(4, 4)
    template, mask = builder.layout()
    record = bytearray(template.tobytes())
    for k, at in enumerate([*places, last]):
        width = 4 if at == last else size
        assert not mask[at : at + width].any()
        record[at : at + width] = k.to_bytes(width, "little")
    assert np.count_nonzero(mask) == len(record) - 31 - count * size - 4
    tags = [varint(n << 3 | wire_type) for n in range(1, count + 1)]
    if count > 15:
        tags = [tag if len(tag) == 2 else bytes([tag[0] | 0x80, 0]) for tag in tags]
    inner = b"".join(tag + k.to_bytes(size, "little") for k, tag in enumerate(tags))
    expected = b"\xaa" + varint(3 << 3 | LENGTH) + varint(len(inner)) + inner
    expected += b"\x25" + count.to_bytes(4, "little")
    head = b"\x05" + (22 + len(expected)).to_bytes(8, "little") + b"\x06" + bytes(21)
    assert bytes(record) == head + expected
