"""A client of Foxglove's websocket protocol, version 1, made of sockets: what it reads, a viewer would."""

import base64
import json
import os
import socket
import struct
import time
from typing import Any


class Client:
    """Connects, and reads as much as it is asked to."""

    def __init__(self, port):
        end = time.monotonic() + 10.0
        while True:
            try:
                self._socket = socket.create_connection(("127.0.0.1", port), timeout=10.0)
                break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._data = b""
        while b"\r\n\r\n" not in self._data:
            self._data += self._socket.recv(4096)
        head, _, self._data = self._data.partition(b"\r\n\r\n")
        assert b" 101 " in head.split(b"\r\n")[0], head
        self.channels: dict[str, Any] = {}
        while not self.channels:
            opcode, data = self.frame()
            if opcode == 1 and (message := json.loads(data))["op"] == "advertise":
                self.channels = {c["topic"]: c for c in message["channels"]}

    def subscribe(self, *topics):
        subscriptions = [{"id": i, "channelId": self.channels[t]["id"]} for i, t in enumerate(topics)]
        data = json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()
        mask = os.urandom(4)
        head = struct.pack("!BBH", 0x81, 0x80 | 126, len(data)) + mask
        self._socket.sendall(head + bytes(b ^ mask[i % 4] for i, b in enumerate(data)))

    def messages(self, quiet_s):
        """Yield subscription, time in ns and payload until the server is quiet or gone."""
        self._socket.settimeout(quiet_s)
        while True:
            try:
                opcode, data = self.frame()
            except (OSError, EOFError):
                return
            if opcode == 8:
                return
            if opcode == 2 and data[0] == 1:
                number, t_ns = struct.unpack_from("<IQ", data, 1)
                yield number, t_ns, data[13:]

    def frame(self):
        """Return opcode and payload of the next frame."""
        first, length = self._take(2)
        length &= 0x7F
        if length >= 126:
            size = 2 if length == 126 else 8
            length = int.from_bytes(self._take(size), "big")
        return first & 0x0F, self._take(length)

    def close(self):
        self._socket.close()

    def _take(self, count):
        while len(self._data) < count:
            piece = self._socket.recv(1 << 16)
            if not piece:
                raise EOFError
            self._data += piece
        taken, self._data = self._data[:count], self._data[count:]
        return taken
