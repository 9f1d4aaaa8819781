"""Damage to bytes and to text, drawn from a seeded generator. Knows nothing of what the bytes mean."""

import re
from random import Random

EXTREMES = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, (1 << 31) - 1, (1 << 32) - 1, (1 << 63) - 1, (1 << 64) - 1)
WORDS = (
    "", "0", "-1", "1e308", "1e-308", ".inf", ".nan", "NaN", "null", "true", "[]", "{}", "9" * 400, "1e9",
    "\u202e", "\x1b[31m", "\x00", "<script>alert(1)</script>", "../../etc/passwd", "/etc/passwd", "%n%s", "é",
    "'", '"', "\\", "&a", "*a", "!!python/object:os.system", "x" * 3000, "- - - - -", "[[[[[[[[", "\t",
)  # fmt: skip
"""What stands in the place of a word of a text."""
_TOKEN = re.compile(rb"[A-Za-z0-9_.+-]+")


def flip(data: bytes, rng: Random) -> bytes:
    """Return the bytes with one to eight bits turned over."""
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def truncate(data: bytes, rng: Random) -> bytes:
    """Return the beginning."""
    return data[: rng.randrange(len(data) + 1)]


def zero_run(data: bytes, rng: Random) -> bytes:
    """Return the bytes with some in a row set to zero, as a file system leaves them."""
    start = rng.randrange(len(data) + 1)
    stop = min(len(data), start + rng.choice((1, 8, 64, 512, 4096)))
    return data[:start] + bytes(stop - start) + data[stop:]


def extreme(data: bytes, rng: Random) -> bytes:
    """Return the bytes with a number somewhere set to an extreme one; often near the beginning."""
    width = rng.choice((1, 2, 4, 8))
    if len(data) < width:
        return data
    last = len(data) - width
    at = rng.randint(0, min(last, 40)) if rng.random() < 0.5 else rng.randint(0, last)
    number = rng.choice(EXTREMES) & ((1 << 8 * width) - 1)
    return data[:at] + number.to_bytes(width, "little") + data[at + width :]


def insert(data: bytes, rng: Random) -> bytes:
    """Return the bytes with some more in between."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.choice((1, 3, 9, 300))) + data[at:]


def doubled(data: bytes, rng: Random) -> bytes:
    """Return the bytes with a part of them twice."""
    start = rng.randrange(len(data) + 1)
    stop = min(len(data), start + rng.choice((1, 10, 100, 2000)))
    return data[:stop] + data[start:stop] + data[stop:]


def word(data: bytes, rng: Random) -> bytes:
    """Return a text with one of its words replaced."""
    found = list(_TOKEN.finditer(data))
    if not found:
        return data
    place = rng.choice(found)
    return data[: place.start()] + rng.choice(WORDS).encode() + data[place.end() :]


ANY = (flip, truncate, zero_run, extreme, insert, doubled)
"""For any bytes."""
TEXT = (word, word, word, flip, truncate, insert, doubled)
"""For texts: words above all, since what is no text is refused at once."""
