"""Runs where vcan0 exists: two python-can sockets exchange a classic and an FD frame, candump listens.

``roundtrip.py LOG``: candump's lines go to LOG, what the second socket received to stdout as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import can

from tests.vcan.listen import candump

SENT = (
    can.Message(arbitration_id=0x123, data=bytes.fromhex("0102030405060708"), is_extended_id=False),
    can.Message(
        arbitration_id=0x110, data=bytes(range(32)), is_fd=True, bitrate_switch=True, is_extended_id=False
    ),
)


def main() -> None:
    received = []
    with (
        candump("vcan0", Path(sys.argv[1])),
        can.Bus(interface="socketcan", channel="vcan0", fd=True) as near,
        can.Bus(interface="socketcan", channel="vcan0", fd=True) as far,
    ):
        for message in SENT:
            near.send(message, timeout=1.0)
            answer = far.recv(timeout=2.0)
            if answer is not None:
                received.append([answer.arbitration_id, answer.is_fd, bytes(answer.data).hex()])
    print(json.dumps(received))


if __name__ == "__main__":
    main()
