"""Random damage by a seeded generator: to bytes and text, and to one place of an MCAP file.

An MCAP file is split, damaged and joined again, with correct or wrong checksums.

Format: https://mcap.dev/spec. Tests of our reader also use these functions.
"""

import io
import math
import re
import struct
import zlib
from random import Random
from typing import Any, cast

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import Attachment, Metadata

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
REALS = (
    math.inf, -math.inf, math.nan, 1.7e308, -1.7e308, 1e300, 1e155, 5e-324, 0.0, -0.0, 2.0**63, -1e19, 1.0,
)  # fmt: skip
"""Values that replace a measured or computed number."""
_PUT_BEFORE = 22
"""Bytes of a message record before its data."""
_ROW = 200
"""Bytes of a message record; a row has more."""
_FEW = 20
"""Number of places in a row that get other numbers."""
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")

Records = list[tuple[int, bytes]]


def split(data: bytes) -> Records:
    """Records (opcode, content) of an MCAP file, or of the content of a chunk."""
    found, at = [], len(MAGIC) if data.startswith(MAGIC) else 0
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        found.append((opcode, data[at + _HEAD.size : at + _HEAD.size + length]))
        at += _HEAD.size + length
        if opcode == FOOTER:
            break
    return found


def joined(records: Records) -> bytes:
    """Join records (opcode, content) to the bytes of an MCAP file or chunk."""
    return b"".join(_HEAD.pack(opcode, len(content)) + content for opcode, content in records)


def whole(records: Records) -> bytes:
    """Bytes of an MCAP file with these records, and a new checksum of the data section."""
    ends = [k for k, (opcode, _) in enumerate(records) if opcode == DATA_END]
    if not ends or records[-1][0] != FOOTER:
        return MAGIC + joined(records) + MAGIC
    data = MAGIC + joined(records[: ends[0]])
    data += joined([(DATA_END, struct.pack("<I", zlib.crc32(data)))])
    summary = joined(records[ends[0] + 1 : -1])
    footer = FOOTER, struct.pack("<QQI", len(data) if summary else 0, 0, 0)
    return data + summary + joined([footer]) + MAGIC


def unpacked(content: bytes) -> bytes:
    """Records in a chunk of our recorder, uncompressed; `content`: that of the chunk record."""
    start = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(content)[4] + 8
    return zstandard.ZstdDecompressor().decompress(content[start:], max_output_size=1 << 24)


def packed(content: bytes, inner: bytes, size: int | None = None) -> bytes:
    """Content of a chunk record as `content`, but with the records `inner` and a new checksum."""
    first, last, _, _, _ = _CHUNK_HEAD.unpack_from(content)
    data = zstandard.ZstdCompressor(level=1).compress(inner)
    size = len(inner) if size is None else size
    head = _CHUNK_HEAD.pack(first, last, size, zlib.crc32(inner), 4) + b"zstd"
    return head + struct.pack("<Q", len(data)) + data


EXTREMES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, (1 << 31) - 1, (1 << 32) - 1, (1 << 63) - 1, (1 << 64) - 1)
WORDS = (
    "", "0", "-1", "1e308", "1e-308", ".inf", ".nan", "NaN", "null", "true", "[]", "{}", "9" * 400, "1e9",
    "\u202e", "\x1b[31m", "\x00", "<script>alert(1)</script>", "../../etc/passwd", "/etc/passwd", "%n%s", "é",
    "'", '"', "\\", "&a", "*a", "!!python/object:os.system", "x" * 3000, "- - - - -", "[[[[[[[[", "\t",
)  # fmt: skip
"""Words that replace a word of a text."""
_TOKEN = re.compile(rb"[A-Za-z0-9_.+-]+")


def flip(data: bytes, rng: Random) -> bytes:
    """Invert one to eight bits at random places."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def truncate(data: bytes, rng: Random) -> bytes:
    """Cut the bytes off at a random place."""
    return data[: rng.randrange(len(data) + 1)]


def extreme(data: bytes, rng: Random) -> bytes:
    """Overwrite 1, 2, 4 or 8 bytes, often near the beginning, with an extreme number."""
    width = rng.choice((1, 2, 4, 8))
    if len(data) < width:
        return data
    last = len(data) - width
    at = rng.randint(0, min(last, 40)) if rng.random() < 0.5 else rng.randint(0, last)
    number = rng.choice(EXTREMES) & ((1 << 8 * width) - 1)
    return data[:at] + number.to_bytes(width, "little") + data[at + width :]


def insert(data: bytes, rng: Random) -> bytes:
    """Insert random bytes, zeros, or a copy of the bytes before a random place there."""
    at, size = rng.randrange(len(data) + 1), rng.choice((1, 3, 9, 300))
    return (
        data[:at] + rng.choice((rng.randbytes(size), bytes(size), data[max(at - size, 0) : at])) + data[at:]
    )


def word(data: bytes, rng: Random) -> bytes:
    """Replace one word of a text by one of WORDS."""
    found = list(_TOKEN.finditer(data))
    if not found:
        return data
    place = rng.choice(found)
    return data[: place.start()] + rng.choice(WORDS).encode() + data[place.end() :]


ANY = (flip, truncate, extreme, insert)
"""Functions that damage any bytes."""
TEXT = (word, word, word, flip, truncate, insert)
"""Functions that damage texts: mostly words, since other damage to texts is refused at once."""


def _pick(records: Records, rng: Random, opcode: int | None = None) -> int:
    kinds = sorted({kind for kind, _ in records}) if opcode is None else [opcode]
    wanted = rng.choice(kinds)
    return rng.choice([k for k, (kind, _) in enumerate(records) if kind == wanted] or [0])


def _with(records: Records, k: int, content: bytes) -> Records:
    return [*records[:k], (records[k][0], content), *records[k + 1 :]]


def _content(records: Records, rng: Random) -> Records:
    """Damage the content of one record, drawn from all kinds of record."""
    k = _pick(records, rng)
    opcode, content = records[k]
    content = rng.choice(ANY)(content, rng)
    if opcode == ATTACHMENT and len(content) > 4 and rng.random() < 0.5:
        content = content[:-4] + struct.pack("<I", zlib.crc32(content[:-4]))
    return _with(records, k, content)


def _text(records: Records, rng: Random) -> Records:
    """Change a word in metadata or configuration; length fields are adapted."""
    k = _pick(records, rng, rng.choice((METADATA, ATTACHMENT)))
    opcode, content = records[k]
    stream, builder = ReadDataStream(io.BytesIO(content)), cast("Any", RecordBuilder())
    found: Any = (Metadata if opcode == METADATA else Attachment).read(stream)
    if opcode == METADATA:
        key = rng.choice(sorted(found.metadata) or [""])
        value = found.metadata.pop(key, "").encode()
        if rng.random() < 0.9:
            found.metadata[key] = rng.choice(TEXT)(value, rng).decode(errors="replace")
    else:
        found.data = rng.choice(TEXT)(found.data, rng)
    found.write(builder)
    return _with(records, k, builder.end()[_HEAD.size :])


def _inner(records: Records, rng: Random) -> Records:
    """Damage messages or any bytes in a chunk, and compress the chunk again."""
    k = _pick(records, rng, CHUNK)
    inner = unpacked(records[k][1])
    if rng.random() < 0.6:
        messages = split(inner)
        for _ in range(rng.randint(1, 4)):
            n = rng.randrange(len(messages))
            messages[n] = messages[n][0], rng.choice(ANY)(messages[n][1], rng)
        inner = joined(messages)
    else:
        inner = rng.choice(ANY)(inner, rng)
    return _with(records, k, packed(records[k][1], inner))


def strange_values(records: Records, rng: Random) -> Records:
    """Put extreme numbers into rows: at one place in all rows of a chunk, or at many places of one row."""
    k = _pick(records, rng, CHUNK)
    messages = split(unpacked(records[k][1]))
    rows = [n for n, (opcode, content) in enumerate(messages) if opcode == MESSAGE and len(content) > _ROW]
    share, everywhere = rng.random(), rng.random() < 0.5
    for n in rows if everywhere else rng.sample(rows, min(len(rows), 1)):
        content = bytearray(messages[n][1])
        places = range(_PUT_BEFORE, len(content) - 8)
        for place in [places[int(share * len(places))]] if everywhere else rng.sample(places, _FEW):
            struct.pack_into("<d", content, place, rng.choice(REALS))
        messages[n] = MESSAGE, bytes(content)
    return _with(records, k, packed(records[k][1], joined(messages)))


def damaged(data: bytes, rng: Random) -> bytes:
    """Damage a log in one way drawn from `rng`; in two of three cases all checksums stay correct."""
    if rng.random() < 0.25:
        return rng.choice(ANY)(data, rng)
    records = rng.choice((_content, _text, _inner, strange_values))(split(data), rng)
    return whole(records) if rng.random() < 0.67 else MAGIC + joined(records) + MAGIC
