"""Random damage to bytes and to text, by a seeded generator, without regard to their meaning."""

import re
from random import Random

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
