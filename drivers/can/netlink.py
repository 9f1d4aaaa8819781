"""Requests to the kernel by route netlink: read and set network interfaces, read transmit queues.

Standard library only. Layouts follow linux/netlink.h, linux/rtnetlink.h and linux/pkt_sched.h. Numbers are in
native byte order; messages and attributes are padded to four bytes.
"""

import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

RTM_NEWLINK, RTM_GETLINK, RTM_GETQDISC = 16, 18, 38
NLM_F_REQUEST, NLM_F_ACK, NLM_F_DUMP = 0x1, 0x4, 0x300
IFF_UP = 0x1
TC_H_ROOT = 0xFFFFFFFF
_NLMSG_ERROR, _NLMSG_DONE = 2, 3
_TCA_STATS2, _TCA_STATS_QUEUE = 7, 3
_KIND = 0x3FFF
"""Mask of an attribute's type; the upper two bits are flags."""
_CAP_NET_ADMIN = 12
_HEADER = struct.Struct("=IHHII")
_ATTRIBUTE = struct.Struct("=HH")
_LINK = struct.Struct("=BxHiII")
"""struct ifinfomsg: family, type, index, flags, changed flags."""
_QUEUE = struct.Struct("=BxxxiIII")
"""struct tcmsg: family, index, handle, parent, info."""
_ERROR = struct.Struct("=i")
"""Start of struct nlmsgerr: 0, or a negative error number."""
_ANSWER = 1 << 16
_TIMEOUT_S = 1.0


def _pieces(raw: bytes, header: struct.Struct) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + header.size <= len(raw):
        size, kind, *_ = header.unpack_from(raw, at)
        if size < header.size or at + size > len(raw):
            return
        yield kind, raw[at + header.size : at + size]
        at += size + -size % 4


def attributes(raw: bytes) -> dict[int, bytes]:
    """Route attributes of a message or nest, by type; a truncated attribute ends them."""
    return {kind & _KIND: payload for kind, payload in _pieces(raw, _ATTRIBUTE)}


def request(kind: int, flags: int, body: bytes) -> list[bytes]:
    """Send one request to the kernel and collect the payloads of its answers.

    Raises OSError with the kernel's error number on a refusal, TimeoutError without an answer.
    """
    answers: list[bytes] = []
    header = _HEADER.pack(_HEADER.size + len(body), kind, NLM_F_REQUEST | NLM_F_ACK | flags, 1, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as sock:
        sock.settimeout(_TIMEOUT_S)
        sock.send(header + body)
        while True:
            for answer, payload in _pieces(sock.recv(_ANSWER), _HEADER):
                if answer == _NLMSG_ERROR:
                    code = -int(_ERROR.unpack_from(payload)[0])
                    if code:
                        raise OSError(code, os.strerror(code))
                    return answers
                if answer == _NLMSG_DONE:
                    return answers
                answers.append(payload)


def get_link(name: str) -> bytes:
    """Answer to RTM_GETLINK for an interface. Raises OSError (ENODEV) if it does not exist."""
    index = socket.if_nametoindex(name)
    (answer, *_) = request(RTM_GETLINK, 0, _LINK.pack(socket.AF_UNSPEC, 0, index, 0, 0))
    return answer


def split_link(answer: bytes) -> tuple[int, int, dict[int, bytes]]:
    """Index, flags and attributes of an RTM_NEWLINK payload."""
    _, _, index, flags, _ = _LINK.unpack_from(answer)
    return index, flags, attributes(answer[_LINK.size :])


def set_up(index: int, *, up: bool) -> None:
    """Bring an interface up or take it down. Raises OSError: EPERM without CAP_NET_ADMIN."""
    body = _LINK.pack(socket.AF_UNSPEC, 0, index, IFF_UP if up else 0, IFF_UP)
    request(RTM_NEWLINK, 0, body)


def queued(index: int) -> int:
    """Number of frames in the transmit queue of an interface, from all senders."""
    waiting = 0
    for answer in request(RTM_GETQDISC, NLM_F_DUMP, _QUEUE.pack(socket.AF_UNSPEC, index, 0, 0, 0)):
        _, of, _, parent, _ = _QUEUE.unpack_from(answer)
        if of == index and parent == TC_H_ROOT:  # else of another interface, or of a queue within one
            statistics = attributes(attributes(answer[_QUEUE.size :]).get(_TCA_STATS2, b""))
            waiting += struct.unpack_from("=I", statistics.get(_TCA_STATS_QUEUE, bytes(4)))[0]
    return waiting


def administers() -> bool:
    """True if this process may take interfaces down and up (CAP_NET_ADMIN)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> _CAP_NET_ADMIN & 1)
    return False
