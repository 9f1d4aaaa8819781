"""What the kernel is asked by route netlink, byte for byte after linux/netlink.h, and what of its answer counts."""

from __future__ import annotations

import errno
import socket
import struct
import sys
from types import SimpleNamespace
from typing import Any, Self

import pytest

from drivers.can import netlink

pytestmark = pytest.mark.skipif(sys.byteorder != "little", reason="byte vectors are little endian")

LINK = "00 00 1801 05000000 c1000100 00000000"
"""struct ifinfomsg: ARPHRD_CAN, index 5, up."""


def message(kind: int, payload: bytes) -> bytes:
    return struct.pack("=IHHII", 16 + len(payload), kind, 0, 1, 0) + payload + bytes(-len(payload) % 4)


DONE, ACKNOWLEDGED = message(3, bytes(4)), message(2, bytes(4) + bytes(16))


class Kernel:
    """A stand-in for the kernel's end: answers what it is given to. Mutable state: what it was sent."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *answers: bytes) -> None:
        self.sent: list[str] = []
        self.answers = list(answers)
        self.opened: tuple[Any, ...] = ()
        names = ("AF_NETLINK", "SOCK_RAW", "NETLINK_ROUTE", "AF_UNSPEC")
        constants = {name: getattr(socket, name) for name in names}
        indices = {"can0": 5}.__getitem__
        stand_in = SimpleNamespace(socket=self._open, if_nametoindex=indices, **constants)
        monkeypatch.setattr(netlink, "socket", stand_in)

    def _open(self, *kind: int) -> Kernel:
        self.opened = kind
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to free."""

    def settimeout(self, _seconds: float) -> None:
        """It answers at once."""

    def send(self, data: bytes) -> None:
        self.sent.append(data.hex())

    def recv(self, _size: int) -> bytes:
        return self.answers.pop(0)


def test_a_link_is_read_by_one_request_for_its_index_that_is_to_be_acknowledged(monkeypatch):
    payload = bytes.fromhex(LINK)
    kernel = Kernel(monkeypatch, message(16, payload), ACKNOWLEDGED)
    assert netlink.get_link("can0") == payload
    assert kernel.opened == (socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
    assert kernel.sent == ["200000001200050001000000000000000000000005000000" + "0" * 16]


@pytest.mark.parametrize(("up", "flags"), [(True, "01000000"), (False, "00000000")])
def test_a_link_is_taken_up_and_down_by_its_flag_alone(monkeypatch, up, flags):
    kernel = Kernel(monkeypatch, ACKNOWLEDGED)
    netlink.set_up(5, up=up)
    head = "20000000100005000100000000000000"
    assert kernel.sent == [head + "0000000005000000" + flags + "01000000"]


def queue(index: int, parent: str, length: int) -> bytes:
    """Return the RTM_NEWQDISC of a queue in which so many frames wait."""
    statistics = f"1800 0300 {length:02x}000000 a8000000 00000000 00000000 00000000"
    return message(
        36, bytes.fromhex(f"00000000 {index:02x}000000 00000180 {parent} 02000000 1c00 0700 {statistics}")
    )


def test_the_frames_that_wait_are_those_of_the_roots_of_one_link_in_any_number_of_answers(monkeypatch):
    found = [queue(5, "ffffffff", 7), queue(6, "ffffffff", 30), queue(5, "01000180", 60)]
    kernel = Kernel(monkeypatch, found[0] + found[1], found[2] + queue(5, "ffffffff", 2), DONE)
    assert netlink.queued(5) == 9
    head = "24000000260005030100000000000000"
    assert kernel.sent == [head + "0000000005000000" + "0" * 24]


@pytest.mark.parametrize("code", [errno.EPERM, errno.ENODEV, errno.EBUSY])
def test_a_refusal_of_the_kernel_is_raised_with_its_number(monkeypatch, code):
    Kernel(monkeypatch, message(2, struct.pack("=i", -code) + bytes(16)))
    with pytest.raises(OSError, match=r".") as caught:
        netlink.set_up(5, up=False)
    assert caught.value.errno == code


@pytest.mark.parametrize(
    ("effective", "may"),
    [(0, False), (1 << 12, True), (1 << 11, False), (1 << 13, False), ((1 << 41) - 1, True)],
)
def test_who_may_take_interfaces_down_is_told_by_the_rights_that_act_now(monkeypatch, effective, may):
    others = (1 << 41) - 1 if not may else 0
    status = "".join(f"{name}:\t{others:016x}\n" for name in ("CapInh", "CapPrm"))
    status += f"CapEff:\t{effective:016x}\n" + f"CapBnd:\t{others:016x}\n"
    asked: list[str] = []

    def path(name: str) -> Any:
        asked.append(name)
        return SimpleNamespace(read_text=lambda: f"Name:\thil\n{status}")

    monkeypatch.setattr(netlink, "Path", path)
    assert netlink.administers() is may
    assert asked == ["/proc/self/status"]
