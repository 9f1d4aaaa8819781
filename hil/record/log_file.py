"""The container of a log: what stands beside its messages, and the messages in buffers, in the file's order.

A log that was cut, or is still being written, is read as far as it goes.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.decode import Decoder
from hil.record.mcap_file import MAGIC
from hil.record.mcap_read import MessageTable, Record, decompress, decompress_part, records, split
from hil.record.row import columns_of, columns_of_0_1_0
from hil.record.schema import CONFIGURATION, IDENTITY

_MESSAGES = frozenset({Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_FOOTER = 9 + 20 + len(MAGIC)
_LOOSE = 4096
"""Messages outside chunks that are read together."""


class LogFile:
    """A log's file. State: what is no message, and the schemas and channels met so far.

    Raises
    ------
    LogError
        No such file, no MCAP, damaged, not written by this product, or cut within its first bytes.

    """

    path: Path
    metadata: dict[str, dict[str, str]]
    """Records by name, `hil` (the run), `environment` (the machine) and `summary` (its end) among them."""
    attachments: dict[str, bytes]
    """Files by name, those of the configuration, the protocol's database and what else replay needs."""
    cut: str
    """Why the file ends too early; empty for a whole one."""
    columns: tuple[Column, ...]
    """Of the rows; without names of elements and numbers where version 0.1.0 wrote the log."""
    topic: str
    """Topic of the rows, `/tick` or `/plant`."""
    can_channel: str
    """Name of the bus."""
    epoch_ns: int
    """UTC of t_ns = 0."""
    lockstep: bool
    """Whether its time is simulated; it counts from 2000-01-01 then."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.metadata, self.attachments = {}, {}
        self._decoder = Decoder(str(path))
        self.cut = self._check_file()
        for record in records(self.path, skip=_MESSAGES):
            self._learn(record)
        identity = self.metadata.get(IDENTITY, {})
        if not {"columns", "dtype"} & identity.keys():
            reason = (
                self.cut or f"an MCAP file, but not a log of this product (no metadata record {IDENTITY!r})"
            )
            raise LogError(f"{path}: {reason}")
        try:
            self.columns = (
                columns_of(identity["columns"])
                if "columns" in identity
                else columns_of_0_1_0(identity["dtype"])
            )
            self.topic, self.epoch_ns = identity["topic"], int(identity["epoch_ns"])
            self.can_channel, self.lockstep = identity["can_channel"], identity["mode"] == "lockstep"
            self._decoder.expect(self.topic, self.columns, self.can_channel, self.epoch_ns)
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise LogError(f"{path}: metadata record {IDENTITY!r} cannot be read: {error!r}") from error

    @property
    def configuration(self) -> str:
        """Text of the configuration of the run.

        Raises
        ------
        LogError
            The log has none, or one that is no text.

        """
        if CONFIGURATION not in self.attachments:
            raise LogError(
                f"{self.path}: no attachment {CONFIGURATION}: the configuration of the run is not known"
            )
        try:
            return self.attachments[CONFIGURATION].decode()
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: attachment {CONFIGURATION} is no text: {error}") from error

    def _check_file(self) -> str:
        """Return why the file is cut, or nothing; refuse what is no log at all."""
        path = self.path
        try:
            with path.open("rb") as file:
                head = file.read(len(MAGIC))
                size = file.seek(0, os.SEEK_END)
                file.seek(max(size - len(MAGIC), 0))
                tail = file.read()
        except FileNotFoundError:
            raise LogError(f"{path}: no such file") from None
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error
        if not head:
            raise LogError(f"{path}: the file is empty")
        if head != MAGIC[: len(head)] or (len(head) == len(MAGIC) and head != MAGIC):
            raise LogError(f"{path}: not an MCAP file")
        if size < len(MAGIC) + _FOOTER or tail != MAGIC:
            return (
                f"cut at {size} bytes, the end is missing (power loss, the recorder was killed, or the run "
                "goes on): run `hil replay --salvage` on it to recover what is there"
            )
        return ""

    def _learn(self, record: Record) -> None:
        """Keep what is not a message."""
        if record.opcode in _MESSAGES:
            return
        found = self._parse(record)
        match type(found).__name__:
            case "Metadata":
                self.metadata[found.name] = dict(found.metadata)
            case "Attachment":
                self.attachments[found.name] = bytes(found.data)
            case "Schema" | "Channel":
                self._decoder.learn(found)

    def _parse(self, record: Record) -> Any:
        try:
            if record.complete:
                return record.parse()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise LogError(f"{self.path}: damaged at byte {record.offset}: {error}") from error
        if self.cut:
            return None
        raise LogError(f"{self.path}: cut at byte {record.offset}: run `hil replay --salvage` on it")

    def _buffers(self) -> Iterator[tuple[bytes, MessageTable]]:
        """Yield buffers of messages: the chunks, or runs of messages that stand outside chunks."""
        loose: list[bytes] = []
        for record in records(self.path):
            if record.opcode == Opcode.MESSAGE and record.complete:
                loose.append(record.whole)
                if len(loose) < _LOOSE:
                    continue
            if loose:
                data, loose = b"".join(loose), []
                yield data, split(data)[0]
            if record.opcode == Opcode.CHUNK:
                yield self._chunk(record)
        if loose:
            data = b"".join(loose)
            yield data, split(data)[0]

    def _chunk(self, record: Record) -> tuple[bytes, MessageTable]:
        """Return the messages of a chunk; of the one where a log is cut, those of whole ticks."""
        chunk: Chunk | None = self._parse(record)
        try:
            data = decompress_part(record.content) if chunk is None else decompress(chunk)
        except LogError as error:
            raise LogError(f"{self.path}: damaged at byte {record.offset}: {error}") from error
        table, others = split(data)
        for other in others:
            self._learn(other)
        if chunk is None:
            begun = self._decoder.messages_of(table, self.topic)  # the row is the first message of a tick
            end = int(begun[-1]) if len(begun) else 0
            table = MessageTable(*(column[:end] for column in table))
        return data, table
