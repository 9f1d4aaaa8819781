"""The container of a log: what stands beside its messages, and the messages in buffers, in the file's order.

A log that was cut, or is still being written, is read as far as it goes.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.opcode import Opcode

from drivers.errors import LogError
from drivers.files import open_regular
from drivers.tick_columns import Column
from hil.record.decode import REFUSED, Decoder, why
from hil.record.mcap_file import MAGIC
from hil.record.mcap_read import (
    NOTHING,
    Allowance,
    MessageTable,
    Record,
    messages_in,
    records,
)
from hil.record.row import OLD, Run, completed
from hil.record.schema import CONFIGURATION, IDENTITY, SALVAGE

_MESSAGES = frozenset({Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_FOOTER = 9 + 20 + len(MAGIC)
MEND, SALVAGED = "run `hil replay --salvage` on it", "it was salvaged before, and no more can be had of it"
"""What to do about a damaged log."""


class LogFile:
    """A log's file. State: metadata, attachments, channels met so far.

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
    """Of the rows."""
    topic: str
    """Topic of the rows, `/tick` or `/plant`."""
    can_channel: str
    """Name of the bus; of several, of the first."""
    can_channels: tuple[str, ...]
    """Name of each bus."""
    epoch_ns: int
    """UTC of t_ns = 0."""
    lockstep: bool
    """Whether its time is simulated; it counts from 2000-01-01 then."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.metadata, self.attachments = {}, {}
        self.cut, size = self._check_file()
        self._decoder = Decoder(str(path), size)
        for record in self._records(skip=_MESSAGES):
            self._learn(record)
        identity = self.metadata.get(IDENTITY, {})
        if "dtype" in identity:
            raise LogError(f"{path}: {OLD}")
        if "columns" not in identity:
            reason = (
                self.cut or f"an MCAP file, but not a log of this product (no metadata record {IDENTITY!r})"
            )
            raise LogError(f"{path}: {reason}")
        try:
            self.topic, self.columns, self.epoch_ns, self.can_channels, self.lockstep = Run.of(identity)
            self.can_channel = self.can_channels[0]
            self._decoder.expect(self.topic, self.columns, self.can_channels, self.epoch_ns)
            self.columns = completed(self.columns)
        except REFUSED as error:
            raise LogError(
                f"{path}: metadata record {IDENTITY!r} cannot be read: {why(error)}; {self.mend}"
            ) from None

    @property
    def mend(self) -> str:
        """What may be done about damage: salvage, once."""
        return SALVAGED if SALVAGE in self.metadata else MEND

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

    def _check_file(self) -> tuple[str, int]:
        """Return why the file is cut, or nothing, and its bytes; refuse what is no log at all."""
        path = self.path
        try:
            with open_regular(path) as file:
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
        if not MAGIC.startswith(head):
            raise LogError(f"{path}: not an MCAP file")
        if size < len(MAGIC) + _FOOTER or tail != MAGIC:
            return (
                f"cut at {size} bytes, the end is missing (power loss, the recorder was killed, or the run "
                "goes on): run `hil replay --salvage` on it to recover what is there"
            ), size
        return "", size

    def verify(self) -> None:
        """Compare the checksum of the whole file.

        Raises
        ------
        LogError
            It differs, or the file does not go on to its end.

        """
        try:
            for _ in self._records():
                pass
        except LogError:
            for _ in self._buffers():  # a damaged chunk says where it is
                pass
            raise

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Name the file in what goes wrong while it is read, and what may be done about damage."""
        try:
            yield
        except LogError as error:
            raise LogError(f"{self.path}: {error}; {self.mend}") from None
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _records(self, skip: frozenset[int] = frozenset()) -> Iterator[Record]:
        """Yield the records as far as they go; refuse a file that is not cut and stops making sense."""
        with self._reading():
            for record in records(self.path, skip):
                if not (record.complete or self.cut):
                    what = "no record" if record.opcode == NOTHING else "a record that ends behind the file"
                    raise LogError(f"damaged at byte {record.offset}: {what}")
                yield record

    def _learn(self, record: Record) -> None:
        """Keep what is whole and not a message."""
        if not record.complete:
            return
        try:
            found = record.parse()
        except LogError as error:
            raise self._damaged(record, error) from None
        match type(found).__name__:
            case "Metadata":
                self.metadata[found.name] = dict(found.metadata)
            case "Attachment":
                self.attachments[found.name] = bytes(found.data)
            case "Channel":
                self._decoder.learn(found)

    def _damaged(self, record: Record, error: LogError) -> LogError:
        return LogError(f"{self.path}: damaged at byte {record.offset}: {error}; {self.mend}")

    def _buffers(self) -> Iterator[tuple[bytes, MessageTable]]:
        """Yield buffers of messages: the chunks."""
        with self._reading():
            allowance = Allowance(self.path.stat().st_size)
        for record in self._records():
            if record.opcode == Opcode.MESSAGE:
                raise self._damaged(record, LogError("a message outside a chunk, which no recorder writes"))
            if record.opcode == Opcode.CHUNK:
                yield self._chunk(record, allowance)

    def _chunk(self, record: Record, allowance: Allowance) -> tuple[bytes, MessageTable]:
        """Return the messages of a chunk; of the one where a log is cut, those of whole ticks."""
        try:
            data, table, others = messages_in(record, allowance, self._decoder.kernels.scan)
        except LogError as error:
            raise self._damaged(record, error) from None
        for other in others:
            self._learn(other._replace(offset=record.offset))
        if not record.complete:
            table = table.before(self._decoder.messages_of(table, self.topic))
        return data, table
