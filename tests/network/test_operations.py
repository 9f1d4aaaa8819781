"""Codec of the CAN operations of FMI-LS-BUS, against public vectors and malformed binaries."""

import json
import random
from pathlib import Path

import pytest

from drivers.protocol import BRS, ESI, EXTENDED, FD, REMOTE, Frame
from plant_fmu.network.operations import Code, Corrupt, Operation, decode, encode, from_frame, to_frame

VECTORS = json.loads((Path(__file__).parents[1] / "data/ls_bus.json").read_text())
"""Binaries that the macros of the standard make, recorded ones, and malformed ones (without operations)."""
GOOD = [v for v in VECTORS if v["operations"]]
BAD = [v for v in VECTORS if not v["operations"]]


def expected(vector):
    return [Operation(Code(code), tuple(a), bytes.fromhex(data)) for code, a, data in vector["operations"]]


@pytest.mark.parametrize("vector", GOOD, ids=lambda v: v["what"])
def test_public_vector_is_encoded_and_decoded_alike(vector):
    binary = bytes.fromhex(vector["binary"])
    assert encode(expected(vector)) == binary
    assert decode(binary) == expected(vector)


@pytest.mark.parametrize("vector", BAD, ids=lambda v: v["what"])
def test_malformed_public_vector_is_corrupt_with_all_its_bytes(vector):
    assert decode(bytes.fromhex(vector["binary"])) == [Corrupt(bytes.fromhex(vector["binary"]))]


@pytest.mark.parametrize(
    "binary",
    [
        "100000001000000000080000 00 00 0000",  # standard identifier 0x800
        "100000001000000000000020 01 00 0000",  # extended identifier of 30 bits
        "100000001000000001000000 02 00 0000",  # Ide 2
        "1100000015000000010000000000000300112233 44",  # 3 bytes stated, 4 there
        "110000001a00000001000000000000 0900 010203040506070809",  # CAN FD has no length 9
        "410000000900000004",
        "400000000d0000000100000000",  # 0 bit/s
        "31000000 0f000000 81010000 07 01 00",
        "4200000009000000 00",
    ],
)
def test_invalid_argument_is_corrupt_and_the_next_operation_is_read(binary):
    broken = bytes.fromhex(binary)
    if int.from_bytes(broken[4:8], "little") == len(broken):
        assert decode(broken + encode([Operation(Code.WAKEUP)])) == [Corrupt(broken), Operation(Code.WAKEUP)]
    assert isinstance(decode(broken)[0], Corrupt)


def test_ten_thousand_malformed_binaries_lose_no_byte_and_raise_nothing():
    draw = random.Random(48)
    good = [bytes.fromhex(v["binary"]) for v in GOOD]
    corrupt = 0
    for _ in range(10_000):
        binary = bytearray(b"".join(draw.choices(good, k=draw.randint(1, 3))))
        for _ in range(draw.randint(1, 3)):
            place = draw.randrange(len(binary))
            match draw.randrange(4):
                case 0:
                    binary[place] = draw.randrange(256)
                case 1:
                    del binary[place:]
                case 2:
                    binary[place:place] = draw.choice(good)
                case _:
                    binary[place : place + 4] = draw.randrange(1 << 32).to_bytes(4, "little")
            binary = binary or bytearray(b"\0")
        found = decode(bytes(binary))
        corrupt += any(isinstance(each, Corrupt) for each in found)
        again = [each.data if isinstance(each, Corrupt) else encode([each]) for each in found]
        assert b"".join(again) == bytes(binary)
    assert corrupt > 5_000


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x7FF, b"\1\2"),
        Frame(0x18EF1300, b"", EXTENDED | REMOTE),
        Frame(0x8001, bytes(12), EXTENDED | FD | BRS),
        Frame(0x123, bytes(64), FD | ESI),
    ],
)
def test_frame_survives_the_way_through_an_operation(frame):
    (operation,) = decode(encode([from_frame(frame)]))
    assert isinstance(operation, Operation)
    assert to_frame(operation) == frame
