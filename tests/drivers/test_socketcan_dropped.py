"""SocketCan takes its interface down and up: the error that this leaves in the socket is not taken for news."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable

import pytest

from drivers.can import netlink, socketcan
from drivers.can.socketcan import SocketCan
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.frames_heard import got
from tests.drivers.test_socketcan import CAN0, SETTINGS, MadeSocket


class KeepingSocket(MadeSocket):
    """A socket that keeps the error of its interface's going down, until it is asked for or told."""

    kept = 0

    def getsockopt(self, level, option, *size):
        if (level, option) != (socket.SOL_SOCKET, socket.SO_ERROR):
            return super().getsockopt(level, option, *size)
        error, self.kept = self.kept, 0
        return error

    def recvmsg(self, size, ancillary):
        error, self.kept = self.kept, 0
        if error:
            raise OSError(error, "made")
        return super().recvmsg(size, ancillary)


@pytest.mark.parametrize("drops", [SocketCan.died, SocketCan.flush_tx])
def test_an_interface_that_was_taken_down_and_up_to_drop_frames_is_not_down_at_the_next_look(
    monkeypatch, drops: Callable[[SocketCan], None]
):
    sock, queued = KeepingSocket(), [3]

    def set_up(_index, *, up):
        queued[0] = 0
        if not up:
            sock.kept = errno.ENETDOWN

    monkeypatch.setattr(netlink, "set_up", set_up)
    monkeypatch.setattr(netlink, "queued", lambda _: queued[0])
    monkeypatch.setattr(netlink, "get_link", lambda _: b"")
    monkeypatch.setattr(socketcan, "parse", lambda *_: CAN0)
    monkeypatch.setattr(SocketCan, "_open", lambda _: (sock, CAN0))
    can = SocketCan(SETTINGS)
    for k in (1, 2):
        drops(can)
        assert queued == [0], "the interface was taken down and up"
        sock.hears(0x123)
        assert [each.frame.id for each in got(can.receive())] == [0x123]
        assert got(can.receive()) == []
        assert not can.off
        assert can.send(sent_array([Frame(1, b"")])) == 1
        assert len(sock.sent) == k
        queued[0] = 3
