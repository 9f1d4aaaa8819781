"""SocketCan gives its socket back to the kernel: when it is closed, and when it does not open."""

from __future__ import annotations

import errno
import socket

import pytest

from drivers.can import netlink, socketcan
from drivers.can.bus import Bus
from drivers.can.socketcan import SocketCan
from drivers.errors import BusError
from tests.drivers.test_socketcan import CAN0, SETTINGS, MadeSocket


class Refusing(MadeSocket):
    """A socket that takes all its settings and cannot be bound."""

    def setblocking(self, blocks):
        assert not blocks

    def setsockopt(self, *_setting):
        """Takes it."""

    def bind(self, _address):
        raise OSError(errno.ENODEV, "made")


def test_a_bus_that_is_closed_closes_its_socket(monkeypatch):
    sock = MadeSocket()
    monkeypatch.setattr(SocketCan, "_open", lambda _: (sock, CAN0))
    with Bus([SocketCan(SETTINGS)]):
        assert not sock.closed
    assert sock.closed


@pytest.mark.parametrize("there", [False, True])
def test_a_socket_whose_interface_is_not_there_or_cannot_be_bound_is_closed(monkeypatch, there):
    sock = Refusing()

    def get_link(_name):
        if not there:
            raise OSError(errno.ENODEV, "made")
        return b""

    monkeypatch.setattr(socket, "socket", lambda *_: sock)
    monkeypatch.setattr(netlink, "get_link", get_link)
    monkeypatch.setattr(socketcan, "parse", lambda *_: CAN0)
    with pytest.raises(BusError, match="does not open" if there else "no such network interface"):
        SocketCan(SETTINGS)
    assert sock.closed
