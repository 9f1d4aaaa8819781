"""MCAP files taken apart, damaged in one place and put together again, checksums made anew or left wrong.

Reads and writes the format by itself (https://mcap.dev/spec), so that it does not share mistakes with the
reader that it tests.
"""

import math
import struct
import zlib
from collections.abc import Callable
from random import Random

import zstandard

from tools.fuzz.mutate import ANY, EXTREMES, TEXT

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
REALS = (
    math.inf, -math.inf, math.nan, 1.7e308, -1.7e308, 1e300, 1e155, 5e-324, 0.0, -0.0, 2.0**63, -1e19, 1.0,
)  # fmt: skip
"""What stands in the place of a measured or a computed number."""
_PUT_BEFORE = 22
"""Bytes of a message record before what it carries."""
_FEW = 20
"""Numbers of a message; a row has more."""
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")

Records = list[tuple[int, bytes]]


def split(data: bytes) -> Records:
    """Return opcode and content of each record of a whole file, or of the content of a chunk."""
    found, at = [], len(MAGIC) if data.startswith(MAGIC) else 0
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        found.append((opcode, data[at + _HEAD.size : at + _HEAD.size + length]))
        at += _HEAD.size + length
        if opcode == FOOTER:
            break
    return found


def joined(records: Records) -> bytes:
    """Return records behind each other."""
    return b"".join(_HEAD.pack(opcode, len(content)) + content for opcode, content in records)


def whole(records: Records) -> bytes:
    """Return a file of records, checksums of data section and summary made anew."""
    ends = [k for k, (opcode, _) in enumerate(records) if opcode == DATA_END]
    if not ends or not records or records[-1][0] != FOOTER or len(records[-1][1]) != 20:
        return MAGIC + joined(records) + MAGIC
    data = MAGIC + joined(records[: ends[0]])
    data += joined([(DATA_END, struct.pack("<I", zlib.crc32(data)))])
    summary = joined(records[ends[0] + 1 : -1])
    start, offset = len(data) if summary else 0, len(data) + _offset_section(records[ends[0] + 1 : -1])
    head = _HEAD.pack(FOOTER, 20) + struct.pack("<QQ", start, offset if summary else 0)
    return data + summary + head + struct.pack("<I", zlib.crc32(head, zlib.crc32(summary))) + MAGIC


def _offset_section(summary: Records) -> int:
    first = next((k for k, (opcode, _) in enumerate(summary) if opcode == SUMMARY_OFFSET), len(summary))
    return len(joined(summary[:first]))


def unpacked(content: bytes) -> bytes:
    """Return the records in a chunk of our own recorder."""
    start = _CHUNK_HEAD.size + _CHUNK_HEAD.unpack_from(content)[4] + 8
    return zstandard.ZstdDecompressor().decompress(content[start:], max_output_size=1 << 24)


def packed(content: bytes, inner: bytes, size: int | None = None) -> bytes:
    """Return the chunk `content` with other records in it, its checksum made anew."""
    first, last, _, _, _ = _CHUNK_HEAD.unpack_from(content)
    data = zstandard.ZstdCompressor(level=1).compress(inner)
    size = len(inner) if size is None else size
    head = _CHUNK_HEAD.pack(first, last, size, zlib.crc32(inner), 4) + b"zstd"
    return head + struct.pack("<Q", len(data)) + data


def resealed(content: bytes) -> bytes:
    """Return an attachment with its checksum made anew."""
    return content[:-4] + struct.pack("<I", zlib.crc32(content[:-4]))


def _pick(records: Records, rng: Random, opcode: int | None = None) -> int:
    kinds = sorted({kind for kind, _ in records}) if opcode is None else [opcode]
    wanted = rng.choice(kinds)
    return rng.choice([k for k, (kind, _) in enumerate(records) if kind == wanted] or [0])


def _content(records: Records, rng: Random) -> Records:
    """Damage the content of a record of any kind."""
    k = _pick(records, rng)
    opcode, content = records[k]
    content = rng.choice(ANY)(content, rng)
    if opcode == ATTACHMENT and len(content) > 4 and rng.random() < 0.5:
        content = resealed(content)
    return [*records[:k], (opcode, content), *records[k + 1 :]]


def _text(records: Records, rng: Random) -> Records:
    """Change a word in a text: metadata, configuration, schema, channel."""
    k = _pick(records, rng, rng.choice((METADATA, METADATA, ATTACHMENT, ATTACHMENT, SCHEMA, CHANNEL)))
    opcode, content = records[k]
    if opcode == METADATA:
        return [*records[:k], (opcode, _metadata(content, rng)), *records[k + 1 :]]
    if opcode == ATTACHMENT:
        return [*records[:k], (opcode, _attachment(content, rng)), *records[k + 1 :]]
    return [*records[:k], (opcode, rng.choice(TEXT)(content, rng)), *records[k + 1 :]]


def _prefixed(data: bytes, at: int) -> tuple[bytes, int]:
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length], at + 4 + length


def _metadata(content: bytes, rng: Random) -> bytes:
    """Return metadata with one of its values damaged, taken away, or under another name."""
    name, at = _prefixed(content, 0)
    at += 4
    pairs = []
    while at < len(content):
        key, at = _prefixed(content, at)
        value, at = _prefixed(content, at)
        pairs.append([key, value])
    if pairs:
        pair = rng.choice(pairs)
        if rng.random() < 0.1:
            pairs.remove(pair)
        else:
            pair[int(rng.random() < 0.9)] = rng.choice(TEXT)(pair[1], rng)
    text = b"".join(struct.pack("<I", len(part)) + part for pair in pairs for part in pair)
    return struct.pack("<I", len(name)) + name + struct.pack("<I", len(text)) + text


def _attachment(content: bytes, rng: Random) -> bytes:
    """Return an attachment whose file is damaged, sealed again."""
    name, at = _prefixed(content, 16)
    media, at = _prefixed(content, at)
    (length,) = struct.unpack_from("<Q", content, at)
    file = rng.choice(TEXT)(content[at + 8 : at + 8 + length], rng)
    head = content[:16] + b"".join(struct.pack("<I", len(part)) + part for part in (name, media))
    return resealed(head + struct.pack("<Q", len(file)) + file + bytes(4))


def _inner(records: Records, rng: Random) -> Records:
    """Damage what is in a chunk and pack it again."""
    k = _pick(records, rng, CHUNK)
    if records[k][0] != CHUNK:
        return records
    inner = unpacked(records[k][1])
    if rng.random() < 0.6:  # one message, whose length is made anew
        messages = split(inner)
        for _ in range(rng.randint(1, 4)):
            n = rng.randrange(len(messages))
            messages[n] = messages[n][0], rng.choice(ANY)(messages[n][1], rng)
        inner = joined(messages)
    else:
        inner = rng.choice(ANY)(inner, rng)
    return [*records[:k], (CHUNK, packed(records[k][1], inner)), *records[k + 1 :]]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value, at, shift = value | (byte & 0x7F) << shift, at + 1, shift + 7
        if byte < 0x80:
            return value, at


def _numbers(data: bytes, at: int, end: int) -> list[int] | None:
    """Return where a message of Protobuf and those in it have numbers of 8 bytes; None if it is none."""
    found: list[int] = []
    while at < end:
        try:
            key, at = _varint(data, at)
            wire = key & 7
            length = {1: 8, 5: 4}.get(wire, 0)
            if wire == 0:
                _, at = _varint(data, at)
            elif wire == 2:
                length, at = _varint(data, at)
        except IndexError:
            return None
        if key < 8 or wire not in (0, 1, 2, 5) or at + length > end:
            return None
        inner = _numbers(data, at, at + length) if wire == 2 else None
        if inner is None and wire in (1, 2) and length % 8 == 0:
            inner = list(range(at, at + length, 8))
        found += inner or []
        at += length
    return found


def strange_values(records: Records, rng: Random) -> Records:
    """Put numbers of no sense into rows: one place in all rows of a chunk, or many places of one row."""
    k = _pick(records, rng, CHUNK)
    if records[k][0] != CHUNK:
        return records
    messages = split(unpacked(records[k][1]))
    places = {
        n: _numbers(content, _PUT_BEFORE, len(content)) or []
        for n, (opcode, content) in enumerate(messages)
        if opcode == MESSAGE
    }
    rows = [n for n, found in places.items() if len(found) > _FEW]
    if not rows:
        return records
    share, everywhere, value = rng.random(), rng.random() < 0.5, rng.choice(REALS)
    for n in rows if everywhere else [rng.choice(rows)]:
        content, at = bytearray(messages[n][1]), places[n]
        chosen = [at[int(share * len(at))]] if everywhere else [p for p in at if rng.random() < share]
        for place in chosen:
            number = value if everywhere or rng.random() < 0.5 else rng.choice(REALS)
            struct.pack_into("<d", content, place, number)
        messages[n] = MESSAGE, bytes(content)
    return [*records[:k], (CHUNK, packed(records[k][1], joined(messages))), *records[k + 1 :]]


def _bomb(records: Records, rng: Random) -> Records:
    """Put in chunks that unpack to far more than they take, or say so."""
    k = _pick(records, rng, CHUNK)
    if records[k][0] != CHUNK:
        return records
    content, kind = records[k][1], rng.randrange(4)
    if kind == 0:  # says that it is huge
        made = [packed(content, unpacked(content), rng.choice(EXTREMES))]
    elif kind == 1:  # one that is
        made = [packed(content, bytes(1 << 26))]
    elif kind == 2:  # many of them
        made = [packed(content, bytes(1 << 24))] * 40
    else:  # of the shortest messages that there can be
        message = next(part for part in split(unpacked(content)) if part[0] == MESSAGE)
        made = [packed(content, joined([(MESSAGE, message[1][:22])]) * 400_000)] * 4
    return [*records[:k], *((CHUNK, each) for each in made), *records[k + 1 :]]


def _order(records: Records, rng: Random) -> Records:
    """Swap two records, double one or take one away."""
    changed = list(records)
    a, b = _pick(records, rng), _pick(records, rng)
    kind = rng.randrange(3)
    if kind == 0:
        changed[a], changed[b] = changed[b], changed[a]
    elif kind == 1:
        changed.insert(b, changed[a])
    else:
        del changed[a]
    return changed


def _length(data: bytes, records: Records, rng: Random) -> bytes:
    """Set the length of a record to something else."""
    k = _pick(records, rng)
    at = len(MAGIC) + len(joined(records[:k]))
    length = len(records[k][1])
    near = (length - 1, length + 1, length + 9, length // 2)
    number = rng.choice((*EXTREMES, *near)) & ((1 << 64) - 1)
    return data[: at + 1] + struct.pack("<Q", number) + data[at + 9 :]


_STRUCTURED: tuple[Callable[[Records, Random], Records], ...] = (
    _content, _content, _content, _text, _text, _text, _inner, _inner, _inner, _order, _bomb,
    strange_values, strange_values,
)  # fmt: skip


def damaged(data: bytes, rng: Random) -> bytes:
    """Return a log with one kind of damage; with sound checksums around it in two cases of three."""
    if rng.random() < 0.25:
        return rng.choice(ANY)(data, rng)
    records = split(data)
    if rng.random() < 0.12:
        return _length(data, records, rng)
    records = rng.choice(_STRUCTURED)(records, rng)
    return whole(records) if rng.random() < 0.67 else MAGIC + joined(records) + MAGIC
