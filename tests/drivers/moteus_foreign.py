"""Random moteus commands and replies, and digests of their bytes and values in the vendor's package.

With the package installed, `python -m tests.drivers.moteus_foreign` writes
tests/data/drives/moteus_random.json.
"""

from __future__ import annotations

import hashlib
import json
import random
import struct
from collections.abc import Iterable, Iterator
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

COUNT = 10_000
FILE = Path(__file__).parents[1] / "data" / "drives" / "moteus_random.json"


def single(value: float) -> float:
    """Nearest float32, an exact input for both codecs."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def commands() -> Iterator[tuple[int, float, float, float]]:
    """Yield id, torque N m, torque limit N m and watchdog s."""
    r = random.Random(7)
    for _ in range(COUNT):
        yield (
            r.randint(1, 126),
            single(r.choice((0.0, 1.0)) * r.uniform(-40.0, 40.0)),
            single(r.uniform(0.01, 40.0)),
            single(r.uniform(0.003, 2.0)),
        )


def replies() -> Iterator[bytes]:
    """Yield reply payloads of every width, with NaN codes and NOPs among them."""
    r = random.Random(11)
    forms = ("b", "h", "i", "f")
    for _ in range(COUNT):
        width = r.randrange(4)
        if width == 3:
            values: list[float] = [single(r.uniform(-50.0, 50.0)) for _ in range(3)]
        else:
            end = 1 << (8 << width) - 1
            values = [r.choice((-end, end - 1, r.randint(-end, end - 1))) for _ in range(3)]
        body = struct.pack(f"<3{forms[width]}", *values)
        data = bytes((0x21, 0, r.choice((0, 1, 10, 11)), 0x23 | width << 2, 1)) + body
        data += bytes((0x23, 0x0D, r.randrange(128), r.randrange(128), r.choice((0, 33, 39))))
        yield data + b"\x50" * r.randrange(3)


def line(mode: float, position: float, velocity: float, torque: float, fault: float) -> str:
    """Values of a reply as a line."""
    return f"{mode:g} {position:.9g} {velocity:.9g} {torque:.9g} {fault:g}\n"


def digest(parts: Iterable[bytes]) -> str:
    whole = hashlib.sha256()
    for part in parts:
        whole.update(part)
    return whole.hexdigest()


def foreign_command(package: Any, node: int, torque: float, most: float, timeout_s: float) -> Any:
    return package.Controller(id=node).make_position(
        position=float("nan"),
        velocity=0.0,
        feedforward_torque=torque,
        kp_scale=0.0,
        kd_scale=0.0,
        maximum_torque=most,
        watchdog_timeout=timeout_s,
        query=True,
    )


def foreign_line(package: Any, data: bytes) -> str:
    """Values that the vendor's package reads in a reply, as a line."""
    said = package.parse_reply(data) if hasattr(package, "parse_reply") else package.moteus.parse_reply(data)
    r = package.Register
    return line(*(float(said[each]) for each in (r.MODE, r.POSITION, r.VELOCITY, r.TORQUE, r.FAULT)))


def write() -> None:
    moteus: Any = import_module("moteus")

    FILE.write_text(
        json.dumps(
            {
                "package": f"moteus {version('moteus')} from PyPI (Apache-2.0)",
                "count": COUNT,
                "commands": digest(bytes(foreign_command(moteus, *each).data) for each in commands()),
                "replies": digest(foreign_line(moteus, each).encode() for each in replies()),
            },
            indent=1,
        )
        + "\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    write()
