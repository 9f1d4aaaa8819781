"""Foxglove messages of a log agree with Foxglove's own SDK: names, numbers, types and enum values."""

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool

from hil.record.encode import Encoder
from hil.record.row import TICKS

messages = pytest.importorskip("foxglove.messages", reason="optional extra `viewers`")
CHANNELS = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None).channels
OURS = {schema.name.removeprefix("foxglove."): schema.descriptors for _, schema, _ in CHANNELS.values()
        if schema.name.startswith("foxglove.")}  # fmt: skip


def described(name, data):
    """All messages and enums that a message consists of: full name -> fields or values."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        pool.Add(file)
    found: dict[str, object] = {}

    def walk(message):
        if message.full_name in found:
            return
        found[message.full_name] = {
            f.name: (f.number, f.type, f.is_repeated, f.message_type and f.message_type.full_name)
            for f in message.fields
        }
        for f in message.fields:
            if f.enum_type is not None:
                found[f.enum_type.full_name] = {v.name: v.number for v in f.enum_type.values}
            if f.message_type is not None:
                walk(f.message_type)

    walk(pool.FindMessageTypeByName(f"foxglove.{name}"))
    return found


@pytest.mark.parametrize("name", sorted(OURS))
def test_foxglove_message_agrees_with_the_sdk(name):
    theirs = getattr(messages, name).get_schema()
    assert (theirs.name, theirs.encoding) == (f"foxglove.{name}", "protobuf")
    expected = described(name, theirs.data)
    assert len(expected) >= 2
    assert len(OURS) == 3
    assert described(name, OURS[name]) == expected
