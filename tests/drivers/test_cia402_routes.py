"""Which CiA 402 drive a frame concerns, by its identifier, and what a drive says of who it is."""

from __future__ import annotations

import pytest

from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, REVISION, SERIAL, Frame, Said
from tests.drivers.cia402_drives import drives

NODES = (21, 3, 126, 40, 5, 64)
ALL = (0, 1, 2, 3, 4, 5)
P = drives(NODES)


@pytest.mark.parametrize("leg", ALL)
def test_what_is_for_one_node_concerns_its_drive_and_what_is_for_all_every_one(leg):
    node = NODES[leg]
    for kind in (0x200, 0x300, 0x400, 0x500, 0x600):
        assert P.addressed(Frame(kind + node, b"")) == (leg,)
        assert P.addressed(Frame(kind + 9, b"")) == ()
    for kind in (0x080, 0x180, 0x280, 0x580, 0x700):
        assert P.addressed(Frame(kind + node, b"")) == ALL
    assert P.addressed(Frame(0, bytes((1, node)))) == (leg,)
    assert P.addressed(Frame(0, b"\1\0")) == P.addressed(Frame(0x080, b"")) == ALL
    assert (
        P.addressed(Frame(0, b"\1\x09")) == P.addressed(Frame(0, b"\1")) == P.addressed(Frame(0, b"")) == ()
    )


@pytest.mark.parametrize("leg", ALL)
def test_a_frame_is_sent_by_the_drive_of_its_node_where_its_kind_is_one_that_drives_send(leg):
    node = NODES[leg]
    for kind in (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700):
        assert P.sender(Frame(kind + node, b"")) == leg
        assert P.sender(Frame(kind + 9, b"")) == -1
    for kind in (0x000, 0x200, 0x300, 0x400, 0x500, 0x600):
        assert P.sender(Frame(kind + node, b"")) == -1


def test_drives_are_asked_for_their_serial_number_and_then_for_their_revision():
    serial, revision = (bytes.fromhex(f"401810{sub:02x}00000000") for sub in (4, 3))
    assert P.traits.identity_requests == tuple(
        tuple(Frame(0x600 + node, request) for node in NODES) for request in (serial, revision)
    )


@pytest.mark.parametrize("leg", ALL)
def test_an_answer_says_who_its_drive_is_and_nothing_else_does(leg):
    def said(text: str, identifier: int = 0x580 + NODES[leg], flags: int = 0) -> Said | None:
        found: Said | None = P.identity(Frame(identifier, bytes.fromhex(text), flags))
        return found

    serial = "4318100478563412"
    assert said(serial) == Said(leg, SERIAL, 0x12345678)
    assert said("4318100302000100") == Said(leg, REVISION, 0x10002)
    for text in ("8018100400000206", "6018100400000000", "4318100278563412", serial[:14], "4118100478563412"):
        assert said(text) is None, text
    for identifier in (0x580 + 9, 0x700 + NODES[leg], 0x080 + NODES[leg], 0x600 + NODES[leg]):
        assert said(serial, identifier) is None
    for flags in (EXTENDED, FD, REMOTE, ERROR, BUS):
        assert said(serial, flags=flags) is None
