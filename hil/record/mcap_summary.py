"""The index at the end of an MCAP file, as far as a log's figures need it."""

import os
import struct
import zlib
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Statistics

from drivers.errors import LogError
from drivers.regular_file import open_regular
from hil.record.mcap_file import MAGIC
from hil.record.mcap_parse import parse_record
from hil.record.mcap_read import HEAD

MAX_SUMMARY = 1 << 28
"""Bytes of an index; one of a log of 1 TB stays below."""
_TAIL = HEAD.size + 20 + len(MAGIC)


def read_summary(path: Path) -> tuple[Statistics, dict[int, str]]:
    """Return the statistics of a whole file, and the topics of its channels by number.

    Raises
    ------
    LogError
        There is no index, or it is damaged.
    OSError
        The file cannot be read.

    """
    with open_regular(path) as file:
        size = file.seek(0, os.SEEK_END)
        end = max(size - _TAIL, 0)
        file.seek(end)
        tail = file.read(_TAIL)
        if len(tail) < _TAIL or HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
            raise LogError(f"damaged at byte {end}: no footer")
        start, _, crc = struct.unpack_from("<QQI", tail, HEAD.size)
        if not start:
            raise LogError("no index at the end")
        if not len(MAGIC) <= start <= end or end - start > MAX_SUMMARY:
            raise LogError(f"damaged at byte {end}: an index from byte {start} to {end} of {size}")
        file.seek(start)
        data = file.read(end - start)
    if crc and zlib.crc32(tail[: HEAD.size + 16], zlib.crc32(data)) != crc:
        raise LogError(f"damaged between byte {start} and {end}: the checksum of the index differs")
    return _parse(data, start)


def _parse(data: bytes, start: int) -> tuple[Statistics, dict[int, str]]:
    statistics, topics, at = None, {}, 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        content = data[at + HEAD.size : at + HEAD.size + length]
        if len(content) < length:
            raise LogError(f"damaged at byte {start + at}: a record of the index reaches past its end")
        if opcode in {Opcode.STATISTICS, Opcode.CHANNEL}:
            try:
                found = parse_record(opcode, content)
            except LogError as error:
                raise LogError(f"damaged at byte {start + at}: {error}") from None
            if isinstance(found, Statistics):
                statistics = found
            else:
                topics[found.id] = found.topic
        at += HEAD.size + length
    if statistics is None:
        raise LogError(f"damaged: the index at byte {start} has no statistics")
    return statistics, topics
