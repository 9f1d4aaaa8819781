"""What a damaged log says of itself: its identity, its schemas and channels, each from the best place.

Schemas and channels stand in the data section and again in the index; those of our own messages can be made
anew. The identity stands once: where its table of columns is damaged, that of this version takes its place.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.records import Schema as SchemaRecord

from drivers.errors import LogError
from hil.record.decode import CAN, OPERATOR, REFUSED
from hil.record.mcap_read import Record
from hil.record.row import TICKS, Table, columns_of, columns_of_0_1_0, describe, row_schema
from hil.record.schema import IDENTITY, Schema, frame_schema, message_class, operator_schema
from hil.record.surviving import Lost, surviving


class Descriptions:
    """What is known of a log. State: channels that were asked for and are unknown.

    Raises LogError where nothing says that it is a log of this product; OSError.
    """

    def __init__(self, path: Path) -> None:
        self.remarks: list[str] = []
        self.identity: dict[str, str] = {}
        self.schemas: dict[int, SchemaRecord] = {}
        self.channels: dict[int, Channel] = {}
        for record in surviving(path, index=True):
            if not isinstance(record, Lost) and record.complete:
                self._learn(record)
        if not self.identity:
            raise LogError(
                f"{path}: no log of this product, or cut within its first bytes: nothing to salvage"
            )
        self._mend_columns(path)
        for channel in self.channels.values():
            self._mend_schema(channel)

    def of_ticks(self) -> list[int]:
        """Return the channels of the rows."""
        topic = self.identity.get("topic")
        return [number for number, channel in self.channels.items() if channel.topic == topic]

    def unknown(self, number: int) -> Channel:
        """Return a description of a channel of which nothing is known."""
        channel = Channel(
            id=number, topic=f"/unknown_{number}", message_encoding="", metadata={}, schema_id=0
        )
        self.channels[number] = channel
        return channel

    def further(self, records: Iterable[Record]) -> list[SchemaRecord | Channel]:
        """Learn from records within a chunk; return what was not known."""
        schemas, channels = set(self.schemas), set(self.channels)
        for record in records:
            self._learn(record)
        found: list[SchemaRecord | Channel] = [s for n, s in self.schemas.items() if n not in schemas]
        return found + [c for n, c in self.channels.items() if n not in channels]

    def _learn(self, record: Record) -> None:
        if record.opcode not in {Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL}:
            return
        try:
            found: Any = record.parse()
        except LogError as error:
            self.remarks.append(str(error))
            return
        if record.opcode == Opcode.METADATA:
            if found.name == IDENTITY and {"columns", "dtype"} & found.metadata.keys():
                self.identity = self.identity or dict(found.metadata)
        elif record.opcode == Opcode.SCHEMA:
            if found.id and (found.id not in self.schemas or not _usable(self.schemas[found.id])):
                self.schemas[found.id] = found
        else:
            self.channels.setdefault(found.id, found)

    def _mend_columns(self, path: Path) -> None:
        try:
            if "columns" in self.identity:
                columns_of(self.identity["columns"])
            else:
                columns_of_0_1_0(self.identity["dtype"])
        except REFUSED as error:
            if self.identity.get("topic") != TICKS.topic or "columns" not in self.identity:
                raise LogError(
                    f"{path}: its table of columns is damaged: nothing to salvage: {error}"
                ) from None
            self.identity["columns"] = describe(TICKS.columns)
            self.remarks.append("the table of columns is damaged; that of this version takes its place")

    def _mend_schema(self, channel: Channel) -> None:
        """See to it that a channel has a schema that can be used, or none."""
        there = self.schemas.get(channel.schema_id)
        if not channel.schema_id or (there is not None and _usable(there)):
            return
        made = self._own(channel.topic)
        if made is None:
            self.remarks.append(f"the schema of {channel.topic} is lost")
            self.schemas.pop(channel.schema_id, None)
            channel.schema_id = 0
            return
        self.remarks.append(f"the schema of {channel.topic} is damaged; that of this version takes its place")
        self.schemas[channel.schema_id] = SchemaRecord(
            id=channel.schema_id, name=made.name, encoding="protobuf", data=made.descriptors
        )

    def _own(self, topic: str) -> Schema | None:
        """Return the schema of our own messages of a topic."""
        if topic == CAN:
            return frame_schema()
        if topic == OPERATOR:
            return operator_schema()
        if topic == self.identity.get("topic") and "columns" in self.identity:
            return row_schema(Table(topic, columns_of(self.identity["columns"])))
        return None


def _usable(schema: SchemaRecord) -> bool:
    """Return whether messages can be read by a schema."""
    if schema.encoding != "protobuf":
        return True
    try:
        message_class(Schema(schema.name, bytes(schema.data)))
    except REFUSED:
        return False
    return True
